"""Microphones in a rectangular room of known size: absolute positions, up to the symmetries of the room.

Microphones and source are searched on lattices and then fitted together, with two models of the field:

    diffuse model  a sum of the room's modes with random amplitudes, which needs no source
    exact model    the field of a point source in a room whose walls have an admittance (`fdcal.acoustics.room_modes`)

The solver goes through phases. A step is a step of one phase and moves every microphone, so that a sweep is the same. A
stage is a phase, or the part of phase "diffuse" with one lattice error.

    search     one step: find the likeliest arrays on a lattice, from the lowest modes
    diffuse    fit all microphones with the diffuse model; the error of the lattice counts as noise, and decreases from
               stage to stage
    source     one step: find the likeliest positions of the source on a lattice
    rough      fit microphones, source and admittance with the exact model; a part of the power counts as noise
    relocated  the same, after microphones were moved to where the source explains them better
    exact      the same, with the noise of the measurement

`_following` decides what follows a phase, and when another source position or another array is tried. Known microphones
only select one of the symmetries of the room; without them the array is put into the corner at the origin.

Pressures (M, N) have unit RMS in each mode, the noise (M,) is a fraction of their power, wavenumbers (M,) are in rad/m;
positions (N, D), points (C, D) and lengths of the room are in metres. `theta` holds all unknowns in one array: the
positions (N D) and, for the exact model, the source (D), the real and imaginary part of the admittance (2) and, if the
size of the room is unknown, the relative change of each length (D).

Searches on lattices:

    find_arrays   with the diffuse model. The loudest microphone is placed at every point of one part of the room, from
                  which reflections generate the whole. It determines the predicted pressures at all other points, so
                  that the other microphones are placed independently: the effort is the number of microphones times the
                  number of points.
    find_sources  with the exact model, for a given array
    relocate      with the exact model, for a given source: moves microphones that fit far better elsewhere
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from ..acoustics import room_modes
from ..acoustics.compiled import check_deadline
from ..cost.eq7 import search_domain
from ..model.problem import Problem, mode_power
from ..model.settings import Search, SolverSettings
from ..model.validation import Complexes, InputError, Numbers, Reals, frozen_array
from .interface import RoomEstimate, RunState, SizeFit, Traits
from .levenberg_marquardt import FIRST_DAMPING, DampedStep, NewtonTerms, damped_step
from .requirements import require_measured, require_range

Cost = Callable[[np.ndarray], float]  # cost of unknowns theta


MIN_CURVATURE = 1e-12  # least eigenvalue of a curvature, relative to the largest, in its inverse
MAX_SIZE_STEPS = 12  # steps of the fit of the size
SIZE_TOLERANCE = 1e-5  # metres; a shorter step ends the fit of the size
LARGE_RESIDUAL = 2.0  # reduced chi-square above which the fit of the size takes more than one step


@dataclass(frozen=True)
class RoomData:
    """The pressures of a room of known size."""

    pressures: np.ndarray  # (M, N) complex128, of unit RMS in each mode
    noise: Reals  # (M,) float64, fraction of their power
    wavenumbers: Numbers  # (M,), rad/m
    size: Sequence[float] | Reals  # (D,), metres


def degrees_of_freedom(modes: int, count: int, D: int) -> float:
    """Return the number of complex pressures of `count` microphones minus the number of complex unknowns."""
    return max(modes * (count - 1) - (count * D + D + 2) / 2, 1.0)


def field_power(pressures: Complexes, noise: Reals) -> np.ndarray:
    """Return s (M,) of the diffuse model: the power of the pressures minus that of the noise."""
    whole = mode_power(pressures)
    return np.maximum(whole - noise, 1e-3 * whole)


def diffuse_terms(theta: Reals, pressures: Complexes, noise: Reals, model: room_modes.DiffuseModel) -> NewtonTerms:
    """Return -log probability density of the diffuse model at positions `theta` (N D,), up to a constant.

    Its derivatives are included. `noise` (M,) includes the power that position errors add.
    """
    N, D = pressures.shape[1], model.kappa.shape[1]
    x = theta.reshape(N, D)
    W, dW = model.shapes(x), model.slopes(x)
    cost, gradient, hessian = 0.0, np.zeros((N, D)), np.zeros((N, D, N, D))
    for p, s, v, w in zip(pressures, field_power(pressures, noise), noise, model.weights, strict=True):
        C = np.asarray(s * (W * w) @ W.T + v * np.eye(N))
        inverse = np.linalg.inv(C)
        u = inverse @ p
        cost += float(np.linalg.slogdet(C)[1]) + float((p.conj() @ u).real)
        g = s * (dW * w) @ (W.T @ u)  # (D, N), slopes of the fitted field
        widening = s * np.einsum("dne,en->nd", dW * w, W.T @ inverse)
        gradient += 2 * widening - 2 * np.real(u.conj() * g).T
        hessian += 2 * np.real(np.einsum("an,nk,bk->nakb", g.conj(), inverse, g))
    return NewtonTerms(cost, gradient.ravel(), hessian.reshape(N * D, N * D))


@dataclass(frozen=True)
class Exact:
    """The exact model's residual at `theta`."""

    # theta, prior: (P,) float64; prior is 1 / standard deviation of the admittance, 0 for the other unknowns
    theta: Reals
    prior: Reals
    residual: Complexes  # (M, N) complex128, in standard deviations of the noise
    fitted: Complexes  # (M, N) complex128, A_m g_m, in the unit of the pressures
    # (M N, P) complex128, of the residual, by Kaufman's approximation, which omits the derivative of A_m
    jacobian: np.ndarray

    @property
    def cost(self) -> float:
        """The sum of the squared residuals and of the prior of the admittance."""
        return float(np.sum(np.abs(self.residual.ravel()) ** 2) + np.sum((self.prior * self.theta) ** 2))

    @property
    def terms(self) -> NewtonTerms:
        """The cost and its derivatives."""
        r, J, weights = self.residual.ravel(), self.jacobian, self.prior**2
        gradient = 2 * np.real(J.conj().T @ r) + 2 * weights * self.theta
        return NewtonTerms(self.cost, gradient, 2 * np.real(J.conj().T @ J) + 2 * np.diag(weights))


