"""Microphones in a rectangular room of known size: absolute positions, up to the symmetries of the room.

    step   one step of a phase
    sweep  the same: every microphone has moved once
    stage  a phase, or a part of phase "diffuse" with one lattice error

    search     the likeliest arrays on a lattice, from the lowest modes: one step
    diffuse    all microphones move together, all modes in use, by the diffuse model, which needs no source; the error
               of the lattice counts as noise, less of it from stage to stage
    source     the likeliest places of the source on a lattice: one step
    rough      microphones, source and the admittance of the walls together by the exact model
               (`fdcal.acoustics.room_modes`), part of the power counted as noise
    relocated  the same, after each microphone is placed where the source found says
    exact      the same, with the noise of the measurement

`_following` says what follows each phase, and when another place of the source or another array is tried. Known
microphones only select one of the symmetries of the room; without them the array is put into the corner at the origin.
"""

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from ...acoustics.room_modes import TRUNCATION, diffuse_model, nearest_symmetry, room_symmetries
from ...cost.expansion import search_domain
from ...model.problem import Problem, mode_power
from ...model.settings import Search, SolverSettings
from ...model.validation import Complexes, InputError, Numbers, Reals, frozen_array
from ..estimate import RoomEstimate
from ..interface import RunState, Traits
from ..levenberg_marquardt import FIRST_DAMPING
from ..requirements import require_measured, require_range
from .fit import (
    WIDTHS,
    ArrayCandidate,
    LatticePoints,
    SourceCandidate,
    bounded_inverse,
    bounded_step,
    degrees_of_freedom,
    diffuse_terms,
    exact,
    find_arrays,
    find_sources,
    fitted_size,
    lattice_step,
    noise_with_errors,
    relocate,
)

TRAITS = Traits(moves_all=True, needs_room=True, takes_positions=True)


@dataclass(frozen=True)
class PhaseLimits:
    """A phase ends when no coordinate moves further than `tolerance`, metres, or after `max_steps` steps."""

    tolerance: float
    max_steps: int = 12


PHASES = {
    "diffuse": PhaseLimits(tolerance=3e-3),
    "rough": PhaseLimits(tolerance=1e-3),
    "relocated": PhaseLimits(tolerance=1e-3),
    "exact": PhaseLimits(tolerance=1e-6, max_steps=20),
}

PhaseName = Literal["search", "diffuse", "source", "rough", "relocated", "exact"]


@dataclass(frozen=True)
class Phase:
    """The present stage."""

    name: PhaseName  # one of those at the top of this module
    spread: int  # index into the lattice errors that phase "diffuse" goes through
    steps: int  # taken in this stage
    damping: float  # of the next step


@dataclass(frozen=True)
class RoomOptimum:
    """Where a restart has ended."""

    positions: Reals  # (N, D) float64, metres
    walls: Reals  # (D + 2,) float64, as of `State`
    cost: float
    converged: bool  # whether it ended because no microphone moved


@dataclass(frozen=True)
class Restarts:
    """What is left to try, and what was found."""

    arrays: tuple[ArrayCandidate, ...] = ()  # candidates of the array search, the next first
    sources: tuple[SourceCandidate, ...] = ()  # candidates of the source search for the present array, the next first
    best: RoomOptimum | None = None  # the best local optimum of phase "exact"
    rejected: RoomOptimum | None = None  # the best of those before phase "exact", which left too much unexplained


@dataclass(frozen=True)
class MeasurementNoise:
    """Noise power (M,) of all modes measured, in the unit of abs(pressures)**2, and whether it was reported."""

    power: np.ndarray
    given: bool


