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

With `ChannelField.conditional` the cost is that of `fdcal.cost.conditional_likelihood`, and this one beside it.

In the plane K consists of few waves (`fdcal.cost.channel_low_rank`) unless the array is of many wavelengths; in space,
and then, C is factorised itself (`fdcal.cost.channel_dense`).
"""

from __future__ import annotations

import numpy as np

from .channel_dense import channel_kernel, dense_channel_terms
from .channel_field import ChannelField, Terms
from .channel_low_rank import few_waves, low_rank_channel_terms, low_rank_spectra
from .conditional_likelihood import conditional_terms, joined

__all__ = ["ChannelField", "Terms", "channel_spectra", "channel_terms", "log_response"]


def channel_terms(positions, gains, pressures, field: ChannelField, derivatives: int = 2) -> Terms:
    """Cost at `positions` (N, D), metres, and `gains` (N, 2) or (N, 4) of `pressures` (M, N).

    gains : a, nepers, b, radians, and if there are four of them d, metres, and kappa, rad/m
    derivatives : 0 for the cost, 2 with gradient and curvature, 3 with the gradient of every mode, too

    Raises numpy.linalg.LinAlgError where a covariance is not positive definite.
    """
    x = np.asarray(positions, float)
    log_gain, by_parameter = log_response(gains, np.real(field.wavenumbers))
    q = pressures * np.exp(-log_gain)
    few = few_waves(x, field)
    if few is None:
        random = dense_channel_terms(x, q, log_gain, by_parameter, field, derivatives)
    else:
        random = low_rank_channel_terms(*few, q, log_gain, by_parameter, field, derivatives)
    if field.conditional is None:
        return random
    conditional = conditional_terms(x, q, log_gain, by_parameter, field, field.conditional, derivatives)
    return joined(conditional, random, field.conditional.weight)


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


def channel_spectra(positions, corrected, field: ChannelField) -> tuple[np.ndarray, np.ndarray]:
    """Return eigenvalues of T^-1/2 K T^-1/2, T = diag(tau), and |e^H T^-1/2 q|^2 along its eigenvectors e.

    Parameters
    ----------
    positions : (N, D) float64, metres
    corrected : (M, N) complex128, q
    field : ChannelField

    Returns
    -------
    two (M, N) float64 arrays
    """
    x, weight = np.asarray(positions, float), 1 / np.sqrt(field.channel_noise)
    few = few_waves(x, field)
    if few is not None:
        return low_rank_spectra(*few, corrected, weight)
    values, vectors = np.linalg.eigh(channel_kernel(x, field, False)[0] * np.multiply.outer(weight, weight))
    along = np.abs(np.einsum("mij,mi->mj", np.conj(vectors), corrected * weight)) ** 2
    return np.maximum(values, 0.0), along
