"""Descent's search over the lattice ends at the candidate where Eq. 7 is least."""

from dataclasses import replace

import numpy as np
import pytest
from fields import measured

from fdcal.cost.eq7 import known_weights, landscape, leave_one_out_fits
from fdcal.cost.expansion import require_modes
from fdcal.cost.lattice import best_candidate, search_lattice
from fdcal.model.validation import InputError, frozen_array

TRUTH = np.random.default_rng(3).uniform(-0.5, 0.5, (24, 2)) + [2.61, 2.31]
PROBLEM = measured(TRUTH, [0, 1, 2], highest=150.0).problem()
LATTICE = search_lattice(PROBLEM, 2)
GUESS = TRUTH + np.random.default_rng(4).normal(0, 0.05, TRUTH.shape)


def all_candidates(positions, n, centre, modes, weight):
    """Eq. 7 at every point of the lattice, summed over the modes."""
    numbers = range(len(LATTICE.orders))[modes]
    W = LATTICE.dictionary(positions, centre, numbers)
    fits = leave_one_out_fits(W, PROBLEM.pressures[modes], n, known_weights(PROBLEM, weight))
    rows = (LATTICE.dictionary(LATTICE.points, centre, [m])[0] for m in numbers)
    return sum(fit.cost_of(w) for fit, w in zip(fits, rows, strict=True))


def assert_best(positions, n, centre, modes, weight, total):
    place, least = best_candidate(PROBLEM, LATTICE, positions, n, centre, modes, weight)
    assert least == pytest.approx(total.min(), rel=1e-8, abs=1e-11)
    np.testing.assert_array_equal(place, LATTICE.points[total.argmin()])


@pytest.mark.parametrize("n", [3, 7, 23])
def test_the_search_is_the_argmin_of_the_landscape(n):
    """Wherever the microphone is when the search starts."""
    modes, centre = slice(1, 9), LATTICE.nearest(TRUTH.mean(axis=0))
    rest = PROBLEM.pressures[modes], PROBLEM.wavenumbers[modes], LATTICE.orders[modes], centre
    total = landscape(GUESS, n, LATTICE.points, *rest).sum(axis=0)
    for start in (GUESS[n], LATTICE.points[0], LATTICE.points[400], LATTICE.points[total.argmin()]):
        positions = GUESS.copy()
        positions[n] = start
        assert_best(positions, n, centre, modes, 1.0, total)


@pytest.mark.parametrize("known_weight", [1.0, 1000.0])
@pytest.mark.parametrize("n", [0, 7, 23])
def test_on_the_lattice_and_off_it_and_where_the_dictionary_has_no_full_rank(n, known_weight):
    modes, centre = slice(1, 9), LATTICE.nearest(TRUTH.mean(axis=0))
    mixed = np.where(np.arange(len(GUESS))[:, None] % 2, LATTICE.nearest(GUESS), GUESS)
    threes = np.repeat(mixed[:8], 3, axis=0)  # three microphones in each place carry few functions
    for positions in (mixed, threes):
        assert_best(
            positions, n, centre, modes, known_weight, all_candidates(positions, n, centre, modes, known_weight)
        )
    assert np.linalg.matrix_rank(LATTICE.dictionary(threes, centre, [8])[0], tol=1e-10) <= 8 < 2 * LATTICE.orders[8] + 1


@pytest.mark.parametrize("seed", range(6))
def test_from_positions_anywhere_first_with_few_modes_and_then_with_many(seed):
    rng = np.random.default_rng(seed)
    positions = LATTICE.points[rng.choice(len(LATTICE.points), len(GUESS), replace=False)]
    centre, n = LATTICE.nearest(positions.mean(axis=0)), int(rng.integers(len(GUESS)))
    for modes in (slice(0, 1), slice(0, 3), slice(2, 10)):
        assert_best(positions, n, centre, modes, 1000.0, all_candidates(positions, n, centre, modes, 1000.0))


def test_of_equal_candidates_the_first_in_the_lattice_is_taken():
    """Without any pressure every candidate costs nothing."""
    silent = replace(PROBLEM, pressures=frozen_array(np.zeros_like(PROBLEM.pressures), complex))
    centre = LATTICE.nearest(TRUTH.mean(axis=0))
    place, least = best_candidate(silent, LATTICE, LATTICE.nearest(GUESS), 7, centre, slice(0, 3), 1.0)
    assert least == 0.0
    np.testing.assert_array_equal(place, LATTICE.points[0])


def test_modes_that_the_microphones_cannot_carry_are_refused():
    problem = measured(TRUTH[:8], [0, 1, 2], highest=300.0).problem()
    with pytest.raises(InputError, match=r"2L \+ 1 = .* functions for 8 microphones; use at most"):
        require_modes(problem, 2, 30)
    with pytest.raises(InputError, match="were measured; use at most"):
        require_modes(problem, 2, 1000)