@dataclass(frozen=True)
class State(RunState):
    """Everything `step` needs; `cost`: in phase "exact" squared residuals over the noise; before, -log likelihood."""

    solver: ClassVar[str] = "room"

    phase: Phase
    restarts: Restarts
    noise: MeasurementNoise
    walls: Reals  # (D + 2,) float64, source, metres, and admittance of the walls, real and imaginary part
    width: float  # rad/m, half the width of a resonance, of the diffuse model

    @property
    def size(self) -> tuple[float, ...]:
        """Lengths of the room, metres."""
        assert self.settings.room is not None  # `init` raises without it
        return self.settings.room

    @property
    def theta(self) -> np.ndarray:
        """The unknowns of the exact model : (N D + D + 2,) float64."""
        return np.concatenate([self.positions.ravel(), self.walls])


def init(problem: Problem, settings: SolverSettings, seed: int, positions: np.ndarray | None = None) -> State:
    """Return the first state: the microphones in the middle of the room, and phase "search" next.

    With `positions` (N, D), metres, phase "diffuse" starts at these; nothing is drawn by the `seed`.
    """
    size = _require_room(problem, settings)
    N, D = problem.pressures.shape[1], len(size)
    return State(
        positions=frozen_array(np.tile(np.asarray(size) / 2, (N, 1)) if positions is None else positions, float),
        settings=settings,
        seed=seed,
        last=settings.modes,
        phase=Phase("search" if positions is None else "diffuse", 0, 0, FIRST_DAMPING),
        restarts=Restarts(),
        noise=_noise(problem, settings),
        walls=frozen_array(np.zeros(D + 2), float),
        width=WIDTHS[0],
    )


NOISE_GUESS = 1e-4  # where none is reported


def _noise(problem: Problem, settings: SolverSettings) -> MeasurementNoise:
    """Return the noise that the settings or the measurement report, or a guess."""
    power = mode_power(problem.pressures)
    if settings.snr_db is not None:
        return MeasurementNoise(frozen_array(power / (1 + 10 ** (settings.snr_db / 10)), float), True)
    reported = problem.noise_power if settings.noise == "reported" else None
    if reported is not None and np.all(reported > 0):  # a simulation without noise is still no exact room
        return MeasurementNoise(frozen_array(reported, float), True)
    return MeasurementNoise(frozen_array(NOISE_GUESS * power, float), False)


MIN_NOISE = 1e-6  # where it is reported that there is none


