"""The Gaussian likelihood of the pressures: cost, gradient and Gauss-Newton matrix of positions and channels.

    p_mn = g_mn (field + noise),   log g_mn = a_n + j b_n - j k_m d_n + h(kappa_n, k_m),   q_mn = p_mn / g_mn
    C_m  = s_m K_m + v_m diag(tau_n)
    cost = sum_m [log det C_m + q_m^H C_m^-1 q_m + 2 Re sum_n log g_mn]

    x      (N, D) positions, metres;  a (N,) log gain, nepers;  b (N,) phase, radians
    d      (N,) delay of a channel times the sound speed, metres
    kappa  (N,) corner frequency of a first-order high-pass filter times 2 pi / c, rad/m
    h      -log(1 - j kappa / k), logarithm of the response of the high-pass filter relative to the other channels; for
           kappa < 0 the filter is the inverse of the one with the corner -kappa
    K      covariance of a field of unit power (`fdcal.cost.kernels`)
    s, v   (M,) power of the field and of the noise;  tau (N,) noise of each channel relative to v, 1 if it is healthy
    u      (M, N) C^-1 q. In formulas without delays, d (M, N) stands for the diagonal of C^-1. The other microphones
           predict q_n - u_n / d_n for q_n

The cost is Eq. 7 with a Tikhonov weight v / s, divided by v, plus the log-determinant, which keeps it unbiased. It has
no centre, no order and no truncation, and is invariant under translations, rotations and mirror images. Without the
determinant the microphones would diverge outward, because the kernel of distant microphones tends to the identity,
which fits any pressures.

The parameters of a microphone are x, (x, a, b) or (x, a, b, d, kappa). With J = (D_1 u, .., D_D u, q dlog g / da, ..)
and D_a the derivative of s K, the gradient is -2 Re[conj(u) J] plus the derivatives of the log-determinant and of
log g. The Gauss-Newton matrix is 2 Re sum_m conj(J_mi) (C_m^-1)_ij J_mj.
"""

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..model.problem import mode_power
from ..model.validation import Complexes, Numbers, Reals
from . import kernels
from .kernels import Slopes

MIN_FIELD_FRACTION = 1e-3  # smallest power of the field, divided by that of the pressures; C is thus never pure noise
ISOTROPIC_ORDERS = 10  # orders above ceil(k R) with which a sum of plane waves is isotropic to 1e-9


@dataclass(frozen=True)
class FieldModel:
    """Assumptions about the sound field and the noise."""

    wavenumbers: Reals  # (M,) rad/m, float64, or complex128 for damped waves
    # power, noise: (M,) float64, s and v, in the unit of abs(pressures)**2
    power: Reals
    noise: Reals
    channel_noise: Reals  # (N,) float64, tau
    dimension: int  # 2 or 3, of the sound field
    # (N, D) float64, metres, positions whose mean is the centre of the waves; the positions of the microphones if None.
    # The gradient treats the centre as constant
    about: Reals | None = None
    # (M, Q) float64, power by direction with a mean of 1 (`fdcal.cost.noise`); None if it is isotropic
    directions: Reals | None = None

    def powers(self, x: Reals) -> Reals | None:
        """Return the power by direction (M, Q), or None for an isotropic field whose covariance has a closed form."""
        if self.directions is not None or self.dimension == 3 or np.isrealobj(self.wavenumbers):
            return self.directions
        return np.ones((len(self.wavenumbers), kernels.directions_needed(x, self.wavenumbers, 2, ISOTROPIC_ORDERS)))

    def offsets(self, x: Reals) -> np.ndarray:
        """Return the positions x (N, D) relative to the centre of the waves, metres."""
        return x - np.mean(x if self.about is None else self.about, axis=0)


def isotropic_field(pressures: Numbers, wavenumbers: Numbers, noise: Reals, dimension: int) -> FieldModel:
    """Return a diffuse field whose power is that of the pressures (M, N) minus the noise (M,).

    Only the real part of the wavenumbers (M,), rad/m, is used; the noise is equal in all channels.
    """
    measured = mode_power(pressures)
    power = np.maximum(measured - noise, MIN_FIELD_FRACTION * measured)
    return FieldModel(np.real(wavenumbers), power, np.asarray(noise), np.ones(int(pressures.shape[1])), dimension)