ADMITTANCE_SIGMA = 0.05  # prior sigma of the real and the imaginary part
DIFFERENCE = 1e-6  # step of the numerical derivatives by the admittance and by relative lengths


@np.errstate(all="ignore")
def exact(theta: Reals, data: RoomData, slopes: bool = True) -> Exact:
    """Return the exact model's residual, and its Jacobian if `slopes`; otherwise the Jacobian has no rows.

    Far outside the room values may overflow; the cost is then not finite, and no step is taken.
    """
    pressures, size, N, D = data.pressures, data.size, data.pressures.shape[1], len(data.size)
    source_at, walls_at, lengths_at = N * D, N * D + D, N * D + D + 2
    x, source = theta[:source_at].reshape(N, D), theta[source_at:walls_at]
    beta, longer = complex(*theta[walls_at:lengths_at]), theta[lengths_at:]
    size = tuple(np.asarray(size) * (1 + longer)) if len(longer) else tuple(size)
    room = room_modes.point_source_model(size, data.wavenumbers, beta)
    excited, shapes = room.excitation(source), room.shapes(x)
    g = room_modes.room_pressures(excited, shapes)
    square = np.sum(np.abs(g) ** 2, axis=1, keepdims=True)
    A = np.sum(g.conj() * pressures, axis=1, keepdims=True) / square
    scale = 1 / np.sqrt(data.noise)[:, None]
    prior = np.zeros(len(theta))
    prior[walls_at:lengths_at] = 1 / ADMITTANCE_SIGMA
    residual, jacobian = scale * (pressures - A * g), np.zeros((0, len(theta)))
    if not slopes:
        return Exact(theta, prior, residual, A * g, jacobian)

    def slope(size: Sequence[float] | Reals, beta: complex) -> np.ndarray:
        changed = room_modes.point_source_model(size, data.wavenumbers, beta)
        return (room_modes.room_pressures(changed.excitation(source), changed.shapes(x)) - g) / DIFFERENCE

    dg = np.zeros((*g.shape, len(theta)), complex)
    for a in range(D):
        dg[:, np.arange(N), D * np.arange(N) + a] = room_modes.room_pressures(excited, room.shapes(x, a))
        dg[:, :, source_at + a] = room_modes.room_pressures(room.excitation(source, a), shapes)
    dg[:, :, walls_at] = slope(size, beta + DIFFERENCE)
    dg[:, :, walls_at + 1] = 1j * dg[:, :, walls_at]
    for a, change in enumerate(longer):
        grown = 1 + DIFFERENCE / (1 + change)
        dg[:, :, lengths_at + a] = slope(np.where(np.arange(D) == a, grown, 1) * size, beta)
    along = np.sum(g.conj()[..., None] * dg, axis=1, keepdims=True) / square[..., None]
    jacobian = -(scale * A)[..., None] * (dg - g[..., None] * along)
    return Exact(theta, prior, residual, A * g, jacobian.reshape(-1, len(theta)))


