"""A lesson as a replay: text, question and reveal beside the run that each step shows, in one file without a server.

The runs of all steps are states of one replay, one after the other; each part of a step, before and after its answer,
shows some of them (`replay_page/lesson.js`). So the lesson must have one scene.
"""

from __future__ import annotations

from collections.abc import Sequence

from ..acoustics.measure import cached_measurement
from ..cost.expansion import reference_cost_of
from ..graphics.gallery import picture_of
from ..graphics.replay import replay_html
from ..model.measurement import Measurement
from ..model.problem import Problem
from ..model.validation import InputError, parse_modes
from ..session.lesson import IN_USE, Lesson, Setting, Step, states_of_lesson

CAMERAS = {"top": "top", "3d": "3d", "close": "3d"}


MAX_BYTES = 2_000_000


def lesson_html(lesson: Lesson, following: str = "", measurement: Measurement | None = None) -> tuple[str, str]:
    """Return the page of a lesson and a picture of its first map; `following`: address of the next lesson's page.

    `measurement`: of the lesson's scene, which is simulated unless it is given.
    Raises InputError: the lesson has several scenes.
    """
    start = lesson.start(0)
    settings = [setting for step in lesson.steps for setting in (step.page, step.then)]
    if start is None or any(setting.begins for setting in settings[1:]):
        raise InputError(f'the lesson "{lesson.title}" has several scenes', "choose one that keeps its scene")
    scene, seed = start
    measurement = cached_measurement(scene) if measurement is None else measurement
    problem, states, steps = measurement.problem(scene.solver.weights, scene.solver.known), [], []
    runs = iter(states_of_lesson(lesson, problem, scene.solver, seed))
    for step in lesson.steps:
        parts = []
        for setting in (step.page, step.then) if step.question else (step.page,):
            run = next(runs)
            parts.append(_part(setting.unfolded(), problem) | {"range": [len(states), len(states) + len(run) - 1]})
            states += run
        steps.append(_texts(step) | {"parts": parts})
    page = replay_html(
        scene, measurement, states, lesson.title, reference_cost_of(problem), problem=problem, max_bytes=MAX_BYTES,
        lesson={"steps": steps, "following": following},
    )  # fmt: skip
    first = lesson.steps[0].page.unfolded()
    n = int(problem.free[0]) if first.microphone is None else first.microphone
    chosen = parse_modes(first.map_modes, len(problem.frequencies)) if first.map_modes not in (None, IN_USE) else None
    return page, picture_of(measurement, problem, states[0], n, chosen)


def _texts(step: Step) -> dict:
    return {
        "text": _paragraphs(step.text),
        "question": step.question,
        "choices": list(step.choices),
        "answer": step.answer - 1,
        "reveal": _paragraphs(step.reveal),
    }


def _paragraphs(text: str) -> Sequence[str]:
    return [" ".join(part.split()) for part in text.split("\n\n") if part.strip()]


def _part(setting: Setting, problem: Problem) -> dict:
    """What a part of a step sets, by the names of the replay; what it leaves out stays."""
    values: dict = {
        "microphone": -1 if setting.follow else setting.microphone,
        "objective": None if setting.quantity is None else setting.quantity == "objective",
        "map": None if setting.map is None else setting.map != "none",
        "minima": setting.minima,
        "trails": setting.trails,
        "view": None if setting.view is None else CAMERAS[setting.view],
    }
    part = {name: value for name, value in values.items() if value is not None}
    if setting.map_modes is not None:
        part["modes"] = None if setting.map_modes == IN_USE else _range(setting.map_modes, problem)
    return part


def _range(text: str, problem: Problem) -> list[int]:
    modes = parse_modes(text, len(problem.frequencies))
    if modes != tuple(range(modes[0], modes[-1] + 1)):
        raise InputError(f'map_modes = "{text}" has gaps', "give one range, as 1-20", key="map_modes", value=text)
    return [modes[0], modes[-1]]
