"""The noise and the power of the field that make the pressures most likely at given positions.

Of an eigen-decomposition T^-1/2 K T^-1/2 = E diag(lambda) E^H (`fdcal.cost.likelihood.spectra`), -log likelihood is
sum log(s lambda + v) + |e^H T^-1/2 q|^2 / (s lambda + v). An error e of a microphone adds the noise
k^2 e^2 / dimension, the power of the field's gradient: at rough positions the high modes are hard to explain and the
low ones are not.

Power s_m and channel noise tau_n follow from a fixed point of the likelihood's derivative, which needs u = C^-1 q and
d = diag C^-1 alone. With gamma_m = N - v_m sum_n tau_n d_mn, the number of field coefficients that mode m determines,

    s_m   <- s_m   (sum_n Re conj(u) q - v tau |u|^2) / gamma_m
    tau_n <- tau_n sum_m v_m |u_mn|^2 / sum_m v_m d_mn

An inverse gamma prior adds so many observations of an expected value to the numerator and the denominator.
"""

from dataclasses import dataclass

import numpy as np

from ..model.types import Numbers, Reals
from .likelihood import FieldModel, Terms, spectra

MAX_NOISE_FRACTION = 0.7  # of the noise


DIFFUSE_FLOOR = (
    1e-6  # least fraction of noise with the diffuse kernel, which leaves that much of a damped field unexplained
)


@dataclass(frozen=True)
class NoiseEstimate:
    """What the pressures leave unexplained at given positions."""

    noise_fraction: float  # noise over the mean power
    spread: float  # metres, error of the positions beside it
    alone: float  # noise over the mean power where the positions have no error
    cost: float  # -log likelihood with `noise_fraction` and `spread`, up to a constant


def estimate_noise(positions: Reals, corrected: Numbers, field: FieldModel, min_share: float) -> NoiseEstimate:
    """Return the noise and the position error of greatest likelihood; `corrected` (M, N) has unit mean power."""
    from scipy.optimize import minimize, minimize_scalar  # takes longer to load than the rest of the solvers

    values, along = spectra(positions, corrected, field)
    values = values * field.power[:, None]
    slope, max_share = np.real(field.wavenumbers)[:, None] ** 2 / field.dimension, MAX_NOISE_FRACTION

    def cost(logs: Reals | tuple[float, float]) -> float:
        noise, variance = np.exp(logs)
        spectrum = values + np.minimum(noise + slope * variance, max_share)
        return float(np.sum(np.log(spectrum) + along / spectrum))

    top = float(slope.max())
    shares, variances = ((float(np.log(min_share / x)), float(np.log(max_share / x))) for x in (1.0, top))
    grid: list[list[float]] = [np.linspace(low, high, 8).tolist() for low, high in (shares, variances)]
    start = min(((a, b) for a in grid[0] for b in grid[1]), key=cost)
    options = {"xatol": 0.05, "fatol": 0.1}
    best = minimize(cost, start, method="Nelder-Mead", bounds=[shares, variances], options=options)

    def without_spread(log: float) -> float:
        return cost((log, variances[0]))

    alone = minimize_scalar(without_spread, bounds=shares, method="bounded")
    noise, variance = np.exp(best.x)
    return NoiseEstimate(float(noise), float(np.sqrt(variance)), float(np.exp(alone.x)), float(best.fun))


# of the field over that of the pressures: without noise a singular covariance would let it grow without bound
MIN_POWER = 1e-3
MAX_POWER = 1e3


def expected_power(field: FieldModel, corrected: Numbers) -> np.ndarray:
    """Mean power of the corrected pressures less the noise (M,); noisy channels count less."""
    q2 = np.abs(corrected) ** 2
    weight = 1 / (1 + field.channel_noise * field.noise[:, None])
    mean = np.sum(weight * q2, axis=1) / np.sum(weight, axis=1)
    return np.maximum(mean - field.noise, MIN_POWER * mean)


POWER_COUNT = 2.0  # observations that the mean power of the pressures is worth


def updated_power(field: FieldModel, terms: Terms) -> np.ndarray:
    """Power of the field (M,), s, after one round of the fixed point."""
    v = field.noise[:, None] * field.channel_noise
    gamma = np.maximum(np.sum(1 - v * terms.precision, axis=1), 0.0)
    energy = np.sum(np.real(np.conj(terms.weighted) * terms.corrected) - v * np.abs(terms.weighted) ** 2, axis=1)
    expected, count = expected_power(field, terms.corrected), POWER_COUNT
    fresh = (field.power * np.maximum(energy, 0.0) + count * expected) / (gamma + count)
    return np.clip(fresh, 1e-2 * expected, MAX_POWER * expected)


CHANNEL_COUNT = 6.0  # observations that a channel is like the others
# of a channel over that of the array
MIN_CHANNEL_NOISE = 0.3
MAX_CHANNEL_NOISE = 1e6


def updated_channel_noise(field: FieldModel, terms: Terms) -> np.ndarray:
    """Noise of every channel over that of the array (N,), tau, of median 1, after one round of the fixed point."""
    v, tau, count = field.noise[:, None], field.channel_noise, CHANNEL_COUNT
    left = tau * np.sum(v * terms.precision, axis=0)
    seen = tau**2 * np.sum(v * np.abs(terms.weighted) ** 2, axis=0)
    fresh = (seen + count) / (left + count)
    return np.clip(fresh / np.median(fresh), MIN_CHANNEL_NOISE, MAX_CHANNEL_NOISE)


def hyper_cost(field: FieldModel, corrected: Numbers) -> float:
    """-log density of power and channel noise by their priors, up to a constant."""
    ratio, tau = expected_power(field, corrected) / field.power, field.channel_noise
    of_power = POWER_COUNT * np.sum(ratio - 1 - np.log(ratio))
    return float(of_power + CHANNEL_COUNT * np.sum(1 / tau - 1 + np.log(tau)))


# greatest factor on the power of the field where two kernels are compared, and how many
MAX_PROFILED = 1e4
PROFILED = 33


def profile_cost(positions: Reals, corrected: Numbers, field: FieldModel, noise: float) -> float:
    """Return -log likelihood of corrected pressures (M, N) with each mode's likeliest power; noise : noise fraction."""
    values, along = spectra(positions, corrected, field)
    powers = np.geomspace(1 / MAX_PROFILED, MAX_PROFILED, PROFILED)
    mixed = np.multiply.outer(powers, values * field.power[:, None]) + noise
    return float((np.log(mixed) + along / mixed).sum(axis=2).min(axis=0).sum())
