"""What a stage minimises, and one step towards the minimum.

The objective is the negative log likelihood of the modes in use plus the priors of gains, given positions and sound
speed, and the terms of arrivals and short windows if there are any. One vector holds the unknowns: the P parameters of
every microphone (its coordinates; where gains are free, log gain and phase; with filters, also delay d_n and corner
kappa_n), then the logarithm of the ratio of the sound speed to the one that the wavenumbers assume. The likelihood
depends only on the product of wavenumber and length, so that a higher sound speed is equivalent to a smaller array:

    d cost / d log c = sum_n [-(x_n - x_0) . d cost / d x_n - d_n d cost / d d_n + kappa_n d cost / d kappa_n]

x_0 is the mean position.

Gains and given positions have Student t priors of NU degrees of freedom,

    -log p = (NU + d) / 2 log(1 + e^2 / (NU sigma^2)),

where e is the deviation and d its number of components. Because of their long tails, a wrong gain or given position
hardly moves the others. In the Gauss-Newton matrix such a prior has the weight w = (NU + d) / (NU sigma^2 + e^2).
Positions that are given exactly have no prior: their coordinates are not free (`Objective.free`).

The second half of the module takes one Levenberg-Marquardt step of all free unknowns, and computes from a quadratic
approximation how far away the minimum is:

    H y = -g,   sigma_i^2 = (H^-1)_ii

g and H are gradient and Gauss-Newton matrix of the whole objective, priors included. A run has converged when the
Newton step y is a small fraction of sigma, because no limit in metres or nats suits all measurements.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...cost.likelihood import FieldModel, Terms, likelihood_terms, log_response
from ...model.gauge import align, rigid_motions
from ...model.problem import Problem, mode_power
from ...model.settings import SolverSettings
from ...model.validation import Integers, Reals, evenly_spaced, frozen_array
from ..levenberg_marquardt import FIRST_DAMPING, NewtonTerms, damped_step
from .arrivals import Arrivals, TakeSources, arrivals_of
from .state import (
    CORNER_SIGMA,
    DELAY_SIGMA,
    FIELD_POWER_FACTOR,
    GIVEN_SIGMA,
    NEGLIGIBLE_DECREASE,
    STAGE_DAMPING,
    STAGES,
    SUSPICIOUS,
    Model,
    State,
)
from .windows import WindowTerm

NU = 3.0  # degrees of freedom of the priors
EXACT = 1e-6  # metres; with a smaller stated sigma the given positions never move


@dataclass(frozen=True)
class Unknowns:
    """The unknowns that a step changes."""

    positions: Reals  # (N, D) float64, metres
    channels: Reals  # (N, 2) or (N, 4) float64, log gain, nepers, phase, radians, delay, metres, corner, rad/m
    log_speed: float = 0.0  # logarithm of the ratio of the sound speed to that of the measurement
    gains: bool = True  # whether the channels are among the unknowns
    filters: bool = False  # whether delays and corners of all channels are free; otherwise only those that are not 0

    @property
    def delays(self) -> np.ndarray | None:
        """Delay of each channel (N,), metres; None where they are not among the unknowns."""
        return self.channels[:, 2] if self.gains and self.channels.shape[1] > 2 else None

    @property
    def vector(self) -> np.ndarray:
        """All unknowns in one vector (N P + 1,)."""
        each = np.column_stack([self.positions, self.channels]) if self.gains else self.positions
        return np.append(each.ravel(), self.log_speed)

    def at(self, vector: np.ndarray) -> Unknowns:
        """Return the unknowns of a vector that has the layout of `vector`."""
        D = self.positions.shape[1]
        each = vector[:-1].reshape(len(self.positions), -1)
        channels = each[:, D:] if self.gains else self.channels
        return replace(self, positions=each[:, :D], channels=channels, log_speed=float(vector[-1]))


@dataclass(frozen=True)
class Priors:
    """Priors of gains, filters, given positions and sound speed."""

    # gain_sigma, phase_sigma: nepers and radians
    gain_sigma: float
    phase_sigma: float
    known: Integers  # (A,) int64, microphones whose position is given
    places: np.ndarray  # (A, D) float64, metres, their given positions
    known_sigma: float  # metres, one sigma of each given coordinate; 0 if the positions are exact
    # (N, 2) float64, nepers and radians, mean of the gains; 0 unless a channel has a gross fault, such as
    # inverted polarity
    offsets: Reals
    speed_sigma: float = 0.0  # standard deviation of the logarithm of the sound speed; 0 if the speed is fixed
    known_tail: float = NU  # degrees of freedom of the prior of the given positions; if large, it is nearly Gaussian
    # delay_sigma, corner_sigma: metres and rad/m; 0 if only faulty channels have filters, whose prior is then wide
    delay_sigma: float = 0.0
    corner_sigma: float = 0.0

    @property
    def constrained(self) -> np.ndarray:
        """Microphones whose given position is exact : (A,) int64."""
        return self.known if self.known_sigma == 0 else self.known[:0]

    def of_known(self, positions: Reals) -> tuple[float, np.ndarray, np.ndarray]:
        """Return cost of the given positions' prior, deviations (A, D), metres, and stiffness (A,), 1/m^2."""
        e, nu = positions[self.known] - self.places, self.known_tail
        square, D, sigma = np.sum(e**2, axis=1), e.shape[1], max(self.known_sigma, EXACT)
        cost = (nu + D) / 2 * float(np.sum(np.log1p(square / (nu * sigma**2))))
        return cost, e, prior_stiffness(square, sigma, D, nu)

    def without_given(self) -> Priors:
        """Return the priors without those of the given positions."""
        return replace(self, known=self.known[:0], places=self.places[:0])


