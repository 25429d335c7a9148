"""A study as a TOML file: draws of a scene over axes of values, or of a list of settings. And the code of its rows."""

import hashlib
import itertools
import json
import math
import subprocess
from collections.abc import Iterator
from dataclasses import MISSING, asdict, dataclass, field, fields, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from ...acoustics.spectrum import SPECTRUM
from ...model.room import Room
from ...model.scene import MeasuredScene, Scene, load_scene, scene_table
from ...model.storage import parse_toml, read_bytes
from ...model.validation import Count, Hertz, InputError, Metres, Seconds, Seed, build, check, shown, within
from ..scene_edits import SceneParameters, change, parameters_of, with_parameters


@dataclass(frozen=True)
class Setting:
    """What all draws of a setting have in common."""

    name: str
    array: Literal["disc", "circle", "ball", "sphere", "plane"]
    microphones: Count
    radius: Metres
    room: tuple[Metres, ...]  # lengths, two or three, metres
    modes: Count  # frequencies of a take, evenly spaced, a little displaced at random
    low: Hertz = 40.0
    high: Hertz = 300.0  # or 0.9 times what the array can interpolate (Eq. 9), if that is lower
    snr_db: Annotated[float, within(0, 120, "dB")] = 40.0
    noise: Literal["reported", "auto"] = "auto"  # whether the solver is given the power of the noise
    takes: Count = 1  # places of the source
    known: Annotated[int, within(0)] = 4  # microphones whose positions are given; 0: blind
    known_error: Annotated[float, within(0, 1, "m")] = 0.0  # standard deviation of each given coordinate
    misplaced: Annotated[float, within(0, 10, "m")] = 0.0  # by which one given position is wrong
    gain_db: Annotated[float, within(0, 40, "dB")] = 0.0  # standard deviation of the channels' gains
    phase_deg: Annotated[float, within(0, 180, "degrees")] = 0.0  # likewise of their phases
    inverted: Annotated[int, within(0)] = 0  # channels of inverted polarity
    dead: Annotated[int, within(0)] = 0  # channels without signal
    # pairs of a frequency, Hz, and the fraction of the energy that the walls absorb there at normal incidence; rigid
    # walls without any, in a recording that is weighted as one of four seconds is
    absorption: tuple[tuple[float, float], ...] = ()
    cardioid: bool = False  # whether the source is a cardioid that faces a random direction
    sound_speed_error: Annotated[float, within(-0.1, 0.1)] = 0.0  # of the sound speed that the solver is given
    # one sigma of given coordinates and of the sound speed as stated to the solver; left out: nothing is stated
    known_sigma: Annotated[float, within(0, 1, "m")] | None = None
    sound_speed_sigma: Annotated[float, within(1e-6, 0.1)] | None = None

    @staticmethod
    def optional(table: dict) -> list[str]:
        """Return the keys that may be missing: those that have a default."""
        return [one.name for one in fields(Setting) if one.default is not MISSING]

    def __post_init__(self):
        check(self, f"settings.{self.name}.")
        flat = self.array in ("disc", "circle")
        if len(self.room) != (2 if flat else 3):
            remedy = f"give {'two' if flat else 'three'} lengths for an array of the form {self.array}"
            raise InputError(f"the room of setting {self.name} has {len(self.room)} lengths", remedy, key="room")
        band = self.low >= self.high
        falling = any(a[0] >= b[0] for a, b in itertools.pairwise(self.absorption))
        if band or falling or not all(0 < a < 1 for _, a in self.absorption):
            problem = f"setting {self.name} needs low below high, and absorption from 0 to 1 at rising frequencies"
            raise InputError(problem, key="low" if band else "absorption")
        if self.known + self.inverted + self.dead > self.microphones or (self.misplaced and not self.known):
            problem = f"setting {self.name} has too few microphones for what is given or faulty"
            raise InputError(problem, "use more microphones", key="microphones")


MAX_TASKS = 100_000_000
PARAMETERS = tuple(field.name for field in fields(SceneParameters) if field.name != "seed")
SCENE = "scene"  # the axis whose values are names or paths of scenes
SETTING = "setting"  # the axis of a study of settings: their names
OWN = ("point", "draw", "seed")  # columns of the table that no axis may be called like


