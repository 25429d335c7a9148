"""Two sets of points matched by their shape: which point of one is which of the other, in whatever place and order.

A base of D points far apart is laid onto every group of D points of the other set that has the same distances. Each
such group gives a rigid motion, and a mirror image of it. The motions under which most points lie close to one of the
other set are refined in turns: the best assignment for the motion, then the best motion for the assignment, which is
iterative closest point with the Hungarian method. Several disjoint bases are tried, so that a few wrong points do no
harm.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..model.gauge import align


@dataclass(frozen=True)
class MatchingLimits:
    """How many motions are tried, and how far apart points count as the same."""

    tolerance: float = 0.5  # of the median distance between nearest neighbours, dimensionless
    bases: int = 8  # number of bases at most
    work: int = 64_000  # number of points that the motions of each base move, at most
    refined: int = 40  # number of motions, of each base, that are refined, at most
    usual: int = 64  # number of points from which fewer motions are refined
    rounds: int = 20  # number of turns of a refinement at most
    enough: float = 0.9  # share of the points that must lie close to another for no further base to be tried


LIMITS = MatchingLimits()


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


def tolerance_of(points: np.ndarray) -> float:
    """Return how far from one of `points` (N, D) another one counts as the same."""
    return LIMITS.tolerance * float(np.median(nearest_neighbours(points)))


def matches(points: np.ndarray, others: np.ndarray) -> list[Match]:
    """Return the ways in which `points` lie closest to `others`, each with another order; both (N, D), metres.

    The closest comes first; those that leave the order as it is are among them.
    """
    from scipy.spatial import KDTree

    tolerance, tree = tolerance_of(others), KDTree(others)
    most = max(1, int(LIMITS.refined * min(1.0, (LIMITS.usual / len(points)) ** 2)))
    half = _same_order(points, others)
    found = [_refined(align(points, others, by), others, tolerance) for by in (half, slice(None))]
    for base in _bases(points):
        motions = _motions(points, others, base, tolerance)
        if len(motions):
            rough = np.minimum(tree.query(motions)[0], tolerance)
            best = np.argsort((rough**2).sum(axis=1), kind="stable")[:most]
            found += [_refined(motions[n], others, tolerance) for n in best]
        closest = min(found, key=lambda match: match.cost)
        if np.mean(np.linalg.norm(closest.placed - others[closest.order], axis=1) < tolerance) >= LIMITS.enough:
            break
    different = {tuple(match.order): match for match in sorted(found, key=lambda match: -match.cost)}
    return sorted(different.values(), key=lambda match: match.cost)


def assigned(placed: np.ndarray, others: np.ndarray, tolerance: float) -> np.ndarray:
    """Return at which of `others` each of `placed` lies, each at one : (N,) int64."""
    from scipy.optimize import linear_sum_assignment  # takes a tenth of a second to load

    distance = distances(placed, others)
    beyond = np.maximum(distance - tolerance, 0.0)  # beyond the tolerance nearer is better still, but counts little
    return linear_sum_assignment(np.minimum(distance, tolerance) ** 2 + 1e-3 * tolerance * beyond)[1]


def _same_order(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the half of the points whose distances to the rest agree best in the order as it is."""
    off = np.median(np.abs(distances(points, points) - distances(others, others)), axis=1)
    return np.argsort(off, kind="stable")[: max(points.shape[1] + 2, (len(points) + 1) // 2)]


def _refined(placed: np.ndarray, others: np.ndarray, tolerance: float) -> Match:
    order = assigned(placed, others, tolerance)
    for _ in range(LIMITS.rounds):
        distance = np.linalg.norm(placed - others[order], axis=1)
        close = np.flatnonzero(distance <= max(tolerance, float(np.median(distance))))
        placed = align(placed, others[order], close)
        before, order = order, assigned(placed, others, tolerance)
        if np.array_equal(before, order):
            break
    distance = np.linalg.norm(placed - others[order], axis=1)
    return Match(placed, order, float(np.mean(np.minimum(distance, tolerance) ** 2)))


def _bases(points: np.ndarray) -> Iterator[np.ndarray]:
    """Yield disjoint groups of D points that are far from each other."""
    free = list(range(len(points)))
    for _ in range(LIMITS.bases):
        if len(free) < points.shape[1]:
            return
        middle = points[free].mean(axis=0)
        base = [free[int(np.argmax(np.linalg.norm(points[free] - middle, axis=1)))]]
        while len(base) < points.shape[1]:
            apart = [np.linalg.norm(points[base] - points[n], axis=1).min() for n in free]
            base.append(free[int(np.argmax(apart))])
        free = [n for n in free if n not in base]
        yield np.array(base)


def _motions(points: np.ndarray, others: np.ndarray, base: np.ndarray, tolerance: float) -> np.ndarray:
    """Return the points laid onto every group of `others` with the distances of the base : (K, N, D) float64."""
    groups = _groups(points[base], others, tolerance)
    centred, goals = points - points[base].mean(axis=0), others[groups]
    middles = goals.mean(axis=1, keepdims=True)
    U, _, Vt = np.linalg.svd(centred[base].T @ (goals - middles))
    mirror = np.append(np.ones(points.shape[1] - 1), -1.0)  # D points leave open on which side of them the others lie
    return np.concatenate([centred @ U @ Vt + middles, centred @ (U * mirror) @ Vt + middles])


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
        most = LIMITS.work // len(others) * (1 if n == len(base) - 1 else 20)
        best = np.argsort(misfit, kind="stable")[:most]
        groups, misfit = groups[best], misfit[best]
    apart = [len(set(group)) == len(group) for group in groups.tolist()]
    return groups[apart]
