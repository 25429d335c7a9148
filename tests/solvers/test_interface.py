"""Every solver has the members on which other code relies."""

from dataclasses import FrozenInstanceError, replace
from itertools import pairwise

import numpy as np
import pytest
from fields import measured
from running import refuses
from solving import run_from

from fdcal import solvers
from fdcal.model.settings import Search, SolverSettings


@pytest.mark.parametrize("name", ["descent", "joint", "robust"])
def test_modes_set_by_the_user_stay_until_the_end_and_modes_that_were_not_measured_are_refused(name):
    solver = solvers.load(name)
    state = solver.use_modes(PROBLEM, solver.init(PROBLEM, replace(SETTINGS, name=name), 0), 3, 12, automatic=False)
    for after in run_from(solver, PROBLEM, state):
        assert (after.first, after.last) == (3, 12)
    resumed = solver.use_modes(PROBLEM, after, 1, 14, automatic=True)
    assert not resumed.finished and resumed.last == 14
    for first, last, words in ((9, 3, "range"), (1, 10_000, "measured"), *[(9, 9, "few")] * solver.TRAITS.moves_all):
        refuses(words, solver.use_modes, PROBLEM, state, first, last, automatic=True)


TRUTH = np.random.default_rng(5).uniform(-0.4, 0.4, (24, 2)) + [2.61, 2.31]
SEARCH = Search((2.01, 1.71), (1.2, 1.2), 0.04, 0.6)
PROBLEM = measured(TRUTH, list(range(12)), highest=200.0, search=SEARCH).problem()
SETTINGS = SolverSettings(name="descent", modes=20, first_modes=8, max_sweeps=2, order_offset=1)


@pytest.fixture(scope="module", params=["descent", "joint"])
def states(request):
    return list(solvers.run(PROBLEM, replace(SETTINGS, name=request.param), 0))


def test_steps_sweeps_and_stages_are_counted_on(states):
    assert states[0].step == states[0].sweep == states[0].stage == 0
    assert [state.finished for state in states] == [False] * (len(states) - 1) + [True]
    for before, after in pairwise(states):
        assert after.step == before.step + 1
        assert after.sweep - before.sweep in (0, 1) and after.stage - before.stage in (0, 1)


def test_states_are_frozen_and_a_finished_run_stays_where_it_is(states):
    """tests/session/test_session_file.py tests that a run can be continued from any state."""
    with pytest.raises(FrozenInstanceError):
        states[0].step = 3
    with pytest.raises(ValueError, match="read-only"):
        states[0].positions[0] = 0
    assert solvers.load(states[0].solver).step(PROBLEM, states[-1]) is states[-1]
