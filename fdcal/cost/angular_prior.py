"""A prior of the field whose power by direction is learned from the pressures.

    C = s W W^H + v I,    W[n, q] = sqrt(w_q S_q) exp(-j k x_n . u_q)

u_q are the directions of `fdcal.cost.wave_directions`, w_q their weights; in the plane w_q = 1 / Q. S_q is the power
that comes from direction u_q, of weighted mean 1. With all S_q equal this is the diffuse field, J_0 or sin(z) / z. In a
room a mode is a few plane waves, and assuming a diffuse field biases the positions. With alpha = A^-1 W^H p the
coefficients and mu A^-1 their variance (`fdcal.cost.low_rank_terms`), one step of expectation and maximisation is

    S_q <- S_q (|alpha_q|^2 / s + mu (A^-1)_qq)

Of more directions than microphones, alpha = W^H C^-1 p and the variance 1 - (W^H s C^-1 W)_qq are the same.

Starting from a diffuse field, a few such steps sharpen the prior where the pressures support it; a weak bias remains.
With a prior of `count` observations that S_q is 1, the step is S_q <- (S_q (..) + count) / (1 + count).

A damped wave has a complex k; it has the amplitude 1 at the centre of the array. With all S_q equal W W^H is then the
covariance of `fdcal.cost.channel_kernels.series_kernel`. Waves of real k are faster (`fdcal.cost.opposite_waves`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .low_rank_covariance import LEAST_WEIGHT
from .low_rank_terms import low_rank_terms
from .mode_sums import ModeTerms, blocks, over_blocks, triangular_inverses
from .opposite_waves import cosines_and_sines, undamped_kernel, undamped_rule
from .wave_directions import direction_count, wave_directions

EXTRA_ORDERS = 6  # beyond ceil(k R), that the directions must resolve


def diffuse_prior(positions, wavenumbers, dimension: int = 2) -> np.ndarray:
    """Return the prior of a diffuse field, with enough directions for the array.

    Parameters
    ----------
    positions : (N, D) float64, metres
    wavenumbers : (M,) complex128 or float64, rad/m
    dimension : 2 or 3, of the sound field

    Returns
    -------
    (M, Q) float64, S, all 1
    """
    return np.ones((len(wavenumbers), directions_needed(positions, wavenumbers, dimension)))


def directions_needed(positions, wavenumbers, dimension: int) -> int:
    """Return how many directions resolve a field over the array; parameters as of `diffuse_prior`."""
    reach = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
    order = int(np.ceil(np.real(wavenumbers).max() * reach)) + EXTRA_ORDERS
    return direction_count(dimension, order)


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
    dimension: int = 2,
) -> np.ndarray:
    """Return the prior after a number of iterations of expectation and maximisation.

    Parameters
    ----------
    positions : (N, D) float64, metres
    pressures : (M, N) complex128
    wavenumbers : (M,) complex128 or float64, rad/m
    power, noise : (M,) float64, s and v, in the unit of abs(pressures)**2
    prior : (M, Q) float64, S to start from
    channel_noise : (N,) float64, noise of each channel over `noise`; 1 unless given
    count : float, observations that the field is diffuse
    about : (N, D) float64, metres, positions whose mean is the centre; `positions` unless given
    dimension : 2 or 3, of the sound field

    Returns
    -------
    (M, Q) float64
    """
    x, k = np.asarray(positions, float), np.asarray(wavenumbers)
    weight = np.ones(len(x)) if channel_noise is None else 1 / np.sqrt(channel_noise)
    x, p = x - np.mean(x if about is None else about, axis=0), weight * pressures / np.sqrt(power)[:, None]
    done, (Q, w), mu = [], (prior.shape[1], wave_directions(dimension, prior.shape[1])[1]), noise / power
    pairs = cosines_and_sines(x, k, Q, dimension) if np.isrealobj(k) and Q > len(x) else None
    for m in blocks(len(k), 2 * len(x) * Q):
        S = np.array(prior[m], float)
        if pairs is None:
            update = _update_rule(_plane_waves(x, k[m], Q, dimension) * weight, p[m], mu[m])
        else:
            update = undamped_rule(pairs[m] * weight[:, None], p[m], mu[m], dimension)
        for _ in range(iterations):
            fresh = S * update(S)
            S = (fresh / (fresh @ w)[:, None] + count) / (1 + count)
        done.append(S)
    return np.concatenate(done)


def _update_rule(waves, p, mu) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function that gives, of S (M, Q), the factor (M, Q) of one iteration.

    waves : (M, Q, N) over the square root of the channels' noise;  p : (M, N) over sqrt(s), likewise;  mu : (M,), v / s
    """
    solve = _coefficients if waves.shape[1] <= waves.shape[2] else _of_many

    def update(S):
        amplitude, variance = solve(waves * np.sqrt(S)[..., None], p, mu[:, None])
        return np.abs(amplitude) ** 2 + variance

    return update


