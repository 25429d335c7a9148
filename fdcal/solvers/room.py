"""Microphones in a rectangular room of known size: absolute positions, up to the room's own symmetries.

    step   one step of what follows
    sweep  the same: every microphone has moved once
    stage  an end of one of the phases

    search   the likeliest arrays on a lattice (`roomsearch`), from the lowest modes: one step
    near     all microphones move together, all modes in use, on the model that knows no source; what the lattice leaves
             unexplained counts as noise, less of it from stage to stage
    source   the likeliest places of the source on a lattice: one step
    exact    microphones, source and the walls' admittance together on the exact model (`fdcal.rectangle`)

If too much is left unexplained, other places of the source are tried, and other arrays. Known microphones only choose
among the room's symmetries; without them the array is put into the corner at the origin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..checks import InputError, frozen_array
from ..measurement import Problem
from ..rectangle import Diffuse, diffuse, images, nearest_image
from ..scene import Solver
from . import roomsearch
from .roomcheck import require_room
from .roomfit import FIRST_DAMPING, damped, diffuse_terms, exact

SEARCH_MODES = 30  # the lowest, of the search
LATTICE = 0.6  # lattice steps: how far a microphone may be from its place on the lattice
SPREADS = (0.3, 0.1, 0.03)  # lattice steps, of the stages "near"
ROUGH = 1e-3  # of the power, taken for noise until the walls are known
SETTLED = {"near": 3e-3, "rough": 1e-3, "exact": 1e-6}  # metres
MOST_STEPS = {"near": 12, "rough": 12, "exact": 20}  # of one stage
ARRAYS, SOURCES = 3, 2  # tried
AGREED = 0.02  # of the cost: two attempts that end so alike have both found what there is
HOPELESS = 6.0  # times noise and ROUGH: more of it left, and an attempt ends before the exact stage
CONVINCING = 1.5  # times the noise told: less of it, and the end needs no other attempt
GUESS = 1e-4  # noise's share of the power where none is told
LEAST_NOISE = 1e-6  # likewise where it is told that there is none
MARGIN = 1e-3  # metres between microphone and wall, at least
LOUDEST_WALLS = 0.2  # admittance at most


@dataclass(frozen=True)
class State:
    """Everything `step` needs to go on.

    Attributes
    ----------
    positions : (N, D) float64, metres, read-only
    settings : Solver; its `room` is the size
    seed : int, unused: nothing is drawn
    step, sweep, stage : steps taken (twice), stages completed
    moved : -1, since all microphones move
    first, last : modes in use, counted from 1, both included
    automatic : whether the phases follow one another by themselves
    phase : "search", "near", "source", "rough" or "exact"
    arrays : of `roomsearch.arrays`, those left to try
    sources : of `roomsearch.sources`, likewise
    walls : (D + 2,) float64, source, metres, and admittance, real and imaginary part
    round : which of SPREADS
    stage_steps : steps taken in the present stage
    damping : of the next step
    best : (positions, walls, cost) of the attempts before, or None
    noise_power : (M,) float64, of all modes measured, told or estimated, in the unit of abs(problem.pressures)**2
    noise_told : whether it was told
    cost : squared residuals over the noise in phase "exact"; before, twice -log likelihood
    finished : nothing is left to do
    converged : finished because nothing moved any more, not because steps ran out
    """

    positions: np.ndarray
    settings: Solver
    seed: int
    step: int
    sweep: int
    stage: int
    moved: int
    first: int
    last: int
    automatic: bool
    phase: str
    arrays: tuple
    sources: tuple
    walls: np.ndarray
    round: int
    stage_steps: int
    damping: float
    best: tuple | None
    noise_power: np.ndarray
    noise_told: bool
    cost: float
    finished: bool
    converged: bool

    @property
    def modes(self) -> slice:
        """Indices of the modes in use."""
        return slice(self.first - 1, self.last)

    @property
    def theta(self) -> np.ndarray:
        """The unknowns of the exact model."""
        return np.concatenate([self.positions.ravel(), self.walls])


def init(problem: Problem, settings: Solver, seed: int, positions=None) -> State:
    """Microphones in the middle of the room, or at `positions` (N, D), metres, the search or what follows it ahead.

    Raises InputError for a room that cannot be, or that the measurement does not fit, and for too few modes.
    """
    size = require_room(problem, settings)
    N, D = problem.pressures.shape[1], len(size)
    noise, told = _noise(problem, settings)
    return State(
        positions=frozen_array(np.tile(np.asarray(size) / 2, (N, 1)) if positions is None else positions, float),
        walls=frozen_array(np.zeros(D + 2), float), noise_power=frozen_array(noise, float), noise_told=told,
        settings=settings, seed=seed, step=0, sweep=0, stage=0, moved=-1, first=1, last=settings.modes, automatic=True,
        phase="search" if positions is None else "near", arrays=(), sources=(), round=0, stage_steps=0,
        damping=FIRST_DAMPING, best=None, cost=0.0, finished=False, converged=False,
    )  # fmt: skip


def step(problem: Problem, state: State) -> State:
    """`state` after one step; unchanged if finished."""
    if state.finished:
        return state
    p, noise, k = _scaled(problem, state, state.modes)
    taken = replace(state, step=state.step + 1, sweep=state.sweep + 1, stage_steps=state.stage_steps + 1)
    return {"search": _search, "near": _near, "source": _source, "rough": _exact, "exact": _exact}[state.phase](
        problem, taken, p, noise, k
    )


def use_modes(problem: Problem, state: State, first: int, last: int, automatic: bool) -> State:
    """`state` with modes `first` to `last` in use (from 1, both included), from the positions where it is."""
    if not 1 <= first <= last <= len(problem.frequencies):
        raise InputError(f"modes {first} to {last} are no range of 1 to {len(problem.frequencies)}")
    phase = "search" if state.phase == "search" else "near"
    changed = replace(state, first=first, last=last, automatic=automatic, phase=phase, arrays=(), sources=())
    return replace(changed, round=0, stage_steps=0, damping=FIRST_DAMPING, best=None, finished=False, converged=False)


def landscape(problem: Problem, state: State, n: int, modes: slice) -> np.ndarray:
    """Cost of microphone `n` over the search lattice, the others held, mode by mode : (modes, ny, nx) float64."""
    if problem.search is None:
        raise InputError("the measurement has no search domain; give --search ORIGIN,SIZE,STEP and --radius R")
    points = problem.search.layer(*state.positions[n, 2:])
    p, noise, k = _scaled(problem, state, modes)
    model = diffuse(state.settings.room, k)
    costs = roomsearch.landscape(state.positions, n, points.reshape(-1, points.shape[-1]), p, noise + ROUGH, model)
    return costs.reshape(len(p), *points.shape[:2])


def _noise(problem: Problem, settings: Solver) -> tuple[np.ndarray, bool]:
    """Noise power (M,) that the settings tell, or a guess."""
    power = np.mean(np.abs(problem.pressures) ** 2, axis=1)
    if settings.snr_db is not None:
        return power / (1 + 10 ** (settings.snr_db / 10)), True
    if problem.noise_power is not None and settings.noise == "told":
        return problem.noise_power, True
    return GUESS * power, False


def _scaled(problem: Problem, state: State, modes: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pressures of unit RMS (modes, N), their noise (modes,) and wavenumbers."""
    p = problem.pressures[modes]
    power = np.mean(np.abs(p) ** 2, axis=1)
    noise = np.maximum(state.noise_power[modes] / power, LEAST_NOISE)
    return p / np.sqrt(power)[:, None], noise, problem.wavenumbers[modes]


