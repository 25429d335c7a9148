"""Laws of block coordinate descent."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from fields import measured
from running import refuses
from solving import run_from

from fdcal import solvers
from fdcal.cost.lattice import plane_lattice
from fdcal.model.settings import Search, SolverSettings
from fdcal.solvers import descent as descent

# The microphones are on points of a coarse lattice, so that the true positions can be found exactly.
SEARCH = Search((2.01, 1.71), (1.2, 1.2), 0.1, 0.8)
GRID = np.array([(x, y) for x in range(13) for y in range(13)]) * 0.1 + [2.01, 1.71]
TRUTH = GRID[np.random.default_rng(1).choice(len(GRID), 20, replace=False)]
KNOWN = list(range(17))
PROBLEM = measured(TRUTH, KNOWN, highest=150.0, search=SEARCH).problem()
MODES = len(PROBLEM.pressures)
SETTINGS = SolverSettings(name="descent", modes=8, first_modes=2, max_sweeps=5, ample_modes=4)


def all_states(seed=0, settings=SETTINGS):
    return list(solvers.run(PROBLEM, settings, seed))


def test_the_step_is_the_argmin_of_the_landscape_and_few_unknown_microphones_are_found_exactly():
    """One microphone moves at a time, and a mode is added whenever the search is trapped."""
    states = all_states()
    for before, after in pairwise(states):
        np.testing.assert_array_equal(after.positions[KNOWN], TRUTH[KNOWN])
        moved = np.flatnonzero(np.any(before.positions != after.positions, axis=1))
        assert set(moved) <= {after.moved} and after.moved not in KNOWN
        lattice = plane_lattice(PROBLEM, before.order_offset)
        total = descent.landscape(PROBLEM, before, after.moved, before.modes).sum(axis=0)
        assert after.cost == pytest.approx(total.min(), rel=1e-7, abs=1e-12)
        np.testing.assert_array_equal(after.positions[after.moved], lattice.points[total.argmin()])
        assert after.last - before.last in (0, 1)
        if after.last > before.last:
            assert after.stage == before.stage + 1 and after.turn == 0
    assert states[0].last == 2 and states[-1].last == 8 and states[-1].finished and states[-1].converged
    np.testing.assert_allclose(states[-1].positions, TRUTH, atol=1e-12)


def test_cost_never_rises_while_centre_and_modes_stay():
    problem = measured(TRUTH, [0, 1, 2], highest=150.0, search=SEARCH).problem()
    state, compared = descent.init(problem, SETTINGS, 0), 0
    for _ in range(120):
        following = descent.step(problem, state)
        if np.array_equal(following.centre, state.centre) and state.last == following.last and state.step:
            after = descent.step(problem, following)
            if following.last == after.last:
                assert after.cost <= following.cost * (1 + 1e-9)
                compared += 1
        state = following
    assert compared > 20


def test_in_descending_order_the_highest_mode_comes_first_and_each_stage_adds_the_next_lower_one():
    states = all_states(settings=replace(SETTINGS, mode_order="descending"))
    assert (states[0].first, states[0].last) == (8, 8) and (states[-1].first, states[-1].last) == (1, 8)
    changes = {(one.first - two.first, two.last, two.stage - one.stage) for one, two in pairwise(states)}
    assert changes == {(0, 8, 0), (1, 8, 1)}


def test_trapped_means_a_whole_sweep_with_the_modes_in_use():
    """Modes change during a sweep; when the run converges, no microphone would still move."""
    state = all_states()[-1]
    for turn in range(1, len(PROBLEM.free)):
        midway = replace(state, turn=turn, finished=False, last=6)
        *_, end = run_from(descent, PROBLEM, descent.use_modes(PROBLEM, midway, 1, 8, automatic=False))
        assert end.converged and end.step - midway.step >= len(PROBLEM.free)


@pytest.mark.parametrize(
    ("known", "changes", "start", "words"),
    [
        ("all", {"known_positions": PROBLEM.known_positions + 5.0}, None, "search domain"),
        ("all", {"search": Search((2.01, 1.71), (0.2, 0.2), 0.1, 0.8)}, None, r"search\.step"),
        ("all", {"search": None}, None, "search domain"),
        ("all", {"pressures": np.outer(np.arange(1, 1 + MODES), TRUTH[:, 0]) + 0j}, "affine", "fewer than 2 direct"),
        ("none", {}, None, 'solver.known = "none".*use known all, or solver joint'),
        ("minimal", {}, None, 'solver.known = "minimal".*use known all, or solver joint'),
    ],
    ids=["known far away", "fewer candidates than microphones", "no domain", "one direction", "none", "minimal"],
)
def test_what_descent_cannot_solve_is_refused(known, changes, start, words):
    problem = replace(measured(TRUTH, KNOWN, highest=150.0, search=SEARCH).problem("unit", known), **changes)
    refuses(words, lambda: descent.init(problem, replace(SETTINGS, known=known, start=start), 0))


def test_the_affine_start_is_snapped_to_the_lattice_and_left_alone_by_the_seed():
    """For a field that is affine over the array the start is exact, so that only snapping remains."""
    rng = np.random.default_rng(0)
    shape = (len(PROBLEM.pressures), 2)
    slopes = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    problem = replace(PROBLEM, pressures=slopes @ (TRUTH - TRUTH.mean(axis=0)).T + rng.normal(size=(shape[0], 1)))
    for seed in (0, 1):
        state = descent.init(problem, replace(SETTINGS, start="affine"), seed)
        np.testing.assert_allclose(state.positions, TRUTH, atol=1e-12)
    near = descent.init(PROBLEM, replace(SETTINGS, start="affine"), 0).positions
    np.testing.assert_allclose(near, plane_lattice(PROBLEM, 2).nearest(near), atol=1e-12)
    assert np.abs(near - TRUTH).max() < 0.5 < np.abs(descent.init(PROBLEM, SETTINGS, 0).positions - TRUTH).max()
