"""Maximum-likelihood updates of what is not a parameter of the array: power, noise, channel noise, prior spreads.

Each is a fixed point of the likelihood's derivative and needs u = C^-1 q, d = diag C^-1 alone. With
gamma_m = N - v_m sum_n tau_n d_mn, the number of field coefficients that mode m determines,

    s_m   <- s_m   (sum_n Re conj(u) q - v tau |u|^2) / gamma_m
    tau_n <- tau_n sum_m v_m |u_mn|^2 / sum_m v_m d_mn

An inverse gamma prior adds so many observations of an expected value to the numerator and the denominator.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...cost.channel_likelihood import ChannelField, Terms, channel_spectra
from .objective import spring
from .settings import NOISE_RULES


def expected_power(field: ChannelField, corrected) -> np.ndarray:
    """Mean power of the corrected pressures less the noise (M,); noisy channels count less."""
    q2 = np.abs(corrected) ** 2
    sound = 1 / (1 + field.channel_noise * field.noise[:, None])
    mean = np.sum(sound * q2, axis=1) / np.sum(sound, axis=1)
    return np.maximum(mean - field.noise, NOISE_RULES.least_power * mean)


def updated_power(field: ChannelField, terms: Terms) -> np.ndarray:
    """Power of the field (M,), s."""
    v = field.noise[:, None] * field.channel_noise
    gamma = np.maximum(np.sum(1 - v * terms.precision, axis=1), 0.0)
    energy = np.sum(np.real(np.conj(terms.weighted) * terms.corrected) - v * np.abs(terms.weighted) ** 2, axis=1)
    expected = expected_power(field, terms.corrected)
    fresh = (field.power * np.maximum(energy, 0.0) + NOISE_RULES.power_count * expected) / (
        gamma + NOISE_RULES.power_count
    )
    return np.clip(fresh, 1e-2 * expected, NOISE_RULES.most_power * expected)


def updated_channel_noise(field: ChannelField, terms: Terms) -> np.ndarray:
    """Noise of every channel over that of the array (N,), tau, of median 1."""
    v, tau = field.noise[:, None], field.channel_noise
    left = tau * np.sum(v * terms.precision, axis=0)
    seen = tau**2 * np.sum(v * np.abs(terms.weighted) ** 2, axis=0)
    fresh = (seen + NOISE_RULES.channel_count) / (left + NOISE_RULES.channel_count)
    return np.clip(fresh / np.median(fresh), NOISE_RULES.least_channel_noise, NOISE_RULES.most_channel_noise)


def updated_sigma(
    sigma: float, deviation, variance, components: int = 1, floor: float = NOISE_RULES.least_sigma
) -> float:
    """Spread of a prior by empirical Bayes (MacKay): squared deviations over how many the data determine.

    deviation : (K,) root of the sum of squares of the components;  variance : (K,) posterior, per component
    """
    weight = spring(deviation**2, sigma, components) * sigma**2
    determined = components * np.clip(1 - weight * variance / sigma**2, 0.0, 1.0)
    fresh = np.sqrt(np.sum(weight * deviation**2) / max(float(determined.sum()), 1e-3))
    return float(np.clip(np.clip(fresh, sigma / 4, 4 * sigma), floor, NOISE_RULES.most_sigma))


def hyper_cost(field: ChannelField, corrected) -> float:
    """-log density of power and channel noise, up to a constant."""
    expected = expected_power(field, corrected)
    ratio, tau = expected / field.power, field.channel_noise
    return float(
        NOISE_RULES.power_count * np.sum(ratio - 1 - np.log(ratio))
        + NOISE_RULES.channel_count * np.sum(1 / tau - 1 + np.log(tau))
    )


def profile_cost(positions, q, field: ChannelField, noise: float) -> float:
    """Return -log likelihood of corrected pressures q (M, N) with each mode's likeliest power of the field.

    noise : float, share of the power
    """
    values, along = channel_spectra(positions, q, field)
    powers = np.geomspace(1 / NOISE_RULES.most_profiled, NOISE_RULES.most_profiled, NOISE_RULES.profiled)
    spectra = np.multiply.outer(powers, values * field.power[:, None]) + noise
    return float((np.log(spectra) + along / spectra).sum(axis=2).min(axis=0).sum())


def estimate_noise(positions, q, field: ChannelField, least: float) -> tuple[float, float, float]:
    """Share of noise and spread of the positions, metres, that make corrected pressures q (M, N) most likely.

    An error e of a microphone adds the noise k^2 e^2 / dimension: at rough positions the high modes are hard to
    explain and the low ones are not.

    Returns
    -------
    noise : float, share of the power;  spread : float, metres;  alone : float, the noise where there is no spread
    """
    from scipy.optimize import minimize, minimize_scalar  # here, as in `fdcal.cost.noise_model`

    values, along = channel_spectra(positions, q, field)
    values = values * field.power[:, None]
    slope = np.real(field.wavenumbers)[:, None] ** 2 / field.dimension

    def cost(logs) -> float:
        noise, spread = np.exp(logs)
        spectrum = values + np.minimum(noise + slope * spread, NOISE_RULES.most_share)
        return float(np.sum(np.log(spectrum) + along / spectrum))

    top = float(slope.max())
    bounds = [
        (np.log(least), np.log(NOISE_RULES.most_share)),
        (np.log(least / top), np.log(NOISE_RULES.most_share / top)),
    ]
    grid = [np.linspace(*bound, 8) for bound in bounds]
    start = min(((a, b) for a in grid[0] for b in grid[1]), key=cost)
    options = {"xatol": 0.05, "fatol": 0.1}
    best = minimize(cost, start, method="Nelder-Mead", bounds=bounds, options=options)
    alone: Any = minimize_scalar(lambda log: cost((log, bounds[1][0])), bounds=bounds[0], method="bounded")
    noise, variance = np.exp(best.x)
    return float(noise), float(np.sqrt(variance)), float(np.exp(alone.x))
