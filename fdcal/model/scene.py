"""A scene: every physical constant of a run.

    room            outline, walls, sound speed, grid cell
    source          position or, one for each take, positions; band, sampling rate, duration
    array           geometry of the microphones
    gauge           the known microphones that fix translation, rotation and mirror
    search          lattice of candidate positions, expansion radius R of Eq. 3
    measurement     how pressures are derived from recordings: SNR, mode picking, wavenumber
    solver          which solver, how many modes, order rule
    faults          channels that are inverted or dead, spread of gains and phases

Lengths are metres, frequencies hertz, speeds metres per second. A TOML file describes a simulated scene, or names a
measurement and gives it a title. Some of these files come with fdcal.

A measured room is an impulse response with directions of arrival, given by name or as a file. The response was measured
at one point; the field between the microphones is modelled, as `fdcal.acoustics.plane_waves` describes.
"""

from __future__ import annotations

import difflib
import math
import os
import typing
from collections import Counter
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from .measurement import Measurement, load_measurement
from .quantities import Count, Hertz, Metres, MetresPerSecond, Point, Seconds, Seed, Whole
from .settings import Faults, Search, Sensing, SolverSettings, search_around
from .storage import parse_text, read_bytes
from .validation import LIMITS, InputError, StorageError, build, check, naming, refusal, require_choice, require_point

SUFFIX = ".mat"
UNKNOWN_WALLS = "unknown"  # room.walls of a measured room
MEASURED_AND_MODELLED = (
    "The impulse response is measured, at one point, with the direction of arrival of each sample. The field between"
    " the microphones is modelled: each sample is a plane wave from its direction. Walls and source are unknown."
)


def folder_of(name: str) -> Path:
    """Return the folder `name` of files that come with fdcal, in the installed package or else in the checkout."""
    beside = Path(__file__).parents[1] / name
    return beside if beside.is_dir() else Path(__file__).parents[2] / name