def prior_stiffness(square: Any, sigma: float, components: int, freedom: float = NU):
    """Return the stiffness of the Student t prior at the squared deviation `square`."""
    return (freedom + components) / (freedom * sigma**2 + square)


@dataclass(frozen=True)
class Evaluation:
    """The objective at some unknowns."""

    cost: float  # nats, priors included
    # gradient, matrix: (U,) and (U, U) float64, gradient and Gauss-Newton matrix with respect to all U = N P + 1
    # unknowns; empty if only the cost is needed
    gradient: np.ndarray
    matrix: np.ndarray
    terms: Terms  # terms of the likelihood alone
    source: TakeSources | None = None  # sources of the arrivals; None without arrivals


@dataclass(frozen=True)
class Objective:
    """What a stage minimises."""

    pressures: np.ndarray  # (M, N) complex128, of the modes in use
    field: FieldModel  # at the sound speed `log_speed`
    priors: Priors
    log_speed: float = 0.0
    arrivals: Arrivals | None = None
    windows: WindowTerm | None = None
    tempering: float = 1.0  # divisor of the likelihood of the pressures

    def evaluate(self, unknowns: Unknowns, derivatives: bool = True) -> Evaluation:
        """Return the cost with priors and, if wanted, its derivatives."""
        field = self.field
        if unknowns.log_speed != self.log_speed:
            field = replace(field, wavenumbers=field.wavenumbers * np.exp(self.log_speed - unknowns.log_speed))
        x, channels, p = unknowns.positions, unknowns.channels, self.pressures
        if unknowns.gains:
            return self.with_priors(unknowns, likelihood_terms(x, p, field, channels, derivatives), derivatives)
        log_gain = log_response(channels, np.real(field.wavenumbers))[0]
        terms = likelihood_terms(x, p * np.exp(-log_gain), field, None, derivatives)
        return self.with_priors(unknowns, terms, derivatives)

    def with_priors(self, unknowns: Unknowns, terms: Terms, derivatives: bool = True) -> Evaluation:
        """Return the same as `evaluate`, from the `terms` of the likelihood at the unknowns."""
        gradient, matrix = np.zeros(0), np.zeros((0, 0))
        if derivatives:
            gradient, matrix = (part / self.tempering for part in _with_speed(unknowns, terms))
        cost, source = terms.cost / self.tempering + _add_priors(unknowns, self.priors, gradient, matrix), None
        if self.windows is not None:
            of_windows, slope, curvature = self.windows.terms(unknowns.positions)
            cost += of_windows
            if derivatives:
                index = arrival_index(unknowns)[: unknowns.positions.size]
                gradient[index] += slope
                matrix[np.ix_(index, index)] += curvature
        if self.arrivals is not None:
            of_arrivals = self.arrivals.terms(unknowns.positions, unknowns.log_speed, derivatives, unknowns.delays)
            cost, source = cost + of_arrivals.cost, of_arrivals.source
            if derivatives:
                index = arrival_index(unknowns)
                gradient[index] += of_arrivals.gradient.sum(axis=0)
                matrix[np.ix_(index, index)] += of_arrivals.matrix
        return Evaluation(cost, gradient, matrix, terms, source)

    def likelihood(self, unknowns: Unknowns) -> tuple[np.ndarray, np.ndarray]:
        """Return gradient (U,) and Gauss-Newton matrix (U, U) of the likelihood alone with respect to all unknowns."""
        gradient, matrix = _with_speed(unknowns, self.evaluate(unknowns).terms)
        return gradient / self.tempering, matrix / self.tempering

    def weakened(self) -> Objective:
        """Return the objective with a stronger field, which weakens the prior that the field is isotropic.

        A tempered objective is returned as it is, because its likelihood has been divided by the excess variance.
        """
        if self.tempering > 1:
            return self
        return replace(self, field=replace(self.field, power=FIELD_POWER_FACTOR * self.field.power))

    def with_start(self, source: TakeSources | None) -> Objective:
        """Return the objective whose fit of the sources begins at `source`, as found at similar unknowns."""
        if self.arrivals is None or source is None:
            return self
        return replace(self, arrivals=replace(self.arrivals, start=source))

    def free(self, unknowns: Unknowns) -> Integers:
        """Return the indices (F,) int64 of the unknowns that may move.

        Microphones whose given position is exact stay. `Unknowns.filters` says which delays and corners are free.
        """
        N, D = unknowns.positions.shape
        index = np.arange(unknowns.vector.size - 1).reshape(N, -1)
        freed = [np.delete(index[:, :D], self.priors.constrained, axis=0).ravel()]
        if unknowns.gains:
            filters = unknowns.channels[:, 2:]
            freed += [index[:, D : D + 2].T.ravel(), index[:, D + 2 :][(filters != 0) | unknowns.filters]]
        if self.priors.speed_sigma > 0:
            freed.append(np.array([unknowns.vector.size - 1]))
        return np.concatenate(freed)

    def finite_cost(self, unknowns: Unknowns) -> float:
        """Return the cost, or infinity if a covariance is singular, as with two microphones at one position."""
        try:
            return self.evaluate(unknowns, False).cost
        except np.linalg.LinAlgError:
            return np.inf


