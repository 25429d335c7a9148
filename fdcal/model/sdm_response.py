"""Impulse responses with directions of arrival, from the spatial decomposition method (SDM), as MATLAB files.

p                   (T,) pressure, or (T, 1)
azi_rad, ele_rad    (T,) direction of arrival of each sample, radians
fs                  sampling rate, Hz
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .matlab_file import read_arrays
from .reading import read_bytes
from .validation import LIMITS, InputError, require_array, shown

KEYS = ("p", "azi_rad", "ele_rad", "fs")


@dataclass(frozen=True)
class SdmThresholds:
    """How a response is checked and trimmed."""

    direct_sound: float = 0.1  # level at which the direct sound begins, as a share of the peak
    segments: int = 20  # parts of equal length whose peaks are compared
    end_peak: float = 5.0  # peak of the last part at most, as a multiple of that of the quietest one
    # min_sample_rate, max_sample_rate: Hz
    min_sample_rate: float = 100.0
    max_sample_rate: float = 1e6
    max_samples: int = 1_000_000


THRESHOLDS = SdmThresholds()


@dataclass(frozen=True)
class SdmResponse:
    """Plane waves that arrive at the origin one after another."""

    amplitudes: np.ndarray  # (T,) float64, pressure of each wave at the origin, any one unit
    directions: np.ndarray  # (T, 3) float64, unit vectors towards where each wave comes from
    times: np.ndarray  # (T,) float64, when each wave arrives at the origin, s
    sample_rate: float  # Hz

    @property
    def duration(self) -> float:
        """From the first to the last wave, s."""
        return len(self.times) / self.sample_rate


def load_sdm_response(path: str | Path) -> SdmResponse:
    """Return the response in a file, from the direct sound on.

    `path`: a .mat file with `p`, `azi_rad`, `ele_rad` and `fs`. Raises InputError: the file is damaged, or lacks one of
    these; its response is silent, or wraps round; StorageError: the file cannot be opened.

    Examples
    --------
    >>> from fdcal.model.measured_room import response_path
    >>> load_sdm_response(response_path("listening_lab")).sample_rate
    48000.0
    """
    pressure, azimuth, elevation, sample_rate = _variables(Path(path))
    start = direct_sound(pressure, str(path))
    require_unwrapped(pressure, start, str(path))
    across = np.cos(elevation)
    directions = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)], axis=1)
    times = np.arange(len(pressure)) / sample_rate
    return SdmResponse(pressure[start:], directions[start:], times[start:], sample_rate)


def direct_sound(pressure: np.ndarray, path: str = "response") -> int:
    """Return the first sample (T,) whose magnitude reaches a tenth of the peak: where the direct sound begins.

    Raises InputError: the response is silent.
    """
    level = np.abs(pressure)
    if not level.max() > 0:
        raise InputError(f"{path}: the response is silent", "measure it again", key="p")
    return int(np.argmax(level >= THRESHOLDS.direct_sound * level.max()))


def require_unwrapped(pressure: np.ndarray, start: int, path: str = "response") -> None:
    """Raise InputError for a response (T,) that begins at the end of the file.

    The sound of a room dies away. If the last samples are louder than the quietest ones after the direct sound, they
    are the beginning of the response, from a circular deconvolution, and the waves of the file are in a wrong order.
    """
    segments = min(THRESHOLDS.segments, len(pressure) - start)
    peaks = np.array([np.abs(part).max() for part in np.array_split(pressure[start:], segments)])
    if len(pressure) - start < len(pressure) / 2 or peaks[-1] > THRESHOLDS.end_peak * peaks.min():
        raise InputError(
            f"{path}: the response wraps round: its beginning is at the end of the file",
            "shift it so that it begins with the direct sound, and take the silence before it off the end",
            key="p",
        )


def _variables(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return pressure, azimuth and elevation, each (T,), and the sampling rate of a file, checked."""
    table = read_arrays(read_bytes(path, LIMITS.unfolded), KEYS, str(path))
    remedy = f"give {', '.join(KEYS[:-1])} (T,) and {KEYS[-1]}"
    for key in KEYS:
        if key not in table:
            raise InputError(f'{path} has no "{key}"', remedy, key=key)
    columns = [require_array(f"{path}: {key}", np.ravel(table[key]), "real", (None,)) for key in KEYS]
    pressure, azimuth, elevation, rate = columns
    if not THRESHOLDS.segments <= len(pressure) <= THRESHOLDS.max_samples:
        problem = f"{path}: p has {len(pressure)} samples"
        raise InputError(problem, f"give {THRESHOLDS.segments} to {THRESHOLDS.max_samples}", key="p")
    for key, column in (("azi_rad", azimuth), ("ele_rad", elevation)):
        if len(column) != len(pressure):
            problem = f"{path}: {key} has {len(column)} samples and p has {len(pressure)}"
            raise InputError(problem, "give one direction for each sample", key=key)
    if len(rate) != 1 or not THRESHOLDS.min_sample_rate <= rate[0] <= THRESHOLDS.max_sample_rate:
        low, high = THRESHOLDS.min_sample_rate, THRESHOLDS.max_sample_rate
        raise InputError(
            f"{path}: fs = {shown(rate.tolist())} is no sampling rate", f"use {low:g} to {high:g} Hz", key="fs"
        )
    return pressure, azimuth, elevation, float(rate[0])
