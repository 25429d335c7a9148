"""The statements of the lessons are true: each number in their texts follows from the scenes that they show."""

import numpy as np
import pytest

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.assessment.uncertainty import confidence_factor, ellipse_axes
from fdcal.cost.eq7 import ReferenceCost
from fdcal.cost.maps import cost_maps, map_minima, map_positions, minima_of, mode_shape, refined
from fdcal.graphics.camera import camera_for, project
from fdcal.graphics.heatmap import wave_floor
from fdcal.graphics.picture import compose
from fdcal.model.gauge import position_errors
from fdcal.model.scene import load_scene
from fdcal.session.calibration_run import assess_state
from fdcal.session.lesson import load_lesson, states_of_lesson
from fdcal.session.process import one_blas_thread
from fdcal.session.scene_edits import edited
from fdcal.session.sources import CalibrationInput
from fdcal.viewer import opening


def run_from(solver, problem, state) -> list:
    """The states of a solver from `state` to the end, `state` first."""
    states = [state]
    while not states[-1].finished:
        states.append(solver.step(problem, states[-1]))
    return states


@pytest.fixture(scope="module")
def lesson_text():
    """Text of a lesson, questions and all, as one line."""

    def text(name):
        parts = [(step.text, step.question, *step.choices, step.reveal) for step in load_lesson(name).steps]
        return " ".join(" ".join(part.split()) for step in parts for part in step)

    return text


@pytest.fixture(scope="module")
def square():
    """The scene of lessons 1 and 2, as the page opens it: its state, microphone 16's maps, and what is true."""
    (scene, seed), step = load_lesson("1_many_minima").start(0), load_lesson("1_many_minima").steps[0].page
    measurement, descent = cached_measurement(scene), solvers.load(scene.solver.name)
    problem, fine = measurement.problem(scene.solver.weights), refined(scene.search)
    state = descent.use_modes(problem, descent.init(problem, scene.solver, seed), 1, 57, False)
    truth, n = measurement.positions[step.microphone], step.microphone
    assert step.quantity == "eq7"
    shown = cost_maps(problem, descent, state, n, (1, 38, 39, 40), step.order_offset, fine)
    maps = dict(zip((1, 38, 39, 40), shown, strict=True))
    return problem, descent, state, maps, fine, truth, measurement


def distances(places, truth):
    """Distances from the truth, metres, the nearest first."""
    return np.sort(np.hypot(*(places - truth).T))


def test_one_mode_has_many_minima(square, lesson_text):
    problem, _, state, maps, fine, truth, measurement = square
    text, f = lesson_text("1_many_minima"), measurement.frequencies
    found = minima_of(maps[38], fine)
    assert found.end is not None and len(found.lowest) == found.count, "all fit equally"
    away = distances(found.lowest, truth)
    assert len(away) == 4 and "four minima" in text and away[0] < fine.step and round(100 * away[1]) == 24
    for mode, words in ((22, "148.6 Hz"), (1, "28.6 Hz")):
        assert f"{f[mode - 1]:.1f} Hz" == words and words in text
    _, level = mode_shape(problem, state.positions, 38, 2, None, 16)
    assert f"{level:.2f} of the peak" in text and "other 48" in text and len(state.positions) == 49
    waves = wave_floor(problem, state.positions, 16, [(22, "mode 22"), (38, "mode 38")], 2)
    away = distances(np.array(waves.lowest), truth)
    assert len(away) == 4 and "At four" in text and away[0] < 0.01 < away[1]
    assert 343 / f[0] == pytest.approx(12, abs=0.1) and 343 / f[0] == pytest.approx(10 * 1.2, rel=0.01)


def test_one_mode_alone_leaves_a_valley(square):
    """Its dark cells span the map: one number does not fix two coordinates."""
    _, _, _, maps, fine, _, _ = square
    assert minima_of(maps[1], fine).count == 1
    rows, columns = np.nonzero(maps[1] < maps[1].min() + 0.01 * np.ptp(maps[1]))
    assert np.ptp(rows) + 1 == maps[1].shape[0] and fine.step * (np.ptp(columns) + 1) == pytest.approx(0.15, abs=0.005)
    rows, columns = np.nonzero(maps[38] < maps[38].min() + 0.01 * np.ptp(maps[38]))
    assert fine.step * np.ptp(rows) > 1.0, "a ring"


