"""The room and the source of a scene. Lengths are metres, frequencies hertz, speeds metres per second.

A measured room is an impulse response with directions of arrival, given by name or as a file. The response was measured
at one point; the field between the microphones is modelled, as `fdcal.acoustics.plane_waves` describes.
"""

from __future__ import annotations

import math
import typing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .validation import (
    LIMITS,
    Hertz,
    InputError,
    Metres,
    MetresPerSecond,
    Point,
    Seconds,
    StorageError,
    check,
    refusal,
    require_choice,
    require_point,
)

SUFFIX = ".mat"
UNKNOWN_WALLS = "unknown"  # room.walls of a measured room
MEASURED_AND_MODELLED = (
    "The impulse response is measured, at one point, with the direction of arrival of each sample. The field between"
    " the microphones is modelled: each sample is a plane wave from its direction. Walls and source are unknown."
)


def folder_of(name: str) -> Path:
    """Return a folder of files that come with fdcal: in the checkout, or inside an installed package."""
    beside = Path(__file__).parents[1] / name
    return beside if beside.is_dir() else Path(__file__).parents[2] / name


def response_names() -> list[str]:
    """Return the names of the responses that come with fdcal."""
    return sorted(path.stem for path in folder_of("rooms").glob(f"*{SUFFIX}"))


def response_path(text: str) -> Path:
    """Return the file of a response that is given by its name or its path; StorageError if it is missing."""
    path = Path(text) if text.lower().endswith(SUFFIX) else folder_of("rooms") / f"{text}{SUFFIX}"
    if not path.is_file():
        raise StorageError(f"cannot read {path}: No such file or directory")
    return path


WALLS = ("rigid", "pressure-release", "absorbing")


