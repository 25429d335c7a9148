"""What the pressures of an array show before any position is known: its radius, and whether there is only one wave.

The power of the mean of the pressures falls as the array grows relative to the wavelength. In a diffuse field

    E |mean_n p_n|^2 / mean_n |p_n|^2 = h(k R),   h(z) = (2 J_1(z) / z)^2 in a plane, (3 j_1(z) / z)^2 in space

for microphones spread evenly over a disc or a ball of radius R. The ratio at each frequency is a random draw with this
mean and approximately an exponential distribution. The estimated radius is the most likely one for the ratios at all
frequencies, and is accurate to a factor of about 1.5. Each channel is first scaled to unit power, so that its gain has
no effect.

A single wave, without any reflection, has the same power at every microphone. The gain of a channel and the distance
from a near source change this power, but by the same factor at every frequency. In a room the power varies from point
to point, in another way at each frequency. Let q_mn be the power of channel n at frequency m, divided by the mean power
of the channel and by that of the frequency. The variance of q over the microphones is near 0 for a single wave and near
1 for a diffuse field. Low frequencies are left out of this test, because in any field the pressure is nearly constant
over an array that is much smaller than the wavelength.
"""

import numpy as np

from ..model.validation import Complexes

RADII = np.geomspace(0.005, 30.0, 400)  # metres, candidates
INCOHERENT = (0.0, 0.03, 0.1, 0.25, 0.5)  # fractions of incoherent power, such as noise, that are tried
MAX_PHASE = 2.0  # largest k R at the lowest frequency; beyond it no frequency shows the radius
MIN_FREQUENCIES = 6  # smallest number of frequencies for an estimate


def array_radius(pressures: np.ndarray, wavenumbers: np.ndarray, dimension: int) -> float | None:
    """Return the radius, metres, of the disc or ball that has the same coherence as the array; None if it is unknown.

    `pressures` (M, N) may have any unit, and each channel any gain; `wavenumbers` (M,) are in rad/m. The radius is
    unknown if there are too few frequencies, if fewer than two channels have a signal, or if all frequencies are too
    high.
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
    expected = (2 * j1(z) / z) ** 2 if dimension == 2 else (3 * spherical_jn(1, z) / z) ** 2  # h(k R)
    least, radius = np.inf, 0.0
    for fraction in INCOHERENT:
        mean = (1 - fraction) * expected + 1 / p.shape[1]  # the ratio of N independent channels is 1 / N
        costs = np.sum(np.log(mean) + coherent[:, None] / mean, axis=0)
        if costs.min() < least:
            least, radius = float(costs.min()), float(RADII[costs.argmin()])
    return radius if k.min() * radius <= MAX_PHASE else None


def squared_coherence(spectra: np.ndarray) -> np.ndarray:
    """Return the squared coherence of all pairs of channels : (F, N, N), 0 for a channel with itself.

    spectra : (F, W, N), of W windows; the squared coherence of independent channels is about 1 / W
    """
    cross = (spectra.swapaxes(1, 2) @ np.conj(spectra)).astype(complex)  # its square exceeds the range of complex64
    power = np.real(np.diagonal(cross, axis1=1, axis2=2))
    squared = np.abs(cross) ** 2 / np.maximum(power[:, :, None] * power[:, None], np.finfo(power.dtype).tiny)
    return squared * (1 - np.eye(spectra.shape[2]))


SINGLE_WAVE = "the pressures are those of a single wave that passes the array: there are hardly any reflections"
SINGLE_WAVE_REMEDY = "record in a room with echoes; without them arrival times give the positions"


# The phase varies over the array if the power of the mean pressure, divided by the mean power, is below this.
COHERENT = 0.5
MIN_VARYING = 5  # smallest number of frequencies at which the phase varies
SINGLE_VARIANCE = 0.06  # largest median variance of q for a single wave; with the reflections of a room it is about 0.2


def is_single_wave(pressures: Complexes) -> bool:
    """Return whether one wave alone explains the pressures (M, N); False if the phase varies at too few frequencies."""
    p = np.asarray(pressures)
    p = p / np.sqrt(np.mean(np.abs(p) ** 2, axis=1))[:, None]
    own = np.mean(np.abs(p) ** 2, axis=0)
    p = p / np.sqrt(np.maximum(own, 1e-12 * own.max()))
    mean = np.mean(np.abs(p) ** 2, axis=1)
    varying = np.abs(p.mean(axis=1)) ** 2 < COHERENT * mean
    if np.sum(varying) < MIN_VARYING:
        return False
    return bool(np.median(np.var(np.abs(p[varying]) ** 2 / mean[varying, None], axis=1)) < SINGLE_VARIANCE)
