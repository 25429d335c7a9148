"""The power of the field by direction, learned from the pressures of each mode.

    C = s W W^H + v diag(tau),    W[n, q] = sqrt(w_q S_q) exp(-j k x_n . u_q)      (`fdcal.cost.waves.plane_waves`)

With all S_q = 1 this is the diffuse field. In a room a mode is a few plane waves, and assuming a diffuse field biases
the positions. One step of expectation and maximisation is

    S_q <- S_q (|alpha_q|^2 / s + var_q),    alpha = W^H C^-1 p,    var_q = 1 - (W^H s C^-1 W)_qq

(the same of fewer directions than microphones: alpha = A^-1 W^H p, var_q = mu (A^-1)_qq, A = W^H W + mu I, mu = v / s).
Starting from a diffuse field, a few such steps sharpen the spectrum where the pressures support it. With a prior of
`count` observations that S_q is 1, the step is S_q <- (S_q (..) + count) / (1 + count).
"""

from __future__ import annotations

import numpy as np

from .batches import blocks, hermitian_inverses, triangular_inverses
from .kernels import cosines_and_sines, pair_covariance, pair_powers
from .likelihood import FieldModel
from .waves import plane_waves, wave_directions


import os
LAB=eval(os.environ.get("FD","{}"))
def learned_powers(x, pressures, field: FieldModel, iterations: int, count: float, takes=None) -> np.ndarray:
    """LAB"""
    if (powers := field.directions) is None:
        raise ValueError("the field has no directions")
    k, weight, dimension = np.asarray(field.wavenumbers), 1 / np.sqrt(field.channel_noise), field.dimension
    x = x - np.mean(x if field.about is None else field.about, axis=0)
    p = weight * pressures / np.sqrt(field.power)[:, None]
    (Q, w), mu = (powers.shape[1], wave_directions(dimension, powers.shape[1])[1]), field.noise / field.power
    pairs = cosines_and_sines(x, k, Q, dimension) if np.isrealobj(k) and Q > len(x) else None
    rules = []
    for m in blocks(len(k), 2 * len(x) * Q):
        if pairs is None:
            waves = plane_waves(x, k[m], np.ones_like(powers[m]), False, dimension)[0] * weight
            factor = _of_few if waves.shape[1] <= waves.shape[2] else _of_many
        else:
            waves, factor = pairs[m] * weight[:, None], _of_pairs
        rules.append((m, waves, factor))
    S = np.array(powers, float)
    c1, rho = LAB.get(dimension, (0.0, 0.1))
    takes = np.zeros(len(k), int) if takes is None else takes
    for _ in range(iterations):
        amp, res = np.empty_like(S), np.empty_like(S)
        for m, waves, factor in rules:
            amp[m], res[m] = factor(waves, S[m], p[m], mu[m, None], dimension)
        fresh = S * (amp + 1 - res)
        fresh /= (fresh @ w)[:, None]
        if not LAB:
            S = (fresh + count) / (1 + count)
            continue
        for t in np.unique(takes):
            r = takes == t
            A = S[r].mean(axis=0)
            n, d = amp[r].sum(axis=0), res[r].sum(axis=0)
            c0 = rho * np.sum(d) * w
            A = A * np.sqrt((n + c0 / A) / (d + c0))
            A /= A @ w
            S[r] = A if c1 == np.inf else (fresh[r] + c1 * A) / (1 + c1)
    return S


def _of_few(waves, S, p, mu, dimension: int) -> np.ndarray:
    """Return the factor (M, Q) of S (M, Q) of one iteration, for fewer waves than microphones.

    waves : (M, Q, N) over the square root of the channels' noise; p : (M, N) over sqrt(s), likewise; mu : (M, 1), v / s
    """
    W, q = waves * np.sqrt(S)[..., None], np.arange(waves.shape[1])
    WH = np.conj(W)
    A = WH @ W.swapaxes(1, 2)
    A[:, q, q] += mu
    X = triangular_inverses(np.linalg.cholesky(A))
    alpha = (np.conj(X.swapaxes(1, 2)) @ (X @ (WH @ p[..., None])))[..., 0]
    return np.abs(alpha) ** 2, 1 - mu * np.sum(np.abs(X) ** 2, axis=1)


def _of_many(waves, S, p, mu, dimension: int) -> np.ndarray:
    """The same of more waves than microphones."""
    W, n = waves * np.sqrt(S)[..., None], np.arange(waves.shape[2])
    C = W.swapaxes(1, 2) @ np.conj(W)
    C[:, n, n] += mu
    X = triangular_inverses(np.linalg.cholesky(C))
    Y = X @ W.swapaxes(1, 2)
    alpha = (np.conj(Y.swapaxes(1, 2)) @ (X @ p[..., None]))[..., 0]
    return np.abs(alpha) ** 2, np.minimum(np.sum(np.abs(Y) ** 2, axis=1), 1.0)


def _of_pairs(waves, S, p, mu, dimension: int) -> np.ndarray:
    """The same of undamped waves in opposite pairs, in real arithmetic; `waves` (M, N, Q) float64."""
    (M, N, Q), n = waves.shape, np.arange(waves.shape[1])
    half, w = Q // 2, wave_directions(dimension, Q)[1]
    C = np.empty((M, N, N), complex)
    pair_covariance(waves, *pair_powers(S, dimension), C)
    C[:, n, n] += mu
    P = hermitian_inverses(C)[0]
    along = np.matmul(waves.swapaxes(1, 2), np.matmul(P, p[..., None]).view(float))  # real and imaginary part
    turned = np.stack([-along[:, half:, 1], along[:, half:, 0]], axis=-1)
    amplitudes = np.concatenate([along[:, :half] + turned, along[:, :half] - turned], axis=1)
    own = np.sum(waves * np.matmul(np.real(P).copy(), waves), axis=1)
    own = own[:, :half] + own[:, half:]
    cross = 2 * np.sum(waves[..., :half] * np.matmul(np.imag(P).copy(), waves[..., half:]), axis=1)
    resolved = w * S * np.concatenate([own + cross, own - cross], axis=1)
    return w * S * np.sum(amplitudes**2, axis=-1), np.minimum(resolved, 1.0)
