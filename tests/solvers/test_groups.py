"""Groups of microphones far from each other: found, and put into the pose that the pressures between them show."""

from dataclasses import replace

import numpy as np
import pytest
from solving import rms_of_shape, run_from, saved_and_read

from fdcal import solvers
from fdcal.cost.likelihood import FieldModel
from fdcal.model.measurement import Measurement
from fdcal.model.settings import SolverSettings
from fdcal.solvers.robust.outliers import groups, other_poses

FREQUENCIES = np.linspace(40.0, 300.0, 24)
K = 2 * np.pi * FREQUENCIES / 343.0
WAVELENGTH = 2 * np.pi / K.max()


def two_groups(rng, apart: float = 2.4) -> np.ndarray:
    x = 0.22 * rng.standard_normal((36, 2))
    x[18:, 0] += apart
    return x


def diffuse(x, rng, noise: float) -> np.ndarray:
    """Pressures (M, N), of unit power on average, at x (N, 2): 40 plane waves a mode, from random directions."""
    angles = rng.uniform(0, 2 * np.pi, (len(K), 40))
    waves = np.exp(1j * K[:, None, None] * (np.stack([np.cos(angles), np.sin(angles)], axis=-1) @ x.T))
    drawn = rng.normal(size=(2, len(K), 40)) / np.sqrt(80)
    p = np.einsum("md,mdn->mn", drawn[0] + 1j * drawn[1], waves) * np.sqrt(1 - noise)
    e = rng.normal(size=(2, *p.shape)) * np.sqrt(noise / 2)
    return p + e[0] + 1j * e[1]


def assumed(x, noise: float = 1e-3) -> FieldModel:
    return FieldModel(K, np.ones(len(K)), np.full(len(K), noise), np.ones(len(x)), 2)


def posed(x, angle: float, shift, mirrored: bool) -> np.ndarray:
    """`x` with its second group turned, mirrored and moved as a whole."""
    y, middle = np.array(x), x[18:].mean(axis=0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    y[18:] = (x[18:] - middle) * ([-1, 1] if mirrored else [1, 1]) @ turn.T + middle + np.asarray(shift)
    return y


def test_groups_are_those_between_gaps_however_microphones_are_numbered():
    rng = np.random.default_rng(1)
    x, order = two_groups(rng), rng.permutation(36)
    found = {frozenset(one.tolist()) for one in groups(x, WAVELENGTH)}
    assert found == {frozenset(range(18)), frozenset(range(18, 36))}
    assert {frozenset(order[one].tolist()) for one in groups(x[order], WAVELENGTH)} == found
    assert len(groups(rng.uniform(0, 2.0, (60, 2)), WAVELENGTH)) == 1, "an array without gaps is one group"


def test_a_single_microphone_belongs_to_the_nearest_group():
    x = two_groups(np.random.default_rng(2))
    x[0] = x[:18].mean(axis=0) - [1.5, 0.0]
    first, second = sorted(groups(x, WAVELENGTH), key=lambda one: one[0])
    assert 0 in first
    assert len(first) == len(second) == 18


@pytest.mark.parametrize(("angle", "shift", "mirrored"), [(2.0, (0.0, 0.0), False), (0.5, (0.6, -0.8), True)])
def test_a_group_in_a_wrong_pose_comes_to_the_right_one(angle, shift, mirrored):
    rng = np.random.default_rng(3)
    x = two_groups(rng)
    p, wrong = diffuse(x, rng, 1e-3), posed(x, angle, shift, mirrored)
    found = other_poses(wrong, p, assumed(x))[0]
    assert rms_of_shape(wrong, x) > 0.2
    assert rms_of_shape(found, x) < 0.05 * WAVELENGTH
    for group in (slice(0, 18), slice(18, 36)):
        assert rms_of_shape(found[group], x[group]) < 1e-9, "each group moves as a whole"


def test_an_array_without_gaps_has_no_other_poses():
    rng = np.random.default_rng(4)
    x = rng.uniform(0, 2.0, (60, 2))
    assert other_poses(x, diffuse(x, rng, 1e-3), assumed(x)) == []


def test_odd_channels_move_with_their_group_and_do_not_decide_its_pose():
    rng = np.random.default_rng(5)
    x = two_groups(rng)
    p, field = diffuse(x, rng, 1e-3), assumed(x)
    field.channel_noise[[3, 20]] = 1e4
    wrong = posed(x, 2.5, (0.3, 0.5), True)
    found = other_poses(wrong, p, field)
    changed = np.array(p)
    changed[:, [3, 20]] = rng.normal(size=(len(K), 2))
    assert rms_of_shape(found[0], x) < 0.05 * WAVELENGTH
    np.testing.assert_array_equal(other_poses(wrong, changed, field), found)


@pytest.fixture(scope="module")
def run():
    """The truth, its problem, and the states of a run that begins with one group in a wrong pose."""
    rng = np.random.default_rng(6)
    x = two_groups(rng)
    measurement = Measurement(pressures=diffuse(x, rng, 1e-4), frequencies=FREQUENCIES, sound_speed=343.0)
    problem, solver = measurement.problem("unit"), solvers.load("robust")
    settings, wrong = SolverSettings(name="robust", modes=len(K)), posed(x, 2.0, (0.2, 0.4), True)
    return x, problem, run_from(solver, problem, solver.init(problem, settings, 0, wrong))


def test_robust_finds_groups_of_which_it_had_one_in_a_wrong_pose(run):
    x, _, (*_, state) = run
    assert rms_of_shape(state.positions, x) < 0.01 * WAVELENGTH
    assert rms_of_shape(state.optima[0].positions, x) > 0.05, "the first optimum is in the wrong pose"
    assert all(one.regrouped for one in state.optima[1:]), "no other start is needed"


def test_the_poses_of_a_larger_array_in_longer_waves_are_the_same():
    rng = np.random.default_rng(3)
    x = two_groups(rng)
    p, wrong, scale = diffuse(x, rng, 1e-3), posed(x, 0.5, (0.6, -0.8), True), 128.0
    longer = replace(assumed(x), wavenumbers=K / scale)
    for found, larger in zip(other_poses(wrong, p, assumed(x)), other_poses(scale * wrong, p, longer), strict=True):
        np.testing.assert_allclose(larger / scale, found, atol=1e-6)


@pytest.fixture(scope="module")
def regrouped(run):
    """The problem, and the first state in a restart that began in another pose, with others still to be tried."""
    return run[1], next(state for state in run[2] if state.progress.poses)


def test_other_modes_begin_without_the_poses_of_those_before(regrouped):
    problem, state = regrouped
    changed = solvers.load("robust").use_modes(problem, state, 1, 20, True)
    assert state.progress.regrouped
    assert (changed.progress.regrouped, changed.progress.poses, changed.optima) == (False, (), ())


def test_modes_that_are_not_in_use_do_not_decide_a_pose(regrouped):
    problem, state = regrouped
    solver, rng = solvers.load("robust"), np.random.default_rng(7)
    spoiled = np.array(problem.pressures)
    spoiled[20:] = rng.normal(size=spoiled[20:].shape)

    def end(problem):
        now = solver.use_modes(problem, state, 1, 20, True)
        while not now.optima:
            now = solver.step(problem, now)
        return now.progress.poses

    for one, other in zip(end(problem), end(replace(problem, pressures=spoiled)), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)


def test_a_state_with_poses_is_saved_and_read(regrouped):
    problem, state = regrouped
    read = saved_and_read(problem, state)
    assert read.progress.regrouped and len(read.progress.poses) == len(state.progress.poses)
    np.testing.assert_array_equal(read.progress.poses[0], state.progress.poses[0])
