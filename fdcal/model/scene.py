"""A scene: every physical constant of a run, read from one TOML file.

    Room            outline, walls, sound speed, grid cell
    Source          position, band, sampling rate, duration
    Array           geometry of the microphones
    Search          lattice of candidate positions, expansion radius R of Eq. 3
    Gauge           the known microphones that fix translation, rotation and mirror
    Sensing         how pressures are taken from recordings: SNR, mode picking, wavenumber
    SolverSettings  which solver, how many modes, order rule
    Scene           all of the above, a title and a seed

Lengths are metres, frequencies hertz, speeds metres per second.
"""

from __future__ import annotations

import math
import tomllib
import typing
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from .from_table import build
from .validation import InputError, StorageError, require_choice, require_finite, require_positive

Point = tuple[float, ...]

WALLS = ("rigid", "pressure-release", "absorbing")
IN_SPACE = ("plane", "ball", "box")  # geometries of a room with three lengths; "positions" of any
GEOMETRIES = ("circle", "rectangle", "rectangle+random", "positions", *IN_SPACE)
MOST_CELLS = 20_000_000  # of a simulation: 160 MB for each of its fields
MOST_MICROPHONES = 10_000
MOST_CANDIDATES = 500_000  # of a search: the solvers' tables of them take 1 to 2 GB
MOST_METRES = 1e9  # of a coordinate
MOST_DECIBELS = 300.0
MOST_SPEED_ERROR = 0.5


@dataclass(frozen=True)
class Room:
    """Walls and air. Give `size` or `outline`.

    `size` is a rectangle with a corner at the origin or, with three lengths, a box: a field of three dimensions, which
    has a closed form (`fdcal.acoustics.box_field`) and no cells.
    """

    size: Point | None = None
    outline: tuple[Point, ...] | None = None
    walls: str = "rigid"
    admittance: float = 0.0  # specific admittance rho c / Z of absorbing walls
    sound_speed: float = 343.0
    cell: float | None = None  # h, edge of one FDTD cell; 0.02 unless given

    @staticmethod
    def optional(table: dict) -> tuple[str, ...]:
        """Keys that a scene file may leave out; the checks below say when."""
        return "size", "outline", "admittance", *(("cell",) if _is_no_pair(table.get("size")) else ())

    def __post_init__(self):
        require_positive("room.sound_speed", self.sound_speed, "m/s")
        if self.dimension == 2:
            object.__setattr__(self, "cell", 0.02 if self.cell is None else self.cell)
            require_positive("room.cell", self.cell, "m")
        elif self.cell is not None:
            raise InputError(
                f"room.cell = {self.cell:g} m has no meaning with a room.size of three lengths, whose field is known in"
                " closed form; remove it"
            )
        self._check_outline()
        self._check_walls()

    def _check_outline(self):
        if (self.size is None) == (self.outline is None):
            raise InputError("room needs either room.size or room.outline; give exactly one")
        if self.size is not None:
            _require_point("room.size", self.size, (2, 3))
        for length in self.size or ():
            require_positive("room.size", length, "m")
        if self.dimension == 3:
            return
        for corner in self.outline or ():
            _require_point("room.outline", corner, (2,))
        if self.outline is not None and (len(self.outline) < 3 or self.area < self.cell**2):
            raise InputError("room.outline encloses no area; give at least three corners [x, y], in order")
        cells = float(np.prod(np.abs(self.vertices).max(axis=0) / self.cell))  # the grid starts at the origin
        if cells > MOST_CELLS:
            raise InputError(
                f"room.cell = {self.cell:g} m cuts the room into {cells:.3g} cells; use a larger one"
                f" ({MOST_CELLS:.0e} cells at most)"
            )

    def _check_walls(self):
        require_choice("room.walls", self.walls, WALLS)
        if self.walls == "absorbing" and not (math.isfinite(self.admittance) and self.admittance > 0):
            raise InputError(
                f"room.admittance = {self.admittance:g} must be above zero for absorbing walls"
                ' (or set room.walls = "rigid")'
            )
        if self.walls != "absorbing" and self.admittance != 0:
            raise InputError(
                f'room.admittance = {self.admittance:g} has no meaning with room.walls = "{self.walls}";'
                ' remove it or set room.walls = "absorbing"'
            )

    @property
    def dimension(self) -> int:
        """2 or 3, of the sound field."""
        return 3 if _is_triple(self.size) else 2

    @property
    def vertices(self) -> np.ndarray:
        """Corners of the outline, of a box those of its floor : (V, 2) float64 array, metres."""
        if self.outline is not None:
            return np.array(self.outline, dtype=float)
        width, depth = self.size[:2]
        return np.array([[0, 0], [width, 0], [width, depth], [0, depth]], dtype=float)

    @property
    def area(self) -> float:
        """Area of the outline, m^2 (shoelace formula)."""
        x, y = self.vertices.T
        return abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))) / 2


