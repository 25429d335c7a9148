"""The power of the field by direction: that of a take, common to its rows, and how each row deviates from it.

    C = s W W^H + v diag(tau),    W[n, q] = sqrt(w_q S_q) exp(-j k x_n . u_q)      (`fdcal.cost.kernels.plane_waves`)

With all S_q = 1 this is the diffuse field. A room is not diffuse: the direct sound and the early reflections of one
source come from the same directions A_q at every frequency, and a resonance is a few plane waves of its own. Assuming a
diffuse field biases the positions; a spectrum for each row alone is more than few microphones can tell. With

    alpha_q = W^H C^-1 p,    r_q = (W^H s C^-1 W)_qq, the part of an observation that a row is of direction q,

one step of expectation and maximisation of a row by itself is S_q <- S_q (|alpha_q|^2 / s + 1 - r_q). The spectrum of a
take follows from all its rows by a step of majorisation and minimisation, which is much faster where few microphones
resolve little (Sun, Babu and Palomar, IEEE Trans. Signal Process. 65 (2017) 794):

    A_q <- A_q sqrt[(sum |alpha_q|^2 / s + c_q / A_q) / (sum r_q + c_q)],    c_q = ISOTROPY w_q sum_q sum r_q

c is an inverse gamma prior of mode 1: without it ever sharper spectra explain ever smaller arrays. Then
S <- (S + count A) / (1 + count): `count` observations that a row is like its take. Both have the mean 1.

(Of fewer directions than microphones: alpha = A^-1 W^H p, 1 - r_q = mu (A^-1)_qq, A = W^H W + mu I, mu = v / s.)
"""

import numpy as np

from ..model.types import Complexes, Integers, Numbers, Reals
from .batches import blocks, hermitian_inverses, triangular_inverses
from .kernels import cosines_and_sines, pair_covariance, pair_powers, plane_waves, wave_directions
from .likelihood import FieldModel

ISOTROPY = 0.03  # observations of a diffuse field, over those of the take; 0.01 to 0.3 give the same errors to 10 %


def learned_powers(
    x: Reals, pressures: Complexes, field: FieldModel, takes: Integers, iterations: int, count: float
) -> np.ndarray:
    """Return the power by direction (M, Q) float64 after some iterations from that of `field`.

    x : (N, D) float64, metres; pressures : (M, N) complex128; takes : (M,) int64, of each row; count : observations
    that the spectrum of a row is that of its take. Raises ValueError for a field without directions.
    """
    if (powers := field.directions) is None:
        raise ValueError("the field has no directions")
    k, weight, dimension = np.asarray(field.wavenumbers), 1 / np.sqrt(field.channel_noise), field.dimension
    x = x - np.mean(x if field.about is None else field.about, axis=0)
    p = weight * pressures / np.sqrt(field.power)[:, None]
    S, w, mu = np.array(powers, float), wave_directions(dimension, powers.shape[1])[1], field.noise / field.power
    if np.isrealobj(k) and len(w) > len(x):
        waves, explained = cosines_and_sines(x, k, len(w), dimension) * weight[:, None], _by_pairs
    else:
        waves = plane_waves(x, k, np.ones_like(S), False, dimension)[0] * weight
        explained = _by_few if len(w) <= len(x) else _by_many
    strength, resolved, rows = np.empty_like(S), np.empty_like(S), [takes == take for take in np.unique(takes)]
    for _ in range(iterations):
        for m in blocks(len(k), 2 * len(x) * len(w)):
            strength[m], resolved[m] = explained(waves[m], S[m], p[m], mu[m, None], dimension)
        own = S * (strength + 1 - resolved)
        own /= (own @ w)[:, None]
        for of_take in rows:
            A, found, seen = S[of_take].mean(axis=0), strength[of_take].sum(axis=0), resolved[of_take].sum(axis=0)
            c = ISOTROPY * w * seen.sum()
            A = A * np.sqrt((found + c / A) / (seen + c))
            S[of_take] = (own[of_take] + count * A / (A @ w)) / (1 + count)
    return S


def _by_few(waves: Numbers, S: Reals, p: Complexes, mu: Reals, dimension: int) -> tuple[np.ndarray, np.ndarray]:
    """Return |alpha|^2 / s and r, (M, Q) each, at S (M, Q), for fewer waves than microphones.

    waves : (M, Q, N) over the square root of the channels' noise; p : (M, N) over sqrt(s), likewise; mu : (M, 1), v / s
    """
    W, q = waves * np.sqrt(S)[..., None], np.arange(int(waves.shape[1]))
    WH = np.conj(W)
    A = WH @ W.swapaxes(1, 2)
    A[:, q, q] += mu
    X = triangular_inverses(np.linalg.cholesky(A))
    alpha = (np.conj(X.swapaxes(1, 2)) @ (X @ (WH @ p[..., None])))[..., 0]
    return np.abs(alpha) ** 2, 1 - mu * np.sum(np.abs(X) ** 2, axis=1)


def _by_many(waves: Numbers, S: Reals, p: Complexes, mu: Reals, dimension: int) -> tuple[np.ndarray, np.ndarray]:
    """The same of more waves than microphones."""
    W, n = waves * np.sqrt(S)[..., None], np.arange(int(waves.shape[2]))
    C = W.swapaxes(1, 2) @ np.conj(W)
    C[:, n, n] += mu
    X = triangular_inverses(np.linalg.cholesky(C))
    Y = X @ W.swapaxes(1, 2)
    alpha = (np.conj(Y.swapaxes(1, 2)) @ (X @ p[..., None]))[..., 0]
    return np.abs(alpha) ** 2, np.minimum(np.sum(np.abs(Y) ** 2, axis=1), 1.0)


def _by_pairs(waves: Reals, S: Reals, p: Complexes, mu: Reals, dimension: int) -> tuple[np.ndarray, np.ndarray]:
    """The same of undamped waves in opposite pairs, in real arithmetic; `waves` (M, N, Q) float64."""
    (M, N, Q), n = waves.shape, np.arange(int(waves.shape[1]))
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
