"""The Gaussian likelihood of the pressures: cost, gradient and Gauss-Newton matrix of positions and channels.

    p_mn = g_mn e_mn + noise,   log g_mn = a_n + j b_n - j k_m d_n + h(kappa_n, k_m),   q_mn = p_mn / g_mn
    C_m  = s_m K_m + v_m diag(tau_n)
    cost = sum_m [log det C_m + q_m^H C_m^-1 q_m + 2 Re sum_n log g_mn]

    x (N, D) positions, metres;  a, b (N,) log gain, nepers, and phase, radians
    d (N,) delay, metres, times the sound speed;  kappa (N,) corner of a first-order high-pass, rad/m, times 2 pi / c
    h = -log(1 - j kappa / k), the high-pass over what all channels share; of a corner below 0 its inverse at -kappa
    K    covariance of a field of unit power (`fdcal.cost.kernels`)
    s, v (M,) power of field and noise;  tau (N,) noise of each channel over that of the array, 1 for a healthy one
    u    C^-1 q;   d  diagonal of C^-1;   q_n - u_n / d_n is what the other microphones predict of channel n

It is Eq. 7 with a Tikhonov weight v / s, divided by v, plus the log-determinant: a cost that stays unbiased in noise.
It has no centre, no order and no truncation; translation, rotation and mirror leave it unchanged. Without the
determinant microphones diverge outward: far away the kernel tends to the identity, which fits any pressures.

The parameters of a microphone are x, (x, a, b) or (x, a, b, d, kappa). With J = (D_1 u, .., D_D u, q dlog g / da, ..),
D_a the slope of s K, the gradient is -2 Re[conj(u) J] and what the log-determinants and log g add, the curvature
2 Re sum_m conj(J_mi) (C_m^-1)_ij J_mj.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..model.problem import mode_power
from ..model.validation import Complexes, Numbers, Reals
from . import kernels
from .kernels import Slopes

MIN_FIELD_SHARE = 1e-3  # least power of the field over that of the pressures, so that C is never pure noise
ISOTROPIC_ORDERS = 10  # beyond ceil(k R), with which waves from everywhere are isotropic to 1e-9


@dataclass(frozen=True)
class FieldModel:
    """What is assumed of the sound field and of the noise."""

    # (M,) float64 or complex128, rad/m, of damped waves
    wavenumbers: Reals
    # power, noise: (M,) float64, s and v, in the unit of abs(pressures)**2
    power: Reals
    noise: Reals
    channel_noise: Reals  # (N,) float64, tau
    dimension: int  # 2 or 3, of the sound field
    # (N, D) float64, metres, or None: positions that give the centre, those of the microphones unless given; the
    # gradient takes it as fixed
    about: Reals | None = None
    # (M, Q) float64 or None: power by direction, mean 1 (`fdcal.cost.noise`)
    directions: Reals | None = None

    def powers(self, x: Reals) -> Reals | None:
        """Return the power by direction (M, Q); None of an isotropic field whose covariance has a closed form."""
        if self.directions is not None or self.dimension == 3 or np.isrealobj(self.wavenumbers):
            return self.directions
        return np.ones((len(self.wavenumbers), kernels.directions_needed(x, self.wavenumbers, 2, ISOTROPIC_ORDERS)))

    def offsets(self, x: Reals) -> np.ndarray:
        """Return positions (N, D) from the centre, metres."""
        return x - np.mean(x if self.about is None else self.about, axis=0)


def isotropic_field(pressures: Numbers, wavenumbers: Numbers, noise: Reals, dimension: int) -> FieldModel:
    """Return a diffuse field whose power is that of the pressures (M, N) less the noise (M,), alike in all channels."""
    measured = mode_power(pressures)
    power = np.maximum(measured - noise, MIN_FIELD_SHARE * measured)
    return FieldModel(np.real(wavenumbers), power, np.asarray(noise), np.ones(int(pressures.shape[1])), dimension)


@dataclass(frozen=True)
class Terms:
    """The cost at one set of parameters, and what follows from the same factorisation."""

    cost: float
    costs: Reals  # (M,) float64, of every mode
    gradient: Reals | None  # (N, P) float64, by the parameters of every microphone; None for the cost alone
    curvature: Reals | None  # (N, P, N, P) float64, Gauss-Newton; None for the cost alone
    weighted: np.ndarray  # (M, N) complex128, u = C^-1 q
    precision: Reals  # (M, N) float64, d, the diagonal of C^-1
    corrected: np.ndarray  # (M, N) complex128, q

    def newton(self) -> tuple[np.ndarray, np.ndarray]:
        """Return gradient and curvature. Raises ValueError where the cost alone was computed."""
        if self.gradient is None or self.curvature is None:
            raise ValueError("these terms were computed without derivatives")
        return self.gradient, self.curvature


def likelihood_terms(
    positions: Reals, pressures: Complexes, field: FieldModel, channels: Reals | None = None, derivatives: bool = True
) -> Terms:
    """Return the terms at `positions` (N, D), metres, of `pressures` (M, N).

    `channels` (N, 2) or (N, 4): a, nepers, b, radians, and d, metres, and kappa, rad/m; without them all gains are 1,
    and the positions are the only parameters. LinAlgError for a covariance that is not positive definite.
    """
    x = np.asarray(positions, float)
    if not np.isfinite(x).all():  # LAPACK factorises a matrix of NaN without a complaint
        raise np.linalg.LinAlgError("positions are not finite")
    log_gain, by_parameter = log_response(channels, np.real(field.wavenumbers))
    q = np.asarray(pressures, complex) * np.exp(-log_gain)
    random = _summed(_rule(x, q, field), q, by_parameter, _largest(x, field), derivatives)
    random = replace(random, costs=random.costs + np.sum(2 * np.real(log_gain), axis=1))
    return replace(random, cost=float(random.costs.sum()))


def _largest(x: Reals, field: FieldModel) -> int:
    """Return how many numbers the largest array of one mode has."""
    powers = field.powers(x)
    if powers is None:
        return len(x) ** 2
    return len(x) * max(len(x), powers.shape[1]) * (2 if np.iscomplexobj(field.wavenumbers) else 1)


def log_response(channels: Reals | None, wavenumbers: Reals) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return log g (M, N) complex128, or (1, N), and its derivatives by the parameters, which broadcast to (M, N)."""
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


