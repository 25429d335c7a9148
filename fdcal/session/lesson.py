"""A lesson: steps of text and questions, and what each sets on the page; read from one TOML file.

    Lesson   a title and its steps
    Step     text, a question with its choices and the answer, what is revealed then
    Setting  what a step sets: scene, modes, microphone, map, how far the solver runs

Whatever a step leaves out stays as it is on the page, the scene among it.
"""

from __future__ import annotations

import difflib
import re
import tomllib
import typing
from dataclasses import dataclass, field
from pathlib import Path

from ..model import mode_ranges
from ..model.arrays import positions_of
from ..model.from_table import build
from ..model.scene import Scene
from ..model.scene_file import load_scene
from ..model.validation import InputError, StorageError, require_choice
from .request import edited

MAPS = ("flat", "relief", "shape", "none")
SCALES = ("log", "linear")
VIEWS = ("top", "3d", "close")
IN_USE = "in use"  # of map_modes: those that the solver uses
RUN = re.compile(r"(\d{1,4}) (step|sweep|stage)s?")
MOST_MODES = 9999
MOST_STEPS, MOST_CHOICES, LONGEST = 50, 6, 5000  # steps, choices of one, characters of a text
MOST_BYTES = 1_000_000  # of a file


@dataclass(frozen=True)
class Setting:
    """What is set on the page, in this order; None leaves it.

    Attributes
    ----------
    scene : name of a scene that comes with fdcal, or a .toml file beside the lesson; it starts anew
    changes : keys of the scene and their values, as {"solver.name": "descent", "gauge.known": [0, 1, 3]}
    start_seed : of the solver's start; the scene's unless given
    reset : start anew in the same scene
    modes : in use by the solver, as "1-20"
    automatic : whether the solver adds modes by itself
    run : "end", or so far as "3 sweeps", "1 step", "2 stages"
    microphone : whose map is shown, from 0
    follow : whether the map is that of the microphone which the solver moves
    map : one of MAPS
    map_modes : modes of the map alone, as "38" or "1-9, 12", or "in use"
    scale : of the map, one of SCALES
    trails, ellipses : drawn or not
    view : one of VIEWS
    """

    scene: str | None = None
    changes: dict | None = None
    start_seed: int | None = None
    reset: bool | None = None
    modes: str | None = None
    automatic: bool | None = None
    run: str | None = None
    microphone: int | None = None
    follow: bool | None = None
    map: str | None = None
    map_modes: str | None = None
    scale: str | None = None
    trails: bool | None = None
    ellipses: bool | None = None
    view: str | None = None

    @property
    def begins(self) -> bool:
        """Whether a scene is begun anew, changed or not."""
        return bool(self.scene or self.changes or self.start_seed is not None)

    OPTIONAL: typing.ClassVar = (
        "scene", "changes", "start_seed", "reset", "modes", "automatic", "run", "microphone", "follow", "map",
        "map_modes", "scale", "trails", "ellipses", "view",
    )  # fmt: skip


@dataclass(frozen=True)
class Step:
    """What is read, asked and set. `page` is set when the step comes, `then` with the reveal; `answer` from 1."""

    text: str
    question: str = ""
    choices: tuple[str, ...] = ()
    answer: int = 0
    reveal: str = ""
    page: Setting = field(default_factory=Setting)
    then: Setting = field(default_factory=Setting)

    OPTIONAL: typing.ClassVar = ("question", "choices", "answer", "reveal", "page", "then")


@dataclass(frozen=True)
class Lesson:
    """Title and steps; `name` and `folder` are those of its file, and not in it."""

    title: str
    steps: tuple[Step, ...]
    name: str = ""
    folder: str = ""

    OPTIONAL: typing.ClassVar = ("name", "folder")

    def start(self, number: int, revealed: bool = False) -> tuple[Scene, int] | None:
        """Scene and seed that step `number` (from 0) stands on, before or after its reveal; None where none is named.

        The last step with a `scene` or `changes` counts; changes alone are of the last scene named.
        """
        name, last = None, None
        for setting in _settings(self.steps[: number + 1])[: None if revealed else -1]:
            name = setting.scene or name
            last = (name, setting) if name and setting.begins else last
        if last is None:
            return None
        scene = edited(load_scene(_path(last[0], self.folder)), last[1].changes or {})
        return scene, scene.seed if last[1].start_seed is None else last[1].start_seed


def _settings(steps) -> list[Setting]:
    return [setting for step in steps for setting in (step.page, step.then)]


def _path(name: str, folder: str) -> str | Path:
    """A scene's name, or its file beside the lesson."""
    return Path(folder) / name if name.endswith(".toml") else name


def lesson_folder() -> Path:
    """Folder of the lessons that come with fdcal: in the checkout, or inside an installed package."""
    beside = Path(__file__).parents[1] / "lessons"
    return beside if beside.is_dir() else Path(__file__).parents[2] / "lessons"


def lesson_names() -> list[str]:
    """Names of the lessons that come with fdcal, in their order."""
    return sorted(path.stem for path in lesson_folder().glob("*.toml"))


