"""Where a solver starts: at random, or in closed form from the lowest modes; and how a rough array bends.

At low frequency the field over the array is nearly affine, so the data matrix [Re p; Im p] of the lowest modes, its
mean over the microphones taken off, has D dominant singular vectors: the positions up to an affine map. Known
microphones fix that map. With none, a first guess of it follows from the diffuse field, whose gradient has the power
k^2 / (dimension) in each direction, and the likelihood of all modes finds its metric, D (D + 1) / 2 numbers.

What is wrong with such a start is smooth, since the field is: `bends` are the polynomials of the positions. Moving the
array along them first, before every microphone moves for itself, is what makes the start good enough (see `joint`).
"""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np

from ..cost.leave_one_out import leave_one_out_chi_square, likelihood_landscapes
from ..cost.likelihood import diffuse_field, total_cost
from ..cost.noise_model import NoiseEstimate, estimate_noise
from ..model.gauge import fixes_gauge
from ..model.power import mode_power
from ..model.problem import Problem
from ..model.validation import InputError
from .levenberg_marquardt import minimise

LOWEST = {2: (8, 16, 28, 5), 3: (20, 28, 12, 8)}  # modes that give the shape in 2-D and 3-D: the choice, and others
OTHER_DIRECTIONS = 5  # weaker singular vectors that may be the last direction
RESCALED = (0.8, 1.25)  # an end that does not convince may have the right shape and a wrong size
METRIC_MODES = 28  # that give the metric first; all of them then
SCALES = (0.3, 0.4, 0.5, 0.6, 0.75, 1.0)  # of the first guess: a field that is not quite affine makes it too large
FIRST_NOISE = 0.1  # what an affine image leaves unexplained of METRIC_MODES modes
MISFIT = 1.3  # mean square of what is expected, from which a microphone may stand in a wrong basin
ASTRAY = 2.5  # the same, from which it surely does
MOST_REHOMED = 8  # at once
NOISE_MODES = 24  # at most, evenly taken, to estimate the noise from
PLENTY = 4000  # pressures, for a bend or a metric, which are few numbers


def random(problem: Problem, rng: np.random.Generator) -> np.ndarray:
    """Free microphones anywhere in the search domain, known ones in their places : (N, D) float64, metres."""
    if problem.search is None:
        raise InputError("a random start needs a search domain", "give <search> and <radius>", key="search")
    low, size = np.array(problem.search.origin), np.array(problem.search.size)
    positions = low + size * rng.random((problem.pressures.shape[1], len(low)))
    positions[problem.known] = problem.known_positions
    return positions


def affine(problem: Problem, modes: int, lowest: int | None = None, last: int | None = None) -> np.ndarray:
    """Positions from the lowest modes : (N, D) float64, metres; without known microphones about the origin.

    modes : number of modes that may be used, from the lowest up
    lowest : how many of them give the shape; the first choice of `LOWEST` unless given
    last : index of the singular vector that gives the last direction; D - 1, the D dominant ones, unless given

    Exact, up to the gauge, for a field that is affine over the array. Raises InputError where there are known
    microphones that do not fix the map.
    """
    shape, values, lowest = singular_vectors(problem, modes, lowest, last)
    if not len(problem.known):
        return _with_metric(problem, modes, shape, values, lowest)
    if not fixes_gauge(problem.known_positions):
        raise InputError(
            f"known = {problem.known.tolist()} does not fix translation, rotation and mirror; name at least"
            f" {problem.array_dimension + 1} known microphones that span the array, or none"
        )
    extended = np.column_stack([shape, np.ones(len(shape))])
    positions = extended @ np.linalg.lstsq(extended[problem.known], problem.known_positions, rcond=None)[0]
    positions[problem.known] = problem.known_positions
    return positions


def redirected(problem: Problem, modes: int) -> np.ndarray:
    """The likeliest affine start whose last direction is a weaker singular vector : (N, D) float64, metres.

    A source near the middle of the room's height hardly excites what changes with height: the curvature of the field
    along the other directions is then the stronger singular vector.
    """
    D, N = problem.array_dimension, problem.pressures.shape[1]
    tries = [affine(problem, modes, None, last) for last in range(D, min(D + OTHER_DIRECTIONS, N - 1))]
    return min(tries, key=lambda x: left_over(problem, x, slice(0, modes)).cost)