@dataclass(frozen=True)
class Terms:
    """The cost at one set of parameters, and quantities from the same factorisation."""

    cost: float
    costs: Reals  # (M,) float64, of every mode
    # gradient (N, P) and Gauss-Newton matrix (N, P, N, P), float64, with respect to the P parameters of every
    # microphone; None if only the cost was asked for
    gradient: Reals | None
    curvature: Reals | None
    weighted: np.ndarray  # (M, N) complex128, u = C^-1 q
    precision: Reals  # (M, N) float64, d, the diagonal of C^-1
    corrected: np.ndarray  # (M, N) complex128, q

    def newton(self) -> tuple[np.ndarray, np.ndarray]:
        """Return gradient and curvature of terms that were computed with derivatives."""
        assert self.gradient is not None and self.curvature is not None
        return self.gradient, self.curvature


def likelihood_terms(
    positions: Reals, pressures: Complexes, field: FieldModel, channels: Reals | None = None, derivatives: bool = True
) -> Terms:
    """Return the terms at `positions` (N, D), metres, for `pressures` (M, N).

    The columns of `channels`, (N, 2) or (N, 4), are a, nepers, b, radians, d, metres, and kappa, rad/m. Without it all
    gains are 1 and the positions are the only parameters. Raises LinAlgError for positions that are not finite or a
    covariance that is not positive definite.
    """
    x, diagonal = np.asarray(positions, float), np.arange(len(positions))
    if not np.isfinite(x).all():  # LAPACK factorises a matrix of NaN without an error
        raise np.linalg.LinAlgError("positions are not finite")
    log_gain, by_parameter = log_response(channels, np.real(field.wavenumbers))
    q = np.asarray(pressures, complex) * np.exp(-log_gain)
    if field.directions is not None and np.isrealobj(field.wavenumbers):  # fills the cache before the threads start
        kernels.cosines_and_sines(field.offsets(x), field.wavenumbers, field.directions.shape[1], field.dimension)

    def of_block(m: slice) -> tuple[np.ndarray, ...]:
        """Return costs (B,), u and d (B, N) and gradients (B, N, P) of B modes, and the sum of their curvatures."""
        C, sloped = field_covariance(x, field, m, derivatives)
        C *= field.power[m, None, None]
        C[:, diagonal, diagonal] += np.multiply.outer(field.noise[m], field.channel_noise)
        inverse, log_det = kernels.hermitian_inverses(C)
        u, d = kernels.applied(inverse, q[m]), np.ascontiguousarray(np.real(inverse[:, diagonal, diagonal]))
        costs = log_det + np.sum(np.real(np.conj(q[m]) * u), axis=1)
        if not derivatives:
            return costs, u, d
        slope, traced = (part * field.power[m, None] for part in sloped(u, inverse))
        D, P = len(slope), len(slope) + len(by_parameter)
        g, logs = np.empty((P, 2, *u.shape)), np.empty((P, *u.shape))
        g[:D, 0], g[:D, 1], logs[:D] = np.real(slope), np.imag(slope), traced
        for i, derivative in enumerate(by_parameter, D):
            of_modes = derivative[m] if len(derivative) > 1 else derivative
            along = q[m] * of_modes
            g[i, 0], g[i, 1], logs[i] = np.real(along), np.imag(along), np.real(of_modes)
        misfit = g[:, 0] * np.real(u) + g[:, 1] * np.imag(u)
        return costs, u, d, 2 * (logs - misfit).transpose(1, 2, 0), kernels.weighted_curvature(g, inverse)

    parts = list(kernels.over_blocks(of_block, len(q), _largest(x, field)))
    costs, u, d = (np.concatenate([block[i] for part in parts for block in part]) for i in range(3))
    costs, gradient, curvature = costs + np.sum(2 * np.real(log_gain), axis=1), None, None
    if derivatives:
        gradient = np.sum([np.sum([block[3].sum(axis=0) for block in part], axis=0) for part in parts], axis=0)
        H = 2 * np.sum([np.sum([block[4] for block in part], axis=0) for part in parts], axis=0)
        for a, b in itertools.combinations(range(len(H)), 2):
            H[b, a] = H[a, b].T
        curvature = np.ascontiguousarray(H.transpose(2, 0, 3, 1))
    return Terms(float(costs.sum()), costs, gradient, curvature, u, d, q)


