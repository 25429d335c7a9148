"""Which given positions are right: hypotheses, each with its evidence against the array that none of them holds.

    b = x + G t + d + e,   d ~ N(0, P),   e ~ N(0, s^2 I)

b are the positions given of the microphones that a hypothesis holds to be right, x those of the free array and P their
covariance, t a rigid motion (and with a wrong sound speed a change of size), s one sigma of a given coordinate. With
S = P + s^2 I and r = b - x, and t marginalised over,

    -log evidence = [r^T S^-1 r - g^T W^-1 g + log det S + log det W + (n - c) log 2 pi] / 2 - log priors
    W = G^T S^-1 G,   g = G^T S^-1 r,   n coordinates, c columns of G

A position that is wrong lies anywhere, its distance from the right one spread evenly over the orders of magnitude. s
has a log-normal prior, and is maximised over.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ...model.gauge import align, rigid_motions
from .free_array import FreeArray
from .given_rules import GIVEN


@dataclass(frozen=True)
class Hypothesis:
    """What may be right of the given positions.

    Attributes
    ----------
    log_evidence : float
    right : (A,) bool, which given positions hold the array
    order : (A,) int64, the positions given in the order in which they belong to the microphones
    scale : whether the sound speed is wrong
    sigma : float, metres, of every given coordinate
    positions : (N, D) float64, metres, the array in the frame of the given positions
    """

    log_evidence: float
    right: np.ndarray
    order: np.ndarray
    scale: bool
    sigma: float
    positions: np.ndarray


def hypotheses(found: FreeArray, known, places, stated: float | None, sized: bool) -> list[Hypothesis]:
    """Return the hypotheses, the likeliest first.

    Parameters
    ----------
    found : FreeArray
    known : (A,) int64
    places : (A, D) float64, metres
    stated : float or None
        Metres, sigma of a given coordinate that the user states.
    sized : bool
        Whether the sound speed may be wrong.
    """
    A, D = places.shape
    as_given, all_right = np.arange(A), np.ones(A, bool)
    likely = [
        _weighed(found, known, places, right, as_given, False, stated) for right in _subsets(found, known, places)
    ]
    likely += [
        _weighed(found, known, places, all_right, order, False, stated) for order in _exchanges(found, known, places)
    ]
    if sized and A * D > D * (D + 1) // 2 + 1:
        likely.append(_weighed(found, known, places, all_right, as_given, True, stated))
    return sorted(likely, key=lambda one: -one.log_evidence)


def _subsets(found: FreeArray, known, places) -> list[np.ndarray]:
    """Which given positions may be right: any of few; of many, those that fit best and ever fewer of them."""
    A, D = places.shape
    if A <= GIVEN.examined:
        wrong = [one for count in range(A - D + 1) for one in combinations(range(A), count)]
        return [~np.isin(np.arange(A), one) for one in wrong]
    worst = np.argsort(-_away(found, known, places))
    return [~np.isin(np.arange(A), worst[:count]) for count in range(min(A - D, GIVEN.most_wrong) + 1)]


def _exchanges(found: FreeArray, known, places) -> list[np.ndarray]:
    """Orders with two positions exchanged; of many, of those that fit least."""
    A, orders = len(known), []
    if A <= places.shape[1]:
        return orders
    suspects = np.sort(np.argsort(-_away(found, known, places))[: GIVEN.examined]) if A > GIVEN.examined else range(A)
    for i, j in combinations(suspects, 2):
        order = np.arange(A)
        order[[i, j]] = j, i
        orders.append(order)
    return orders


def _away(found: FreeArray, known, places) -> np.ndarray:
    """Distance (A,) of the given positions from an array that lies on the subset of least median error."""
    x, D = found.unknowns.positions[known], places.shape[1]
    best = np.full(len(known), np.inf)
    for chosen in list(combinations(range(len(known)), D + 1))[: GIVEN.tried]:
        away = np.linalg.norm(align(x, places, np.array(chosen)) - places, axis=1)
        best = away if np.median(away) < np.median(best) else best
    return best


def _weighed(found: FreeArray, known, places, right, order, scale: bool, stated: float | None) -> Hypothesis:
    """One hypothesis, with the likelier one of the two mirror images."""
    x, D = found.unknowns.positions, places.shape[1]
    ordered, held = places[order], known[right]
    index = (held[:, None] * D + np.arange(D)).ravel()
    values, vectors = np.linalg.eigh(found.covariance[np.ix_(index, index)])
    columns = rigid_motions(x)
    if scale:
        columns = np.column_stack([columns, (x - x.mean(axis=0)).ravel()])
    images = [
        _placed(found, known, ordered, right, columns, index, (np.maximum(values, 0.0), vectors), mirror, stated)
        for mirror in (False, True)
    ]
    evidence, sigma, positions = max(images, key=lambda one: one[0])
    return Hypothesis(evidence + _log_prior(right, order, scale), right, order, scale, sigma, positions)


def _log_prior(right, order, scale: bool) -> float:
    """Logarithm of the probability that these given positions are wrong or exchanged, or the sound speed."""
    A, wrong = len(right), np.sum(~right)
    prior = wrong * np.log(GIVEN.wrong) + (A - wrong) * np.log1p(-GIVEN.wrong)
    if np.any(order != np.arange(A)):
        prior += np.log(GIVEN.wrong / (A * (A - 1) / 2))
    return float(prior + (np.log(GIVEN.wrong / GIVEN.sizes) if scale else 0.0))


def _placed(found: FreeArray, known, places, right, columns, index, spectrum, mirror: bool, stated: float | None):
    """Log evidence, sigma and positions of one image of the array."""
    x = found.unknowns.positions
    turn, centre, goal = _turn(x[known[right]], places[right], mirror)
    b = (places - goal) @ turn.T + centre  # the given positions in the frame of the free array
    values, vectors = spectrum
    r, G = vectors.T @ (b[right] - x[known[right]]).ravel(), vectors.T @ columns[index]
    sigmas, log_prior = sigma_grid(stated)
    inverse = 1 / (values + sigmas[:, None] ** 2)
    W = np.einsum("sn,na,nb->sab", inverse, G, G)
    g = np.einsum("sn,na,n->sa", inverse, G, r)
    t = np.linalg.solve(W, g[..., None])[..., 0]
    chi = inverse @ r**2 - np.sum(g * t, axis=1)
    logs = log_prior - (chi - np.log(inverse).sum(axis=1) + np.linalg.slogdet(W)[1]) / 2
    best = int(np.argmax(logs))
    pull = vectors @ (inverse[best] * (r - G @ t[best]))
    moved = x + (columns @ t[best] + found.covariance[:, index] @ pull).reshape(x.shape)
    evidence = logs[best] - (r.size - columns.shape[1]) / 2 * np.log(2 * np.pi)
    evidence += _of_wrong(b[~right] - moved[known[~right]], sigmas[best])
    return float(evidence), float(sigmas[best]), (moved - centre) @ turn + goal


def _of_wrong(away, sigma: float) -> float:
    """Log density of wrong positions at `away` (W, D), metres, from where they should be."""
    D = away.shape[1]
    distance = np.sqrt(np.sum(away**2, axis=1) + sigma**2)
    sphere = 2 * np.pi if D == 2 else 4 * np.pi
    return float(-np.sum(D * np.log(distance) + np.log(sphere * np.log(GIVEN.decades))))


def _turn(x, places, mirror: bool):
    """The motion y = (x - centre) turn + goal of least squares; `mirror` takes the other image."""
    centre, goal = x.mean(axis=0), places.mean(axis=0)
    U, _, Vt = np.linalg.svd((x - centre).T @ (places - goal))
    if mirror:
        U = U * np.append(np.ones(U.shape[1] - 1), -1.0)
    return U @ Vt, centre, goal


def sigma_grid(stated: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Return sigmas of a given coordinate, metres, and the logarithm of their prior probabilities."""
    middle = GIVEN.sigma if stated is None else stated
    most = GIVEN.most_sigma if stated is None else stated
    sigmas = np.append(np.geomspace(middle / 4, middle, 4), np.geomspace(middle, most, 8)[1:] if most > middle else [])
    logs = -((np.log(sigmas / middle) / GIVEN.sigma_spread) ** 2) / 2
    return sigmas, logs
