"""Likelihood of pressures whose channels have gains and noise of their own: cost, gradient, Gauss-Newton matrix.

    p_mn = g_mn e_mn + noise,   log g_mn = a_n + j b_n - j k_m d_n + h(kappa_n, k_m),   q_mn = p_mn / g_mn
    C_m  = s_m K_m + v_m diag(tau_n)
    cost = sum_m [log det C_m + q_m^H C_m^-1 q_m + 2 Re sum_n log g_mn]

    x (N, D) positions, metres;  a, b (N,) log gain, nepers, and phase, radians
    d (N,) delay, metres, times the sound speed;  kappa (N,) corner of a first-order high-pass, rad/m, times 2 pi / c
    h = -log(1 - j kappa / k), the high-pass over what all channels share; of a corner below 0 its inverse at -kappa
    K    covariance of a field of unit power (`fdcal.cost.channel_kernels`)
    s, v (M,) power of field and noise;  tau (N,) noise of each channel over that of the array, 1 for a sound one
    u    C^-1 q;   d  diagonal of C^-1;   q_n - u_n / d_n is what the other microphones predict of channel n

The parameters of a microphone are (x, a, b), or (x, a, b, d, kappa). With J = (D_1 u, .., D_D u, q dlog g / da, ..),
the gradient is -2 Re[conj(u) J] and what the log-determinants and log g add, the curvature
2 Re sum_m conj(J_mi) (C_m^-1)_ij J_mj.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import get_lapack_funcs

from .angular_prior import plane_wave_kernel
from .channel_kernels import diffuse_kernel, series_kernel


@dataclass(frozen=True)
class ChannelField:
    """What is assumed of the sound field and of the noise.

    Attributes
    ----------
    wavenumbers : (M,) float64 or complex128, rad/m; complex ones take the series, real ones the diffuse kernel
    power, noise : (M,) float64, s and v, in the unit of abs(pressures)**2
    channel_noise : (N,) float64, tau
    dimension : 2 or 3, of the sound field
    near : whether a source may be close to the array; with the series only
    about : (N, D) float64, metres, or None: positions that give the centre of the series, those of the microphones
        unless given; the gradient takes it as fixed
    directions : (M, Q) float64 or None: power by direction, mean 1 (`fdcal.cost.angular_prior`), in two dimensions
    """

    wavenumbers: np.ndarray
    power: np.ndarray
    noise: np.ndarray
    channel_noise: np.ndarray
    dimension: int
    near: bool = False
    about: np.ndarray | None = None
    directions: np.ndarray | None = None


@dataclass(frozen=True)
class Terms:
    """The cost at one set of parameters, and what follows from the same factorisation.

    Attributes
    ----------
    cost : float
    costs : (M,) float64, of every mode
    gradient : (N, P) float64, by position, log gain, phase and, if wanted, delay and corner; None for the cost alone
    curvature : (N, P, N, P) float64, Gauss-Newton; None for the cost alone
    weighted : (M, N) complex128, u = C^-1 q
    precision : (M, N) float64, d, the diagonal of C^-1
    corrected : (M, N) complex128, q
    slopes : (M, N, P) float64, gradient of every mode; None unless wanted
    """

    cost: float
    costs: np.ndarray
    gradient: np.ndarray | None
    curvature: np.ndarray | None
    weighted: np.ndarray
    precision: np.ndarray
    corrected: np.ndarray
    slopes: np.ndarray | None = None

    def newton(self) -> tuple[np.ndarray, np.ndarray]:
        """Return gradient and curvature. Raises ValueError where the cost alone was computed."""
        if self.gradient is None or self.curvature is None:
            raise ValueError("these terms were computed without derivatives")
        return self.gradient, self.curvature


def channel_terms(positions, gains, pressures, field: ChannelField, derivatives: int = 2) -> Terms:
    """Cost at `positions` (N, D), metres, and `gains` (N, 2) or (N, 4) of `pressures` (M, N).

    gains : a, nepers, b, radians, and if there are four of them d, metres, and kappa, rad/m
    derivatives : 0 for the cost, 2 with gradient and curvature, 3 with the gradient of every mode, too

    Raises numpy.linalg.LinAlgError where a covariance is not positive definite.
    """
    x = np.asarray(positions, float)
    log_gain, by_parameter = log_response(gains, np.real(field.wavenumbers))
    q = pressures * np.exp(-log_gain)
    K, D = _kernel(x, field, derivatives > 0)
    K *= field.power[:, None, None]
    diagonal = np.arange(len(x))
    K[:, diagonal, diagonal] += np.multiply.outer(field.noise, field.channel_noise)
    precision, log_det = _inverses(K)
    u = _apply(precision, q)
    costs = log_det + np.sum(np.real(np.conj(q) * u + 2 * log_gain), axis=1)
    d = np.ascontiguousarray(np.real(precision[:, diagonal, diagonal]))
    if not derivatives:
        return Terms(float(costs.sum()), costs, None, None, u, d, q)
    slopes, J = _gradients(x, q, u, precision, D, field, by_parameter)
    H = _curvature(precision, J)
    return Terms(float(costs.sum()), costs, slopes.sum(axis=0), H, u, d, q, slopes if derivatives > 2 else None)


def log_response(gains, wavenumbers):
    """Logarithm of the response of every channel, and its derivatives by the parameters in `gains`.

    gains : (N, 2) or (N, 4), as of `channel_terms`;  wavenumbers : (M,) float64, rad/m

    Returns
    -------
    log_gain : (M, N) complex128, or (1, N) with two parameters
    by_parameter : list of arrays that broadcast to (M, N)
    """
    constant = (gains[:, 0] + 1j * gains[:, 1])[None]
    first: list = [np.ones((1, 1)), np.full((1, 1), 1j)]
    if gains.shape[1] == 2:
        return constant, first
    k, corner = np.asarray(wavenumbers)[:, None], gains[:, 3]
    cut = 1 - 1j * np.abs(corner) / k
    delayed = -1j * k * gains[:, 2] - np.sign(corner) * np.log(cut)
    return constant + delayed, [*first, -1j * k, 1j / (k * cut)]


def field_covariance(positions, field: ChannelField) -> np.ndarray:
    """Covariance of a field of unit power between microphones at `positions` (N, D), metres : (M, N, N)."""
    return _kernel(np.asarray(positions, float), field, False)[0]


def _kernel(x, field: ChannelField, slope: bool):
    """K (M, N, N); and, if wanted, of the diffuse one its slope (M, N, N), of the others D (D, M, N, N)."""
    if field.directions is not None:
        about = x if field.about is None else field.about
        return plane_wave_kernel(x, about, field.wavenumbers, field.directions, slope)
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


def _inverses(C):
    """C^-1 (M, N, N) and log det C (M,) of Hermitian matrices; C is overwritten."""
    factor, invert = get_lapack_funcs(("potrf", "potri"), (C,))
    log_det = np.empty(len(C))
    for m, A in enumerate(C):  # the transpose of a row-major matrix is column-major: no copies
        G, fault = factor(A.T, lower=0, overwrite_a=1, clean=1)
        if fault:
            raise np.linalg.LinAlgError(f"covariance of mode {m} is not positive definite")
        log_det[m] = 2 * np.log(np.real(np.diagonal(G))).sum()
        A.T[:] = invert(G, lower=0, overwrite_c=1)[0]
    upper = np.conj(np.swapaxes(C, 1, 2))  # A.T holds the upper triangle, so A the lower
    N = C.shape[1]
    over = np.triu_indices(N, 1)
    C[:, over[0], over[1]] = upper[:, over[0], over[1]]
    return C, log_det


def _apply(A, v):
    """A v for every mode: A (M, N, N) real or complex, v (M, N) complex."""
    if np.iscomplexobj(A):
        return np.matmul(A, v[..., None])[..., 0]
    two = np.ascontiguousarray(v).view(float).reshape(*v.shape, 2)
    return np.ascontiguousarray(np.matmul(A, two)).view(complex)[..., 0]


def _gradients(x, q, u, precision, D, field: ChannelField, by_parameter):
    """Gradient of every mode (M, N, P), and J (M, N, P) complex128."""
    M, (N, dimensions) = len(q), x.shape
    J = np.empty((M, N, dimensions + len(by_parameter)), complex)
    logs = np.zeros(J.shape)
    s = field.power[:, None]
    if D.ndim == 3:  # D_a = S (x_i - x_j)_a
        moments = np.concatenate([u[..., None], u[..., None] * x], axis=-1)
        Su = np.matmul(D, moments.view(float)).view(complex) * s[..., None]
        J[..., :dimensions] = x * Su[..., :1] - Su[..., 1:]
        E = precision * D
        rows = np.matmul(E, np.column_stack([np.ones(N), x]))
        logs[..., :dimensions] = 2 * s[..., None] * (x * rows[..., :1] - rows[..., 1:])
    else:
        for a in range(dimensions):
            J[..., a] = s * np.matmul(D[a], u[..., None])[..., 0]
            logs[..., a] = 2 * s * np.einsum("mij,mij->mi", D[a], np.conj(precision)).real
    for i, derivative in enumerate(by_parameter, dimensions):
        J[..., i] = q * derivative
        logs[..., i] = 2 * np.real(derivative)
    return logs - 2 * (np.conj(u)[..., None] * J).real, J


def _curvature(precision, J):
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