def response_path(text: str) -> Path:
    """Return the file of a response that is given by its name or path; raise StorageError if it is missing."""
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
    walls: str = ""  # one of WALLS, rigid unless given; UNKNOWN_WALLS in a measured room
    admittance: float = 0.0  # specific admittance rho c / Z of absorbing walls, dimensionless
    sound_speed: MetresPerSecond = 343.0  # c
    cell: Metres | None = None  # h, edge of one FDTD cell; 0.02 unless given. A box has none.
    # name or path of the response of a measured room (see the module), whose field is three-dimensional.
    # In a scene file, `room = "NAME"` is short for a table with this key alone
    response: str | None = None

    @staticmethod
    def optional(table: dict[str, Any]) -> tuple[str, ...]:
        """Return the keys that a scene file may leave out."""
        if "response" in table:
            return "size", "outline", "admittance", "cell", "walls", "sound_speed"
        return "response", "size", "outline", "admittance", *(("cell",) if not_planar(table.get("size")) else ())

    def __post_init__(self):
        if self.response is not None:
            shipped = sorted(path.stem for path in folder_of("rooms").glob(f"*{SUFFIX}"))
            if not self.response.lower().endswith(SUFFIX) and self.response not in shipped:
                remedy = f"use {', '.join(shipped)} or the path of a {SUFFIX} file"
                raise refusal("room.response", self.response, "is unknown", remedy)
            for key in ("size", "outline", "cell", "walls", "admittance"):
                value = getattr(self, key)
                if value and value != UNKNOWN_WALLS:
                    problem = f"room.{key} = {value!r} has no meaning in a measured room, whose walls are unknown"
                    raise InputError(problem, "remove it", key=f"room.{key}")
            object.__setattr__(self, "walls", UNKNOWN_WALLS)
            check(self, "room.")
            return
        object.__setattr__(self, "walls", self.walls or "rigid")
        if self.dimension == 2:
            object.__setattr__(self, "cell", 0.02 if self.cell is None else self.cell)
        elif self.cell is not None:
            raise refusal("room.cell", self.cell, "has no meaning with a room.size of three lengths", "remove it", "m")
        if (self.size is None) == (self.outline is None):
            raise InputError("room needs either room.size or room.outline", "give exactly one", key="room.size")
        if self.size is not None:
            require_point("room.size", self.size, (2, 3))
        check(self, "room.")
        for corner in self.outline or ():
            require_point("room.outline", corner, (2,))
        if self.outline is not None and (len(self.outline) < 3 or self.area < self.cell_size**2):
            raise InputError("room.outline encloses no area", "give three or more corners", key="room.outline")
        cells = float(np.prod(np.abs(self.vertices).max(axis=0) / (self.cell or math.inf)))  # from the origin on
        if cells > LIMITS.cells:
            raise refusal("room.cell", self.cell, f"makes {cells:.3g} cells", "use a larger one", "m")
        require_choice("room.walls", self.walls, WALLS)
        if self.walls == "absorbing" and not (math.isfinite(self.admittance) and self.admittance > 0):
            raise refusal("room.admittance", self.admittance, "is not that of absorbing walls", "give one above zero")
        if self.walls != "absorbing" and self.admittance != 0:
            raise refusal("room.admittance", self.admittance, f"has no meaning with {self.walls} walls", "remove it")

    @property
    def dimension(self) -> int:
        """Dimension of the sound field, 2 or 3."""
        return 3 if self.response is not None or len(self.size or ()) == 3 else 2

    @property
    def cell_size(self) -> float:
        """Edge h of one FDTD cell, metres; raises InputError for a box, which has no cells."""
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
    """Band and sampling rate of a simulated pulse, Hz."""

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
    duration: Seconds = 4.0  # length of the recording of each take
    positions: tuple[Point, ...] = ()  # one for each take, metres; () if `position` is given

    DEFAULTS: typing.ClassVar = Band(low=20.0, high=3000.0, sample_rate=28590.0)

    @classmethod
    def optional(cls, table: dict[str, Any]) -> tuple[str, ...]:
        """Return the keys that a scene file may leave out."""
        places = table.get("positions")
        first = places[0] if isinstance(places, list) and places else table.get("position")
        other = "position" if "positions" in table else "positions"
        return other, *(cls.DEFAULTS._fields if not_planar(first) else ())

    def __post_init__(self):
        if (self.position is None) == (not self.positions):
            problem = "source needs either source.position or source.positions"
            raise InputError(problem, "give exactly one", key="source.position")
        if len(self.positions) > LIMITS.takes:
            raise refusal("len(source.positions)", len(self.positions), "is too many", f"use at most {LIMITS.takes}")
        for number, (key, place) in enumerate(zip(self.keys, self.places, strict=True)):
            require_point(key, place, (len(self.places[0]),) if number else (2, 3))
            if place in self.places[:number]:
                raise InputError(f"{key} = {list(place)} m is given twice", "move it to another position", key=key)
        check(self, "source.")
        pulsed = len(self.places[0]) == 2
        for key, default in self.DEFAULTS._asdict().items():
            value = getattr(self, key)
            if not pulsed and value is not None:
                raise refusal(f"source.{key}", value, "has no meaning with three coordinates", "remove it", "Hz")
            if pulsed:
                object.__setattr__(self, key, default if value is None else value)
        if pulsed and not self.band.low < self.band.high < self.band.sample_rate / 2:
            why = f"is not between source.low = {self.low:g} and half of source.sample_rate = {self.sample_rate:g} Hz"
            raise refusal("source.high", self.high, why, "change one of the three", "Hz")

    @property
    def places(self) -> tuple[Point, ...]:
        """All positions of the source, one for each take, metres."""
        return self.positions if self.position is None else (self.position,)

    @property
    def place(self) -> Point:
        """The only position of the source, metres; raises ValueError if it has several (see `Scene.takes`)."""
        (place,) = self.places
        return place

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of its positions for messages: "source.position", or "source.positions[1]" and so on."""
        return tuple(f"source.positions[{i + 1}]" for i in range(len(self.positions))) or ("source.position",)

    def table(self) -> dict[str, Any]:
        """Return the values for the key of the cache, as a dictionary without empty `positions`."""
        return {key: value for key, value in asdict(self).items() if key != "positions" or value}

    @property
    def band(self) -> Band:
        """Band and sampling rate of the simulated pulse; raises InputError for a source in space, which has none."""
        if self.low is None or self.high is None or self.sample_rate is None:
            raise refusal("source.position", list(self.places[0]), "has three coordinates and no pulse", "give two")
        return Band(self.low, self.high, self.sample_rate)


def not_planar(values: Any) -> bool:
    """Return whether a list of a scene file, a size or a position, does not have the two entries of a plane."""
    return isinstance(values, list) and len(values) != 2


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
            Table of the file.

        Returns
        -------
        tuple of str
        """
        room = table.get("room")
        measured = isinstance(room, dict) and "response" in room
        boxed = measured or (isinstance(room, dict) and not_planar(room.get("size")))
        return "name", "title", "faults", *(("source",) if measured else ()), *(("search",) if boxed else ())

    @property
    def emitter(self) -> Source:
        """The source; raises InputError in a measured room, whose source is unknown."""
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
        sources = (replace(self.source, position=place, positions=()) for place in self.source.places)
        return tuple(replace(self, source=source) for source in sources)

    def __post_init__(self):
        check(self)
        for key in ("inverted", "dead"):
            for n in getattr(self.faults, key):
                if not 0 <= n < self.array.number:
                    raise refusal(f"faults.{key}", n, "is not a microphone", f"use 0 to {self.array.number - 1}")
        D = self.room.dimension
        if self.room.response is not None:
            if self.source is not None:
                raise InputError("source has no meaning in a room that was measured", "remove it", key="source")
        elif len(self.emitter.places[0]) != D:
            key, position = self.emitter.keys[0], self.emitter.places[0]
            raise refusal(key, list(position), f"does not fit a room of {D} dimensions", f"give {D} coordinates")
        if self.array.room_dimension != D:
            wanted = '"ball", "box", "plane", or "positions" of three' if D == 3 else "a geometry of two"
            why = f"has {self.array.room_dimension} dimensions, and the room has {D}"
            raise refusal("array.geometry", self.array.geometry, why, f"use {wanted} coordinates")
        if D == 3 and self.measurement.wavenumber != "continuous":
            why, remedy = "has no meaning without a grid", 'a room of three dimensions needs "continuous"'
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
                problem += f" exceeds source.low = {band.low:g} Hz to source.high = {band.high:g} Hz"
                raise InputError(problem, "narrow the first band or widen the second", key="measurement.highest")
        elif self.array.number > LIMITS.microphones_3d:
            raise refusal("array.count", self.array.number, "is too large", f"use at most {LIMITS.microphones_3d}")


