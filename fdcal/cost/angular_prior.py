"""A prior of the field whose power by direction is learned from the pressures, in two dimensions.

    C = s W W^H + v I,    W[n, q] = sqrt(S_q / Q) exp(-j k (x_n cos t_q + y_n sin t_q)),
    t_q = 2 pi q / Q

S_q is the power that comes from direction t_q, mean 1. With all S_q equal this is the diffuse field, J_0. In a room a
mode is a few plane waves, and assuming a diffuse field biases the positions. With alpha = A^-1 W^H p the coefficients
and mu A^-1 their variance (`fdcal.cost.newton_kernels`), one step of expectation and maximisation is

    S_q <- S_q (|alpha_q|^2 / s + mu (A^-1)_qq)

Starting from a diffuse field, a few such steps sharpen the prior where the pressures support it; a weak bias remains.
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


def learned_prior(positions, pressures, wavenumbers, power, noise, prior, iterations: int) -> np.ndarray:
    """Return the prior after a number of iterations of expectation and maximisation.

    Parameters
    ----------
    positions : (N, 2) float64, metres
    pressures : (M, N) complex128
    wavenumbers : (M,) complex128 or float64, rad/m; the real parts count
    power, noise : (M,) float64, s and v, in the unit of abs(pressures)**2
    prior : (M, Q) float64, S to start from

    Returns
    -------
    (M, Q) float64
    """
    x = writable(positions, float)
    S = np.array(prior, float)
    k = writable(np.real(wavenumbers))
    _learn(x - x.mean(axis=0), writable(pressures, complex), k, writable(power), writable(noise), S, iterations)
    return S


def learned_terms(positions, pressures, wavenumbers, power, noise, prior, log_det: bool, derivatives=2):
    """Return cost, gradient and curvature with the prior `prior` (M, Q) float64.

    The other parameters, and what is returned, are those of `fdcal.cost.low_rank_covariance.expansion_terms`.
    """
    x = writable(positions, float)
    noise = np.maximum(noise, LEAST_WEIGHT * power)
    scale = 1 / noise if log_det else np.ones_like(noise)
    p, k = writable(pressures, complex), writable(np.real(wavenumbers))
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
            phase = k * (x[n, 0] * c + x[n, 1] * s)
            W[n, q] = root * (np.cos(phase) - 1j * np.sin(phase))
            dW[0, n, q], dW[1, n, q] = -1j * k * c * W[n, q], -1j * k * s * W[n, q]


@compiled
def _learn(x, p, k, power, noise, prior, iterations):
    Q = prior.shape[1]
    W, dW = np.empty((len(x), Q), np.complex128), np.empty((2, len(x), Q), np.complex128)
    for m in range(len(k)):
        mu = noise[m] / power[m]
        for _ in range(iterations):
            _plane_waves(x, k[m], prior[m], W, dW)
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
                prior[m, q] *= Q / total
