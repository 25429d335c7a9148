"""The likelihood of `fdcal.cost.channel_likelihood` by the covariance of every mode itself, (M, N, N)."""

from __future__ import annotations

import numpy as np

from .angular_prior import plane_wave_kernel
from .channel_field import ChannelField, Terms
from .channel_kernels import diffuse_kernel, series_kernel
from .mode_sums import hermitian_inverses


def dense_channel_terms(x, q, log_gain, by_parameter, field: ChannelField, derivatives: int) -> Terms:
    """Return the terms at positions `x` (N, D), metres, of corrected pressures `q` (M, N).

    log_gain, by_parameter : as of `fdcal.cost.channel_likelihood.log_response`
    derivatives : as of `fdcal.cost.channel_likelihood.channel_terms`
    """
    K, D = channel_kernel(x, field, derivatives > 0)
    K *= field.power[:, None, None]
    diagonal = np.arange(len(x))
    K[:, diagonal, diagonal] += np.multiply.outer(field.noise, field.channel_noise)
    precision, log_det = hermitian_inverses(K)
    u = applied(precision, q)
    costs = log_det + np.sum(np.real(np.conj(q) * u + 2 * log_gain), axis=1)
    d = np.ascontiguousarray(np.real(precision[:, diagonal, diagonal]))
    if not derivatives:
        return Terms(float(costs.sum()), costs, None, None, u, d, q)
    slopes, J = gradients(x, q, u, precision, D, field.power, by_parameter)
    H = curvature(precision, J)
    return Terms(float(costs.sum()), costs, slopes.sum(axis=0), H, u, d, q, slopes if derivatives > 2 else None)


def channel_kernel(x, field: ChannelField, slope: bool):
    """Return the covariance K (M, N, N) of a field of unit power and, if wanted, its slope.

    The slope is (M, N, N) of the diffuse kernel, and D (D, M, N, N) of the others.
    """
    if field.directions is not None:
        about = x if field.about is None else field.about
        return plane_wave_kernel(x, about, field.wavenumbers, field.directions, slope, field.dimension)
    if np.iscomplexobj(field.wavenumbers):
        return series_kernel(x, field.about, field.wavenumbers, field.dimension, field.near, slope)
    N, M = len(x), len(field.wavenumbers)
    pairs = np.tril_indices(N, -1)
    distance = np.linalg.norm(x[pairs[0]] - x[pairs[1]], axis=1)
    if not np.all(np.isfinite(distance)):
        raise np.linalg.LinAlgError("positions are not finite")
    kappa, over = diffuse_kernel(distance, field.wavenumbers, field.dimension, slope)
    lower, upper = pairs[0] * N + pairs[1], pairs[1] * N + pairs[0]
    K = np.empty((M, N * N))
    K[:, lower] = K[:, upper] = kappa
    K[:, :: N + 1] = 1.0
    if not slope:
        return K.reshape(M, N, N), None
    S = np.zeros((M, N * N))
    S[:, lower] = S[:, upper] = over
    return K.reshape(M, N, N), S.reshape(M, N, N)


def applied(A, v):
    """A v for every mode: A (M, N, N) real or complex, v (M, N) complex."""
    if np.iscomplexobj(A):
        return np.matmul(A, v[..., None])[..., 0]
    two = np.ascontiguousarray(v).view(float).reshape(*v.shape, 2)
    return np.ascontiguousarray(np.matmul(A, two)).view(complex)[..., 0]


def gradients(x, q, u, traced, D, power, by_parameter, counted=1.0):
    """Gradient of every mode (M, N, P), and J (M, N, P) complex128.

    x, q, u, by_parameter : as of `dense_channel_terms`
    traced : (M, N, N) Hermitian, A, where the slope tr(A dC) belongs to the gradient; C^-1 for a log-determinant
    D : slope of the kernel, as of `channel_kernel`;  power : (M,) float64, s
    counted : by which the slope of 2 Re log g is multiplied, 1 or (M, N)
    """
    M, (N, dimensions) = len(q), x.shape
    J = np.empty((M, N, dimensions + len(by_parameter)), complex)
    logs = np.zeros(J.shape)
    s = power[:, None]
    if D.ndim == 3:  # D_a = S (x_i - x_j)_a
        moments = np.concatenate([u[..., None], u[..., None] * x], axis=-1)
        Su = np.matmul(D, moments.view(float)).view(complex) * s[..., None]
        J[..., :dimensions] = x * Su[..., :1] - Su[..., 1:]
        E = traced * D
        rows = np.matmul(E, np.column_stack([np.ones(N), x]))
        logs[..., :dimensions] = 2 * s[..., None] * (x * rows[..., :1] - rows[..., 1:])
    else:
        for a in range(dimensions):
            J[..., a] = s * np.matmul(D[a], u[..., None])[..., 0]
            logs[..., a] = 2 * s * np.einsum("mij,mij->mi", D[a], np.conj(traced)).real
    for i, derivative in enumerate(by_parameter, dimensions):
        J[..., i] = q * derivative
        logs[..., i] = 2 * np.real(derivative) * counted
    return logs - 2 * (np.conj(u)[..., None] * J).real, J


def curvature(precision, J):
    """2 Re sum_m conj(J_mia) (C_m^-1)_ij J_mjb : (N, P, N, P) float64."""
    N, P = J.shape[1:]
    H = np.empty((P, P, N, N))
    if np.iscomplexobj(precision):
        for a in range(P):
            left = np.conj(J[..., a])[..., None] * precision
            for b in range(a, P):
                H[a, b] = 2 * np.einsum("mij,mj->ij", left, J[..., b]).real
    else:
        for a in range(P):
            parts = precision * J[..., a].real[..., None], precision * J[..., a].imag[..., None]
            for b in range(a, P):
                H[a, b] = np.einsum("mij,mj->ij", parts[0], J[..., b].real.copy())
                H[a, b] += np.einsum("mij,mj->ij", parts[1], J[..., b].imag.copy())
                H[a, b] *= 2
    for a in range(P):
        for b in range(a):
            H[a, b] = H[b, a].T
    return np.ascontiguousarray(H.transpose(2, 0, 3, 1))