def attempts(problem: Problem, modes: int) -> list[tuple[str, float]]:
    """What to try, in this order.

    "lowest": the affine start of so many lowest modes; "redirected": as of `redirected`; "rescaled": the best so far
    times a factor; "gentle": the first once more, with a noise that falls in stages (of use without noise alone).

    The second is most like the first: where the first was right, it soon says so, too.
    """
    lowest = [("lowest", count) for count in dict.fromkeys(min(n, modes) for n in LOWEST[problem.dimension])]
    second = lowest[1:2] if len(problem.known) else [("rescaled", factor) for factor in RESCALED]
    others = [one for one in lowest[1:] if one not in second]
    return [lowest[0], *second, ("redirected", 0), *others, ("gentle", lowest[0][1])]


def singular_vectors(
    problem: Problem, modes: int, lowest: int | None = None, last: int | None = None
) -> tuple[np.ndarray, np.ndarray, int]:
    """The D dominant ones (N, D) over the microphones, their singular values (D,), and how many modes gave them.

    With `last` that one takes the place of the last, with the singular value of the one before: how little of it there
    is says nothing of its length.
    """
    lowest = min(LOWEST[problem.dimension][0] if lowest is None else lowest, modes)
    data = np.concatenate([problem.pressures[:lowest].real, problem.pressures[:lowest].imag])
    data = data - data.mean(axis=1, keepdims=True)
    _, values, vectors = np.linalg.svd(data, full_matrices=False)
    D = problem.array_dimension
    if len(values) < D or values[D - 1] <= 1e-9 * values[0]:
        raise InputError(
            f"the lowest {lowest} modes show fewer than {D} directions: the microphones stand on a line, or there"
            " are too few modes; measure more"
        )
    if last is not None:
        chosen = [*range(D - 1), last]
        return vectors[chosen].T, np.append(values[: D - 1], values[D - 2]), lowest
    return vectors[:D].T, values[:D], lowest


def bends(positions: np.ndarray, known: np.ndarray, degree: int) -> np.ndarray:
    """Smooth deformations that leave the known microphones in place : (N D, F) float64, orthonormal.

    Every coordinate moves by a polynomial of `degree` in the positions, of less where the array has too few
    microphones to tell them apart.
    """
    N, D = positions.shape
    z = positions - positions.mean(axis=0)
    z = z / np.sqrt(np.mean(z**2))
    columns = [np.ones(N)]
    for d in range(1, degree + 1):
        more = [np.prod(z[:, list(c)], axis=1) for c in combinations_with_replacement(range(D), d)]
        if d > 1 and len(columns) + len(more) > N / 2:
            break
        columns += more
    whole = np.kron(np.linalg.qr(np.column_stack(columns))[0], np.eye(D))
    if not len(known):
        return whole
    rows = whole[(D * np.asarray(known)[:, None] + np.arange(D)).ravel()]
    _, values, vectors = np.linalg.svd(rows)
    return whole @ vectors[np.count_nonzero(values > 1e-9 * values[0]) :].T


def left_over(problem: Problem, positions, modes: slice, near: bool = False, told: float = 0.0) -> NoiseEstimate:
    """`fdcal.cost.noise_model.estimate_noise` of a part of the modes, evenly taken."""
    used = _spaced(problem, modes)
    return estimate_noise(positions, problem.pressures[used], problem.wavenumbers[used], problem.dimension, near, told)


