"""The most likely noise, and the most likely power of the field and its dependence on direction.

With the eigendecomposition T^-1/2 K T^-1/2 = E diag(lambda) E^H (`fdcal.cost.likelihood.spectra`), the negative
log-likelihood is sum log(s lambda + v) + |e^H T^-1/2 q|^2 / (s lambda + v). A position error of RMS length e adds
noise of the power k^2 e^2 / dimension, relative to the field, since the pressure changes by its gradient times the
error. Inaccurate positions therefore explain the pressures better at low frequencies than at high ones.

Power s_m and channel noise tau_n are found by a fixed-point iteration on the derivative of the likelihood, which only
needs u = C^-1 q and d = diag C^-1. With gamma_m = N - v_m sum_n tau_n d_mn, the number of field coefficients that
mode m determines,

    s_m   <- s_m   (sum_n Re conj(u) q - v tau |u|^2) / gamma_m
    tau_n <- tau_n sum_m v_m tau_n |u_mn|^2 / sum_m v_m tau_n d_mn

An inverse gamma prior on s and tau acts like further observations of an expected value: it adds their sum to the
numerator, and their number to the denominator.

A row is one frequency of one take. The field of a row has the power S_q in direction q. It deviates from A_q, the power
in this direction that all rows of the take have in common. The covariance of a row is

    C = s W W^H + v diag(tau),    W[n, q] = sqrt(w_q S_q) exp(-j k x_n . u_q)      (`fdcal.cost.kernels.plane_waves`)

If all S_q are 1, the field is diffuse. The field in a room is not: the direct sound and the early reflections of one
source come from the same directions at every frequency, and each resonance consists of a few plane waves. Assuming a
diffuse field biases the positions, but a few microphones cannot determine the S_q of a single row. They are therefore
learned together with A_q. With

    alpha_q = s (W^H C^-1 p)_q,    r_q = s (W^H C^-1 W)_qq (at most 1), the number of observations of q in a row,

one step of expectation-maximisation for a single row is S_q <- S_q (|alpha_q|^2 / s + 1 - r_q). A_q follows from all
rows of the take by a step of majorisation-minimisation, which converges much faster if few microphones resolve the
directions poorly (Sun, Babu and Palomar, IEEE Trans. Signal Process. 65 (2017) 794):

    A_q <- A_q sqrt[(sum |alpha_q|^2 / s + c_q / A_q) / (sum r_q + c_q)],    c_q = ISOTROPY w_q sum_q sum r_q

Here c is the weight of an inverse gamma prior of mode 1. Without this prior, ever smaller arrays with ever sharper
directional spectra would fit the pressures. Finally S <- (S + count A) / (1 + count), where `count` is the weight of
the take. S and A have the mean 1.
"""

from dataclasses import dataclass

import numpy as np

from ..model.validation import Complexes, Integers, Numbers, Reals
from . import kernels
from .likelihood import FieldModel, Terms, spectra

MAX_NOISE_FRACTION = 0.7  # largest noise fraction of an estimate
# smallest noise fraction with the diffuse kernel, which leaves that fraction of a damped field unexplained
DIFFUSE_FLOOR = 1e-6


@dataclass(frozen=True)
class NoiseEstimate:
    """Noise and position error that explain the residual."""

    noise_fraction: float  # noise power divided by the mean power of the pressures
    spread: float  # metres, RMS length of the position error
    alone: float  # the noise fraction if the positions are assumed to have no error
    cost: float  # negative log-likelihood with `noise_fraction` and `spread`, up to a constant


