"""HDF5 of Acoular: `time_data` (T, N), one channel per microphone, with the attribute `sample_freq`, Hz."""

from pathlib import Path
from typing import Any

import numpy as np

from ...model.libraries import needs
from ...model.validation import InputError, shown
from ..recording import RANGE_SAMPLES, Recording, ranges
from . import Format, damaged, isolated


def require_whole_file(path: Path) -> None:
    """Raise InputError for an HDF5 file with links or data that another file holds, and for a damaged one."""
    h5py = needs("h5py")

    links: list[tuple[bytes, int]] = []
    with damaged(f"{path} is not an HDF5 file that can be read"), h5py.File(path, "r") as file:
        file.id.links.visit(lambda name, link: links.append((name, link.type)), info=True)
        reason = ""
        for link, kind in links:
            name = shown(link.decode(errors="replace"), 80)
            data: Any = file[link] if kind == h5py.h5l.TYPE_HARD else None
            if kind == h5py.h5l.TYPE_EXTERNAL:
                target = file.id.links.get_val(link)[0].decode(errors="replace")
                reason = f'"{name}" is a link to {shown(target, 80)}'
            elif isinstance(data, h5py.Dataset) and data.external:
                reason = f'"{name}" has its values in {shown(data.external[0][0], 80)}'
            elif isinstance(data, h5py.Dataset) and data.is_virtual:
                reason = f'"{name}" is a virtual dataset, with its values in other datasets'
    if reason:
        raise InputError(f"{path}: {reason}, and no other file is read", "write the values into the file itself")


def _read_hdf5(path: Path, source: int | None = None) -> Recording:
    """Return the recording of an Acoular time data file, read in pieces; raise InputError for another kind of file."""
    h5py = needs("h5py")
    require_whole_file(path)
    with damaged(f"{path} is not an HDF5 file that can be read"), h5py.File(path, "r") as file:
        data = file.get("time_data")
        if not isinstance(data, h5py.Dataset):
            raise InputError(f'{path} has no "time_data"', "write the samples (T, N) there, as Acoular does")
        if data.ndim != 2 or data.dtype.kind not in "fiu":
            raise InputError(f'{path}: "time_data" is {data.dtype}, {data.shape}', "give real samples (T, N)")
        if "sample_freq" not in data.attrs:
            problem = f'{path}: "time_data" has no attribute "sample_freq", the sampling rate in Hz'
            raise InputError(problem, "add it")
        rate = np.asarray(data.attrs["sample_freq"])
        if rate.size != 1 or rate.dtype.kind not in "fiu":
            raise InputError(f'{path}: "sample_freq" is {shown(rate.tolist(), 80)}', "give one number, the rate in Hz")
        samples, channels = data.shape

    def block(start: int, stop: int, chosen: np.ndarray) -> np.ndarray:
        values = np.empty((len(chosen), stop - start))
        with damaged(f"{path} cannot be read at sample {start}", "copy the file again"), h5py.File(path, "r") as file:
            for first, last in ranges(stop - start, RANGE_SAMPLES // channels):
                values[:, first:last] = file["time_data"][start + first : start + last].T[chosen]
        return values

    return Recording(str(path), None, float(rate.item()), int(channels), int(samples), block)


FORMATS = (Format((".h5", ".hdf5"), read=isolated(_read_hdf5)),)
