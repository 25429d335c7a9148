"""A study as a TOML file: draws of a scene over axes of values, or of a list of scenarios."""

import hashlib
import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from fdcal.acoustics.spectrum import SPECTRUM
from fdcal.model.quantities import Count, Seconds, Seed
from fdcal.model.scene import MeasuredScene, Room, Scene, load_scene, scene_table
from fdcal.model.storage import parse_text, read_bytes
from fdcal.model.validation import InputError, build, check, shown, within
from fdcal.session.scene_edits import SceneParameters, change, parameters_of, with_parameters

from .draw import RIGID_DECAY, Scenario, admittance_of

MAX_TASKS = 100_000_000
PARAMETERS = tuple(field.name for field in fields(SceneParameters) if field.name != "seed")
SCENE = "scene"  # the axis whose values are names or paths of scenes
SCENARIO = "scenario"  # the axis of a study of scenarios: their names
OWN = ("point", "draw", "seed")  # names of columns of the table, which no axis may have


@dataclass(frozen=True)
class Drawn:
    """What is drawn for every calibration, in addition to noise, random microphones and the solver's start."""

    source: bool = False  # whether the source is at a random place of the room, the same for one draw at all points
    least_distance: Annotated[float, within(0, 1e12, "m")] = 0.7  # of such a source from every microphone

    OPTIONAL = ("source", "least_distance")


@dataclass(frozen=True)
class Study:
    """Calibrations over the product of some axes, or over some scenarios."""

    title: str
    draws: Count  # calibrations at every point, each with a seed of its own
    axes: dict = field(default_factory=dict)  # at most a few thousand points; for scenarios, their names
    scene: str = ""  # name or path of a scene's file; left out where the axis "scene" names several
    seed: Seed = 0  # seed of the first draw
    fixed: dict | None = None
    drawn: Drawn = Drawn()
    time_limit: Seconds = 60.0  # processor time of one calibration
    scenarios: tuple[Scenario, ...] = ()  # arrays and rooms that are drawn, in place of a scene and axes

    OPTIONAL = ("title", "axes", "scene", "seed", "fixed", "drawn", "time_limit", "scenarios")

    def __post_init__(self):
        check(self)
        if self.scenarios:
            names = [scenario.name for scenario in self.scenarios]
            if self.scene or self.fixed or self.axes.keys() - {SCENARIO}:
                problem = "a study of scenarios has no scene, no axes and nothing fixed"
                raise InputError(problem, "write what is fixed into each of [[scenarios]]", key="scenarios")
            for i, name in enumerate(names):
                if name in names[:i]:
                    raise InputError(f'two scenarios have the name "{shown(name)}"', "rename one", key="scenarios")
            object.__setattr__(self, "axes", {SCENARIO: names})
        else:
            self._check_axes()
        if self.count > MAX_TASKS:
            problem = f"the study has {self.count:.3g} calibrations"
            raise InputError(problem, f"use at most {MAX_TASKS:.0e}", key="draws")

    def _check_axes(self) -> None:
        if not self.axes:
            raise InputError("axes is missing", "write [axes], or [[scenarios]]", key="axes")
        for key, values in self.axes.items():
            if not isinstance(values, list) or not values:
                remedy = f'write it as "{shown(key)}" = [...]'
                raise InputError(f"axes.{shown(key)} is not a list of values", remedy, key=f"axes.{key}")
            kinds = {type(value) for value in values}
            if len(kinds) > 1 and kinds != {int, float}:
                problem = f"axes.{shown(key)} mixes numbers with texts or lists"
                raise InputError(problem, "run a study for each kind", key=f"axes.{key}")
            twice = next((value for i, value in enumerate(values) if value in values[:i]), None)
            if twice is not None:
                problem = f"axes.{shown(key)} has the value {shown(json.dumps(twice))} twice"
                raise InputError(problem, "write each value once", key=f"axes.{key}")
        if bool(self.scene) == (SCENE in self.axes):
            remedy = 'write scene = "NAME", or name several by scene = [...] below [axes]'
            raise InputError("a study has a scene, or an axis of scenes", remedy, key=SCENE)
        for key in (*(key for key in self.axes if key != SCENE), *(self.fixed or {})):
            if key in OWN or ("." not in key and key not in PARAMETERS):
                remedy = f"use a key of the scene, such as solver.modes, or one of {', '.join(PARAMETERS)}"
                raise InputError(f'no scene has the key "{shown(key)}"', remedy, key=f"axes.{shown(key)}")

    def scenario(self, name: str) -> Scenario:
        """Return the scenario of a name."""
        return next(one for one in self.scenarios if one.name == name)

    @property
    def scenes(self) -> list[str]:
        """Names or paths of all its scenes; empty for a study of scenarios."""
        if self.scenarios:
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
        """Return a hash of the content of the study and of its scene, which identifies it."""
        content = json.dumps([asdict(self), *map(_table_of, self.scenes)], sort_keys=True, default=str)
        return hashlib.blake2b(content.encode(), digest_size=12).hexdigest()


def load_study(path: str | Path) -> Study:
    """Return the study of a TOML file, checked as far as possible without a calibration."""
    path = Path(path)

    def beside(scene: str) -> str:  # the full path of a scene that is a file beside the study
        own = path.parent / str(scene)
        return str(own.resolve()) if own.suffix == ".toml" and own.is_file() else scene

    try:
        table = parse_text(read_bytes(path, what="study"), "TOML", path)
        study = build(Study, {"title": path.stem, **table}, whole="study")
        if study.scene:
            study = replace(study, scene=beside(study.scene))
        elif not study.scenarios:
            study = replace(study, axes={**study.axes, SCENE: [beside(scene) for scene in study.axes[SCENE]]})
        for number in () if study.scenarios else {0, study.points - 1}:
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
                raise InputError(error.problem, error.remedy, key=where) from None
    scene = build(Scene, {**table, "seed": seed})
    changed = {key: value for key, value in values.items() if "." not in key}
    parameters = asdict(parameters_of(scene)) | changed
    if "absorption" in changed and parameters["walls"] != "absorbing":
        problem = f"absorption has no effect on {parameters['walls']} walls"
        raise InputError(problem, 'add walls = "absorbing" below [fixed]', key="absorption")
    return with_parameters(scene, SceneParameters(**parameters))


def reverberation_time(room: Room, duration: float) -> float:
    """Return the time, s, in which sound falls by 60 dB in recordings of a `duration`, s, weighted as a scene does.

    The walls absorb as in a diffuse field (Eyring), with their absorption at normal incidence. The result is never
    longer than the decay of the window.
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
    """Return lines on what is the same at all points of a study: rooms, walls, reverberation, and what is drawn."""
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
    for one in study.scenarios:
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
        lines.append(f"the source at a random place, at least {study.drawn.least_distance:g} m from the microphones")
    return lines


def _table_of(scene: str) -> dict:
    loaded = load_scene(scene)  # raises InputError for anything but a scene
    if isinstance(loaded, MeasuredScene):
        problem = f"{loaded.name} is a measurement, but a study simulates"
        raise InputError(problem, "give a scene that is simulated", key="scene")
    return scene_table(scene)