def estimate_noise(positions: Reals, corrected: Numbers, field: FieldModel, min_fraction: float) -> NoiseEstimate:
    """Return the most likely noise and position error.

    `positions` (N, D), metres; `corrected` (M, N) pressures of unit mean power; `min_fraction` is the smallest noise
    fraction that is considered.
    """
    from scipy.optimize import minimize, minimize_scalar  # imported here: it takes longer to load than all solvers

    values, along = spectra(positions, corrected, field)
    values = values * field.power[:, None]
    slope, max_fraction = np.real(field.wavenumbers)[:, None] ** 2 / field.dimension, MAX_NOISE_FRACTION

    def cost(logs: Reals | tuple[float, float]) -> float:
        noise, variance = np.exp(logs)
        spectrum = values + np.minimum(noise + slope * variance, max_fraction)
        return float(np.sum(np.log(spectrum) + along / spectrum))

    top = float(slope.max())
    fractions, variances = ((float(np.log(min_fraction / x)), float(np.log(max_fraction / x))) for x in (1.0, top))
    grid: list[list[float]] = [np.linspace(low, high, 8).tolist() for low, high in (fractions, variances)]
    start = min(((a, b) for a in grid[0] for b in grid[1]), key=cost)
    options = {"xatol": 0.05, "fatol": 0.1}
    best = minimize(cost, start, method="Nelder-Mead", bounds=[fractions, variances], options=options)

    alone = minimize_scalar(lambda log: cost((log, variances[0])), bounds=fractions, method="bounded")
    noise, variance = np.exp(best.x)
    return NoiseEstimate(float(noise), float(np.sqrt(variance)), float(np.exp(alone.x)), float(best.fun))


MIN_POWER = 1e-3  # smallest expected power of the field, divided by the power of the pressures
# Largest power of the field, divided by its expected value. Without noise the covariance can be singular, and without
# this limit the power would then diverge.
MAX_POWER = 1e3


def expected_power(field: FieldModel, corrected: Numbers) -> np.ndarray:
    """Return the mean power of the corrected pressures minus the noise : (M,); noisy channels have less weight."""
    q2 = np.abs(corrected) ** 2
    weight = 1 / (1 + field.channel_noise * field.noise[:, None])
    mean = np.sum(weight * q2, axis=1) / np.sum(weight, axis=1)
    return np.maximum(mean - field.noise, MIN_POWER * mean)


POWER_COUNT = 2.0  # weight of the expected power, as a number of observations


def updated_power(field: FieldModel, terms: Terms) -> np.ndarray:
    """Return the power s (M,) of the field after one step of the fixed-point iteration."""
    v = field.noise[:, None] * field.channel_noise
    gamma = np.maximum(np.sum(1 - v * terms.precision, axis=1), 0.0)
    energy = np.sum(np.real(np.conj(terms.weighted) * terms.corrected) - v * np.abs(terms.weighted) ** 2, axis=1)
    expected, count = expected_power(field, terms.corrected), POWER_COUNT
    fresh = (field.power * np.maximum(energy, 0.0) + count * expected) / (gamma + count)
    return np.clip(fresh, 1e-2 * expected, MAX_POWER * expected)


CHANNEL_COUNT = 6.0  # weight of the expectation tau = 1, as a number of observations
# bounds on tau, the noise of a channel divided by v
MIN_CHANNEL_NOISE = 0.3
MAX_CHANNEL_NOISE = 1e6


def updated_channel_noise(field: FieldModel, terms: Terms) -> np.ndarray:
    """Return the relative noise tau (N,) of the channels, of median 1, after one step of the fixed-point iteration."""
    v, tau, count = field.noise[:, None], field.channel_noise, CHANNEL_COUNT
    left = tau * np.sum(v * terms.precision, axis=0)
    fresh = (tau**2 * np.sum(v * np.abs(terms.weighted) ** 2, axis=0) + count) / (left + count)
    return np.clip(fresh / np.median(fresh), MIN_CHANNEL_NOISE, MAX_CHANNEL_NOISE)


def hyper_cost(field: FieldModel, corrected: Numbers) -> float:
    """Return the negative log density of power and channel noise under their priors, up to a constant."""
    ratio, tau = expected_power(field, corrected) / field.power, field.channel_noise
    of_power = POWER_COUNT * np.sum(ratio - 1 - np.log(ratio))
    return float(of_power + CHANNEL_COUNT * np.sum(1 / tau - 1 + np.log(tau)))


ISOTROPY = 0.03  # weight of the prior of a diffuse field; values from 0.01 to 0.3 change the errors by less than 10 %