GEOMETRIES_3D = ("plane", "ball", "box")  # those of a three-dimensional room; "positions" may have either dimension


@dataclass(frozen=True)
class Array:
    """Geometry of the microphones; `fdcal.model.arrays` turns it into positions."""

    geometry: str  # one of NEEDS, which lists the keys that each of them takes
    center: Point | None = None  # centre, metres; the origin unless given
    count: Count | None = None  # microphones on a circle, or in a ball or box
    radius: Metres | None = None  # metres, radius of a circle or ball
    shape: tuple[Count, ...] | None = None  # microphones along x and y of a rectangle or plane
    size: tuple[Metres, ...] | None = None  # outer lengths of a rectangle, plane or box, metres
    random: Whole = 0  # additional random microphones inside `size` ("rectangle+random")
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
                raise InputError(f"{name} is missing or zero", f'array.geometry = "{self.geometry}" needs it', key=name)
            if key not in needs and value:
                raise InputError(f'{name} has no meaning with geometry = "{self.geometry}"', "remove it", key=name)
        check(self, "array.")
        if self.center is None:
            object.__setattr__(self, "center", (0.0,) * self.room_dimension)
        require_point("array.center", self.center, (self.room_dimension,))
        for key, wanted in (("shape", 2), ("size", self.dimension), ("positions", self.dimension)):
            value = getattr(self, key)
            for row in () if key not in needs else value if key == "positions" else [value]:
                require_point(f"array.{key}", row, (wanted,))
        if self.number > LIMITS.microphones:
            raise refusal("array.count", self.number, "is too large", f"use at most {LIMITS.microphones}")

    @property
    def dimension(self) -> int:
        """Number of coordinates of a microphone, 2 or 3: 2 in a plane."""
        return self.room_dimension - (self.geometry == "plane")

    @property
    def room_dimension(self) -> int:
        """Dimension of the room that the array stands in, 2 or 3."""
        if self.geometry == "positions":
            return 3 if self.positions and len(self.positions[0]) == 3 else 2
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
        """Return the known microphones of an array of `count`, ascending.

        Raises InputError for wrong or repeated numbers.
        """
        key, given = ("gauge.known", self.known or ()) if self.free is None else ("gauge.free", self.free)
        wrong = [n for n, times in Counter(given).items() if not 0 <= n < count or times > 1]
        if wrong:
            problem = f"{key} names microphone {wrong[0]}, which does not exist or is listed twice"
            raise InputError(problem, f"list each of 0 to {count - 1} once", key=key)
        return tuple(n for n in range(count) if (n in given) == (self.free is None))


