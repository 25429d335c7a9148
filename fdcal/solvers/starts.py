"""Where a solver starts: at random, in closed form from the lowest modes, or from the coherence between microphones.

affine     At low frequency the field over the array is nearly affine, so that the data matrix [Re p; Im p] of the
           lowest modes, minus its mean over the microphones, has D dominant singular vectors: the positions up to an
           affine map. Known microphones fix that map. Without them the diffuse field gives a first guess, because its
           gradient has the power k^2 / dimension in each direction, and the likelihood of all modes then determines
           the metric, which has D (D + 1) / 2 parameters.
coherence  In a diffuse field two microphones at a distance r have the coherence E[p_i conj(p_j)] / power = kappa(k r).
           All frequencies together give the likeliest distance of every pair, with an error of about a tenth, since one
           source excites few directions at each frequency. Unlike the affine start, this one works for an array that is
           not small against the wavelength. Distances of far pairs are ambiguous: the array is first unfolded along
           near pairs (Tenenbaum, de Silva and Langford, Science 290, 2000: isomap), and stress majorisation (de Leeuw,
           1977) then uses far pairs where they are consistent.
"""

from dataclasses import dataclass, replace
from itertools import combinations, combinations_with_replacement

import numpy as np
from scipy.sparse.csgraph import shortest_path

from ..acoustics.compiled import check_deadline
from ..cost.kernels import diffuse_kernel
from ..cost.likelihood import FieldModel, isotropic_field, likelihood_terms
from ..cost.noise import DIFFUSE_FLOOR, NoiseEstimate, estimate_noise
from ..model.gauge import align, fixes_gauge
from ..model.problem import Problem, mode_power
from ..model.validation import Complexes, InputError, Numbers, Reals
from .levenberg_marquardt import FIRST_DAMPING, NewtonTerms, damped_step


def random(problem: Problem, rng: np.random.Generator) -> np.ndarray:
    """Return free microphones drawn uniformly in the search domain, and known ones : (N, D) float64, metres.

    InputError for a problem without a search domain.
    """
    if problem.search is None:
        raise InputError("a random start needs a search domain", "give <search> and <radius>", key="search")
    low, size = np.array(problem.search.origin), np.array(problem.search.size)
    positions = low + size * rng.random((problem.pressures.shape[1], len(low)))
    positions[problem.known] = problem.known_positions
    return positions


LOWEST = {2: (8, 16, 28, 5), 3: (20, 28, 12, 8)}  # numbers of modes in affine starts, by dimension of the field
# Number of random starts, which are used if the others disagree, and numbers of modes to which they are fitted first.
# There are fewer starts if there are many microphones, because each then takes longer.
RANDOM_STARTS = 32
RANDOM_SIZE = 24  # number of microphones above which there are fewer random starts
RANDOM_LOWEST = (3, 5, 8)
COHERENCE_LOWEST = 5


@dataclass(frozen=True)
class Start:
    """How one start is computed."""

    kind: str  # "affine", "coherence" or "random"
    number: int  # number of the modes used, or of a random start
    lowest: int  # number of the lowest modes to which it is fitted first
    given: bool = False  # whether given positions determine it