def learned_powers(
    x: Reals, pressures: Complexes, field: FieldModel, takes: Integers, iterations: int, count: float
) -> np.ndarray:
    """Return the power by direction (M, Q) float64 after `iterations` that start from `field.directions`.

    x : (N, D) float64, metres; pressures : (M, N) complex128; takes : (M,) int64, the take of each row; count : weight
    of A in S. `field.directions` must not be None.
    """
    powers = field.directions
    assert powers is not None
    k, weight, dimension = np.asarray(field.wavenumbers), 1 / np.sqrt(field.channel_noise), field.dimension
    x = field.offsets(x)
    p = weight * pressures / np.sqrt(field.power)[:, None]
    S, mu = np.array(powers, float), field.noise / field.power
    w = kernels.wave_directions(dimension, powers.shape[1])[1]
    if np.isrealobj(k) and len(w) > len(x):
        waves, explained = kernels.cosines_and_sines(x, k, len(w), dimension) * weight[:, None], _by_pairs
    else:
        waves = kernels.plane_waves(x, k, np.ones_like(S), dimension) * weight
        explained = _by_waves
    strength, resolved, rows = np.empty_like(S), np.empty_like(S), [takes == take for take in np.unique(takes)]
    for _ in range(iterations):
        for m in kernels.blocks(len(k), 2 * len(x) * len(w)):
            strength[m], resolved[m] = explained(waves[m], S[m], p[m], mu[m, None], dimension)
        own = S * (strength + 1 - resolved)
        own /= (own @ w)[:, None]
        for of_take in rows:
            A, found, seen = S[of_take].mean(axis=0), strength[of_take].sum(axis=0), resolved[of_take].sum(axis=0)
            c = ISOTROPY * w * seen.sum()
            A = A * np.sqrt((found + c / A) / (seen + c))
            S[of_take] = (own[of_take] + count * A / (A @ w)) / (1 + count)
    return S


def _by_waves(waves: Numbers, S: Reals, p: Complexes, mu: Reals, dimension: int) -> tuple[np.ndarray, np.ndarray]:
    """Return |alpha|^2 / s and r, (M, Q) each, for the power S (M, Q) by direction.

    waves : (M, Q, N), divided by the square root of the channels' noise; p : (M, N), pressures divided by that root and
    by sqrt(s); mu : (M, 1), v / s
    """
    W, n = waves * np.sqrt(S)[..., None], np.arange(int(waves.shape[2]))
    C = W.swapaxes(1, 2) @ np.conj(W)
    C[:, n, n] += mu
    X = np.linalg.inv(np.linalg.cholesky(C))
    Y = X @ W.swapaxes(1, 2)
    alpha = (np.conj(Y.swapaxes(1, 2)) @ (X @ p[..., None]))[..., 0]
    return np.abs(alpha) ** 2, np.minimum(np.sum(np.abs(Y) ** 2, axis=1), 1.0)


def _by_pairs(waves: Reals, S: Reals, p: Complexes, mu: Reals, dimension: int) -> tuple[np.ndarray, np.ndarray]:
    """Return what `_by_waves` returns, for undamped `waves` (M, N, Q) float64 in opposite pairs, in real arithmetic."""
    (M, N, Q), n = waves.shape, np.arange(int(waves.shape[1]))
    half, w = Q // 2, kernels.wave_directions(dimension, Q)[1]
    C = np.empty((M, N, N), complex)
    kernels.pair_covariance(waves, *kernels.pair_powers(S, dimension), C)
    C[:, n, n] += mu
    P = kernels.hermitian_inverses(C)[0]
    along = np.matmul(waves.swapaxes(1, 2), np.matmul(P, p[..., None]).view(float))  # real and imaginary part
    times_j = np.stack([-along[:, half:, 1], along[:, half:, 0]], axis=-1)
    amplitudes = np.concatenate([along[:, :half] + times_j, along[:, :half] - times_j], axis=1)
    own = np.sum(waves * np.matmul(np.real(P).copy(), waves), axis=1)
    own = own[:, :half] + own[:, half:]
    cross = 2 * np.sum(waves[..., :half] * np.matmul(np.imag(P).copy(), waves[..., half:]), axis=1)
    resolved = w * S * np.concatenate([own + cross, own - cross], axis=1)
    return w * S * np.sum(amplitudes**2, axis=-1), np.minimum(resolved, 1.0)
