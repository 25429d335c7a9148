"""What the lessons on noise and on a bad channel say is so: each number in their texts."""

import re

import numpy as np
import pytest

from fdcal import solvers
from fdcal.acoustics.measurement_cache import cached_measurement
from fdcal.assessment.error_ellipses import confidence_factor, ellipse_axes
from fdcal.model.scene_file import load_scene
from fdcal.session.assess import assess
from fdcal.session.blas_threads import one_blas_thread
from fdcal.session.lesson_file import load_lesson
from fdcal.session.request import edited
from fdcal.session.sources import CalibrationInput

NOISE, CHANNEL = "6_noise_and_error_bars", "7_one_bad_channel"


def said(name, step, revealed=True):
    """What a step says, with its reveal, as one line."""
    one = load_lesson(name).steps[step]
    return " ".join(" ".join((one.text, one.question, *one.choices, one.reveal if revealed else "")).split())


class End:
    """The end of a scene's run as the page judges it; errors and error bars are those of the microphones sought, mm."""

    def __init__(self, scene, seed):
        self.measurement, solver = cached_measurement(scene), solvers.load(scene.solver.name)
        problem = self.measurement.problem(scene.solver.weights)
        with one_blas_thread():
            state = solver.init(problem, scene.solver, seed)
            while not state.finished:
                state = solver.step(problem, state)
            inputs = CalibrationInput(scene.name, scene, self.measurement, state.settings, seed)
            self.found = assess(inputs, problem, state)
        self.free, self.positions, self.converged = problem.free, state.positions, state.converged
        self.errors = 1e3 * self.measurement.errors(state.positions)
        self.sought, self.bars = self.errors[self.free], 1e3 * self.found.uncertainty[self.free]


@pytest.fixture(scope="module")
def noisy():
    """The ends at 40 dB and at 20 dB, as the lesson shows them, and without noise."""
    lesson = load_lesson(NOISE)
    scene = edited(lesson.start(0)[0], {"measurement.snr_db": float("inf")})
    return [End(*lesson.start(0)), End(*lesson.start(1)), End(scene, scene.seed)]


def one_sigma(end) -> str:
    """The error bar that the line below the status names, mm."""
    return re.search(r"one sigma ([\d.]+) mm", end.found.verdict_text)[1]


def test_error_and_error_bar_follow_the_noise(noisy):
    some, more, none = noisy
    assert [load_lesson(NOISE).start(i)[0].measurement.snr_db for i in (0, 1)] == [40, 20]
    assert [len(end.free) for end in noisy] == [13] * 3 and all(end.found.verdict == "good" for end in noisy)
    assert [round(value, 1) for value in (some.sought.mean(), some.sought.max())] == [1.8, 3.4]
    assert "1.8 mm on average, 3.4 mm for the worst" in said(NOISE, 0)
    assert round(none.sought.mean(), 1) == 0.9 and "0.9 mm would be left" in said(NOISE, 0)
    assert one_sigma(some) == "2.3" and '"one sigma 2.3 mm"' in said(NOISE, 0)
    assert round(more.sought.mean(), 1) == 7.6 and "from 1.8 to 7.6 mm" in said(NOISE, 1)
    assert one_sigma(more) == "13" and "one sigma from 2.3 to 13 mm" in said(NOISE, 1)
    ratios = more.sought.mean() / some.sought.mean(), more.bars.mean() / some.bars.mean()
    assert max(ratios) < 6 and max(ratios) / min(ratios) < 1.4, "together, and not tenfold"


def test_the_ellipses_contain_what_they_say(noisy):
    some, more, _ = noisy
    axes = ellipse_axes(more.found.covariance, confidence_factor(0.95, 2))[more.free]
    away = (more.positions - more.measurement.positions)[more.free]
    inside = [np.linalg.norm(np.linalg.solve(axis.T, offset)) < 1 for axis, offset in zip(axes, away, strict=True)]
    assert sum(inside) == len(inside) == 13 and "All 13; of many" in said(NOISE, 2)
    assert np.sum(more.sought < more.bars) == 12 and "12 of the 13 errors are smaller" in said(NOISE, 2)
    assert np.sum(some.sought < some.bars) == 7 and "at 40 dB it was 7 of 13" in said(NOISE, 2)


@pytest.fixture(scope="module")
def swapped():
    """The ends of solvers joint and robust with the bad channel, as the lesson shows them."""
    lesson = load_lesson(CHANNEL)
    return End(*lesson.start(0)), End(*lesson.start(2))


def test_a_wrong_sign_carries_its_microphone_away(swapped):
    joint, _ = swapped
    scene, _ = load_lesson(CHANNEL).start(0)
    assert scene.faults.inverted == (11,) and scene.solver.name == "joint"
    assert len(joint.measurement.frequencies[: scene.solver.modes]) == 20 and "at all 20" in said(CHANNEL, 0)
    assert round(joint.errors[11] / 1e3, 1) == 2.1 and "2.1 m from its true position" in said(CHANNEL, 0)
    x, y = joint.positions[11]
    width, depth = scene.room.size
    assert not (0 <= x <= width and 0 <= y <= depth) and "outside the room" in said(CHANNEL, 0)
    assert not joint.converged and "stops before it has converged" in said(CHANNEL, 0), "as the status has it"
    others = joint.errors[np.setdiff1d(joint.free, 11)].mean()
    assert round(others, 1) == 1.4 and "1.4 mm on average" in said(CHANNEL, 0)
    sound = End(edited(load_scene("tiny"), {"solver.name": "joint"}), 0)
    assert round(sound.errors[np.setdiff1d(joint.free, 11)].mean(), 1) == 0.8 and "0.8 mm would be left" in said(
        CHANNEL, 0
    )


def test_the_residuals_name_the_channel(swapped):
    found = swapped[0].found
    assert found.verdict == "odd_channel" and "microphone 11" in found.verdict_text
    errors = np.array(found.evidence.microphones_db)
    assert np.delete(errors, 11).max() < -30 and "to -30 dB or better" in said(CHANNEL, 1)
    assert abs(errors[11]) < 0.5 and "as much as it recorded, 0 dB" in said(CHANNEL, 1)
    assert '"odd channel"' in said(CHANNEL, 1)


def test_the_fault_is_named_and_the_position_found(swapped):
    _, robust = swapped
    channels = robust.found.channels
    assert [(fault.name, fault.kind) for fault in channels.faults] == [("11", "inverted")]
    assert abs(abs(channels.phase_deg[11]) - 180) < 0.5 and "a phase of 180 degrees" in said(CHANNEL, 2)
    assert abs(channels.gain_db[11]) < 0.05 and "a gain of 0 dB" in said(CHANNEL, 2)
    assert round(robust.errors[11], 1) == 0.6 and "0.6 mm off" in said(CHANNEL, 2)
    assert round(robust.sought.mean(), 1) == 0.9 and "the mean of all 13 is 0.9 mm" in said(CHANNEL, 2)
