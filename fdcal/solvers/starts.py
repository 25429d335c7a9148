"""Where a solver starts: at random, in closed form from the lowest modes, or from the coherence between microphones.

affine     At low frequency the field over the array is nearly an affine function of the position. The data matrix
           [Re p; Im p] of the lowest modes, minus its mean over the microphones, therefore has D dominant singular
           vectors, which are the positions up to an affine map. Known microphones fix that map. Without them, a first
           guess of the map follows from the diffuse field, whose gradient has the power k^2 / dimension in each
           direction; then the likelihood of all modes determines the metric, which has D (D + 1) / 2 parameters.
coherence  In a diffuse field two microphones at a distance r have the coherence E[p_i conj(p_j)] / power = kappa(k r).
           All frequencies together yield the most likely distance of every pair. Its error is about a tenth, because
           one source excites only few directions at each frequency. Unlike the affine start, this start also works if
           the array is not small compared with the wavelength. The distances of far pairs are ambiguous. The array is
           therefore first unfolded along near pairs (isomap: Tenenbaum, de Silva and Langford, Science 290, 2000);
           then stress majorisation (de Leeuw, 1977) uses the far pairs that are consistent with it.
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
    """Return positions (N, D) float64, metres: random ones in the search domain, given ones for known microphones.

    The random positions have a uniform distribution. Raises InputError for a problem without a search domain.
    """
    if problem.search is None:
        raise InputError("a random start needs a search domain", "give <search> and <radius>", key="search")
    low, size = np.array(problem.search.origin), np.array(problem.search.size)
    positions = low + size * rng.random((problem.pressures.shape[1], len(low)))
    positions[problem.known] = problem.known_positions
    return positions


LOWEST = {2: (8, 16, 28, 5), 3: (20, 28, 12, 8)}  # numbers of modes of the affine starts, by dimension of the field
# Random starts are used if the other starts disagree. Arrays of more than RANDOM_SIZE microphones have fewer of them,
# because each then takes longer.
RANDOM_STARTS = 32
RANDOM_SIZE = 24
RANDOM_LOWEST = (3, 5, 8)  # numbers of lowest modes; successive random starts are first fitted to these, in turn
COHERENCE_LOWEST = 5  # number of the lowest modes to which starts by coherence are fitted first


@dataclass(frozen=True)
class Start:
    """How one start is computed."""

    kind: str  # "affine", "coherence" or "random"
    number: int  # number of modes from which it is computed; the seed of a random start
    lowest: int  # number of the lowest modes to which it is fitted first
    given: bool = False  # whether it depends on the given positions


def plan(problem: Problem, modes: int) -> list[Start]:
    """Return the starts of a problem whose `modes` lowest modes are in use, in the order in which they are tried."""
    whole, half = (Start("coherence", n, COHERENCE_LOWEST) for n in (modes, max(modes // 2, 1)))
    kinds = (True, False) if len(problem.known) else (False,)
    counts = dict.fromkeys(min(n, modes) for n in LOWEST[problem.dimension])
    first, *others = [[Start("affine", n, max(n // 2, 1), given) for given in kinds] for n in counts]
    count = RANDOM_STARTS * RANDOM_SIZE**2 // max(problem.pressures.shape[1], RANDOM_SIZE) ** 2
    drawn = [Start("random", n, RANDOM_LOWEST[n % len(RANDOM_LOWEST)]) for n in range(count)]
    return [whole, *first, half, *(one for pair in others for one in pair), *drawn]


def start(problem: Problem, modes: int, noise: float | None, one: Start) -> np.ndarray:
    """Return the positions (N, D), metres, of one start; noise : reported noise fraction, or None.

    Raises InputError if the modes do not determine the start.
    """
    if one.kind == "affine":
        return affine(problem, modes, one.number)
    every = modes // one.number if one.kind == "coherence" else 1
    p, k = problem.pressures[:modes:every], problem.wavenumbers[:modes:every]
    x = coherence_start(p, k, noise, problem.dimension, problem.array_dimension)
    if one.kind == "random":
        return np.sqrt(np.mean(x**2)) * np.random.default_rng(one.number).standard_normal(x.shape)
    return x


OPPOSITE_MODES = 8  # number of the lowest modes that show inverted channels
OPPOSITE = 0.7  # the sign of a channel is clear if its mean coherence with the others exceeds this, sign corrected


def inverted(problem: Problem) -> np.ndarray:
    """Return which channels are clearly inverted relative to the majority : (N,) bool.

    Where an array is small compared with the wavelength, the pressures of all channels are equal up to the sign.
    """
    p = problem.pressures[:OPPOSITE_MODES]
    p = p / np.sqrt(np.mean(np.abs(p) ** 2, axis=0) + np.finfo(float).tiny)
    coherence = np.real(p.T @ np.conj(p)) / len(p)
    sign = np.sign(np.linalg.eigh(coherence)[1][:, -1])
    sign *= np.sign(np.sum(sign))
    clear = (sign * (coherence @ sign) - 1) / (len(sign) - 1) > OPPOSITE
    return (sign < 0) & clear & (2 * np.sum(clear) > len(sign))


def without_given(problem: Problem) -> Problem:
    """Return the problem without given positions."""
    return replace(problem, known=problem.known[:0], known_positions=problem.known_positions[:0], frame=None)


def affine(problem: Problem, modes: int, lowest: int | None = None) -> np.ndarray:
    """Return positions (N, D), metres, from the lowest modes; exact if the field is affine and microphones are known.

    modes : number of modes that may be used, from the lowest up; lowest : number of modes that determine the shape.
    Without known microphones the positions are centred on the origin. Raises InputError if the modes span too few
    directions, or if known microphones do not fix the gauge.
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
    """Return the D dominant singular vectors (N, D) of the data matrix, their values (D,), and how many modes are used.

    Raises InputError if the modes span fewer than D directions.
    """
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


