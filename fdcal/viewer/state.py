"""The state of the page: a frozen `PageState`, and the frozen `Choices` of its users, which events replace.

A session file holds the choices of `Choices.to_save`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from ..cost.eq7 import ORDER_OFFSET
from ..graphics.picture import z_range_of
from ..model.measurement import Measurement
from ..model.validation import InputError
from ..session.calibration_run import Assessment
from ..session.lesson import MAX_ORDER_OFFSET
from ..session.session import SessionView
from .cost_maps import MAP_KINDS, CostMap, CostMapRequest, MapStyle, map_modes
from .prepare import PreparedRun

PICTURE = "Picture (PNG)"  # the first kind of file to save
VIEWS = {"Top": "top", "3-D": "close", "Room": "3d"}  # label to view of a camera

# Choices that another scene keeps.
KEPT = "trails ellipses lecture export_kind export_view export_size rate themed dark".split()


@dataclass(frozen=True)
class Choices(MapStyle):
    """The choices of the page's users; the modes in use and the positions are in the states of the session."""

    microphone: int = 0  # whose map is shown, counted from 0
    follow: bool = True  # whether the map is that of the microphone which the last step moved
    modes: tuple[int, ...] | None = None  # of the map, counted from 1; None for those that the solver uses
    # added to ceil(k R) in the order of every mode of the map; at first as for the cost in the status
    order_offset: int = ORDER_OFFSET
    objective: bool = True  # whether the map shows what the method minimises; otherwise it shows Eq. 7
    dark: bool = False  # whether the page has a dark background
    trails: bool = False  # whether the path of each estimate is drawn
    ellipses: bool = False  # whether the error ellipses are drawn
    lecture: bool = False  # whether text and marks are large enough for a projector
    themed: bool = False  # whether a user has chosen dark or light; otherwise the page follows the browser
    descending: bool = False  # whether modes are added to the map from the highest down
    modes_error: str = ""  # why the text in the field "Mode numbers" was refused, "" if it was not
    export_kind: str = PICTURE  # kind of file to save, a key of `tabs.view.KINDS`
    export_view: str = "top"  # view of a picture to save, a value of VIEWS
    export_size: tuple[int, int] = (1280, 800)  # of a picture to save, width and height in pixels
    seed: int = 0  # of the solver's next start
    rate: int | None = None  # steps per second that the user has chosen; None before that
    # verdict: whether the result is assessed; panel, marks: as of `fdcal.session.lesson.LessonSetting`
    verdict: bool = True
    panel: str = "none"
    marks: tuple[int, ...] = ()

    @property
    def style(self) -> MapStyle:
        """How a map is drawn."""
        return MapStyle(**{one.name: getattr(self, one.name) for one in fields(MapStyle)})

    @property
    def map_order(self) -> int | None:
        """The number that is added to ceil(k R) in the map; None for the cost of the method, which has no volume."""
        return None if self.objective and not self.volume else self.order_offset

    def map_request(
        self, run: PreparedRun, view: SessionView, microphone: int, revision: int = 0, follow: bool = False
    ) -> CostMapRequest:
        """Return the request for the map of a microphone, counted from 0, in the state that is shown.

        `revision`: counts the states on the screen; `follow`: whether the map of any microphone will do.
        """
        state, order = view.state, self.map_order
        if has_volume(run.measurement):  # in space the map is the layer of the estimate, or the nearest in the domain
            low, high = z_range_of(None, run.measurement)
            positions = np.array(state.positions)
            positions[microphone, 2] = np.clip(positions[microphone, 2], low, high)
            state = replace(state, positions=positions)
        modes, custom = map_modes(run, state, self.modes, order), self.modes is not None
        return CostMapRequest(revision, microphone, modes, order, custom, self.style, follow, state, view.lineage)

    def to_save(self) -> dict[str, Any]:
        """Return the values that an OpenRequest needs to restore these choices."""
        return {key: getattr(self, key) for key in ("kind", "microphone", "modes", "order_offset", *SWITCHES)}


