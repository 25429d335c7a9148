"""The likelihood of `fdcal.cost.channel_likelihood` by waves, where they are fewer than the microphones.

In the plane K = W W^H of some circular or plane waves. With T = diag(tau) the covariance is

    C = T^1/2 (s W' W'^H + v I) T^1/2,    W' = T^-1/2 W,    q' = T^-1/2 q,

so that with P of `fdcal.cost.low_rank_terms` C^-1 = T^-1/2 P T^-1/2 / v, and a matrix of r x r takes the place of one
of N x N.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .angular_prior import weighted_waves
from .channel_field import ChannelField, Terms
from .circular_waves import circular_waves
from .low_rank_covariance import LEAST_WEIGHT, expansion_centre, spectra_along
from .low_rank_terms import factorised, fitted_slopes
from .mode_sums import blocks

Waves = Callable[[slice, bool], tuple[np.ndarray, np.ndarray | None]]


def few_waves(x, field: ChannelField) -> tuple[Waves, int] | None:
    """Return the waves of which the covariance consists, and their number; None unless fewer than the microphones.

    Parameters
    ----------
    x : (N, D) float64, metres
    field : ChannelField

    Returns
    -------
    waves : callable, of a slice of modes, and whether derivatives are wanted, returns W (M, r, N) and dW (2, M, r, N)
    r : int
    """
    if field.dimension == 3:
        return None
    k, directions = field.wavenumbers, field.directions
    if directions is not None:
        offsets, r = x - np.mean(x if field.about is None else field.about, axis=0), directions.shape[1]
        return (lambda m, slope: weighted_waves(offsets, k[m], directions[m], slope), r) if r < len(x) else None
    centre, orders, gains = expansion_centre(x, k, 2, field.near, field.about)
    r = 2 * int(orders.max()) + 1
    if r >= len(x):
        return None
    return lambda m, slope: circular_waves(x, centre, k[m], orders[m], gains[m], slope), r


def low_rank_channel_terms(waves: Waves, r: int, q, log_gain, by_parameter, field: ChannelField, derivatives) -> Terms:
    """Return the terms of corrected pressures `q` (M, N).

    waves, r : of `few_waves`
    log_gain, by_parameter : as of `fdcal.cost.channel_likelihood.log_response`
    derivatives : as of `fdcal.cost.channel_likelihood.channel_terms`
    """
    (M, N), weight = q.shape, 1 / np.sqrt(field.channel_noise)
    s, v = field.power, np.maximum(field.noise, LEAST_WEIGHT * field.power)
    jacobian = np.sum(2 * np.real(log_gain), axis=1) + N * np.log(v) + np.sum(np.log(field.channel_noise))
    costs, u, d, slopes, H = np.empty(M), np.empty((M, N), complex), np.empty((M, N)), [], 0.0
    for m in blocks(M, 2 * N * r):
        W, dW = waves(m, derivatives > 0)
        seen = factorised(W * weight, q[m] * weight, v[m] / s[m])
        costs[m] = seen.misfit / v[m] + seen.log_det
        u[m] = seen.residual * weight / v[m, None]
        d[m] = (1 - np.sum(np.abs(seen.F) ** 2, axis=1)) * weight**2 / v[m, None]
        if dW is None:
            continue
        dW = dW * weight
        D, P = len(dW), len(dW) + len(by_parameter)
        g, logs = np.empty((P, 2, len(W), N)), np.empty((P, len(W), N))
        g[:D], logs[:D] = fitted_slopes(dW, seen.coefficients, N), seen.widening(dW)
        for i, derivative in enumerate(by_parameter, D):
            of_modes = derivative[m] if len(derivative) > 1 else derivative
            along = q[m] * weight * of_modes
            g[i, 0], g[i, 1], logs[i] = along.real, along.imag, np.real(of_modes)
        misfit = (g[:, 0] * np.real(seen.residual) + g[:, 1] * np.imag(seen.residual)) / v[m, None]
        slopes.append(2 * (logs - misfit).transpose(1, 2, 0))
        H = H + seen.curvature(g, 1 / v[m])
    costs += jacobian
    if not derivatives:
        return Terms(float(costs.sum()), costs, None, None, u, d, q)
    each = np.concatenate(slopes)
    return Terms(float(costs.sum()), costs, each.sum(axis=0), _whole(H), u, d, q, each if derivatives > 2 else None)


def low_rank_spectra(waves: Waves, r: int, q, weight) -> tuple[np.ndarray, np.ndarray]:
    """Return eigenvalues of W' W'^H and |e^H q'|^2 along its eigenvectors e : two (M, N) float64 arrays.

    waves, r : of `few_waves`;  q : (M, N) complex128;  weight : (N,) float64, T^-1/2
    """
    found = [spectra_along(waves(m, False)[0] * weight, q[m] * weight) for m in blocks(len(q), 2 * q.shape[1] * r)]
    return np.concatenate([values for values, _ in found]), np.concatenate([along for _, along in found])


def _whole(H) -> np.ndarray:
    """(N, P, N, P) from blocks a <= b of (P, P, N, N)."""
    for a in range(len(H)):
        for b in range(a):
            H[a, b] = H[b, a].T
    return np.ascontiguousarray(H.transpose(2, 0, 3, 1))
