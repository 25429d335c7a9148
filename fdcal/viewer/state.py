"""The state of the page, and the controls that change it.

`PageState` is what the page shows, and `Choices` is what its users have chosen. Both are frozen: events replace them. A
session file contains the choices in `Choices.to_save`.

`Binding` creates the controls of a session. A control, its bounds and its effect are declared together:
`binding.slider("SNR (dB)", 1, 60, 1, 30, act)`. With `command="snr"` the bar of the layout Explore and the keys have
the same effect under that name (`Binding.carry_out`). `server.hardening` drops values that a control cannot have.
Callbacks are `async`, so that viser runs them in order on its own event loop. None of them blocks. viser sends a
property only if it differs from what the browsers have.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partialmethod
from typing import Annotated, Any, TypeVar

import numpy as np
import viser

from ..cost.eq7 import ORDER_OFFSET
from ..graphics.picture import z_range_of
from ..model.address import Map
from ..model.validation import InputError, convert, require_choice, within
from ..session.calibration_run import Assessment
from ..session.lesson import MAX_ORDER_OFFSET
from ..session.session import SessionView
from ..session.sources import OpenRequest
from ..session.worker import Memo, Scheduler
from .cost_maps import CostMap, CostMapRequest, MapStyle, map_modes
from .html import of_browsers, whole
from .prepare import DisplayFrame, PreparedRun

PICTURE = "Picture (PNG)"  # the first kind of file to save
VIEWS = {"Top": "top", "3-D": "close", "Room": "3d"}  # label to view of a camera

# Choices that stay when another scene is opened.
KEPT = "log minima trails ellipses lecture export_kind export_view export_size rate themed dark".split()


@dataclass(frozen=True)
class Choices(MapStyle):
    """The choices of the page's users; the modes in use and the positions are in the states of the session."""

    microphone: int = 0  # microphone whose map is shown, counted from 0
    follow: bool = True  # whether the map is that of the microphone that the solver moves next
    modes: tuple[int, ...] | None = None  # modes of the map, counted from 1; None for those that the solver uses
    # number added to ceil(k R) for the order of each mode of the map; initially as for the cost in the status lines
    order_offset: int = ORDER_OFFSET
    objective: bool = True  # whether the map shows what the method minimises; otherwise it shows Eq. 7
    dark: bool = False  # whether the page has a dark background
    trails: bool = False  # whether the path of each estimate is drawn
    ellipses: bool = False  # whether the error ellipses are drawn
    lecture: bool = False  # whether text and marks are large enough for a projector
    themed: bool = False  # whether a user or a file has chosen dark or light; otherwise the page follows the browser
    descending: bool = False  # whether modes are added to the map from the highest down
    modes_error: str = ""  # why the text in the field "Frequency numbers" was refused, "" if it was not
    export_kind: str = PICTURE  # kind of file to save, a key of `tabs.view.KINDS`
    export_view: str = "top"  # view of a picture to save, a value of VIEWS
    export_size: tuple[int, int] = (1280, 800)  # width and height of a picture to save, pixels
    seed: int = 0  # seed of the solver's next start
    rate: int | None = None  # steps per second that the user has chosen; None before that
    # verdict: whether the result is assessed; panel, marks: see `fdcal.session.lesson.LessonSetting`
    verdict: bool = True
    panel: str = "none"
    marks: tuple[int, ...] = ()

    @property
    def map_order(self) -> int | None:
        """The number that is added to ceil(k R) in the map; None for the cost of the method, which has no volume."""
        return None if self.objective and not self.volume else self.order_offset

    def map_request(
        self, run: PreparedRun, view: SessionView, microphone: int, revision: int = 0, follow: bool = False
    ) -> CostMapRequest:
        """Return the request for the map of a microphone, counted from 0, in the state that is shown.

        `revision`: number of the state on the screen; `follow`: whether a map of another microphone may be shown
        instead.
        """
        state, order = view.state, self.map_order
        if self.in_space:  # in space the map is the layer of the estimate, or the nearest in the domain
            low, high = z_range_of(None, run.measurement)
            positions = np.array(state.positions)
            positions[microphone, 2] = np.clip(positions[microphone, 2], low, high)
            state = replace(state, positions=positions)
        modes, custom = map_modes(run, state, self.modes, order), self.modes is not None
        style = MapStyle(self.kind, self.log, self.minima, self.in_space)
        return CostMapRequest(revision, microphone, modes, order, custom, style, follow, state, view.lineage)

    def to_save(self) -> dict[str, Any]:
        """Return the values that an OpenRequest needs to restore these choices."""
        return {key: getattr(self, key) for key in ("kind", "microphone", "modes", "order_offset", *SWITCHES)}


