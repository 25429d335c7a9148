"""Laws of the starts, affine and of the coherence, and of the deformations of an array."""

from dataclasses import replace

import numpy as np
import pytest
from fields import measured, waves
from running import refuses
from solving import rms_of_shape

from fdcal import solvers
from fdcal.model.gauge import align, position_errors
from fdcal.model.measurement import Measurement
from fdcal.model.settings import SolverSettings
from fdcal.model.validation import InputError
from fdcal.solvers import starts
from fdcal.solvers.robust.objective import polynomial_deformations

KNOWN = [0, 1, 2, 3]


def affine_problem(D, known, offsets=1.0):
    """Problem of pressures that are exactly affine in the positions, and the truth (N, D)."""
    rng = np.random.default_rng(D)
    truth = rng.uniform(-0.5, 0.5, (30, D)) + 2.5
    base = measured(truth[:, :2], [])
    modes = len(base.frequencies)
    slopes = base.wavenumbers.real[:, None] * (rng.normal(size=(modes, D)) + 1j * rng.normal(size=(modes, D)))
    pressures = slopes @ (truth - truth.mean(axis=0)).T + offsets * rng.normal(size=(modes, 1))
    chosen = {"known": known, "known_positions": truth[known] if known else None}
    measurement = replace(
        base, dimension=D, array_dimension=D, pressures=pressures, positions=truth, search=None, **chosen
    )
    return measurement.problem("raw"), truth


@pytest.mark.parametrize("D", [2, 3])
def test_the_affine_start_is_exact_for_an_affine_field(D):
    problem, truth = affine_problem(D, KNOWN[: D + 1])
    for lowest in (None, 8, 40):
        np.testing.assert_allclose(starts.affine(problem, 40, lowest), truth, atol=1e-9)


@pytest.mark.parametrize("D", [2, 3])
def test_blind_it_is_an_affine_image_of_the_truth(D):
    """Which image, the pressures of an affine field do not tell."""
    problem, truth = affine_problem(D, [])
    found = starts.affine(problem, 40)
    extended = np.column_stack([truth, np.ones(len(truth))])
    image = extended @ np.linalg.lstsq(extended, found, rcond=None)[0]
    np.testing.assert_allclose(found, image, atol=1e-9)
    assert np.linalg.matrix_rank(found - found.mean(axis=0), tol=1e-6) == D


def test_known_microphones_that_do_not_span_the_array_are_refused():
    problem, truth = affine_problem(2, [0, 1])
    refuses("at least 3 known microphones that span the array, or none", starts.affine, problem, 40)
    on_a_line = np.column_stack([truth[:, 0], truth[:, 0]])
    with pytest.raises(InputError, match="fewer than 2 directions"):
        starts.affine(replace(problem, pressures=problem.pressures[:, :1] * on_a_line[None, :, 0]), 40)


def test_a_random_start_fills_the_search_domain_and_keeps_the_known():
    truth = np.random.default_rng(7).uniform(-0.5, 0.5, (40, 2)) + [2.61, 2.31]
    problem = measured(truth, KNOWN).problem()
    one, again, other = (starts.random(problem, np.random.default_rng(seed)) for seed in (0, 0, 1))
    assert np.array_equal(one, again) and not np.array_equal(one, other)
    assert np.array_equal(one[KNOWN], truth[KNOWN])
    low, high = np.array(problem.search.origin), np.add(problem.search.origin, problem.search.size)
    assert np.all((one >= low) & (one <= high)) and np.ptp(one, axis=0).min() > 0.8
    refuses("needs a search domain", lambda: starts.random(replace(problem, search=None), np.random.default_rng(0)))


@pytest.mark.parametrize("degree", [2, 3])
@pytest.mark.parametrize("D", [2, 3])
def test_deformations_are_orthonormal_and_contain_the_affine_maps_and_curved_ones(D, degree):
    x = np.random.default_rng(1).uniform(-0.5, 0.5, (60, D)) + 3.0
    basis = polynomial_deformations(x, np.zeros(0, int), degree)
    np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=1e-9)
    for column in np.column_stack([x, np.ones(len(x))]).T:
        for coordinate in np.eye(D):
            move = np.outer(column, coordinate).ravel()
            np.testing.assert_allclose(basis @ (basis.T @ move), move, atol=1e-9 * np.abs(move).max())
    if (D, degree) == (2, 3):
        assert polynomial_deformations(x[:8], np.zeros(0, int), 3).shape == (16, 6), "few deform by a lower degree"
    assert basis.shape[1] == D * {(2, 2): 6, (2, 3): 10, (3, 2): 10, (3, 3): 20}[D, degree]


@pytest.mark.parametrize("held", [[0, 1, 2], list(range(0, 60, 5))])
def test_deformations_leave_microphones_that_stay_in_place_and_stay_smooth(held):
    x = np.random.default_rng(1).uniform(-0.5, 0.5, (60, 2)) + 3.0
    basis = polynomial_deformations(x, np.array(held), 2)
    np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=1e-9)
    moves = basis.T.reshape(-1, 60, 2)
    assert not np.any(moves[:, held]) and 0 < len(moves) <= 12
    ordered = np.argsort(np.linalg.norm(x[:, None] - x, axis=-1), axis=1)
    near, far = (np.mean(np.sum((moves - moves[:, ordered[:, i]]) ** 2, axis=-1)) for i in (1, 30))
    assert near < far / 3