def test_modes_together_have_one_common_minimum(square, lesson_text):
    problem, descent, state, maps, fine, truth, _ = square
    text = lesson_text("2_joint_minimum")
    two, three = (minima_of(sum(maps[mode] for mode in modes), fine) for modes in ((38, 39), (38, 39, 40)))
    assert two.count == 4 and "four minima are left" in text
    np.testing.assert_allclose(distances(two.lowest, truth), [0.0, 0.24], atol=0.005)
    assert three.count == 1 and distances(three.lowest, truth) < 0.002 and "One, at the true position" in text
    each = cost_maps(problem, descent, state, 16, tuple(range(1, 100)), 2, fine)
    for count in (57, 92, 99):  # of the lesson, of the film in the opening, and all
        found = minima_of(each[:count].sum(axis=0), fine)
        assert found.count == 1 and distances(found.lowest, truth) < 0.002
    assert "The 57 lowest of the 99 frequencies" in text and "the 92 of the film in the opening" in text
    assert len(problem.frequencies) == 99 and opening.MODE == 92
    np.testing.assert_allclose(descent.step(problem, state).positions[16], truth, atol=1e-12)


@pytest.fixture(scope="module")
def box():
    """The scene of lessons 3 and 4 and where descent ends in it, with all modes at once and one by one."""
    scene, seed = load_lesson("3_too_many_too_soon").start(0)
    measurement, descent = cached_measurement(scene), solvers.load("descent")
    problem = measurement.problem(scene.solver.weights)
    begun = descent.init(problem, scene.solver, seed)
    parts = [part for step in load_lesson("3_too_many_too_soon").steps for part in step.parts]
    _, at_once, _, _, _, staged = states_of_lesson(parts, problem, scene.solver, seed)
    return scene, measurement, problem, descent, begun, at_once[-1], staged


def mean_error(measurement, state) -> float:
    """Mean error of the microphones sought, mm, as in the status."""
    free = measurement.problem().free
    return 1e3 * float(position_errors(state.positions, measurement.positions)[free].mean())


def cost(measurement, positions) -> float:
    """The cost in the status, dB."""
    return ReferenceCost(measurement.problem())(positions)


def test_too_many_modes_too_soon_trap_the_descent(box, lesson_text):
    _, measurement, problem, _, begun, at_once, states = box
    staged = states[-1]
    text, f = lesson_text("3_too_many_too_soon"), measurement.frequencies
    assert begun.first == 1 and begun.last == 3 and len(problem.free) == 13
    assert f"{f[0]:.0f} to {f[19]:.0f} Hz" in text
    assert mean_error(measurement, begun) == pytest.approx(224, abs=5) and "22 cm from their true positions" in text
    assert at_once.sweep == 7 and mean_error(measurement, at_once) == pytest.approx(190, abs=5)
    assert "After 7 sweeps" in text and "still 19 cm" in text and at_once.converged
    above = cost(measurement, at_once.positions) - cost(measurement, measurement.positions)
    assert above == pytest.approx(39.4, abs=0.5) and "The misfit is 39 dB above that of the true positions" in text
    low = next(state for state in states[::-1] if state.last == 3)
    assert mean_error(measurement, staged) > 2 * mean_error(measurement, low)
    assert cost(measurement, staged.positions) > cost(measurement, low.positions) + 1
    assert "After that, error and misfit rise again" in text
    assert (
        low.sweep == 4 and round(mean_error(measurement, low)) == 3 and "after 4 sweeps the mean error is 3 mm" in text
    )
    assert staged.sweep == 34 and mean_error(measurement, staged) == pytest.approx(17, abs=0.5) and "1.7 cm" in text
    assert mean_error(measurement, at_once) / mean_error(measurement, staged) == pytest.approx(11, abs=1)


