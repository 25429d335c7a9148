"""A scene: every physical constant of a run.

    room            outline, walls, sound speed, grid cell
    source          position or, one for each take, positions; band, sampling rate, duration
    array           geometry of the microphones
    gauge           the known microphones that fix translation, rotation and mirror
    search          lattice of candidate positions, expansion radius R of Eq. 3
    measurement     how pressures are derived from recordings: SNR, mode picking, wavenumber
    solver          which solver, how many modes, order rule
    faults          channels that are inverted or dead, spread of gains and phases

Lengths are metres, frequencies hertz, speeds metres per second. A TOML file holds a scene, simulated or a measurement
with a title; some come with fdcal.
"""

from __future__ import annotations

import difflib
import math
import os
import typing
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from .measurement import Measurement, load_measurement
from .room import SUFFIX, Room, Source, folder_of, is_no_pair, is_triple
from .settings import KNOWN_ROOM_SOLVERS, Faults, Search, Sensing, SolverSettings
from .storage import parse_toml, read_bytes
from .validation import (
    LIMITS,
    Count,
    InputError,
    Metres,
    Point,
    Seed,
    build,
    check,
    refusal,
    require_choice,
    require_point,
    shown,
    shown_literal,
    within,
)


@dataclass(frozen=True)
class Scene:
    """Everything that a run depends on.

    Attributes
    ----------
    name, title : str
        The name is that of the file; the title is shown.
    room, source, array, gauge, search, measurement, solver, faults
        See the module. `search` may be None in a room of three dimensions; `source` is None in a measured room.
    seed : int
        Seed of all random numbers: microphones, noise and random starts.

    Examples
    --------
    >>> from fdcal.acoustics.measure import measure
    >>> from fdcal.model.scene import load_scene
    >>> measure(load_scene("tiny")).count
    16
    """

    name: str
    title: str
    room: Room
    source: Source | None = field(default=None, kw_only=True)
    array: Array
    gauge: Gauge
    search: Search | None = None
    measurement: Sensing = field(default_factory=Sensing)
    solver: SolverSettings = field(default_factory=SolverSettings)
    seed: Seed = 0
    faults: Faults = field(default_factory=Faults)

    @staticmethod
    def optional(table: dict[str, Any]) -> tuple[str, ...]:
        """Return the keys that a scene file may leave out; `load_scene` takes name and title from the file's name.

        Parameters
        ----------
        table : dict
            Of the file.

        Returns
        -------
        tuple of str
        """
        room = table.get("room")
        measured = isinstance(room, dict) and "response" in room
        boxed = measured or (isinstance(room, dict) and is_no_pair(room.get("size")))
        return "name", "title", "faults", *(("source",) if measured else ()), *(("search",) if boxed else ())

    @property
    def emitter(self) -> Source:
        """The source; InputError in a measured room, whose source is unknown."""
        if self.source is None:
            raise InputError("source is missing", "add it to the scene", key="source")
        return self.source

    def takes(self) -> tuple[Scene, ...]:
        """Return the scene of each take, in which the source has only one of its positions.

        Returns
        -------
        tuple of Scene
            One for each position of the source, in their order; the scene itself if there is one position.
        """
        if self.source is None or len(self.source.places) == 1:
            return (self,)
        return tuple(replace(self, source=source) for source in self.source.each())

    def __post_init__(self):
        check(self)
        for key in ("inverted", "dead"):
            for n in getattr(self.faults, key):
                if not 0 <= n < self.array.number:
                    remedy = f"the array has 0 to {self.array.number - 1}"
                    raise InputError(f"faults.{key} names microphone {n}", remedy, key=f"faults.{key}", value=n)
        D = self.room.dimension
        if self.room.response is not None:
            if self.source is not None:
                problem = "source has no meaning in a measured room, whose response contains the sound of its own"
                raise InputError(problem, "remove it", key="source")
        elif len(self.emitter.places[0]) != D:
            key, position = self.emitter.keys[0], self.emitter.places[0]
            why = f"has {len(position)} numbers and the room has {D} lengths"
            raise refusal(key, list(position), why, "give as many coordinates")
        if self.array.room_dimension != D:
            wanted = '"ball", "box", "plane", or "positions" of three' if D == 3 else "a geometry of two"
            why = f"is of {self.array.room_dimension} dimensions and the room of {D}"
            raise refusal("array.geometry", self.array.geometry, why, f"use {wanted} coordinates")
        if D == 3 and self.measurement.wavenumber != "continuous":
            why, remedy = "has no meaning without a grid", 'a room of three lengths needs "continuous"'
            raise refusal("measurement.wavenumber", self.measurement.wavenumber, why, remedy)
        if self.search is not None:
            require_point("search.origin", self.search.origin, (self.array.dimension,))
            require_point("search.size", self.search.size, (self.array.dimension,))
        elif D == 2:
            raise InputError("search is missing", "add it to the scene", key="search")
        if D == 2:
            sensing, band = self.measurement, self.emitter.band
            if not band.low <= sensing.lowest < sensing.highest <= band.high:
                problem = f"measurement.lowest = {sensing.lowest:g} Hz to measurement.highest = {sensing.highest:g} Hz"
                problem += " exceeds the band of the source,"
                problem += f" source.low = {band.low:g} Hz to source.high = {band.high:g} Hz"
                remedy = "narrow the one or widen the other"
                raise InputError(problem, remedy, key="measurement.highest", value=sensing.highest)
        elif self.array.number > LIMITS.microphones_3d:
            problem = f"array has {self.array.number} microphones"
            remedy = f"use at most {LIMITS.microphones_3d} in a room with height"
            raise InputError(problem, remedy, key="array.count", value=self.array.number)
        if self.solver.name in KNOWN_ROOM_SOLVERS:
            require_rectangle(self)
            object.__setattr__(self, "solver", replace(self.solver, room=self.solver.room or self.room.size))


