"""Microphones in a rectangular room of known size: absolute positions, up to the room's own symmetries.

    step   one step of what follows
    sweep  the same: every microphone has moved once
    stage  an end of one of the phases

    search   the likeliest arrays on a lattice (`roomsearch`), from the lowest modes: one step
    near     all microphones move together, all modes in use, on the model that knows no source; what the lattice leaves
             unexplained counts as noise, less of it from stage to stage
    source   the likeliest places of the source on a lattice: one step
    rough    microphones, source and the walls' admittance together on the exact model
             (`fdcal.acoustics.room_modes`), some of the
             power taken for noise
    again    if much is left unexplained: the same, microphones first put where the source found says
    exact    the same, to the noise

If too much is left unexplained, other places of the source are tried, and other arrays. Known microphones only choose
among the room's symmetries; without them the array is put into the corner at the origin.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...acoustics.room_modes import diffuse_model
from ...model.problem import Problem
from ...model.settings import Search, SolverSettings
from ...model.validation import InputError, frozen_array
from ..interface import AssessmentMethod, Traits
from . import array_search, source_search
from .fit import FIRST_DAMPING, damped, diffuse_terms, exact
from .multistart import EXACT, NEW_DAMPING, begin, end, from_source, hopeless
from .state import ROUGH, State, freedom, noise_of, require_enough, require_room, scaled

TRAITS = Traits(
    moves_all=True,
    needs_search=False,
    needs_room=True,
    adds_modes=False,
    starts=(),
    draws_order=False,
    takes_positions=True,
    settings=None,
    assessment=AssessmentMethod.KNOWN_ROOM,
    uses_likelihood=False,
)

SPREADS = (0.3, 0.1, 0.03)  # lattice steps, of the stages "near"
SETTLED = {"near": 3e-3, "rough": 1e-3, "again": 1e-3, "exact": 1e-6}  # metres
MOST_STEPS = {"near": 12, "rough": 12, "again": 12, "exact": 20}  # of one stage
SOURCES = 4  # tried with each array
HOPELESS = 6.0  # times noise and ROUGH: more of it left, and an attempt ends before the exact stage
MARGIN = 1e-3  # metres between microphone and wall, at least
LOUDEST_WALLS = 0.2  # admittance at most


def init(problem: Problem, settings: SolverSettings, seed: int, positions=None) -> State:
    """Microphones in the middle of the room, or at `positions` (N, D), metres, the search or what follows it ahead.

    Raises InputError for a room that cannot be, or that the measurement does not fit, and for too few modes.
    """
    size = require_room(problem, settings)
    N, D = problem.pressures.shape[1], len(size)
    noise, told = noise_of(problem, settings)
    return State(
        positions=frozen_array(np.tile(np.asarray(size) / 2, (N, 1)) if positions is None else positions, float),
        walls=frozen_array(np.zeros(D + 2), float), noise_power=frozen_array(noise, float), noise_told=told,
        settings=settings, seed=seed, step=0, sweep=0, stage=0, moved=-1, first=1, last=settings.modes, automatic=True,
        phase="search" if positions is None else "near", arrays=(), sources=(), width=array_search.WIDTHS[0],
        round=0, stage_steps=0, damping=FIRST_DAMPING, best=None, hopeless=None, cost=0.0,
        finished=False, converged=False,
    )  # fmt: skip


def step(problem: Problem, state: State) -> State:
    """`state` after one step; unchanged if finished."""
    if state.finished:
        return state
    p, noise, k = scaled(problem, state, state.modes)
    taken = replace(state, step=state.step + 1, sweep=state.sweep + 1, stage_steps=state.stage_steps + 1)
    return {"search": _search, "near": _near, "source": _source, "rough": _exact, "again": _exact, "exact": _exact}[
        state.phase
    ](problem, taken, p, noise, k)


def use_modes(problem: Problem, state: State, first: int, last: int, automatic: bool) -> State:
    """`state` with modes `first` to `last` in use (from 1, both included), from the positions where it is."""
    if not 1 <= first <= last <= len(problem.frequencies):
        raise InputError(f"modes {first} to {last} are no range of 1 to {len(problem.frequencies)}")
    require_enough(*state.positions.shape, last - first + 1)
    phase = "search" if state.phase == "search" else "near"
    noise, told = noise_of(problem, state.settings)  # an end may have put its own in place
    changed = replace(state, first=first, last=last, automatic=automatic, phase=phase, arrays=(), sources=())
    return replace(
        changed,
        noise_power=frozen_array(noise, float),
        noise_told=told,
        round=0,
        stage_steps=0,
        damping=FIRST_DAMPING,
        best=None,
        hopeless=None,
        finished=False,
        converged=False,
    )


def landscape(problem: Problem, state: State, n: int, modes: slice, search: Search | None = None) -> np.ndarray:
    """Cost of microphone `n` over the search lattice, the others held, mode by mode : (modes, ny, nx) float64."""
    search = problem.search if search is None else search
    if search is None:
        raise InputError("the measurement has no search domain", "give <search> and <radius>", key="search")
    points = search.layer(*state.positions[n, 2:])
    p, noise, k = scaled(problem, state, modes)
    model = diffuse_model(state.settings.room, k, state.width)
    costs = array_search.Places(points.reshape(-1, points.shape[-1]), p, noise + ROUGH, model).costs(state.positions, n)
    costs -= np.minimum(costs.min(axis=1, keepdims=True), 0.0)
    return costs.reshape(len(p), *points.shape[:2])


def usable_modes(problem: Problem, settings: SolverSettings) -> int:
    """Return the number of modes measured."""
    return len(problem.frequencies)


def _inside(positions, size) -> np.ndarray:
    return np.clip(positions, MARGIN, np.asarray(size) - MARGIN)


def _search(problem: Problem, state: State, p, noise, k) -> State:
    found = array_search.likeliest(p, noise, k, state.settings.room)
    return begin(replace(state, arrays=tuple(found), stage=state.stage + 1))


def _near(problem: Problem, state: State, p, noise, k) -> State:
    size = state.settings.room
    between = array_search.step_of(k, size)
    model = diffuse_model(size, k, state.width)
    noise = array_search.spread(noise, k, len(size), SPREADS[state.round] * between)
    x = state.positions.ravel()
    trial = damped(
        x,
        diffuse_terms(x, p, noise, model),
        lambda y: diffuse_terms(y, p, noise, model).cost,
        lambda y: _inside(y.reshape(-1, len(size)), size).ravel(),
        len(x),
        state.damping,
        between,
    )
    positions = frozen_array(trial.theta.reshape(-1, len(size)), float)
    after = replace(state, positions=positions, cost=trial.cost, damping=trial.damping)
    if trial.moved >= SETTLED["near"] and state.stage_steps < MOST_STEPS["near"]:
        return after
    after = replace(after, stage=state.stage + 1, stage_steps=0, damping=FIRST_DAMPING)
    last = state.round + 1 == len(SPREADS)
    return replace(after, phase="source") if last else replace(after, round=state.round + 1)


def _source(problem: Problem, state: State, p, noise, k) -> State:
    found = source_search.sources(state.positions, p, k, state.settings.room, SOURCES)
    return from_source(replace(state, sources=tuple(found), stage=state.stage + 1))


def _exact(problem: Problem, state: State, p, noise, k) -> State:
    size = state.settings.room
    N, D = state.positions.shape
    v = noise + ROUGH * (state.phase != "exact")

    def kept(theta):
        theta = np.array(theta)
        theta[: N * D + D] = _inside(theta[: N * D + D].reshape(-1, D), size).ravel()
        theta[N * D + D] = np.clip(theta[N * D + D], 0.0, LOUDEST_WALLS)
        return theta

    trial = damped(
        state.theta,
        exact(state.theta, p, v, k, size).terms(state.theta, N, D),
        lambda y: exact(y, p, v, k, size, False).terms(y, N, D).cost,
        kept,
        N * D,
        state.damping,
        array_search.step_of(k, size),
    )
    positions = frozen_array(trial.theta[: N * D].reshape(N, D), float)
    walls = frozen_array(trial.theta[N * D :], float)
    after = replace(state, positions=positions, walls=walls, cost=trial.cost, damping=trial.damping)
    settled = trial.moved < SETTLED[state.phase]
    if not settled and state.stage_steps < MOST_STEPS[state.phase]:
        return after
    after = replace(after, stage=state.stage + 1, stage_steps=0)
    if state.phase == "exact":
        return end(problem, after, settled)
    if trial.cost <= HOPELESS * freedom(len(p), N, D):
        return replace(after, **EXACT)
    if state.phase == "rough":
        anew = source_search.put_anew(positions, walls, p, k, size)
        return replace(after, phase="again", positions=frozen_array(anew, float), damping=NEW_DAMPING)
    return hopeless(after)
