"""Impulse responses with directions of arrival, from the spatial decomposition method (SDM), as MATLAB files.

p                   (T,) pressure, or (T, 1)
azi_rad, ele_rad    (T,) direction of arrival of each sample, radians
fs                  sampling rate, Hz
"""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from . import libraries
from .storage import read_bytes
from .validation import LIMITS, InputError, convert, require_array, within

PROCESSOR_SECONDS, BYTES = 20, 2_000_000_000  # that reading a MATLAB file may take; BYTES of address space


def read_arrays(data: bytes, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Return those of the variables `names` that the content of a MATLAB file has."""
    from scipy.io import loadmat

    try:
        table = loadmat(io.BytesIO(data), variable_names=names)
    except NotImplementedError as error:  # version 7.3 is HDF5
        raise InputError("it is of version 7.3", "save it with save(..., '-v7')") from error
    except Exception as error:  # a damaged file raises anything
        raise InputError(f"it is damaged ({type(error).__name__})", "save it again") from error
    return {name: np.asarray(table[name]) for name in names if name in table}


KEYS = ("p", "azi_rad", "ele_rad", "fs")


DIRECT_SOUND = 0.1  # level at which the direct sound begins, as a fraction of the peak
SEGMENTS = 20  # parts of equal length whose peaks are compared; the fewest samples
END_PEAK = 5.0  # peak of the last part at most, as a multiple of that of the quietest one
MAX_SAMPLES = 1_000_000


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
    """Return the response in a .mat file with `p`, `azi_rad`, `ele_rad` and `fs`, from the direct sound on."""
    limits = {"processor_seconds": PROCESSOR_SECONDS, "memory": BYTES}
    try:  # in a process of its own: a damaged file can crash SciPy's compiled reader
        table = libraries.call(read_arrays, read_bytes(path, LIMITS.unfolded), KEYS, **limits)
    except InputError as error:
        raise error.within(path) from error
    except libraries.ProcessError as error:
        raise InputError(f"{path} is not a MATLAB file that can be read: {error}", "save it again") from error
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
    start = direct_sound(pressure, str(path))
    # The sound of a room dies away. If the last samples are louder than the quietest ones after the direct sound, they
    # are the beginning of the response, from a circular deconvolution, and the waves of the file are in a wrong order.
    segments = min(SEGMENTS, len(pressure) - start)
    peaks = np.array([np.abs(part).max() for part in np.array_split(pressure[start:], segments)])
    if len(pressure) - start < len(pressure) / 2 or peaks[-1] > END_PEAK * peaks.min():
        problem = f"{path}: the response wraps round: its beginning is at the end of the file"
        remedy = "shift it so that it begins with the direct sound, and take the silence before it off the end"
        raise InputError(problem, remedy, key="p")
    across = np.cos(elevation)
    directions = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)], axis=1)
    times = np.arange(len(pressure)) / float(rate[0])
    return SdmResponse(pressure[start:], directions[start:], times[start:], float(rate[0]))


def direct_sound(pressure: np.ndarray, path: str = "response") -> int:
    """Return the first sample (T,) whose magnitude reaches a tenth of the peak; InputError for silence."""
    level = np.abs(pressure)
    if not level.max() > 0:
        raise InputError(f"{path}: the response is silent", "measure it again", key="p")
    return int(np.argmax(level >= DIRECT_SOUND * level.max()))
