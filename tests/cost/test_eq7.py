"""Laws of the cost, Eq. 7, and of its landscape."""

from itertools import pairwise

import numpy as np
import pytest
from fields import measured

from fdcal.acoustics.dictionary import fourier_bessel, max_order
from fdcal.cost.eq7 import coefficients, cost, known_weights, landscape, leave_one_out_fits, residual

TRUTH = np.random.default_rng(3).uniform(-0.5, 0.5, (24, 2)) + [2.61, 2.31]
MEASUREMENT = measured(TRUTH, [0, 1, 2], highest=150.0)
PROBLEM = MEASUREMENT.problem()
ORDERS = max_order(PROBLEM.wavenumbers, 0.8, 2)
CENTRE = TRUTH.mean(axis=0)
GUESS = TRUTH + np.random.default_rng(4).normal(0, 0.05, TRUTH.shape)
CANDIDATES = np.random.default_rng(5).uniform(-0.6, 0.6, (50, 2)) + CENTRE


ARGUMENTS = (PROBLEM.pressures, PROBLEM.wavenumbers, ORDERS, CENTRE)


def test_landscape_is_eq_7_by_brute_force():
    """By a pseudo-inverse for every candidate."""
    found = landscape(GUESS, 7, CANDIDATES, *ARGUMENTS)
    for m, (p, k, L) in enumerate(zip(PROBLEM.pressures, PROBLEM.wavenumbers, ORDERS, strict=True)):
        for c, candidate in enumerate(CANDIDATES):
            moved = GUESS.copy()
            moved[7] = candidate
            W = fourier_bessel(moved, k, L, CENTRE)
            assert found[m, c] == pytest.approx(np.sum(np.abs(W @ (np.linalg.pinv(W) @ p) - p) ** 2), abs=1e-10)


def test_landscape_at_the_microphone_is_the_cost():
    here = landscape(GUESS, 5, GUESS[5:6], *ARGUMENTS)[:, 0]
    np.testing.assert_allclose(here, cost(GUESS, *ARGUMENTS), atol=1e-10)


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


@pytest.mark.parametrize("order", [3, 6])
def test_microphones_at_fewer_places_than_functions_are_fitted_by_their_means(order):
    """Any pressures at five places are a field of seven functions; only differences at one place are left over."""
    at, k = np.arange(20) % 5, PROBLEM.wavenumbers[[0, 4, 8]]
    p = PROBLEM.pressures[[0, 4, 8]][:, :20]
    means = np.stack([p[:, at == place].mean(axis=1) for place in at], axis=1)
    arguments = p, k, [order] * 3, CENTRE
    np.testing.assert_allclose(residual(GUESS[at], *arguments), means - p, atol=1e-9)
    for one, wavenumber in zip(p, k, strict=True):
        W = fourier_bessel(GUESS[at], wavenumber, order, CENTRE)
        distinct = one.reshape(4, 5).mean(axis=0)  # of all solutions Eq. 5 takes the one of least norm
        shortest = W[:5].conj().T @ np.linalg.solve(W[:5] @ W[:5].conj().T, distinct)
        np.testing.assert_allclose(coefficients(W, one), shortest, atol=1e-6 * np.abs(shortest).max())
    there = landscape(GUESS[at], 7, GUESS[[at[7]]], *arguments)[:, 0]
    np.testing.assert_allclose(there, np.sum(np.abs(means - p) ** 2, axis=1), atol=1e-9)


def test_functions_too_small_to_be_told_from_rounding_errors_explain_nothing():
    """J_l(z) of an array far smaller than the wavelength is below 1e-12 from some order on."""
    k, p = np.array([0.1]), np.random.default_rng(6).normal(size=(1, 24)) + 0j
    enough, ample = (cost(GUESS, p, k, [order], CENTRE)[0] for order in (8, 11))
    assert ample == pytest.approx(enough, rel=1e-9)


def test_truth_explains_the_pressures_and_ample_order_is_better():
    k = PROBLEM.wavenumbers
    totals = [
        cost(TRUTH, PROBLEM.pressures[:5], k[:5], max_order(k[:5], 0.8, offset), CENTRE).sum() for offset in range(4)
    ]
    assert all(after < before / 30 for before, after in pairwise(totals))
    assert residual(TRUTH, PROBLEM.pressures[:5], k[:5], max_order(k[:5], 0.8, 3), CENTRE) == pytest.approx(0, abs=1e-4)


def test_cost_does_not_change_under_translation_rotation_and_mirror():
    angle = 0.8
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    here = cost(GUESS, *ARGUMENTS)
    for move in (np.eye(2), turn, turn @ np.diag([1, -1])):
        there = cost(GUESS @ move.T + [3, -2], *ARGUMENTS[:3], move @ CENTRE + [3, -2])
        np.testing.assert_allclose(there, here, rtol=1e-7, atol=1e-12)


def test_weights_make_the_cost_dimensionless():
    louder = MEASUREMENT.__class__(**{**vars(MEASUREMENT), "pressures": MEASUREMENT.pressures * 17.0})
    np.testing.assert_allclose(louder.problem().pressures, PROBLEM.pressures)
    np.testing.assert_allclose(louder.problem("raw").pressures, MEASUREMENT.pressures * 17.0)


@pytest.mark.parametrize("known_weight", [0.01, 1.0, 50.0])
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
