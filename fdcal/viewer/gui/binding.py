"""The choices made on the page, what a tick shows, and the controls of the panels, bound to a session.

The choices, apart from those that belong to the session, are saved with it.

A control, its bounds and its effect are declared together: `binding.slider("SNR (dB)", 1, 60, 1, 30, act)`.
A value that the control cannot have never arrives; `server.hardening` drops it. Callbacks are `async`, so that viser
runs them in order on its own event loop. None of them blocks. viser sends a property only where it differs from what
the browsers have; so a tab assigns all that it shows at each tick.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np
import viser

from ...assessment.calibration import Channels
from ...cost.eq7 import ORDER_OFFSET
from ...graphics.picture import row_word
from ...graphics.primitives import Picture
from ...model.measurement import Measurement
from ...model.validation import InputError, Reals
from ...session.calibration_run import Assessment
from ...session.lesson import MAX_ORDER_OFFSET
from ...session.session import SessionView
from ...session.sources import OpenRequest
from ..cost_maps import CostMap, CostMapRequest, MapStyle, map_modes
from ..prepare import DisplayFrame, PreparedRun, Threads


@dataclass(frozen=True)
class PlanChoices:
    """What the controls of the tab show."""

    shown: bool = False  # whether the scene shows the planned array in place of the estimates
    snr_db: float = 30.0  # signal-to-noise ratio of each frequency, dB
    frequencies: int | None = None  # the lowest so many are in use; None for all that the array can interpolate
    known: tuple[int, ...] = ()  # numbers of the microphones whose positions are given
    gain_sigma_db: float = 0.0  # spread of the channels' gains, dB; 0 for equal channels
    moved: tuple[tuple[int, float, float], ...] = ()  # number, x and y, metres, of each microphone that was dragged
    takes: int = 1  # places of the source, recorded equally long from each

    def placed(self, positions) -> np.ndarray:
        """Return positions (N, D), metres, with the microphones that were dragged where they are now."""
        placed = np.array(positions, float)
        for microphone, x, y in self.moved:
            placed[microphone, :2] = x, y
        return placed


FLOOR, RELIEF, SHAPE, NOTHING = "Flat map", "Relief", "Mode shape (last mode)", "No map"  # kinds of map
BASINS = "Basins of attraction"
VOLUME = "Isosurfaces (3-D)"  # of an array in space
SLICES = {"None": "none", "x": "x", "y": "y", "z": "z"}  # label to axis across the slice through a volume
PICTURE = "Picture (PNG)"  # the first kind of file to save
ELLIPSE_SCALES = {"Automatic": 0, "True": 1, "10 times": 10, "100 times": 100, "1000 times": 1000}  # label to factor
VIEWS = {"Top": "top", "3-D": "close", "Room": "3d"}  # label to view of a camera

Line = tuple[tuple[float, float], tuple[float, float]]  # ends, metres
BOUNDS = {"opacity": (0.1, 1.0), "relief_height": (0.05, 1.0), "slice_position": (-math.inf, math.inf)}
# Choices that another scene keeps.
KEPT = ("trails", "ellipses", "ellipse_scale", "lecture", "export_kind", "export_view", "export_size", "rate", "themed")


@dataclass(frozen=True)
class Choices:
    """What the controls of the page show, apart from what belongs to the session."""

    microphone: int  # whose map is shown, counted from 0
    follow: bool = True  # whether the map is that of the microphone which the last step moved
    shown: bool = True  # whether a map is shown
    modes: tuple[int, ...] | None = None  # of the map, counted from 1; None for those that the solver uses
    # of the map, added to ceil(k R) in the order of every mode; that of the cost in the status at first
    order_offset: int = ORDER_OFFSET
    objective: bool = False  # whether the map shows what the solver minimises, in place of Eq. 7
    style: MapStyle = field(default_factory=MapStyle)
    trails: bool = False  # whether the path of each estimate is drawn
    ellipses: bool = False  # whether the error ellipses are drawn
    ellipse_scale: int = 0  # by which the error ellipses are enlarged; 0 for the factor that makes them visible
    lecture: bool = False  # whether the page is shown by a projector
    themed: bool = False  # whether a user has chosen a dark or a light page; else it follows the browser
    release: bool = False  # whether known microphones can be dragged
    modes_error: str = ""  # why the text in the field "Mode numbers" was refused, "" if it was not
    export_kind: str = PICTURE  # kind of file to save, a key of `tabs.view.KINDS`
    export_view: str = "top"  # view of a picture to save, a value of VIEWS
    export_size: tuple[int, int] = (1280, 800)  # of a picture to save, width and height in pixels
    seed: int = 0  # of the solver's next start
    rate: int | None = None  # steps per second that the user has chosen; None before that
    cut: Line | None = None  # the line along which the cost is drawn; None for no line
    plan: PlanChoices = field(default_factory=PlanChoices)
    take: int | None = None  # whose rows and spectrum are shown; None for those of all takes

    @property
    def map_order(self) -> int | None:
        """What is added to ceil(k R) in the map; None for the solver's objective, which no volume shows."""
        return None if self.objective and not self.style.volume else self.order_offset

    def map_request(
        self, run: PreparedRun, view: SessionView, microphone: int, revision: int = 0, follow: bool = False
    ) -> CostMapRequest:
        """Return the request for the map of a microphone, counted from 0, in the state that is shown.

        `revision`: counts the states on the screen; `follow`: whether the map of any microphone will do. Another
        opacity needs no other map.
        """
        state, order = view.state, self.map_order
        return CostMapRequest(
            revision, microphone, map_modes(run, state, self.modes, order, self.take), order, self.modes is not None,
            replace(self.style, opacity=1.0), follow, state, view.lineage, self.take,
        )  # fmt: skip

    def to_save(self) -> dict[str, Any]:
        """Return the values that an OpenRequest needs to restore these choices."""
        keys = ("microphone", "modes", "order_offset", "opacity", "relief_height", "slice_axis", "slice_position")
        keys += ("ellipse_scale", "take", *SWITCHES)
        return {key: getattr(self.style if hasattr(self.style, key) else self, key) for key in keys}