def bounded_step(
    theta: Reals,
    terms: NewtonTerms,
    cost: Cost,
    bounds: tuple[np.ndarray | float, np.ndarray | float],
    coordinates: int,
    damping: float,
    max_step: float,
) -> DampedStep[np.ndarray]:
    """Return one damped Gauss-Newton step of unknowns `theta` (P,), clipped to their lower and upper `bounds`.

    No coordinate of a microphone, the first `coordinates` of the unknowns, moves further than `max_step`, metres.
    """

    def advance(y: np.ndarray) -> np.ndarray:
        return np.clip(theta + y, *bounds)

    def length(tried: np.ndarray) -> float:
        return float(np.abs(tried - theta)[:coordinates].max())

    return damped_step(theta, terms, cost, advance, length, damping, max_step)


def bounded_inverse(curvature: np.ndarray) -> np.ndarray:
    """Return the inverse (P, P) of a curvature whose eigenvalues are raised to MIN_CURVATURE of the largest."""
    values, vectors = np.linalg.eigh(curvature)
    return (vectors / np.maximum(values, MIN_CURVATURE * values[-1])) @ vectors.T


def fitted_size(theta: Reals, data: RoomData, residual: float) -> SizeFit:
    """Return the lengths of the room that fit best together with all other unknowns.

    The fit starts at the solution `theta` for the given size. If its reduced chi-square `residual` is small, one step
    is enough.
    """
    N, D = data.pressures.shape[1], len(data.size)
    grown, damping = np.concatenate([theta, np.zeros(D)]), FIRST_DAMPING
    left = MAX_SIZE_STEPS if residual > LARGE_RESIDUAL else 1
    while True:
        terms, free = exact(grown, data).terms, (-np.inf, np.inf)
        step = bounded_step(grown, terms, lambda y: exact(y, data, False).cost, free, N * D, damping, max_step=0.5)
        grown, damping, left = step.unknowns, step.damping, left - 1
        if step.moved < SIZE_TOLERANCE or not left:
            break
    after = step.cost / degrees_of_freedom(len(data.pressures), N, D)
    sigma = np.sqrt(np.diag(bounded_inverse(terms.curvature))[-D:] * max(1.0, after))
    return SizeFit(grown[-D:], sigma, after)


WIDTHS = (0.006, 0.04)  # rad/m, half widths of resonances that are tried


@dataclass(frozen=True)
class ArrayCandidate:
    """An array that the search has found."""

    width: float  # rad/m, half width of a resonance
    positions: np.ndarray  # (N, D) float64, metres


POINTS_PER_WAVE = 8  # lattice points per shortest wavelength
MAX_POINTS = 8000  # of a lattice; its step is enlarged where there would be more


def lattice_step(wavenumbers: Numbers, size: Sequence[float] | Reals) -> float:
    """Return the step of the lattice of an array search, metres."""
    fine = 2 * np.pi / float(np.real(wavenumbers).max()) / POINTS_PER_WAVE
    return max(fine, float(np.prod(size) / MAX_POINTS) ** (1 / len(size)))