def _with_speed(unknowns: Unknowns, terms: Terms) -> tuple[np.ndarray, np.ndarray]:
    """Return gradient (U,) and Gauss-Newton matrix (U, U) of the likelihood with respect to all unknowns."""
    gradient, curvature = terms.newton()
    x, (N, D) = unknowns.positions, unknowns.positions.shape
    moves = np.zeros((N, D + unknowns.gains * unknowns.channels.shape[1]))  # equivalent to a rise of log c
    moves[:, :D] = x.mean(axis=0) - x
    if unknowns.delays is not None:
        moves[:, D + 2], moves[:, D + 3] = -unknowns.channels[:, 2], unknowns.channels[:, 3]
    direction = moves.ravel()
    H = curvature.reshape(direction.size, direction.size)
    across = H @ direction
    matrix = np.block([[H, across[:, None]], [across[None], np.array([[direction @ across]])]])
    return np.append(gradient.ravel(), direction @ gradient.ravel()), matrix


def _add_priors(unknowns: Unknowns, priors: Priors, gradient: Reals, matrix: Reals) -> float:
    """Return the cost of the priors; add their derivatives in place to gradient and matrix unless these are empty."""
    D, channels, known = unknowns.positions.shape[1], unknowns.channels, priors.known
    P, every, cost = D + unknowns.gains * channels.shape[1], np.arange(len(unknowns.positions)), 0.0

    def add(index: Integers | int, slope: Reals | float, stiffness: Reals | float) -> None:
        if len(gradient):
            gradient[index] += slope
            matrix[index, index] += stiffness

    if unknowns.gains:
        spreads = (priors.gain_sigma, priors.phase_sigma, priors.delay_sigma, priors.corner_sigma)
        for column, sigma in enumerate(spreads[: channels.shape[1]]):
            e = channels[:, column] - (priors.offsets[:, column] if column < 2 else 0.0)
            if sigma > 0:
                cost += (NU + 1) / 2 * np.sum(np.log1p(e**2 / (NU * sigma**2)))
                add(P * every + D + column, prior_stiffness(e**2, sigma, 1) * e, prior_stiffness(e**2, sigma, 1))
            else:
                wide = (DELAY_SIGMA, CORNER_SIGMA)[column - 2]
                cost += np.sum((e / wide) ** 2) / 2
                add(P * every + D + column, e / wide**2, 1 / wide**2)
    if len(known) and priors.known_sigma > 0:
        of_known, e, w = priors.of_known(unknowns.positions)
        cost += of_known
        for a in range(D):
            add(P * known + a, w * e[:, a], w)
    if priors.speed_sigma > 0:
        e = unknowns.log_speed / priors.speed_sigma
        cost += e**2 / 2
        add(-1, e / priors.speed_sigma, 1 / priors.speed_sigma**2)
    return float(cost)


