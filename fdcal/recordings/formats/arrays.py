"""Recordings in files of arrays: of NumPy and HDF5.

.npz      `recordings` (N, T) and `sample_rate`, Hz; optionally `kind`, `names`, `positions`, `sound_speed`. A
          measurement, which has pressures instead, is read by `fdcal.model.measurement`.
folder    of MeshRIR: impulse responses of one microphone moved over a mesh, with several sources, 48 kHz: pos_mic.npy
          (M, 3) and pos_src.npy (S, 3), metres; ir_<i>.npy (S, T), one for each of the M places
.h5       of Acoular: `time_data` (T, N), one channel per microphone, with the attribute `sample_freq`, Hz

S. Koyama, T. Nishida, K. Kimura, T. Abe, N. Ueno, J. Brunnström, "MeshRIR: A dataset of room impulse responses on
meshed grid points for evaluating sound field analysis and synthesis methods", WASPAA 2021.
"""

from pathlib import Path
from typing import Any

import numpy as np

from ...model.libraries import needs
from ...model.storage import load_archive
from ...model.validation import InputError, StorageError, require_array, require_choice, shown
from ..recording import KINDS, RANGE_SAMPLES, Recording, ranges, recording_of
from . import Format, damaged, isolated, wanted_source

MESHRIR_RATE = 48_000.0  # Hz, of the whole data set; no file contains it
KEYS = {
    "recordings": ("real", (None, None)),
    "sample_rate": ("real", ()),
    "kind": ("text", ()),
    "names": ("text", (None,)),
    "positions": ("real", (None, None)),
    "sound_speed": ("real", ()),
}


def keys_of(path: Path) -> list[str]:
    """Return the names of the arrays in an archive; none where it cannot be read."""
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            return list(archive.files)
    except Exception:  # a damaged archive raises anything
        return []


def _read_npz(path: Path, source: int | None = None) -> Recording:
    """Return the recording of an archive; raise InputError for one that is damaged or has no recordings."""
    table = load_archive(path, KEYS.__contains__)
    if "pressures" in keys_of(path):
        raise InputError(f"{path} is a measurement already", "give it to `fdcal calibrate`")
    for key in ("recordings", "sample_rate"):
        if key not in table:
            problem = f'{path} has no "{key}"'
            raise InputError(problem, "give recordings (N, T) and sample_rate, or a measurement", key=key)
    value = {key: require_array(f"{path}: {key}", table[key], *KEYS[key]) for key in table if key != "recordings"}
    data = table["recordings"]
    if data.ndim != 2 or data.dtype.kind not in "fiu":
        raise InputError(f"{path}: recordings is {data.dtype} of shape {data.shape}", "give real numbers (N, T)")
    kind = value["kind"].item() if "kind" in value else None
    if kind is not None:
        require_choice(f"{path}: kind", kind, KINDS)
    return recording_of(
        str(path),
        kind,
        value["sample_rate"].item(),
        data,
        names=tuple(value["names"].tolist()) if "names" in value else (),
        positions=value.get("positions"),
        sound_speed=value["sound_speed"].item() if "sound_speed" in value else None,
    )


def _read_meshrir(path: Path, source: int | None = None) -> Recording:
    """Return the responses to one source, the first by default; raise InputError for a damaged folder."""
    places, sources = (_positions(path / name) for name in ("pos_mic.npy", "pos_src.npy"))
    source = wanted_source(path, source, len(sources))
    missing = [n for n in range(len(places)) if not (path / f"ir_{n}.npy").exists()]
    if missing:
        problem = f"{path} has {len(places)} positions but no ir_{missing[0]}.npy ({len(missing)} missing)"
        raise InputError(problem, "copy it again")
    samples = _mapped(path / "ir_0.npy").shape[-1]

    def block(start: int, stop: int, chosen: np.ndarray) -> np.ndarray:
        values = np.empty((len(chosen), stop - start))
        for row, n in enumerate(chosen):
            file, wanted = path / f"ir_{n}.npy", (len(sources), samples)
            data = _mapped(file)
            if data.shape != wanted:
                problem = f"{file} has shape {data.shape}, but pos_src.npy and ir_0.npy call for {wanted}"
                raise InputError(problem, "copy it again")
            values[row] = data[source, start:stop]
        return values

    return Recording(str(path), "impulse", MESHRIR_RATE, len(places), samples, block, positions=places)


def _positions(path: Path) -> np.ndarray:
    values = _mapped(path)
    if values.ndim != 2 or values.shape[1] != 3 or not len(values):
        raise InputError(f"{path} has shape {values.shape}", "it must be (number, 3), metres")
    if not np.all(np.isfinite(values)):
        raise InputError(f"{path} holds a number that is not finite", "repair it")
    return np.array(values, dtype=float)


def _mapped(path: Path) -> np.ndarray:
    """Return an .npy file of real numbers, memory-mapped."""
    try:
        with np.errstate(all="raise"):  # a damaged header may announce more bytes than there are numbers
            values = np.load(path, mmap_mode="r", allow_pickle=False)
    except OSError as error:
        raise StorageError(f"cannot read {path}: {error.strerror or error}") from error
    except Exception as error:  # a damaged header raises anything
        raise InputError(f"{path} is damaged or truncated ({error})", "copy it again") from error
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu" or values.ndim == 0:
        raise InputError(f"{path} holds no array of real numbers", "copy it again")
    return values


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
            raise InputError(f'{path}: "time_data" has no attribute "sample_freq", the sampling rate in Hz', "add it")
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


FORMATS = (
    Format((".npz",), read=_read_npz),
    Format(
        (),
        _read_meshrir,
        recognises=lambda path: path.is_dir() and ((path / "pos_mic.npy").exists() or (path / "ir_0.npy").exists()),
        source_count=lambda path: len(_positions(path / "pos_src.npy")),
    ),
    Format((".h5", ".hdf5"), read=isolated(_read_hdf5)),
)
