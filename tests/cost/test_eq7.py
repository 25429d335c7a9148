"""Laws of the cost, Eq. 7, and of its landscape."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from fields import measured

from fdcal.acoustics.fourier_bessel import fourier_bessel, max_order
from fdcal.cost.eq7 import cost, known_weights, landscape, leave_one_out_fits, residual
from fdcal.cost.lattice_search import FitTables, best_candidate, candidate_costs, lattice_fits, lattice_landscape
from fdcal.cost.mode_limits import require_modes, search_lattice
from fdcal.model.validation import InputError

TRUTH = np.random.default_rng(3).uniform(-0.5, 0.5, (24, 2)) + [2.61, 2.31]
MEASUREMENT = measured(TRUTH, [0, 1, 2], highest=150.0)
PROBLEM = MEASUREMENT.problem()
ORDERS = max_order(PROBLEM.wavenumbers, 0.8, 2)
CENTRE = TRUTH.mean(axis=0)
GUESS = TRUTH + np.random.default_rng(4).normal(0, 0.05, TRUTH.shape)
CANDIDATES = np.random.default_rng(5).uniform(-0.6, 0.6, (50, 2)) + CENTRE


def brute_force(n, tikhonov=0.0, centre=CENTRE, guess=GUESS, orders=ORDERS):
    """Eq. 7 by a pseudo-inverse for every candidate."""
    values = np.empty((len(orders), len(CANDIDATES)))
    for m, (p, k, L) in enumerate(zip(PROBLEM.pressures, PROBLEM.wavenumbers, orders, strict=True)):
        for c, candidate in enumerate(CANDIDATES):
            moved = guess.copy()
            moved[n] = candidate
            W = fourier_bessel(moved, k, L, centre)
            A = np.concatenate([W, np.sqrt(tikhonov) * np.eye(W.shape[1])])
            b = np.concatenate([p, np.zeros(W.shape[1])])
            values[m, c] = np.sum(np.abs(A @ (np.linalg.pinv(A) @ b) - b) ** 2)
    return values


@pytest.mark.parametrize("tikhonov", [0.0, 1e-6, 0.1])
def test_landscape_is_eq_7_by_brute_force(tikhonov):
    arguments = (PROBLEM.pressures, PROBLEM.wavenumbers, ORDERS, CENTRE, tikhonov)
    expected = brute_force(7, tikhonov)
    np.testing.assert_allclose(landscape(GUESS, 7, CANDIDATES, *arguments), expected, atol=1e-10)


def test_landscape_at_the_microphone_is_the_cost():
    arguments = (PROBLEM.pressures, PROBLEM.wavenumbers, ORDERS, CENTRE)
    for tikhonov in (0.0, 1e-3):
        here = landscape(GUESS, 5, GUESS[5:6], *arguments, tikhonov)[:, 0]
        np.testing.assert_allclose(here, cost(GUESS, *arguments, tikhonov), atol=1e-10)


def test_rank_deficient_landscape_is_eq_7_on_the_reduced_dictionary():
    """Two microphones in one place: their rows are equal, and the dictionary is reduced once, for all candidates."""
    few = np.repeat(GUESS[:5], 3, axis=0)
    W = fourier_bessel(few, PROBLEM.wavenumbers[0], 3, CENTRE)
    p = PROBLEM.pressures[0, : len(few)]
    fit = leave_one_out_fits([W], p[None], 0)[0]
    others = W[1:]
    V = np.linalg.svd(others, full_matrices=False)[2].conj().T[:, : np.linalg.matrix_rank(others, tol=1e-10)]
    rows = fourier_bessel(CANDIDATES, PROBLEM.wavenumbers[0], 3, CENTRE)
    for c, row in enumerate(rows):
        A = np.concatenate([row[None], others]) @ V
        expected = np.sum(np.abs(A @ (np.linalg.pinv(A) @ p) - p) ** 2)
        assert fit.cost_of(rows)[c] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("weight", [0.01, 1.0, 25.0])
def test_weights_multiply_the_squared_residuals(weight):
    """Least squares with rows scaled by the root of the weights; the microphone left out counts once."""
    weights = known_weights(PROBLEM, weight)
    W = fourier_bessel(GUESS, PROBLEM.wavenumbers[3], int(ORDERS[3]), CENTRE)
    p, n = PROBLEM.pressures[3], 7
    fit = leave_one_out_fits([W], p[None], n, weights=weights)[0]
    alpha = np.linalg.lstsq(np.sqrt(weights)[:, None] * W, np.sqrt(weights) * p, rcond=None)[0]
    expected = np.sum(weights * np.abs(W @ alpha - p) ** 2)
    assert fit.cost_of(W[n : n + 1])[0] == pytest.approx(expected, rel=1e-8)
    assert weights.tolist() == [weight] * 3 + [1.0] * (len(GUESS) - 3)


def test_truth_explains_the_pressures_and_ample_order_is_better():
    k = PROBLEM.wavenumbers
    totals = [
        cost(TRUTH, PROBLEM.pressures[:5], k[:5], max_order(k[:5], 0.8, offset), CENTRE).sum() for offset in range(4)
    ]
    assert all(after < before / 30 for before, after in pairwise(totals))
    assert residual(TRUTH, PROBLEM.pressures[:5], k[:5], max_order(k[:5], 0.8, 3), CENTRE) == pytest.approx(0, abs=1e-4)


@pytest.mark.parametrize("tikhonov", [0.0, 1e-3])
def test_cost_does_not_change_under_translation_rotation_and_mirror(tikhonov):
    angle = 0.8
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    here = cost(GUESS, PROBLEM.pressures, PROBLEM.wavenumbers, ORDERS, CENTRE, tikhonov)
    for move in (np.eye(2), turn, turn @ np.diag([1, -1])):
        there = cost(
            GUESS @ move.T + [3, -2], PROBLEM.pressures, PROBLEM.wavenumbers, ORDERS, move @ CENTRE + [3, -2], tikhonov
        )
        np.testing.assert_allclose(there, here, rtol=1e-7, atol=1e-12)


def test_lattice_landscape_and_pruned_search_agree_with_the_landscape():
    lattice = search_lattice(PROBLEM, 2)
    modes = slice(1, 9)
    centre = lattice.nearest(CENTRE)
    expected = landscape(
        GUESS, 7, lattice.points, PROBLEM.pressures[modes], PROBLEM.wavenumbers[modes], ORDERS[modes], centre
    )
    maps = lattice_landscape(PROBLEM, lattice, GUESS, 7, centre, modes)
    assert maps.shape == (8, *lattice.shape)
    np.testing.assert_allclose(maps.reshape(8, -1), expected, atol=1e-10)
    fits = lattice_fits(PROBLEM, lattice, GUESS, 7, centre, modes, 1.0)
    for start in (0, 400, len(lattice.points) - 1):
        best, least = best_candidate(lattice, centre, modes, fits, start)
        assert best == expected.sum(axis=0).argmin()
        assert least == pytest.approx(expected.sum(axis=0).min(), rel=1e-9)


@pytest.mark.parametrize("known_weight", [1.0, 1000.0])
@pytest.mark.parametrize("n", [0, 7, 23])
def test_compiled_fits_are_the_fits_of_the_dictionary(n, known_weight):
    """With microphones on the lattice and off it, and with a mode whose W is rank-deficient without microphone n."""
    lattice = search_lattice(PROBLEM, 2)
    centre, modes = lattice.nearest(CENTRE), slice(1, 9)
    weights = known_weights(PROBLEM, known_weight)
    mixed = np.where(np.arange(len(GUESS))[:, None] % 2, lattice.nearest(GUESS), GUESS)
    for positions in (mixed, np.repeat(mixed[:8], 3, axis=0)):
        W = lattice.dictionary(positions, centre, range(1, 9))
        expected = leave_one_out_fits(W, PROBLEM.pressures[modes], n, weights=weights)
        tables = lattice_fits(PROBLEM, lattice, positions, n, centre, modes, known_weight)
        assert tables.triangular.tolist() == [fit.triangular for fit in expected]
        for found in (tables, FitTables.of(expected)):
            costs = candidate_costs(lattice, centre, modes, found)
            for values, fit, m in zip(costs, expected, range(1, 9), strict=True):
                rows = lattice.dictionary(lattice.points, centre, [m])[0]
                np.testing.assert_allclose(values, fit.cost_of(rows), rtol=1e-8, atol=1e-11)
    assert not tables.triangular.all(), "three microphones in each place carry few functions"


@pytest.mark.parametrize("seed", range(6))
def test_pruned_search_is_the_argmin_of_all_candidates(seed):
    """From positions anywhere, first with few modes and then with many, and wherever the search starts."""
    rng = np.random.default_rng(seed)
    lattice = search_lattice(PROBLEM, 2)
    positions = lattice.points[rng.choice(len(lattice.points), len(GUESS), replace=False)]
    centre, n = lattice.nearest(positions.mean(axis=0)), int(rng.integers(len(GUESS)))
    for modes in (slice(0, 1), slice(0, 3), slice(2, 10)):
        fits = lattice_fits(PROBLEM, lattice, positions, n, centre, modes, 1000.0)
        total = candidate_costs(lattice, centre, modes, fits).sum(axis=0)
        for start in (int(total.argmin()), int(total.argmax()), lattice.index(positions[n])):
            best, least = best_candidate(lattice, centre, modes, fits, start)
            assert best == total.argmin()
            assert least == pytest.approx(total.min(), rel=1e-12)


def test_of_equal_candidates_the_first_in_the_lattice_is_taken():
    """Without pressure at the microphone and a field of zero, every candidate costs the same."""
    lattice = search_lattice(PROBLEM, 2)
    centre, modes = lattice.nearest(CENTRE), slice(0, 3)
    fits = lattice_fits(PROBLEM, lattice, lattice.nearest(GUESS), 7, centre, modes, 1.0)
    silent = replace(fits, p_n=np.zeros(3, complex), columns=np.zeros_like(fits.columns))
    assert best_candidate(lattice, centre, modes, silent, 500) == (0, pytest.approx(fits.r0.sum()))


def test_weights_make_the_cost_dimensionless():
    louder = MEASUREMENT.__class__(**{**vars(MEASUREMENT), "pressures": MEASUREMENT.pressures * 17.0})
    np.testing.assert_allclose(louder.problem().pressures, PROBLEM.pressures)
    np.testing.assert_allclose(louder.problem("raw").pressures, MEASUREMENT.pressures * 17.0)


def test_modes_that_the_microphones_cannot_carry_are_refused():
    problem = measured(TRUTH[:8], [0, 1, 2], highest=300.0).problem()
    with pytest.raises(InputError, match=r"2L \+ 1 = .* functions for 8 microphones; use at most"):
        require_modes(problem, 2, 30)
    with pytest.raises(InputError, match="were measured; use at most"):
        require_modes(problem, 2, 1000)


@pytest.mark.parametrize("known_weight", [1.0, 50.0])
def test_known_weight_multiplies_the_squared_residual_of_the_known_microphones(known_weight):
    """The fit without microphone n, weighted, is the minimum of sum_i w_i |residual_i|^2, found by brute force."""
    n, m = 7, 3
    W = fourier_bessel(GUESS, PROBLEM.wavenumbers[m], ORDERS[m], CENTRE)
    rows = fourier_bessel(CANDIDATES, PROBLEM.wavenumbers[m], ORDERS[m], CENTRE)
    fit = leave_one_out_fits([W], PROBLEM.pressures[m : m + 1], n, weights=known_weights(PROBLEM, known_weight))[0]
    weights = np.ones(len(GUESS))
    weights[[0, 1, 2]] = known_weight
    expected = []
    for row in rows:
        moved = W.copy()
        moved[n] = row
        A, b = np.sqrt(weights)[:, None] * moved, np.sqrt(weights) * PROBLEM.pressures[m]
        error = moved @ (np.linalg.pinv(A) @ b) - PROBLEM.pressures[m]
        expected.append(np.sum(weights * np.abs(error) ** 2))
    np.testing.assert_allclose(fit.cost_of(rows), expected, rtol=1e-7)