def _coefficients(W, p, mu) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance (M, Q) of the waves' coefficients, of fewer waves than microphones."""
    WH, q = np.conj(W), np.arange(W.shape[1])
    A = WH @ W.swapaxes(1, 2)
    A[:, q, q] += mu
    X = triangular_inverses(np.linalg.cholesky(A))
    alpha = (np.conj(X.swapaxes(1, 2)) @ (X @ (WH @ p[..., None])))[..., 0]
    return alpha, mu * np.sum(np.abs(X) ** 2, axis=1)


def _of_many(W, p, mu) -> tuple[np.ndarray, np.ndarray]:
    """The same of more waves than microphones."""
    n = np.arange(W.shape[2])
    C = W.swapaxes(1, 2) @ np.conj(W)
    C[:, n, n] += mu
    X = triangular_inverses(np.linalg.cholesky(C))
    Y = X @ W.swapaxes(1, 2)
    alpha = (np.conj(Y.swapaxes(1, 2)) @ (X @ p[..., None]))[..., 0]
    return alpha, np.maximum(1 - np.sum(np.abs(Y) ** 2, axis=1), 0.0)


def plane_wave_kernel(positions, about, wavenumbers, prior, slope: bool = True, dimension: int = 2):
    """Return the covariance of a field of unit power whose power by direction is `prior`.

    Parameters
    ----------
    positions : (N, D) float64, metres
    about : (N, D) float64, metres, positions whose mean is the centre
    wavenumbers : (M,) float64 or complex128, rad/m
    prior : (M, Q) float64, S
    slope : bool
    dimension : 2 or 3, of the sound field

    Returns
    -------
    K : (M, N, N) complex128, Hermitian
    D : (D, M, N, N) complex128, 1/m, derivatives with respect to the first microphone; None unless wanted
    """
    x, k = np.asarray(positions, float) - np.mean(about, axis=0), np.asarray(wavenumbers)
    if np.isrealobj(k):
        return undamped_kernel(x, k, prior, slope, dimension)
    (N, axes), (M, Q) = x.shape, prior.shape
    K, D = np.empty((M, N, N), complex), np.empty((axes, M, N, N), complex) if slope else None
    for m in blocks(M, 2 * N * max(N, Q)):
        W, dW = weighted_waves(x, k[m], prior[m], slope, dimension)
        WH = np.conj(W)
        np.matmul(W.swapaxes(1, 2), WH, out=K[m])
        if D is not None and dW is not None:
            for derivative, along in zip(D, dW, strict=True):
                np.matmul(along.swapaxes(1, 2), WH, out=derivative[m])
    return K, D


def learned_terms(positions, pressures, wavenumbers, power, noise, prior, log_det: bool, derivatives=2) -> ModeTerms:
    """Return cost, gradient and curvature with the prior `prior` (M, Q) float64.

    The other parameters, and what is returned, are those of `fdcal.cost.low_rank_covariance.expansion_terms`.
    """
    x, k, p = np.asarray(positions, float), np.real(wavenumbers), np.asarray(pressures)
    x, Q = x - x.mean(axis=0), prior.shape[1]
    noise = np.maximum(noise, LEAST_WEIGHT * power)
    scale = 1 / noise if log_det else np.ones_like(noise)

    def of_block(m: slice) -> ModeTerms:
        W, dW = weighted_waves(x, k[m], prior[m], derivatives > 0)
        return low_rank_terms(W, dW, p[m], noise[m] / power[m], scale[m], float(log_det), derivatives)

    return over_blocks(of_block, len(k), 2 * len(x) * max(len(x), Q))


def weighted_waves(x, k, S, slope: bool, dimension: int = 2) -> tuple[np.ndarray, np.ndarray | None]:
    """Return W (M, Q, N) and, if wanted, its derivatives (D, M, Q, N), 1/m.

    x : (N, D) float64, metres, about the centre;  k : (M,), rad/m;  S : (M, Q) float64, power by direction
    """
    W = _plane_waves(x, k, S.shape[1], dimension) * np.sqrt(S)[..., None]
    if not slope:
        return W, None
    u, factor = wave_directions(dimension, S.shape[1])[0], -1j * k[:, None, None]
    dW = np.empty((x.shape[1], *W.shape), complex)
    for out, along in zip(dW, u, strict=False):  # a plane array has no third coordinate
        np.multiply(W, factor * along[:, None], out=out)
    return W, dW


def _plane_waves(x, k, Q: int, dimension: int) -> np.ndarray:
    """sqrt(w_q) exp(-j k x . u_q) : (M, Q, N) complex128."""
    u, w = wave_directions(dimension, Q)
    half, E = Q // 2, np.empty((len(k), Q, len(x)), complex)
    np.exp(np.multiply.outer(-1j * k, u[: x.shape[1], :half].T @ x.T), out=E[:, :half])
    if np.iscomplexobj(k):
        np.divide(1.0, E[:, :half], out=E[:, half:])
    else:
        np.conj(E[:, :half], out=E[:, half:])
    E *= np.sqrt(w)[:, None]
    return E
