"""Binds the controls of the panels to a session: callbacks from the browser, and what a tick shows.

A control, its bounds and its effect are declared together: `binding.on(gui.add_slider("SNR (dB)", 1, 60, 1, 30), act)`.
A value that the control cannot have never arrives; `server.hardening` drops it. Callbacks are `async`, so that viser
runs them in order on its own event loop. None of them blocks. viser sends a property only where it differs from what
the browsers have; so a tab assigns all that it shows at each tick.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import viser

from ...graphics.picture import row_word
from ...graphics.primitives import Picture
from ...model.types import Reals
from ...session.calibration_run import Assessment
from ...session.history import SessionView
from ...session.request import OpenRequest
from ..background.comparison import RunSummary
from ..background.cost_map import CostMap
from ..background.prepare import PreparedRun
from ..background.threads import Threads
from ..background.verdict import PositionUncertainty
from ..display_frame import DisplayFrame
from .choices import Choices, initial_choices

Control = TypeVar("Control")


@dataclass(frozen=True)
class Tick:
    """What the main loop shows at one moment."""

    view: SessionView
    now: float = 0.0  # s
    revision: int = 0  # counts the states that were shown
    microphone: int = 0  # whose map is shown, counted from 0
    drawn: CostMap | None = None  # the map on the floor or in space
    reason: str = ""  # why there is no map, "" where it is only not ready
    picture: Picture | None = None  # on the screen
    fault: str = ""  # an exception of the page, as text
    note: str = ""  # on work in the background
    found: Assessment | None = None  # of the state, once the solver has finished
    uncertainty: PositionUncertainty | None = None  # likewise
    assessing: bool = False  # whether there will be one
    runs: tuple[RunSummary, ...] = ()  # of a race
    sought: np.ndarray | None = None  # numbers of the microphones whose errors count; those of the run unless given


@dataclass(frozen=True, eq=False)
class Same:
    """An object in a key: equal to the same object alone, which it holds, for an id is given again to another one."""

    value: object

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and other.value is self.value

    def __hash__(self) -> int:
        return id(self.value)


def bind(handle: Control, act: Callable[[Any], object]) -> Control:
    """Call `act(value)` when a client, and not this program, has changed a control; return the control."""

    async def respond(event) -> None:
        if event.client is not None:
            act(event.target.value)

    control: Any = handle
    (control.on_click if hasattr(control, "on_click") else control.on_update)(respond)
    return handle


class Tab:
    """A tab of one session, which creates its controls in `__init__`."""

    def refresh(self) -> None:
        """Let what depends on choices and values of controls follow them, after a program has set them."""

    def show(self, tick: Tick) -> None:
        """Bring the tab up to date; called by the main loop."""


class Binding:
    """The session that is shown, the choices made for it, its threads, and the values sent to its controls.

    The callbacks replace `choices` as a whole; the main loop reads it. An object that outlives the session asks the
    page for the present binding each time (`Page.binding`).

    `modes`: number of modes that can be in use; `open_other`: function that opens another session in place of this one
    as soon as that is ready; `before`: Choices of the session that was shown before, or None; `wake`: function that
    makes the main loop update the page at once; `call`: runs a function on viser's event loop. `row`: what the page
    calls a row of the measurement: "mode", or "row" where there are several takes; `sent`: the values that `send` has
    sent last, by the identity of the control; `frame`: in which the page draws.
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
        self.modes, self.weights, self.open, self.call = modes, run.scene.solver.weights, open_other, call
        self.row, self.frame = row_word(run.measurement), DisplayFrame(run)
        self.choices, self._wake = initial_choices(run, modes, before), wake
        self.threads = Threads(wake)
        self.sent: dict[int, object] = {}
        self.closed = False  # the session is being replaced

    def on(self, handle: Control, act: Callable[[Any], object]) -> Control:
        """Call `act(value)` when a client, and not this program, has changed a control; return the control."""

        def respond(value) -> None:
            self.session.yield_to_ui()
            try:
                act(value)
            except RuntimeError:
                if not self.closed:  # else the session has given way to another one, with all of its controls
                    raise

        return bind(handle, respond)

    def on_client(self, handle: Control, act: Callable[[viser.ClientHandle, Any], object]) -> Control:
        """Call `act(client, value)` when a client has pressed a button; return the button."""
        button: Any = handle

        @button.on_click
        async def _(event) -> None:
            if event.client is not None:
                act(event.client, event.target.value)

        return handle

    def choose(self, **changes) -> None:
        """Change some of the choices."""
        self.choices = replace(self.choices, **changes)
        self._wake()

    @property
    def positions(self) -> Reals:
        """The positions of the newest state as the page draws them : (N, D) float64, metres."""
        return self.frame.positions(self.session.view.state.positions)

    def place(self, microphone: int, place, gesture: int | None = None) -> None:
        """Move a microphone to a place on the page, (2,) or (3,), metres: its estimate, or that of the plan shown."""
        if self.choices.plan.shown:
            self.choose(plan=self.choices.plan.with_moved(microphone, place))
        else:
            place = self.frame.placed(self.session.view.state.positions, microphone, place)
            self.session.place(microphone, place, gesture)

    def choose_style(self, **changes) -> None:
        """Change the style of the maps and of the page."""
        self.choose(style=replace(self.choices.style, **changes))

    def send(self, handle, value) -> None:
        """Set the value of a control where it differs from the one sent last.

        A slider that the user is dragging is therefore not pulled back by the main loop.
        """
        if id(handle) not in self.sent or self.sent[id(handle)] != value:
            self.sent[id(handle)] = value
            handle.value = value

    def keep(self, handle, value) -> None:
        """Count a value as sent: the user has set it, who may still be dragging the slider."""
        self.sent[id(handle)] = value