def lattice(size: Sequence[float] | Reals, step: float) -> tuple[list[np.ndarray], np.ndarray]:
    """Return coordinates along each axis, about `step` apart, and all points (C, D), with the last axis fastest."""
    counts = [max(2, round(length / step)) for length in size]
    axes = [(np.arange(n) + 0.5) * length / n for n, length in zip(counts, size, strict=True)]
    return axes, np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def noise_with_errors(noise: Reals, wavenumbers: Numbers, D: int, error: float) -> np.ndarray:
    """Return the noise (M,) plus the power that position errors of `error` metres add."""
    return noise + np.minimum((np.real(wavenumbers) * error) ** 2 / D, 0.5)


SEARCH_MODES = 30  # lowest modes that the search for arrays uses
LATTICE_ERROR = 0.6  # distance of a microphone from its lattice point that is assumed, in lattice steps
PLACED_AGAIN = 3  # number of the likeliest arrays whose microphones are placed a second time


def find_arrays(data: RoomData) -> list[ArrayCandidate]:
    """Return array candidates, the likeliest first."""
    p, k, size = data.pressures[:SEARCH_MODES], data.wavenumbers[:SEARCH_MODES], data.size
    step = lattice_step(k, size)
    noise = noise_with_errors(data.noise[:SEARCH_MODES], k, len(size), LATTICE_ERROR * step)
    everywhere, part = (lattice(np.asarray(size) / parts, step)[1] for parts in (1, 2))
    found: list[tuple[float, float, Reals, LatticePoints]] = []
    for width in WIDTHS:
        points = LatticePoints(everywhere, p, noise, room_modes.diffuse_model(size, k, width))
        found += [(points.cost(x), width, x, points) for x in points.arrays(part)]
    found.sort(key=lambda one: one[0])
    better: dict[bytes, tuple[float, ArrayCandidate]] = {}
    for _, width, x, points in found[:PLACED_AGAIN]:
        x = points.placed_again(x)
        better[x.tobytes()] = points.cost(x), ArrayCandidate(width, frozen_array(x, float))
    return [candidate for _, candidate in sorted(better.values(), key=lambda one: one[0])]


CANDIDATES = 6  # arrays that are kept for each width
BLOCK = 16  # positions of the loudest microphone that are computed together
MAX_NEIGHBOURS = 12  # microphones from which the position of another one is predicted
MAX_PASSES = 3  # number of times that the microphones of an array are placed again


