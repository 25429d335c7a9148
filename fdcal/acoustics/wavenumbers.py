"""Wavenumbers of windowed recordings, of a continuous field and of a wave on the simulation's grid."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import jv

from ..model.validation import InputError

# Power series of 1 - J_0(z) in z^2, highest power first: computed directly, small z would lose half the digits.
ONE_MINUS_J0 = [-((-0.25) ** m) / math.factorial(m) ** 2 if m else 0.0 for m in range(25, -1, -1)]


def wavenumber_continuous(frequencies: np.ndarray, s: float, sound_speed: float) -> np.ndarray:
    """Return k = (2 pi f - 1j s) / c.

    `frequencies` (M,) float64 f, Hz.; `s`: rate of the exponential window, 1/s; `sound_speed`: c, m/s. Returns (M,)
    complex128, rad/m.
    """
    return (2 * np.pi * np.asarray(frequencies, dtype=float) - 1j * s) / sound_speed


def wavenumber_discrete(frequencies: np.ndarray, s: float, sound_speed: float, cell: float, fs: float) -> np.ndarray:
    """Return the wavenumber of a wave on the simulation's grid, averaged over its directions.

    Inserting exp(j (w t - k . x)) into the scheme of `fdcal.acoustics.fdtd` gives, with lam = c / (fs h),

        sin^2(w / (2 fs)) = lam^2 [sin^2(k_x h / 2) + sin^2(k_y h / 2)] = lam^2 [1 - (cos k_x h + cos k_y h) / 2].

    The grid is slightly anisotropic. With k = |k| (cos t, sin t), cos(|k| h cos t) is J_0(|k| h) on average over t, so

        sin^2(w / (2 fs)) = lam^2 (1 - J_0(k h)),

    which Newton's method solves for complex k, w = 2 pi f - 1j s.

    `frequencies` (M,) float64 f, Hz.; `s`: rate of the exponential window, 1/s; `sound_speed`, `cell`, `fs`: c, m/s; h,
    m; sampling rate, Hz. Returns (M,) complex128, rad/m. Raises InputError if no wave of that frequency propagates on
    the grid.
    """
    k = wavenumber_continuous(frequencies, s, sound_speed)
    wanted = (np.sin(k * sound_speed / (2 * fs)) * cell * fs / sound_speed) ** 2
    z = k * cell
    with np.errstate(all="ignore"):  # without a solution the iteration diverges, and the error below is raised
        for _ in range(50):
            change = (np.polyval(ONE_MINUS_J0, z * z) - wanted) / jv(1, z)
            z = z - change
            if np.all(np.abs(change) <= 1e-14 * np.abs(z)):
                return z / cell
    raise InputError(
        f"measurement.highest is above the frequencies that propagate with room.cell = {cell:g} m",
        'lower it, use a smaller cell, or set measurement.wavenumber = "continuous"',
        key="measurement.highest",
    )
