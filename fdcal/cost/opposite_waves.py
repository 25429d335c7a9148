"""Plane waves of real wavenumbers in opposite pairs: their covariance, and their power, in real arithmetic.

With c = cos(k x . u_q), s = sin(k x . u_q), the waves c - j s of direction u_q and c + j s of the opposite direction,
and powers S_q and S'_q of weight w_q, the covariance of `fdcal.cost.angular_prior` is

    K_ij = sum_q a_q (c_i c_j + s_i s_j) + j b_q (c_i s_j - s_i c_j),    a = w (S + S'),    b = w (S - S')

over half the directions, which takes about a third of the operations of complex waves. A damped wave has no such pair.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from .mode_sums import blocks, hermitian_inverses
from .wave_directions import wave_directions


def cosines_and_sines(x, k, Q: int, dimension: int) -> np.ndarray:
    """cos and sin of k x . u of half the Q directions, side by side : (M, N, Q) float64, not to be written to.

    A solver that tries a step, learns the powers there and goes on from there needs the same waves three times: those
    of the last positions are kept.

    x : (N, D) float64, metres, about the centre;  k : (M,) float64, rad/m
    """
    return _waves_of(np.ascontiguousarray(x).tobytes(), np.ascontiguousarray(k).tobytes(), x.shape[1], Q, dimension)


@lru_cache(maxsize=1)
def _waves_of(places: bytes, wavenumbers: bytes, axes: int, Q: int, dimension: int) -> np.ndarray:
    x, k, half = np.frombuffer(places).reshape(-1, axes), np.frombuffer(wavenumbers), Q // 2
    along = x @ wave_directions(dimension, Q)[0][:axes, :half]
    waves = np.empty((len(k), len(x), Q))
    for m in blocks(len(k), len(x) * Q):
        phase = np.multiply.outer(k[m], along)
        np.cos(phase, out=waves[m, :, :half])
        np.sin(phase, out=waves[m, :, half:])
    waves.setflags(write=False)
    return waves


def undamped_kernel(x, k, prior, slope: bool, dimension: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Return covariance and slope of `fdcal.cost.angular_prior.plane_wave_kernel` for real wavenumbers.

    x : (N, D) float64, metres, about the centre;  k : (M,) float64, rad/m;  prior : (M, Q) float64, S
    """
    (N, axes), (M, Q) = x.shape, prior.shape
    K, D = np.empty((M, N, N), complex), np.empty((axes, M, N, N), complex) if slope else None
    u, of_modes = wave_directions(dimension, Q)[0], cosines_and_sines(x, k, Q, dimension)
    for m in blocks(M, N * max(N, Q)):
        waves, (a, b) = of_modes[m], _pair_powers(prior[m], dimension)
        _covariance(waves, a, b, K[m])
        for derivative, towards in zip(() if D is None else D, u, strict=False):  # a plane array has no third axis
            along = k[m, None] * towards[: Q // 2]
            _slope(waves, a * along, b * along, derivative[m])
    return K, D


def undamped_rule(waves, p, mu, dimension: int) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function that gives how much power each direction is found to have over S (M, Q) : (M, Q) float64.

    waves : (M, N, Q) float64, of `cosines_and_sines`, over the square root of the noise of the channels
    p : (M, N) complex128, pressures over sqrt(s), likewise;  mu : (M,) float64, v / s
    """
    (M, N, Q), n = waves.shape, np.arange(waves.shape[1])
    half, w = Q // 2, wave_directions(dimension, Q)[1]

    def update(S):
        C = np.empty((M, N, N), complex)
        _covariance(waves, *_pair_powers(S, dimension), C)
        C[:, n, n] += mu[:, None]
        P = hermitian_inverses(C)[0]
        along = np.matmul(waves.swapaxes(1, 2), np.matmul(P, p[..., None]).view(float))  # real and imaginary part
        turned = np.stack([-along[:, half:, 1], along[:, half:, 0]], axis=-1)
        amplitudes = np.concatenate([along[:, :half] + turned, along[:, :half] - turned], axis=1)
        own = np.sum(waves * np.matmul(np.real(P).copy(), waves), axis=1)
        own = own[:, :half] + own[:, half:]
        cross = 2 * np.sum(waves[..., :half] * np.matmul(np.imag(P).copy(), waves[..., half:]), axis=1)
        variance = 1 - w * S * np.concatenate([own + cross, own - cross], axis=1)
        return w * S * np.sum(amplitudes**2, axis=-1) + np.maximum(variance, 0.0)

    return update


def _pair_powers(prior, dimension: int) -> tuple[np.ndarray, np.ndarray]:
    """Weighted sum and difference (M, Q / 2) of the powers of opposite directions."""
    half = prior.shape[1] // 2
    weighted = wave_directions(dimension, prior.shape[1])[1] * prior
    return weighted[:, :half] + weighted[:, half:], weighted[:, :half] - weighted[:, half:]


def _covariance(waves, a, b, out) -> None:
    """K of the module, (M, N, N) complex128."""
    half = a.shape[1]
    weighted = waves * np.sqrt(np.concatenate([a, a], axis=1))[:, None]
    out.real = np.matmul(weighted, weighted.swapaxes(1, 2))
    crossed = np.matmul(waves[..., :half] * b[:, None], waves[..., half:].swapaxes(1, 2))
    out.imag = crossed - crossed.swapaxes(1, 2)


def _slope(waves, a, b, out) -> None:
    """Derivative of K (M, N, N) by one coordinate of the first microphone; a and b times that coordinate of k u."""
    half = a.shape[1]
    crossed = np.matmul(waves[..., :half] * a[:, None], waves[..., half:].swapaxes(1, 2))
    out.real = crossed - crossed.swapaxes(1, 2)
    both = np.concatenate([b, b], axis=1)
    out.imag = -np.matmul(waves * both[:, None], waves.swapaxes(1, 2))
