"""Chebyshev nodes over a search domain: costs are computed there, and interpolated onto a lattice of any fineness.

A lattice is far finer than the field. A prediction of the pressure has no wavenumber above k and the variance of its
error none above 2 k, so that a few dozen nodes along each axis hold both to rounding errors.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.special import jv

from ..model.settings import Search

NEGLIGIBLE = 1e-15  # Chebyshev coefficient that is left out


def area(search: Search, dimension: int = 2) -> np.ndarray:
    """Return lowest and highest x and y, and z of three dimensions, the cells at the edge included : (2, D) metres."""
    low = np.asarray(search.origin)[:dimension] - search.step / 2
    return np.stack([low, low + search.step * np.array(search.shape[:dimension])])


@functools.lru_cache(maxsize=1024)
def node_counts(
    search: Search, wavenumber: float, dimension: int = 2, negligible: float = NEGLIGIBLE
) -> tuple[int, ...]:
    """Return the numbers of nodes along each axis that resolve wavenumbers up to 2 k.

    They are multiples of 4, so that modes share their tables.

    Parameters
    ----------
    wavenumber : k, rad/m
    dimension : 2 for x and y, 3 for z, too
    negligible : Chebyshev coefficient of a plane wave of wavenumber 2 k that is left out
    """
    low, high = area(search, dimension)
    counts = []
    for half in (high - low) / 2:
        z = 2 * wavenumber * half
        degrees = np.arange(int(z) + 1, int(1.5 * z) + 60)  # beyond l = z the coefficients J_l(z) decrease
        counts.append(4 * (int(degrees[np.argmax(jv(degrees, z) < negligible)]) // 4 + 1))
    return tuple(counts)


def _nodes(count: int) -> np.ndarray:
    """Return the Chebyshev nodes between -1 and 1 : (count,) float64."""
    return np.cos(np.pi * (np.arange(count) + 0.5) / count)


def node_points(search: Search, counts) -> np.ndarray:
    """Return the nodes of the domain, as many along each axis as `counts` says : (C, D) metres, x fastest."""
    low, high = area(search, len(counts))
    axes = [a + (b - a) * (1 + _nodes(count)) / 2 for a, b, count in zip(low, high, counts, strict=True)]
    return np.stack([x.ravel() for x in np.meshgrid(*axes[::-1], indexing="ij")][::-1], axis=1)


@functools.lru_cache(maxsize=128)
def from_nodes(domain: Search, search: Search, axis: int, count: int) -> np.ndarray:
    """Return the matrix (points, nodes) that interpolates from the nodes of `domain` to the lattice, on one axis."""
    return interpolation(domain, search.origin[axis] + search.step * np.arange(search.shape[axis]), axis, count)


def interpolation(domain: Search, places: np.ndarray, axis: int, count: int) -> np.ndarray:
    """Return the matrix (P, count) that interpolates from the nodes of `domain` to places (P,), metres, on one axis."""
    low, high = area(domain, len(domain.origin))[:, axis]
    weight = np.full(count, 2.0 / count)
    weight[0] /= 2
    there = chebvander((2 * places - low - high) / (high - low), count - 1)
    return (there * weight) @ chebvander(_nodes(count), count - 1).T
