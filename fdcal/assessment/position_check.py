"""Comparison of estimated positions with a list: swapped channels, another order or size, another array.

The first part matches two sets of points by their shape, whatever their position and order. A base of D points far
apart is aligned with every group of D points of the other set that has the same distances. Each group gives a rigid
motion and its mirror image. The motions that bring most points close to points of the other set are refined by the
iterative closest point method: the best assignment for the motion, then the best motion for the assignment, in turns.
Several disjoint bases are tried, so that a few wrong points do no harm.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..model.gauge import align
from ..model.validation import InputError, frozen_array, require_array
from .calibration import Calibration


@dataclass(frozen=True, eq=False)
class Match:
    """One alignment of points with others."""

    placed: np.ndarray  # (N, D) float64, metres, the points after the rigid motion
    order: np.ndarray  # (N,) int64, index of the other point that is assigned to each
    cost: float  # metres^2, mean square of the distances, each of which is limited to the tolerance


def distances(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the distance of each of `points` (N, D) from each of `others` (P, D) : (N, P) float64."""
    return np.linalg.norm(points[:, None] - others[None], axis=2)


def nearest_neighbours(points: np.ndarray) -> np.ndarray:
    """Return the distance of each of `points` (N, D) from the nearest other one : (N,) float64."""
    return (distances(points, points) + np.diag(np.full(len(points), np.inf))).min(axis=1)


TOLERANCE = 0.5  # distance within which two points count as the same, in median distances of nearest neighbours


def tolerance_of(points: np.ndarray) -> float:
    """Return the distance from one of `points` (N, D), metres, within which another point counts as the same."""
    return TOLERANCE * float(np.median(nearest_neighbours(points)))


MAX_REFINED = 40  # largest number of motions of each base that are refined
USUAL_COUNT = 64  # with more points than this, fewer motions are refined
ENOUGH = 0.9  # no further base is tried once this fraction of the points lies close to another point


