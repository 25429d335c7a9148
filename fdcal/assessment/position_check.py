"""Positions found compared with a list of them: swapped channels, another order or size, another array.

The two sets of points are matched by their shape, in whatever place and order, in the first part.

A base of D points far apart is laid onto every group of D points of the other set that has the same distances. Each
such group gives a rigid motion, and a mirror image of it. The motions under which most points lie close to one of the
other set are refined in turns: the best assignment for the motion, then the best motion for the assignment, which is
iterative closest point with the Hungarian method. Several disjoint bases are tried, so that a few wrong points do no
harm.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..model.gauge import align
from ..model.validation import InputError, frozen_array, require_finite

if TYPE_CHECKING:
    from .calibration import Calibration


@dataclass(frozen=True, eq=False)
class Match:
    """One way to lay points onto others."""

    placed: np.ndarray  # (N, D) float64, the points, moved as a whole, metres
    order: np.ndarray  # (N,) int64, number of the other point at which each lies
    cost: float  # mean square of the distances, each cut off at the tolerance, metres^2


def distances(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the distance of each of `points` (N, D) from each of `others` (P, D) : (N, P) float64."""
    return np.linalg.norm(points[:, None] - others[None], axis=2)


def nearest_neighbours(points: np.ndarray) -> np.ndarray:
    """Return the distance of each of `points` (N, D) from the nearest other one : (N,) float64."""
    return (distances(points, points) + np.diag(np.full(len(points), np.inf))).min(axis=1)


TOLERANCE = 0.5  # of the median distance between nearest neighbours, dimensionless


def tolerance_of(points: np.ndarray) -> float:
    """Return how far from one of `points` (N, D) another one counts as the same."""
    return TOLERANCE * float(np.median(nearest_neighbours(points)))


MAX_REFINED = 40  # number of motions, of each base, that are refined, at most
USUAL_COUNT = 64  # number of points from which fewer motions are refined
ENOUGH = 0.9  # fraction of the points that must lie close to another for no further base to be tried