SWITCHES = "log minima follow objective dark trails ellipses descending".split()  # saved choices, true or false


def initial_choices(run: PreparedRun, modes: int, before: Choices | None) -> Choices:
    """Return the choices of a new session: those of its request, and the style of the previous session.

    `modes`: number of modes that can be in use; `before`: choices of the session that was shown before, or None.
    InputError if the `choices` of the request, which may come from a file, have an unknown key or value.
    """
    measurement = run.measurement
    free = [n for n in range(measurement.count) if n not in measurement.known]
    offset = ORDER_OFFSET if run.reference_cost is None else run.reference_cost.order_offset
    themed, seed = "dark" in run.opening.choices, run.session.view.state.seed
    choices = Choices(microphone=free[0] if free else 0, order_offset=offset, seed=seed, themed=themed)
    if before is not None:
        kind = "flat" if before.kind in ("shape", "none") else before.kind
        choices = replace(choices, kind=kind, **{name: getattr(before, name) for name in KEPT})
    kinds: dict[str, Any] = {name: bool for name in SWITCHES} | {
        "kind": Map,
        "microphone": Annotated[int, within(0, measurement.count - 1)],
        "order_offset": Annotated[int, within(0, MAX_ORDER_OFFSET)],
        "modes": list[Annotated[int, within(1, modes)]],
    }
    values = {}
    for key, value in run.opening.choices.items():
        if key not in kinds:
            raise InputError(f"choices.{key} is unknown", f"use {', '.join(kinds)}", key=f"choices.{key}")
        values[key] = None if key == "modes" and not value else convert(value, kinds[key], f"choices.{key}")
    if values.get("modes"):
        values["modes"] = tuple(sorted(set(values["modes"])))
    in_space = measurement.array_dimension == 3 and measurement.search is not None
    choices = replace(choices, **(values | {"in_space": in_space, "themed": themed or choices.themed}))
    return replace(choices, kind="flat") if choices.kind == "volume" and not choices.in_space else choices


@dataclass(frozen=True)
class PageState:
    """What the page shows; all of its views are functions of this state."""

    view: SessionView  # the states of the run; the one that is shown is in the frame of the page
    now: float = 0.0  # time, s
    revision: int = 0  # number of the state on the screen: it counts the states that were shown
    microphone: int = 0  # microphone whose map is shown, counted from 0
    drawn: CostMap | None = None  # the map on the floor or in space
    reason: str = ""  # why there is no map; "" if the map is not ready yet
    picture: Any = None  # Picture, on the screen
    fault: str = ""  # an exception of the page, as text
    found: Assessment | None = None  # assessment of the state, once the solver has finished
    # (N, D, D) float64, metres, half axes of the 95 % ellipses in rows, the longest last; None where `found` has none
    axes: np.ndarray | None = None
    assessing: bool = False  # whether an assessment is expected
    sought: np.ndarray | None = None  # numbers of the microphones whose errors are averaged; None: as in the run
    run: Any = None  # PreparedRun; like `choices`, None in tests of views that do not need it
    choices: Any = None

    @property
    def counted(self) -> np.ndarray:
        """Numbers of the microphones whose errors are averaged; these also align an array without known ones."""
        return self.run.sought if self.sought is None else self.sought


RUN_BAR = "run bar"  # used like the name of a tab, for the controls above all tabs


class Tab:
    """A part of a tab of one session. It creates its controls in `__init__`, and `show` brings them up to date.

    `part`: its name in `Tabs`; `where`: name of the tab; `order`: rank among the parts of all tabs, since a part may
    use those created before it; `interval`: least time between two updates, s; `plots`: plots of the part, which may
    still have data to send.
    """

    part, where, order = "", "", 10
    interval = 0.0
    plots: tuple = ()
    _updated = -math.inf

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
            plot.send_waiting()
        inputs, memo = self.inputs(state), vars(self).setdefault("_memo", Memo())
        if state.now - self._updated >= self.interval and memo.get(*inputs) is None:
            self._updated = state.now
            self.show(state)
            memo.keep(True, *inputs)


Buttons = viser.GuiButtonHandle | viser.GuiButtonGroupHandle
Control = TypeVar("Control", bound=viser.GuiInputHandle | Buttons)


