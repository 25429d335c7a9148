"""Lessons: files of steps, each with a text, a question and settings of the page.

LessonSetting, LessonStep, Lesson   what a file holds; `load_lesson` reads and checks it
LessonProgress          where in the lessons the page is
states_of_lesson        the runs that a page of the gallery plays
"""

import difflib
import re
import typing
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from .. import solvers
from ..model.address import SOLVER, Map, Unit, View, parse_address
from ..model.problem import Problem
from ..model.quantities import Seed
from ..model.scene import Scene, folder_of, load_scene
from ..model.settings import SolverSettings
from ..model.storage import parse_text, read_bytes
from ..model.validation import InputError, StorageError, build, naming, parse_modes, shown, within
from ..solvers.interface import RunState
from .scene_edits import edited
from .sources import check_scene

Scale = Literal["log", "linear"]
Quantity = Literal["eq7", "objective"]
Panel = Literal["none", "distance", "prediction", "channels"]
MAX_ORDER_OFFSET = 4  # largest number added to the order of a map (Eq. 3)
MAX_CHOICES = 6  # largest number of choices of one question
MAX_MODE = 9999  # highest number of a mode, counted from 1
FILE_BYTES = 1_000_000  # largest size of a lesson
RUN = re.compile(r"(\d{1,4}) (step|sweep|stage)s?")


@dataclass(frozen=True)
class LessonSetting:
    """The settings that a step makes on the page, in the order of the fields; None leaves a control as it is."""

    # name of a scene that comes with fdcal, or a .toml file beside the lesson; the solver restarts
    scene: str | None = None
    # keys of the scene and their values, such as {"solver.name": "descent", "gauge.known": [0, 1, 3]}
    changes: dict | None = None
    start_seed: Seed | None = None  # seed of the solver's start; that of the scene unless given
    reset: bool | None = None  # restart in the same scene
    modes: str | None = None  # modes that the solver uses, such as "1-20"
    automatic: bool | None = None  # whether the solver adds modes by itself
    run: str | None = None  # how far the solver runs: "end", "3 sweeps", "1 step", "2 stages"
    # a state of the run and a view, written as in an address: "step=12&microphone=9"
    frame: str | None = None
    microphone: int | None = None  # number, from 0, of the microphone whose map is shown
    follow: bool | None = None  # whether the map is that of the microphone which the solver moves
    map: Map | None = None
    map_modes: str | None = None  # modes of the map: "38", "1-9, 12" or "solver", those that the solver uses
    quantity: Quantity | None = None  # what the map shows: Eq. 7, or what the solver minimises
    # number added to ceil(k R), the order of each mode, in a map of Eq. 7
    order_offset: Annotated[int, within(0, MAX_ORDER_OFFSET)] | None = None
    scale: Scale | None = None  # colour scale of the map
    minima: bool | None = None  # whether the local minima of the map are marked and counted
    # trails, ellipses: whether the paths of the estimates and the error ellipses are drawn
    trails: bool | None = None
    ellipses: bool | None = None
    verdict: bool | None = None  # whether the result is assessed, and faulty channels are marked
    panel: Panel | None = None  # the plot or list below the text
    marks: tuple[int, ...] = ()  # microphones that are marked, with their errors, after the run has ended
    view: View | None = None

    @property
    def begins(self) -> bool:
        """Whether the step loads a scene, changed or not."""
        return bool(self.scene or self.changes or self.start_seed is not None)

    @staticmethod
    def optional(table: dict) -> Iterable[str]:
        """Return the keys that may be missing: all."""
        return LessonSetting.__dataclass_fields__

    def modes_in_use(self, state: RunState, count: int) -> tuple[int, int, bool] | None:
        """Return the first and the last mode, and whether the solver adds more; None to change nothing.

        `count`: number of modes of the measurement.
        """
        if self.modes is None and self.automatic is None:
            return None
        modes = range(state.first, state.last + 1) if self.modes is None else parse_modes(self.modes, count)
        return modes[0], modes[-1], state.automatic if self.automatic is None else self.automatic

    def unfolded(self) -> "LessonSetting":
        """Return the setting with the values of its `frame` in the fields that are not set."""
        if self.frame is None:
            return self
        parts, values = parse_address(self.frame), dict[str, typing.Any]()
        if parts.get("microphone", "none") != "none":
            values |= {"microphone": int(parts["microphone"]), "follow": False}
        if "trails" in parts:
            values["trails"] = parts["trails"] == "on"
        if (commas := parts.get("view", "").count(",")) < 9 and "view" in parts:  # 9: a camera, which suits one window
            values["view"] = "3d" if commas else parts["view"]
        values |= {name: parts[key] for key, name in (("map", "map"), ("modes", "map_modes")) if key in parts}
        given = {name: value for name, value in vars(self).items() if value not in (None, ())}
        return LessonSetting(**(values | given))