@dataclass(frozen=True)
class Room:
    """Walls and air. Give `size`, `outline` or `response`."""

    # lengths of a rectangle with a corner at the origin, metres. Three lengths make a box, whose field is
    # three-dimensional, has a closed form (`fdcal.acoustics.box_field`) and needs no cells
    size: tuple[Metres, ...] | None = None
    outline: tuple[Point, ...] | None = None  # corners of the floor in order, metres
    walls: str = ""  # one of WALLS, rigid unless given; UNKNOWN_WALLS of a measured room
    admittance: float = 0.0  # specific admittance rho c / Z of absorbing walls, dimensionless
    sound_speed: MetresPerSecond = 343.0  # c
    cell: Metres | None = None  # h, edge of one FDTD cell; 0.02 unless given. A box has none.
    # name or path of the response of a measured room (`fdcal.model.room`), whose field is of three dimensions.
    # In a scene file, `room = "NAME"` is short for a table with this key alone
    response: str | None = None

    @staticmethod
    def optional(table: dict[str, Any]) -> tuple[str, ...]:
        """Return the keys that a scene file may leave out."""
        if "response" in table:
            return "size", "outline", "admittance", "cell", "walls", "sound_speed"
        return "response", "size", "outline", "admittance", *(("cell",) if is_no_pair(table.get("size")) else ())

    def __post_init__(self):
        if self.response is not None:
            if not self.response.lower().endswith(SUFFIX) and self.response not in response_names():
                remedy = f"use {', '.join(response_names())} or the path of a {SUFFIX} file"
                raise refusal("room.response", self.response, "is unknown", remedy)
            for key in ("size", "outline", "cell", "walls", "admittance"):
                value = getattr(self, key)
                if value and value != UNKNOWN_WALLS:
                    problem = f"room.{key} = {value!r} has no meaning in a measured room, whose walls are unknown"
                    raise InputError(problem, "remove it", key=f"room.{key}", value=value)
            object.__setattr__(self, "walls", UNKNOWN_WALLS)
            check(self, "room.")
            return
        object.__setattr__(self, "walls", self.walls or "rigid")
        if self.dimension == 2:
            object.__setattr__(self, "cell", 0.02 if self.cell is None else self.cell)
        elif self.cell is not None:
            why = "has no meaning with a room.size of three lengths, whose field is known in closed form"
            raise refusal("room.cell", self.cell, why, "remove it", "m")
        if (self.size is None) == (self.outline is None):
            raise InputError("room needs either room.size or room.outline", "give exactly one", key="room.size")
        if self.size is not None:
            require_point("room.size", self.size, (2, 3))
        check(self, "room.")
        for corner in self.outline or ():
            require_point("room.outline", corner, (2,))
        if self.outline is not None and (len(self.outline) < 3 or self.area < self.cell_size**2):
            remedy = "give at least three corners [x, y], in order"
            raise InputError("room.outline encloses no area", remedy, key="room.outline", value=self.outline)
        cells = float(np.prod(np.abs(self.vertices).max(axis=0) / (self.cell or math.inf)))  # from the origin on
        if cells > LIMITS.cells:
            remedy = f"use a larger one ({LIMITS.cells:.0e} cells at most)"
            raise refusal("room.cell", self.cell, f"divides the room into {cells:.3g} cells", remedy, "m")
        require_choice("room.walls", self.walls, WALLS)
        if self.walls == "absorbing" and not (math.isfinite(self.admittance) and self.admittance > 0):
            remedy = 'give a number above zero (or set room.walls = "rigid")'
            raise refusal("room.admittance", self.admittance, "cannot describe absorbing walls", remedy)
        if self.walls != "absorbing" and self.admittance != 0:
            why = f'has no meaning with room.walls = "{self.walls}"'
            raise refusal("room.admittance", self.admittance, why, 'remove it or set room.walls = "absorbing"')

    @property
    def dimension(self) -> int:
        """Dimension of the sound field, 2 or 3."""
        return 3 if self.response is not None or is_triple(self.size) else 2

    @property
    def cell_size(self) -> float:
        """Edge h of one FDTD cell, metres; InputError for a box, which has no cells."""
        if self.cell is None:
            raise InputError(f"room.size = {list(self.size or ())} has three lengths", "simulate it in closed form")
        return self.cell

    @property
    def vertices(self) -> np.ndarray:
        """Corners of the outline, or of the floor of a box; none of a measured room : (V, 2) float64 array, metres."""
        if self.response is not None:
            return np.empty((0, 2))
        if self.outline is not None:
            return np.array(self.outline, dtype=float)
        width, depth = (self.size or (0.0, 0.0))[:2]
        return np.array([[0, 0], [width, 0], [width, depth], [0, depth]], dtype=float)

    @property
    def area(self) -> float:
        """Area of the outline, m^2 (shoelace formula)."""
        x, y = self.vertices.T
        return abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))) / 2


class Band(typing.NamedTuple):
    """Band of a simulated pulse and the rate that it is sampled with, Hz."""

    low: float
    high: float
    sample_rate: float