# Those that are saved and are true or false.
SWITCHES = tuple(
    one.name
    for one in (*fields(Choices), *fields(MapStyle))
    if one.type == "bool" and one.name not in ("lecture", "themed")
)


def initial_choices(run: PreparedRun, modes: int, before: Choices | None) -> Choices:
    """Return the choices of a session that opens: those of its request, and the appearance of the page before.

    `modes`: number of modes that can be in use; `before`: Choices of the session that was shown before, or None. Raises
    InputError: the request's `choices` hold an unknown key or value.
    """
    measurement = run.measurement
    free = [n for n in range(measurement.count) if n not in measurement.known]
    offset = ORDER_OFFSET if run.reference_cost is None else run.reference_cost.order_offset
    choices = Choices(microphone=free[0] if free else 0, order_offset=offset, seed=run.session.view.state.seed)
    choices = replace(choices, themed="dark" in run.opening.choices)
    if before is not None:
        kept = {name: getattr(before, name) for name in KEPT}
        volume = (before.style.volume or before.style.basins) and has_volume(measurement)
        style = replace(before.style, shape=False, volume=volume, slice_position=None)  # what any measurement may have
        choices = replace(choices, style=style, **kept)
    wanted, takes = run.opening.choices.items(), set(measurement.takes.tolist())
    values = {key: _checked(key, value, measurement.count, modes, takes) for key, value in wanted}
    of_style = {key: values.pop(key) for key in tuple(values) if hasattr(choices.style, key)}
    style = replace(choices.style, **of_style)
    if not has_volume(measurement):  # the request may be of a file of an array in a plane
        style = replace(style, volume=False)
    return replace(choices, style=style, **values)


def has_volume(measurement: Measurement) -> bool:
    """Return whether the cost of one microphone can be shown in space."""
    return measurement.array_dimension == 3 and measurement.search is not None


def _checked(key: str, value: Any, count: int, modes: int, takes: set[int]) -> Any:
    """Return a value of a request's choices, which may come from a file."""
    number = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    whole, x = number and isinstance(value, int), float(value) if number else math.nan
    numbers = list(value) if isinstance(value, (list, tuple)) else []
    possible = {name: isinstance(value, bool) for name in SWITCHES}
    possible |= {name: low <= x <= high for name, (low, high) in BOUNDS.items()}
    possible |= {
        "microphone": whole and 0 <= x < count,
        "take": value is None or (whole and value in takes),
        "order_offset": whole and 0 <= x <= MAX_ORDER_OFFSET,
        "ellipse_scale": whole and value in ELLIPSE_SCALES.values(),
        "slice_axis": value in SLICES.values(),
        "slice_position": value is None or number,
        "modes": value is None or (bool(numbers) and all(isinstance(n, int) and 1 <= n <= modes for n in numbers)),
    }
    if possible.get(key):
        return tuple(sorted(set(numbers))) if numbers else x if key in BOUNDS and number else value
    raise InputError(
        f"choices.{key} = {value!r} is not possible",
        f"use microphone (0 to {count - 1}), take (0 to {max(takes)}), modes (from 1 to {modes}),"
        f" order_offset (0 to {MAX_ORDER_OFFSET}),"
        f" opacity (0.1 to 1), relief_height (0.05 to 1), slice_axis ({', '.join(SLICES.values())}), slice_position"
        f" (metres), ellipse_scale ({', '.join(map(str, ELLIPSE_SCALES.values()))}) or, true or false,"
        f" {', '.join(SWITCHES)}",
        key=f"choices.{key}",
        value=value,
    )


