"""The pages of a gallery: a replay of the paper's Fig. 1, and the lessons.

The page of a lesson shows, for each step, its text, its question and its answer beside a run. The page contains one run
for each scene of the lesson. A step has one part before its answer and one after it; each part shows some states of one
run (`replay_page/lesson.js`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..acoustics.measure import cached_measurement
from ..assessment.findings import root_mean_square
from ..assessment.uncertainty import confidence_factor, ellipse_axes
from ..assessment.words import state_error_words
from ..cost.eq7 import reference_cost_of
from ..graphics.lesson_panels import lesson_panel
from ..graphics.marks import MARKS
from ..graphics.picture import ellipse_scale, focus_of
from ..graphics.replay import index_html, page_html, picture_of, replay_html, run_data
from ..model.address import SOLVER
from ..model.measurement import Measurement
from ..model.problem import Problem
from ..model.scene import Scene
from ..model.validation import InputError, length_text, parse_modes
from ..session.calibration_run import assess_state, counted_microphones, problem_of, states_of
from ..session.lesson import Lesson, LessonSetting, load_lesson, paragraphs, states_of_lesson
from ..session.session import recorded
from ..session.sources import CalibrationInput, with_settings
from ..solvers.interface import RunState
from .options import scene_of

MAX_BYTES = 1_000_000  # largest size of the replay of Fig. 1
TITLE = "Microphone positions from the resonances of a room"
INTRODUCTION = (
    "fdcal finds where the microphones of an array are, from what they record of a reverberant room. Each picture opens"
    " a run or a lesson that plays in this browser. The address of a page contains what it shows, so you can link to"
    " any moment."
)


# The run that plays above the index: the paper's Fig. 1, with the map of one microphone at one frequency.
SCENE, MICROPHONE, MODE = "fig1_square", 16, 92
RUN_TITLE = "Fig. 1: many minima"
RUN_TEXT = (
    "At one frequency, eight places fit microphone 16. Add more frequencies with the slider Frequencies until one place"
    " is left. Drag the microphone, and let it go."
)
# Lessons in the index, and their descriptions.
LESSONS = {
    "1_many_minima": "Why one frequency is not enough: a question, an answer, and a microphone to drag.",
    "2_joint_minimum": "Add frequencies one after the other, and one minimum is left.",
    "3_too_many_too_soon": "Sixteen microphones at random starts: take the steps of the paper's method yourself.",
    "4_frozen_grid": "Why descent on a grid stops before it reaches the true positions, and which method reaches them.",
    "5_corner_or_centre": "How the error grows with the distance from the known microphones: the paper's Fig. 5.",
    "6_noise_and_error_bars": "What noise does, and whether the error ellipses contain the true positions.",
    "7_one_bad_channel": "A swapped cable: how you notice it, and which method names the channel.",
    "8_second_place": "What a second position of the loudspeaker brings.",
}
Progress = Callable[..., None]


def gallery_pages(progress: Progress) -> Iterator[tuple[str, str]]:
    """Yield name and text of each file, the index last; `progress` gets the fraction done and a note."""
    entries, count = list[tuple[str, ...]](), len(LESSONS) + 1
    files = [f"lesson-{number}.html" for number, _ in enumerate(LESSONS, 1)]
    for i, (name, text) in enumerate(LESSONS.items()):
        progress(i / count, name)
        lesson = load_lesson(name)
        page, picture = lesson_html(lesson, files[i + 1] if i + 1 < len(files) else "")
        figures = f"lesson, {len(lesson.steps)} steps, {len(page) / 1e6:.2f} MB"
        entries.append((files[i], f"Lesson {lesson.title}", text, figures, picture))
        yield files[i], page
    progress(len(LESSONS) / count, SCENE)
    address = f"step=0&microphone={MICROPHONE}&modes={MODE}&view=top"
    inputs = with_settings(scene_of(SCENE), "descent", None, None)
    states, problem, measurement = recorded(states_of(inputs)), problem_of(inputs), inputs.measurement
    sought = counted_microphones(inputs, states[-1])
    page = replay_html(
        inputs.scene, measurement, states, RUN_TITLE, reference_cost_of(problem), sought, problem=problem,
        microphone=MICROPHONE, max_bytes=MAX_BYTES, opens_at=address,
    )  # fmt: skip
    picture = picture_of(measurement, problem, states[-1], MICROPHONE, (MODE,), sought)
    errors = measurement.errors(states[-1].positions)
    away = state_error_words(measurement, None if errors is None else errors[sought])
    figures = f"descent, {away}, {len(page) / 1e6:.2f} MB"
    entries.append((f"fig1.html#{address}", RUN_TITLE, RUN_TEXT, figures, picture))
    yield "fig1.html", page
    yield "index.html", index_html(TITLE, INTRODUCTION, entries, f"fig1.html#{address}&opening=on&embed=on")
    progress(1.0, "written")


CAMERAS = {"top": "top", "3d": "3d", "close": "3d"}
MAX_LESSON_BYTES = 2_000_000


def lesson_html(lesson: Lesson, following: str = "", measurement: Measurement | None = None) -> tuple[str, str]:
    """Return the page of a lesson and a picture of its first map; `following`: address of the next lesson's page.

    Steps that show a standing wave are left out, because the page can compute only maps of the cost.

    `measurement`: the measurement of the lesson's only scene; without it, the scenes are simulated.
    """
    lesson = replace(lesson, steps=tuple(step for step in lesson.steps if step.page.map != "shape"))
    scenes, groups, steps = list[tuple[Scene, int]](), list[list[LessonSetting]](), list[dict]()
    for number, step in enumerate(lesson.steps):
        for setting, revealed in zip(step.parts, (False, True), strict=False):
            if setting.begins and (start := lesson.start(number, revealed)) is not None:
                scenes.append(start)
                groups.append([])
            groups[-1].append(setting)
        words = {"text": paragraphs(step.text), "question": step.question, "choices": list(step.choices)}
        steps.append(words | {"answer": step.answer - 1, "reveal": paragraphs(step.reveal)})
    runs, parts, picture = list[dict](), list[dict](), ""
    for number, (start, settings) in enumerate(zip(scenes, groups, strict=True)):
        data, shown, drawn = _lesson_run(*start, settings, measurement, MAX_LESSON_BYTES // len(groups))
        runs.append(data)
        parts += [part | {"run": number} for part in shown]
        picture = picture or drawn
    rest = iter(parts)
    for step, table in zip(lesson.steps, steps, strict=True):
        table["parts"] = [next(rest) for _ in step.parts]
    return page_html(lesson.title, runs, lesson={"steps": steps, "following": following}), picture


def _lesson_run(
    scene: Scene, seed: int, settings: Sequence[LessonSetting], measurement: Measurement | None, max_bytes: int
) -> tuple[dict, list[dict], str]:
    """Return the data of the run that some parts of a lesson show, these parts, and an image of the first map."""
    measurement = cached_measurement(scene) if measurement is None else measurement
    problem = measurement.problem(scene.solver.weights, scene.solver.known)
    states, parts, panel, ellipses = list[RunState](), list[dict](), "none", False
    shown = states_of_lesson(settings, problem, scene.solver, seed)
    inputs = CalibrationInput(scene.name, scene, measurement, shown[-1][-1].settings, seed)
    needed = any(one.ellipses or one.panel in ("prediction", "channels") for one in settings)
    found = assess_state(inputs, problem, shown[-1][-1]) if needed and shown[-1][-1].finished else None
    for setting, run in zip(settings, shown, strict=True):
        part = _part(setting.unfolded(), problem) | {"range": [len(states), len(states) + len(run) - 1]}
        states += run
        panel, ellipses = setting.panel or panel, ellipses or bool(setting.ellipses)
        ended = found if run[-1] is shown[-1][-1] else None
        part["panel"] = lesson_panel(panel, measurement, list({id(one): one for one in states}.values()), ended)
        parts.append(part)
    data = run_data(
        scene, measurement, states, reference_cost_of(problem), problem=problem, max_bytes=max_bytes, parts=parts
    )
    if ellipses and found is not None:  # those of the last state: two half axes each, as drawn, and the legend
        axes = ellipse_axes(found.covariance, confidence_factor(0.95, measurement.array_dimension))
        x0, y0, x1, y1 = focus_of(measurement)
        scale = ellipse_scale(axes, max(x1 - x0, y1 - y0))
        sigma = root_mean_square(np.delete(found.uncertainty, measurement.known))
        drawn = scale * np.pad(axes[:, -2:], ((0, 0), (0, 0), (0, 3 - axes.shape[2])))
        enlarged = f", drawn {scale:g} times larger" if scale > 1 else ""
        text = f"{MARKS['ellipses'].text}{enlarged}; one sigma {length_text(sigma, 2)}"
        data["ellipses"] = {"axes": np.round(drawn, 6).tolist(), "text": text}
    first = settings[0].unfolded()
    n = int(problem.free[0]) if first.microphone is None else first.microphone
    chosen = parse_modes(first.map_modes, len(problem.frequencies)) if first.map_modes not in (None, SOLVER) else ()
    return data, parts, picture_of(measurement, problem, states[0], n, chosen)


def _part(setting: LessonSetting, problem: Problem) -> dict:
    """Return the settings of a part of a step under their names in the replay; a missing setting changes nothing."""
    values: dict = {
        "microphone": -1 if setting.follow else setting.microphone,
        "objective": None if setting.quantity is None else setting.quantity == "objective",
        "map": None if setting.map is None else setting.map != "none",
        "minima": setting.minima,
        "trails": setting.trails,
        "ellipses": setting.ellipses,
        "marks": list(setting.marks) or None,
        "view": None if setting.view is None else CAMERAS[setting.view],
    }
    part = {name: value for name, value in values.items() if value is not None}
    if (text := setting.map_modes) == SOLVER:
        part["modes"] = None
    elif text is not None:
        modes = parse_modes(text, len(problem.frequencies))
        if modes != tuple(range(modes[0], modes[-1] + 1)):
            raise InputError(f'map_modes = "{text}" has gaps', "give one range, such as 1-20", key="map_modes")
        part["modes"] = [modes[0], modes[-1]]
    return part
