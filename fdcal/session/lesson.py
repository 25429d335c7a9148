"""A lesson: steps of text and questions, and what each sets on the page.

    Lesson          a title and its steps
    Step            text, a question with its choices and the answer, what is revealed then
    LessonProgress  where in a lesson a page is
    Setting         what a step sets: scene, modes, microphone, map, how far the solver runs, a frame of its run

What a step leaves out stays as it is on the page, including the scene. `fdcal.session.lesson_file` reads a lesson.
"""

from __future__ import annotations

import re
import typing
from dataclasses import dataclass, field
from pathlib import Path

from ..model.scene import Scene
from ..model.scene_file import load_scene
from .lesson_frame import parse_frame
from .request import edited

MAPS = ("flat", "relief", "shape", "basins", "volume", "none")
SCALES = ("log", "linear")
QUANTITIES = ("eq7", "objective")
MAX_ORDER_OFFSET = 4  # of a map
MAX_CHOICES = 6  # of one question
VIEWS = ("top", "3d", "close")
IN_USE = "in use"  # value of map_modes: the modes that the solver uses
RUN = re.compile(r"(\d{1,4}) (step|sweep|stage)s?")


@dataclass(frozen=True)
class Setting:
    """What a step sets on the page, in this order; None leaves a control as it is."""

    # name of a scene that comes with fdcal, or a .toml file beside the lesson; the solver restarts
    scene: str | None = None
    # keys of the scene and their values, as {"solver.name": "descent", "gauge.known": [0, 1, 3]}
    changes: dict | None = None
    start_seed: int | None = None  # of the solver's start; the scene's unless given
    reset: bool | None = None  # restart in the same scene
    modes: str | None = None  # in use by the solver, as "1-20"
    automatic: bool | None = None  # whether the solver adds modes by itself
    run: str | None = None  # "end", or so far as "3 sweeps", "1 step", "2 stages"
    # of the run, as the address of a replay names it, "step=12&microphone=9"; see `lesson_frame`
    frame: str | None = None
    microphone: int | None = None  # whose map is shown, from 0
    follow: bool | None = None  # whether the map is that of the microphone which the solver moves
    map: str | None = None  # one of MAPS
    map_modes: str | None = None  # modes of the map alone, as "38" or "1-9, 12", or "in use"
    quantity: str | None = None  # of the map, one of QUANTITIES: Eq. 7, or what the solver minimises
    order_offset: int | None = None  # of the map of Eq. 7, added to ceil(k R) in the order of every mode
    scale: str | None = None  # of the map, one of SCALES
    minima: bool | None = None  # whether the local minima of the map are marked and counted
    # trails, ellipses: drawn or not
    trails: bool | None = None
    ellipses: bool | None = None
    view: str | None = None  # one of VIEWS

    @property
    def begins(self) -> bool:
        """Whether the step loads a scene, changed or not."""
        return bool(self.scene or self.changes or self.start_seed is not None)

    OPTIONAL: typing.ClassVar = (
        "scene", "changes", "start_seed", "reset", "modes", "automatic", "run", "frame", "microphone", "follow",
        "map", "map_modes", "quantity", "order_offset", "scale", "minima", "trails", "ellipses", "view",
    )  # fmt: skip

    def unfolded(self) -> Setting:
        """Return the setting with the values of its frame, where they are not given by themselves."""
        if self.frame is None:
            return self
        frame = parse_frame(self.frame)
        own = {name: value for name, value in vars(self).items() if value is not None}
        values = {
            "microphone": frame.microphone,
            "follow": None if frame.microphone is None else False,
            "map": "none" if frame.map is False else None,
            "map_modes": IN_USE if frame.modes == "solver" else frame.modes,
            "trails": frame.trails,
            "view": frame.view,
        }
        return Setting(**(values | own))


@dataclass(frozen=True)
class Step:
    """Text, a question and settings.

    `page` applies when the step is shown, `then` with the reveal; `answer` counts from 1.
    """

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
    """Title and steps; `name` and `folder` are those of its file and are not written in it."""

    title: str
    steps: tuple[Step, ...]
    name: str = ""
    folder: str = ""

    OPTIONAL: typing.ClassVar = ("name", "folder")

    def start(self, number: int, revealed: bool = False) -> tuple[Scene, int] | None:
        """Return the scene and the seed of step `number`, counted from 0, before or after its reveal.

        The last step with a `scene` or `changes` counts; changes alone apply to the last scene named. None if no step
        up to this one names a scene.
        """
        name, last = None, None
        for setting in _settings(self.steps[: number + 1])[: None if revealed else -1]:
            name = setting.scene or name
            last = (name, setting) if name and setting.begins else last
        if last is None:
            return None
        scene = edited(load_scene(_path(last[0], self.folder)), last[1].changes or {})
        return scene, scene.seed if last[1].start_seed is None else last[1].start_seed


@dataclass(frozen=True)
class LessonProgress:
    """Where in the lessons the page is."""

    lesson: Lesson | None = None
    number: int = 0  # of the step, from 0
    choice: int = -1  # the answer chosen, from 0; -1 before one is chosen

    @property
    def step(self) -> Step | None:
        return None if self.lesson is None else self.lesson.steps[self.number]

    def moved(self, steps: int) -> LessonProgress | None:
        """Return the progress at the beginning of another step; None where the lesson has no such step."""
        number = self.number + steps
        if self.lesson is None or not 0 <= number < len(self.lesson.steps):
            return None
        return LessonProgress(self.lesson, number)

    @property
    def answered(self) -> bool:
        """Whether the step asks nothing that has no answer yet; False without a lesson."""
        return self.step is not None and (self.choice >= 0 or not self.step.choices)


def _settings(steps) -> list[Setting]:
    return [setting for step in steps for setting in (step.page, step.then)]


def _path(name: str, folder: str) -> str | Path:
    """Return the name of a scene, or its file beside the lesson."""
    return Path(folder) / name if name.endswith(".toml") else name


def run_goal(run: str) -> tuple[str, int]:
    """Return what a checked `run` asks for: ("end", 0), or "step", "sweep" or "stage" and how many."""
    match = RUN.fullmatch(run)
    return (match[2], int(match[1])) if match else ("end", 0)
