"""What the lessons on noise and on a bad channel say is so: each number in their texts."""

import re

import numpy as np
import pytest

from fdcal import solvers
from fdcal.acoustics.measurement_cache import cached_measurement
from fdcal.assessment.uncertainty import confidence_factor, ellipse_axes
from fdcal.model.scene_file import load_scene
from fdcal.session.blas_threads import one_blas_thread
from fdcal.session.calibrate import assess
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
    assert [round(value, 1) for value in (some.sought.mean(), some.sought.max())] == [1.8, 3.2]
    assert "1.8 mm on average, 3.2 mm for the worst" in said(NOISE, 0)
    assert round(none.sought.mean(), 1) == 0.9 and "0.9 mm would be left" in said(NOISE, 0)
    assert one_sigma(some) == "2.2" and '"one sigma 2.2 mm"' in said(NOISE, 0)
    assert round(more.sought.mean(), 1) == 7.8 and "from 1.8 to 7.8 mm" in said(NOISE, 1)
    assert one_sigma(more) == "11" and "one sigma from 2.2 to 11 mm" in said(NOISE, 1)
    ratios = more.sought.mean() / some.sought.mean(), more.bars.mean() / some.bars.mean()
    assert max(ratios) < 6 and max(ratios) / min(ratios) < 1.4, "together, and not tenfold"


def test_the_ellipses_contain_what_they_say(noisy):
    some, more, _ = noisy
    axes = ellipse_axes(more.found.covariance, confidence_factor(0.95, 2))[more.free]
    away = (more.positions - more.measurement.positions)[more.free]
    inside = [np.linalg.norm(np.linalg.solve(axis.T, offset)) < 1 for axis, offset in zip(axes, away, strict=True)]
    assert sum(inside) == len(inside) == 13 and "All 13; of many" in said(NOISE, 2)
    assert np.sum(more.sought < more.bars) == 10 and "10 of the 13 errors are smaller" in said(NOISE, 2)
    assert np.sum(some.sought < some.bars) == 8 and "at 40 dB it was 8 of 13" in said(NOISE, 2)


@pytest.fixture(scope="module")
def swapped():
    """The ends of solvers descent and robust with the bad channel, as the lesson shows them."""
    lesson = load_lesson(CHANNEL)
    return End(*lesson.start(0)), End(*lesson.start(2))


def test_a_wrong_sign_carries_its_microphone_away(swapped):
    spoilt, text = swapped[0], said(CHANNEL, 0)
    scene, seed = load_lesson(CHANNEL).start(0)
    assert scene.faults.inverted == (11,) and scene.solver.name == "descent"
    assert len(spoilt.measurement.frequencies[: scene.solver.modes]) == 20 and "at all 20" in text
    assert round(spoilt.errors[11] / 10) == 37 and "37 cm from its true position" in text
    top = scene.search.origin[1] + scene.search.size[1]
    assert abs(spoilt.positions[11][1] - top) < 1e-9 and "at the edge of the lattice" in text
    good = np.setdiff1d(spoilt.free, 11)
    assert round(spoilt.errors[good].mean()) == 48 and "twelve are 48 mm off on average" in text
    sound = End(edited(load_scene("tiny"), {"solver.name": "descent"}), seed)
    assert round(sound.errors[good].mean()) == 18 and "18 mm would be left" in text


def test_the_residuals_show_the_channel_among_others_that_it_has_spoilt(swapped):
    found, text = swapped[0].found, said(CHANNEL, 1)
    errors = np.array(found.evidence.microphones_db)
    assert errors.argmax() == 11 and 0.7 < errors[11] < 1.3 and "about 1 dB" in text
    assert np.sum(np.delete(errors, 11) > -9) >= 3 and "three good ones" in text and "than -9 dB" in text
    assert found.verdict != "good" and "doubts the result" in text


def test_the_fault_is_named_and_the_position_found(swapped):
    _, robust = swapped
    channels = robust.found.channels
    assert [(fault.name, fault.kind) for fault in channels.faults] == [("11", "inverted")]
    assert abs(abs(channels.phase_deg[11]) - 180) < 0.5 and "a phase of 180 degrees" in said(CHANNEL, 2)
    assert abs(channels.gain_db[11]) < 0.05 and "a gain of 0 dB" in said(CHANNEL, 2)
    assert round(robust.errors[11], 1) == 0.6 and "0.6 mm off" in said(CHANNEL, 2)
    assert round(robust.sought.mean(), 1) == 0.9 and "the mean of all 13 is 0.9 mm" in said(CHANNEL, 2)