def arrival_index(unknowns: Unknowns) -> np.ndarray:
    """Return indices int64 of the unknowns that arrivals depend on: coordinates, delays if free, and sound speed."""
    size, (N, D) = unknowns.vector.size, unknowns.positions.shape
    index = np.arange(size - 1).reshape(N, -1)
    delays = index[0, :0] if unknowns.delays is None else index[:, D + 2]
    return np.concatenate([index[:, :D].ravel(), delays, [size - 1]])


def in_unit_power(problem: Problem) -> Problem:
    """Return `problem` with pressures and noise of every mode scaled to a mean power of 1."""
    power = mode_power(problem.pressures)
    if np.allclose(power, 1.0, rtol=1e-9):
        return problem
    noise = None if problem.noise_power is None else problem.noise_power / power
    return replace(problem, pressures=problem.pressures / np.sqrt(power)[:, None], noise_power=noise)


# nepers and radians, prior sigma of gains and phases at the start; with 0.05 one array of the suite is not found
GAIN_SIGMA = 0.02
PHASE_SIGMA = 0.02


def first_model(problem: Problem, settings: SolverSettings) -> Model:
    """Return the model that a restart begins with."""
    M, N = problem.pressures.shape
    gain, phase = settings.gain_sigma_db, settings.phase_sigma_deg
    return Model(
        power=np.ones(int(M)),
        noise=0.1 * np.ones(M),
        channel_noise=np.ones(int(N)),
        noise_fraction=0.1,
        spread=0.0,
        gain_sigma=GAIN_SIGMA if gain is None else gain * np.log(10) / 20,
        phase_sigma=PHASE_SIGMA if phase is None else float(np.radians(phase)),
        known_sigma=first_known_sigma(problem, settings),
        damped=False,
        directional=False,
        places=frozen_array(problem.known_positions, float),
        contradicted=frozen_array(np.zeros(len(problem.known), bool), bool),
        filters=np.zeros((N, 2)),
    )


# For plane arrays in space, whose scale only given positions fix: one sigma of each given coordinate, metres, and the
# degrees of freedom of the prior of these positions, which is nearly Gaussian. With a sigma of 3 mm the errors of such
# arrays grow from 1.0 to 2.3 mm; with 3 degrees of freedom the error of 1 of 6 of them grows from 7 to 70 mm.
CARRYING_SIGMA = 1e-3
CARRYING_TAIL = 1e6


def first_known_sigma(problem: Problem, settings: SolverSettings) -> float:
    """Return the sigma of a given coordinate at the start, metres, 0 if exact; during a run it usually only falls."""
    if settings.known_sigma is not None:
        return settings.known_sigma if settings.known_sigma > EXACT else 0.0
    return CARRYING_SIGMA if given_carry_scale(problem) else GIVEN_SIGMA


def given_carry_scale(problem: Problem) -> bool:
    """Return whether only given positions fix the scale, as for a plane array in space."""
    return problem.array_dimension < problem.dimension