@dataclass(frozen=True)
class Source:
    """The source, outside the array: a zero-mean pulse of flat spectrum from `low` to `high`.

    With three coordinates it emits all frequencies equally: its field has a closed form, and only `duration` is used.
    It has one position, or several, one after the other: the recording from each position is a take.
    """

    position: Point | None = None  # its only position, metres; None if `positions` is given
    # low, high: band of the pulse, Hz; 20 and 3000 unless given. None with three coordinates
    low: Hertz | None = None
    high: Hertz | None = None
    sample_rate: Hertz | None = None  # fs; 28590 unless given. None with three coordinates
    duration: Seconds = 4.0  # of the recording of each take
    positions: tuple[Point, ...] = ()  # one for each take, metres; () if `position` is given

    DEFAULTS: typing.ClassVar = Band(low=20.0, high=3000.0, sample_rate=28590.0)

    @classmethod
    def optional(cls, table: dict[str, Any]) -> tuple[str, ...]:
        """Return the keys that a scene file may leave out."""
        places = table.get("positions")
        first = places[0] if isinstance(places, list) and places else table.get("position")
        other = "position" if "positions" in table else "positions"
        return other, *(cls.DEFAULTS._fields if is_no_pair(first) else ())

    def __post_init__(self):
        self._check_places()
        check(self, "source.")
        pulsed = self.dimension == 2
        for key, default in self.DEFAULTS._asdict().items():
            value = getattr(self, key)
            if not pulsed and value is not None:
                why = "has no meaning with a source of three coordinates, where no pulse is simulated"
                raise refusal(f"source.{key}", value, why, "remove it", "Hz")
            if pulsed:
                object.__setattr__(self, key, default if value is None else value)
        if pulsed and not self.band.low < self.band.high < self.band.sample_rate / 2:
            problem = f"source.low = {self.low:g} Hz and source.high = {self.high:g} Hz must be in ascending order and"
            problem += f" below half of source.sample_rate = {self.sample_rate:g} Hz"
            raise InputError(problem, "change one of the three", key="source.high", value=self.high)

    def _check_places(self):
        """Raise InputError unless there is one position, or a list of different ones with as many coordinates."""
        if self.position is None and not self.positions:
            remedy = "add it, or a list of source.positions, one for each take"
            raise InputError("source.position is missing", remedy, key="source.position")
        if self.position is not None:
            if self.positions:
                problem = "source.position and source.positions are both given"
                raise InputError(problem, "keep one of them", key="source.positions")
            require_point("source.position", self.position, (2, 3))
            return
        if len(self.positions) > LIMITS.takes:
            problem = f"source.positions has {len(self.positions)} positions"
            raise InputError(problem, f"use at most {LIMITS.takes}", key="source.positions")
        for number, (key, place) in enumerate(zip(self.keys, self.positions, strict=True)):
            require_point(key, place, (len(self.positions[0]),) if number else (2, 3))
            if place in self.positions[:number]:
                problem = f"{key} = {list(place)} m is given twice"
                raise InputError(problem, "move it: each take needs another position", key=key, value=place)

    @property
    def dimension(self) -> int:
        """Number of coordinates of its positions, 2 or 3."""
        return len(next(iter(self.places)))

    @property
    def places(self) -> tuple[Point, ...]:
        """All positions of the source, one for each take, metres."""
        return self.positions if self.position is None else (self.position,)

    @property
    def place(self) -> Point:
        """The only position of the source, metres; InputError if it has several."""
        if self.position is None and len(self.positions) != 1:
            problem = f"the source has {len(self.places)} positions, and one is simulated at a time"
            raise InputError(problem, "use Source.each()", key="source.positions")
        (place,) = self.places
        return place

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of its positions for messages: "source.position", or "source.positions[1]" and so on."""
        return tuple(f"source.positions[{i + 1}]" for i in range(len(self.positions))) or ("source.position",)

    def each(self) -> tuple[Source, ...]:
        """Return one source for each position, which has only this one."""
        return tuple(replace(self, position=place, positions=()) for place in self.places)

    def table(self) -> dict[str, Any]:
        """Return the values for the key of the cache, as a dictionary without empty `positions`."""
        return {key: value for key, value in asdict(self).items() if key != "positions" or value}

    @property
    def band(self) -> Band:
        """Band and sampling rate of the simulated pulse; InputError with three coordinates, which need no pulse."""
        if self.low is None or self.high is None or self.sample_rate is None:
            why = "has three coordinates, so that no pulse is simulated"
            remedy = "give two coordinates, in a room without height"
            raise refusal("source.position", list(self.places[0]), why, remedy)
        return Band(self.low, self.high, self.sample_rate)


def is_triple(values: Any) -> bool:
    """Return whether `values`, of any type, is a list of three entries."""
    return isinstance(values, (list, tuple)) and len(values) == 3


def is_no_pair(values: Any) -> bool:
    """Return whether a value of a scene file is a list without exactly two entries, so that it is not in a plane."""
    return isinstance(values, list) and len(values) != 2
