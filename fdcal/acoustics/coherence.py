"""Properties of an array's pressures before any position is known: its radius, and whether there is only one wave.

The mean of the pressures over an array loses power as the array grows beyond a wavelength. In a diffuse field

    E |mean_n p_n|^2 / mean_n |p_n|^2 = h(k R),   h(z) = (2 J_1(z) / z)^2 in a plane, (3 j_1(z) / z)^2 in space

for microphones spread evenly over a disc or a ball of radius R. Each frequency is one draw of this ratio, about
exponentially distributed, so that the radius is the one of the highest likelihood over all frequencies. The radius is
accurate to a factor of about 1.5. Gains scale each channel and are divided out.

A single wave, without any reflection, has the same power at every microphone, except for factors of the channels' gains
and of a near source, which are the same at every frequency. In a room the power varies from point to point. With q_mn
the power of a channel over its own mean and over that of the frequency, the variance of q over the microphones is near
0 for a single wave and near 1 for a diffuse field. Low frequencies, at which the phase hardly varies over the array,
are not used, because there the pressure is the same everywhere in any field.
"""

import numpy as np

from ..model.validation import Complexes

RADII = np.geomspace(0.005, 30.0, 400)  # metres, candidates
INCOHERENT = (0.0, 0.03, 0.1, 0.25, 0.5)  # fractions of incoherent power that are tried
SCATTER = 1.0  # coherent power at high frequencies relative to that of independent channels
MAX_PHASE = 2.0  # k R at the lowest frequency; beyond it the array is incoherent throughout and its radius unknown
MIN_FREQUENCIES = 6


def array_radius(pressures: np.ndarray, wavenumbers: np.ndarray, dimension: int) -> float | None:
    """Estimate the radius, metres, of an array: that of the disc or ball with the same coherence; None if unknown.

    `pressures` (M, N), any unit, any gains; `wavenumbers` (M,) rad/m, too few or all too high where it is unknown.
    """
    from scipy.special import j1, spherical_jn

    p, k = np.asarray(pressures), np.abs(np.real(wavenumbers))
    level = np.sqrt(np.mean(np.abs(p) ** 2, axis=0))
    p = p[:, level > 0] / level[level > 0]
    power = np.mean(np.abs(p) ** 2, axis=1)
    p, k, power = p[power > 0], k[power > 0], power[power > 0]
    if len(k) < MIN_FREQUENCIES or p.shape[1] < 2:
        return None
    coherent = np.abs(p.mean(axis=1)) ** 2 / power
    z = k[:, None] * RADII
    expected = (2 * j1(z) / z) ** 2 if dimension == 2 else (3 * spherical_jn(1, z) / z) ** 2  # h of the module
    least, radius = np.inf, 0.0
    for fraction in INCOHERENT:
        mean = (1 - fraction) * expected + (fraction + SCATTER * (1 - fraction)) / p.shape[1]
        costs = np.sum(np.log(mean) + coherent[:, None] / mean, axis=0)
        if costs.min() < least:
            least, radius = float(costs.min()), float(RADII[costs.argmin()])
    return radius if k.min() * radius <= MAX_PHASE else None


SINGLE_WAVE = "the pressures are those of a single wave that passes the array: there are hardly any reflections"
SINGLE_WAVE_REMEDY = "record in a room with echoes; without them arrival times give the positions"


COHERENT = 0.5  # power of the mean pressure over the mean power, below which the phase varies over the array
MIN_VARYING = 5  # least number of such frequencies
SINGLE_VARIANCE = 0.06  # largest median variance of the power over the microphones; in a room it is 0.2


def is_single_wave(pressures: Complexes) -> bool:
    """Return whether one wave alone explains the pressures (M, N)."""
    p = np.asarray(pressures)
    p = p / np.sqrt(np.mean(np.abs(p) ** 2, axis=1))[:, None]
    own = np.mean(np.abs(p) ** 2, axis=0)
    p = p / np.sqrt(np.maximum(own, 1e-12 * own.max()))
    mean = np.mean(np.abs(p) ** 2, axis=1)
    varying = np.abs(p.mean(axis=1)) ** 2 < COHERENT * mean
    if np.sum(varying) < MIN_VARYING:
        return False
    power = np.abs(p[varying]) ** 2 / mean[varying, None]
    return bool(np.median(np.var(power, axis=1)) < SINGLE_VARIANCE)
