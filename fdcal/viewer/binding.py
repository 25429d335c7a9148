"""The controls of the panels, bound to a session.

A control, its bounds and its effect are declared together: `binding.slider("SNR (dB)", 1, 60, 1, 30, act)`. With
`command="snr"` the bar of the face Explore and the keys have the same effect under that name (`Binding.carry_out`).
`server.hardening` drops values that a control cannot have. Callbacks are `async`, so that viser runs them in order on
its own event loop. None of them blocks. viser sends a property only if it differs from what the browsers have.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import viser

from ..graphics.picture import row_word
from ..model.validation import Reals, require_choice
from ..session.sources import OpenRequest
from .html import whole
from .prepare import DisplayFrame, PreparedRun
from .scheduler import Memo, Scheduler
from .state import Choices, PageState, initial_choices

Control = TypeVar("Control")


RUN_BAR = "run bar"  # in place of the name of a tab: the controls above all tabs


class Tab:
    """A part of a tab of one session. It creates its controls in `__init__`, and `show` brings them up to date.

    `where`: name of the tab; `order`: rank among the parts of all tabs, since a part may use those created before it;
    `interval`: least time between two updates, s; `plots`: plots of the part, which may still have data to send.
    """

    where, order = "", 10
    interval = 0.0
    plots: tuple = ()
    _updated = -math.inf

    def __init__(self, binding: Binding): ...

    @classmethod
    def attribute(cls) -> str:
        """Return the name of the part as an attribute of `Tabs`, such as "map" for a MapTab."""
        return cls.__name__.lower().removesuffix("tab").removesuffix("panel").replace("runbar", "run_bar")

    def refresh(self) -> None:
        """Update what depends on choices and values of controls, after the program has set them."""

    def inputs(self, state: PageState) -> tuple:
        """Return the parts of a state that the tab shows; it is updated when one of them has changed."""
        return (state,)

    def show(self, state: PageState) -> None:
        """Bring the tab up to date."""

    def update(self, state: PageState) -> None:
        """Call `show` if the inputs have changed, at most once per `interval`; called by the main loop."""
        for plot in self.plots:
            plot.settle()
        inputs, memo = self.inputs(state), vars(self).setdefault("_memo", Memo())
        if state.now - self._updated >= self.interval and memo.get(*inputs) is None:
            self._updated = state.now
            self.show(state)
            memo(lambda: True, *inputs)


class Binding:
    """The session that is shown, the choices made for it, its threads, and the values sent to its controls.

    The callbacks replace `choices` as a whole; the main loop reads it. An object that outlives the session asks the
    page for the present binding each time (`Page.viewer`).

    `modes`: number of modes that can be in use; `open_other`: function that opens another session in place of this one
    as soon as that is ready; `before`: Choices of the session that was shown before, or None; `wake`: function that
    makes the main loop update the page at once; `call`: runs a function on viser's event loop. `row`: the word for a
    row of the measurement: "mode", or "row" if there are several takes; `sent`: the last values that `send` has sent,
    by the identity of the control; `frame`: DisplayFrame of the page; `state`: what the page shows; `commands`:
    controls and their effects by name; `tabs`: Tabs of the session, once they are made.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        run: PreparedRun,
        modes: int,
        open_other: Callable[[OpenRequest], None] = lambda request: None,
        before: Choices | None = None,
        wake: Callable[[], None] = lambda: None,
        call: Callable[[Callable[[], object]], object] = lambda function: function(),
    ):
        self.gui, self.run, self.session, self.measurement = gui, run, run.session, run.measurement
        self.modes, self.open, self.call = modes, open_other, call
        self.row, self.frame = row_word(run.measurement), DisplayFrame(run)
        self.choices, self._wake = initial_choices(run, modes, before), wake
        self.threads = Scheduler(wake)
        self.sent: dict[int, object] = {}
        self._followers: list[tuple[Any, str, Callable[[Choices], Any]]] = []  # control, property, and what it is
        self.folders: list[viser.GuiFolderHandle] = []  # that hold the controls
        self._removed = False
        self.commands: dict[str, tuple[Any, Callable[[Any, Any], None]]] = {}
        self.tabs: Any = None
        self.state = PageState(run.session.view, microphone=self.choices.microphone, run=run, choices=self.choices)

    def on(self, handle: Control, act: Callable[..., object], of_client: bool = False, command: str = "") -> Control:
        """Call `act(value)` when a client has changed a control, but not when this program has; return the control.

        `of_client`: whether `act(client, value)` is called instead; `command`: name of the control in `commands`.
        """

        def answer(client: Any, value: Any) -> None:
            self.session.yield_to_ui()
            try:
                act(*([client] if of_client else []), value)
            except RuntimeError:
                if not self._removed:
                    raise
            self._wake()

        async def respond(event) -> None:
            if event.client is not None:
                answer(event.client, event.target.value)

        control: Any = handle
        if command:
            self.commands[command] = control, answer
        (control.on_click if hasattr(control, "on_click") else control.on_update)(respond)
        return handle

    def carry_out(self, client: Any, command: str, text: str = "") -> None:
        """Do what the control of a command does if it gets the value in `text`; a checkbox is toggled.

        InputError if the control cannot have that value.
        """
        handle, answer = self.commands[command]
        options, value = getattr(handle, "options", None), getattr(handle, "value", None)
        if options is not None:
            require_choice(command, text, options)
            value = text
        elif isinstance(value, bool) and not hasattr(handle, "on_click"):
            value = not value
        elif hasattr(handle, "max"):
            value = whole(text, handle.min, handle.max)
        else:
            value = text
        if not hasattr(handle, "on_click"):
            self.sent[id(handle)] = handle.value = value
        answer(client, value)

    # Controls of viser, with their bounds and their effect. Value and visibility may be functions of the choices.

    def _control(
        self, add: Callable, label: str, *bounds, value, act, visible: Any = True, command: str = "", **options: Any
    ):
        now = self.choices
        first, seen = (one(now) if callable(one) else one for one in (value, visible))
        handle = add(label, *bounds, initial_value=first, visible=seen, **options)
        followed = {"value": value, "visible": visible}
        self._followers += [(handle, name, of) for name, of in followed.items() if callable(of)]
        return self.on(handle, act, command=command)

    def slider(self, label: str, low, high, step, value, act: Callable[[Any], object], **options: Any):
        return self._control(self.gui.add_slider, label, low, high, step, value=value, act=act, **options)

    def checkbox(self, label: str, value, act: Callable[[Any], object], **options: Any):
        return self._control(self.gui.add_checkbox, label, value=value, act=act, **options)

    def dropdown(self, label: str, names: tuple[str, ...], value, act: Callable[[Any], object], **options: Any):
        return self._control(self.gui.add_dropdown, label, names, value=value, act=act, **options)

    def button(self, label: str, act: Callable[[Any], object], command: str = "", **options: Any):
        return self.on(self.gui.add_button(label, **options), act, command=command)

    def follow(self, handle: Any, **properties: Callable[[Choices], Any]) -> None:
        """Let properties of a control be functions of the choices from now on."""
        for name, of in properties.items():
            setattr(handle, name, of(self.choices))
            self._followers.append((handle, name, of))

    def choose(self, **changes) -> None:
        """Change some of the choices, and let the controls follow."""
        self.choices = replace(self.choices, **changes)
        for handle, name, of in self._followers:
            wanted = of(self.choices)
            if getattr(handle, name) != wanted:
                setattr(handle, name, wanted)
        self._wake()

    def remove(self) -> None:
        """Remove all controls; another session takes the place of this one."""
        self._removed = True
        for folder in self.folders:
            folder.remove()

    @property
    def positions(self) -> Reals:
        """The positions of the newest state as the page draws them : (N, D) float64, metres."""
        return self.frame.positions(self.session.view.state.positions)

    def place(self, microphone: int, place, gesture: int | None = None) -> None:
        """Move the estimate of a microphone to a place on the page, (2,) or (3,), metres."""
        place = self.frame.placed(self.session.view.state.positions, microphone, place)
        self.session.place(microphone, place, gesture)

    def send(self, handle, value) -> None:
        """Set the value of a control if it differs from the one sent last.

        A caller that enters the user's own value in `sent` keeps this from pulling back a slider that is being dragged.
        """
        if id(handle) not in self.sent or self.sent[id(handle)] != value:
            self.sent[id(handle)] = value
            handle.value = value