METRIC_MODES = 28  # number of modes to which the metric is first fitted, before all modes are used
# factors on the first guess of the size that are tried; the guess is too large if the field is not quite affine
SCALES = (0.3, 0.4, 0.5, 0.6, 0.75, 1.0)
METRIC_STEPS = 12  # largest number of steps in a fit of the metric
METRIC_TOLERANCE = 3e-3  # metres; a fit ends when no coordinate moves further than this in a step
METRIC_PRESSURES = 4000  # approximate number of pressures in a fit; if there are more, only every n-th mode is used
MIN_MODES = 24  # smallest number of modes in a fit, if so many are available
MAX_UNEXPLAINED = 0.5  # largest noise fraction of a mode in a fit


def _with_metric(problem: Problem, modes: int, shape: Reals, values: Reals, lowest: int) -> np.ndarray:
    """Return the shape from `singular_vectors` with the most likely metric : (N, D), metres."""
    (N, D), k, first = shape.shape, np.real(problem.wavenumbers), min(METRIC_MODES, modes)
    axes, pairs = np.eye(D), combinations_with_replacement(range(D), 2)
    maps = [np.maximum(np.outer(axes[a], axes[b]), np.outer(axes[b], axes[a])) for a, b in pairs]
    basis = np.array([shape @ S for S in maps]).reshape(-1, N * D).T

    def unexplained(x: Reals, count: int) -> tuple[Complexes, FieldModel, NoiseEstimate]:
        """Return some pressures of unit power, an isotropic field without noise, and the noise that it leaves."""
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
    """Return positions (N, D), metres, after damped steps in the subspace of the columns of `basis` (N D, F)."""
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


# largest number of subsets of the given positions with which an array is aligned; with 3 instead of 40 subsets, 2 of 24
# arrays with 9 to 20 given positions are not found
SUBSETS = 40


def best_subset(x: Reals, places: Reals) -> np.ndarray:
    """Return the numbers (D + 1,) int64 of the points of `x` whose alignment with `places` has the lowest median error.

    x, places : (A, D), metres, estimated and given positions; at most SUBSETS subsets of D + 1 points are tried
    """

    def error(chosen: tuple[int, ...]) -> float:
        return float(np.median(np.linalg.norm(align(x, places, np.array(chosen)) - places, axis=1)))

    A, D = x.shape
    return np.array(min(list(combinations(range(A), min(D + 1, A)))[:SUBSETS], key=error))


def aligned(problem: Problem, x: Reals) -> np.ndarray:
    """Return an array `x` (N, D), metres, aligned with the `best_subset` of the given positions."""
    chosen = best_subset(x[problem.known], problem.known_positions)
    return onto(x, problem.known[chosen], problem.known_positions[chosen])


def onto(x: Reals, known: np.ndarray, places: Reals) -> np.ndarray:
    """Return `x` moved by the best rigid motion or mirror image that takes microphones `known` to `places`."""
    target = np.zeros_like(x)
    target[known] = places
    return align(x, target, known)