def matches(points: np.ndarray, others: np.ndarray) -> list[Match]:
    """Return the best alignments of `points` (N, D) with `others`, all of different order, the closest first."""
    from scipy.spatial import KDTree

    tolerance, tree = tolerance_of(others), KDTree(others)
    max_count = max(1, int(MAX_REFINED * min(1.0, (USUAL_COUNT / len(points)) ** 2)))
    off = np.median(np.abs(distances(points, points) - distances(others, others)), axis=1)
    half = np.argsort(off, kind="stable")[: max(points.shape[1] + 2, (len(points) + 1) // 2)]
    found = [_refined(align(points, others, by), others, tolerance) for by in (half, slice(None))]
    for base in _bases(points):
        centred, targets = points - points[base].mean(axis=0), others[_groups(points[base], others, tolerance)]
        middles = targets.mean(axis=1, keepdims=True)
        U, _, Vt = np.linalg.svd(centred[base].T @ (targets - middles))
        mirror = np.append(np.ones(points.shape[1] - 1), -1.0)  # D points fit an array and its mirror image equally
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
    """Return the one-to-one assignment of `placed` to `others`, as indices of the latter : (N,) int64."""
    from scipy.optimize import linear_sum_assignment  # imported here: it loads in 0.1 s

    distance = distances(placed, others)
    beyond = np.maximum(distance - tolerance, 0.0)  # its small weight makes closer points preferable
    return linear_sum_assignment(np.minimum(distance, tolerance) ** 2 + 1e-3 * tolerance * beyond)[1]


MAX_ROUNDS = 20  # largest number of iterations of a refinement


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


MAX_BASES = 8  # largest number of bases


def _bases(points: np.ndarray) -> Iterator[np.ndarray]:
    """Yield disjoint groups of D points that are far from each other."""
    free = list(range(len(points)))
    for _ in range(min(MAX_BASES, len(points) // points.shape[1])):
        base = [free[int(np.argmax(np.linalg.norm(points[free] - points[free].mean(axis=0), axis=1)))]]
        while len(base) < points.shape[1]:
            apart = [np.linalg.norm(points[base] - points[n], axis=1).min() for n in free]
            base.append(free[int(np.argmax(apart))])
        free = [n for n in free if n not in base]
        yield np.array(base)


MAX_WORK = 64_000  # largest number of points that all motions of one base move together


def _groups(base: np.ndarray, others: np.ndarray, tolerance: float) -> np.ndarray:
    """Return the indices (K, D) int64 of groups of D points with the distances of `base`, the closest group first."""
    distance = distances(others, others)
    groups, misfit = np.arange(len(others))[:, None], np.zeros(len(others))
    for n in range(1, len(base)):
        off = np.abs(distance[groups] - np.linalg.norm(base[:n] - base[n], axis=1)[None, :, None])  # (K, n, N)
        group, last = np.nonzero(off.max(axis=1) < tolerance)
        misfit = misfit[group] + (off[group, :, last] ** 2).sum(axis=1)
        groups = np.column_stack([groups[group], last])
        best = np.argsort(misfit, kind="stable")[: MAX_WORK // len(others) * (1 if n == len(base) - 1 else 20)]
        groups, misfit = groups[best], misfit[best]
    return groups[[len(set(group)) == len(group) for group in groups.tolist()]]


TRUSTED = "good"  # the verdict of a result that can be trusted


@dataclass(frozen=True, eq=False)
class PositionCheck:
    """Estimated positions compared with those of a list.

    Attributes
    ----------
    errors : (N,) float64
        Metres, distance of each microphone from its position in the list, after the best rigid motion.
    order : (N,) int64
        Row of the list at whose position each microphone stands; its own row unless channels are swapped.
    distances : (N,) float64
        Metres, distance of each microphone from the position of that row.
    fits : bool
        Whether the list fits the array found in this order. If not, swaps cannot be detected: the list is of another
        array, or the positions of either are far off.
    spacing : (N,) float64
        Metres, distance of each position of the list from the nearest other one.
    scale : float
        Ratio of the size of the list to that of the array found. It is 1 if only the unscaled list fits; with a ratio
        within a tenth of 1, also if both sizes fit, or neither. If `fits`, the lengths above belong to the list divided
        by this scale.
    symmetric : bool
        Whether the list also fits after a rotation or reflection of the array, because this is symmetric. A swap of
        most channels that equals such a motion cannot be detected.
    moved : bool
        Whether the positions were moved as a whole although microphones were known, because the list has other axes.
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
        """Pairs of channels whose positions are swapped."""
        return tuple(cycle for cycle in _cycles(self.order) if len(cycle) == 2)

    @property
    def permuted(self) -> tuple[tuple[int, ...], ...]:
        """Cycles of more than two channels that stand at each other's positions."""
        return tuple(cycle for cycle in _cycles(self.order) if len(cycle) > 2)

    @property
    def agrees(self) -> bool:
        """Whether the list fits in its own order and size."""
        return self.fits and self.scale == 1 and np.array_equal(self.order, np.arange(len(self.order)))

    def table(self, names: Sequence[str]) -> dict:
        """Return the comparison as it stands in a result file.

        Parameters
        ----------
        names : sequence of N str
            Names of the microphones.

        Returns
        -------
        dict
            Values of JSON types by key; lengths in metres.
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

    The two are matched by their shape, whatever their order, position and size; the order of the list is kept if it
    fits as well as any other. A swap is reported if the array as a whole fits better with it, and if the distance of
    each exchanged microphone falls to less than half. In a cycle of four or more, three quarters of them suffice.

    Parameters
    ----------
    found, given : (N, D) array_like
        Metres.
    known : sequence of int
        Numbers of known microphones. If there are none, the positions are first moved as a whole onto the list. This is
        also done if there are some, but the list does not fit without such a motion.

    Returns
    -------
    PositionCheck

    Raises
    ------
    InputError
        The two have different shapes or are no tables of numbers, or a value is not finite.

    Examples
    --------
    >>> import fdcal
    >>> given = [[0.0, 0.0], [1.0, 0.0], [0.0, 2.0], [1.5, 2.5], [3.0, 0.7]]
    >>> fdcal.compare_positions([given[n] for n in (0, 1, 3, 2, 4)], given, known=[0, 1, 4]).swapped
    ((2, 3),)
    """
    found, given = (require_array(*one, "real", (None, None), "m") for one in (("found", found), ("given", given)))
    if found.shape != given.shape or not found.size:
        problem = f"the result has positions of shape {found.shape}, the measurement {given.shape}"
        remedy = "use the result of this measurement" if found.size else "give a row of coordinates per microphone"
        raise InputError(problem, remedy, key="result")
    if len(found) <= found.shape[1]:
        return _checked(found if len(known) else align(found, given), given, np.arange(len(found)))
    free = _free(found, given)
    if not len(known):
        return free
    fixed = _checked(found, given, _kept_order(found, given))
    if (fixed.fits and free.scale == 1) or not free.fits:
        return fixed if fixed.fits else replace(fixed, scale=free.scale)
    return replace(free, moved=True)


MAX_SCALE = 1.1  # up to this ratio of the sizes of list and array the list is not scaled if it fits unscaled


def size_ratio(found: np.ndarray, given: np.ndarray) -> float:
    """Return the median distance between microphones of `given`, divided by that of `found`, whatever their order."""
    apart = [distances(p, p)[np.triu_indices(len(p), 1)] for p in (found, given)]
    own, listed = map(float, np.median(apart, axis=1))
    return listed / own if min(own, listed) > 0 else 1.0


def _free(found: np.ndarray, given: np.ndarray) -> PositionCheck:
    """Return the comparison after the best rigid motion, with the list scaled to the size of the array if that fits."""
    scale = size_ratio(found, given)
    check = _best(found, given)
    if check.fits and 1 / MAX_SCALE < scale < MAX_SCALE:
        return check
    scaled = _best(found, given / scale)
    if not scaled.fits:
        near = 1 / MAX_SCALE < scale < MAX_SCALE  # if the list does not fit, a ratio near 1 is a coincidence
        return check if near or check.fits else replace(check, scale=scale)  # wrong rows can distort the ratio
    close = scaled.distances <= 2 * np.median(scaled.distances)
    radii = [np.linalg.norm(p - p.mean(axis=0)) for p in (given[scaled.order[close]] / scale, found[close])]
    scale *= float(radii[0]) / float(radii[1])
    return replace(_best(found, given / scale), scale=scale)


KEPT = 0.5  # largest fraction of exchanged microphones with which the order still counts as that of the list
# Another order fits as well if its mean square is below ALIKE times the best one plus (RESOLVED times the spacing)^2.
ALIKE = 1.5
RESOLVED = 0.03


def _best(found: np.ndarray, given: np.ndarray) -> PositionCheck:
    """Return the comparison in the order of the list if that fits as well as any other, otherwise in the best order."""
    candidates, spacing, own = matches(found, given), 2 * tolerance_of(given), np.arange(len(given))
    limit = ALIKE * candidates[0].cost + (RESOLVED * spacing) ** 2
    alike = [match for match in candidates if match.cost <= limit]
    match = min(alike, key=lambda match: np.count_nonzero(match.order != own))
    check = _aligned(match, given)
    if not check.fits:
        return _aligned(max(candidates, key=lambda match: np.count_nonzero(match.order == own)), given)
    # The order of a rotated array differs in most channels.
    return replace(check, symmetric=any(np.mean(other.order != match.order) > KEPT for other in alike))


def _aligned(match: Match, given: np.ndarray) -> PositionCheck:
    """Return the comparison of a match, aligned by all microphones if the list fits all of them."""
    order = _kept_order(match.placed, given)
    placed = align(match.placed, given[order])
    whole = np.linalg.norm(placed - given[order], axis=1).max() < tolerance_of(given)
    return _checked(placed if whole else match.placed, given, order)


# Largest median distance, in spacings of the microphones, of a list that fits in its own order, and of one in which
# most rows are exchanged; for unrelated arrays it is as low as 0.28 with 16 microphones and 0.34 with 32.
CLOSE = 0.5
CLOSE_EXCHANGED = 0.25
FREEDOM = 12  # number of microphones beyond D + 1 from which CLOSE_EXCHANGED applies; with fewer the limit is lower


def _checked(placed: np.ndarray, given: np.ndarray, order: np.ndarray) -> PositionCheck:
    """Return the comparison of aligned positions in `order`, or in the order of the list if that does not fit."""
    own, spacing = np.arange(len(order)), nearest_neighbours(given)
    errors, away = (np.linalg.norm(placed - given[rows], axis=1) for rows in (own, order))
    # The more rows are exchanged, the more easily a list fits by chance, and the lower the limit must be.
    many = min(1.0, max(0.0, (len(order) - given.shape[1] - 1) / FREEDOM))
    exchanged = min(1.0, float(np.mean(order != own)) / (1 - KEPT))
    limit = (1 - exchanged) * CLOSE + exchanged * CLOSE_EXCHANGED * many
    fits = bool(np.median(away) <= limit * np.median(spacing))
    return PositionCheck(errors, order if fits else own, away if fits else errors, fits, spacing)


SWAPPED = 0.5  # a swap must reduce the distance of a microphone to less than this fraction
IMPROVED = 0.75  # smallest fraction of the microphones of a cycle whose distances must be reduced that much


def _kept_order(placed: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Return the row of the list at whose position each microphone stands : (N,) int64.

    It differs from the microphone's own row only where an exchange improves the fit.
    """
    order, kept = assigned(placed, given, tolerance_of(given)), np.arange(len(given))
    nearer = np.linalg.norm(placed - given[order], axis=1) < SWAPPED * np.linalg.norm(placed - given, axis=1)
    for cycle in map(list, _cycles(order)):
        if np.mean(nearer[cycle]) >= IMPROVED:
            kept[cycle] = order[cycle]
    return kept


def _cycles(order: np.ndarray) -> list[tuple[int, ...]]:
    """Return the cycles of a permutation with more than one element, each from its lowest number."""
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
    """Limits beyond which a row of a list, or its size, counts as wrong.

    Figures are from twelve correct lists with 2 mm of error in each coordinate (`python -m benchmarks doctor`).
    """

    # relative difference of the sizes, and the same in sigmas; both must be exceeded. Without a thermometer the sound
    # speed is known to 2 %; correct lists differ by 3.0 % at most
    scale: float = 0.033
    scale_sigmas: float = 2.5
    # error of a row in metres, in sigmas of the position found, and in medians over the rows; all must be exceeded.
    # Rows of correct lists reach 29 mm, 2.7 sigmas (for errors above 5 mm), and 3.7 medians
    misplaced: float = 0.015
    misplaced_sigmas: float = 5.0
    misplaced_medians: float = 4.0
    # RMS error of the list in metres, and in sigmas of the positions found; both must be exceeded. Correct lists reach
    # 9.7 mm, and 1.8 sigmas (for errors above 5 mm); a tape with 5 mm of error in each coordinate gives 8.7 mm
    rms: float = 0.015
    rms_sigmas: float = 2.5
    repeated: float = 1e-6  # metres; two positions of a list that are closer count as the same


LIST_RULES = ListRules()


@dataclass(frozen=True, eq=False)
class ListFit:
    """A list that fits, compared with the array scaled to it and aligned by the rows that are not outliers.

    Attributes
    ----------
    errors : (N,) float64
        Metres, distance of each microphone from its position in the order that fits.
    kept : (N,) bool
        Rows by which the list was aligned.
    scale : float
        Ratio of the size of the list to that of the array.
    misplaced : tuple of int
        Microphones that are not at their listed positions.
    sized : bool
        Whether the sizes of list and array differ significantly.
    poor : bool
        Whether the errors of the kept rows are larger than expected.
    trusted : bool
        Whether the array found can be trusted; if not, the array rather than the list may cause a `poor` fit.
    repeated : tuple of int
        Microphones to which the list gives the same position as to another one.
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
        """RMS error of the rows that are kept, metres."""
        return float(np.sqrt(np.mean(self.errors[self.kept] ** 2)))

    @property
    def wrong(self) -> bool:
        """Whether anything but the order is wrong."""
        return bool(self.misplaced or self.repeated) or self.sized or (self.poor and self.trusted)


def fit_result(check: PositionCheck, result: Calibration, given) -> ListFit:
    """Return the result of `fit_list` for the array of a calibration, without its dead channels."""
    dead = {fault.name for fault in (result.channels.faults if result.channels else ()) if fault.kind == "dead"}
    numbers = [n for n, name in enumerate(result.names) if name in dead]
    return fit_list(check, result.positions, given, result.uncertainty, result.verdict, numbers)


def fit_list(
    check: PositionCheck, found, given, sigma=None, verdict: str = TRUSTED, dead: Sequence[int] = ()
) -> ListFit:
    """Return how each row of a list fits, after `check` has found that the list fits as a whole.

    `found`, `given` (N, D), metres, are the positions that `check` compared; `sigma` (N,), metres, is one sigma of each
    position found; `dead` are channels without signal, whose positions mean nothing. If array and list agree in most
    rows, these rows are right whatever the verdict is, and the other rows of the list are wrong. Size and RMS error are
    only judged if the array is trusted.
    """
    rules, found, listed = LIST_RULES, np.asarray(found, float), np.asarray(given, float)[check.order] / check.scale
    alive = ~np.isin(np.arange(len(found)), dead)
    errors, kept = check.distances, alive
    for _ in range(4):  # each time without the outliers found before
        kept = alive & (errors <= max(3 * float(np.median(errors[alive])), 1e-3))
        errors = np.linalg.norm(align(found, listed, kept) - listed, axis=1)
    radii = [np.linalg.norm(x[kept] - x[kept].mean(axis=0)) for x in (listed, found)]
    ratio = float(radii[0] / radii[1])
    errors = np.linalg.norm(align(found * ratio, listed, kept) - listed, axis=1)
    sigma = np.zeros(len(found)) if sigma is None else np.asarray(sigma, float)
    limit = np.maximum(rules.misplaced, rules.misplaced_sigmas * sigma)
    limit = np.maximum(limit, rules.misplaced_medians * float(np.median(errors[alive])))
    fit = ListFit(errors, kept, check.scale * ratio, tuple(np.flatnonzero(alive & (errors > limit)).tolist()))
    found_sigma = float(np.sqrt(np.mean(sigma[kept] ** 2)))
    # The errors of the array found may all point outwards and then do not average out. Those of a list do.
    scale_sigma = float(np.hypot(found_sigma, fit.rms / np.sqrt(np.sum(kept)))) / (radii[1] / np.sqrt(np.sum(kept)))
    sized = abs(fit.scale - 1) > max(rules.scale, rules.scale_sigmas * scale_sigma)
    poor, trusted = fit.rms > max(rules.rms, rules.rms_sigmas * found_sigma), verdict == TRUSTED
    misplaced = fit.misplaced if trusted or not poor else ()
    same = tuple(np.flatnonzero(nearest_neighbours(np.asarray(given, float)) < rules.repeated).tolist())
    return replace(fit, misplaced=misplaced, sized=bool(sized) and trusted, poor=poor, trusted=trusted, repeated=same)