# Those that are saved and are true or false.
SWITCHES = tuple(
    one.name
    for one in fields(Choices)
    if one.type == "bool" and one.name not in ("in_space", "lecture", "themed", "verdict")
)


def initial_choices(run: PreparedRun, modes: int, before: Choices | None) -> Choices:
    """Return the choices of a new session: those of its request, and the style of the page before.

    `modes`: number of modes that can be in use; `before`: choices of the session that was shown before, or None.
    InputError if the `choices` of the request have an unknown key or value.
    """
    measurement = run.measurement
    free = [n for n in range(measurement.count) if n not in measurement.known]
    offset = ORDER_OFFSET if run.reference_cost is None else run.reference_cost.order_offset
    themed, seed = "dark" in run.opening.choices, run.session.view.state.seed
    choices = Choices(microphone=free[0] if free else 0, order_offset=offset, seed=seed, themed=themed)
    if before is not None:
        kind = "flat" if before.kind in ("shape", "none") else before.kind
        kept = {name: getattr(before, name) for name in KEPT} | vars(before.style) | {"kind": kind}
        choices = replace(choices, **kept)
    values = {key: _checked(key, value, measurement.count, modes) for key, value in run.opening.choices.items()}
    choices = replace(choices, **(values | {"in_space": has_volume(measurement)}))
    return replace(choices, kind="flat") if choices.kind == "volume" and not choices.in_space else choices


def has_volume(measurement: Measurement) -> bool:
    """Return whether the cost of one microphone can be shown in space."""
    return measurement.array_dimension == 3 and measurement.search is not None


def _checked(key: str, value: Any, count: int, modes: int) -> Any:
    """Return a value of a request's choices, which may come from a file."""
    whole = value if isinstance(value, int) and not isinstance(value, bool) else -1
    numbers = list(value) if isinstance(value, (list, tuple)) else []
    possible = {name: isinstance(value, bool) for name in SWITCHES}
    possible |= {
        "kind": value in MAP_KINDS,
        "microphone": 0 <= whole < count,
        "order_offset": 0 <= whole <= MAX_ORDER_OFFSET,
        "modes": value is None or (bool(numbers) and all(isinstance(n, int) and 1 <= n <= modes for n in numbers)),
    }
    if possible.get(key):
        return tuple(sorted(set(numbers))) if numbers else value
    raise InputError(
        f"choices.{key} = {value!r} is not possible",
        f"use kind ({', '.join(MAP_KINDS)}), microphone (0 to {count - 1}), modes (from 1 to {modes}),"
        f" order_offset (0 to {MAX_ORDER_OFFSET}) or, true or false, {', '.join(SWITCHES)}",
        key=f"choices.{key}",
        value=value,
    )


@dataclass(frozen=True)
class PageState:
    """What the page shows; all of its views are functions of this state."""

    view: SessionView  # the states of the run; the one that is shown is in the frame of the page
    now: float = 0.0  # s
    revision: int = 0  # counts the states that were shown
    microphone: int = 0  # whose map is shown, counted from 0
    drawn: CostMap | None = None  # the map on the floor or in space
    reason: str = ""  # why there is no map; "" if it is only not ready
    picture: Any = None  # Picture, on the screen
    fault: str = ""  # an exception of the page, as text
    found: Assessment | None = None  # of the state, once the solver has finished
    # (N, D, D) float64, metres, half axes of the 95 % ellipses in rows, the longest last; None where `found` has none
    axes: np.ndarray | None = None
    assessing: bool = False  # whether an assessment is expected
    sought: np.ndarray | None = None  # numbers of the microphones whose errors are averaged; None: as in the run
    run: Any = None  # PreparedRun; like `choices`, None in tests of views that do not need it
    choices: Any = None

    @property
    def map_request(self) -> CostMapRequest:
        """The request for the map that the choices ask for."""
        return self.choices.map_request(self.run, self.view, self.microphone)

    @property
    def counted(self) -> np.ndarray:
        """Numbers of the microphones whose errors are averaged and that align a blind array with the truth."""
        return self.run.sought if self.sought is None else self.sought