MAX_PRODUCTS = 3e5  # largest number of pressure products M N (N - 1) / 2; if there are more, some modes are left out
# noise fractions that are tried if none is reported; the first one is also the smallest fraction that is assumed
NOISE_FRACTIONS = (1e-2, 3e-2, 0.1, 0.3)
NEIGHBOURS = 10  # when the array is unfolded, each microphone is connected with this number of nearest ones
# for each round of majorisation, distance times the largest k beyond which a pair has the weight FAR_WEIGHT
REACH = (4.0, 4.0, 9.0, 9.0, 9.0)
FAR_WEIGHT = 0.1
SCATTER = 0.2  # relative error of a distance; pairs that disagree more with the array have less weight
ITERATIONS = 30  # number of iterations of majorisation in a round
MAX_RADIUS = 2.5  # a microphone at more than this times the median distance from the middle is moved to the middle


def coherence_start(
    pressures: Complexes, wavenumbers: Numbers, noise: float | None, dimension: int, axes: int
) -> np.ndarray:
    """Return positions (N, axes), metres, about the origin, that agree with the coherence of the pressures.

    pressures : (M, N) complex128, each mode of unit mean power; wavenumbers : (M,), rad/m, whose real parts are used;
    noise : noise fraction, None for the most likely of NOISE_FRACTIONS; dimension : dimension of the field
    """
    N, k = pressures.shape[1], np.real(wavenumbers)
    some = np.unique(np.linspace(0, len(k) - 1, max(1, min(len(k), int(2 * MAX_PRODUCTS / N**2)))).astype(int))
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
        for _ in range(ITERATIONS):  # each iteration lowers the weighted sum of (distance - |x_i - x_j|)^2
            ratio = weight * between / _distances(x)
            x = inverse @ (ratio.sum(axis=1)[:, None] * x - ratio @ x)
        x = x - x.mean(axis=0)
    radius = np.linalg.norm(x - np.median(x, axis=0), axis=1)
    outliers = radius > MAX_RADIUS * np.median(radius)  # dead or noisy channels, which are coherent with no other
    return np.where(outliers[:, None], np.median(x, axis=0), x)


DISTANCES = 60  # number of candidates for a distance, geometrically spaced
SHORTEST = 0.04  # smallest candidate times the largest k
LONGEST = 3.0  # largest candidate times the smallest k


def pair_distances(pressures: Complexes, wavenumbers: Reals, noise: float, dimension: int) -> tuple[np.ndarray, float]:
    """Return the most likely distances (N, N) between microphones, metres, and the sum of their -log likelihoods.

    pressures : (M, N) complex128, each mode of unit mean power; wavenumbers : (M,) float64, rad/m; noise : noise
    fraction
    """
    N, k = pressures.shape[1], wavenumbers
    i, j = np.triu_indices(N, 1)
    power = np.abs(pressures) ** 2
    both = power[:, i] + power[:, j]
    cross = 2 * np.real(np.conj(pressures[:, i]) * pressures[:, j])
    candidates = np.geomspace(SHORTEST / float(k.max()), LONGEST / float(k.min()), DISTANCES)
    kappa = diffuse_kernel(candidates, k, dimension, slope=False)[0] * (1 - max(noise, NOISE_FRACTIONS[0]))
    det = 1 - kappa**2  # determinant of the covariance of two channels of unit power; cost adds the quadratic form
    cost = (1 / det).T @ both - (kappa / det).T @ cross + np.log(det).sum(axis=0)[:, None]  # (DISTANCES, pairs)
    distance = np.zeros((N, N))
    distance[i, j] = distance[j, i] = candidates[np.argmin(cost, axis=0)]
    return distance, float(cost.min(axis=0).sum())


def _distances(x: Reals) -> np.ndarray:
    return np.maximum(np.linalg.norm(x[:, None] - x[None], axis=-1), 1e-9)


def _unfolded(distance: Reals, neighbours: int, axes: int) -> np.ndarray:
    """Return positions (N, axes), metres, by multidimensional scaling of the shortest paths over near neighbours."""
    N = len(distance)
    near = np.argsort(distance + np.diag(np.full(N, np.inf)), axis=1)[:, :neighbours]
    graph, rows = np.zeros((N, N)), np.arange(N)[:, None]
    graph[rows, near] = distance[rows, near]
    path: Reals = shortest_path(np.maximum(graph, graph.T), directed=False)
    path = np.where(np.isfinite(path), path, distance)  # there is no path between separate groups
    centre = np.eye(N) - 1 / N
    values, vectors = np.linalg.eigh(-0.5 * centre @ path**2 @ centre)
    return vectors[:, -axes:] * np.sqrt(np.maximum(values[-axes:], 1e-6 * values[-1]))