@dataclass(frozen=True)
class Source:
    """The one source, outside the array: a zero-mean pulse of flat spectrum from `low` to `high`.

    At three coordinates the field has a closed form, the spectrum is flat throughout, and `duration` alone counts.
    """

    position: Point
    low: float | None = None  # Hz; 20 unless given
    high: float | None = None  # Hz; 3000
    sample_rate: float | None = None  # fs, Hz; 28590
    duration: float = 4.0  # of the recording, s

    FLAT: typing.ClassVar = {"low": 20.0, "high": 3000.0, "sample_rate": 28590.0}  # of a field that is simulated

    @classmethod
    def optional(cls, table: dict) -> tuple[str, ...]:
        """Keys that a scene file may leave out."""
        return tuple(cls.FLAT) if _is_no_pair(table.get("position")) else ()

    def __post_init__(self):
        _require_point("source.position", self.position, (2, 3))
        require_positive("source.duration", self.duration, "s")
        for key, usual in self.FLAT.items():
            value = getattr(self, key)
            if len(self.position) == 3 and value is not None:
                raise InputError(
                    f"source.{key} = {value:g} Hz has no meaning with a source.position of three coordinates, where no"
                    " pulse is simulated; remove it"
                )
            if len(self.position) == 2:
                object.__setattr__(self, key, usual if value is None else value)
                require_positive(f"source.{key}", getattr(self, key), "Hz")
        if len(self.position) == 2 and not self.low < self.high < self.sample_rate / 2:
            raise InputError(
                f"source.low = {self.low:g} Hz and source.high = {self.high:g} Hz must rise and stay below half of"
                f" source.sample_rate = {self.sample_rate:g} Hz"
            )


@dataclass(frozen=True)
class Array:
    """Geometry of the microphones; `fdcal.model.arrays` turns it into positions."""

    geometry: str
    center: Point | None = None  # the origin unless given
    count: int | None = None  # circle, ball, box: microphones on or in it
    radius: float | None = None  # circle, ball
    shape: tuple[int, ...] | None = None  # rectangle, plane: microphones along x, y
    size: Point | None = None  # rectangle, plane, box: outer lengths
    random: int = 0  # rectangle+random: extra microphones inside `size`
    positions: tuple[Point, ...] | None = None  # positions: one microphone a row

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
        require_choice("array.geometry", self.geometry, GEOMETRIES)
        needs = self.NEEDS[self.geometry]
        for key in ("count", "radius", "shape", "size", "random", "positions"):
            value = getattr(self, key)
            if key in needs and not value:
                raise InputError(f'array.{key} is missing or zero; array.geometry = "{self.geometry}" needs it')
            if key not in needs and value:
                raise InputError(f'array.{key} has no meaning with array.geometry = "{self.geometry}"; remove it')
            for number in np.ravel(value) if key in needs and key != "positions" else ():  # positions may be negative
                require_positive(f"array.{key}", float(number), "m" if key in ("radius", "size") else "")
        self._check_lengths(needs)
        if self._number() > MOST_MICROPHONES:
            raise InputError(f"array has {self._number()} microphones; use at most {MOST_MICROPHONES}")

    def _check_lengths(self, needs) -> None:
        """Of every point and size, how many numbers it has; fills in the centre."""
        if self.center is None:
            object.__setattr__(self, "center", (0.0,) * self.room_dimension)
        _require_point("array.center", self.center, (self.room_dimension,))
        for key, rows, wanted in (
            ("shape", [self.shape], 2),
            ("size", [self.size], self.dimension),
            ("positions", self.positions, self.dimension),
        ):
            for row in rows or () if key in needs else ():
                _require_point(f"array.{key}", row, (wanted,))

    @property
    def dimension(self) -> int:
        """2 or 3, coordinates of a microphone: 2 in a plane."""
        return self.room_dimension - (self.geometry == "plane")

    @property
    def room_dimension(self) -> int:
        """2 or 3, of the room that the array stands in."""
        if self.geometry == "positions":
            return 3 if _is_triple(self.positions[0]) else 2
        return 3 if self.geometry in IN_SPACE else 2

    def _number(self) -> int:
        """Number of microphones N."""
        return (self.count or 0) + math.prod(self.shape or (0,)) + self.random + len(self.positions or ())