MAP_KINDS = (FLOOR, RELIEF, SHAPE, BASINS, VOLUME, NOTHING)


def kind_of(choices: Choices) -> str:
    """Return which kind of map the choices ask for."""
    style = choices.style
    if not choices.shown:
        return NOTHING
    if style.basins:
        return BASINS
    if style.volume:
        return VOLUME
    return RELIEF if style.relief else SHAPE if style.shape else FLOOR


Control = TypeVar("Control")


@dataclass(frozen=True)
class PositionUncertainty:
    """Uncertainty of N positions."""

    axes: np.ndarray  # (N, D, D) float64, metres, half axes of the 95 % ellipses in rows, the longest last
    sigma: np.ndarray  # (N,) float64, metres, one standard deviation
    # verdict, text: the verdict and its message
    verdict: str = ""
    text: str = ""
    channels: Channels | None = None  # of a solver that finds the gains of the channels, or None


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
    sought: np.ndarray | None = None  # numbers of the microphones whose errors count; those of the run unless given


class Due:
    """Tells when something is to be brought up to date: what it shows has changed, and `interval`, s, has passed."""

    def __init__(self, interval: float = 0.0):
        self._interval, self._key, self._since = interval, None, -math.inf

    def __call__(self, now: float, *key) -> bool:
        """Whether it is due at the time `now`, s, to show `key`; then it counts as shown."""
        if key == self._key or now - self._since < self._interval:
            return False
        self._key, self._since = key, now
        return True


class Tab:
    """A tab of one session, which creates its controls in `__init__`."""

    def refresh(self) -> None:
        """Let what depends on choices and values of controls follow them, after a program has set them."""

    def show(self, tick: Tick) -> None:
        """Bring the tab up to date; called by the main loop."""


class Binding:
    """The session that is shown, the choices made for it, its threads, and the values sent to its controls.

    The callbacks replace `choices` as a whole; the main loop reads it. An object that outlives the session asks the
    page for the present binding each time (`Page.viewer`).

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
        self.modes, self.open, self.call = modes, open_other, call
        self.row, self.frame = row_word(run.measurement), DisplayFrame(run)
        self.choices, self._wake = initial_choices(run, modes, before), wake
        self.threads = Threads(wake)
        self.sent: dict[int, object] = {}
        self.closed = False  # the session is being replaced

    def on(self, handle: Control, act: Callable[..., object], of_client: bool = False) -> Control:
        """Call `act(value)` when a client, and not this program, has changed a control; return the control.

        `of_client`: whether `act(client, value)` is called instead.
        """

        async def respond(event) -> None:
            if event.client is None:
                return
            self.session.yield_to_ui()
            try:
                act(*([event.client] if of_client else []), event.target.value)
            except RuntimeError:
                if not self.closed:  # else the session has given way to another one, with all of its controls
                    raise

        control: Any = handle
        (control.on_click if hasattr(control, "on_click") else control.on_update)(respond)
        return handle

    # Controls of viser, with their bounds and their effect.

    def slider(self, label: str, low, high, step, value, act: Callable[[Any], object], **options: Any):
        return self.on(self.gui.add_slider(label, low, high, step, value, **options), act)

    def checkbox(self, label: str, value: bool, act: Callable[[Any], object], **options: Any):
        return self.on(self.gui.add_checkbox(label, value, **options), act)

    def dropdown(self, label: str, names: tuple[str, ...], value: str, act: Callable[[Any], object], **options: Any):
        return self.on(self.gui.add_dropdown(label, names, initial_value=value, **options), act)

    def button(self, label: str, act: Callable[[Any], object], **options: Any):
        return self.on(self.gui.add_button(label, **options), act)

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
            plan, moved = self.choices.plan, (int(microphone), float(place[0]), float(place[1]))
            others = tuple(move for move in plan.moved if move[0] != microphone)
            self.choose(plan=replace(plan, moved=(*others, moved)))
        else:
            place = self.frame.placed(self.session.view.state.positions, microphone, place)
            self.session.place(microphone, place, gesture)

    def choose_style(self, **changes) -> None:
        """Change the style of the maps and of the page."""
        self.choose(style=replace(self.choices.style, **changes))

    def send(self, handle, value) -> None:
        """Set the value of a control where it differs from the one sent last.

        Where what the user has set is put into `sent`, a slider that is being dragged is not pulled back.
        """
        if id(handle) not in self.sent or self.sent[id(handle)] != value:
            self.sent[id(handle)] = value
            handle.value = value