@dataclass(frozen=True)
class Drawn:
    """What is drawn for every calibration, in addition to noise, random microphones and the solver's start."""

    source: bool = False  # whether the source is at a random place of the room, the same for one draw at all points
    least_distance: Annotated[float, within(0, 1e12, "m")] = 0.7  # of such a source from every microphone

    OPTIONAL = ("source", "least_distance")


@dataclass(frozen=True)
class Study:
    """Calibrations over the product of some axes, or over some settings."""

    title: str
    draws: Count  # calibrations at every point, each with a seed of its own
    axes: dict = field(default_factory=dict)  # at most a few thousand points; of settings their names
    scene: str = ""  # name or path of a scene's file; left out where the axis "scene" names several
    seed: Seed = 0  # of the first draw
    fixed: dict | None = None
    drawn: Drawn = Drawn()
    time_limit: Seconds = 60.0  # processor time of one calibration
    settings: tuple[Setting, ...] = ()  # of arrays and rooms that are drawn, in place of a scene and axes

    OPTIONAL = ("title", "axes", "scene", "seed", "fixed", "drawn", "time_limit", "settings")

    def __post_init__(self):
        check(self)
        if self.settings:
            self._check_settings()
            return
        if not self.axes:
            raise InputError("axes is missing", "write [axes], or [[settings]]", key="axes")
        for key, values in self.axes.items():
            if not isinstance(values, list) or not values:
                remedy = f'write it as "{shown(key)}" = [...]'
                raise InputError(f"axes.{shown(key)} is no list of values", remedy, key=f"axes.{key}")
            kinds = {type(value) for value in values}
            if len(kinds) > 1 and kinds != {int, float}:
                problem = f"axes.{shown(key)} mixes numbers with texts or lists"
                raise InputError(problem, "run a study for each kind", key=f"axes.{key}")
            twice = next((value for i, value in enumerate(values) if value in values[:i]), None)
            if twice is not None:
                problem = f"axes.{shown(key)} has the value {shown(json.dumps(twice))} twice"
                raise InputError(problem, "write each value once", key=f"axes.{key}", value=twice)
        if bool(self.scene) == (SCENE in self.axes):
            remedy = 'write scene = "NAME", or name several by scene = [...] below [axes]'
            raise InputError("a study has a scene, or an axis of scenes", remedy, key=SCENE)
        for key in (*(key for key in self.axes if key != SCENE), *(self.fixed or {})):
            if key in OWN or ("." not in key and key not in PARAMETERS):
                remedy = f"use a key of the scene, such as solver.modes, or one of {', '.join(PARAMETERS)}"
                raise InputError(f'no scene has the key "{shown(key)}"', remedy, key=f"axes.{shown(key)}")
        self._require_few("axes")

    def _require_few(self, key: str) -> None:
        if self.count > MAX_TASKS:
            raise InputError(f"the study has {self.count:.3g} calibrations", f"use at most {MAX_TASKS:.0e}", key=key)

    def _check_settings(self) -> None:
        names = [setting.name for setting in self.settings]
        if self.scene or self.fixed or self.axes.keys() - {SETTING}:
            problem = "a study of settings has no scene, no axes and nothing fixed"
            raise InputError(problem, "write what is fixed into each of [[settings]]", key="settings")
        for i, name in enumerate(names):
            if name in names[:i]:
                raise InputError(f'two settings have the name "{shown(name)}"', "rename one", key="settings")
        object.__setattr__(self, "axes", {SETTING: names})
        self._require_few("draws")

    def setting(self, name: str) -> Setting:
        """Return the setting of a name."""
        return next(one for one in self.settings if one.name == name)

    @property
    def scenes(self) -> list[str]:
        """Names or paths of all its scenes; none of a study of settings."""
        if self.settings:
            return []
        return self.axes.get(SCENE, [self.scene])

    @property
    def points(self) -> int:
        """Number of points: the product of the lengths of the axes."""
        return math.prod(len(values) for values in self.axes.values())

    @property
    def count(self) -> int:
        """Number of calibrations."""
        return self.points * self.draws

    def point(self, number: int) -> dict[str, Any]:
        """Return the value of every axis at a point; the last axis changes fastest."""
        found = {}
        for key, values in reversed(self.axes.items()):
            number, index = divmod(number, len(values))
            found[key] = values[index]
        return {key: found[key] for key in self.axes}

    def tasks(self, done: set[int]) -> Iterator[int]:
        """Yield the numbers of the calibrations that are not in `done`: all points of a draw before the next draw."""
        return (number for number in range(self.count) if number not in done)

    def digest(self) -> str:
        """Return what tells this study from any other: a hash of its content and of its scene."""
        content = json.dumps([asdict(self), *map(_table_of, self.scenes)], sort_keys=True, default=str)
        return hashlib.blake2b(content.encode(), digest_size=12).hexdigest()


