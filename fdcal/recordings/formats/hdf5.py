"""The HDF5 file of Acoular: `time_data` (T, N) with the attribute `sample_freq`, Hz."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...model.validation import InputError
from ..recording import Recording, sample_ranges

SUFFIXES = (".h5", ".hdf5")


def read(path: Path, source: int | None = None) -> Recording:
    """Return the recording of an Acoular time data file, read in pieces; raise InputError for another kind of file."""
    from . import needs

    h5py = needs("h5py")
    try:
        with h5py.File(path, "r") as file:
            data = file.get("time_data")
            if not isinstance(data, h5py.Dataset):
                raise InputError(f'{path} has no "time_data"', "write the samples (T, N) there, as Acoular does")
            if data.ndim != 2 or data.dtype.kind not in "fiu":
                raise InputError(f'{path}: "time_data" is {data.dtype}, {data.shape}', "give real samples (T, N)")
            if "sample_freq" not in data.attrs:
                raise InputError(
                    f'{path}: "time_data" has no attribute "sample_freq", the sampling rate in Hz', "add it"
                )
            rate = np.asarray(data.attrs["sample_freq"])
            if rate.size != 1 or rate.dtype.kind not in "fiu":
                raise InputError(f'{path}: "sample_freq" is {rate.tolist()!r}', "give one number, the rate in Hz")
            rate = float(rate.item())
            samples, channels = data.shape
    except InputError:
        raise
    except Exception as error:  # a damaged file raises anything
        raise InputError(f"{path} is not an HDF5 file that can be read: {error}") from error

    def block(start: int, stop: int, chosen: np.ndarray) -> np.ndarray:
        values = np.empty((len(chosen), stop - start))
        try:
            with h5py.File(path, "r") as file:
                for first, last in sample_ranges(stop - start, channels):
                    values[:, first:last] = file["time_data"][start + first : start + last].T[chosen]
        except Exception as error:
            raise InputError(f"{path} cannot be read at sample {start}: {error}", "copy the file again") from error
        return values

    return Recording(str(path), None, rate, int(channels), int(samples), block)