class LatticePoints:
    """Points (C, D), metres, and the diffuse model at these points."""

    def __init__(self, points: np.ndarray, pressures: Complexes, noise: Reals, model: room_modes.DiffuseModel):
        self.points, self.p, self.noise, self.model = points, pressures, noise, model
        self.weights = field_power(pressures, noise)[:, None] * model.weights  # (M, E)
        self.shapes = model.shapes(points)
        self.own = self.weights @ self.shapes.T**2 + noise[:, None]  # (M, C)

    def cost(self, positions: Reals) -> float:
        """Return the cost of an array (N, D) by the diffuse model."""
        return diffuse_terms(positions.ravel(), self.p, self.noise, self.model).cost

    def arrays(self, part: Reals) -> list[np.ndarray]:
        """Return the likeliest arrays (N, D) with the loudest microphone at a point of `part` (B, D)."""
        first = int(np.argmax(np.sum(np.abs(self.p) ** 2 / self.weights.sum(axis=1)[:, None], axis=0)))
        blocks = [self._others(part[start : start + BLOCK], first) for start in range(0, len(part), BLOCK)]
        costs, found = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
        likeliest = np.argsort(costs, kind="stable")[:CANDIDATES]
        arrays = self.points[found[likeliest]]
        arrays[:, first] = part[likeliest]
        return list(arrays)

    def _others(self, assumed: Reals, first: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest costs (B,) with microphone `first` at each of `assumed` (B, D), and all points (B, N)."""
        check_deadline()
        here, squares = self.model.shapes(assumed), np.abs(self.p) ** 2
        mine = (self.weights @ here.T**2 + self.noise[:, None])[..., None]  # (M, B, 1)
        shared = (here * self.weights[:, None]) @ self.shapes.T  # (M, B, C)
        predicted = shared / mine
        variance = self.own[:, None] - shared * predicted
        loud, together = squares[:, first, None, None], np.real(self.p.conj() * self.p[:, first, None])
        costs = np.sum(np.log(variance) + loud * predicted**2 / variance, axis=0)
        costs = costs + np.tensordot(squares.T, 1 / variance, 1)  # (N, B, C)
        costs -= 2 * np.tensordot(together.T, predicted / variance, 1)
        costs[first] = np.sum(np.log(mine) + loud / mine, axis=0)
        return costs.min(axis=2).sum(axis=0), costs.argmin(axis=2).T

    def costs(self, positions: Reals, n: int, max_others: int | None = None) -> np.ndarray:
        """Return -log of the probability density of microphone `n` at each point, given the others : (M, C)."""
        check_deadline()
        others = np.delete(np.arange(len(positions)), n)
        if max_others is not None and len(others) > max_others:
            others = others[np.linspace(0, len(others) - 1, max_others).astype(int)]
        W = self.model.shapes(positions[others])
        weighted = W * self.weights[:, None]  # (M, N - 1, E)
        C = weighted @ W.T + self.noise[:, None, None] * np.eye(len(W))
        c = self.shapes @ weighted.transpose(0, 2, 1)  # (M, C, N - 1)
        t = c @ np.linalg.inv(C)
        variance = self.own - np.sum(t * c, axis=2)
        predicted = (t @ self.p[:, others, None])[..., 0]
        return np.log(variance) + np.abs(self.p[:, n, None] - predicted) ** 2 / variance

    def placed_again(self, positions: Reals) -> np.ndarray:
        """Return `positions` with one microphone after the other put where the others predict it : (N, D)."""
        positions = np.array(positions)
        for _ in range(MAX_PASSES):
            before = positions.copy()
            for n in range(len(positions)):
                positions[n] = self.points[self.costs(positions, n, MAX_NEIGHBOURS).sum(axis=0).argmin()]
            if np.array_equal(before, positions):
                break
        return positions


FINER = 1.5  # lattice step of an array search over that of a source search
ADMITTANCES = (0.0, 0.01, 0.04)  # of the walls, tried with every position of the source
SOURCES = 4  # number of source positions that are returned
MIN_DISTANCE = 2.0  # lattice steps, least distance between two of them


def find_sources(positions: Reals, data: RoomData) -> list[Reals]:
    """Return candidates for `State.walls`, sources some lattice steps apart, the likeliest first."""
    step = lattice_step(data.wavenumbers, data.size) / FINER
    axes, points = lattice(data.size, step)
    rooms = [room_modes.point_source_model(data.size, data.wavenumbers, beta) for beta in ADMITTANCES]
    costs = np.array([_source_costs(room, positions, data.pressures, axes) for room in rooms])
    chosen: list[int] = []
    for c in np.argsort(costs.min(axis=0), kind="stable").tolist():
        if all(np.linalg.norm(points[c] - points[other]) > MIN_DISTANCE * step for other in chosen):
            chosen.append(c)
        if len(chosen) == SOURCES:
            break
    return [frozen_array([*points[c], ADMITTANCES[int(costs[:, c].argmin())], 0.0], float) for c in chosen]


UNEXPLAINED = 0.05  # fraction of the power that the error of a lattice point leaves unexplained


def _source_costs(
    room: room_modes.PointSourceModel, positions: Reals, pressures: Complexes, axes: Sequence[Reals]
) -> np.ndarray:
    """Return the cost of the residual with a source of any strength at each point of a lattice : (C,) float64."""
    shapes, along = room.shapes(positions), _along(room, axes)
    cost = np.zeros(np.prod([len(axis) for axis in axes]))
    for m, p in enumerate(pressures):
        weights = room.response[m][None]
        for a, shape in enumerate(shapes):
            weights = weights * shape[m].reshape(len(positions), *(-1 if b == a else 1 for b in range(len(axes))))
        g = _everywhere(weights, along, m)
        power = np.sum(np.abs(p) ** 2)
        left = power - np.abs(p.conj() @ g) ** 2 / np.sum(np.abs(g) ** 2, axis=0)
        cost += len(p) * np.log(left / power + UNEXPLAINED)
    return cost


BETTER = 0.3  # a microphone is relocated if this reduces its residual power to less than this fraction


def relocate(positions: Reals, walls: Reals, data: RoomData) -> np.ndarray:
    """Return `positions` (N, D), with microphones that fit far better at another lattice point moved to it.

    `walls` (D + 2,) holds the source, metres, and the admittance, real and imaginary part.
    """
    pressures, size, D = data.pressures, data.size, len(data.size)
    axes, points = lattice(size, lattice_step(data.wavenumbers, size) / FINER)
    room = room_modes.point_source_model(size, data.wavenumbers, complex(*walls[D:]))
    excited, along = room.excitation(walls[:D]), _along(room, axes)
    here = room_modes.room_pressures(excited, room.shapes(positions))
    loud = np.sum(here.conj() * pressures, axis=1, keepdims=True) / np.sum(np.abs(here) ** 2, axis=1, keepdims=True)
    fitted = loud * np.array([_everywhere(T[None], along, m)[0] for m, T in enumerate(excited)])  # (M, C)
    costs = np.sum(np.abs(fitted) ** 2, axis=0)[:, None] - 2 * np.real(fitted.conj().T @ pressures)
    costs += np.sum(np.abs(pressures) ** 2, axis=0)
    better = costs.min(axis=0) < BETTER * np.sum(np.abs(pressures - loud * here) ** 2, axis=0)
    return np.where(better[:, None], points[costs.argmin(axis=0)], positions)


def _along(room: room_modes.PointSourceModel, axes: Sequence[Reals]) -> list[np.ndarray]:
    """Return the eigenfunctions along each axis at the coordinates of a lattice: D arrays (M, C_a, n_a)."""
    middle, number = np.asarray(room.size) / 2, np.arange(len(axes))
    return [room.shapes(np.where(number == a, axis[:, None], middle))[a] for a, axis in enumerate(axes)]


def _everywhere(weights: Numbers, along: Sequence[Numbers], m: int) -> np.ndarray:
    """Return sums over the eigenfunctions of mode m, with `weights` (X, n_1, ..., n_D), at each point : (X, C)."""
    check_deadline()
    for shape in along:  # each contraction takes the first of the axes left and puts the points last
        weights = np.tensordot(weights, shape[m], axes=(1, 1))
    return weights.reshape(len(weights), -1)


TRAITS = Traits(moves_all=True, needs_room=True)


# tolerance, metres, and number of steps: a phase ends when no coordinate moves further, or after these steps
PHASES = {"diffuse": (3e-3, 12), "rough": (1e-3, 12), "relocated": (1e-3, 12), "exact": (1e-6, 20)}

PhaseName = Literal["search", "diffuse", "source", "rough", "relocated", "exact"]


@dataclass(frozen=True)
class Phase:
    """The present stage."""

    name: PhaseName
    spread: int  # index into LATTICE_ERRORS, for phase "diffuse"
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
    """The candidates that are left, and the optima found so far."""

    arrays: tuple[ArrayCandidate, ...] = ()  # from the array search, the next one first
    # from the source search for the present array, the next one first, each as of `State.walls`
    sources: tuple[Reals, ...] = ()
    best: RoomOptimum | None = None  # the best optimum of phase "exact"
    rejected: RoomOptimum | None = None  # the best optimum that left too much unexplained for phase "exact"


@dataclass(frozen=True)
class MeasurementNoise:
    """The noise of the measurement."""

    power: np.ndarray  # (M,) float64, of all modes, in the unit of abs(pressures)**2
    given: bool  # whether it was reported


@dataclass(frozen=True)
class State(RunState):
    """Everything that `step` needs; `cost` is a chi-square in the phases with the exact model, else -log likelihood."""

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

    With `positions` (N, D), metres, phase "diffuse" starts at these instead. The solver draws no random numbers.
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


NOISE_GUESS = 1e-4  # noise fraction that is assumed where none is reported


def _noise(problem: Problem, settings: SolverSettings) -> MeasurementNoise:
    """Return the noise that the settings or the measurement report, or a guess."""
    power, reported = mode_power(problem.pressures), problem.noise_power if settings.noise == "reported" else None
    if settings.snr_db is not None:
        reported = power / (1 + 10 ** (settings.snr_db / 10))
    if reported is None or not np.all(reported > 0):  # even a simulation without noise differs from the exact model
        return MeasurementNoise(frozen_array(NOISE_GUESS * power, float), False)
    return MeasurementNoise(frozen_array(reported, float), True)


MIN_NOISE = 1e-6  # least noise fraction


def scaled(problem: Problem, state: State, modes: slice) -> RoomData:
    """Return the pressures of some modes, scaled to unit RMS."""
    p = problem.pressures[modes]
    power = mode_power(p)
    noise = np.maximum(state.noise.power[modes] / power, MIN_NOISE)
    return RoomData(p / np.sqrt(power)[:, None], noise, problem.wavenumbers[modes], state.size)


def step(problem: Problem, state: State) -> State:
    """Return `state` after one step; the same state if it is finished."""
    if state.finished:
        return state
    data, tried = scaled(problem, state, state.modes), state.restarts
    phase = replace(state.phase, steps=state.phase.steps + 1)
    state = replace(state, step=state.step + 1, sweep=state.sweep + 1, phase=phase)
    if phase.name == "search":
        return _following(problem, replace(state, restarts=replace(tried, arrays=tuple(find_arrays(data)))), True)
    if phase.name == "source":
        sources = tuple(find_sources(state.positions, data))
        return _following(problem, replace(state, restarts=replace(tried, sources=sources)), True)
    state, moved = _fitted(state, data)
    tolerance, max_steps = PHASES[phase.name]
    ended = moved < tolerance or phase.steps >= max_steps
    return _following(problem, state, moved < tolerance) if ended else state


ROUGH_NOISE = 1e-3  # noise fraction that is added before phase "exact"
LATTICE_ERRORS = (0.3, 0.1, 0.03)  # position errors, lattice steps, assumed in the stages of phase "diffuse"
MARGIN = 1e-3  # metres, least distance between a microphone and a wall
MAX_ADMITTANCE = 0.2  # of the walls


def _fitted(state: State, data: RoomData) -> tuple[State, float]:
    """Return the state after one damped step with the model of its phase, and how far a coordinate moved, metres."""
    k, size, name, (N, D) = data.wavenumbers, data.size, state.phase.name, state.positions.shape
    max_step = lattice_step(k, size)
    if name == "diffuse":
        v = noise_with_errors(data.noise, k, D, LATTICE_ERRORS[state.phase.spread] * max_step)
        model, theta = room_modes.diffuse_model(size, k, state.width), state.positions.ravel()
        terms = diffuse_terms(theta, data.pressures, v, model)

        def cost(y: Reals) -> float:
            return diffuse_terms(y, data.pressures, v, model).cost
    else:
        noisier, theta = replace(data, noise=data.noise + ROUGH_NOISE * (name != "exact")), state.theta
        terms = exact(theta, noisier).terms

        def cost(y: Reals) -> float:
            return exact(y, noisier, False).cost

    low = np.concatenate([np.full(N * D + D, MARGIN), [0.0, -np.inf]])[: len(theta)]
    high = np.tile(np.asarray(size) - MARGIN, N + 1)
    high = np.concatenate([high, [MAX_ADMITTANCE, np.inf]])[: len(theta)]
    trial = bounded_step(theta, terms, cost, (low, high), N * D, state.phase.damping, max_step)
    positions = frozen_array(trial.unknowns[: N * D].reshape(N, D), float)
    walls = state.walls if name == "diffuse" else frozen_array(trial.unknowns[N * D :], float)
    phase = replace(state.phase, damping=trial.damping)
    return replace(state, positions=positions, walls=walls, cost=trial.cost, phase=phase), trial.moved


CONFIRMED = 1.5  # residual over the noise below which an optimum needs no restart
REJECTED = 6.0  # residual over noise and ROUGH_NOISE above which an optimum is not refined in phase "exact"
EXACT_DAMPING = 1e-2  # of the first step with the exact model


def _following(problem: Problem, state: State, converged: bool) -> State:
    """Return the state after the end of a phase; `converged` says whether it ended because no microphone moved.

    search     followed by a restart with the first array
    diffuse    by diffuse with the next lattice error; after the last one by source
    source     by a restart with the first source position
    rough      by exact if enough is explained, otherwise by relocated
    relocated  by exact if enough is explained, otherwise by a restart; if none is left, by exact from the best optimum
    exact      by the end if the noise explains the residual, if the same optimum was found twice, or if no restart is
               left; otherwise by a restart

    A restart begins phase rough at the next source position or, if none is left, phase diffuse with the next array.
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
        data = scaled(problem, state, state.modes)
        positions = frozen_array(relocate(state.positions, state.walls, data), float)
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
    """Return the state at the next restart; None if none is left."""
    tried = state.restarts
    if tried.sources:
        walls, *others = tried.sources
        state = replace(state, walls=walls, restarts=replace(tried, sources=tuple(others)))
        return _begin(state, "rough", state.phase.spread, EXACT_DAMPING)
    if tried.arrays:
        array, *others = tried.arrays
        restarts = replace(tried, arrays=tuple(others))
        return _begin(replace(state, positions=array.positions, width=array.width, restarts=restarts), "diffuse", 0)
    return None


SAME_COST = 0.02  # relative difference of two costs below which they belong to the same optimum


def _best(before: RoomOptimum | None, state: State, converged: bool) -> tuple[RoomOptimum, bool]:
    """Return the better of an earlier optimum and the present one, and whether their costs are the same."""
    here = RoomOptimum(state.positions, state.walls, state.cost, converged)
    if before is None:
        return here, False
    same = abs(here.cost - before.cost) < SAME_COST * before.cost
    return here if here.cost < before.cost else before, same


def _finished(problem: Problem, state: State, best: RoomOptimum, left: float) -> State:
    """Return the last state of a run, in the symmetry nearest to the known microphones or in the corner at the origin.

    Noise that was not reported is estimated from `left`, the reduced chi-square.
    """
    size, D, x = state.size, len(state.size), best.positions
    if len(problem.known):
        image = room_modes.nearest_symmetry(x[problem.known], problem.known_positions, size)
    else:
        image = min(room_modes.room_symmetries(size), key=lambda image: list(image.apply(x).mean(axis=0).round(9)))
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
    data = scaled(problem, state, modes)
    model = room_modes.diffuse_model(state.size, data.wavenumbers, state.width)
    flat = points.reshape(-1, points.shape[-1])
    costs = LatticePoints(flat, data.pressures, data.noise + ROUGH_NOISE, model).costs(state.positions, n)
    costs -= np.minimum(costs.min(axis=1, keepdims=True), 0.0)
    return costs.reshape(len(costs), *points.shape[:2])


def usable_modes(problem: Problem, settings: SolverSettings) -> int:
    """Return the number of modes measured."""
    return len(problem.frequencies)


def result(problem: Problem, state: State) -> RoomEstimate:
    """Return what the solver has found.

    The covariance is that of the exact model with its source, walls and loudness unknown, enlarged by the excess
    residual.
    """
    size, (N, D), data = state.size, state.positions.shape, scaled(problem, state, state.modes)
    p, fit = data.pressures, exact(state.theta, data)
    residual = float(np.sum(np.abs(fit.residual) ** 2)) / degrees_of_freedom(len(p), N, D)
    covariance = bounded_inverse(fit.terms.curvature) * max(1.0, residual)
    part = np.abs(fit.fitted) ** 2
    left_out = (p - fit.fitted) / np.maximum(1 - part / part.sum(axis=1, keepdims=True), 1e-9)
    noise_fraction = float(np.exp(np.mean(np.log(data.noise)))) * (residual if state.noise.given else 1.0)
    return RoomEstimate(
        problem, state.modes, state.positions, state.converged, p, left_out,
        np.array([covariance[D * n : D * n + D, D * n : D * n + D] for n in range(N)]),
        residual, np.sum(np.abs(fit.residual) ** 2, axis=0), noise_fraction, state.noise.given, tuple(map(float, size)),
        fitted_size(state.theta, data, residual), state.walls[:D], complex(*state.walls[D:]),
        tuple(room_modes.room_symmetries(size)),
    )  # fmt: skip


MAX_RESPONSE = 1e7  # complex numbers in the response of the exact model, at most


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
        return InputError(f"room = {text}{message}", remedy, key="room")

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
    limit = room_modes.TRUNCATION
    top = np.sqrt(limit.decay / limit.tau(D) + highest**2) / np.pi  # where the exact model's sum ends
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
        raise InputError(message, remedy, key="modes")
