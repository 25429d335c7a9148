"""Laws that the lessons on noise and on a bad channel show: error bars follow the noise, a fault is found by name."""

import numpy as np
import pytest

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.assessment.uncertainty import confidence_factor, ellipse_axes
from fdcal.graphics.camera import camera_for, project
from fdcal.graphics.picture import compose
from fdcal.model.scene_file import load_scene
from fdcal.session.calibration_run import assess_state
from fdcal.session.lesson import load_lesson
from fdcal.session.process import one_blas_thread
from fdcal.session.scene_edits import edited
from fdcal.session.sources import CalibrationInput

NOISE, CHANNEL = "6_noise_and_error_bars", "7_one_bad_channel"


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
            self.found = assess_state(inputs, problem, state)
        self.free, self.positions, self.converged = problem.free, state.positions, state.converged
        self.errors = 1e3 * self.measurement.errors(state.positions)
        self.sought, self.bars = self.errors[self.free], 1e3 * self.found.uncertainty[self.free]


@pytest.fixture(scope="module")
def noisy():
    """The ends at 40 dB and at 20 dB, as the lesson shows them, and without noise."""
    lesson = load_lesson(NOISE)
    scene = edited(lesson.start(0)[0], {"measurement.snr_db": float("inf")})
    return [End(*lesson.start(0)), End(*lesson.start(1)), End(scene, scene.seed)]


def test_error_and_error_bar_follow_the_noise(noisy):
    some, more, none = noisy
    assert [load_lesson(NOISE).start(i)[0].measurement.snr_db for i in (0, 1)] == [40, 20]
    assert all(end.found.verdict == "good" for end in noisy)
    assert none.sought.mean() < some.sought.mean() < more.sought.mean() < 10
    assert none.bars.mean() < some.bars.mean() < more.bars.mean()
    ratios = more.sought.mean() / some.sought.mean(), more.bars.mean() / some.bars.mean()
    assert max(ratios) / min(ratios) < 1.5, "error and error bar grow together"


def test_the_ellipses_contain_the_true_positions(noisy):
    for end in noisy[:2]:
        axes = ellipse_axes(end.found.covariance, confidence_factor(0.95, 2))[end.free]
        away = (end.positions - end.measurement.positions)[end.free]
        inside = [np.linalg.norm(np.linalg.solve(axis.T, offset)) < 1 for axis, offset in zip(axes, away, strict=True)]
        assert sum(inside) >= 11, "at least 11 of 13 where 12.4 are expected"


@pytest.fixture(scope="module")
def swapped():
    """The ends of solvers descent and robust with the bad channel, as the lesson shows them."""
    lesson = load_lesson(CHANNEL)
    return End(*lesson.start(0)), End(*lesson.start(2))


def test_a_wrong_sign_carries_its_microphone_away_and_spoils_the_others(swapped):
    spoilt = swapped[0]
    scene, seed = load_lesson(CHANNEL).start(0)
    assert scene.faults.inverted == (11,) and scene.solver.name == "descent"
    picture = compose(scene, spoilt.measurement, spoilt.positions)
    for size in ((1280, 720), (618, 720), (390, 844)):
        camera = camera_for(picture, size, load_lesson(CHANNEL).steps[0].then.view)
        at = project(camera, size, np.column_stack([spoilt.positions, np.zeros(len(spoilt.positions))]))
        assert (at > 0).all() and (at < size).all(), "the wrong estimate is in the picture"
    healthy = np.setdiff1d(spoilt.free, 11)
    unspoilt = End(edited(load_scene("tiny"), {"solver.name": "descent"}), seed)
    assert spoilt.errors[11] > 100 > spoilt.errors[healthy].mean() > 1.5 * unspoilt.errors[healthy].mean()
    residuals = np.array(spoilt.found.evidence.microphones_db)
    assert residuals.argmax() == 11 and np.sum(np.delete(residuals, 11) > residuals[11] - 12) >= 3
    assert spoilt.found.verdict != "good"


def test_the_fault_is_named_and_the_position_found(swapped):
    _, robust = swapped
    channels = robust.found.channels
    assert [(fault.name, fault.kind) for fault in channels.faults] == [("11", "inverted")]
    assert abs(abs(channels.phase_deg[11]) - 180) < 0.5 and abs(channels.gain_db[11]) < 0.05
    assert robust.errors[11] < 1 and robust.sought.mean() < 1
