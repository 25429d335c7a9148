"""A prior of the field whose power by direction is learned from the pressures, in two dimensions.

    C = s W W^H + v I,    W[n, q] = sqrt(S_q / Q) exp(-j k (x_n cos t_q + y_n sin t_q)),
    t_q = 2 pi q / Q

S_q is the power that comes from direction t_q, mean 1. With all S_q equal this is the diffuse field, J_0. In a room a
mode is a few plane waves, and assuming a diffuse field biases the positions. With alpha = A^-1 W^H p the coefficients
and mu A^-1 their variance (`fdcal.cost.newton_kernels`), one step of expectation and maximisation is

    S_q <- S_q (|alpha_q|^2 / s + mu (A^-1)_qq)

Starting from a diffuse field, a few such steps sharpen the prior where the pressures support it; a weak bias remains.
With a prior of `count` observations that S_q is 1, the step is S_q <- (S_q (..) + count) / (1 + count).

A damped wave has a complex k; it has the amplitude 1 at the centre of the array. With all S_q equal W W^H is then the
covariance of `fdcal.cost.channel_kernels.series_kernel`.
"""

from __future__ import annotations

import numpy as np

from ..acoustics.compiled import adjoint, compiled, lower_inverse, sum_over_modes, writable
from .low_rank_covariance import LEAST_WEIGHT
from .newton_kernels import add_mode

EXTRA_ORDERS = 6  # beyond ceil(k R), that the directions must resolve


def diffuse_prior(positions, wavenumbers) -> np.ndarray:
    """Return the prior of a diffuse field, with enough directions for the array.

    Parameters
    ----------
    positions : (N, 2) float64, metres
    wavenumbers : (M,) complex128 or float64, rad/m

    Returns
    -------
    (M, Q) float64, S, all 1
    """
    reach = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
    return np.ones((len(wavenumbers), 2 * (int(np.ceil(np.real(wavenumbers).max() * reach)) + EXTRA_ORDERS)))


def learned_prior(
    positions,
    pressures,
    wavenumbers,
    power,
    noise,
    prior,
    iterations: int,
    channel_noise=None,
    count: float = 0.0,
    about=None,
) -> np.ndarray:
    """Return the prior after a number of iterations of expectation and maximisation.

    Parameters
    ----------
    positions : (N, 2) float64, metres
    pressures : (M, N) complex128
    wavenumbers : (M,) complex128 or float64, rad/m
    power, noise : (M,) float64, s and v, in the unit of abs(pressures)**2
    prior : (M, Q) float64, S to start from
    channel_noise : (N,) float64, noise of each channel over `noise`; 1 unless given
    count : float, observations that the field is diffuse
    about : (N, 2) float64, metres, positions whose mean is the centre; `positions` unless given

    Returns
    -------
    (M, Q) float64
    """
    x = writable(positions, float)
    S = np.array(prior, float)
    weight = np.ones(len(x)) if channel_noise is None else 1 / np.sqrt(channel_noise)
    p, k = writable(weight * pressures, complex), writable(wavenumbers, complex)
    centre = np.mean(x if about is None else about, axis=0)
    _learn(x - centre, weight, p, k, writable(power), writable(noise), S, iterations, float(count))
    return S


def plane_wave_kernel(positions, about, wavenumbers, prior, slope: bool = True):
    """Return the covariance of a field of unit power whose power by direction is `prior`.

    Parameters
    ----------
    positions : (N, 2) float64, metres
    about : (N, 2) float64, metres, positions whose mean is the centre
    wavenumbers : (M,) float64 or complex128, rad/m
    prior : (M, Q) float64, S
    slope : bool

    Returns
    -------
    K : (M, N, N) complex128, Hermitian
    D : (2, M, N, N) complex128, 1/m, derivatives with respect to the first microphone; None unless wanted
    """
    x = writable(positions, float) - np.mean(about, axis=0)
    N, M = len(x), len(prior)
    K = np.empty((M, N, N), complex)
    D = np.empty((2, M, N, N) if slope else (2, M, 0, 0), complex)
    _plane_wave_kernel(x, writable(wavenumbers, complex), writable(prior, float), slope, K, D)
    return K, (D if slope else None)


def learned_terms(positions, pressures, wavenumbers, power, noise, prior, log_det: bool, derivatives=2):
    """Return cost, gradient and curvature with the prior `prior` (M, Q) float64.

    The other parameters, and what is returned, are those of `fdcal.cost.low_rank_covariance.expansion_terms`.
    """
    x = writable(positions, float)
    noise = np.maximum(noise, LEAST_WEIGHT * power)
    scale = 1 / noise if log_det else np.ones_like(noise)
    p, k = writable(pressures, complex), writable(np.real(wavenumbers), complex)
    modes = p, k, prior, noise / power, scale
    return sum_over_modes(_modes, (x - x.mean(axis=0),), modes, (float(log_det), derivatives), derivatives)


@compiled
def _modes(x, p, k, prior, mu, scale, log_det, derivatives, cost, gradient, H):
    W = np.empty((len(x), prior.shape[1]), np.complex128)
    dW = np.empty((2, len(x), prior.shape[1]), np.complex128)
    for m in range(len(k)):
        _plane_waves(x, k[m], prior[m], W, dW)
        add_mode(W, dW, p[m], mu[m], scale[m], log_det, derivatives, cost, gradient, H)


@compiled
def _plane_waves(x, k, S, W, dW):
    Q = len(S)
    for q in range(Q):
        c, s = np.cos(2 * np.pi * q / Q), np.sin(2 * np.pi * q / Q)
        root = np.sqrt(S[q] / Q)
        for n in range(len(x)):
            along = x[n, 0] * c + x[n, 1] * s
            phase = k.real * along
            W[n, q] = root * np.exp(k.imag * along) * (np.cos(phase) - 1j * np.sin(phase))
            dW[0, n, q], dW[1, n, q] = -1j * k * c * W[n, q], -1j * k * s * W[n, q]


@compiled
def _plane_wave_kernel(x, k, prior, slope, K, D):
    W = np.empty((len(x), prior.shape[1]), np.complex128)
    dW = np.empty((2, len(x), prior.shape[1]), np.complex128)
    for m in range(len(k)):
        _plane_waves(x, k[m], prior[m], W, dW)
        WH = adjoint(W)
        K[m] = W @ WH
        if slope:
            for a in range(2):
                D[a, m] = dW[a] @ WH


@compiled
def _learn(x, weight, p, k, power, noise, prior, iterations, count):
    Q = prior.shape[1]
    W, dW = np.empty((len(x), Q), np.complex128), np.empty((2, len(x), Q), np.complex128)
    for m in range(len(k)):
        mu = noise[m] / power[m]
        for _ in range(iterations):
            _plane_waves(x, k[m], prior[m], W, dW)
            for n in range(len(x)):
                W[n] *= weight[n]
            WH = adjoint(W)
            A = WH @ W
            for q in range(Q):
                A[q, q] += mu
            X = lower_inverse(np.linalg.cholesky(A))
            alpha = np.conj(X.T) @ (X @ (WH @ p[m]))
            total = 0.0
            for q in range(Q):
                variance = 0.0
                for i in range(q, Q):
                    variance += abs(X[i, q]) ** 2
                prior[m, q] *= abs(alpha[q]) ** 2 / power[m] + mu * variance
                total += prior[m, q]
            for q in range(Q):
                prior[m, q] = (prior[m, q] * Q / total + count) / (1 + count)
