"""Every solver, found by listing them, has the functions and the states that others rely on."""

from __future__ import annotations

import dataclasses

import pytest

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.model.scene_file import load_scene
from fdcal.model.settings import KNOWN_ROOM_SOLVERS
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