def _spread(noise, k, D: int, far: float) -> np.ndarray:
    """Noise and what microphones `far` away, metres, add to it."""
    return noise + np.minimum((np.real(k) * far) ** 2 / D, 0.5)


def _inside(positions, size) -> np.ndarray:
    return np.clip(positions, MARGIN, np.asarray(size) - MARGIN)


def _search(problem: Problem, state: State, p, noise, k) -> State:
    size, few = state.settings.room, slice(0, SEARCH_MODES)
    between = roomsearch.step_of(k[few])
    noise = _spread(noise[few], k[few], len(size), LATTICE * between)
    found = roomsearch.arrays(p[few], noise, diffuse(size, k[few]), size, between, ARRAYS)
    return _begin(replace(state, arrays=tuple(found[1:]), stage=state.stage + 1), found[0])


def _begin(state: State, positions) -> State:
    """The stages that follow the search, from `positions`."""
    begun = replace(state, positions=frozen_array(positions, float), phase="near", round=0)
    return replace(begun, stage_steps=0, damping=FIRST_DAMPING)


def _near(problem: Problem, state: State, p, noise, k) -> State:
    size = state.settings.room
    between = roomsearch.step_of(k)
    model: Diffuse = diffuse(size, k)
    noise = _spread(noise, k, len(size), SPREADS[state.round] * between)
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
    between = roomsearch.step_of(k)
    found = roomsearch.sources(state.positions, p, k, state.settings.room, between, SOURCES)
    return _from_source(replace(state, sources=tuple(found), stage=state.stage + 1))