def test_maps_of_a_wrong_array_have_few_minima_with_few_modes(box, lesson_text):
    scene, measurement, problem, descent, begun, *_ = box

    def maps(last):
        state, found = descent.use_modes(problem, begun, 1, last, False), {}
        for n in problem.free:
            cost = cost_maps(problem, descent, state, int(n), range(1, last + 1), None).sum(axis=0)
            lowest = map_positions(np.array([np.unravel_index(cost.argmin(), cost.shape)]), scene.search)[0]
            modes = range(1, last + 1)
            marked = map_minima(problem, descent, state, int(n), modes, None, cost, scene.search)
            found[int(n)] = marked.count, float(np.hypot(*(lowest - measurement.positions[n])))
        return found

    few, many = maps(3), maps(20)
    text = lesson_text("3_too_many_too_soon")
    assert (
        max(count for count, _ in few.values()) == 1
        and "None of the 13 maps with three frequencies has more than one local minimum" in text
    )
    assert np.mean([distance for _, distance in few.values()]) == pytest.approx(0.03, abs=0.002)
    assert (
        np.mean([count for count, _ in many.values()]) == pytest.approx(2.4, abs=0.1)
        and "two minima on average" in text
    )
    assert np.mean([distance for _, distance in many.values()]) == pytest.approx(0.26, abs=0.005)
    assert few[8][0] == 1 < many[8][0] and many[8][1] == pytest.approx(0.44, abs=0.01) and "44 cm" in text


def test_the_best_move_of_a_trapped_microphone_is_less_than_half_a_cell(box, lesson_text):
    scene, measurement, problem, descent, *_, (*_, staged) = box
    text, truth, fine = lesson_text("4_frozen_grid"), measurement.positions, refined(scene.search, 121)
    errors = 1e3 * position_errors(staged.positions, truth)
    assert errors.argmax() == 6 and errors.max() == pytest.approx(45, abs=1) and "4.5 cm for the worst" in text
    assert mean_error(measurement, staged) == pytest.approx(17, abs=0.5) and "1.7 cm on average" in text
    for positions, words in ((staged.positions, "a misfit of -33.7 dB"), (truth, "the true positions have -59.2 dB")):
        assert f"{cost(measurement, positions):.1f} dB" in words and words in text
    lattice = (truth - scene.search.origin) / scene.search.step
    np.testing.assert_allclose(lattice, np.rint(lattice), atol=1e-9)

    def wanted(n, lattice):
        cost = cost_maps(problem, descent, staged, n, range(1, 21), None, lattice).sum(axis=0)
        lowest = map_positions(np.array([np.unravel_index(cost.argmin(), cost.shape)]), lattice)[0]
        return lowest - staged.positions[n]

    wants = [wanted(int(n), fine) for n in problem.free]
    assert np.abs(wants).max() < (scene.search.step + fine.step) / 2, "this holds for all 13"
    assert 1e3 * np.hypot(*wanted(6, refined(scene.search))) == pytest.approx(4, abs=1)
    assert "4 mm from the ball" in text


def test_the_remaining_error_is_a_smooth_deformation(box):
    """A polynomial of second degree explains more than three quarters of the squared errors."""
    _, measurement, *_, (*_, staged) = box
    x, y = (measurement.positions - measurement.positions.mean(axis=0)).T
    error = staged.positions - measurement.positions
    smooth = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    rest = error - smooth @ np.linalg.lstsq(smooth, error, rcond=None)[0]
    assert np.sum(rest**2) < 0.25 * np.sum(error**2), "of random errors, 10 of 16 parts would be left"


def test_moving_all_microphones_at_once_gets_beyond_the_grid(box, lesson_text):
    _, measurement, problem, *_ = box
    scene, seed = load_lesson("4_frozen_grid").start(2)
    joint = solvers.load(scene.solver.name)
    begun = joint.init(problem, scene.solver, seed)
    last, text = run_from(joint, problem, begun)[-1], lesson_text("4_frozen_grid")
    assert mean_error(measurement, last) == pytest.approx(0.3, abs=0.05) and "0.3 mm on average" in text
    assert f"at a misfit of {cost(measurement, last.positions):.1f} dB" in text