def plan(problem: Problem, modes: int) -> list[Start]:
    """Return the starts of a problem whose `modes` lowest modes are in use."""
    whole, half = (Start("coherence", n, COHERENCE_LOWEST) for n in (modes, max(modes // 2, 1)))
    kinds = (True, False) if len(problem.known) else (False,)
    counts = dict.fromkeys(min(n, modes) for n in LOWEST[problem.dimension])
    first, *others = [[Start("affine", n, max(n // 2, 1), given) for given in kinds] for n in counts]
    count = RANDOM_STARTS * RANDOM_SIZE**2 // max(problem.pressures.shape[1], RANDOM_SIZE) ** 2
    drawn = [Start("random", n, RANDOM_LOWEST[n % len(RANDOM_LOWEST)]) for n in range(count)]
    return [whole, *first, half, *(one for pair in others for one in pair), *drawn]


def start(problem: Problem, modes: int, noise: float | None, one: Start) -> np.ndarray:
    """Return the positions (N, D), metres, of one start; noise : reported noise fraction, or None.

    InputError if the modes do not determine it.
    """
    if one.kind == "affine":
        return affine(problem, modes, one.number)
    D, every = problem.array_dimension, modes // one.number if one.kind == "coherence" else 1
    p, k = problem.pressures[:modes:every], problem.wavenumbers[:modes:every]
    x = coherence_start(p, k, noise, problem.dimension, D)
    if one.kind == "random":
        return np.sqrt(np.mean(x**2)) * np.random.default_rng(one.number).standard_normal(x.shape)
    return x


def without_given(problem: Problem) -> Problem:
    """Return the problem without given positions."""
    return replace(problem, known=problem.known[:0], known_positions=problem.known_positions[:0], frame=None)


def affine(problem: Problem, modes: int, lowest: int | None = None) -> np.ndarray:
    """Return positions (N, D), metres, from the lowest modes, exact up to the gauge where the field is affine.

    modes : number of modes that may be used, from the lowest up; lowest : number of modes that give the shape. Without
    known microphones the positions are centred on the origin.
    """
    shape, values, lowest = singular_vectors(problem, modes, lowest)
    if not len(problem.known):
        return _with_metric(problem, modes, shape, values, lowest)
    require_gauge(problem)
    extended = np.column_stack([shape, np.ones(len(shape))])
    positions = extended @ np.linalg.lstsq(extended[problem.known], problem.known_positions, rcond=None)[0]
    positions[problem.known] = problem.known_positions
    return positions


def require_gauge(problem: Problem) -> None:
    """Raise InputError if there are known microphones and an array and its mirror image fit them equally well."""
    if len(problem.known) and not fixes_gauge(problem.known_positions):
        fault = f"known = {problem.known.tolist()} does not fix translation, rotation and mirror image"
        remedy = f"name at least {problem.array_dimension + 1} known microphones that span the array, or none"
        raise InputError(fault, remedy, key="known")


def singular_vectors(problem: Problem, modes: int, lowest: int | None = None) -> tuple[np.ndarray, np.ndarray, int]:
    """Return the D dominant singular vectors (N, D) of the data matrix, their values (D,), and modes that gave them."""
    lowest = min(LOWEST[problem.dimension][0] if lowest is None else lowest, modes)
    data = np.concatenate([np.real(problem.pressures[:lowest]), np.imag(problem.pressures[:lowest])])
    data = data - data.mean(axis=1, keepdims=True)
    _, values, vectors = np.linalg.svd(data, full_matrices=False)
    D = problem.array_dimension
    if len(values) < D or values[D - 1] <= 1e-9 * values[0]:
        fault = (
            f"the lowest {lowest} frequencies show fewer than {D} directions: the microphones stand on a line, or there"
            " are too few frequencies"
        )
        raise InputError(fault, "measure more frequencies", key="modes")
    return vectors[:D].T, values[:D], lowest


METRIC_MODES = 28  # modes to which the metric is first fitted, before all modes are used
# factors on the first guess of the size that are tried; the guess is too large where the field is not quite affine
SCALES = (0.3, 0.4, 0.5, 0.6, 0.75, 1.0)
METRIC_STEPS = 12  # steps of a fit of the metric at most
METRIC_TOLERANCE = 3e-3  # metres; a fit ends when no coordinate moves further
METRIC_PRESSURES = 4000  # approximate number of pressures in a fit; every n-th mode is used where there are more
MIN_MODES = 24  # least number of modes in a fit, if there are as many
MAX_UNEXPLAINED = 0.5  # largest noise fraction of a mode in a fit


def _with_metric(problem: Problem, modes: int, shape: Reals, values: Reals, lowest: int) -> np.ndarray:
    """Return the shape of `singular_vectors` with the likeliest metric : (N, D), metres."""
    (N, D), k, first = shape.shape, np.real(problem.wavenumbers), min(METRIC_MODES, modes)
    axes, pairs = np.eye(D), combinations_with_replacement(range(D), 2)
    maps = [np.maximum(np.outer(axes[a], axes[b]), np.outer(axes[b], axes[a])) for a, b in pairs]
    basis = np.array([shape @ S for S in maps]).reshape(-1, N * D).T

    def unexplained(x: Reals, count: int) -> tuple[Complexes, FieldModel, NoiseEstimate]:
        """Return some pressures in unit power, an isotropic field without noise, and what this leaves unexplained."""
        used = np.arange(count)[:: max(1, min(count * N // METRIC_PRESSURES, count // MIN_MODES))]
        p = problem.pressures[used] / np.sqrt(mode_power(problem.pressures[used]))[:, None]
        field = isotropic_field(p, k[used], np.zeros(len(p)), problem.dimension)
        return np.asarray(p, complex), field, estimate_noise(x, p, field, DIFFUSE_FLOOR)

    guess = shape * values / np.sqrt(np.sum(k[:lowest] ** 2) / problem.dimension)
    x = min((scale * guess for scale in SCALES), key=lambda x: unexplained(x, first)[2].cost)
    for count in (first, modes):
        p, field, residual = unexplained(x, count)
        fraction = residual.noise_fraction + (field.wavenumbers * residual.spread) ** 2 / problem.dimension
        noise = np.minimum(fraction, MAX_UNEXPLAINED)
        x = _fitted(x, p, replace(field, noise=noise, power=1 - noise), basis)
    return x


def _fitted(positions: Reals, pressures: Complexes, field: FieldModel, basis: Reals) -> np.ndarray:
    """Return positions (N, D), metres, after damped steps along `basis` (N D, F)."""
    x, damping = positions, FIRST_DAMPING
    max_step = float(np.ptp(x, axis=0).max()) / 2  # a very large array would need expansions of a very high order

    for _ in range(METRIC_STEPS):
        terms = likelihood_terms(x, pressures, field)
        gradient, curvature = terms.newton()
        g, H = basis.T @ gradient.ravel(), basis.T @ curvature.reshape(x.size, -1) @ basis
        step = damped_step(
            x,
            NewtonTerms(terms.cost, g, H),
            lambda y: likelihood_terms(y, pressures, field, derivatives=False).cost,
            lambda y, x=x: x + (basis @ y).reshape(x.shape),
            lambda y, x=x: float(np.abs(y - x).max()),
            damping,
            max_step,
        )
        x, damping = step.unknowns, step.damping
        if step.moved < METRIC_TOLERANCE or step.decrease < 1.0:
            break
    return x


# subsets of the given positions on which an array is aligned, at most; with 3 subsets 2 of 24 arrays with 9 to 20 given
# positions are not found
SUBSETS = 40


def best_subset(x: Reals, places: Reals) -> np.ndarray:
    """Return the numbers (D + 1,) int64 of the points of `x` whose alignment with `places` has the least median error.

    x, places : (A, D), metres, the array found and the given positions; at most SUBSETS subsets are tried
    """

    def error(chosen: tuple[int, ...]) -> float:
        return float(np.median(np.linalg.norm(align(x, places, np.array(chosen)) - places, axis=1)))

    A, D = x.shape
    return np.array(min(list(combinations(range(A), min(D + 1, A)))[:SUBSETS], key=error))


def aligned(problem: Problem, x: Reals) -> np.ndarray:
    """Return a blind array aligned with the given positions by the `best_subset` of them."""
    chosen = best_subset(x[problem.known], problem.known_positions)
    return onto(x, problem.known[chosen], problem.known_positions[chosen])


def onto(x: Reals, known: np.ndarray, places: Reals) -> np.ndarray:
    """Return `x` moved, turned and mirrored as a whole so that microphones `known` come to `places`."""
    target = np.zeros_like(x)
    target[known] = places
    return align(x, target, known)


MAX_PRODUCTS = 3e5  # pressure products M N (N - 1) / 2 at most; some of the modes are used where there are more
# noise fractions that are tried where none is reported; the first one is also the least fraction that is assumed
NOISE_FRACTIONS = (1e-2, 3e-2, 0.1, 0.3)
NEIGHBOURS = 10  # number of nearest microphones of each that are connected when the array is unfolded
# distance times the largest k beyond which a pair has the weight FAR_WEIGHT, for each round of majorisation
REACH = (4.0, 4.0, 9.0, 9.0, 9.0)
FAR_WEIGHT = 0.1
SCATTER = 0.2  # relative error of a distance; pairs that disagree more with the array get less weight
ITERATIONS = 30  # number of iterations of majorisation in a round
MAX_RADIUS = 2.5  # distance from the middle, over its median, beyond which a microphone is moved to the middle


def coherence_start(
    pressures: Complexes, wavenumbers: Numbers, noise: float | None, dimension: int, axes: int
) -> np.ndarray:
    """Return positions (N, axes), metres, about the origin, that agree with the coherence of the pressures.

    pressures : (M, N) complex128, each mode of unit mean power; wavenumbers : (M,) rad/m, the real parts count;
    noise : noise fraction, None for the likeliest of NOISE_FRACTIONS; dimension : of the field
    """
    N, k = pressures.shape[1], np.real(wavenumbers)
    count = max(1, min(len(k), int(2 * MAX_PRODUCTS / N**2)))
    some = np.unique(np.linspace(0, len(k) - 1, count).astype(int))
    fractions = NOISE_FRACTIONS if noise is None else (noise,)
    found = [pair_distances(pressures[some], k[some], one, dimension) for one in fractions]
    distance, _ = min(found, key=lambda one: one[1])
    x = _unfolded(distance, min(NEIGHBOURS, N - 1), axes)
    between = distance + np.eye(N)
    for reach in REACH:
        check_deadline()
        misfit = np.log(between / (_distances(x) + np.eye(N)))
        weight = np.where(distance < reach / k.max(), 1.0, FAR_WEIGHT)
        weight = weight / (SCATTER**2 + misfit**2) / between**2
        weight = weight - np.diag(np.diag(weight))
        system = np.diag(weight.sum(axis=1)) - weight + weight.mean() / N  # the added constant fixes the mean
        inverse = np.linalg.inv(np.asarray(system))
        for _ in range(ITERATIONS):  # each lowers the weighted sum of (distance - |x_i - x_j|)^2
            ratio = weight * between / _distances(x)
            x = inverse @ (ratio.sum(axis=1)[:, None] * x - ratio @ x)
        x = x - x.mean(axis=0)
    radius = np.linalg.norm(x - np.median(x, axis=0), axis=1)
    outliers = radius > MAX_RADIUS * np.median(radius)  # these are coherent with no other: dead or noisy
    return np.where(outliers[:, None], np.median(x, axis=0), x)


DISTANCES = 60  # number of candidates of a distance, geometrically spaced
SHORTEST = 0.04  # smallest candidate times the largest k
LONGEST = 3.0  # largest candidate times the smallest k


def pair_distances(pressures: Complexes, wavenumbers: Reals, noise: float, dimension: int) -> tuple[np.ndarray, float]:
    """Return the likeliest distances (N, N) between microphones, metres, and the sum of their -log likelihoods.

    pressures : (M, N) complex128, each mode of unit mean power; wavenumbers : (M,) float64; noise : fraction
    """
    N, k = pressures.shape[1], wavenumbers
    i, j = np.triu_indices(N, 1)
    power = np.abs(pressures) ** 2
    both, cross = power[:, i] + power[:, j], 2 * np.real(np.conj(pressures[:, i]) * pressures[:, j])
    candidates = np.geomspace(SHORTEST / float(k.max()), LONGEST / float(k.min()), DISTANCES)
    kappa = diffuse_kernel(candidates, k, dimension, slope=False)[0] * (1 - max(noise, NOISE_FRACTIONS[0]))
    det = 1 - kappa**2  # the determinant and the quadratic form of two channels of unit power
    cost = (1 / det).T @ both - (kappa / det).T @ cross + np.log(det).sum(axis=0)[:, None]  # (DISTANCES, pairs)
    distance = np.zeros((N, N))
    distance[i, j] = distance[j, i] = candidates[np.argmin(cost, axis=0)]
    return distance, float(cost.min(axis=0).sum())


def _distances(x: Reals) -> np.ndarray:
    return np.maximum(np.linalg.norm(x[:, None] - x[None], axis=-1), 1e-9)


def _unfolded(distance: Reals, neighbours: int, axes: int) -> np.ndarray:
    """Return positions (N, axes), metres, by classical scaling of the shortest paths over near neighbours."""
    N = len(distance)
    near = np.argsort(distance + np.diag(np.full(N, np.inf)), axis=1)[:, :neighbours]
    graph, rows = np.zeros((N, N)), np.arange(N)[:, None]
    graph[rows, near] = distance[rows, near]
    path: Reals = shortest_path(np.maximum(graph, graph.T), directed=False)
    path = np.where(np.isfinite(path), path, distance)  # there is no path between separate groups
    centre = np.eye(N) - 1 / N
    values, vectors = np.linalg.eigh(-0.5 * centre @ path**2 @ centre)
    return vectors[:, -axes:] * np.sqrt(np.maximum(values[-axes:], 1e-6 * values[-1]))