def _largest(x: Reals, field: FieldModel) -> int:
    """Return the number of elements of the largest array of one mode."""
    powers = field.powers(x)
    if powers is None:
        return len(x) ** 2
    return len(x) * max(len(x), powers.shape[1]) * (2 if np.iscomplexobj(field.wavenumbers) else 1)


def log_response(channels: Reals | None, wavenumbers: Reals) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return log g, complex128, and its derivatives with respect to the parameters of each channel.

    All have shapes that broadcast to (M, N). `channels` are as in `likelihood_terms`; wavenumbers (M,), rad/m.
    """
    if channels is None:
        return np.zeros((1, 1), complex), []
    constant = (channels[:, 0] + 1j * channels[:, 1])[None]
    first = [np.ones((1, 1)), np.full((1, 1), 1j)]
    if channels.shape[1] == 2:
        return constant, first
    k, corner = np.asarray(wavenumbers)[:, None], channels[:, 3]
    cut = 1 - 1j * np.abs(corner) / k
    delayed = -1j * k * channels[:, 2] - np.sign(corner) * np.log(cut)
    return constant + delayed, [*first, -1j * k, 1j / (k * cut)]


def field_covariance(x: Reals, field: FieldModel, m: slice, derivatives: bool) -> tuple[np.ndarray, Slopes]:
    """Return K (M, N, N) of a field of unit power for the modes `m`, and a function that applies its derivative.

    The function is that of `fdcal.cost.kernels.plane_wave_covariance`; it may only be called if `derivatives` is true.
    """
    powers, k = field.powers(x), field.wavenumbers
    if powers is not None:
        return kernels.plane_wave_covariance(field.offsets(x), k, powers, field.dimension, m)
    if np.iscomplexobj(k):
        K, D = kernels.damped_matrices(field.offsets(x), k[m].astype(complex), derivatives)
    else:
        K, D = kernels.diffuse_matrices(x, k[m], field.dimension, derivatives)
    return K, lambda u, P: _dense_slopes(x, u, P, D)


def _dense_slopes(x: Reals, u: Complexes, traced: Numbers, D: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the two results of `Slopes` for vectors u and Hermitian matrices `traced`, the P of `Slopes`.

    D is (D, M, N, N), or S (M, N, N) of `diffuse_matrices`, with D_a = S (x_i - x_j)_a.
    """
    if D.ndim == 4:
        g = np.array([kernels.applied(slope, u) for slope in D])
        return g, np.array([np.einsum("mij,mij->mi", slope, np.conj(traced)).real for slope in D])
    moments = np.ascontiguousarray(np.concatenate([u[..., None], u[..., None] * x], axis=-1))
    Su = np.matmul(D, moments.view(float)).view(complex)
    rows = np.matmul(np.real(traced) * D, np.column_stack([np.ones(len(x)), x]))
    return np.moveaxis(x * Su[..., :1] - Su[..., 1:], 2, 0), np.moveaxis(x * rows[..., :1] - rows[..., 1:], 2, 0)


def spectra(positions: Reals, corrected: Numbers, field: FieldModel) -> tuple[np.ndarray, np.ndarray]:
    """Return the eigenvalues of T^-1/2 K T^-1/2, and |e^H T^-1/2 q|^2 for its eigenvectors e : (M, N) each, float64.

    T is the diagonal matrix of the channels' noise, and q are the `corrected` pressures (M, N).
    """
    x, weight = np.asarray(positions, float), 1 / np.sqrt(field.channel_noise)

    def of_block(m: slice) -> tuple[np.ndarray, np.ndarray]:
        p = np.asarray(corrected, complex)[m] * weight
        values, vectors = np.linalg.eigh(field_covariance(x, field, m, False)[0] * np.multiply.outer(weight, weight))
        along = np.conj(vectors.swapaxes(1, 2)) @ kernels.as_columns(p, vectors.dtype)
        return np.maximum(values, 0.0), np.sum(np.abs(along) ** 2, axis=2)

    found = [one for part in kernels.over_blocks(of_block, len(corrected), _largest(x, field)) for one in part]
    return np.concatenate([values for values, _ in found]), np.concatenate([along for _, along in found])