def _from_source(state: State) -> State:
    """The exact stages from the next place of the source."""
    (place, admittance), *others = state.sources
    walls = frozen_array([*place, admittance, 0.0], float)
    return replace(state, walls=walls, sources=tuple(others), phase="rough", stage_steps=0, damping=1e-2)


def _exact(problem: Problem, state: State, p, noise, k) -> State:
    size = state.settings.room
    N, D = state.positions.shape
    v = noise + ROUGH * (state.phase == "rough")

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
        roomsearch.step_of(k),
    )
    positions = frozen_array(trial.theta[: N * D].reshape(N, D), float)
    walls = frozen_array(trial.theta[N * D :], float)
    after = replace(state, positions=positions, walls=walls, cost=trial.cost, damping=trial.damping)
    settled = trial.moved < SETTLED[state.phase]
    if not settled and state.stage_steps < MOST_STEPS[state.phase]:
        return after
    after = replace(after, stage=state.stage + 1, stage_steps=0)
    return (
        replace(after, phase="exact", damping=FIRST_DAMPING)
        if state.phase == "rough"
        else _end(problem, after, settled)
    )


def freedom(modes: int, count: int, D: int) -> float:
    """Complex numbers that the exact model leaves to the noise."""
    return max(modes * (count - 1) - (count * D + D + 2) / 2, 1.0)


def _end(problem: Problem, state: State, settled: bool) -> State:
    """The end, or another attempt where too much is left unexplained."""
    best = state.best
    agreed = best is not None and abs(state.cost - best[2]) < AGREED * best[2]
    if best is None or state.cost < best[2]:
        best = (state.positions, state.walls, state.cost, settled)
    N, D = state.positions.shape
    left = best[2] / freedom(state.last - state.first + 1, N, D)
    state = replace(state, best=best)
    if left > CONVINCING and state.automatic and not agreed and (state.noise_told or left * GUESS > ROUGH):
        if state.sources:
            return _from_source(state)
        if state.arrays:
            return _begin(replace(state, arrays=state.arrays[1:]), state.arrays[0])
    noise = state.noise_power if state.noise_told else state.noise_power * left
    positions, walls = _placed(problem, state.settings.room, best[0], best[1])
    ended = replace(state, positions=positions, walls=walls, cost=best[2], noise_power=frozen_array(noise, float))
    return replace(ended, finished=True, converged=best[3])


def _placed(problem: Problem, size, positions, walls) -> tuple[np.ndarray, np.ndarray]:
    """Positions and source in the symmetry nearest to the known microphones, or in the corner at the origin."""
    if len(problem.known):
        image = nearest_image(positions[problem.known], problem.known_positions, size)
    else:
        image = min(images(size), key=lambda image: tuple(np.round(image.of(positions).mean(axis=0), 9)))
    D = len(size)
    return (
        frozen_array(image.of(positions), float),
        frozen_array(np.concatenate([image.of(walls[:D]), walls[D:]]), float),
    )
