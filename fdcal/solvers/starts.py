"""Where a solver starts: at random, or in closed form from the lowest modes.

At low frequency the field over the array is nearly affine, so the data matrix [Re p; Im p] of the lowest modes, its
mean over the microphones taken off, has D dominant singular vectors: the positions up to an affine map. Known
microphones fix that map. With none, a first guess of it follows from the diffuse field, whose gradient has the power
k^2 / (dimension) in each direction, and the likelihood finds its metric, D (D + 1) / 2 numbers.
"""

from __future__ import annotations

import numpy as np

from ..checks import InputError
from ..gauge import fixes_gauge
from ..likelihood import diffuse_field
from ..measurement import Problem
from .newton import minimise

MODES = 8  # that give the shape
METRIC_MODES = 28  # that give the metric
SCALES = (0.35, 0.5, 0.7, 1.0)  # of the first guess: a field that is not quite affine makes it too large
AFFINE_NOISE = 0.1  # what an affine image leaves unexplained of METRIC_MODES modes


def random(problem: Problem, rng: np.random.Generator) -> np.ndarray:
    """Free microphones anywhere in the search domain, known ones in their places : (N, D) float64, metres."""
    if problem.search is None:
        raise InputError("a random start needs a search domain; give --search ORIGIN,SIZE,STEP and --radius R")
    low, size = np.array(problem.search.origin), np.array(problem.search.size)
    positions = low + size * rng.random((problem.pressures.shape[1], len(low)))
    positions[problem.known] = problem.known_positions
    return positions


def affine(problem: Problem) -> np.ndarray:
    """Positions from the lowest modes : (N, D) float64, metres; without known microphones about the origin.

    Exact, up to the gauge, for a field that is affine over the array. Raises InputError where there are known
    microphones that do not fix the map.
    """
    shape = singular_vectors(problem)[0]
    if not len(problem.known):
        return _with_metric(problem)
    if not fixes_gauge(problem.known_positions):
        raise InputError(
            f"known = {problem.known.tolist()} does not fix translation, rotation and mirror; name at least"
            f" {problem.array_dimension + 1} known microphones that span the array, or none"
        )
    extended = np.column_stack([shape, np.ones(len(shape))])
    positions = extended @ np.linalg.lstsq(extended[problem.known], problem.known_positions, rcond=None)[0]
    positions[problem.known] = problem.known_positions
    return positions


def singular_vectors(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """The D dominant ones (N, D) over the microphones, and their singular values (D,), of the lowest modes."""
    lowest = problem.pressures[:MODES]
    data = np.concatenate([lowest.real, lowest.imag])
    data = data - data.mean(axis=1, keepdims=True)
    _, values, vectors = np.linalg.svd(data, full_matrices=False)
    D = problem.array_dimension
    if len(values) < D or values[D - 1] <= 1e-9 * values[0]:
        raise InputError(
            f"the lowest {len(lowest)} modes show fewer than {D} directions: the microphones stand on a line, or there"
            " are too few modes; measure more"
        )
    return vectors[:D].T, values[:D]


def _with_metric(problem: Problem) -> np.ndarray:
    """The shape of `singular_vectors` with the metric that makes the pressures most likely."""
    shape, values = singular_vectors(problem)
    N, D = shape.shape
    k = np.real(problem.wavenumbers)
    guess = shape * values / np.sqrt(np.sum(k[:MODES] ** 2) / problem.dimension)
    p = problem.pressures[:METRIC_MODES]
    power = np.mean(np.abs(p) ** 2, axis=1)
    field = diffuse_field(p, k[:METRIC_MODES], AFFINE_NOISE * power, problem.dimension)
    basis = _symmetric_maps(shape).reshape(-1, N * D).T
    found = [minimise(scale * guess, p, field, basis, iterations=12) for scale in SCALES]
    return min(found, key=lambda pair: pair[1])[0]


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