@dataclass(frozen=True)
class _Block:
    """Some modes, factorised.

    costs (B,); u (B, N) complex128; d (B, N) diagonal of C^-1; inverse (B, N, N), C^-1;
    slopes : returns D_a u (D, B, N) complex128 and half the gradient of the log-determinant (D, B, N)
    """

    costs: np.ndarray
    u: np.ndarray
    d: np.ndarray
    inverse: np.ndarray
    slopes: Callable[[], tuple[np.ndarray, np.ndarray]]


Rule = Callable[[slice, bool], _Block]


def _summed(rule: Rule, q: Complexes, by_parameter: Sequence[np.ndarray], numbers: int, derivatives: bool) -> Terms:
    """Return the terms of all modes, block by block; what log g itself adds to the cost is left out."""

    def differentiated(m: slice, one: _Block) -> tuple[_Block, np.ndarray, np.ndarray]:
        if not derivatives:
            return one, np.zeros(0), np.zeros(0)
        slope, widened = one.slopes()
        D, P = len(slope), len(slope) + len(by_parameter)
        g, logs = np.empty((P, 2, *one.u.shape)), np.empty((P, *one.u.shape))
        g[:D, 0], g[:D, 1], logs[:D] = np.real(slope), np.imag(slope), widened
        for i, derivative in enumerate(by_parameter, D):
            of_modes = derivative[m] if len(derivative) > 1 else derivative
            along = q[m] * of_modes
            g[i, 0], g[i, 1], logs[i] = np.real(along), np.imag(along), np.real(of_modes)
        misfit = g[:, 0] * np.real(one.u) + g[:, 1] * np.imag(one.u)
        return one, 2 * (logs - misfit).transpose(1, 2, 0), kernels.weighted_curvature(g, one.inverse)

    parts = list(kernels.over_blocks(lambda m: differentiated(m, rule(m, derivatives)), len(q), numbers))
    found = [one for part in parts for one, _, _ in part]
    costs = np.concatenate([one.costs for one in found])
    u = np.concatenate([one.u for one in found])
    d = np.concatenate([one.d for one in found])
    if not derivatives:
        return Terms(0.0, costs, None, None, u, d, q)
    gradient = np.sum([np.sum([each.sum(axis=0) for _, each, _ in part], axis=0) for part in parts], axis=0)
    H = kernels.whole_curvature(2 * np.sum([np.sum([matrix for *_, matrix in part], axis=0) for part in parts], axis=0))
    return Terms(0.0, costs, gradient, H, u, d, q)


