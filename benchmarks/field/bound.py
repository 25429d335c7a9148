"""The Cramer-Rao bound of a diffuse field."""

import numpy as np
from scipy.special import j0, j1

from .cases import Case
from .constants import SOUND_SPEED

SNR_WITHOUT_NOISE = 80.0  # dB


def bound(case: Case) -> float:
    """Return the bound of the RMS error of the microphones that are sought, metres."""
    x = case.positions
    count, dimension = x.shape
    snr = SNR_WITHOUT_NOISE if case.spec.snr is None else case.spec.snr
    wavenumbers = 2 * np.pi * case.table["frequencies"] / SOUND_SPEED
    information = fisher(x, wavenumbers, 10 ** (-snr / 10), case.spec.dimension)
    information = (information + information.T) / 2
    free = np.arange(count) if case.spec.blind else np.setdiff1d(np.arange(count), case.known)
    if case.spec.blind:
        covariance = np.linalg.pinv(information, rcond=1e-11, hermitian=True)
    else:
        rows = (dimension * free[:, None] + np.arange(dimension)).ravel()
        covariance = np.linalg.inv(information[np.ix_(rows, rows)])
    return float(np.sqrt(np.trace(covariance) / len(free)))


def fisher(positions, wavenumbers, noise_fraction: float, dimension: int) -> np.ndarray:
    """Return the Fisher information of positions (N, D), metres, in a diffuse field : (N D, N D) float64, 1/m^2.

    wavenumbers : (M,) float64, rad/m; noise_fraction : noise power over total power; dimension : of the sound field
    """
    count, coordinates = positions.shape
    difference = positions[:, None] - positions[None]
    distance = np.linalg.norm(difference, axis=-1)
    unit = difference / np.where(distance == 0, 1, distance)[..., None]
    total = np.zeros((count, coordinates, count, coordinates))
    for k in wavenumbers:
        correlation, slope = (_plane if dimension == 2 else _space)(k * distance)
        inverse = np.linalg.inv((1 - noise_fraction) * correlation + noise_fraction * np.eye(count))
        slopes = [(1 - noise_fraction) * k * slope * unit[:, :, a] for a in range(coordinates)]
        for a, first in enumerate(slopes):
            for b, second in enumerate(slopes):
                total[:, a, :, b] += 2 * inverse * (first @ inverse @ second.T)
                total[:, a, :, b] += 2 * (inverse @ second.T) * (inverse @ first.T).T
    return total.reshape(count * coordinates, count * coordinates)


def _plane(z) -> tuple[np.ndarray, np.ndarray]:
    """Correlation of a diffuse field in two dimensions at distance z / k, and its slope."""
    return j0(z), -j1(z)


def _space(z) -> tuple[np.ndarray, np.ndarray]:
    safe = np.where(z == 0, 1, z)
    correlation = np.where(z == 0, 1, np.sin(safe) / safe)
    return correlation, np.where(z == 0, 0, np.cos(safe) / safe - np.sin(safe) / safe**2)
