"""Positions found compared with a list of them: swapped channels, another order or size, another array."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..model.gauge import align
from ..model.validation import InputError, frozen_array, require_finite
from .list_order import LIMITS, closeness, cycles_of, kept_order
from .point_matching import Match, matches, nearest_neighbours, tolerance_of


@dataclass(frozen=True, eq=False)
class PositionCheck:
    """Estimated positions compared with those of a list.

    Attributes
    ----------
    errors : (N,) float64
        Metres, distance from the position in the list, of its size, after the best rigid motion.
    swapped : tuple of (int, int)
        Pairs of channels whose positions are exchanged.
    permuted : tuple of tuple of int
        Cycles of more than two channels that stand at each other's positions.
    order : (N,) int64
        Row of the list at whose position each microphone stands; its own unless it is in a cycle.
    distances : (N,) float64
        Metres, distance from that position.
    fits : bool
        Whether the list fits the array found, in this order. Without, nothing is said about swaps: it is the list of
        another array, or the positions, of the list or found, are far off.
    scale : float
        Size of the list over that of the array found; 1 unless they differ by more than a tenth, as in other units.
    spacing : (N,) float64
        Metres, distance of each position of the list, of the size of the array, from the nearest other one.
    symmetric : bool
        Whether the list fits as well turned or mirrored, so that such an exchange of most channels cannot be seen.
    moved : bool
        Whether the positions were moved as a whole although microphones were known: the list has other axes.
    """

    errors: np.ndarray
    swapped: tuple[tuple[int, int], ...]
    permuted: tuple[tuple[int, ...], ...]
    order: np.ndarray
    distances: np.ndarray
    fits: bool
    scale: float
    spacing: np.ndarray
    symmetric: bool = False
    moved: bool = False

    def __post_init__(self):
        for name in ("errors", "distances", "spacing"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), float))
        object.__setattr__(self, "order", frozen_array(self.order, np.int64))

    @property
    def agrees(self) -> bool:
        """Whether the list fits, in its order and its size."""
        return self.fits and self.scale == 1 and not self.swapped and not self.permuted

    def table(self, names: Sequence[str]) -> dict:
        """Return the comparison as it stands in a result file.

        Parameters
        ----------
        names : sequence of N str
            Of the microphones.

        Returns
        -------
        dict
            Of values for JSON; lengths in metres.
        """
        return {
            "fits": self.fits,
            "swapped": [[names[n] for n in pair] for pair in self.swapped],
            "permuted": [[names[n] for n in cycle] for cycle in self.permuted],
            "order": [names[n] for n in self.order],
            "errors_m": self.errors.tolist(),
            "distances_m": self.distances.tolist(),
            "scale": self.scale,
            "symmetric": self.symmetric,
            "moved": self.moved,
        }


def compare_positions(found, given, known=()) -> PositionCheck:
    """Compare estimated positions with those of a list.

    The two are matched by their shape, in any order, place and size; the order of the list is kept where it fits as
    well as any other. A swap is reported where the array as a whole fits better with it and each microphone concerned
    by half at least, of more than three concerned most of them.

    Parameters
    ----------
    found, given : (N, D) array_like
        Metres.
    known : sequence of int
        Numbers of known microphones; without any, or where the list fits only then, the positions are first moved onto
        each other as a whole.

    Returns
    -------
    PositionCheck

    Raises
    ------
    InputError
        The two have different shapes, or a value is not finite.

    Examples
    --------
    >>> import fdcal
    >>> given = [[0.0, 0.0], [1.0, 0.0], [0.0, 2.0], [1.5, 2.5], [3.0, 0.7]]
    >>> fdcal.compare_positions([given[n] for n in (0, 1, 3, 2, 4)], given, known=[0, 1, 4]).swapped
    ((2, 3),)
    """
    found, given = np.asarray(found, float), np.asarray(given, float)
    if found.shape != given.shape:
        raise InputError(
            f"the result has positions of shape {found.shape}, the measurement {given.shape}",
            "use the result of this measurement",
            key="result",
        )
    require_finite("found", found)
    require_finite("given", given)
    if len(found) <= found.shape[1]:
        return _checked(found if len(known) else align(found, given), given, np.arange(len(found)))
    free = _free(found, given)
    if not len(known):
        return free
    fixed = _checked(found, given, kept_order(found, given))
    if (fixed.fits and free.scale == 1) or not free.fits:
        return replace(fixed, scale=free.scale)
    return replace(free, moved=True)


def _free(found: np.ndarray, given: np.ndarray) -> PositionCheck:
    """Return the comparison after the best motion as a whole, and in the size of the array found if that fits."""
    check, scale = _best(found, given), _scale(found, given)
    if 1 / LIMITS.size < scale < LIMITS.size:
        return check
    scaled = _best(found, given / scale)
    if not scaled.fits:
        return replace(check, scale=scale)
    close = scaled.distances <= 2 * np.median(scaled.distances)
    scale *= _spread(given[scaled.order[close]] / scale) / _spread(found[close])
    return replace(_best(found, given / scale), scale=scale)


def _spread(points: np.ndarray) -> float:
    return float(np.linalg.norm(points - points.mean(axis=0)))


def _scale(found: np.ndarray, given: np.ndarray) -> float:
    """Return the ratio of the median distances between microphones, which no exchange changes."""
    of = np.triu_indices(len(found), 1)
    sizes = [float(np.median(np.linalg.norm(p[of[0]] - p[of[1]], axis=1))) for p in (found, given)]
    return sizes[1] / sizes[0] if min(sizes) > 0 else 1.0


def _best(found: np.ndarray, given: np.ndarray) -> PositionCheck:
    """Return the comparison in the order of the list if it fits as well as any other one, or in the best."""
    ways, spacing = matches(found, given), 2 * tolerance_of(given)
    limit = LIMITS.alike * ways[0].cost + (LIMITS.resolved * spacing) ** 2
    alike = [match for match in ways if match.cost <= limit]
    own = np.arange(len(found))
    match = min(alike, key=lambda match: np.count_nonzero(match.order != own))
    check = _aligned(match, given)
    if not check.fits:
        return _aligned(max(ways, key=lambda match: np.count_nonzero(match.order == own)), given)
    return replace(check, symmetric=any(_differs(other, match) for other in alike))


def _aligned(match: Match, given: np.ndarray) -> PositionCheck:
    """Return the comparison of a match, moved by all its microphones where the list fits all of them."""
    order = kept_order(match.placed, given)
    placed = align(match.placed, given[order])
    at_most = tolerance_of(given)
    whole = np.linalg.norm(placed - given[order], axis=1).max() < at_most
    return _checked(placed if whole else match.placed, given, order)


def _differs(one: Match, other: Match) -> bool:
    """Return whether two orders differ in most channels, as those of a turned array do."""
    return float(np.mean(one.order != other.order)) > LIMITS.kept


def _checked(placed: np.ndarray, given: np.ndarray, order: np.ndarray) -> PositionCheck:
    """Return the comparison of positions already placed, in an order; in that of the list where it does not fit."""
    own, spacing = np.arange(len(order)), nearest_neighbours(given)
    errors = np.linalg.norm(placed - given, axis=1)
    distances = np.linalg.norm(placed - given[order], axis=1)
    fits = bool(np.median(distances) <= closeness(order, given.shape[1]) * np.median(spacing))
    cycles = cycles_of(order) if fits else []
    return PositionCheck(
        errors=errors,
        swapped=tuple((c[0], c[1]) for c in cycles if len(c) == 2),
        permuted=tuple(c for c in cycles if len(c) > 2),
        order=order if fits else own,
        distances=distances if fits else errors,
        fits=fits,
        scale=1.0,
        spacing=spacing,
    )