def no_rectangle(scene: Scene) -> str:
    """Return why solver "room" cannot be used for the room of `scene`; "" if it can."""
    if scene.room.size is None:
        return "is not a rectangle with room.size"
    if scene.source is not None and len(scene.source.places) > 1:
        return f"has a source at {len(scene.source.places)} positions, and the solver seeks one"
    return 'has walls = "pressure-release"' if scene.room.walls == "pressure-release" else ""


def require_rectangle(scene: Scene) -> None:
    """Raise InputError unless solver "room" can be used for the room of `scene`."""
    reason = no_rectangle(scene)
    if reason:
        remedy = 'use another solver: "room" is for rigid or absorbing rectangles'
        raise InputError(f"the room of {scene.name} {reason}", remedy, key="solver.name", value="room")


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
        wrong = [n for n, times in Counter(given).items() if not 0 <= n < count or times > 1]
        if wrong:
            problem = f"{key} names microphone {wrong[0]}, which does not exist or is listed twice"
            raise InputError(problem, f"list each of 0 to {count - 1} once", key=key, value=wrong[0])
        named = set(given)
        return tuple(n for n in range(count) if (n in named) == (self.free is None))


CELLS = 50  # steps along the search domain of a placeholder
MARGIN = 1.0  # metres around the known positions of the array
KEYS = ("name", "title", "measurement", "remark")  # of the file of a scene that is a measurement


@dataclass(frozen=True)
class MeasuredScene(Scene):
    """The scene of a measurement: title, solver, seed and gauge are real; room, source and array are placeholders."""

    file: str = ""  # path of the measurement; "" if the measurement is given together with the scene
    remark: str = ""  # what was measured, by whom, and under which licence; it is shown below the scene's name

    @staticmethod
    def optional(table: dict[str, Any]) -> tuple[str, ...]:
        """Return the keys that the table of a measured scene may leave out."""
        return (*Scene.optional(table), "file", "remark")


def placeholder_scene(
    measurement: Measurement,
    name: str,
    solver: SolverSettings,
    seed: int = 0,
    *,
    title: str = "",
    file: str = "",
    remark: str = "",
) -> MeasuredScene:
    """Return a scene for a measurement that has none; `title`: the name and "as measured" unless given."""
    D, d = measurement.dimension, measurement.array_dimension
    places = measurement.positions if measurement.positions is not None else measurement.known_positions
    low, high = (np.min(places, axis=0), np.max(places, axis=0)) if len(places) else (np.zeros(d), np.ones(d))
    low, size = low - MARGIN, np.maximum(high - low, 0.1) + 2 * MARGIN
    boxed, step = D == 3, float(size.max()) / CELLS
    search = measurement.search or (None if boxed else Search(tuple(low.tolist()), (CELLS * step,) * 2, step))
    corners = low + size * np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) if not boxed else None
    c = measurement.sound_speed
    if boxed and d == 2:
        array = Array("plane", center=(4.5, 4.0, 3.5), shape=(measurement.count, 1), size=(1.0, 0.1))
    else:
        placed = measurement.positions
        placed = 0.1 * np.arange(measurement.count)[:, None] * np.ones(d) if placed is None else placed
        array = Array("positions", positions=_rows(placed))
    return MeasuredScene(
        name=name,
        title=title or f"{name}, as measured",
        room=Room(size=(9.0, 8.0, 7.0), sound_speed=c) if boxed else Room(outline=_rows(corners), sound_speed=c),
        source=Source(position=(0.1,) * 3 if boxed else tuple((low + 0.1).tolist())),
        array=array,
        gauge=Gauge(known=tuple(measurement.known.tolist())),
        search=search,
        measurement=Sensing(wavenumber="continuous"),
        solver=solver,
        seed=seed,
        file=file,
        remark=remark,
    )


