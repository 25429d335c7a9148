"""Arrival times of the direct sound as a term of the cost; the position of each take's source is unknown.

    r_tn = c tau_tn - b_t - g(x_n - x_0, u_t, q_t)
    g    = |x_n - y_t| - |x_0 - y_t| = (q z^2 - 2 u . z) / (1 + s),   s = sqrt(1 - 2 q u . z + q^2 z^2)

r_tn is the residual of the arrival time tau_tn at microphone n in take t, multiplied by c. y_t is the position of the
source, u_t the direction to it from the middle x_0 of the array, z = x_n - x_0, and q_t the inverse of the distance of
the source from x_0. A plane wave has q = 0, where no formula is singular. The derivatives follow from
g (2 + q g) = q z^2 - 2 u . z:

    dg / du = -z / s,    dg / dq = (z^2 - g^2) / (2 s),    dg / dz = (q z - u) / s

The residuals have a Student t distribution of NU degrees of freedom, since a time may be that of a reflection. u_t, q_t
and the path b_t (c times the time of emission) are profiled out for each take: at their optimum the gradient with
respect to the positions equals that at fixed u, q and b, and the Gauss-Newton matrix is the Schur complement (Golub and
Pereyra, "The Differentiation of Pseudo-Inverses and Nonlinear Least Squares Problems Whose Variables Separate", SIAM J.
Numer. Anal. 10(2), 1973).

The delay d_n of a channel is subtracted from c tau_tn. One take cannot distinguish it from the microphone's position.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ...model.problem import Problem
from ...model.validation import Bools, Integers, Reals, frozen_array

NU = 3.0  # degrees of freedom of a residual


@dataclass(frozen=True)
class TakeSources:
    """The source of each take."""

    direction: np.ndarray  # (T, dimension) float64, u, unit vectors
    inverse: np.ndarray  # (T,) float64, q, 1/m
    emission: np.ndarray  # (T,) float64, b, metres


@dataclass(frozen=True)
class ArrivalTerms:
    """The term of the arrivals at some positions."""

    cost: float  # nats
    # (T, F) float64, derivatives of each take's cost with respect to the N D coordinates, the N delays if they are
    # unknown, and the logarithm of the sound speed
    gradient: np.ndarray
    matrix: Reals  # (F, F) float64, Gauss-Newton matrix of all takes
    # residual, weight: (T, N) float64, metres and 1/m^2; 0 where there is no arrival
    residual: Reals
    weight: Reals
    # (T, N, F) float64, derivatives of the weighted residuals, with the sources profiled out; `matrix` is the sum over
    # the takes of slopes^T slopes
    slopes: Reals
    count: Reals  # (T,) float64, number of arrivals minus the number of unknowns of the source
    source: TakeSources  # the likeliest source of each take


MAX_STEPS = 40  # largest number of Levenberg-Marquardt steps in the fit of the sources
MIN_DECREASE = 1e-9  # nats; the fit ends when the next step predicts a smaller decrease of the cost
# damping, dimensionless, of the first step, and the smallest damping
DAMPING = 1e-3
MIN_DAMPING = 1e-9
NEAREST = 0.1  # metres, least distance of a source from the middle of the array
# smallest ratio of curvature to weight of a residual that the fit uses; the exact ratio of an outlier is negative
MIN_CURVATURE = 0.1
STARTS = (0.0, 0.6)  # first values of q in the fit, times the radius of the array


@dataclass(frozen=True)
class Arrivals:
    """Arrivals of the takes that have enough of them."""

    paths: Reals  # (T, N) float64, metres, c times the arrival times minus the median of the take; 0 without arrival
    used: Bools  # (T, N) bool, whether there is an arrival
    # sigma, stated: (T,) float64, metres, one sigma of an arrival, as assumed and as the measurement states
    sigma: Reals
    stated: Reals
    dimension: int  # dimension of the space of the sources
    # where the fit of the sources begins, as found for similar positions; None for a search, which is far slower
    start: TakeSources | None = None

    def terms(
        self, positions: Reals, log_speed: float = 0.0, derivatives: bool = True, delays: Reals | None = None
    ) -> ArrivalTerms:
        """Return the term at positions (N, D) and delays (N,), metres, with derivatives if wanted.

        log_speed : logarithm of the ratio of the sound speed to that of the measurement
        """
        (N, D), T = positions.shape, len(self.paths)
        z = np.pad(positions - positions.mean(axis=0), ((0, 0), (0, self.dimension - D)))
        arrived = self.paths * np.exp(log_speed)
        paths = arrived if delays is None else arrived - delays
        source = self._sources(paths, z) if self.start is None else self._fitted(paths, z, self.start)[0]
        r, g, s = self._residuals(paths, z, source)
        count = np.sum(self.used, axis=1) - (self.dimension + 1.0)
        cost = float(np.sum(self._costs(r)) + np.sum(count * np.log(self.sigma / self.stated)))
        w = self.used * ((NU + 1) / (NU * self.sigma[:, None] ** 2 + r**2))
        if not derivatives:
            empty = np.zeros((0, 0))
            return ArrivalTerms(cost, empty, empty, r, w, np.zeros((0, 0, 0)), count, source)
        along = (source.direction[:, None] - source.inverse[:, None, None] * z) / s[..., None]  # dr / dx
        root = np.sqrt(w)
        slopes = np.zeros((T, N, N * D + (0 if delays is None else N) + 1))
        each = np.arange(N)[:, None]
        slopes[:, each, each * D + np.arange(D)] = along[..., :D]
        if delays is not None:
            slopes[:, each[:, 0], N * D + each[:, 0]] = -1.0
        slopes[..., -1] = np.where(self.used, arrived, 0.0)
        slopes *= root[..., None]
        gradient = np.einsum("tn,tnf->tf", root * r, slopes)
        J = self._jacobian(z, source, g, s) * root[..., None]  # the weight is 0 without an arrival
        J[..., -2] *= ~self._at_bound(J[..., -2], root * r, source.inverse)[:, None]
        U, values, _ = np.linalg.svd(
            J / np.maximum(np.linalg.norm(J, axis=1, keepdims=True), 1e-300), full_matrices=False
        )
        Q = U * (values > 1e-7)[:, None]  # orthonormal bases of the column spaces; columns beyond the rank are 0
        slopes = slopes - Q @ (np.swapaxes(Q, 1, 2) @ slopes)
        flat = slopes.reshape(T * N, -1)
        return ArrivalTerms(cost, gradient, flat.T @ flat, r, w, slopes, count, source)

    def scatter(self, positions: np.ndarray) -> np.ndarray:
        """Return sigma (T,), metres: the stated one and, added in quadrature, that of residuals at positions (N, D)."""
        paths, missing = self.paths, self.dimension - positions.shape[1]
        z = np.pad(positions - positions.mean(axis=0), ((0, 0), (0, missing)))
        u, b = self._plane_waves(paths, z)
        wide = replace(self, sigma=np.hypot(self.stated, 1.4826 * self.median(paths + u @ z.T - b[:, None])))
        for _ in range(2):  # now with curved wave fronts
            r = wide._residuals(paths, z, wide._sources(paths, z))[0]
            wide = replace(wide, sigma=np.hypot(self.stated, 1.4826 * self.median(r)))
        return wide.sigma

    def median(self, r: Reals) -> np.ndarray:
        """Return the median (T,) of the absolute values of r (T, N) over the microphones that have an arrival."""
        size, count = np.sort(np.where(self.used, np.abs(r), np.inf), axis=1), self.used.sum(axis=1)
        take = np.arange(len(r))
        return (size[take, (count - 1) // 2] + size[take, count // 2]) / 2

    def _costs(self, r: Reals) -> np.ndarray:
        return (NU + 1) / 2 * np.log1p(r**2 / (NU * self.sigma[:, None] ** 2)).sum(axis=1)

    def _residuals(self, paths: Reals, z: Reals, source: TakeSources) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return residuals r, 0 without an arrival, and path differences g, both metres, and s : (T, N) each."""
        q, b = source.inverse[:, None], source.direction @ z.T
        a = q * (z**2).sum(axis=1)
        s = np.sqrt(np.maximum(1 + q * (a - 2 * b), 1e-12))
        g = (a - 2 * b) / (1 + s)
        return self.used * (paths - source.emission[:, None] - g), g, s

    def _jacobian(self, z: Reals, source: TakeSources, g: Reals, s: Reals) -> np.ndarray:
        """Return the derivatives (T, N, K) of all residuals with respect to the tangents of u, to q and to b."""
        J = np.empty((*s.shape, z.shape[1] + 1))
        np.divide(z @ _tangents(source.direction), s[..., None], out=J[..., :-2])
        np.divide(g**2 - (z**2).sum(axis=1), 2 * s, out=J[..., -2])
        J[..., -1] = -1.0
        return J

    def _at_bound(self, slope: Reals, r: Reals, inverse: Reals) -> np.ndarray:
        """Return which sources are at a bound of their distance and would cross it in the next step : (T,) bool."""
        gradient = (slope * r).sum(axis=1)
        return ((inverse <= 0) & (gradient > 0)) | ((inverse >= 1 / NEAREST) & (gradient < 0))

    def _sources(self, paths: Reals, z: Reals) -> TakeSources:
        """Return the likeliest source of each take, from starts at several distances."""
        radius = float(np.sqrt(np.sum(z**2, axis=1).mean())) or 1.0
        direction, emission = self._plane_waves(paths, z)
        (T, _), starts = paths.shape, np.array(STARTS)
        take = np.tile(np.arange(T), len(starts))
        every = replace(self, used=self.used[take], sigma=self.sigma[take], stated=self.stated[take])
        inverse = np.minimum(np.repeat(starts, T) / radius, 1 / NEAREST)
        found, cost = every._fitted(paths[take], z, TakeSources(direction[take], inverse, emission[take]))
        best = np.argmin(cost.reshape(-1, T) + 1e-9 * np.arange(len(starts))[:, None], axis=0) * T + np.arange(T)
        return TakeSources(found.direction[best], found.inverse[best], found.emission[best])

    def _plane_waves(self, paths: Reals, z: Reals) -> tuple[np.ndarray, np.ndarray]:
        """Return directions (T, dimension) and paths b (T,), metres, of plane waves; the fit rejects outliers."""
        A = np.column_stack([z, np.ones(len(z))])
        flat = np.linalg.svd(z, full_matrices=False)[2][-1]  # the shortest axis of the array
        fit: np.ndarray = self._consensus(paths, A)
        for _ in range(3):
            r: np.ndarray = paths - fit @ A.T
            scale: Reals = np.maximum(1.4826 * self.median(r), self.stated)[:, None]
            weight: Reals = self.used / (NU + (r / scale) ** 2)
            weighted = weight[:, :, None] * A
            inverse = np.linalg.pinv(np.swapaxes(weighted, 1, 2) @ A, rcond=1e-6, hermitian=True)
            fit = np.einsum("tkl,tnl,tn->tk", inverse, weighted, paths)
        u = -fit[:, :-1]
        normal = u @ flat
        u = u - normal[:, None] * flat
        size = np.linalg.norm(u, axis=1)
        rest = np.sqrt(np.maximum(1 - size**2, 0.0)) * np.where(normal < 0, -1.0, 1.0)
        u = u / np.maximum(size, 1.0)[:, None] + rest[:, None] * flat
        return u / np.linalg.norm(u, axis=1, keepdims=True), fit[:, -1]

    def _consensus(self, paths: Reals, A: Reals) -> np.ndarray:
        """Return the fit (T, K) of the paths by A (N, K) with the least median residual, among fits to small subsets.

        P. Rousseeuw, "Least Median of Squares Regression", J. Am. Stat. Assoc. 79, 1984: up to half may be outliers.
        """
        chosen = _subsets(self.used.tobytes(), *paths.shape)[..., : A.shape[1] + 1]
        few = A[chosen]
        normal = np.asarray(np.swapaxes(few, -1, -2) @ few)
        normal += 1e-9 * np.trace(normal, axis1=-2, axis2=-1)[..., None, None] * np.eye(A.shape[1])
        right = np.swapaxes(few, -1, -2) @ paths[np.arange(len(paths))[:, None], chosen][..., None]
        fits = np.asarray(np.linalg.solve(np.asarray(normal), np.asarray(right)))[..., 0]
        size = np.where(self.used, np.abs(paths - fits @ A.T), np.inf)
        middle = np.sort(size, axis=-1)[:, np.arange(len(paths)), np.sum(self.used, axis=1) // 2]
        return fits[np.argmin(middle, axis=0), np.arange(len(paths))]

    def _fitted(self, paths: Reals, z: Reals, source: TakeSources) -> tuple[TakeSources, np.ndarray]:
        """Return the source of each take at the nearest minimum, and its cost (T,), by damped Gauss-Newton steps."""
        diagonal, sigma2 = np.arange(z.shape[1] + 1), self.sigma[:, None] ** 2
        r, g, s = self._residuals(paths, z, source)
        cost: np.ndarray = self._costs(r)
        damping: Reals = np.full(len(paths), DAMPING)
        for _ in range(MAX_STEPS):
            w: Reals = self.used * (NU + 1) / (NU * sigma2 + r**2)
            J, wr = self._jacobian(z, source, g, s), w * r
            J[..., -2] *= ~self._at_bound(J[..., -2], wr, source.inverse)[:, None]
            slope = (wr[:, None] @ J)[:, 0]
            curved = np.maximum(w - 2 / (NU + 1) * wr**2, MIN_CURVATURE * w)
            H = (J * curved[..., None]).swapaxes(1, 2) @ J
            size: Reals = H[:, diagonal, diagonal]
            size = np.maximum(size, 1e-12 * size.max(axis=1, keepdims=True))
            H[:, diagonal, diagonal] = size * (1 + damping[:, None])
            step: np.ndarray = -np.linalg.solve(H, slope[..., None])[..., 0]
            if np.all(-(step * slope).sum(axis=1) < MIN_DECREASE):
                break
            u = source.direction + (_tangents(source.direction) @ step[:, :-2, None])[..., 0]
            tried = TakeSources(
                u / np.sqrt((u**2).sum(axis=1, keepdims=True)),
                np.clip(source.inverse + step[:, -2], 0.0, 1 / NEAREST),
                source.emission + step[:, -1],
            )
            tried_r, tried_g, tried_s = self._residuals(paths, z, tried)
            there = self._costs(tried_r)
            better = there <= cost
            row = better[:, None]
            source = TakeSources(
                np.where(row, tried.direction, source.direction),
                np.where(better, tried.inverse, source.inverse),
                np.where(better, tried.emission, source.emission),
            )
            r, g, s = np.where(row, tried_r, r), np.where(row, tried_g, g), np.where(row, tried_s, s)
            cost = np.where(better, there, cost)
            damping = np.where(better, np.maximum(damping / 10, MIN_DAMPING), np.minimum(6 * damping, 1e6))
        return source, cost


SUBSETS = 40  # number of subsets of the microphones, to each of which a plane wave is fitted


@lru_cache(maxsize=4)
def _subsets(used: bytes, takes: int, microphones: int) -> np.ndarray:
    """Return random orders of the microphones (`SUBSETS`, T, N) int64; those with an arrival come first."""
    missing = ~np.frombuffer(used, bool).reshape(takes, microphones)
    return frozen_array(np.argsort(np.random.default_rng(0).random((SUBSETS, *missing.shape)) + missing), np.int64)


def _tangents(u: Reals) -> np.ndarray:
    """Return orthonormal vectors (T, dimension, dimension - 1) perpendicular to unit vectors (T, dimension)."""
    v = np.array(u)
    v[:, 0] += np.where(u[:, 0] < 0, -1.0, 1.0)
    reflected = v[:, :, None] * (-2 / (v**2).sum(axis=1)[:, None, None] * v[:, None, 1:])
    reflected[:, np.arange(1, u.shape[1]), np.arange(u.shape[1] - 1)] += 1.0
    return reflected


def arrivals_of(problem: Problem, sigma: np.ndarray | None) -> Arrivals | None:
    """Return the arrivals of a problem with `sigma` (T,), metres, or the stated sigma; None without enough arrivals."""
    if problem.arrivals is None or problem.arrival_sigma is None:
        return None
    enough = counted(problem)
    if not np.any(enough):
        return None
    paths = problem.sound_speed * problem.arrivals[enough]
    used = np.isfinite(paths)
    middle = np.array([np.median(row[use]) for row, use in zip(paths, used, strict=True)])
    stated = problem.sound_speed * problem.arrival_sigma
    own = stated if sigma is None else sigma
    return Arrivals(np.where(used, paths - middle[:, None], 0.0), used, own[enough], stated[enough], problem.dimension)


def arrival_misfits(problem: Problem, positions: np.ndarray) -> np.ndarray | None:
    """Return the absolute residuals (T, N) float64, metres, of the arrivals at some positions; NaN without an arrival.

    The result has a row for each take that has enough arrivals (`counted`), and is None if there is no such take.
    """
    arrivals = arrivals_of(problem, None)
    if arrivals is None:
        return None
    terms = replace(arrivals, sigma=arrivals.scatter(positions)).terms(positions, derivatives=False)
    return np.where(arrivals.used, np.abs(terms.residual), np.nan)


def counted(problem: Problem) -> np.ndarray:
    """Return which takes have more arrivals than unknowns of their source : (T,) bool."""
    assert problem.arrivals is not None
    return np.sum(np.isfinite(problem.arrivals), axis=1) > problem.dimension + 1


PRIOR_COUNT = 4.0  # weight of the stated sigma in the estimate of sigma, as a number of arrivals


MIN_SPREAD = 5e-3  # metres, smallest sigma that is assumed for the coordinates before arrivals are used
CONSTRAINED_STIFFNESS = 1e16  # 1/m^2, stiffness of a microphone whose position is exact
ROUNDS = 15  # iterations of positions and sigma in `near_positions`


def near_positions(
    arrivals: Arrivals, positions: np.ndarray, spread: float, constrained: Integers
) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions (N, D) near `positions` that fit the arrivals best, and the arrivals' sigma (T,), metres.

    spread : one sigma of a coordinate of `positions`, metres; constrained : (A,) int64, microphones that do not move
    """
    x: np.ndarray = np.array(positions)
    stiffness = np.full(positions.shape, 1 / max(spread, MIN_SPREAD) ** 2)
    stiffness[constrained] = CONSTRAINED_STIFFNESS
    stiffness = stiffness.ravel()
    arrivals = replace(arrivals, sigma=arrivals.scatter(x))
    covariance = np.zeros((x.size + 1,) * 2)
    for _ in range(ROUNDS):
        terms = arrivals.terms(x)
        covariance[:-1, :-1] = np.linalg.inv(terms.matrix[:-1, :-1] + np.diag(stiffness))
        pull = terms.gradient[:, :-1].sum(axis=0) + stiffness * (x - positions).ravel()
        x = x - (covariance[:-1, :-1] @ pull).reshape(x.shape)
        there = replace(arrivals, start=terms.source).terms(x)
        arrivals = replace(arrivals, sigma=updated_sigma(arrivals, there, covariance))
    return x, arrivals.sigma


OUTLIER = 4.0  # robust standard deviations beyond which a residual does not count in sigma
MIN_SIGMA = 0.2  # smallest estimate of sigma, divided by the stated sigma
MAX_CHANGE = 4.0  # largest factor by which one update changes sigma


def updated_sigma(arrivals: Arrivals, terms: ArrivalTerms, covariance: np.ndarray) -> np.ndarray:
    """Return the sigma (T,), metres, of the arrivals, by empirical Bayes (MacKay).

    Its square is the weighted sum of the squared residuals, divided by the degrees of freedom that remain after the fit
    of the positions; the stated sigma counts as `PRIOR_COUNT` further residuals. Outliers are left out, because the
    estimate of the scale of a Student t distribution breaks down at a fraction 1 / (1 + NU) of outliers.

    covariance : (F, F) float64, of the unknowns that the arrivals depend on
    """
    r, used = np.abs(terms.residual), arrivals.used
    inside = used & (r <= OUTLIER * np.maximum(1.4826 * arrivals.median(r), arrivals.stated)[:, None])
    part = np.sum(inside, axis=1) / np.sum(used, axis=1)
    fitted = np.einsum("tnf,fg,tng,tn->t", terms.slopes, covariance, terms.slopes, inside)
    determined = np.clip(part * terms.count - fitted, 0.0, terms.count)
    squares = np.sum(inside * terms.weight * r**2, axis=1) * arrivals.sigma**2
    fresh = (squares + PRIOR_COUNT * arrivals.stated**2) / (determined + PRIOR_COUNT)
    fresh = np.clip(np.sqrt(fresh), arrivals.sigma / MAX_CHANGE, MAX_CHANGE * arrivals.sigma)
    return np.maximum(fresh, MIN_SIGMA * arrivals.stated)
