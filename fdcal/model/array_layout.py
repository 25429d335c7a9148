"""The array of a scene: its geometry, and which of its microphones are known."""

import math
import typing
from dataclasses import dataclass
from typing import Annotated

from .declared import Count, Metres, check, within
from .room import is_triple
from .validation import LIMITS, InputError, Point, require_choice, require_point

GEOMETRIES_3D = ("plane", "ball", "box")  # of a room with three lengths; "positions" may have two or three coordinates


@dataclass(frozen=True)
class Array:
    """Geometry of the microphones; `fdcal.model.arrays` turns it into positions."""

    geometry: str  # one of NEEDS, which lists the keys that each of them takes
    center: Point | None = None  # centre, metres; the origin unless given
    count: Count | None = None  # microphones on a circle, or in a ball or box
    radius: Metres | None = None  # of a circle or ball, metres
    shape: tuple[Count, ...] | None = None  # microphones along x and y of a rectangle or plane
    size: tuple[Metres, ...] | None = None  # outer lengths of a rectangle, plane or box, metres
    random: Annotated[int, within(0)] = 0  # additional random microphones inside `size` ("rectangle+random")
    positions: tuple[Point, ...] | None = None  # one microphone a row, metres ("positions")

    OPTIONAL: typing.ClassVar = ("center", "count", "radius", "shape", "size", "random", "positions")
    NEEDS: typing.ClassVar = {
        "circle": ("count", "radius"),
        "rectangle": ("shape", "size"),
        "rectangle+random": ("shape", "size", "random"),
        "positions": ("positions",),
        "plane": ("shape", "size"),
        "ball": ("count", "radius"),
        "box": ("count", "size"),
    }

    def __post_init__(self):
        require_choice("array.geometry", self.geometry, self.NEEDS)
        needs = self.NEEDS[self.geometry]
        for key in self.OPTIONAL[1:]:
            value, name = getattr(self, key), f"array.{key}"
            if key in needs and not value:
                remedy = f'array.geometry = "{self.geometry}" needs it'
                raise InputError(f"{name} is missing or zero", remedy, key=name, value=value)
            if key not in needs and value:
                problem = f'{name} has no meaning with array.geometry = "{self.geometry}"'
                raise InputError(problem, "remove it", key=name, value=value)
        check(self, "array.")
        if self.center is None:
            object.__setattr__(self, "center", (0.0,) * self.room_dimension)
        require_point("array.center", self.center, (self.room_dimension,))
        for key, wanted in (("shape", 2), ("size", self.dimension), ("positions", self.dimension)):
            value = getattr(self, key)
            for row in () if key not in needs else value if key == "positions" else [value]:
                require_point(f"array.{key}", row, (wanted,))
        if self.number > LIMITS.microphones:
            problem = f"array has {self.number} microphones"
            raise InputError(problem, f"use at most {LIMITS.microphones}", key="array.count")

    @property
    def dimension(self) -> int:
        """Number of coordinates of a microphone, 2 or 3: 2 in a plane."""
        return self.room_dimension - (self.geometry == "plane")

    @property
    def room_dimension(self) -> int:
        """Dimension of the room that the array stands in, 2 or 3."""
        if self.geometry == "positions":
            return 3 if is_triple((self.positions or ((),))[0]) else 2
        return 3 if self.geometry in GEOMETRIES_3D else 2

    @property
    def number(self) -> int:
        """Number of microphones N."""
        return (self.count or 0) + math.prod(self.shape or (0,)) + self.random + len(self.positions or ())


@dataclass(frozen=True)
class Gauge:
    """Which microphones are known: `known` lists them, or `free` lists all the others. Give exactly one."""

    known: tuple[int, ...] | None = None
    free: tuple[int, ...] | None = None

    OPTIONAL: typing.ClassVar = ("known", "free")

    def __post_init__(self):
        if (self.known is None) == (self.free is None):
            raise InputError("gauge needs either gauge.known or gauge.free", "give exactly one", key="gauge.known")

    def indices(self, count: int) -> tuple[int, ...]:
        """Return the known microphones of an array of `count`, ascending; InputError for one lacking or given twice."""
        key, given = ("gauge.known", self.known or ()) if self.free is None else ("gauge.free", self.free)
        for index in given:
            if not 0 <= index < count:
                remedy = f"the array has 0 to {count - 1}"
                raise InputError(f"{key} names microphone {index}", remedy, key=key, value=index)
        if len(set(given)) < len(given):
            raise InputError(f"{key} = {list(given)} names a microphone twice", "list each once", key=key, value=given)
        if self.free is None:
            return tuple(sorted(given))
        return tuple(n for n in range(count) if n not in given)