def field_covariance(x: Reals, field: FieldModel, m: slice, derivatives: bool) -> tuple[np.ndarray, Slopes]:
    """Return K (M, N, N) of a field of unit power for the modes `m`, and a function of its slope.

    That function is the one of `fdcal.cost.kernels.plane_wave_covariance`; it may be called with `derivatives` only.
    """
    powers, k = field.powers(x), field.wavenumbers
    if powers is not None:
        return kernels.plane_wave_covariance(field.offsets(x), k, powers, field.dimension, m)
    if np.iscomplexobj(k):
        K, D = kernels.damped_matrices(field.offsets(x), k[m].astype(complex), derivatives)
    else:
        K, D = kernels.diffuse_matrices(x, k[m], field.dimension, derivatives)
    return K, lambda u, P: _dense_slopes(x, u, P, D)


def _rule(x: Reals, q: Complexes, field: FieldModel) -> Rule:
    """Return the function that factorises the covariance of some modes."""
    if field.directions is not None and np.isrealobj(field.wavenumbers):  # kept for the blocks of all threads
        kernels.cosines_and_sines(field.offsets(x), field.wavenumbers, field.directions.shape[1], field.dimension)
    diagonal = np.arange(len(x))

    def rule(m: slice, derivatives: bool) -> _Block:
        C, sloped = field_covariance(x, field, m, derivatives)
        C *= field.power[m, None, None]
        C[:, diagonal, diagonal] += np.multiply.outer(field.noise[m], field.channel_noise)
        P, log_det = kernels.hermitian_inverses(C)
        u, d = kernels.applied(P, q[m]), np.ascontiguousarray(np.real(P[:, diagonal, diagonal]))
        costs = log_det + np.sum(np.real(np.conj(q[m]) * u), axis=1)

        def slopes():
            g, logs = sloped(u, P)
            return g * field.power[m, None], logs * field.power[m, None]

        return _Block(costs, u, d, P, slopes)

    return rule


def _dense_slopes(x: Reals, u: Complexes, traced: Numbers, D: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return D_a u (D, M, N) complex128 and Re tr(A dK) (D, M, N), A the Hermitian matrices `traced` (M, N, N)."""
    if D.ndim == 4:
        g = np.array([kernels.applied(slope, u) for slope in D])
        return g, np.array([np.einsum("mij,mij->mi", slope, np.conj(traced)).real for slope in D])
    moments = np.ascontiguousarray(np.concatenate([u[..., None], u[..., None] * x], axis=-1))  # D_a = S (x_i - x_j)_a
    Su = np.matmul(D, moments.view(float)).view(complex)
    rows = np.matmul(np.real(traced) * D, np.column_stack([np.ones(len(x)), x]))
    return np.moveaxis(x * Su[..., :1] - Su[..., 1:], 2, 0), np.moveaxis(x * rows[..., :1] - rows[..., 1:], 2, 0)


def spectra(positions: Reals, corrected: Numbers, field: FieldModel) -> tuple[np.ndarray, np.ndarray]:
    """Return eigenvalues of T^-1/2 K T^-1/2 and |e^H T^-1/2 q|^2 along its eigenvectors e : (M, N)."""
    x, weight = np.asarray(positions, float), 1 / np.sqrt(field.channel_noise)

    def of_block(m: slice) -> tuple[np.ndarray, np.ndarray]:
        p = np.asarray(corrected, complex)[m] * weight
        values, vectors = np.linalg.eigh(field_covariance(x, field, m, False)[0] * np.multiply.outer(weight, weight))
        along = np.conj(vectors.swapaxes(1, 2)) @ kernels.as_columns(p, vectors.dtype)
        return np.maximum(values, 0.0), np.sum(np.abs(along) ** 2, axis=2)

    found = [one for part in kernels.over_blocks(of_block, len(corrected), _largest(x, field)) for one in part]
    return np.concatenate([values for values, _ in found]), np.concatenate([along for _, along in found])
