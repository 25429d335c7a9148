"""The sound field of a measured room: a sum of plane waves, one for each sample of a directional impulse response.

Sample n of the response is taken as a plane wave that arrives from the direction u_n at the time t_n, so that

    p(x, f) = sum_n a_n exp(-j w (t_n - u_n . x / c)),        w = 2 pi f

The response was measured at the origin. Elsewhere the field is modelled by this sum, which solves the Helmholtz
equation exactly for any response, and has no source inside the array.

a_n, t_n, u_n    amplitude of wave n, its arrival time at the origin, s, and its direction of arrival, a unit vector
f, c             frequency, Hz; sound speed, m/s
x                position, metres

The response is a MATLAB file from the spatial decomposition method (SDM):

p                   (T,) pressure, or (T, 1)
azi_rad, ele_rad    (T,) direction of arrival of each sample, radians
fs                  sampling rate, Hz
"""

import itertools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from ..model.libraries import isolated_call
from ..model.problem import mode_power
from ..model.settings import Sensing
from ..model.storage import matlab_arrays
from ..model.validation import Complexes, InputError, convert, refusal, require_array, within
from .spectrum import ModalPressures, fast_length, pick_peaks, rfft, wavenumber_continuous

KEYS = ("p", "azi_rad", "ele_rad", "fs")
DIRECT_SOUND = 0.1  # the direct sound begins at the first sample above this fraction of the peak
SEGMENTS = 20  # number of equal segments whose peaks are compared; also the smallest number of samples
END_PEAK = 5.0  # largest ratio of the peak of the last segment to the peak of the quietest one
MAX_SAMPLES = 1_000_000  # largest number of samples of a response


@dataclass(frozen=True)
class SdmResponse:
    """Plane waves that arrive at the origin one after another."""

    amplitudes: np.ndarray  # (T,) float64, pressure of each wave at the origin, any unit common to all
    directions: np.ndarray  # (T, 3) float64, unit vectors in the directions that the waves come from
    times: np.ndarray  # (T,) float64, when each wave arrives at the origin, s
    sample_rate: float  # Hz


def load_sdm_response(path: str | Path) -> SdmResponse:
    """Return the response in a .mat file with `p`, `azi_rad`, `ele_rad` and `fs`, from the direct sound on.

    Raises InputError for a missing or wrong array, a silent response, or one that wraps round.
    """
    table = isolated_call(path, matlab_arrays, path)  # a damaged file can crash SciPy's compiled reader
    for key in KEYS:
        if key not in table:
            raise InputError(f'{path} has no "{key}"', f"give {', '.join(KEYS[:-1])} (T,) and {KEYS[-1]}", key=key)
    samples = table["p"].size
    if not SEGMENTS <= samples <= MAX_SAMPLES:
        raise InputError(f"{path}: p has {samples} samples", f"give {SEGMENTS} to {MAX_SAMPLES}", key="p")
    lengths = {"p": samples, "azi_rad": samples, "ele_rad": samples, "fs": 1}
    columns = (require_array(f"{path}: {key}", np.ravel(table[key]), "real", (lengths[key],)) for key in KEYS)
    pressure, azimuth, elevation, rate = columns
    convert(rate[0], Annotated[float, within(100.0, 1e6, "Hz")], f"{path}: fs")
    level = np.abs(pressure)
    if not level.max() > 0:
        raise InputError(f"{path}: the response is silent", "measure it again", key="p")
    start = int(np.argmax(level >= DIRECT_SOUND * level.max()))
    # The sound in a room decays. If the last segment is much louder than the quietest one after the direct sound, then
    # a circular deconvolution has moved the beginning of the response to the end of the file.
    segments = min(SEGMENTS, len(pressure) - start)
    peaks = np.array([np.abs(part).max() for part in np.array_split(pressure[start:], segments)])
    if len(pressure) - start < len(pressure) / 2 or peaks[-1] > END_PEAK * peaks.min():
        problem = f"{path}: the response wraps round: its beginning is at the end of the file"
        remedy = "shift it circularly so that it begins with the direct sound, and cut off the silence at the new end"
        raise InputError(problem, remedy, key="p")
    across = np.cos(elevation)
    directions = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)], axis=1)
    times = np.arange(len(pressure)) / float(rate[0])
    return SdmResponse(pressure[start:], directions[start:], times[start:], float(rate[0]))


TAPS = 8  # number of samples over which one wave is interpolated
MAX_FREQUENCY = 1 / 6  # highest frequency that is used, relative to the sampling rate of the response
POINTS = 6  # points of the spectrum per 1 / duration


def plane_wave_pressures(response: SdmResponse, positions, frequencies, sound_speed: float, progress=None) -> Complexes:
    """Return the pressures of plane waves at the frequencies (M,), Hz : (M, N) complex128, unit of the response.

    `positions` (N, 3), metres, are relative to the origin of the response; `sound_speed` is in m/s.
    """
    # (T, N), s: how much earlier each wave arrives at a microphone than at the origin
    lead = response.directions @ np.asarray(positions, float).T / sound_speed
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
    """Return the impulse responses of a field of plane waves at microphones, at the sampling rate of `response`.

    Each wave is delayed by Lagrange interpolation over TAPS samples, whose error is 1e-6 up to a twentieth of the
    sampling rate and 1 % up to MAX_FREQUENCY. `positions` (N, 3), metres, are relative to the origin of the response.
    The result is (N, S) float64; all responses begin at the same sample, before the direct sound, and end with the last
    wave.
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
    """Raise InputError if the response has too low a sampling rate for the band, or is too short for the resolution."""
    if sensing.highest > MAX_FREQUENCY * response.sample_rate:
        why = f"is too high for a response of {response.sample_rate:g} Hz"
        remedy = f"use at most {MAX_FREQUENCY * response.sample_rate:g} Hz"
        raise refusal("measurement.highest", sensing.highest, why, remedy, "Hz")
    duration = len(response.times) / response.sample_rate
    if sensing.resolution * duration < 1 - 1e-2:
        why = f"is finer than that of a response of {duration:.3g} s"
        remedy = f"use at least {math.ceil(10 / duration) / 10:g} Hz"
        raise refusal("measurement.resolution", sensing.resolution, why, remedy, "Hz")


def modal_pressures(
    response: SdmResponse, positions, sensing: Sensing, sound_speed: float, progress=None
) -> ModalPressures:
    """Return the pressures of an array in a measured room, without noise.

    `positions` (N, 3), metres, are relative to the origin of the response. The wavenumbers are real: the response has
    decayed at its end, so that no exponential window is needed.
    """
    rows = plane_wave_responses(response, positions, sound_speed)
    padded = fast_length(POINTS * rows.shape[1])
    step = response.sample_rate / padded
    first, last = max(1, math.ceil(sensing.lowest / step)), math.floor(sensing.highest / step)
    power = mode_power(np.array([rfft(row, padded)[first : last + 1] for row in rows]).T)
    frequencies = pick_peaks(power, first * step, step, sensing.prominence_db, sensing.resolution)
    pressures = plane_wave_pressures(response, positions, frequencies, sound_speed, progress)
    grid = step * np.arange(first, last + 1)
    k = wavenumber_continuous(frequencies, 0.0, sound_speed)
    return ModalPressures(frequencies, k, pressures, np.stack([grid, power]))