@dataclass(frozen=True)
class LessonStep:
    """Text, a question and settings.

    `page` applies when the step is shown, `then` when the answer is revealed; `answer` counts from 1.
    """

    text: str
    question: str = ""
    choices: tuple[str, ...] = ()
    answer: int = 0
    reveal: str = ""
    page: LessonSetting = field(default_factory=LessonSetting)
    then: LessonSetting = field(default_factory=LessonSetting)

    OPTIONAL: typing.ClassVar = ("question", "choices", "answer", "reveal", "page", "then")

    @property
    def parts(self) -> tuple[LessonSetting, ...]:
        """The settings before and after the answer; only those before it where the step has no question."""
        return (self.page, self.then) if self.question else (self.page,)


@dataclass(frozen=True)
class Lesson:
    """Title and steps of a lesson; `name` and `folder` are those of its file and not keys of it."""

    title: str
    steps: tuple[LessonStep, ...]
    name: str = ""
    folder: str = ""

    OPTIONAL: typing.ClassVar = ("name", "folder")

    def start(self, number: int, revealed: bool = False) -> tuple[Scene, int] | None:
        """Return the scene and the seed of step `number`, counted from 0, before or after its answer is revealed.

        The last step with `scene`, `changes` or `start_seed` determines it: its changes, if any, apply to the last
        scene named, and those of earlier steps do not. The result is None if no step up to this one names a scene.
        """
        name, last = None, None
        every = [setting for step in self.steps[: number + 1] for setting in (step.page, step.then)]
        for setting in every[: None if revealed else -1]:
            name = setting.scene or name
            last = (name, setting) if name and setting.begins else last
        if last is None:
            return None
        path = Path(self.folder) / last[0] if last[0].endswith(".toml") else last[0]
        scene = edited(load_scene(path), last[1].changes or {})
        return scene, scene.seed if last[1].start_seed is None else last[1].start_seed


@dataclass(frozen=True)
class LessonProgress:
    """Where in the lessons the page is."""

    lesson: Lesson | None = None
    number: int = 0  # number of the step, from 0
    choice: int = -1  # the answer chosen, from 0; -1 before one is chosen

    @property
    def step(self) -> LessonStep | None:
        return None if self.lesson is None else self.lesson.steps[self.number]

    def moved(self, steps: int) -> "LessonProgress | None":
        """Return the progress at the beginning of another step; None where the lesson has no such step."""
        number = self.number + steps
        if self.lesson is None or not 0 <= number < len(self.lesson.steps):
            return None
        return LessonProgress(self.lesson, number)

    @property
    def answered(self) -> bool:
        """Whether the question of the step, if it has one, is answered; False without a lesson."""
        return self.step is not None and (self.choice >= 0 or not self.step.choices)


def paragraphs(text: str) -> list[str]:
    """Return the paragraphs of a text, which empty lines separate, each in one line."""
    return [" ".join(part.split()) for part in text.split("\n\n") if part.strip()]


def run_target(run: str) -> tuple[Literal["end"] | Unit, int]:
    """Return what a checked `run` means: ("end", 0), or "step", "sweep" or "stage" and their number."""
    match = RUN.fullmatch(run)
    return (typing.cast(Unit, match[2]), int(match[1])) if match else ("end", 0)


def states_of_lesson(
    parts: Iterable[LessonSetting], problem: Problem, settings: SolverSettings, seed: int
) -> list[list[RunState]]:
    """Return the states that the page shows for each part of a lesson; all parts have the same scene.

    The first state of a part is the one at which it begins, the others are those of its run.
    """
    solver = solvers.load(settings.name)
    state = begun = solver.init(problem, solvers.with_mode_count(problem, settings), seed)
    shown = []
    for setting in parts:
        state = begun if setting.begins or setting.reset else state
        if (used := setting.modes_in_use(state, len(problem.frequencies))) is not None:
            state = solver.use_modes(problem, state, *used)
        run = [state]
        what, count = run_target(setting.run or "0 steps")
        while not state.finished and (what == "end" or getattr(state, what) < getattr(run[0], what) + count):
            state = solver.step(problem, state)
            run.append(state)
        shown.append(run)
    return shown


def lesson_names() -> list[str]:
    """Return the names of the built-in lessons, in their order."""
    return sorted(path.stem for path in folder_of("lessons").glob("*.toml"))


