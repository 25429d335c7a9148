"""Every solver has what others rely on; laws of chains of solvers."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from fields import measured

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.model.gauge import position_errors
from fdcal.model.scene import load_scene
from fdcal.model.settings import KNOWN_ROOM_SOLVERS, Search, SolverSettings
from fdcal.model.validation import InputError
from fdcal.solvers import descent, joint
from fdcal.solvers.interface import RunState, Traits


@pytest.mark.parametrize("name", solvers.names())
def test_a_solver_has_the_functions_and_traits_of_the_protocol(name):
    solver = solvers.load(name)
    assert isinstance(solver.TRAITS, Traits)
    assert all(
        callable(getattr(solver, function))
        for function in ("init", "step", "use_modes", "landscape", "result", "usable_modes")
    )


@pytest.mark.parametrize("name", [name for name in solvers.names() if "+" not in name])
def test_the_states_of_a_solver_are_frozen_run_states_of_its_name(name):
    State = solvers.load(name).State
    assert issubclass(State, RunState) and State.solver == name
    assert State.__dataclass_params__.frozen
    assert {field.name for field in dataclasses.fields(RunState)} < {field.name for field in dataclasses.fields(State)}


@pytest.mark.parametrize("name", [name for name in solvers.names() if not solvers.load(name).TRAITS.needs_room])
def test_a_run_begins_in_the_first_stage(name, cache):
    problem = cached_measurement(load_scene("tiny")).problem("unit")
    settings = solvers.with_mode_count(problem, dataclasses.replace(load_scene("tiny").solver, name=name))
    first = solvers.load(name).init(problem, settings, 0)
    assert (first.step, first.sweep, first.stage) == (0, 0, 0)


def test_the_model_and_the_solvers_agree_on_who_needs_the_room():
    assert tuple(name for name in solvers.names() if solvers.load(name).TRAITS.needs_room) == KNOWN_ROOM_SOLVERS


def test_a_chain_starts_like_its_first_member():
    descent, joint, chain = (solvers.load(name).TRAITS for name in ("descent", "joint", "descent+joint"))
    assert chain.default_start == descent.default_start != joint.default_start
    assert chain.needs_search and chain.draws_order and not chain.moves_all
    assert descent.ignores("noise") and not chain.ignores("noise")
    assert joint.uses_seed("random") and not joint.uses_seed(None) and chain.uses_seed("affine")


# Laws of chains of solvers.


TRUTH = np.random.default_rng(5).uniform(-0.4, 0.4, (24, 2)) + [2.61, 2.31]
SEARCH = Search((2.01, 1.71), (1.2, 1.2), 0.04, 0.6)
PROBLEM = measured(TRUTH, list(range(12)), highest=200.0, search=SEARCH).problem()
SETTINGS = SolverSettings(name="descent+joint", modes=20, first_modes=8, max_sweeps=2, order_offset=1)


@pytest.fixture(scope="module")
def states():
    return list(solvers.run(PROBLEM, SETTINGS, 0))


def turning_point(states) -> int:
    """Index of the first state of joint."""
    return next(i for i, state in enumerate(states) if isinstance(state, joint.State))


def test_the_names_are_documented():
    assert solvers.names() == ["descent", "descent+joint", "joint", "robust", "room"]
    assert (solvers.load("descent"), solvers.load("joint")) == (descent, joint)
    assert solvers.load("descent+joint").members == (descent, joint)
    for name in ("joint+descent", "descent+", "+", "chain", "newton", "staging", "starts", "descent+joint+joint", ""):
        with pytest.raises(InputError, match=r"solver.name = .* descent, descent\+joint, joint"):
            solvers.load(name)


def test_joint_begins_where_descent_has_ended(states):
    turn = turning_point(states)
    alone = list(solvers.run(PROBLEM, dataclasses.replace(SETTINGS, name="descent"), 0))
    assert turn == len(alone) - 1 > 5
    for one, other in zip(states[:turn], alone, strict=False):
        assert np.array_equal(one.positions, other.positions)
    assert np.array_equal(states[turn].positions, alone[-1].positions)
    assert all(isinstance(state, joint.State) for state in states[turn:])


def test_only_the_last_state_is_finished_and_it_is_better(states):
    assert [state.finished for state in states] == [False] * (len(states) - 1) + [True]
    assert states[-1].converged
    before, after = (position_errors(states[i].positions, TRUTH).mean() for i in (turning_point(states), -1))
    assert after < 3e-3 < before


def test_steps_sweeps_and_stages_are_counted_on(states):
    assert states[0].step == states[0].sweep == states[0].stage == 0
    for before, after in pairwise(states):
        assert after.step == before.step + 1
        assert after.sweep - before.sweep in (0, 1) and after.stage - before.stage in (0, 1)


def test_states_are_frozen_and_the_run_can_be_continued_from_any(states):
    chain, turn = solvers.load("descent+joint"), turning_point(states)
    for index in (0, turn - 1, turn, len(states) - 2):
        with pytest.raises(dataclasses.FrozenInstanceError):
            states[index].step = 3
        after = chain.step(PROBLEM, states[index])
        assert np.array_equal(after.positions, states[index + 1].positions) and after.step == index + 1
    assert chain.step(PROBLEM, states[-1]) is states[-1]


def test_modes_and_landscapes_are_those_of_the_solver_whose_state_it_is(states):
    chain = solvers.load("descent+joint")
    for state, module in ((states[3], descent), (states[-1], joint)):
        mine, own = (m.use_modes(PROBLEM, state, 1, 9, automatic=False) for m in (chain, module))
        assert type(mine) is type(own) is module.State and (mine.last, mine.cost) == (own.last, own.cost) == (
            9,
            own.cost,
        )
        maps = chain.landscape(PROBLEM, state, 12, slice(0, 2))
        np.testing.assert_array_equal(maps, module.landscape(PROBLEM, state, 12, slice(0, 2)))


def test_with_modes_set_by_the_user_the_chain_ends_with_the_active_member(states):
    chain = solvers.load("descent+joint")
    state = chain.use_modes(PROBLEM, states[turning_point(states) - 1], 1, 9, automatic=False)
    for _ in range(200):
        state = chain.step(PROBLEM, state)
        if state.finished:
            break
    assert state.finished and isinstance(state, descent.State)
    assert not chain.use_modes(PROBLEM, state, 1, 9, automatic=True).finished


def test_limits_of_the_second_member_are_reported_before_the_first_runs():
    with pytest.raises(InputError, match="modes are too few"):
        solvers.load("descent+joint").init(PROBLEM, dataclasses.replace(SETTINGS, modes=4, first_modes=3), 0)