KEYS = ("name", "title", "measurement", "remark")  # keys of the file of a scene that is a measurement


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
    measurement: Measurement, name: str, solver: SolverSettings, seed: int = 0, *, title="", file="", remark=""
) -> MeasuredScene:
    """Return a scene for a measurement that has none; unless given, `title` is the name followed by "as measured".

    A measurement that is called like a scene of fdcal is named "NAME (measured)".
    """
    title = title or f"{name}, as measured"
    name += " (measured)" if not file and name in scene_names() else ""
    D, d, placed = measurement.dimension, measurement.array_dimension, measurement.positions
    if D == 3 and d == 2:
        array = Array("plane", center=(4.5, 4.0, 3.5), shape=(measurement.count, 1), size=(1.0, 0.1))
    else:
        placed = 0.1 * np.arange(measurement.count)[:, None] * np.ones(d) if placed is None else placed
        array = Array("positions", positions=tuple(map(tuple, placed.tolist())))
    return MeasuredScene(
        name=name,
        title=title,
        room=Room(size=(9.0, 8.0, 7.0)[:D], sound_speed=measurement.sound_speed),
        source=Source(position=(0.1,) * D),
        array=array,
        gauge=Gauge(known=tuple(measurement.known.tolist())),
        search=measurement.search or (search_around([(0.0, 0.0), (1.0, 1.0)]) if D == 2 else None),
        measurement=Sensing(wavenumber="continuous"),
        solver=solver,
        seed=seed,
        file=file,
        remark=remark,
    )


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
    with naming(path):
        table = scene_table(path)
        if not isinstance(table.get("measurement"), str):
            return build(Scene, table)
        for key, value in table.items():
            if key not in KEYS:
                raise InputError(f"{key} has no meaning in a scene that is a measurement", "remove it", key=key)
            if not isinstance(value, str):
                raise refusal(key, value, "must be a text", "write it in quotes")
        file, words = table["measurement"], {"title": table["title"], "remark": table.get("remark", "")}
        return placeholder_scene(load_measurement(file), table["name"], SolverSettings(), file=file, **words)


def scene_table(path: str | Path) -> dict[str, Any]:
    """Return the table of a scene for `fdcal.model.validation.build`; `path` is as in `load_scene`.

    In a measured scene `measurement` is a path. The paths in a file are relative to its folder.
    """
    path = _file_of(Path(path))
    table = {"name": path.stem, "title": path.stem, **parse_text(read_bytes(path, what="scene"), "TOML", path)}
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
        raise InputError(f"{path} is a measurement", f"give a scene: {available}", key="scene")
    if os.path.isdir(path) and path.name not in scene_names():
        problem = f"{path} is a folder in which no recordings were found"
        raise InputError(problem, f"give a file, a folder of MeshRIR, or {available}", key="scene")
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
        raise InputError(f'the scene, file or folder "{str(path)[:60]}" is unknown', meant, key="scene")
    return folder_of("scenes") / f"{path.name}.toml"