def load_lesson(path: str | Path) -> Lesson:
    """Return the lesson of a TOML file, or a built-in one by its name."""
    path, names = Path(path), lesson_names()
    if path.suffix != ".toml":
        if str(path) not in names:
            near = difflib.get_close_matches(str(path), names, 1)
            remedy = f'did you mean "{near[0]}"?' if near else f"use a .toml file or one of {', '.join(names)}"
            raise InputError(f'lesson "{path}" is unknown', remedy, key="lesson")
        path = folder_of("lessons") / f"{path}.toml"
    table = parse_text(read_bytes(path, FILE_BYTES, "lesson"), "TOML", path)
    with naming(path):
        for key in Lesson.OPTIONAL:
            if key in table:
                raise InputError(f"{key} is not a key of a lesson", "remove it: the path of the file gives it", key=key)
        lesson = build(Lesson, {**table, "name": path.stem, "folder": str(path.parent)}, whole="lesson")
        check(lesson)
        return lesson


Fault = tuple[object, str, str, str]  # whether the fault exists; its key, what is wrong with it, and the remedy


def check(lesson: Lesson) -> None:
    """Raise InputError if a page could not show a lesson."""
    none = not lesson.steps or not lesson.steps[0].page.scene
    remedy = 'name the scene with which the lesson begins, such as "tiny"'
    _refuse("steps[1].", [(none, "page.scene", "is missing", remedy)])
    scene = None
    for number, step in enumerate(lesson.steps):
        prefix, count = f"steps[{number + 1}].", len(step.choices)
        wrong_count = bool(step.question) != bool(count) or count == 1 or count > MAX_CHOICES
        choices = f"give 2 to {MAX_CHOICES} choices with a question, and none without one"
        added = "add a question and choices, or remove `reveal` and the settings of `then`"
        _refuse(prefix, [
            (not step.text.strip(), "text", "is empty", "write a few sentences"),
            (wrong_count, "choices", f"has {count} entries", choices),
            ((count or step.answer) and not 1 <= step.answer <= count, "answer",
             f"= {step.answer} is none of the {count} choices", "count them from 1"),
            (count and not step.reveal.strip(), "reveal", "is empty", "write the answer and the reason"),
            (not count and (step.reveal or step.then != LessonSetting()), "reveal", "has no question before it", added),
        ])  # fmt: skip
        for part, setting in (("page", step.page), ("then", step.then)):
            key = f"{prefix}{part}."
            if setting.begins:
                try:
                    start = lesson.start(number, part == "then")
                    assert start is not None  # the first step names a scene
                    check_scene(start[0])
                except (InputError, StorageError) as error:
                    remedy = error.remedy if isinstance(error, InputError) else "name a scene that can be read"
                    problem = error.problem if isinstance(error, InputError) else error
                    raise InputError(f"{key}scene or {key}changes: {problem}", remedy, key=f"{key}scene") from error
                scene = start[0]
            assert scene is not None
            _check_setting(key, setting, scene)


def _refuse(prefix: str, faults: Iterable[Fault]) -> None:
    """Raise InputError for the first fault of a part of a lesson, whose keys begin with `prefix`."""
    for wrong, key, why, remedy in faults:
        if wrong:
            raise InputError(f"{prefix}{key} {why}", remedy, key=f"{prefix}{key}")


def _check_setting(prefix: str, setting: LessonSetting, scene: Scene) -> None:
    """Raise InputError for settings that a page with this scene cannot have."""
    both = setting.frame is not None and setting.run is not None
    remedy = "run the solver in one step and show the frame in another"
    _refuse(prefix, [(both, "frame", "and run are both given", remedy)])
    with naming(f"{prefix}frame"):
        if setting.frame is not None and not parse_address(setting.frame):
            raise InputError(f'"{shown(setting.frame)}" has no known key', 'write, for example, "step=12&microphone=9"')
        setting = setting.unfolded()
    for name, text in (("modes", setting.modes), ("map_modes", setting.map_modes)):
        if text is None or (name == "map_modes" and text == SOLVER):
            continue
        with naming(f'{prefix}{name} = "{shown(text)}"'):
            modes = parse_modes(text, MAX_MODE)
        gaps = name == "modes" and modes != tuple(range(modes[0], modes[-1] + 1))
        _refuse(prefix, [(gaps, "modes", f'= "{text}" has gaps', "give one range, such as 1-20")])
    count, run = scene.array.number, setting.run
    named = {"microphone": () if setting.microphone is None else (setting.microphone,)}
    _refuse(prefix, [
        (setting.map == "volume" and scene.array.dimension != 3, "map", '= "volume" needs an array in space',
         "name a scene whose array is in space, such as ball3d, or another map"),
        (run not in (None, "end") and not RUN.fullmatch(run or ""), "run", f'= "{run}" is unknown',
         'write "end", or for example "3 sweeps", "1 step" or "2 stages"'),
        *((not 0 <= n < count, key, f"= {n} does not exist", f"{scene.name} has microphones 0 to {count - 1}")
          for key, numbers in (named | {"marks": setting.marks}).items() for n in numbers),
    ])  # fmt: skip