def load_lesson(path: str | Path) -> Lesson:
    """Lesson from a TOML file, or by the name of one that comes with fdcal.

    Raises InputError, one line with the file, the key, its value and the remedy, and StorageError.
    """
    path = Path(path)
    if path.suffix != ".toml":
        near = difflib.get_close_matches(str(path), lesson_names(), 1)
        if str(path) not in lesson_names():
            remedy = f'did you mean "{near[0]}"?' if near else f"use a .toml file or one of {', '.join(lesson_names())}"
            raise InputError(f'lesson "{path}" is unknown; {remedy}')
        path = lesson_folder() / f"{path}.toml"
    try:
        if path.stat().st_size > MOST_BYTES:
            raise InputError(f"{path} has more than {MOST_BYTES} bytes; a lesson is a page of text")
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise StorageError(f"cannot read lesson {path}: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is not valid TOML: {error}".replace("\n", " ")) from error
    try:
        for key in Lesson.OPTIONAL:
            if key in table:
                raise InputError(f"{key} is not a key of a lesson; remove it, the file has one")
        lesson = build(Lesson, {**table, "name": path.stem, "folder": str(path.parent)}, whole="lesson")
        check(lesson)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return lesson


def check(lesson: Lesson) -> None:
    """Raise InputError for what no page could do."""
    if not 1 <= len(lesson.steps) <= MOST_STEPS:
        raise InputError(f"steps has {len(lesson.steps)} entries; give 1 to {MOST_STEPS} [[steps]]")
    if lesson.steps[0].page.scene is None:
        raise InputError('steps[1].page.scene is missing; name a scene, as "tiny", that the lesson begins with')
    scene = _scene_of(lesson, 0, False, "steps[1].page")
    for number, step in enumerate(lesson.steps):
        key = f"steps[{number + 1}]"
        _check_question(key, step)
        for part, setting, revealed in (("page", step.page, False), ("then", step.then, True)):
            if setting.begins:
                scene = _scene_of(lesson, number, revealed, f"{key}.{part}")
            _check_setting(f"{key}.{part}", setting, scene)


def _check_question(key: str, step: Step) -> None:
    for name in ("text", "question", "reveal"):
        if len(getattr(step, name)) > LONGEST:
            raise InputError(f"{key}.{name} has {len(getattr(step, name))} characters; use {LONGEST} at most")
    if not step.text.strip():
        raise InputError(f'{key}.text = "" says nothing; write a few sentences')
    count = len(step.choices)
    if bool(step.question) != bool(count) or count == 1 or count > MOST_CHOICES:
        raise InputError(f"{key}.choices has {count} entries; a question has 2 to {MOST_CHOICES}, no question none")
    if (count or step.answer) and not 1 <= step.answer <= count:
        raise InputError(f"{key}.answer = {step.answer} is none of the {count} choices; they count from 1")
    if count and not step.reveal.strip():
        raise InputError(f'{key}.reveal = "" leaves the question open; write the answer and why')
    if not count and (step.reveal or step.then != Setting()):
        raise InputError(f"{key}.reveal has nothing to be revealed after; add a question and choices, or remove it")


def _scene_of(lesson: Lesson, number: int, revealed: bool, key: str) -> Scene:
    try:
        start = lesson.start(number, revealed)
    except (InputError, StorageError) as error:
        raise InputError(f"{key}.scene or {key}.changes: {error}") from error
    if start is None:
        raise InputError(f"{key}.scene is missing", "name a scene", key=f"{key}.scene")
    return start[0]


def _check_setting(key: str, setting: Setting, scene: Scene) -> None:
    for name, choices in (("map", MAPS), ("scale", SCALES), ("view", VIEWS)):
        if getattr(setting, name) is not None:
            require_choice(f"{key}.{name}", getattr(setting, name), choices)
    if setting.modes is not None:
        modes = _modes(f"{key}.modes", setting.modes)
        if modes != tuple(range(modes[0], modes[-1] + 1)):
            raise InputError(f'{key}.modes = "{setting.modes}" has gaps; the solver uses a range, as 1-20')
    if setting.map_modes not in (None, IN_USE):
        _modes(f"{key}.map_modes", setting.map_modes)
    if setting.run not in (None, "end") and not RUN.fullmatch(setting.run):
        raise InputError(f'{key}.run = "{setting.run}" is unknown; write "end", or as "3 sweeps", "1 step", "2 stages"')
    if setting.start_seed is not None and setting.start_seed < 0:
        raise InputError(f"{key}.start_seed = {setting.start_seed} must not be negative; use 0 or more")
    if setting.microphone is not None and not 0 <= setting.microphone < len(positions_of(scene)):
        count = len(positions_of(scene))
        raise InputError(f"{key}.microphone = {setting.microphone} is not there; {scene.name} has 0 to {count - 1}")


def _modes(key: str, text: str) -> tuple[int, ...]:
    try:
        return mode_ranges.parse(text, MOST_MODES)
    except InputError as error:
        raise InputError(f'{key} = "{text}": {error}') from error


def run_goal(run: str) -> tuple[str, int]:
    """What a checked `run` asks for: ("end", 0), or "step", "sweep" or "stage" and how many."""
    match = RUN.fullmatch(run)
    return (match[2], int(match[1])) if match else ("end", 0)
