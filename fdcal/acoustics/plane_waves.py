"""The sound field of a measured room: the plane waves of an impulse response whose directions of arrival are known.

Sample n of the response is a plane wave that arrives from the direction u_n at the time t_n, so that

    p(x, f) = sum_n a_n exp(-j w (t_n - u_n . x / c)),        w = 2 pi f

The response is measured, at the origin. The field elsewhere is modelled: it is this sum. It solves the Helmholtz
equation exactly, whatever the response, and has no source anywhere near.

a_n, t_n, u_n    amplitude, time of arrival at the origin, s, and unit vector towards where wave n comes from
f, c             frequency, Hz; sound speed, m/s
x                position, metres
"""

import itertools
import math

import numpy as np

from ..model.problem import mode_power
from ..model.sdm_response import SdmResponse
from ..model.settings import Sensing
from ..model.validation import refusal
from .spectrum import ModalPressures, fast_length, pick_peaks, rfft, wavenumber_continuous

TAPS = 8  # samples of the interpolation of one wave
MAX_FREQUENCY = 1 / 6  # of responses that are rendered, relative to the sampling rate
POINTS = 6  # points of the spectrum per 1 / duration


def plane_wave_pressures(
    response: SdmResponse, positions, frequencies, sound_speed: float, progress=None
) -> np.ndarray:
    """Return the pressures of plane waves at (N, 3), metres from the origin of the response : (M, N) complex128."""
    lead = response.directions @ np.asarray(positions, float).T / sound_speed  # (T, N) s earlier than at the origin
    pressures = np.empty((len(frequencies), lead.shape[1]), complex)
    for m, f in enumerate(np.asarray(frequencies, float)):
        w = 2 * np.pi * f
        at_origin = response.amplitudes * np.exp(-1j * w * response.times)
        parts = np.stack([at_origin.real, at_origin.imag])
        cosine, sine = parts @ np.cos(w * lead), parts @ np.sin(w * lead)
        pressures[m] = cosine[0] - sine[1] + 1j * (cosine[1] + sine[0])
        if progress is not None:
            progress((m + 1) / len(frequencies))
    return pressures


def plane_wave_responses(response: SdmResponse, positions, sound_speed: float) -> np.ndarray:
    """Return the impulse responses of a field of plane waves, sampled as the response is.

    Each wave is delayed by Lagrange interpolation over TAPS samples: exact to 1e-6 up to a twentieth of the sampling
    rate, to 1 % up to MAX_FREQUENCY. `positions` (N, 3), metres from the origin of the response. Returns (N, S), which
    begin before the direct sound, at one time, a whole number of samples, and end with the last wave.
    """
    fs, positions = response.sample_rate, np.asarray(positions, float)
    reach = math.ceil(float(np.linalg.norm(positions, axis=1).max()) / sound_speed * fs) + TAPS
    first = np.round(response.times * fs).astype(np.int64)
    samples = int(np.ptp(first)) + 2 * reach + 1
    rows = np.empty((len(positions), samples))
    for row, position in zip(rows, positions, strict=True):
        arrival = first - first[0] + reach - response.directions @ position * fs / sound_speed  # in samples
        below = np.floor(arrival).astype(np.int64) - (TAPS // 2 - 1)
        taps = below[:, None] + np.arange(TAPS)
        weights = np.tile(response.amplitudes[:, None], TAPS)
        for node, other in itertools.permutations(range(TAPS), 2):
            weights[:, node] *= (arrival - below - other) / (node - other)
        row[:] = np.bincount(taps.ravel(), weights.ravel(), samples)
    return rows


def require_rendered(response: SdmResponse, sensing: Sensing) -> None:
    """Raise InputError for frequencies above those of the response, or closer than it resolves."""
    if sensing.highest > MAX_FREQUENCY * response.sample_rate:
        why = f"is too high for a response of {response.sample_rate:g} Hz"
        remedy = f"use at most {MAX_FREQUENCY * response.sample_rate:g} Hz"
        raise refusal("measurement.highest", sensing.highest, why, remedy, "Hz")
    if sensing.resolution * response.duration < 1 - 1e-2:
        why = f"is finer than that of a response of {response.duration:.3g} s"
        remedy = f"use at least {math.ceil(10 / response.duration) / 10:g} Hz"
        raise refusal("measurement.resolution", sensing.resolution, why, remedy, "Hz")


def modal_pressures(
    response: SdmResponse, positions, sensing: Sensing, sound_speed: float, progress=None
) -> ModalPressures:
    """Return the pressures of an array in a measured room, before noise, at (N, 3) metres from the response's origin.

    The wavenumbers are real: the response has decayed, so no exponential window is needed.
    """
    require_rendered(response, sensing)
    rows = plane_wave_responses(response, positions, sound_speed)
    padded = fast_length(POINTS * rows.shape[1])
    step = response.sample_rate / padded
    first, last = max(1, math.ceil(sensing.lowest / step)), math.floor(sensing.highest / step)
    power = mode_power(np.array([rfft(row, padded)[first : last + 1] for row in rows]).T)
    frequencies = pick_peaks(power, first * step, step, sensing.prominence_db, sensing.resolution)
    pressures = plane_wave_pressures(response, positions, frequencies, sound_speed, progress)
    grid = step * np.arange(first, last + 1)
    return ModalPressures(
        frequencies, wavenumber_continuous(frequencies, 0.0, sound_speed), pressures, np.stack([grid, power])
    )
