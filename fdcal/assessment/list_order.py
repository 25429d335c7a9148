"""The order in which a list of positions fits: when channels count as swapped, and when the list counts as fitting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .point_matching import assigned, tolerance_of


@dataclass(frozen=True)
class CheckLimits:
    """When a list counts as fitting, and channels as swapped.

    Attributes
    ----------
    swapped : a swap must reduce the distance of a microphone to less than this share of what it was
    improved : share of the microphones of a cycle for which it must
    kept : share of the microphones that must be at their own places for the order to count as that of the list
    close : median distance of a list in its own order, of the spacing of the microphones, at most
    found : the same of a list in which most are exchanged; unrelated arrays of 16 reach 0.28, of 32 0.34
    freedom : number of microphones beyond D + 1 from which `found` holds; of fewer it is less in proportion
    alike, resolved : other orders fit as well up to this factor of the mean square, and this share of the spacing
    size : factor by which list and array may differ in size
    """

    swapped: float = 0.5
    improved: float = 0.75
    kept: float = 0.5
    close: float = 0.5
    found: float = 0.25
    freedom: int = 12
    alike: float = 1.5
    resolved: float = 0.03
    size: float = 1.1


LIMITS = CheckLimits()


def closeness(order: np.ndarray, dimension: int) -> float:
    """Return how close a list must be in an order, of the spacing: the more is exchanged, the more easily it fits."""
    many = min(1.0, max(0.0, (len(order) - dimension - 1) / LIMITS.freedom))
    moved = float(np.mean(order != np.arange(len(order))))
    exchanged = min(1.0, moved / (1 - LIMITS.kept))
    return (1 - exchanged) * LIMITS.close + exchanged * LIMITS.found * many


def kept_order(placed: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Return at whose position each microphone stands : (N,) int64, its own unless most of a cycle is far nearer."""
    tolerance = tolerance_of(given)
    order = assigned(placed, given, tolerance)
    before = np.linalg.norm(placed - given, axis=1)
    nearer = np.linalg.norm(placed - given[order], axis=1) < LIMITS.swapped * before
    kept = np.arange(len(order))
    for cycle in map(list, cycles_of(order)):
        if np.mean(nearer[cycle]) >= LIMITS.improved:
            kept[cycle] = order[cycle]
    return kept


def cycles_of(order: np.ndarray) -> list[tuple[int, ...]]:
    """Return the cycles of a permutation that move something, each from its lowest number."""
    seen, cycles = set(), []
    for start in range(len(order)):
        cycle, n = [], start
        while n not in seen:
            seen.add(n)
            cycle.append(n)
            n = int(order[n])
        if len(cycle) > 1:
            cycles.append(tuple(cycle))
    return cycles