class Binding:
    """The session that is shown, the choices made for it, its threads, and the values sent to its controls.

    The callbacks replace `choices` as a whole; the main loop reads it. An object that outlives the session asks the
    page for the present binding each time (`Page.viewer`).

    `modes`: number of modes that can be in use; `open_other`: function that opens another session in place of this one
    as soon as that is ready; `before`: Choices of the session that was shown before, or None; `wake`: function that
    makes the main loop update the page at once; `call`: runs a function on viser's event loop. `sent`: for the identity
    of each control, the value that `send` has sent last; `frame`: DisplayFrame of the page; `state`: what the page
    shows; `commands`: controls and their effects by name; `tabs`: Tabs of the session, once they are made.
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
        self.frame = DisplayFrame(run)
        self.choices, self._wake = initial_choices(run, modes, before), wake
        self.threads = Scheduler(wake)
        self.sent: dict[int, object] = {}
        self._followers: list[tuple[Any, str, Callable[[Choices], Any]]] = []  # control, property, function of choices
        self.folders: list[viser.GuiFolderHandle] = []  # the folders that hold the controls
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

        if command:
            self.commands[command] = handle, answer
        respond = of_browsers(lambda event: answer(event.client, event.target.value))
        if isinstance(handle, Buttons):
            handle.on_click(respond)
        else:
            handle.on_update(respond)
        return handle

    def carry_out(self, client: Any, command: str, text: str = "") -> None:
        """Act as if a user had set the control of a command to the value in `text`; a checkbox is toggled.

        "+1" and "-1" stand for the next and the previous value; an unknown command does nothing. InputError if the
        control cannot have that value.
        """
        if command not in self.commands:
            return
        handle, answer = self.commands[command]
        options, value = getattr(handle, "options", None), getattr(handle, "value", None)
        pressed, shift = isinstance(handle, Buttons), int(text) if text in ("+1", "-1") else 0
        if options is not None:
            value = options[(options.index(handle.value) + shift) % len(options)] if shift else text
            require_choice(command, value, options)
        elif isinstance(value, bool) and not pressed:
            value = not value
        elif hasattr(handle, "max"):
            value = whole(str(handle.value + shift) if shift else text, handle.min, handle.max)
        else:
            value = text
        if not pressed:
            self.sent[id(handle)] = handle.value = value
        answer(client, value)

    # Controls of viser, with their bounds and effects. A value or a visibility may be a function of the choices.

    def _control(self, kind: str, label: str, *given, visible: Any = True, command: str = "", **options: Any) -> Any:
        (*bounds, value, act), now = given, self.choices
        first, seen = (one(now) if callable(one) else one for one in (value, visible))
        handle = getattr(self.gui, f"add_{kind}")(label, *bounds, initial_value=first, visible=seen, **options)
        self.follow(handle, **{name: of for name, of in (("value", value), ("visible", visible)) if callable(of)})
        return self.on(handle, act, command=command)

    slider = partialmethod(_control, "slider")  # label, lowest, highest, step, value, effect
    checkbox = partialmethod(_control, "checkbox")  # label, value, effect
    dropdown = partialmethod(_control, "dropdown")  # label, names, value, effect

    def choice(self, label: str, key: str, values: dict[str, Any] | None = None, **options: Any):
        """Add a control of one of the choices: a list of `values` by their names, or a checkbox for True and False."""
        if values is None:
            return self.checkbox(label, lambda of: getattr(of, key), lambda on: self.choose(**{key: on}), **options)
        names = {value: name for name, value in values.items()}
        act = lambda name: self.choose(**{key: values[name]})  # noqa: E731
        return self.dropdown(label, tuple(values), lambda of: names[getattr(of, key)], act, **options)

    def follow(self, handle: Any, **properties: Callable[[Choices], Any]) -> None:
        """Let properties of a control follow the choices from now on."""
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
        """Remove all controls, because another session replaces this one."""
        self._removed = True
        for folder in self.folders:
            folder.remove()

    def place(self, microphone: int, place, gesture: int | None = None) -> None:
        """Move the estimate of a microphone to a position on the page, (2,) or (3,), metres."""
        place = self.frame.placed(self.session.view.state.positions, microphone, place)
        self.session.place(microphone, place, gesture)

    def send(self, handle, value) -> None:
        """Set the value of a control if it differs from the one sent last.

        A caller may enter a value of the user in `sent`; then a slider that is being dragged is not moved back.
        """
        if id(handle) not in self.sent or self.sent[id(handle)] != value:
            self.sent[id(handle)] = value
            handle.value = value
