"""A start from the coherence between microphones: distances of pairs, then positions by multidimensional scaling.

In a diffuse field two microphones at a distance r share

    E[p_i conj(p_j)] / power = kappa(k r),   kappa = J_0 in the plane, sin(z) / z in space.

All frequencies together give the likeliest distance of every pair. It is good to about a tenth of itself: one source
excites few directions at a frequency. Unlike the affine start, it does not suppose that the array is small against the
wavelength. Distances of far pairs are ambiguous: the array is unfolded along its near ones (Tenenbaum, de Silva and
Langford, Science 290, 2000: isomap), and stress majorisation (de Leeuw, 1977) brings in the others where they fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import shortest_path

from ...cost.channel_kernels import diffuse_kernel


@dataclass(frozen=True)
class CoherenceRules:
    """Numbers of the coherence start.

    Attributes
    ----------
    values : pressures products M N (N - 1) / 2 at most; of more modes a part is taken
    distances : candidates of a distance, geometrically spaced
    shortest, longest : the least candidate over 1 / (greatest k), the greatest over 1 / (least k)
    noises : shares of noise in the power to choose from where none is reported; the first is the least in any case
    neighbours : nearest microphones of each along which the array is unfolded
    reach : times 1 / (greatest k): farther pairs count less, one entry for every round of majorisation
    far : weight of these
    scatter : relative error of a distance; pairs that disagree by more with the array count less
    iterations : of majorisation in a round
    farthest : distance from the middle over the median of all; a channel beyond starts in the middle
    """

    values: float = 3e5
    distances: int = 60
    shortest: float = 0.04
    longest: float = 3.0
    noises: tuple[float, ...] = (1e-2, 3e-2, 0.1, 0.3)
    neighbours: int = 10
    reach: tuple[float, ...] = (4.0, 4.0, 9.0, 9.0, 9.0)
    far: float = 0.1
    scatter: float = 0.2
    iterations: int = 30
    farthest: float = 2.5


RULES = CoherenceRules()


def coherence_start(pressures, wavenumbers, noise: float | None, dimension: int, axes: int) -> np.ndarray:
    """Return positions (N, axes), metres, about the origin, that agree with the coherence of the pressures.

    Parameters
    ----------
    pressures : (M, N) complex128, each mode of unit mean power
    wavenumbers : (M,) rad/m, the real parts count
    noise : share of noise in the power; None for the likeliest of `CoherenceRules.noises`
    dimension : 2 or 3, of the sound field
    axes : of the array
    """
    N, k = pressures.shape[1], np.real(wavenumbers)
    some = np.unique(np.linspace(0, len(k) - 1, max(1, min(len(k), int(2 * RULES.values / N**2)))).astype(int))
    shares = RULES.noises if noise is None else (noise,)
    distance, _ = min((pair_distances(pressures[some], k[some], one, dimension) for one in shares), key=lambda d: d[1])
    x = _unfolded(distance, min(RULES.neighbours, N - 1), axes)
    between = distance + np.eye(N)
    for reach in RULES.reach:
        misfit = np.log(between / (_distances(x) + np.eye(N)))
        weight = np.where(distance < reach / k.max(), 1.0, RULES.far) / (RULES.scatter**2 + misfit**2) / between**2
        x = _majorised(x, between, weight - np.diag(np.diag(weight)))
    radius = np.linalg.norm(x - np.median(x, axis=0), axis=1)
    outliers = radius > RULES.farthest * np.median(radius)  # hears nothing of what the others hear: dead or noisy
    return np.where(outliers[:, None], np.median(x, axis=0), x)


def pair_distances(pressures, wavenumbers, noise: float, dimension: int) -> tuple[np.ndarray, float]:
    """Return the likeliest distance of every two microphones, metres, (N, N), and the sum of -log likelihood.

    pressures : (M, N) complex128, each mode of unit mean power;  wavenumbers : (M,) float64;  noise : share
    """
    N, k = pressures.shape[1], wavenumbers
    i, j = np.triu_indices(N, 1)
    power = np.abs(pressures) ** 2
    both, cross = power[:, i] + power[:, j], 2 * np.real(np.conj(pressures[:, i]) * pressures[:, j])
    candidates = np.geomspace(RULES.shortest / k.max(), RULES.longest / k.min(), RULES.distances)
    kappa = diffuse_kernel(candidates, k, dimension, slope=False)[0] * (1 - max(noise, RULES.noises[0]))
    det = 1 - kappa**2  # the determinant and the quadratic form of two channels of unit power
    cost = (1 / det).T @ both - (kappa / det).T @ cross + np.log(det).sum(axis=0)[:, None]
    distance = np.zeros((N, N))
    distance[i, j] = distance[j, i] = candidates[np.argmin(cost, axis=0)]
    return distance, float(cost.min(axis=0).sum())


def _distances(x) -> np.ndarray:
    return np.maximum(np.linalg.norm(x[:, None] - x[None], axis=-1), 1e-9)


def _unfolded(distance, neighbours: int, axes: int) -> np.ndarray:
    """Positions (N, axes) by classical scaling of the shortest paths over near neighbours."""
    N = len(distance)
    near = np.argsort(distance + np.diag(np.full(N, np.inf)), axis=1)[:, :neighbours]
    graph = np.zeros((N, N))
    rows = np.arange(N)[:, None]
    graph[rows, near] = distance[rows, near]
    path = shortest_path(np.maximum(graph, graph.T), directed=False)
    path = np.where(np.isfinite(path), path, distance)  # groups far from each other
    centre = np.eye(N) - 1 / N
    values, vectors = np.linalg.eigh(-0.5 * centre @ path**2 @ centre)
    return vectors[:, -axes:] * np.sqrt(np.maximum(values[-axes:], 1e-6 * values[-1]))


def _majorised(x, distance, weight) -> np.ndarray:
    """Positions that lower the weighted sum of (distance - |x_i - x_j|)^2; weight (N, N) is zero on the diagonal."""
    N = len(x)
    system = np.diag(weight.sum(axis=1)) - weight + weight.mean() / N  # the added constant holds the mean
    inverse = np.linalg.inv(system)
    for _ in range(RULES.iterations):
        ratio = weight * distance / _distances(x)
        x = inverse @ (ratio.sum(axis=1)[:, None] * x - ratio @ x)
    return x - x.mean(axis=0)
