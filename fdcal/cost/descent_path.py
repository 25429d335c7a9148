"""The way of one microphone downhill over a map of its cost: from a place to the local minimum of its basin.

The path follows the steepest descent of the cost, interpolated between the points of the lattice, and stays in the
basin where it begins (`fdcal.cost.basins`), so it ends at the minimum that the map marks there. At a minimum that is
too shallow to count it goes on at the nearest point of the basin whose cost is lower.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from ..model.settings import Search
from ..model.types import Reals
from .basins import OUTSIDE, Basins

STRIDE, SHORTEST = 0.7, 0.05  # of a step of the path, in steps of the lattice: the usual one, and the last one tried
MAX_STEPS = 2000
REACH = 4.0  # steps of the lattice over which a path to the edge of the map goes on from a shallow minimum


@dataclass(frozen=True)
class DescentPath:
    """A path downhill."""

    points: Reals  # (P, D) float64, metres, from the start to the minimum
    costs: Reals  # (P,) float64, descending
    basin: int  # number of the basin, or OUTSIDE of a path that ends at the edge of the map


def descent_path(cost: np.ndarray, search: Search, basins: Basins, place: Reals) -> DescentPath:
    """Return the path downhill from a place.

    `cost` (ny, nx) or (nz, ny, nx) float64, over the lattice `search`; `basins`: of this cost; `place` (2,) or (3,)
    float64, metres; outside of the lattice, its edge.
    """
    origin, last = np.asarray(search.origin[: cost.ndim]), np.array(cost.shape) - 1
    here = np.clip(((np.asarray(place, float)[: cost.ndim] - origin) / search.step)[::-1], 0.0, last)  # as indices
    own = basins.labels[_nearest(here)]
    slopes = np.gradient(cost)

    def height(at: Reals) -> float:
        return float(map_coordinates(cost, at[:, None], order=1)[0])

    def step_from(at: Reals, level: float) -> tuple[Reals, float] | None:
        """The next place downhill in the basin and its cost, or None."""
        slope = np.array([map_coordinates(one, at[:, None], order=1)[0] for one in slopes])
        slope[((at <= 0) & (slope > 0)) | ((at >= last) & (slope < 0))] = 0.0  # not out of the map
        length, stride = float(np.linalg.norm(slope)), STRIDE
        while length > 0 and stride > SHORTEST:
            there = np.clip(at - stride * slope / length, 0.0, last)
            lower = height(there)
            if lower < level and basins.labels[_nearest(there)] == own:
                return there, lower
            stride /= 2
        return _nearest_lower(cost, basins.labels == own, at, level, REACH if own == OUTSIDE else np.inf)

    points, costs = [here], [height(here)]
    while len(points) < MAX_STEPS and (step := step_from(points[-1], costs[-1])) is not None:
        points.append(step[0])
        costs.append(step[1])
    return DescentPath(origin + search.step * np.array(points)[:, ::-1], np.array(costs), int(own))


def _nearest(place: Reals) -> tuple[int, ...]:
    return tuple(np.rint(place).astype(int))


def _nearest_lower(
    cost: np.ndarray, inside: np.ndarray, place: Reals, level: float, reach: float
) -> tuple[Reals, float] | None:
    """The nearest point of a basin whose cost is below `level`, no farther than `reach`, and its cost; or None."""
    lower = np.argwhere(inside & (cost < level))
    away = np.linalg.norm(lower - place, axis=1)
    if not len(lower) or away.min() > reach:
        return None
    found = lower[int(away.argmin())]
    return found.astype(float), float(cost[tuple(found)])