def _rows(values: Any) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in np.asarray(values).tolist())


# Suffixes of files that are mistaken for scenes: what such a file is, and the command for it.
OTHER_FILES = {
    ".csv": ("a table", "give positions as <positions>"),
    ".xml": ("a table of positions", "give it as <positions>"),
    ".json": ("a result or a session", "use `fdcal export` or `fdcal view`"),
}


def scene_names() -> list[str]:
    """Return the names of the scenes that come with fdcal."""
    return sorted(path.stem for path in folder_of("scenes").glob("*.toml"))


def load_scene(path: str | Path) -> Scene:
    """Return the scene of a TOML file, or one that comes with fdcal, by its name.

    Parameters
    ----------
    path : str or Path
        A .toml file, or one of `scene_names()`.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        For an unknown or missing key, a wrong type or an impossible value.
    StorageError
        If the file cannot be read.

    Examples
    --------
    >>> load_scene("tiny").room.size
    (1.68, 1.2)
    """
    table = scene_table(path)
    if not isinstance(table.get("measurement"), str):
        return build(Scene, table)
    for key, value in table.items():
        if key not in KEYS:
            problem = f"{key} has no meaning in a scene that is a measurement, of which nothing is simulated"
            raise InputError(problem, "remove it", key=key)
        if not isinstance(value, str):
            raise InputError(f"{key} = {shown_literal(value)} must be a text", "write it in quotes", key=key)
    file, words = table["measurement"], {"title": table["title"], "remark": table.get("remark", "")}
    return placeholder_scene(load_measurement(file), table["name"], SolverSettings(), file=file, **words)


def scene_table(path: str | Path) -> dict[str, Any]:
    """Return the table of a scene for `fdcal.model.validation.build`; `path`: as of `load_scene`.

    In a measured scene `measurement` is a path. The paths in a file are relative to its folder.
    """
    path = _file_of(Path(path))
    table = {"name": path.stem, "title": path.stem, **parse_toml(read_bytes(path, what="scene"), path)}
    folder, room = path.resolve().parent, table.get("room")
    if isinstance(table.get("measurement"), str):
        table["measurement"] = str(folder / table["measurement"])
    if isinstance(room, str):
        room = table["room"] = {"response": room}
    if isinstance(room, dict) and isinstance(room.get("response"), str) and room["response"].lower().endswith(SUFFIX):
        table["room"] = {**room, "response": str(folder / room["response"])}
    return table


def _file_of(path: Path) -> Path:
    """Return the file of a scene that is given by its path or its name."""
    available = f"a .toml file or one of {', '.join(scene_names())}"
    if path.suffix == ".npz":
        raise InputError(f"{path} is a measurement", f"give a scene: {available}", key="scene", value=path)
    if os.path.isdir(path) and path.name not in scene_names():
        problem = f"{path} is a folder in which no recordings were found"
        raise InputError(problem, f"give a file, a folder of MeshRIR, or {available}", key="scene", value=path)
    is_file, suffix = os.path.isfile(path), path.suffix.lower()  # False for a name that is too long
    if is_file and suffix in OTHER_FILES:
        what, use = OTHER_FILES[suffix]
        raise InputError(f"{path} is {what}", f"{use}, or give a scene: {available}", key="scene")
    if is_file or suffix in (".toml", *OTHER_FILES) or "\0" in str(path):
        return path  # reading it reports a missing file
    if path.name not in scene_names() or path.name != str(path):
        near = [name for name in scene_names() if name.startswith(str(path))]
        near = near or difflib.get_close_matches(str(path)[:60], scene_names(), 1)
        meant = f"did you mean {near[0]}? use {available}" if near else f"use {available}"
        raise InputError(f'scene "{shown(str(path))}" is unknown', meant, key="scene", value=path)
    return folder_of("scenes") / f"{path.name}.toml"
