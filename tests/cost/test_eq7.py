"""Eq. 7: its value, the expansion that it needs, and the search of descent over the lattice."""

from dataclasses import replace

import numpy as np
import pytest
from fields import measured

from fdcal.acoustics.dictionary import fourier_bessel, max_order, spherical_bessel
from fdcal.cost.eq7 import (
    FieldExpansion,
    carried_modes,
    coefficients,
    cost,
    functions,
    known_weights,
    landscape,
    leave_one_out_fits,
    require_modes,
    residual,
    usable_modes,
)
from fdcal.cost.lattice import best_candidate, search_lattice
from fdcal.model.validation import InputError, frozen_array

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


# Rows of the dictionary over any points, and which modes the microphones can carry.


SPREAD = np.random.default_rng(3).uniform(-0.4, 0.4, (24, 2)) + [2.61, 2.31]
PLANE = measured(SPREAD, [0, 1, 2], modes=14).problem()
ARRAYS = [(2, 2), (3, 3), (3, 2)]  # dimensions of the field and of the array


@pytest.mark.parametrize("scale", [1.0, 4.0])
@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_rows_are_those_of_the_dictionary_up_to_a_factor_of_each_column(dimension, D, scale):
    """Inside the tables and beyond them."""
    problem = replace(PLANE, dimension=dimension, array_dimension=D)
    expansion = FieldExpansion(problem, 0)
    points, centre = scale * np.random.default_rng(0).uniform(-0.5, 0.5, (15, D)), np.full(D, 0.01)
    for group in expansion.groups(range(len(expansion.carried.modes))):
        for number, rows in zip(group, expansion.rows(points, centre, group), strict=True):
            order, k = int(expansion.carried.orders[number]), problem.wavenumbers[expansion.carried.modes[number]]
            build = fourier_bessel if dimension == 2 else spherical_bessel
            W = build(points, complex(k), order, centre)
            assert rows.shape == W.shape == (15, functions(problem, order))
            factor = np.sum(W * rows.conj(), axis=0) / np.sum(np.abs(rows) ** 2, axis=0)
            assert np.all(np.abs(rows * factor - W) < 1e-9 * np.abs(W).max(axis=0))


@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_a_mode_is_carried_that_has_fewer_functions_than_there_are_microphones(dimension, D):
    problem = replace(PLANE, dimension=dimension, array_dimension=D)
    count = functions(problem, int(carried_modes(problem, 0).orders[-1]))
    exactly, more = (
        carried_modes(replace(problem, pressures=np.ones((14, n), complex)), 0).modes for n in (count, count + 1)
    )
    assert len(exactly) < len(more)


def test_usable_modes_end_at_the_first_that_is_not_carried():
    problem = replace(PLANE, wavenumbers=PLANE.wavenumbers[[0, 1, 13, 2]], pressures=PLANE.pressures[:4, :9])
    assert carried_modes(problem, 2).modes.tolist() == [0, 1, 3]
    assert usable_modes(problem, 2) == 2


# Descent's search over the lattice ends at the candidate where Eq. 7 is least.


LATTICE = search_lattice(PROBLEM, 2)


def assert_best(positions, n, centre, modes, weight):
    """The search finds the least of Eq. 7, summed over the modes, at all points of the lattice."""
    numbers = range(len(LATTICE.orders))[modes]
    W = LATTICE.dictionary(positions, centre, numbers)
    fits = leave_one_out_fits(W, PROBLEM.pressures[modes], n, known_weights(PROBLEM, weight))
    rows = (LATTICE.dictionary(LATTICE.points, centre, [m])[0] for m in numbers)
    total = sum(fit.cost_of(w) for fit, w in zip(fits, rows, strict=True))
    place, least = best_candidate(PROBLEM, LATTICE, positions, n, centre, modes, weight)
    assert least == pytest.approx(total.min(), rel=1e-8, abs=1e-11)
    np.testing.assert_array_equal(place, LATTICE.points[total.argmin()])


@pytest.mark.parametrize("known_weight", [1.0, 1000.0])
@pytest.mark.parametrize("n", [0, 23])
def test_on_the_lattice_and_off_it_and_where_the_dictionary_has_no_full_rank(n, known_weight):
    modes, centre = slice(1, 9), LATTICE.nearest(CENTRE)
    mixed = np.where(np.arange(len(GUESS))[:, None] % 2, LATTICE.nearest(GUESS), GUESS)
    threes = np.repeat(mixed[:8], 3, axis=0)  # three microphones in each place carry few functions
    for positions in (mixed, threes):
        assert_best(positions, n, centre, modes, known_weight)
    assert np.linalg.matrix_rank(LATTICE.dictionary(threes, centre, [8])[0], tol=1e-10) <= 8 < 2 * LATTICE.orders[8] + 1


@pytest.mark.parametrize("seed", range(2))
def test_from_positions_anywhere_first_with_few_modes_and_then_with_many(seed):
    rng = np.random.default_rng(seed)
    positions = LATTICE.points[rng.choice(len(LATTICE.points), len(GUESS), replace=False)]
    centre, n = LATTICE.nearest(positions.mean(axis=0)), int(rng.integers(len(GUESS)))
    for modes in (slice(0, 1), slice(0, 3), slice(2, 10)):
        assert_best(positions, n, centre, modes, 1000.0)


def test_of_equal_candidates_the_first_in_the_lattice_is_taken():
    """Without any pressure every candidate costs nothing."""
    silent = replace(PROBLEM, pressures=frozen_array(np.zeros_like(PROBLEM.pressures), complex))
    centre = LATTICE.nearest(CENTRE)
    place, least = best_candidate(silent, LATTICE, LATTICE.nearest(GUESS), 7, centre, slice(0, 3), 1.0)
    assert least == 0.0
    np.testing.assert_array_equal(place, LATTICE.points[0])


def test_modes_that_the_microphones_cannot_carry_are_refused():
    problem = measured(TRUTH[:8], [0, 1, 2], highest=300.0).problem()
    with pytest.raises(InputError, match=r"2L \+ 1 = .* functions for 8 microphones; use at most"):
        require_modes(problem, 2, 30)
    with pytest.raises(InputError, match="were measured; use at most"):
        require_modes(problem, 2, 1000)
