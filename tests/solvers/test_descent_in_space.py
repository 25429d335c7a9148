"""Block coordinate descent on a lattice of three dimensions."""

import dataclasses

import numpy as np
import pytest
from fields import waves
from running import refuses
from solving import run_from

from fdcal.cost.eq7 import known_weights, leave_one_out_fits
from fdcal.cost.lattice import space_lattice
from fdcal.cost.maps import cost_maps, refined
from fdcal.model.measurement import Measurement
from fdcal.model.settings import Search, SolverSettings
from fdcal.model.validation import InputError, frozen_array
from fdcal.solvers import descent as descent

STEP, COUNT = 0.04, 30
SEARCH = Search((1.0, 1.0, 1.0), (0.8, 0.8, 0.8), STEP, 0.6)
SETTINGS = SolverSettings(name="descent", modes=12, first_modes=3, max_sweeps=5, ample_modes=3, order_offset=1)


def problem_of(truth, known, dimension=3):
    """Fields of many plane waves, from 55 to 190 Hz."""
    k = np.linspace(1.0, 3.5, SETTINGS.modes)
    return Measurement(
        343 * k / (2 * np.pi), waves(truth, k, 40, 5), 343.0, 3, positions=truth, known=np.arange(known), search=SEARCH,
        array_dimension=dimension,
    ).problem("unit")  # fmt: skip


# Every position is on the lattice.
TRUTH = np.array(SEARCH.origin) + STEP * np.random.default_rng(1).integers(2, 19, (COUNT, 3))
PROBLEM = problem_of(TRUTH, 26)


def near(problem, truth, metres, seed=0):
    """The first state with the free microphones `metres` off, on the lattice."""
    state, lattice = descent.init(problem, SETTINGS, seed), space_lattice(problem, 0)
    positions = lattice.nearest(truth + metres * np.random.default_rng(3).normal(size=truth.shape))
    positions[problem.known] = problem.known_positions
    centre = lattice.nearest(positions.mean(axis=0))
    return dataclasses.replace(state, positions=frozen_array(positions, float), centre=frozen_array(centre, float))


def test_few_unknown_microphones_are_found_exactly_from_anywhere_on_the_lattice():
    states = run_from(descent, PROBLEM, descent.init(PROBLEM, SETTINGS, 0))
    assert states[-1].converged and states[-1].last == SETTINGS.modes
    np.testing.assert_allclose(states[-1].positions, TRUTH, atol=1e-12)


def test_the_step_is_the_lowest_candidate_of_the_whole_lattice():
    """The search from coarse to fine finds all of these; here every candidate is tried."""
    problem, lattice = problem_of(TRUTH, 15), space_lattice(PROBLEM, 0)
    points = lattice.points
    assert len(points) == 21**3
    state = dataclasses.replace(near(problem, TRUTH, 0.05), last=8)
    for n in problem.free[:6]:
        offset = descent.landscape(problem, state, int(n), slice(0, 8))
        assert offset.shape == (8, 21, 21)
        lattice = space_lattice(problem, state.order_offset)
        W = lattice.dictionary(state.positions, state.centre, range(8))
        weights = known_weights(problem, SETTINGS.known_weight)
        fits = leave_one_out_fits(W, problem.pressures[:8], int(n), weights=weights)
        rows = lattice.dictionary(points, state.centre, range(8))
        every = sum(fit.cost_of(w) for fit, w in zip(fits, rows, strict=True))
        place, least = lattice.best(state.centre, slice(0, 8), fits, state.positions[n])
        assert least == pytest.approx(every.min(), rel=1e-9)
        np.testing.assert_allclose(place, points[every.argmin()])
        layer = np.isclose(points[:, 2], state.positions[n, 2])
        np.testing.assert_allclose(offset.sum(axis=0).ravel(), every[layer], rtol=1e-6)


def test_the_map_of_the_solver_is_of_the_layer_of_the_microphone_at_any_fineness():
    state, n = dataclasses.replace(near(PROBLEM, TRUTH, 0.03), last=6), 28
    coarse = cost_maps(PROBLEM, descent, state, n, (2, 5), None)
    fine = cost_maps(PROBLEM, descent, state, n, (2, 5), None, refined(SEARCH, 105))
    assert coarse.shape == (2, 21, 21) and fine.shape == (2, 105, 105)
    np.testing.assert_allclose(fine[:, 2::5, 2::5], coarse, rtol=1e-6)


def test_what_the_microphones_cannot_carry_or_fix_is_refused():
    with pytest.raises(InputError, match=r"\(L \+ 1\)\^2 = .* functions for 30 microphones"):
        descent.init(PROBLEM, dataclasses.replace(SETTINGS, order_offset=4), 0)
    assert descent.usable_modes(PROBLEM, SETTINGS) == 12
    refuses("four known microphones", lambda: descent.init(problem_of(TRUTH, 3), SETTINGS, 0))
    plane = dataclasses.replace(PROBLEM, array_dimension=2)
    refuses(r"array in a plane has dimension = 3", descent.init, plane, SETTINGS, 0)