def rehomed(problem: Problem, positions, modes: slice, rest: NoiseEstimate) -> np.ndarray:
    """`positions` with the microphones that fit worst moved to where they fit best, the others held : (N, D), metres.

    A microphone that the rough start has put into a wrong basin would flee outward once less noise is supposed. The
    places tried lie an eighth of the shortest wavelength apart all over the array: the paper's step, coarse and for a
    few microphones alone.
    """
    p, k, field = _rough_field(problem, modes, rest)
    x = np.array(positions)
    misfit = leave_one_out_chi_square(x, p, field)
    apart = np.pi / 4 / float(k.max())
    axes = [np.arange(low - apart, high + 2 * apart, apart) for low, high in zip(x.min(0), x.max(0), strict=True)]
    candidates = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, x.shape[1])
    worst = [n for n in np.argsort(-misfit)[:MOST_REHOMED] if misfit[n] > MISFIT and n in problem.free]
    while worst:
        costs = likelihood_landscapes(x, worst, np.vstack([x[worst], candidates]), p, field).sum(axis=0)
        own = np.arange(len(worst))
        costs[:, : len(worst)] = np.where(own[:, None] == own, costs[:, : len(worst)], np.inf)  # not onto another
        falls = np.diag(costs) - costs.min(axis=1)
        moving = np.flatnonzero(falls > 1.0)
        if not len(moving):
            break
        first = int(moving[0])  # the others are looked at anew
        x[worst[first]] = np.vstack([x[worst], candidates])[int(np.argmin(costs[first]))]
        worst = worst[first + 1 :]
    return x


def misfits(problem: Problem, positions, modes: slice, rest: NoiseEstimate) -> np.ndarray:
    """Return `leave_one_out_chi_square` of every microphone (N,), the whole residual taken as noise."""
    p, _, field = _rough_field(problem, modes, rest)
    return leave_one_out_chi_square(positions, p, field)


def _rough_field(problem: Problem, modes: slice, rest: NoiseEstimate):
    """Pressures, wavenumbers and the diffuse field of a part of the modes."""
    used = _spaced(problem, modes)
    p, k = problem.pressures[used], np.real(problem.wavenumbers[used])
    return p, k, diffuse_field(p, k, rest.shares(k) * mode_power(p), problem.dimension)


def plenty(problem: Problem, modes: slice) -> np.ndarray:
    """Of the modes as many, evenly taken, as a bend of a large array takes, NOISE_MODES at least : int64."""
    chosen = np.arange(len(problem.pressures))[modes]
    count = len(chosen) * problem.pressures.shape[1] // PLENTY
    return chosen[:: max(1, min(count, len(chosen) // NOISE_MODES))]


def _spaced(problem: Problem, modes: slice) -> np.ndarray:
    """At most NOISE_MODES of the modes, evenly taken : int64."""
    chosen = np.arange(len(problem.pressures))[modes]
    return chosen[:: max(1, -(-len(chosen) // NOISE_MODES))]


def _with_metric(problem: Problem, modes: int, shape, values, lowest: int) -> np.ndarray:
    """The shape of `singular_vectors` with the metric that makes the pressures most likely."""
    N, D = shape.shape
    k = np.real(problem.wavenumbers)
    guess = shape * values / np.sqrt(np.sum(k[:lowest] ** 2) / problem.dimension)
    basis = _symmetric_maps(shape).reshape(-1, N * D).T
    rest = None
    for count in (METRIC_MODES, METRIC_MODES, modes, modes):
        used = plenty(problem, slice(0, min(count, modes)))
        p = problem.pressures[used]
        power = mode_power(p)
        noise = FIRST_NOISE if rest is None else rest.shares(k[used])
        field = diffuse_field(p, k[used], noise * power, problem.dimension)
        if rest is None:
            guess = min((scale * guess for scale in SCALES), key=lambda x: total_cost(x, p, field))
        guess = minimise(guess, p, field, basis, iterations=12, tolerance=3e-3)
        rest = left_over(problem, guess, slice(0, min(count, modes)))
    return guess


def _symmetric_maps(shape: np.ndarray) -> np.ndarray:
    """The images of (N, D) `shape` under a basis of the symmetric matrices : (D (D + 1) / 2, N, D)."""
    D = shape.shape[1]
    maps = []
    for a in range(D):
        for b in range(a, D):
            S = np.zeros((D, D))
            S[a, b] = S[b, a] = 1.0
            maps.append(shape @ S)
    return np.array(maps)
