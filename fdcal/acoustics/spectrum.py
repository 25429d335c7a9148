"""From recordings to modes: exponential window, peak picking, pressures and wavenumbers.

In a weakly damped room the sound has not decayed at the end of a recording, and the Fourier transform of the truncated
signal does not satisfy a Helmholtz equation. The transform of the signal times exp(-s t) does satisfy it, except for
the remainder at the end of the recording, at the complex frequency

    w = 2 pi f - 1j s    (time sign exp(+1j w t)),    k = w / c,

provided that the source has zero mean and the recording starts in silence. This holds at any frequency f, but the
signal is strongest at the modes. The modes are therefore picked in a spectrum of high resolution and low side lobes.
The pressures are then computed at exactly these frequencies, with the exponential window.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import fft
from scipy.special import jv

from ..model.validation import InputError, refusal


def fast_length(min_length: int) -> int:
    """Return the smallest length of at least `min_length` whose Fourier transform is fast."""
    length: int | None = fft.next_fast_len(min_length, real=True)
    return min_length if length is None else length


def rfft(values, length: int | None = None) -> np.ndarray:
    """Return the Fourier transform of real `values` along the last axis, padded to `length` : complex."""
    return np.asarray(fft.rfft(values, length))


def irfft(spectrum, length: int) -> np.ndarray:
    """Return the real signal of `length` samples whose transform along the last axis is `spectrum` : (..., length)."""
    return np.asarray(fft.irfft(spectrum, length))


@dataclass(frozen=True)
class SpectrumRules:
    """How spectra are computed and their peaks picked."""

    decay: float = 12.0  # nepers from the start to the end of a recording; the remainder is exp(-12) = 6e-6
    # width at -6 dB of a line under the Blackman-Harris window, times the duration, dimensionless
    line_width: float = 2.72
    # dB; peaks further than this below the strongest one may be side lobes (those of the window are at -92 dB)
    range_db: float = 60.0
    padding: int = 2  # points of the spectrum per 1 / duration


SPECTRUM = SpectrumRules()
BLOCK = 4096  # number of samples that are transformed at the same time


def window_rate(recordings: np.ndarray, fs: float) -> float:
    """Return the rate s, 1/s, of the exponential window with which recordings (N, T) decay by 12 nepers to their end.

    It is 12 / duration if the sound does not decay by itself, 0 if it has decayed by 12 nepers at the end, and between
    these values otherwise. Raises InputError for silent recordings or values that are not finite.
    """
    recordings = np.asarray(recordings)
    level = np.sqrt(np.mean(np.square(recordings, dtype=float)))
    if not np.isfinite(level):
        raise InputError("recordings contain a number that is not finite", "simulate or record them again")
    if level == 0:
        raise InputError("recordings are silent", "check source.position, source.low and source.high")
    end = np.sqrt(np.mean(recordings[:, -max(1, recordings.shape[1] // 20) :] ** 2))
    decayed = math.log(level / end) if end > 0 else math.inf  # nepers, without a window
    return float(np.clip(SPECTRUM.decay - decayed, 0.0, SPECTRUM.decay)) * fs / recordings.shape[1]


def laplace_transform(recordings: np.ndarray, fs: float, s: float, frequencies: np.ndarray) -> np.ndarray:
    """Return the sum over t of recordings (N, T) times exp(-(s + 2 pi j f) t) : (M, N) complex128.

    fs : sampling rate, Hz; s : 1/s; frequencies : (M,), Hz, which need not lie on a grid
    """
    rates = (s + 2j * np.pi * np.asarray(frequencies, dtype=float)) / fs
    samples = recordings.shape[1]
    phases = np.exp(-rates * np.arange(min(BLOCK, samples))[:, None])  # of the first block; others only need a factor
    phases = np.concatenate([np.real(phases), np.imag(phases)], axis=1)
    total = np.zeros((len(rates), len(recordings)), dtype=complex)
    for start in range(0, samples, BLOCK):
        block = recordings[:, start : start + BLOCK]
        real, imaginary = np.split((block @ phases[: block.shape[1]]).T, 2)
        total += np.exp(-rates * start)[:, None] * (real + 1j * imaginary)
    return total


def mean_power(
    recordings: np.ndarray, fs: float, lowest: float, highest: float, resolution: float = 1.0
) -> tuple[float, float, np.ndarray]:
    """Return the power spectrum in which `pick_peaks` finds peaks, averaged over the microphones.

    The recordings (N, T) are weighted with a power of a Blackman-Harris window. The exponent is 1 if the sound has not
    decayed at the end, 0 if it has decayed by 12 nepers, and in between otherwise. Returns the first frequency and the
    spacing of the points, Hz, and the power (F,) float64, in the squared unit of the recordings. Raises InputError as
    `check_band` does.
    """
    from scipy.signal import get_window  # imported here: it loads in 1 s; a cached measurement does not need it

    samples = recordings.shape[1]
    check_band(samples / fs, fs, highest, resolution)
    exponent = window_rate(recordings, fs) * samples / fs / SPECTRUM.decay
    window = get_window("blackmanharris", samples, fftbins=False) ** exponent
    padded = fast_length(SPECTRUM.padding * samples)
    step = fs / padded
    first, last = max(1, math.floor(lowest / step)), math.ceil(highest / step)
    power = np.zeros(last - first + 1)
    for recording in recordings:  # one at a time, because all of them, padded, would take twice the memory
        power += np.abs(rfft(recording * window, padded)[first : last + 1]) ** 2
    return first * step, step, power / len(recordings)


def pick_peaks(power: np.ndarray, lowest: float, step: float, prominence_db: float, resolution: float) -> np.ndarray:
    """Return the frequencies of the peaks of a power spectrum, interpolated between its points : (M,), Hz, ascending.

    `power` (F,) belongs to the frequencies `lowest`, `lowest` + `step`, ... Hz. A peak must have a prominence of
    `prominence_db`, dB. Of two peaks closer than `resolution`, Hz, only the stronger is returned. A prominence of 0
    selects frequencies at a spacing of `resolution` instead of peaks. Raises InputError if there is no peak.
    """
    if prominence_db == 0:
        return np.arange(lowest, lowest + step * (len(power) - 0.5), resolution)
    from scipy.signal import find_peaks  # imported here for the same reason as `get_window`

    decibels = 10 * np.log10(power / power.max() + 1e-30)
    apart = max(1.0, resolution / step)
    peaks, _ = find_peaks(decibels, height=-SPECTRUM.range_db, prominence=prominence_db, distance=apart)
    if len(peaks) == 0:
        band = f"measurement.lowest = {lowest:g} Hz and measurement.highest = {lowest + step * (len(power) - 1):g} Hz"
        problem = f"no resonance stands out by measurement.prominence_db = {prominence_db:g} dB between {band}"
        raise InputError(problem, "widen the band or lower the prominence", key="measurement.prominence_db")
    left, top, right = decibels[peaks - 1], decibels[peaks], decibels[peaks + 1]
    vertex = 0.5 * (left - right) / np.minimum(left - 2 * top + right, -1e-300)  # of the parabola through three points
    return lowest + (peaks + vertex) * step


def check_band(duration: float, fs: float, highest: float, resolution: float) -> None:
    """Raise InputError unless a recording of `duration`, s, resolves lines `resolution` apart up to `highest`, Hz.

    The sampling rate fs, Hz, must exceed twice the highest frequency.
    """
    require_duration(duration, resolution, SPECTRUM.line_width)
    if highest >= fs / 2:
        why = f"must lie below half of source.sample_rate = {fs:g} Hz"
        raise refusal("measurement.highest", highest, why, "lower it", "Hz")


def require_duration(duration: float, resolution: float, line_width: float) -> None:
    """Raise InputError unless a recording of `duration`, s, resolves lines that are `resolution`, Hz, apart.

    `line_width` is the width of a line times the duration, dimensionless.
    """
    if duration * resolution < line_width * (1 - 1e-9):
        why = f"is too short for measurement.resolution = {resolution:g} Hz"
        seconds, hertz = (math.ceil(line_width / other * 100) / 100 for other in (resolution, duration))
        remedy = f"use at least {seconds:g} s, or a resolution of {hertz:g} Hz"
        raise refusal("source.duration", duration, why, remedy, "s")


# Power series of 1 - J_0(z) in z^2, highest power first. For small z, subtracting J_0(z) from 1 would lose half the
# digits.
ONE_MINUS_J0 = [-((-0.25) ** m) / math.factorial(m) ** 2 if m else 0.0 for m in range(25, -1, -1)]


def wavenumber_continuous(frequencies: np.ndarray, s: float, sound_speed: float) -> np.ndarray:
    """Return k = (2 pi f - 1j s) / c of frequencies f (M,), Hz, and window rate s, 1/s : (M,) complex128, rad/m."""
    return (2 * np.pi * np.asarray(frequencies, dtype=float) - 1j * s) / sound_speed


def wavenumber_discrete(frequencies: np.ndarray, s: float, sound_speed: float, cell: float, fs: float) -> np.ndarray:
    """Return the wavenumber (M,), rad/m, of a wave on the simulation's grid, averaged over its directions.

    Inserting exp(j (w t - k . x)) into the scheme of `fdcal.acoustics.fdtd` gives, with lam = c / (fs h),

        sin^2(w / (2 fs)) = lam^2 [sin^2(k_x h / 2) + sin^2(k_y h / 2)] = lam^2 [1 - (cos k_x h + cos k_y h) / 2].

    The grid is slightly anisotropic. With k = |k| (cos t, sin t), the mean of cos(|k| h cos t) over t is J_0(|k| h), so

        sin^2(w / (2 fs)) = lam^2 (1 - J_0(k h)).

    Newton's method solves this equation for complex k at w = 2 pi f - 1j s. Frequencies are in Hz, s in 1/s, the edge
    of a `cell` in metres, the sampling rate fs in Hz. Raises InputError above the frequencies that propagate.
    """
    k = wavenumber_continuous(frequencies, s, sound_speed)
    wanted = (np.sin(k * sound_speed / (2 * fs)) * cell * fs / sound_speed) ** 2
    z = k * cell
    with np.errstate(all="ignore"):  # without a solution the iteration diverges, and then the error below is raised
        for _ in range(50):
            change = (np.polyval(ONE_MINUS_J0, z * z) - wanted) / jv(1, z)
            z = z - change
            if np.all(np.abs(change) <= 1e-14 * np.abs(z)):
                return z / cell
    problem = f"measurement.highest is above the frequencies that propagate with room.cell = {cell:g} m"
    remedy = 'lower it, use a smaller cell, or set measurement.wavenumber = "continuous"'
    raise InputError(problem, remedy, key="measurement.highest")


class ModalPressures(NamedTuple):
    """Pressures at the peaks of the spectrum."""

    frequencies: np.ndarray  # (M,) float64, Hz, ascending
    wavenumbers: np.ndarray  # (M,) complex128, k, rad/m
    pressures: np.ndarray  # (M, N) complex128, any unit common to all; 1/m if computed in closed form
    # (2, F) float64, the spectrum in which the peaks were picked: frequencies, Hz, and mean power of the microphones
    spectrum: np.ndarray | None = None