def load_study(path: str | Path) -> Study:
    """Return the study of a TOML file, checked as far as can be without calibrating."""
    path = Path(path)
    try:
        table = parse_toml(read_bytes(path, what="study"), path)
        study = build(Study, {"title": path.stem, **table}, whole="study")
        study = _with_scenes_beside(study, path.parent)
        for number in () if study.settings else {0, study.points - 1}:
            scene_at(study, study.point(number), study.seed)
    except InputError as error:
        raise error.within(path) from error
    return study


def scene_at(study: Study, point: dict[str, Any], seed: int) -> Scene:
    """Return the scene of a study at a point, with the seed of a draw."""
    values = {**(study.fixed or {}), **point}
    table = _table_of(values.pop(SCENE, study.scene))
    for key, value in values.items():
        if "." in key:
            try:
                change(table, key, value)
            except InputError as error:
                where = f"{'axes' if key in point else 'fixed'}.{key}"
                raise InputError(error.problem, error.remedy, key=where, value=value) from None
    scene = build(Scene, {**table, "seed": seed})
    changed = {key: value for key, value in values.items() if "." not in key}
    parameters = asdict(parameters_of(scene)) | changed
    if "absorption" in changed and parameters["walls"] != "absorbing":
        problem = f"absorption has no effect on {parameters['walls']} walls"
        raise InputError(problem, 'add walls = "absorbing" below [fixed]', key="absorption")
    return with_parameters(scene, SceneParameters(**parameters))


def reverberation_time(room: Room, duration: float) -> float:
    """Return in which time the sound falls by 60 dB, s, in recordings of a `duration`, s, weighted as a scene does.

    The walls absorb as in a diffuse field (Eyring), with what they absorb at normal incidence. The window takes the
    rest.
    """
    window = math.log(1e3) / SPECTRUM.decay * duration
    if room.walls != "absorbing" or not room.admittance:
        return window
    if room.dimension == 3 and room.size is not None:
        x, y, z = (*room.size, 1.0)[:3]
        path = 2 * x * y * z / (x * y + y * z + z * x)  # between two reflections, 4 V / S
    else:
        corners = room.vertices
        path = math.pi * room.area / np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).sum()
    lost = -2 * math.log(abs((1 - room.admittance) / (1 + room.admittance)) or 1e-12)
    return float(min(window, math.log(1e6) * path / (room.sound_speed * lost)))


