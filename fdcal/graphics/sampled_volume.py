"""The cost of one microphone in space on a lattice, and the slices through it.

sampled_volume  values and minima on a lattice of the whole domain
drawn_volume    its isosurfaces
sliced          these with a slice across an axis
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..cost.basins import local_minima
from ..cost.maps import CostVolume, area, map_positions
from ..model.settings import Search
from .volume import AXES, Volume, slice_of, volume_of

POINTS = 61  # along the longest edge of a volume that is finished
PIXELS = 240  # along the longer edge of its slice


@dataclass(frozen=True)
class SampledVolume:
    """A volume and its values on a lattice."""

    terms: CostVolume
    search: Search  # the lattice
    cost: np.ndarray  # (nz, ny, nx) float64
    minima: np.ndarray  # (K, 3) float64, metres, local minima

    @property
    def lowest(self) -> np.ndarray:
        """Where the cost is lowest : (3,) float64, metres."""
        index = np.array([np.unravel_index(self.cost.argmin(), self.cost.shape)])
        return map_positions(index, self.search)[0]


def sampled_volume(
    terms: CostVolume, count: int = POINTS, cancelled: Callable[[], bool] = lambda: False
) -> SampledVolume | None:
    """Return a volume on a lattice of the whole domain with its minima; None once cancelled.

    `count`: points along the longest edge; `cancelled`: tells whether the values are no longer wanted.
    """
    domain = terms.domain
    step = max(domain.size) / (count - 1)
    shape = [max(int(length / step + 1e-6), 1) + 1 for length in domain.size]
    search = replace(domain, size=tuple((n - 1) * step for n in shape), step=step)
    axes = [origin + step * np.arange(n) for origin, n in zip(search.origin, shape, strict=True)]
    x, y, z = axes
    cost = terms.on(x, y, z, cancelled)
    if cost is None:
        return None
    minima = map_positions(local_minima(cost), search)
    return SampledVolume(terms, search, cost, minima)


def drawn_volume(sampled: SampledVolume, log: bool = True, minima: bool = True) -> Volume:
    """Return the isosurfaces of a volume, without a slice.

    `log`: whether the colours follow decibels; `minima`: whether the minima are marked.
    """
    places = np.concatenate([sampled.lowest[None], sampled.minima]) if minima else ()
    return volume_of(sampled.cost, sampled.search, log, places)


def sliced(
    volume: Volume, sampled: SampledVolume, axis: str, position: float, log: bool = True, pixels: int = PIXELS
) -> Volume:
    """Return a volume with a slice.

    `volume`: of `drawn_volume`; `axis`: "x", "y" or "z", across the slice; any other word for no slice; `position`:
    along that axis, metres; beyond the domain, its edge; `log`: as of `drawn_volume`; `pixels`: along the longer edge
    of the slice.
    """
    if axis not in AXES or volume.bar is None:
        return replace(volume, plate=None)
    number, terms = AXES.index(axis), sampled.terms
    domain = area(terms.domain, 3)
    low, high = domain[0], domain[1]
    place = float(np.clip(position, low[number], high[number]))
    step = float(np.delete(high - low, number).max()) / pixels
    counts = np.maximum(np.rint((high - low) / step).astype(int), 2)
    places = [a + (b - a) * (np.arange(n) + 0.5) / n for a, b, n in zip(low, high, counts, strict=True)]
    places[number] = np.array([place])
    x, y, z = places
    cost = terms.on(x, y, z)
    if cost is None:
        raise ValueError("a slice that nobody cancels is complete")
    return replace(volume, plate=slice_of(np.squeeze(cost, axis=2 - number), number, place, domain, volume.bar, log))
