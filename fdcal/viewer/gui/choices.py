"""The choices made on the page, apart from those that belong to the session; they are saved with a session."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from ...cost.expansion import ORDER_OFFSET
from ...model.measurement import Measurement
from ...model.validation import InputError
from ...session.lesson import MAX_ORDER_OFFSET
from ..background.cost_map import MapStyle
from ..background.prepare import PreparedRun


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

    def with_moved(self, microphone: int, place) -> PlanChoices:
        """Return the choices with a microphone at another place, (2,), metres."""
        others = tuple(move for move in self.moved if move[0] != microphone)
        return replace(self, moved=(*others, (int(microphone), float(place[0]), float(place[1]))))

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
MAX_RATE = 60  # steps per second at the end of the slider, which stands for no limit
WATCHED_MOVES = 20  # steps per second that can be followed, of single microphones
WATCHED_RATE = 5  # steps per second that can be followed, of a solver whose steps move all microphones
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
    export_kind: str = PICTURE  # kind of file to save, a key of `exports.KINDS`
    export_view: str = "top"  # view of a picture to save, a value of VIEWS
    export_size: tuple[int, int] = (1280, 800)  # of a picture to save, width and height in pixels
    seed: int = 0  # of the solver's next start
    rate: int | None = None  # steps per second that the user has chosen; None before that
    cut: Line | None = None  # the line along which the cost is drawn; None for no line
    plan: PlanChoices = field(default_factory=PlanChoices)
    take: int | None = None  # whose rows and spectrum are shown; None for those of all takes

    def steps_per_second(self, moves_all: bool, watched: bool = False) -> int:
        """Return how many steps the solver takes per second, MAX_RATE for no limit.

        `moves_all`: whether a step of the solver moves all microphones, so that a run has few of them; `watched`:
        whether it is to be followed though its steps move single microphones.
        """
        return self.rate or (WATCHED_RATE if moves_all else WATCHED_MOVES if watched else MAX_RATE)

    @property
    def map_order(self) -> int | None:
        """What is added to ceil(k R) in the map; None for the solver's objective, which no volume shows."""
        return None if self.objective and not self.style.volume else self.order_offset

    def with_values(self, values: Mapping[str, Any]) -> Choices:
        """Return the choices with some values changed, by the names of the fields of Choices and of MapStyle."""
        style = {key: value for key, value in values.items() if hasattr(self.style, key)}
        own = {key: value for key, value in values.items() if key not in style}
        return replace(self, style=replace(self.style, **style), **own)

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
        choices = replace(choices, style=_style_elsewhere(before, measurement), **kept)
    wanted, takes = run.opening.choices.items(), set(measurement.takes.tolist())
    choices = choices.with_values({key: _checked(key, value, measurement.count, modes, takes) for key, value in wanted})
    if choices.style.volume and not has_volume(measurement):  # a file of an array in a plane
        choices = replace(choices, style=replace(choices.style, volume=False))
    return choices


def _style_elsewhere(before: Choices, measurement: Measurement) -> MapStyle:
    """Return the style of the session before, without what the new measurement may not have."""
    volume = (before.style.volume or before.style.basins) and has_volume(measurement)
    return replace(before.style, shape=False, volume=volume, slice_position=None)


def has_volume(measurement: Measurement) -> bool:
    """Return whether the cost of one microphone can be shown in space."""
    return measurement.array_dimension == 3 and measurement.search is not None


def _checked(key: str, value: Any, count: int, modes: int, takes: set[int]) -> Any:
    """Return a value of a request's choices, which may come from a file."""
    number = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    whole = number and isinstance(value, int)
    if key in SWITCHES and isinstance(value, bool):
        return value
    if key in ("modes", "slice_position", "take") and value is None:
        return None
    if key in BOUNDS and number and BOUNDS[key][0] <= value <= BOUNDS[key][1]:
        return float(value)
    if (key == "microphone" and whole and 0 <= value < count) or (key == "take" and whole and value in takes):
        return value
    if key == "order_offset" and whole and 0 <= value <= MAX_ORDER_OFFSET:
        return value
    if (key == "ellipse_scale" and whole and value in ELLIPSE_SCALES.values()) or (
        key == "slice_axis" and value in SLICES.values()
    ):
        return value
    if key == "modes" and isinstance(value, (list, tuple)) and value:
        if all(isinstance(mode, int) and 1 <= mode <= modes for mode in value):
            return tuple(sorted(set(value)))
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


def kinds_of(measurement: Measurement) -> tuple[str, ...]:
    """Return those of MAP_KINDS that there can be of a measurement."""
    return tuple(kind for kind in MAP_KINDS if kind != VOLUME or has_volume(measurement))


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


def style_of(kind: str, measurement: Measurement) -> dict[str, bool]:
    """Return the fields of a MapStyle that make a map one of `kinds_of`.

    The basins of an array in space are those of descent in three dimensions, on a slice.
    """
    return {
        "relief": kind == RELIEF,
        "shape": kind == SHAPE,
        "basins": kind == BASINS,
        "volume": kind == VOLUME or (kind == BASINS and has_volume(measurement)),
    }