def test_an_array_is_found_though_the_source_hardly_excites_one_direction():
    """Waves along x in all but the high modes: the second strongest direction is the curvature along x, not y."""
    rng = np.random.default_rng([2, 24])
    truth = rng.uniform(-0.5, 0.5, (24, 2))
    frequencies = np.linspace(30, 250, 40)
    k = 2 * np.pi * frequencies / 343.0
    pressures = np.empty((40, 24), complex)
    for m in range(40):
        if m < 28:
            x, y = k[m] * truth.T
            a = rng.normal(size=4) + 1j * rng.normal(size=4)
            pressures[m] = a[0] * np.cos(x) + a[1] * np.sin(x) + 0.03 * (a[2] * np.cos(y) + a[3] * np.sin(y))
        else:
            angles = 2 * np.pi * rng.random(30)
            a = rng.normal(size=30) + 1j * rng.normal(size=30)
            pressures[m] = np.exp(-1j * k[m] * truth @ np.array([np.cos(angles), np.sin(angles)])) @ a
    noise = np.mean(np.abs(pressures) ** 2, axis=1) * 1e-4
    draws = rng.normal(size=pressures.shape) + 1j * rng.normal(size=pressures.shape)
    measurement = Measurement(
        frequencies=frequencies,
        pressures=pressures + np.sqrt(noise / 2)[:, None] * draws,
        sound_speed=343.0,
        wavenumbers=k.astype(complex),
        noise_power=noise,
        positions=truth,
        known=KNOWN,
    )
    last = list(solvers.run(measurement.problem(), SolverSettings(name="joint", modes=40), 0))[-1]
    assert last.converged and position_errors(last.positions, truth).max() < 0.02


# The coherence start: right for arrays of several wavelengths, where an affine image of the low modes is not.

FREQUENCIES = np.linspace(40.0, 320.0, 48)
K = 2 * np.pi * FREQUENCIES / 343.0


@pytest.mark.parametrize(("D", "noise"), [(2, 0.01), (3, 0.01), (2, 0.3)])
def test_distances_of_near_pairs_follow_from_the_coherence(D, noise):
    """Noise lowers the coherence as a distance does, unless it is taken into account."""
    rng = np.random.default_rng(1)
    x = rng.uniform(0, 1.0, (12, D))
    k = np.linspace(1.0, 6.0, 600)
    found, _ = starts.pair_distances(waves(x, k, 40, rng, noise), k, noise, D)
    np.testing.assert_allclose(found, found.T)
    apart = np.linalg.norm(x[:, None] - x[None], axis=-1)
    pairs = np.triu_indices(12, 1)
    off = np.log(found[pairs] / apart[pairs])
    assert np.median(np.abs(off)) < 0.06 if noise < 0.1 else abs(np.median(off)) < 0.05


@pytest.mark.parametrize("noise", [1e-3, 0.1])
def test_an_array_of_three_wavelengths(noise):
    rng = np.random.default_rng(5)
    x = rng.uniform(0, 3.2, (50, 2))
    p = waves(x, K, 40, rng, noise)
    assert rms_of_shape(starts.coherence_start(p, K, noise, 2, 2), x) < 0.2
    unknown = starts.coherence_start(p, K, None, 2, 2)
    assert rms_of_shape(unknown, x) < 0.2, "the noise is chosen by likelihood where none is reported"
    problem = Measurement(pressures=p, frequencies=FREQUENCIES, sound_speed=343.0).problem("unit")
    assert rms_of_shape(starts.affine(problem, len(K)), x) > 0.4, "the low modes are not affine over so large an array"


def test_robust_finds_an_array_of_three_wavelengths_with_a_noisy_and_an_inverted_channel():
    rng = np.random.default_rng(6)
    x = rng.uniform(0, 3.2, (42, 2))
    p = waves(x, K, 40, rng, 1e-4)
    p[:, 7] *= -1
    p[:, 20] = (rng.normal(size=len(K)) + 1j * rng.normal(size=len(K))) / np.sqrt(2)
    problem = Measurement(pressures=p, frequencies=FREQUENCIES, sound_speed=343.0).problem("unit")
    state = list(solvers.run(problem, SolverSettings(name="robust", modes=len(K)), 0))[-1]
    sound = np.arange(42) != 20
    assert rms_of_shape(state.positions[sound], x[sound]) < 5e-3
    assert state.model.channel_noise[20] > 100
    assert abs(state.gains[7, 1]) == pytest.approx(np.pi, abs=0.1)


@pytest.mark.parametrize("D", [2, 3])
def test_an_array_is_laid_on_the_given_positions_that_agree(D):
    rng = np.random.default_rng(D)
    x, turn = rng.normal(size=(7, D)), np.linalg.qr(rng.normal(size=(D, D)))[0]
    places = x @ turn + 3.0
    places[2] += 1.0
    chosen = starts.best_subset(x, places)
    off = np.linalg.norm(align(x, places, chosen) - places, axis=1)
    assert len(chosen) == D + 1 and np.flatnonzero(off > 1e-9).tolist() == [2]