def given_in_use(problem: Problem, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Return the microphones (H,) whose given position is used, and these positions (H, D), metres."""
    right = ~state.model.contradicted
    return problem.known[right], state.model.places[right]


def gains_are_free(state: State) -> bool:
    """Return whether the present stage seeks the gains of the channels."""
    return STAGES[state.progress.stage].gains and state.settings.gains != "fixed"


def speed_is_free(problem: Problem, state: State) -> bool:
    """Return whether the sound speed is sought: it is uncertain, and given positions fix the scale."""
    return state.settings.sound_speed_sigma is not None and len(problem.known) > 1


def unknowns_of(state: State) -> Unknowns:
    """Return the unknowns of the present stage."""
    model, gains = state.model, gains_are_free(state)
    sought = model.delay_sigma > 0
    channels = np.hstack([state.gains, model.filters]) if sought or np.any(model.filters) else state.gains
    return Unknowns(state.positions, channels, model.log_speed, gains, sought)


def with_unknowns(state: State, moved: Unknowns) -> State:
    """Return `state` with the unknowns `moved`."""
    filters = moved.channels[:, 2:] if moved.channels.shape[1] > 2 else state.model.filters
    model = replace(state.model, filters=frozen_array(filters, float), log_speed=moved.log_speed)
    positions, gains = frozen_array(moved.positions, float), frozen_array(moved.channels[:, :2], float)
    return replace(state, positions=positions, gains=gains, model=model)


def used_modes(problem: Problem, state: State, max_count: int = 0) -> np.ndarray:
    """Return indices int64 of the modes in use, or of `max_count` evenly spaced ones of them if it is not 0."""
    count = len(problem.pressures[state.modes])
    return state.first - 1 + (evenly_spaced(count, max_count) if max_count else np.arange(count))


def wavenumbers(problem: Problem, state: State) -> np.ndarray:
    """Return the wavenumbers (M,) complex128, rad/m, at the sound speed of the state."""
    return problem.wavenumbers * np.exp(-state.model.log_speed)


def corrected(problem: Problem, state: State, used: Integers | slice) -> np.ndarray:
    """Return the pressures of the modes `used` divided by the responses of the channels."""
    k, filters = np.real(wavenumbers(problem, state)[used]), state.model.filters
    channels = np.hstack([state.gains, filters]) if np.any(filters) else state.gains
    return problem.pressures[used] * np.exp(-log_response(channels, k)[0])


def field_of(problem: Problem, state: State, used: Integers) -> FieldModel:
    """Return the field model of the modes `used`.

    used : (m,) int64, numbers of the modes, from 0. The wavenumbers are complex only where the model is damped, because
    complex ones cost more time.
    """
    model, k = state.model, wavenumbers(problem, state)[used]
    about = state.stage_start if model.damped or model.directional else None
    directions = model.directions[used] if model.directional and model.directions is not None else None
    power, noise = model.power[used], model.noise[used]
    k = k.astype(complex) if model.damped else np.real(k)
    return FieldModel(k, power, noise, model.channel_noise, problem.dimension, about, directions)


def objective_of(problem: Problem, state: State, used: Integers) -> Objective:
    """Return what the present stage minimises, over the modes `used`."""
    model = state.model
    speed = state.settings.sound_speed_sigma if speed_is_free(problem, state) else None
    tail = CARRYING_TAIL if given_carry_scale(problem) else NU
    given = given_in_use(problem, state)
    spreads = model.delay_sigma, model.corner_sigma
    sigmas, known_sigma = (model.gain_sigma, model.phase_sigma), model.known_sigma
    priors = Priors(*sigmas, *given, known_sigma, state.offsets, speed or 0.0, tail, *spreads)
    arrivals = None if model.arrival_sigma is None else arrivals_of(problem, model.arrival_sigma)
    field = field_of(problem, state, used)
    return Objective(
        problem.pressures[used], field, priors, model.log_speed, arrivals, window_term_of(model), model.tempering
    )


def window_term_of(model: Model) -> WindowTerm | None:
    """Return the term of the short windows; None if they are not used."""
    if model.window_positions is None or model.window_precision is None:
        return None
    return WindowTerm(model.window_positions, model.window_precision)


@dataclass(frozen=True)
class ChannelStep:
    """Result of one step; `terms`, `matrix` and `source` belong to the unknowns before it."""

    unknowns: Unknowns
    cost: float  # infinite if a covariance is singular
    decrease: float  # nats, decrease of the cost
    damping: float  # damping of the next step
    moved: float  # metres, largest change of a coordinate
    free: np.ndarray  # see `Objective.free`
    terms: Terms | None = None  # None if a covariance is singular
    matrix: Reals | None = None  # (F, F) float64, Gauss-Newton matrix in the free directions; None without `terms`
    source: TakeSources | None = None  # None without arrivals


def interpolation(positions: np.ndarray, constrained: np.ndarray) -> np.ndarray:
    """Return the weights (N, A) that interpolate the moves of `constrained` microphones (A,) smoothly over the array.

    This is kriging with the covariance (1 + r / l) exp(-r / l), where l is the radius of the array.
    """
    radius = np.sqrt(np.sum((positions - positions.mean(axis=0)) ** 2, axis=1).mean())
    r = np.asarray(np.linalg.norm(positions[:, None] - positions[constrained], axis=-1) / radius)
    K = (1 + r) * np.exp(-r)
    return K @ np.linalg.pinv(K[constrained], hermitian=True)


def channel_step(
    unknowns: Unknowns, objective: Objective, free: np.ndarray, damping: float, max_step: float = np.inf
) -> ChannelStep:
    """Return one damped Gauss-Newton step of the unknowns `free`, see `damped_step`; `max_step` in metres."""
    try:
        here = objective.evaluate(unknowns)
    except np.linalg.LinAlgError:
        return ChannelStep(unknowns, np.inf, 0.0, FIRST_DAMPING, 0.0, free)
    if not len(free):
        return ChannelStep(unknowns, here.cost, 0.0, FIRST_DAMPING, 0.0, free, here.terms, np.zeros((0, 0)))
    g, H = reduced(unknowns, here, free, objective.priors)
    before, near = unknowns.vector, objective.with_start(here.source)
    step = damped_step(
        before,
        NewtonTerms(here.cost, g, H),
        lambda tried: near.evaluate(unknowns.at(tried), False).cost,
        lambda y: before + np.bincount(free, y, before.size),
        lambda tried: float(np.abs(unknowns.at(tried).positions - unknowns.positions).max()),
        damping,
        max_step,
    )
    moved = unknowns.at(step.unknowns)
    return ChannelStep(moved, step.cost, step.decrease, step.damping, step.moved, free, here.terms, H, here.source)


def reduced(unknowns: Unknowns, here: Evaluation, free: np.ndarray, priors: Priors) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradient (F,) and the Gauss-Newton matrix (F, F) of the free unknowns.

    Directions along which the likelihood does not change get an artificial stiffness: the rigid motions of an array
    without given positions, and a gain, phase or delay that all channels share.
    """
    x = unknowns.positions
    N, D = x.shape
    g, H = here.gradient, here.matrix.copy()
    index = np.arange(len(g) - 1).reshape(N, -1)
    diagonal = np.diag(H)[:-1].reshape(N, -1)
    if not len(priors.known):
        motions = np.linalg.qr(rigid_motions(x))[0]
        placed = index[:, :D].ravel()
        H[np.ix_(placed, placed)] += np.mean(diagonal[:, :D]) * (motions @ motions.T)
    for column in (D, D + 1) if unknowns.gains else ():
        H[np.ix_(index[:, column], index[:, column])] += np.mean(diagonal[:, D : D + 2]) / N
    if unknowns.gains and unknowns.filters:
        H[np.ix_(index[:, D + 2], index[:, D + 2])] += np.mean(diagonal[:, D + 2]) / N
    return g[free], H[np.ix_(free, free)]


# Smaller eigenvalues of the scaled Gauss-Newton matrix, dimensionless, are raised to this; their directions are
# practically undetermined.
MIN_EIGENVALUE = 1e-13


def scaled_inverse(H: np.ndarray) -> np.ndarray:
    """Return the inverse of a positive semidefinite matrix (F, F) whose parameters may have different units."""
    scale = 1 / np.sqrt(np.diag(H))
    values, vectors = np.linalg.eigh(H * np.outer(scale, scale))
    return scale[:, None] * ((vectors / np.maximum(values, MIN_EIGENVALUE)) @ vectors.T) * scale


@dataclass(frozen=True)
class Quadratic:
    """The quadratic approximation of an objective about some unknowns, and its minimum."""

    unknowns: Unknowns
    free: np.ndarray  # (F,) int64, indices of the free unknowns, coordinates first
    gradient: np.ndarray  # (F,) float64
    inverse: np.ndarray  # (F, F) float64, of the Gauss-Newton matrix
    coordinates: np.ndarray  # (C,) int64, indices of the free coordinates among the N D ones
    covariance: Reals  # (N D, N D) float64, metres^2, of all coordinates; 0 for constrained ones
    # sigma, step: (N, D) float64, metres, one sigma of each coordinate, and the Newton step to the minimum
    sigma: Reals
    step: Reals
    decrease: float  # nats, difference of the cost here and at the minimum


def quadratic(unknowns: Unknowns, objective: Objective, here: Evaluation | None = None) -> Quadratic:
    """Return the quadratic approximation of an objective; `here` is its evaluation at the unknowns, if known."""
    evaluation, free = objective.evaluate(unknowns) if here is None else here, objective.free(unknowns)
    gradient, matrix = reduced(unknowns, evaluation, free, objective.priors)
    shape, size, inverse = unknowns.positions.shape, unknowns.positions.size, scaled_inverse(matrix)
    coordinates = np.delete(np.arange(size).reshape(shape), objective.priors.constrained, axis=0).ravel()
    newton, step = -inverse @ gradient, np.zeros(size)
    C, covariance = len(coordinates), np.zeros((size, size))
    covariance[np.ix_(coordinates, coordinates)] = inverse[:C, :C]
    step[coordinates] = newton[:C]
    sigma, decrease = np.sqrt(np.diag(covariance)).reshape(shape), -float(gradient @ newton) / 2
    return Quadratic(unknowns, free, gradient, inverse, coordinates, covariance, sigma, step.reshape(shape), decrease)


def descend(unknowns: Unknowns, objective: Objective, steps: int) -> tuple[Unknowns, float]:
    """Return the minimum near some unknowns, after `steps` steps at most, and the decrease of the cost."""
    damping, decrease, free = STAGE_DAMPING, 0.0, objective.free(unknowns)
    for _ in range(steps):
        trial = channel_step(unknowns, objective, free, damping)
        unknowns, damping, decrease = trial.unknowns, trial.damping, decrease + trial.decrease
        if trial.decrease < NEGLIGIBLE_DECREASE:
            break
    return unknowns, decrease


def sigmas_moved(before: Unknowns, trial: ChannelStep, healthy: np.ndarray) -> float:
    """Return the RMS move of the `healthy` (N,) bool microphones in a step, in sigmas of their coordinates."""
    if trial.matrix is None:
        return np.inf
    variance = np.full(before.vector.size, np.inf)
    variance[trial.free] = np.diag(scaled_inverse(trial.matrix))
    variance = variance[:-1].reshape(len(healthy), -1)[healthy, : before.positions.shape[1]]
    move = (trial.unknowns.positions - before.positions)[healthy]
    return float(np.sqrt(np.mean(move**2 / variance))) if np.any(healthy) else 0.0


# largest Newton step that may remain in a converged run, in sigmas of the coordinate
CONVERGED_SIGMAS = 0.2


def is_converged(problem: Problem, state: State) -> bool:
    """Return whether every healthy microphone is within a small fraction of its sigma from the minimum.

    A motion of the array as a whole does not count where uncertain given positions fix it, because `given.anchored`
    moves the array onto them at the end.
    """
    objective = objective_of(problem, state, used_modes(problem, state))
    try:
        there = quadratic(unknowns_of(state), objective)
    except np.linalg.LinAlgError:
        return False
    healthy = state.model.channel_noise < SUSPICIOUS
    step, anchored = there.step, len(problem.known) and problem.frame is None
    if anchored and not len(objective.priors.constrained) and np.any(healthy):
        step = align(state.positions + step, state.positions, healthy) - state.positions
    return bool(np.all(np.abs(step[healthy]) <= CONVERGED_SIGMAS * there.sigma[healthy]))
