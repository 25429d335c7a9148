"""Where a solver starts: at random, or in closed form from the lowest modes.

At low frequency the field over the array is nearly affine, so the data matrix [Re p; Im p] of the lowest modes, minus
its mean over the microphones, has D dominant singular vectors: the positions up to an affine map. Known microphones
fix that map. Without them a first guess of it follows from the diffuse field, whose gradient has the power
k^2 / (dimension) in each direction, and the likelihood of all modes finds its metric, D (D + 1) / 2 numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..cost.likelihood import diffuse_field, total_cost
from ..model.gauge import fixes_gauge
from ..model.power import mode_power
from ..model.problem import Problem
from ..model.validation import InputError
from .position_fit import minimise
from .residual_noise import enough_modes, noise_at


@dataclass(frozen=True)
class StartRules:
    """How the affine start is made.

    Attributes
    ----------
    lowest_2d, lowest_3d : numbers of lowest modes that give the shape: the first choice, then alternatives
    directions : weaker singular vectors that may give the last direction
    rescalings : factors of the size that are tried if the shape may be right and the size wrong
    metric_modes : modes that the metric is first fitted to; then all
    scales : factors of the first guess that are tried: a field that is not quite affine makes the guess too large
    first_noise : noise's share of the power of `metric_modes` modes at an affine image of the positions
    metric_steps : steps at most of the fit of the metric
    metric_tolerance : metres, at which that fit ends
    """

    lowest_2d: tuple[int, ...] = (8, 16, 28, 5)
    lowest_3d: tuple[int, ...] = (20, 28, 12, 8)
    directions: int = 5
    rescalings: tuple[float, ...] = (0.8, 1.25)
    metric_modes: int = 28
    scales: tuple[float, ...] = (0.3, 0.4, 0.5, 0.6, 0.75, 1.0)
    first_noise: float = 0.1
    metric_steps: int = 12
    metric_tolerance: float = 3e-3

    def lowest(self, dimension: int) -> tuple[int, ...]:
        """Return the numbers of lowest modes for a field of 2 or 3 dimensions."""
        return self.lowest_2d if dimension == 2 else self.lowest_3d


RULES = StartRules()


def random(problem: Problem, rng: np.random.Generator) -> np.ndarray:
    """Return free microphones anywhere in the search domain and known ones in their places : (N, D) float64, metres.

    Raises
    ------
    InputError
        Without a search domain.
    """
    if problem.search is None:
        raise InputError("a random start needs a search domain", "give <search> and <radius>", key="search")
    low, size = np.array(problem.search.origin), np.array(problem.search.size)
    positions = low + size * rng.random((problem.pressures.shape[1], len(low)))
    positions[problem.known] = problem.known_positions
    return positions


def affine(problem: Problem, modes: int, lowest: int | None = None, last: int | None = None) -> np.ndarray:
    """Return positions from the lowest modes; they are exact, up to the gauge, for a field affine over the array.

    Parameters
    ----------
    problem : Problem
    modes : int, modes that may be used, from the lowest up
    lowest : int, optional
        How many of them give the shape; the first choice of `StartRules.lowest` unless given.
    last : int, optional
        Index of the singular vector that gives the last direction; D - 1 unless given, so that the D dominant ones do.

    Returns
    -------
    (N, D) float64, metres; about the origin without known microphones

    Raises
    ------
    InputError
        If there are known microphones that do not fix the affine map, or the modes show too few directions.
    """
    shape, values, lowest = singular_vectors(problem, modes, lowest, last)
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
        raise InputError(
            f"known = {problem.known.tolist()} does not fix translation, rotation and mirror",
            f"name at least {problem.array_dimension + 1} known microphones that span the array, or none",
            key="known",
            value=problem.known.tolist(),
        )


def redirected(problem: Problem, modes: int) -> np.ndarray:
    """Return the likeliest affine start whose last direction is a weaker singular vector : (N, D) float64, metres.

    A source near the middle of the room's height hardly excites modes that change with height: the curvature of the
    field along the other directions is then the stronger singular vector.
    """
    D, N = problem.array_dimension, problem.pressures.shape[1]
    tries = [affine(problem, modes, None, last) for last in range(D, min(D + RULES.directions, N - 1))]
    return min(tries, key=lambda x: noise_at(problem, x, slice(0, modes)).cost)


def attempts(problem: Problem, modes: int) -> list[tuple[str, float]]:
    """Return the starts to try, in this order: kind and value.

    "lowest"      the affine start of so many lowest modes
    "rescaled"    the best positions so far times a factor
    "redirected"  as of `redirected`
    "gradual"     the first start again, with a noise that is lowered in stages (of use if noise is not the only error)

    The second start is most like the first: if the first was right, the second soon confirms it.
    """
    counts = dict.fromkeys(min(n, modes) for n in RULES.lowest(problem.dimension))
    lowest = [("lowest", count) for count in counts]
    second = lowest[1:2] if len(problem.known) else [("rescaled", factor) for factor in RULES.rescalings]
    others = [one for one in lowest[1:] if one not in second]
    return [lowest[0], *second, ("redirected", 0), *others, ("gradual", lowest[0][1])]


def singular_vectors(
    problem: Problem, modes: int, lowest: int | None = None, last: int | None = None
) -> tuple[np.ndarray, np.ndarray, int]:
    """Return the D dominant singular vectors of the data matrix over the microphones.

    Parameters
    ----------
    problem, modes, lowest, last : as of `affine`

    Returns
    -------
    vectors : (N, D) float64
    values : (D,) float64, singular values; that of `last` is the value of the vector before it, since a weak
        excitation says nothing about the extent of the array
    lowest : int, modes that gave them
    """
    lowest = min(RULES.lowest(problem.dimension)[0] if lowest is None else lowest, modes)
    data = np.concatenate([np.real(problem.pressures[:lowest]), np.imag(problem.pressures[:lowest])])
    data = data - data.mean(axis=1, keepdims=True)
    _, values, vectors = np.linalg.svd(data, full_matrices=False)
    D = problem.array_dimension
    if len(values) < D or values[D - 1] <= 1e-9 * values[0]:
        raise InputError(
            f"the lowest {lowest} modes show fewer than {D} directions: the microphones stand on a line, or there"
            " are too few modes",
            "measure more modes",
            key="modes",
        )
    if last is not None:
        chosen = [*range(D - 1), last]
        return vectors[chosen].T, np.append(values[: D - 1], values[D - 2]), lowest
    return vectors[:D].T, values[:D], lowest


def _with_metric(problem: Problem, modes: int, shape, values, lowest: int) -> np.ndarray:
    """The shape of `singular_vectors` with the metric of greatest likelihood."""
    N, D = shape.shape
    k = np.real(problem.wavenumbers)
    guess = shape * values / np.sqrt(np.sum(k[:lowest] ** 2) / problem.dimension)
    basis = _symmetric_maps(shape).reshape(-1, N * D).T
    residual = None
    for count in (RULES.metric_modes, RULES.metric_modes, modes, modes):
        used = enough_modes(problem, slice(0, min(count, modes)))
        p = problem.pressures[used]
        power = mode_power(p)
        share = RULES.first_noise if residual is None else residual.shares(k[used])
        field = diffuse_field(p, k[used], share * power, problem.dimension)
        if residual is None:
            sizes = [scale * guess for scale in RULES.scales]
            guess = min(sizes, key=lambda x, p=p, field=field: total_cost(x, p, field))
        guess = minimise(guess, p, field, basis, RULES.metric_steps, RULES.metric_tolerance)
        residual = noise_at(problem, guess, slice(0, min(count, modes)))
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