def test_the_error_grows_with_distance_from_a_corner_and_not_from_the_centre(lesson_text):
    lesson, runs = load_lesson("5_corner_or_centre"), []
    for number in (0, 1):
        scene, seed = lesson.start(number)
        measurement, descent = cached_measurement(scene), solvers.load("descent")
        problem = measurement.problem(scene.solver.weights)
        states = run_from(descent, problem, descent.init(problem, scene.solver, seed))
        truth, free = measurement.positions, problem.free
        error = 1e3 * np.mean([position_errors(state.positions, truth) for state in states], axis=0)[free]
        distance = np.hypot(*(truth[free] - truth[measurement.known[0]]).T)
        near = distance <= np.median(distance)
        last = 1e3 * position_errors(states[-1].positions, truth)
        runs.append(
            (error[near].mean(), error[~near].mean(), states[-1].sweep, last, np.corrcoef(distance, error)[0, 1])
        )
    (near, far, sweeps, last, grows), (inner, outer, sooner, ends, flat) = runs
    text = lesson_text("5_corner_or_centre")
    assert near == pytest.approx(8, abs=0.6) and far == pytest.approx(21, abs=0.6) and grows > 0.7
    assert "8 mm for the nearer half and 21 mm for the farther half" in text
    assert inner == pytest.approx(9, abs=0.6) and outer == pytest.approx(9, abs=0.6) and abs(flat) < 0.3
    assert (sooner, sweeps) == (30, 40) and "30 sweeps instead of 40" in text
    assert "microphones 2 and 11 are still 2 cm off" in text and np.flatnonzero(last > 1).tolist() == [2, 11]
    assert ends.max() < 1e-6 and np.count_nonzero(last > 1) == 2 and last.max() == pytest.approx(20, abs=1)


# Noise, and a bad channel: error bars follow the noise, a fault is found by name.


NOISE, CHANNEL = "6_noise_and_error_bars", "7_one_bad_channel"


class End:
    """The end of a scene's run as the page judges it; errors and error bars are those of the microphones sought, mm."""

    def __init__(self, scene, seed):
        self.measurement, solver = cached_measurement(scene), solvers.load(scene.solver.name)
        problem = self.measurement.problem(scene.solver.weights)
        with one_blas_thread():
            state = run_from(solver, problem, solver.init(problem, scene.solver, seed))[-1]
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


def test_an_inverted_channel_displaces_its_own_microphone_and_others(lesson_text):
    scene, seed = load_lesson(CHANNEL).start(0)
    spoilt = End(scene, seed)
    assert scene.faults.inverted == (11,) and scene.solver.name == "descent"
    picture = compose(scene, spoilt.measurement, spoilt.positions)
    for size in ((1280, 720), (618, 720), (390, 844)):
        camera = camera_for(picture, size, load_lesson(CHANNEL).steps[0].page.view)
        at = project(camera, size, np.column_stack([spoilt.positions, np.zeros(len(spoilt.positions))]))
        assert (at > 0).all() and (at < size).all(), "the wrong estimate is in the picture"
    healthy = np.setdiff1d(spoilt.free, 11)
    unspoilt = End(edited(load_scene("tiny"), {"solver.name": "descent"}), seed)
    assert spoilt.errors[11] > 100 > spoilt.errors[healthy].mean() > 1.5 * unspoilt.errors[healthy].mean()
    residuals = np.array(spoilt.found.evidence.microphones_db)
    assert residuals.argmax() == 11 and np.sum(np.delete(residuals, 11) > residuals[11] - 12) >= 3
    assert spoilt.found.verdict != "good"
    assert [fault.name for fault in spoilt.found.channels.faults] == ["7", "11"]
    assert "microphones 7 and 11 are both marked as faulty channels, and 7 is healthy" in lesson_text(CHANNEL)
    assert round(spoilt.errors[healthy].mean()) == 48 and "48 mm off on average" in lesson_text(CHANNEL)
