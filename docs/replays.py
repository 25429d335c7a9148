"""The replays that pages of the documentation show. Each build computes them, which takes a second or two for each.

The measurement of Fig. 1 comes with fdcal; that of the tutorial is simulated in less than a second.
"""

from __future__ import annotations

from pathlib import Path

import fdcal
from fdcal.commands.gallery_pages import MAX_BYTES, MICROPHONE, RUN_TITLE, SCENE, lesson_html
from fdcal.cost.eq7 import reference_cost_of
from fdcal.graphics.replay import replay_html
from fdcal.model.measurement import load_measurement
from fdcal.model.scene import load_scene
from fdcal.session.calibration_run import problem_of, states_of
from fdcal.session.lesson import load_lesson
from fdcal.session.session import recorded
from fdcal.session.sources import CalibrationInput
from fdcal.viewer.opening import MEASUREMENT


def fig1() -> str:
    """The paper's Fig. 1, as in the gallery."""
    scene = load_scene(SCENE)
    inputs = CalibrationInput(scene.name, scene, load_measurement(MEASUREMENT), scene.solver, scene.seed)
    states = recorded(states_of(inputs))
    problem = problem_of(inputs)
    return replay_html(
        scene, inputs.measurement, states, RUN_TITLE, reference_cost_of(problem), problem=problem,
        microphone=MICROPHONE, max_bytes=MAX_BYTES,
    )  # fmt: skip


def lesson() -> str:
    """Lesson 1."""
    return lesson_html(load_lesson("1_many_minima"), measurement=load_measurement(MEASUREMENT))[0]


def plate() -> str:
    """The result of the tutorial "Your first recording"."""
    return fdcal.calibrate(fdcal.load("tiny")).show().html


REPLAYS = {"fig1": fig1, "lesson-1": lesson, "plate": plate}


def write(folder: Path) -> None:
    """Write all of them to a folder."""
    folder.mkdir(exist_ok=True)
    for name, page in REPLAYS.items():
        (folder / f"{name}.html").write_text(page(), encoding="utf-8")