@dataclass(frozen=True)
class Search:
    """Lattice of candidate positions and the expansion radius R of Eq. 3."""

    origin: Point  # corner with the lowest coordinates
    size: Point
    step: float = 0.01
    radius: float = 0.8

    def __post_init__(self):
        if len(self.origin) != len(self.size):
            raise InputError(
                f"search.origin = {list(self.origin)} and search.size = {list(self.size)} differ in dimension;"
                " give both as many numbers as a position has"
            )
        require_finite("search.origin", self.origin)
        for length in self.size:
            require_positive("search.size", length, "m")
        require_positive("search.step", self.step, "m")
        require_positive("search.radius", self.radius, "m")
        if min(self.size) < self.step * (1 - 1e-9):
            raise InputError(
                f"search.step = {self.step:g} m is longer than search.size = {list(self.size)} m; use a smaller step"
            )
        if math.prod(self.shape) > MOST_CANDIDATES:
            raise InputError(
                f"search.step = {self.step:g} m gives {float(math.prod(self.shape)):.3g} candidates; use a larger one"
                f" ({MOST_CANDIDATES} candidates at most)"
            )
        for length in self.size:
            steps = length / self.step
            if abs(steps - round(steps)) > 1e-6:
                below, above = (f(steps) * self.step for f in (math.floor, math.ceil))
                raise InputError(
                    f"search.size = {length:g} m is no whole number of steps of search.step = {self.step:g} m;"
                    f" use {below:g} or {above:g} m"
                )

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of candidates along each axis."""
        return tuple(round(length / self.step) + 1 for length in self.size)

    def layer(self, height: float = 0.0) -> np.ndarray:
        """Candidates of the horizontal layer at `height`, metres : (ny, nx, D) float64; all of them where D is 2."""
        x, y = (o + self.step * np.arange(n) for o, n in zip(self.origin[:2], self.shape[:2], strict=True))
        axes = (*np.meshgrid(x, y), np.full((len(y), len(x)), height))
        return np.stack(axes[: len(self.origin)], axis=-1)


@dataclass(frozen=True)
class Gauge:
    """Which microphones are known: `known` lists them, or `free` lists all the others."""

    known: tuple[int, ...] | None = None
    free: tuple[int, ...] | None = None

    OPTIONAL: typing.ClassVar = ("known", "free")

    def __post_init__(self):
        if (self.known is None) == (self.free is None):
            raise InputError("gauge needs either gauge.known or gauge.free; give exactly one")

    def indices(self, count: int) -> tuple[int, ...]:
        """Known microphones of an array of `count`, ascending; InputError for a number it lacks."""
        key, given = ("known", self.known) if self.free is None else ("free", self.free)
        for index in given:
            if not 0 <= index < count:
                raise InputError(f"gauge.{key} names microphone {index}; the array has 0 to {count - 1}")
        if len(set(given)) < len(given):
            raise InputError(f"gauge.{key} = {list(given)} names a microphone twice")
        if self.free is None:
            return tuple(sorted(given))
        return tuple(n for n in range(count) if n not in given)


@dataclass(frozen=True)
class Sensing:
    """How pressures are taken from the recordings (the [measurement] table)."""

    snr_db: float = math.inf  # per mode, noise on the complex pressures
    lowest: float = 20.0  # Hz, modes are picked between lowest and highest
    highest: float = 400.0
    prominence_db: float = 1.0
    resolution: float = 1.0  # Hz, closest pair of modes to be told apart
    wavenumber: str = "discrete"  # or "continuous"
    sound_speed_error: float = 0.0  # share by which the sound speed told to solvers is too high

    OPTIONAL: typing.ClassVar = ("sound_speed_error",)

    def __post_init__(self):
        if not (abs(self.snr_db) <= MOST_DECIBELS or self.snr_db == math.inf):
            raise InputError(
                f"measurement.snr_db = {self.snr_db:g} must be a number of decibels, -{MOST_DECIBELS:g} to"
                f" {MOST_DECIBELS:g}, or inf for no noise"
            )
        for key in ("lowest", "highest", "resolution"):
            require_positive(f"measurement.{key}", getattr(self, key), "Hz")
        require_positive("measurement.prominence_db", self.prominence_db, "dB")
        if not self.lowest < self.highest:
            raise InputError(
                f"measurement.lowest = {self.lowest:g} Hz must lie below measurement.highest = {self.highest:g} Hz"
            )
        if not abs(self.sound_speed_error) <= MOST_SPEED_ERROR:
            raise InputError(
                f"measurement.sound_speed_error = {self.sound_speed_error:g} is a share; use -{MOST_SPEED_ERROR:g} to"
                f" {MOST_SPEED_ERROR:g}, as 0.01 for 1 %"
            )
        require_choice("measurement.wavenumber", self.wavenumber, ("discrete", "continuous"))


@dataclass(frozen=True)
class SolverSettings:
    """Which solver and its settings."""

    name: str = "joint"  # or "descent", the paper's, or "descent+joint"
    modes: int = 57  # modes in use at the end
    first_modes: int = 3  # modes in use at the start
    order_offset: int = 2  # added to ceil(kR), Eq. 3; 0 is the paper's
    ample_modes: int = 15  # modes in use from which descent adds order_offset; with fewer it adds nothing
    known_weight: float = 1000.0  # of a known microphone's squared residual in descent; 1 is the paper's
    weights: str = "unit"  # each mode scaled to unit RMS, or "raw", the paper's
    max_sweeps: int = 20  # of one stage
    start: str | None = None  # "affine" or "random"; descent's is random and joint's affine unless given
    cost: str = "likelihood"  # of joint; "projection" is Eq. 7 with a Tikhonov weight
    noise: str = "told"  # by the measurement, where it is; "auto" estimates it; or the SNR of each mode, decibels
    known: str = "all"  # microphones whose positions are given; "minimal" takes the least gauge of them; or "none"
    room: Point | None = None  # size of a rectangular room, for solver "room"; a scene's own unless given

    OPTIONAL: typing.ClassVar = ("start", "cost", "noise", "known", "room")

    def __post_init__(self):
        for key in ("modes", "first_modes", "max_sweeps", "ample_modes", "known_weight"):
            require_positive(f"solver.{key}", getattr(self, key))
        if self.first_modes > self.modes:
            raise InputError(f"solver.first_modes = {self.first_modes} is above solver.modes = {self.modes}; lower it")
        if self.order_offset < 0:
            raise InputError(f"solver.order_offset = {self.order_offset} must not be negative")
        require_choice("solver.weights", self.weights, ("unit", "raw"))
        require_choice("solver.cost", self.cost, ("likelihood", "projection"))
        require_choice("solver.known", self.known, ("all", "minimal", "none"))
        if self.start is not None:
            require_choice("solver.start", self.start, ("affine", "random"))
        for length in self.room or ():
            require_positive("solver.room", length, "m")
        _ = self.snr_db

    @property
    def snr_db(self) -> float | None:
        """The signal-to-noise ratio of `noise`, decibels; None where it is no number."""
        if self.noise in ("told", "auto"):
            return None
        try:
            value = float(self.noise)
        except ValueError:
            value = math.nan
        if not -MOST_DECIBELS <= value <= MOST_DECIBELS:
            raise InputError(f'solver.noise = "{self.noise}" must be "told", "auto" or a number of decibels')
        return value


@dataclass(frozen=True)
class Scene:
    """Everything a run depends on.

    `load_scene` makes one from a TOML file; `fdcal.model.measurement.measure` runs it.
    """

    name: str
    title: str
    room: Room
    source: Source
    array: Array
    gauge: Gauge
    search: Search | None = None
    measurement: Sensing = field(default_factory=Sensing)
    solver: SolverSettings = field(default_factory=SolverSettings)
    seed: int = 0

    @staticmethod
    def optional(table: dict) -> tuple[str, ...]:
        """Keys that a scene file may leave out: load_scene gives the name of the file."""
        room = table.get("room")
        boxed = isinstance(room, dict) and _is_no_pair(room.get("size"))
        return "name", "title", *(("search",) if boxed else ())

    def __post_init__(self):
        if self.seed < 0:
            raise InputError(f"seed = {self.seed} must not be negative; use 0 or more")
        self._check_dimensions()
        if self.room.dimension == 2:
            self._check_band()
        if self.solver.name == "room":
            require_rectangle(self)
            object.__setattr__(self, "solver", replace(self.solver, room=self.solver.room or self.room.size))

    def _check_dimensions(self):
        D = self.room.dimension
        if len(self.source.position) != D:
            raise InputError(
                f"source.position = {list(self.source.position)} has {len(self.source.position)} numbers; the room has"
                f" {D} lengths, give as many coordinates"
            )
        if self.array.room_dimension != D:
            wanted = '"ball", "box", "plane", or "positions" of three' if D == 3 else "a geometry of two"
            raise InputError(
                f'array.geometry = "{self.array.geometry}" is of {self.array.room_dimension} dimensions and the room of'
                f" {D}; use {wanted} coordinates"
            )
        if self.search is None and D == 2:
            raise InputError("search is missing; add it to the scene")
        for key in ("origin", "size") if self.search is not None else ():
            _require_point(f"search.{key}", getattr(self.search, key), (self.array.dimension,))
        if D == 3 and self.measurement.wavenumber != "continuous":
            raise InputError(
                f'measurement.wavenumber = "{self.measurement.wavenumber}" has no meaning without a grid; a room of'
                ' three lengths needs "continuous"'
            )

    def _check_band(self):
        if not self.source.low <= self.measurement.lowest < self.measurement.highest <= self.source.high:
            raise InputError(
                f"measurement.lowest = {self.measurement.lowest:g} Hz to measurement.highest ="
                f" {self.measurement.highest:g} Hz leaves the band of the source, source.low = {self.source.low:g} Hz"
                f" to source.high = {self.source.high:g} Hz; narrow the one or widen the other"
            )


def no_rectangle(scene: Scene) -> str:
    """What keeps the solver of known rooms from knowing this one; "" if nothing does."""
    if scene.room.size is None:
        return "is no rectangle with room.size"
    return 'has walls = "pressure-release"' if scene.room.walls == "pressure-release" else ""


def require_rectangle(scene: Scene) -> None:
    """Raise InputError for a room that the solver of known rooms cannot know."""
    if no_rectangle(scene):
        raise InputError(
            f'the room of {scene.name} {no_rectangle(scene)}; solver "room" is for rigid or absorbing rectangles'
        )


def _is_triple(values) -> bool:
    """Whether a list, of whatever, has three entries."""
    return isinstance(values, (list, tuple)) and len(values) == 3


def _is_no_pair(values) -> bool:
    """Whether a list of a scene file cannot be a point of the plane; how many entries it should have is told later."""
    return isinstance(values, list) and len(values) != 2


def _require_point(key: str, values, lengths: tuple[int, ...]) -> None:
    """Raise InputError unless `values` are finite numbers, as many as one of `lengths`."""
    if len(values) not in lengths:
        words = " or ".join({2: "two, along x and y", 3: "three, along x, y and z"}[n] for n in lengths)
        raise InputError(f"{key} = {list(values)} has {len(values)} numbers; give {words}")
    require_finite(key, values)
    if max(map(abs, values)) > MOST_METRES:
        raise InputError(f"{key} = {list(values)} is too far away; use coordinates up to {MOST_METRES:g} m")


def scene_folder() -> Path:
    """Folder of the scenes that come with fdcal: in the checkout, or inside an installed package."""
    beside = Path(__file__).parents[1] / "scenes"
    return beside if beside.is_dir() else Path(__file__).parents[2] / "scenes"


def scene_names() -> list[str]:
    """Names of the scenes that come with fdcal."""
    return sorted(path.stem for path in scene_folder().glob("*.toml"))


def load_scene(path: str | Path) -> Scene:
    """Scene from a TOML file, or by the name of one that comes with fdcal.

    Raises InputError (unknown or missing key, wrong type, impossible value) and StorageError.
    """
    path = Path(path)
    if path.suffix == ".npz":
        raise InputError(f"{path} is a measurement; give a scene: a .toml file or one of {', '.join(scene_names())}")
    if path.suffix != ".toml" and not path.is_file():
        if path.name not in scene_names() or path.name != str(path):
            raise InputError(f'scene "{path}" is unknown; use a .toml file or one of {", ".join(scene_names())}')
        path = scene_folder() / f"{path.name}.toml"
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise StorageError(f"cannot read scene {path}: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is not valid TOML: {error}".replace("\n", " ")) from error
    return build(Scene, {"name": path.stem, "title": path.stem, **table})