def scaled(problem: Problem, state: State, modes: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return pressures of unit RMS (modes, N), their noise power (modes,) and wavenumbers (modes,), rad/m."""
    p = problem.pressures[modes]
    power = mode_power(p)
    noise = np.maximum(state.noise.power[modes] / power, MIN_NOISE)
    return p / np.sqrt(power)[:, None], noise, problem.wavenumbers[modes]


def step(problem: Problem, state: State) -> State:
    """Return `state` after one step; the same state if it is finished."""
    if state.finished:
        return state
    p, noise, k = scaled(problem, state, state.modes)
    phase = replace(state.phase, steps=state.phase.steps + 1)
    state = replace(state, step=state.step + 1, sweep=state.sweep + 1, phase=phase)
    if phase.name == "search":
        arrays = tuple(find_arrays(p, noise, k, state.size))
        return _following(problem, replace(state, restarts=replace(state.restarts, arrays=arrays)), True)
    if phase.name == "source":
        sources = tuple(find_sources(state.positions, p, k, state.size))
        return _following(problem, replace(state, restarts=replace(state.restarts, sources=sources)), True)
    state, moved = _fitted(state, p, noise, k)
    converged = moved < PHASES[phase.name].tolerance
    if converged or phase.steps >= PHASES[phase.name].max_steps:
        return _following(problem, state, converged)
    return state


ROUGH_NOISE = 1e-3  # added until the admittance of the walls is known
LATTICE_ERRORS = (0.3, 0.1, 0.03)  # lattice steps, of the stages of phase "diffuse"
MARGIN = 1e-3  # metres, least distance between a microphone and a wall
MAX_ADMITTANCE = 0.2  # of the walls


def _fitted(state: State, p: Complexes, noise: Reals, k: Numbers) -> tuple[State, float]:
    """Return the state after one damped step with the model of its phase, and how far a coordinate moved, metres."""
    size, name, max_step = state.size, state.phase.name, lattice_step(k, state.size)
    N, D = state.positions.shape
    if name == "diffuse":
        v = noise_with_errors(noise, k, D, LATTICE_ERRORS[state.phase.spread] * max_step)
        model, theta = diffuse_model(size, k, state.width), state.positions.ravel()
        terms = diffuse_terms(theta, p, v, model)

        def cost(y: Reals) -> float:
            return diffuse_terms(y, p, v, model).cost
    else:
        v, theta = noise + ROUGH_NOISE * (name != "exact"), state.theta
        terms = exact(theta, p, v, k, size).terms

        def cost(y: Reals) -> float:
            return exact(y, p, v, k, size, False).cost

    low = np.concatenate([np.full(N * D + D, MARGIN), [0.0, -np.inf]])[: len(theta)]
    high = np.tile(np.asarray(size) - MARGIN, N + 1)
    high = np.concatenate([high, [MAX_ADMITTANCE, np.inf]])[: len(theta)]
    trial = bounded_step(theta, terms, cost, (low, high), N * D, state.phase.damping, max_step)
    positions = frozen_array(trial.unknowns[: N * D].reshape(N, D), float)
    walls = state.walls if name == "diffuse" else frozen_array(trial.unknowns[N * D :], float)
    phase = replace(state.phase, damping=trial.damping)
    return replace(state, positions=positions, walls=walls, cost=trial.cost, phase=phase), trial.moved


CONFIRMED = 1.5  # times the reported noise: a local optimum that leaves less needs no restart
REJECTED = 6.0  # times ROUGH_NOISE and noise: a local optimum that leaves more has no phase "exact"
EXACT_DAMPING = 1e-2  # of the first step of the exact model


def _following(problem: Problem, state: State, converged: bool) -> State:
    """Return what follows the end of a phase, which was reached because no microphone moved if `converged`.

    search     a restart, with the first array
    diffuse    diffuse with the next lattice error; after the last one, source
    source     a restart, with the first place of the source
    rough      exact if enough is explained, otherwise relocated
    relocated  exact if enough is explained, otherwise a restart; if none is left, exact from the best so far
    exact      the end if the noise explains the rest, or for the second time the same optimum; otherwise a restart;
               if none is left, the end

    restart    rough from the next place of the source; if none is left, diffuse from the next array
    """
    state = replace(state, stage=state.stage + 1, phase=replace(state.phase, steps=0))
    name, spread, tried = state.phase.name, state.phase.spread, state.restarts
    freedom = degrees_of_freedom(state.last - state.first + 1, *state.positions.shape)
    if name == "diffuse":
        more = spread + 1 < len(LATTICE_ERRORS)
        return _begin(state, "diffuse", spread + 1) if more else _begin(state, "source", spread)
    if name in ("rough", "relocated") and state.cost <= REJECTED * freedom:
        return _begin(state, "exact", spread)
    if name == "rough":
        p, _, k = scaled(problem, state, state.modes)
        positions = frozen_array(relocate(state.positions, state.walls, p, k, state.size), float)
        return _begin(replace(state, positions=positions), "relocated", spread, EXACT_DAMPING)
    if name == "relocated":
        best, agreed = _best(tried.rejected, state, False)
        state = replace(state, restarts=replace(tried, rejected=best, sources=() if agreed else tried.sources))
        return _restart(state) or _begin(replace(state, positions=best.positions, walls=best.walls), "exact", spread)
    if name == "exact":
        best, agreed = _best(tried.best, state, converged)
        state = replace(state, restarts=replace(tried, best=best))
        left = best.cost / freedom
        unexplained = left > CONFIRMED and (state.noise.given or left * NOISE_GUESS > ROUGH_NOISE)
        following = _restart(state) if unexplained and not agreed and state.automatic else None
        return following or _finished(problem, state, best, left)
    following = _restart(state)
    assert following is not None  # a search finds one candidate at least
    return following


def _begin(state: State, name: PhaseName, spread: int, damping: float = FIRST_DAMPING) -> State:
    return replace(state, phase=Phase(name, spread, 0, damping))


def _restart(state: State) -> State | None:
    """Return the next restart; None if none is left."""
    tried = state.restarts
    if tried.sources:
        source, *others = tried.sources
        walls = frozen_array([*source.place, source.admittance, 0.0], float)
        state = replace(state, walls=walls, restarts=replace(tried, sources=tuple(others)))
        return _begin(state, "rough", state.phase.spread, EXACT_DAMPING)
    if tried.arrays:
        array, *others = tried.arrays
        restarts = replace(tried, arrays=tuple(others))
        return _begin(replace(state, positions=array.positions, width=array.width, restarts=restarts), "diffuse", 0)
    return None


SAME_COST = 0.02  # relative difference of the costs of two restarts that have found the same optimum


def _best(before: RoomOptimum | None, state: State, converged: bool) -> tuple[RoomOptimum, bool]:
    """Return the better of two local optima, one of them that of the state, and whether their costs are the same."""
    here = RoomOptimum(state.positions, state.walls, state.cost, converged)
    if before is None:
        return here, False
    same = abs(here.cost - before.cost) < SAME_COST * before.cost
    return here if here.cost < before.cost else before, same


def _finished(problem: Problem, state: State, best: RoomOptimum, left: float) -> State:
    """Return the end of a run, in the symmetry nearest to the known microphones or in the corner at the origin.

    Noise that was not reported is estimated: `left` is the squared residual over the noise and the freedom.
    """
    size, D, x = state.size, len(state.size), best.positions
    if len(problem.known):
        image = nearest_symmetry(x[problem.known], problem.known_positions, size)
    else:
        image = min(room_symmetries(size), key=lambda image: list(image.apply(x).mean(axis=0).round(9)))
    noise = state.noise.power if state.noise.given else state.noise.power * left
    return replace(
        state,
        positions=frozen_array(image.apply(x), float),
        walls=frozen_array([*image.apply(best.walls[:D]), *best.walls[D:]], float),
        cost=best.cost,
        noise=replace(state.noise, power=frozen_array(noise, float)),
        finished=True,
        converged=best.converged,
    )


def use_modes(problem: Problem, state: State, first: int, last: int, automatic: bool) -> State:
    """Return `state` with modes `first` to `last` in use, counted from 1; the solver continues from its positions."""
    require_range(problem, first, last)
    N, D = state.positions.shape
    _require_enough(N, D, last - first + 1)
    state = replace(state, first=first, last=last, automatic=automatic, finished=False, converged=False)
    noise = _noise(problem, state.settings)  # a finished state has its own estimate
    again = _begin(state, "search" if state.phase.name == "search" else "diffuse", 0)
    return replace(again, restarts=Restarts(), noise=noise)


def landscape(problem: Problem, state: State, n: int, modes: slice, domain: Search | None = None) -> np.ndarray:
    """Return the cost of microphone `n` over the search lattice, the others constrained : (modes, ny, nx)."""
    points = (search_domain(problem) if domain is None else domain).layer(*state.positions[n, 2:])
    p, noise, k = scaled(problem, state, modes)
    model = diffuse_model(state.size, k, state.width)
    lattice = LatticePoints(points.reshape(-1, points.shape[-1]), p, noise + ROUGH_NOISE, model)
    costs = lattice.costs(state.positions, n)
    costs -= np.minimum(costs.min(axis=1, keepdims=True), 0.0)
    return costs.reshape(len(p), *points.shape[:2])


def usable_modes(problem: Problem, settings: SolverSettings) -> int:
    """Return the number of modes measured."""
    return len(problem.frequencies)


def result(problem: Problem, state: State) -> RoomEstimate:
    """Return what the solver has found.

    The covariance is that of the exact model with its source, walls and loudness unknown, enlarged by the excess
    residual.
    """
    size, (N, D) = state.settings.room, state.positions.shape
    assert size is not None  # `init` requires it
    p, noise, k = scaled(problem, state, state.modes)
    fit = exact(state.theta, p, noise, k, size)
    residual = float(np.sum(np.abs(fit.residual) ** 2)) / degrees_of_freedom(len(p), N, D)
    covariance = bounded_inverse(fit.terms.curvature) * max(1.0, residual)
    part = np.abs(fit.fitted) ** 2
    left_out = (p - fit.fitted) / np.maximum(1 - part / part.sum(axis=1, keepdims=True), 1e-9)
    noise_fraction = float(np.exp(np.mean(np.log(noise)))) * (residual if state.noise.given else 1.0)
    return RoomEstimate(
        problem, state.modes, state.positions, state.converged, p, left_out,
        np.array([covariance[D * n : D * n + D, D * n : D * n + D] for n in range(N)]),
        residual, np.sum(np.abs(fit.residual) ** 2, axis=0), noise_fraction, state.noise.given, tuple(map(float, size)),
        fitted_size(state.theta, p, noise, k, size, residual), state.walls[:D], complex(*state.walls[D:]),
        tuple(room_symmetries(size)),
    )  # fmt: skip


MAX_RESPONSE = 1e7  # complex numbers of the exact model's response


def _require_room(problem: Problem, settings: SolverSettings) -> tuple[float, ...]:
    """Return the size of the room, metres; raise InputError without it, or where the measurement does not fit it."""
    size, D, modes = settings.room, problem.dimension, settings.modes
    if size is None:
        remedy = "give <room> LxW, or LxWxH for a field of three dimensions"
        raise InputError('solver "room" needs the size of the room', remedy, key="room")
    takes = np.unique(problem.takes)
    if len(takes) > 1:
        remedy = f"use measurement.of_take({takes[0]}), or another solver"
        raise InputError(f'solver "room" seeks one source, and there are {len(takes)} takes', remedy, key="takes")

    text = "x".join(f"{length:g}" for length in size)

    def error(message: str, remedy: str) -> InputError:
        return InputError(f"room = {text}{message}", remedy, key="room", value=size)

    if len(size) != D:
        raise error(f" has {len(size)} lengths, but the sound field has {D} dimensions", "give as many")
    if problem.array_dimension != D:
        raise InputError("a known room gives all three coordinates", "set array_dimension = 3 in the measurement")
    require_measured(problem, modes)
    _require_enough(problem.pressures.shape[1], D, modes)
    highest = np.real(problem.wavenumbers[:modes]).max()
    if highest < np.pi / max(size):
        lowest = f"{problem.sound_speed / 2 / max(size):.4g} Hz"
        message = f": so small a room has its first resonance at {lowest}, above all frequencies in use"
        raise error(message, "give <room> in metres")
    top = np.sqrt(TRUNCATION.decay / TRUNCATION.tau(D) + highest**2) / np.pi  # where the exact model's sum ends
    if modes * np.prod([1 + top * length for length in size]) > MAX_RESPONSE:
        raise error(": a room so large has too many modes", "give <room> in metres")
    outside = np.flatnonzero(np.any((problem.known_positions < 0) | (problem.known_positions > size), axis=1))
    if len(outside):
        message = f": known microphone {problem.known[outside[0]]} at {problem.known_positions[outside[0]].tolist()} m"
        remedy = "give positions from a corner of the room, or <known> none"
        raise error(f"{message} stands outside", remedy)
    return size


def _require_enough(count: int, D: int, modes: int) -> None:
    """Raise InputError if the pressures of `count` microphones are fewer than the unknowns."""
    needed = -(-(count * D + D + 2) // max(count - 1, 1))
    if count < 2 or modes < needed:
        message = f"{modes} modes of {count} microphones are too few for a known room"
        remedy = f"use {needed} modes (<modes>) or more, and two microphones at least"
        raise InputError(message, remedy, key="modes", value=modes)