def matches(points: np.ndarray, others: np.ndarray) -> list[Match]:
    """Return the ways in which `points` (N, D) lie closest to `others`, each with another order, the closest first."""
    from scipy.spatial import KDTree

    tolerance, tree = tolerance_of(others), KDTree(others)
    max_count = max(1, int(MAX_REFINED * min(1.0, (USUAL_COUNT / len(points)) ** 2)))
    off = np.median(np.abs(distances(points, points) - distances(others, others)), axis=1)
    half = np.argsort(off, kind="stable")[: max(points.shape[1] + 2, (len(points) + 1) // 2)]
    found = [_refined(align(points, others, by), others, tolerance) for by in (half, slice(None))]
    for base in _bases(points):
        groups = _groups(points[base], others, tolerance)
        centred, targets = points - points[base].mean(axis=0), others[groups]
        middles = targets.mean(axis=1, keepdims=True)
        U, _, Vt = np.linalg.svd(centred[base].T @ (targets - middles))
        mirror = np.append(
            np.ones(points.shape[1] - 1), -1.0
        )  # D points leave open on which side of them the others lie
        motions = np.concatenate([centred @ U @ Vt + middles, centred @ (U * mirror) @ Vt + middles])
        if len(motions):
            rough = np.minimum(tree.query(motions)[0], tolerance)
            best = np.argsort((rough**2).sum(axis=1), kind="stable")[:max_count]
            found += [_refined(motions[n], others, tolerance) for n in best]
        closest = min(found, key=lambda match: match.cost)
        if np.mean(np.linalg.norm(closest.placed - others[closest.order], axis=1) < tolerance) >= ENOUGH:
            break
    different = {tuple(match.order): match for match in sorted(found, key=lambda match: -match.cost)}
    return sorted(different.values(), key=lambda match: match.cost)


def assigned(placed: np.ndarray, others: np.ndarray, tolerance: float) -> np.ndarray:
    """Return at which of `others` each of `placed` lies, each at one : (N,) int64."""
    from scipy.optimize import linear_sum_assignment  # takes a tenth of a second to load

    distance = distances(placed, others)
    beyond = np.maximum(distance - tolerance, 0.0)  # beyond the tolerance nearer is better still, but counts little
    return linear_sum_assignment(np.minimum(distance, tolerance) ** 2 + 1e-3 * tolerance * beyond)[1]


MAX_ROUNDS = 20  # number of turns of a refinement at most


def _refined(placed: np.ndarray, others: np.ndarray, tolerance: float) -> Match:
    order = assigned(placed, others, tolerance)
    for _ in range(MAX_ROUNDS):
        distance = np.linalg.norm(placed - others[order], axis=1)
        close = np.flatnonzero(distance <= max(tolerance, float(np.median(distance))))
        placed = align(placed, others[order], close)
        before, order = order, assigned(placed, others, tolerance)
        if np.array_equal(before, order):
            break
    distance = np.linalg.norm(placed - others[order], axis=1)
    return Match(placed, order, float(np.mean(np.minimum(distance, tolerance) ** 2)))


MAX_BASES = 8  # number of bases at most


def _bases(points: np.ndarray) -> Iterator[np.ndarray]:
    """Yield disjoint groups of D points that are far from each other."""
    free = list(range(len(points)))
    for _ in range(MAX_BASES):
        if len(free) < points.shape[1]:
            return
        middle = points[free].mean(axis=0)
        base = [free[int(np.argmax(np.linalg.norm(points[free] - middle, axis=1)))]]
        while len(base) < points.shape[1]:
            apart = [np.linalg.norm(points[base] - points[n], axis=1).min() for n in free]
            base.append(free[int(np.argmax(apart))])
        free = [n for n in free if n not in base]
        yield np.array(base)


MAX_WORK = 64_000  # number of points that the motions of each base move, at most


def _groups(base: np.ndarray, others: np.ndarray, tolerance: float) -> np.ndarray:
    """Return the numbers of the groups of D points that have the distances of `base` : (K, D) int64, closest first."""
    distance = distances(others, others)
    groups, misfit = np.arange(len(others))[:, None], np.zeros(len(others))
    for n in range(1, len(base)):
        wanted = np.linalg.norm(base[:n] - base[n], axis=1)
        off = np.abs(distance[groups] - wanted[None, :, None])  # (K, n, N)
        group, last = np.nonzero(off.max(axis=1) < tolerance)
        misfit = misfit[group] + (off[group, :, last] ** 2).sum(axis=1)
        groups = np.column_stack([groups[group], last])
        max_count = MAX_WORK // len(others) * (1 if n == len(base) - 1 else 20)
        best = np.argsort(misfit, kind="stable")[:max_count]
        groups, misfit = groups[best], misfit[best]
    apart = [len(set(group)) == len(group) for group in groups.tolist()]
    return groups[apart]


TRUSTED = "good"  # the verdict with which finding no swap means that there is none


@dataclass(frozen=True, eq=False)
class PositionCheck:
    """Estimated positions compared with those of a list.

    Attributes
    ----------
    errors : (N,) float64
        Metres, distance from the position in the list, of its size, after the best rigid motion.
    order : (N,) int64
        Row of the list at whose position each microphone stands; its own unless it is in a cycle.
    distances : (N,) float64
        Metres, distance from that position.
    fits : bool
        Whether the list fits the array found, in this order. Without, nothing is said about swaps: it is the list of
        another array, or the positions, of the list or found, are far off.
    spacing : (N,) float64
        Metres, distance of each position of the list, of the size of the array, from the nearest other one.
    scale : float
        Size of the list over that of the array found; 1 unless they differ by more than a tenth, as in other units.
    symmetric : bool
        Whether the list fits as well turned or mirrored, so that such an exchange of most channels cannot be seen.
    moved : bool
        Whether the positions were moved as a whole although microphones were known: the list has other axes.
    """

    errors: np.ndarray
    order: np.ndarray
    distances: np.ndarray
    fits: bool
    spacing: np.ndarray
    scale: float = 1.0
    symmetric: bool = False
    moved: bool = False

    def __post_init__(self):
        for name, kind in (("errors", float), ("order", np.int64), ("distances", float), ("spacing", float)):
            object.__setattr__(self, name, frozen_array(getattr(self, name), kind))

    @property
    def swapped(self) -> tuple[tuple[int, ...], ...]:
        """Pairs of channels whose positions are exchanged."""
        return tuple(cycle for cycle in _cycles(self.order) if len(cycle) == 2)

    @property
    def permuted(self) -> tuple[tuple[int, ...], ...]:
        """Cycles of more than two channels that stand at each other's positions."""
        return tuple(cycle for cycle in _cycles(self.order) if len(cycle) > 2)

    @property
    def agrees(self) -> bool:
        """Whether the list fits, in its order and its size."""
        return self.fits and self.scale == 1 and np.array_equal(self.order, np.arange(len(self.order)))

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
        problem = f"the result has positions of shape {found.shape}, the measurement {given.shape}"
        raise InputError(problem, "use the result of this measurement", key="result")
    require_finite("found", found)
    require_finite("given", given)
    if len(found) <= found.shape[1]:
        return _checked(found if len(known) else align(found, given), given, np.arange(len(found)))
    free = _free(found, given)
    if not len(known):
        return free
    fixed = _checked(found, given, _kept_order(found, given))
    if (fixed.fits and free.scale == 1) or not free.fits:
        return replace(fixed, scale=free.scale)
    return replace(free, moved=True)


# factor by which list and array may differ in size; below it the size is not mentioned if the list fits unscaled
MAX_SCALE = 1.1


def size_ratio(found: np.ndarray, given: np.ndarray) -> float:
    """Return the size of `given` over that of `found`: no exchange changes the median distance between microphones."""
    apart = [distances(p, p)[np.triu_indices(len(p), 1)] for p in (found, given)]
    own, listed = map(float, np.median(apart, axis=1))
    return listed / own if min(own, listed) > 0 else 1.0


def _free(found: np.ndarray, given: np.ndarray) -> PositionCheck:
    """Return the comparison after the best motion as a whole, and in the size of the array found if that fits."""
    scale = size_ratio(found, given)
    check = _best(found, given)
    if check.fits and 1 / MAX_SCALE < scale < MAX_SCALE:
        return check
    scaled = _best(found, given / scale)
    if not scaled.fits:
        near = 1 / MAX_SCALE < scale < MAX_SCALE  # where nothing fits, nothing shows so small a factor
        return check if near else replace(check, scale=scale)
    close = scaled.distances <= 2 * np.median(scaled.distances)
    spreads = [np.linalg.norm(p - p.mean(axis=0)) for p in (given[scaled.order[close]] / scale, found[close])]
    scale *= float(spreads[0]) / float(spreads[1])
    return replace(_best(found, given / scale), scale=scale)


# fraction of the microphones that must be at their own places for the order to count as that of the list
KEPT = 0.5
# other orders fit as well up to this factor of the mean square, and this fraction of the spacing
ALIKE = 1.5
RESOLVED = 0.03


def _best(found: np.ndarray, given: np.ndarray) -> PositionCheck:
    """Return the comparison in the order of the list if it fits as well as any other one, or in the best."""
    ways, spacing, own = matches(found, given), 2 * tolerance_of(given), np.arange(len(given))
    limit = ALIKE * ways[0].cost + (RESOLVED * spacing) ** 2
    alike = [match for match in ways if match.cost <= limit]
    match = min(alike, key=lambda match: np.count_nonzero(match.order != own))
    check = _aligned(match, given)
    if not check.fits:
        return _aligned(max(ways, key=lambda match: np.count_nonzero(match.order == own)), given)
    # The orders of a turned array differ in most channels.
    return replace(check, symmetric=any(np.mean(other.order != match.order) > KEPT for other in alike))


def _aligned(match: Match, given: np.ndarray) -> PositionCheck:
    """Return the comparison of a match, moved by all its microphones where the list fits all of them."""
    order = _kept_order(match.placed, given)
    placed = align(match.placed, given[order])
    whole = np.linalg.norm(placed - given[order], axis=1).max() < tolerance_of(given)
    return _checked(placed if whole else match.placed, given, order)


CLOSE = 0.5  # median distance of a list in its own order, of the spacing of the microphones, at most
CLOSE_EXCHANGED = 0.25  # the same of a list in which most are exchanged; unrelated arrays of 16 reach 0.28, of 32 0.34
FREEDOM = 12  # number of microphones beyond D + 1 from which CLOSE_EXCHANGED holds; of fewer it is less in proportion


def _checked(placed: np.ndarray, given: np.ndarray, order: np.ndarray) -> PositionCheck:
    """Return the comparison of positions already placed, in an order; in that of the list where it does not fit."""
    own, spacing = np.arange(len(order)), nearest_neighbours(given)
    errors, away = (np.linalg.norm(placed - given[rows], axis=1) for rows in (own, order))
    # The more is exchanged, the more easily a list fits, and the closer it must be.
    many = min(1.0, max(0.0, (len(order) - given.shape[1] - 1) / FREEDOM))
    exchanged = min(1.0, float(np.mean(order != own)) / (1 - KEPT))
    limit = (1 - exchanged) * CLOSE + exchanged * CLOSE_EXCHANGED * many
    fits = bool(np.median(away) <= limit * np.median(spacing))
    return PositionCheck(errors, order if fits else own, away if fits else errors, fits, spacing)


SWAPPED = 0.5  # a swap must reduce the distance of a microphone to less than this fraction of what it was
IMPROVED = 0.75  # fraction of the microphones of a cycle for which it must


def _kept_order(placed: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Return at whose position each microphone stands : (N,) int64, its own unless most of a cycle is far nearer."""
    order, kept = assigned(placed, given, tolerance_of(given)), np.arange(len(given))
    before = np.linalg.norm(placed - given, axis=1)
    nearer = np.linalg.norm(placed - given[order], axis=1) < SWAPPED * before
    for cycle in map(list, _cycles(order)):
        if np.mean(nearer[cycle]) >= IMPROVED:
            kept[cycle] = order[cycle]
    return kept


def _cycles(order: np.ndarray) -> list[tuple[int, ...]]:
    """Return the cycles of a permutation that move something, each from its lowest number."""
    seen, cycles = set(), []
    for n in range(len(order)):
        cycle = []
        while n not in seen:
            seen.add(n)
            cycle.append(n)
            n = int(order[n])
        if len(cycle) > 1:
            cycles.append(tuple(cycle))
    return cycles


@dataclass(frozen=True)
class ListRules:
    """When a row of a list, or its size, is wrong.

    Figures are of twelve lists with 2 mm of error in each coordinate (`python -m benchmarks doctor`).
    """

    # relative, and sigmas of it: a size that is off. Without a thermometer the sound speed is known to 2 %. Of 16 right
    # lists of living and dead rooms, whose runs ended, the size seemed off by 3.0 % at most
    scale: float = 0.033
    scale_sigmas: float = 2.5
    # metres, sigmas and medians of the errors: a microphone beyond all of them is in another place than listed. They
    # are at most 29 mm; 2.7 sigmas of errors above 5 mm, where smaller ones are up to 13; 3.7 medians
    misplaced: float = 0.015
    misplaced_sigmas: float = 5.0
    misplaced_medians: float = 4.0
    # metres, and sigmas of the positions found: RMS error beyond which the list as a whole is wrong. It is at most 9.7
    # mm, and 1.8 sigmas where it is above 5 mm; a tape that errs by 5 mm in each coordinate brings 8.7 mm
    rms: float = 0.015
    rms_sigmas: float = 2.5
    repeated: float = 1e-6  # metres: two positions of a list that are closer are the same, and one of them is wrong


LIST_RULES = ListRules()


@dataclass(frozen=True, eq=False)
class ListFit:
    """A list that fits, laid onto the array by its healthy rows, in the size of the array.

    Attributes
    ----------
    errors : (N,) float64
        Metres, distance of each microphone from its place in the order that fits.
    kept : (N,) bool
        Rows by which the list was laid onto the array.
    scale : float
        Size of the list over that of the array.
    misplaced : tuple of int
        Microphones that are in another place than listed.
    sized : bool
        Whether list and array differ in size by more than they are uncertain.
    poor : bool
        Whether the rows that are kept are wrong by more than list and array may be.
    trusted : bool
        Whether the array found is to be trusted; if not, it may be the cause where the fit is `poor`.
    repeated : tuple of int
        Microphones that share their position in the list with another one.
    """

    errors: np.ndarray
    kept: np.ndarray
    scale: float
    misplaced: tuple[int, ...] = ()
    sized: bool = False
    poor: bool = False
    trusted: bool = True
    repeated: tuple[int, ...] = ()

    @property
    def rms(self) -> float:
        """RMS distance of the rows that are kept from their places, metres."""
        return float(np.sqrt(np.mean(self.errors[self.kept] ** 2)))

    @property
    def wrong(self) -> bool:
        """Whether anything but the order is wrong."""
        return bool(self.misplaced or self.repeated) or self.sized or (self.poor and self.trusted)


def fit_result(check: PositionCheck, result: "Calibration", given) -> ListFit:
    """Return how a list fits the array of a calibration row by row, as `fit_list` does, its dead channels left out."""
    dead = {fault.name for fault in (result.channels.faults if result.channels else ()) if fault.kind == "dead"}
    numbers = [n for n, name in enumerate(result.names) if name in dead]
    return fit_list(check, result.positions, given, result.uncertainty, result.verdict, numbers)


def fit_list(
    check: PositionCheck, found, given, sigma=None, verdict: str = TRUSTED, dead: Sequence[int] = ()
) -> ListFit:
    """Return how a list fits row by row, which `check` has found to fit as a whole.

    `found`, `given` (N, D), metres, as compared; `sigma` (N,), metres, of each position found; `dead`: channels that
    recorded nothing of the field, and so were found anywhere. Whatever the verdict, an array found and a list that
    agree in most rows are both right there, because nothing else makes them agree; the rows that differ are then
    wrong. Size and mean error are judged of a trusted array alone.
    """
    rules, own, placed = LIST_RULES, np.asarray(found, float), np.asarray(given, float)[check.order] / check.scale
    alive = ~np.isin(np.arange(len(own)), dead)
    errors, kept = np.zeros(len(own)), alive
    for _ in range(3):  # without those that are misplaced
        errors = np.linalg.norm(align(own, placed, kept) - placed, axis=1)
        kept = alive & (errors <= max(3 * float(np.median(errors[alive])), 1e-3))
    spread = [np.linalg.norm(x[kept] - x[kept].mean(axis=0)) for x in (placed, own)]
    ratio = float(spread[0] / spread[1])
    errors = np.linalg.norm(align(own * ratio, placed, kept) - placed, axis=1)
    sigma = np.zeros(len(own)) if sigma is None else np.asarray(sigma, float)
    limit = np.maximum(rules.misplaced, rules.misplaced_sigmas * sigma)
    limit = np.maximum(limit, rules.misplaced_medians * float(np.median(errors[alive])))
    fit = ListFit(errors, kept, check.scale * ratio, tuple(np.flatnonzero(alive & (errors > limit)).tolist()))
    own_sigma = float(np.sqrt(np.mean(sigma[kept] ** 2)))
    # errors of the array found may all point outwards, those of a list are independent
    unsure = float(np.hypot(own_sigma, fit.rms / np.sqrt(np.sum(kept)))) / (spread[1] / np.sqrt(np.sum(kept)))
    sized = abs(fit.scale - 1) > max(rules.scale, rules.scale_sigmas * unsure)
    poor, trusted = fit.rms > max(rules.rms, rules.rms_sigmas * own_sigma), verdict == TRUSTED
    misplaced = fit.misplaced if trusted or not poor else ()
    same = tuple(np.flatnonzero(nearest_neighbours(np.asarray(given, float)) < rules.repeated).tolist())
    return replace(fit, misplaced=misplaced, sized=bool(sized) and trusted, poor=poor, trusted=trusted, repeated=same)