def describe(study: Study) -> list[str]:
    """Return in lines what is the same at all points of a study: rooms, walls, reverberation, and what is drawn."""
    lines, axes = [], study.axes
    for name in study.scenes:
        scene = scene_at(study, {**study.point(0), **({SCENE: name} if SCENE in axes else {})}, study.seed)
        room = scene.room
        size = " x ".join(f"{length:g}" for length in room.size or np.ptp(room.vertices, axis=0))
        walls = f"{room.walls} walls"
        if "walls" in axes or "absorption" in axes:
            walls = "walls as below; at the first point"
        seconds = reverberation_time(room, scene.emitter.duration)
        lines.append(
            f"scene {scene.name}: {scene.array.number} microphones unless stated below, in a room of {size} m,"
            f" {walls}, a decay by 60 dB in {seconds:.2g} s"
        )
    alike: dict[str, list[str]] = {}
    for one in study.settings:
        size = " x ".join(f"{length:g}" for length in one.room)
        walls = f"rigid walls, a decay by 60 dB in {math.log(1e3) / RIGID_DECAY:.2g} s"
        if one.absorption:
            rooms = [Room(size=one.room, walls="absorbing", admittance=admittance_of(a)) for _, a in one.absorption]
            seconds = [reverberation_time(room, math.inf) for room in rooms]
            absorbed = [100 * a for _, a in one.absorption]
            walls = f"walls that absorb {min(absorbed):g} to {max(absorbed):g} %, a decay by 60 dB in"
            walls += f" {max(seconds):.2g} to {min(seconds):.2g} s"
        alike.setdefault(f"in a room of {size} m, {walls}", []).append(one.name)
    lines += [f"{room}: {'; '.join(names)}" for room, names in alike.items()]
    lines += [f"{key} = {value}" for key, value in (study.fixed or {}).items()]
    if study.drawn.source:
        lines.append(f"the source at a random place, {study.drawn.least_distance:g} m from the microphones at least")
    return lines


def _with_scenes_beside(study: Study, folder: Path) -> Study:
    """Return the study with the full paths of those of its scenes that are files beside its own."""

    def beside(scene: str) -> str:
        path = folder / str(scene)
        return str(path.resolve()) if path.suffix == ".toml" and path.is_file() else scene

    if study.settings:
        return study
    if study.scene:
        return replace(study, scene=beside(study.scene))
    return replace(study, axes={**study.axes, SCENE: [beside(scene) for scene in study.axes[SCENE]]})


def _table_of(scene: str) -> dict:
    loaded = load_scene(scene)  # refuses what is no scene, with its words
    if isinstance(loaded, MeasuredScene):
        problem = f"{loaded.name} is a measurement, and a study simulates"
        raise InputError(problem, "give a scene that is simulated", key="scene", value=scene)
    return scene_table(scene)


RIGID_DECAY = 3.0  # 1/s, of the sound between rigid walls


def admittance_of(absorption: float) -> float:
    """Return the admittance of walls that absorb a fraction of the energy at normal incidence."""
    reflection = (1 - absorption) ** 0.5
    return (1 - reflection) / (1 + reflection)


PACKAGE = Path(__file__).parents[2]
PARTS = ("acoustics", "assessment", "cost", "model", "session", "solvers")  # what a row depends on
GIT_SECONDS = 10.0


@dataclass(frozen=True)
class CodeVersion:
    """The code that computes rows."""

    version: str  # of fdcal
    source: str  # hash of the modules that a row depends on
    # that changed the package last, with "+" where files were changed since; None outside a repository
    commit: str | None


def version_text(version: str, source: str, commit: str | None) -> str:
    """Return the code of some rows in words."""
    return f"fdcal {version}, sources {source}" + (f", commit {commit}" if commit else "")


@cache
def code_version() -> CodeVersion:
    """Return the version of the code of this process, as its files are at the first call."""
    commit = _git(PACKAGE, "log", "-1", "--format=%h")
    changed = "+" if commit and _git(PACKAGE, "status", "--porcelain") else ""
    return CodeVersion(version("fdcal"), source_hash(PACKAGE), commit and commit + changed)


def source_hash(package: Path) -> str:
    """Return a hash of the modules in the PARTS of a folder: names and contents, line ends apart."""
    found = hashlib.blake2b(digest_size=8)
    for path in sorted(path for part in PARTS for path in (package / part).rglob("*.py")):
        found.update(path.relative_to(package).as_posix().encode())
        found.update(path.read_bytes().replace(b"\r\n", b"\n"))
    return found.hexdigest()


def _git(folder: Path, *words: str) -> str | None:
    """Return what git says of a folder; None where it says nothing, or there is none."""
    command = ["git", "-C", str(folder), *words, "--", "."]
    try:
        found = subprocess.run(command, capture_output=True, text=True, timeout=GIT_SECONDS, check=False)
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip() or None
