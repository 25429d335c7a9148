"""Recordings in files of arrays: of NumPy, MATLAB and HDF5, and tables of samples.

The samples are the array called `recordings` (N, T), or `time_data` (T, N) as in Acoular; or else the only array of
real numbers with a long axis for time and at most one other axis, for channels. The file may also hold `kind`, `names`,
`positions`, `sound_speed`, and the sampling rate under one of the names in RATES, as a number or a text, or as an
attribute.
If the file has no rate, that of `fdcal.recordings.recording.ImportOptions` is used.

.npz, .npy       of NumPy; an .npz file with `pressures` is a measurement (`fdcal.model.measurement`)
.mat             of MATLAB, structures included, of any version
.h5, .hdf5       HDF5, groups included
.csv, .tsv, .txt one line for each time, one column for each channel; a column of times gives the rate
folder           of MeshRIR: impulse responses of one microphone moved over a mesh, with several sources, 48 kHz:
                 pos_mic.npy (M, 3) and pos_src.npy (S, 3), metres; ir_<i>.npy (S, T), one for each of the M positions

S. Koyama, T. Nishida, K. Kimura, T. Abe, N. Ueno, J. Brunnström, "MeshRIR: A dataset of room impulse responses on
meshed grid points for evaluating sound field analysis and synthesis methods", WASPAA 2021.
"""

import contextlib
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...model.libraries import isolated_call, needs
from ...model.storage import damaged, load_archive, matlab_arrays, require_regular
from ...model.validation import InputError, require_array, require_choice, shown
from ..recording import KINDS, MIN_SAMPLES, RANGE_SAMPLES, Recording, ranges
from . import Format, read_apart, require_whole_file, wanted_source

MESHRIR_RATE = 48_000.0  # Hz, of the whole data set; no file contains it
# Names of arrays, in lower case, with letters only and without a unit.
RATES = "samplerate samplingrate samplefreq samplingfreq samplefrequency samplingfrequency fs sr rate srate".split()
TIMES = ("t", "time", "times", "zeit")
PLACES = "positions micpositions microphonepositions microphonepositionsm micpos posmic receiverpositions".split()
ORDERS = {"recordings": (0, 1), "timedata": (1, 0)}  # axes of channels and samples in an array of similar lengths
LONGER = 2  # the axis of time is at least this many times as long as the other one
UNEVEN = 0.01  # largest deviation of times from evenly spaced ones, in steps, besides the rounding of the times
MAX_LISTED = 6  # largest number of arrays that a message lists
OTHERS = {"kind": ("text", ()), "names": ("text", (None,)), "sound_speed": ("real", ())}
DIRECTIONS = {"azi_rad", "ele_rad"}  # arrays of a measured room: `fdcal.acoustics.plane_waves`

Arrays = Mapping[str, Any]  # by name: arrays of NumPy, or objects with shape, ndim and dtype
Opened = Callable[[], contextlib.AbstractContextManager[Any]]  # opens the array of the samples


def keys_of(path: Path) -> list[str]:
    """Return the names of the arrays in an archive; an empty list if it cannot be read."""
    try:
        require_regular(path)
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            return list(archive.files)
    except Exception:  # a damaged archive can raise any exception
        return []


def _word(name: str) -> str:
    return re.sub("[^a-z]", "", re.split(r"[/.]", name)[-1].lower())


def _rate(arrays: Arrays) -> float | None:
    """Return the sampling rate, Hz, that the arrays or their attributes hold; None if they hold none."""
    rates = dict[str, float]()
    for name, value in arrays.items():
        word, unit = re.fullmatch("(.*?)(khz|hz)?", _word(name)).groups()  # type: ignore
        if word not in RATES:
            continue
        single = np.ravel(value[()])[0] if value.shape in ((), (1,), (1, 1)) else f"an array {value.shape}"
        text = single.decode(errors="replace") if isinstance(single, bytes) else str(single)
        number = re.fullmatch(r"\s*(\d+\.?\d*(?:e\+?\d+)?)\s*(k?hz)?\s*", text, re.IGNORECASE)
        if number is None:
            raise InputError(f'"{shown(name)}" is {shown(text, 80)}', "give one number in Hz", key="rate")
        rates[name] = float(number[1]) * (1000 if "khz" in (unit, (number[2] or "").lower()) else 1)
    if len(set(rates.values())) > 1:
        listed = ", ".join(f"{shown(name)} = {hz:g}" for name, hz in rates.items())
        raise InputError(f"it has several sampling rates: {listed}", "keep one", key="rate")
    return next(iter(rates.values()), None)


def _rate_of_times(times: np.ndarray) -> float | None:
    """Return the sampling rate of evenly spaced times (T,), s; None for other values, such as numbers of samples."""
    if len(times) < MIN_SAMPLES or not np.all(np.isfinite(times)) or times[-1] <= times[0]:
        return None
    step = (times[-1] - times[0]) / (len(times) - 1)
    even = np.abs(times - times[0] - step * np.arange(len(times))).max() <= UNEVEN * step + 1e-6 * abs(times[-1])
    return float(1 / step) if even and step != 1 else None


def recording_in(
    path: Path, arrays: Arrays, rate: float | None, opened: Callable[[str], Opened] | None = None
) -> Recording:
    """Return the recording in arrays; raise InputError with a list of them if several may be the samples.

    `rate` is the sampling rate, Hz, if the arrays hold none. `opened` is for arrays that are not in memory: it returns
    the function that opens the array with a given name.
    """

    def long(array: Any) -> list[int]:
        return [axis for axis, length in enumerate(array.shape) if length > 1]

    beside = {*RATES, *TIMES, *PLACES}
    real = {
        name: array for name, array in arrays.items()
        if array.dtype.kind in "fiu" and 1 <= len(long(array)) <= 2 and max(array.shape) >= MIN_SAMPLES
        and min(array.shape) > 0 and re.sub("k?hz$", "", _word(name)) not in beside
    }  # fmt: skip
    found = [name for name in real if len(long(real[name])) == 2] or list(real)
    named = [name for name in found if _word(name) in ORDERS]
    found = named if len(named) == 1 else found
    if len(found) != 1:
        if set(arrays) >= DIRECTIONS:
            raise InputError(f"{path} holds an impulse response with directions", "use it as the room of a scene")
        which, listed = "several arrays that may be the samples", found
        if not found:
            which, listed = "no array of real samples", list(arrays)
        names = ", ".join(f'"{shown(one, 60)}" {arrays[one].shape}' for one in listed[:MAX_LISTED])
        raise InputError(f"{path} holds {which}: {names}", 'call the samples "recordings"', key="recordings")
    name, array = found[0], real[found[0]]
    axes = sorted(long(array), key=lambda axis: array.shape[axis])
    if len(axes) == 2 and array.shape[axes[1]] < LONGER * array.shape[axes[0]]:
        if _word(name) not in ORDERS:
            problem = f'{path}: it is not clear which axis of "{shown(name)}" {array.shape} is time'
            remedy = 'call it "recordings" and give it the shape (channels, samples)'
            raise InputError(problem, remedy, key="recordings")
        axes = [sorted(axes)[n] for n in ORDERS[_word(name)]]
    time, channel, dimensions = axes[-1], axes[0] if len(axes) == 2 else None, array.ndim
    count, samples = 1 if channel is None else array.shape[channel], array.shape[time]
    hertz = _rate(arrays)
    for key, times in arrays.items() if hertz is None else ():
        if _word(key) in TIMES and times.dtype.kind in "fiu" and times.size == samples:
            hertz = _rate_of_times(np.ravel(times[()]))
    hertz = rate if hertz is None else hertz
    if hertz is None:
        problem = f'{path} has no sampling rate beside "{shown(name)}" ({count} channels, {samples} samples)'
        raise InputError(problem, "give <rate> in Hz", key="rate")
    open_array = opened(name) if opened else lambda: contextlib.nullcontext(array)

    def block(start: int, stop: int, chosen: np.ndarray) -> np.ndarray:
        values = np.empty((len(chosen), stop - start))
        with open_array() as data:
            for first, last in ranges(stop - start, RANGE_SAMPLES // count):
                index: list[Any] = [0] * dimensions
                index[time] = slice(start + first, start + last)
                if channel is not None:
                    index[channel] = slice(None)
                part = np.asarray(data[tuple(index)])
                part = part[None] if channel is None else part.T if channel > time else part
                values[:, first:last] = part[chosen]
        return values

    others: dict[str, Any] = {
        key: require_array(f"{path}: {key}", np.array(np.squeeze(arrays[key]), ndmin=len(what[1])), *what).tolist()
        for key, what in OTHERS.items() if key in arrays and arrays[key].dtype.kind != "O"
    }  # fmt: skip
    if (kind := others.pop("kind", None)) is not None:
        require_choice(f"{path}: kind", kind, KINDS)
    places = [np.asarray(array[()]) for key, array in arrays.items() if _word(key) in PLACES and array.ndim == 2]
    if len(places) == 1:
        others["positions"] = places[0].T if places[0].shape[0] != count else places[0]
    return Recording(str(path), kind, hertz, count, samples, block, **others)


def _read_arrays(path: Path, source: int | None = None, rate: float | None = None) -> Recording:
    """Return the recording in a file of NumPy or MATLAB; only those of .npy or MATLAB 7.3 stay on disk."""
    suffix = path.suffix.lower()
    if suffix == ".npz" and "pressures" in keys_of(path):
        raise InputError(f"{path} is a measurement already", "give it to `fdcal calibrate`")
    if suffix == ".npz":
        return recording_in(path, load_archive(path, lambda key: True), rate)
    if suffix == ".npy":
        return recording_in(path, {path.stem: _mapped(path)}, rate)
    with open(path, "rb") as file:
        if file.read(19) == b"MATLAB 7.3 MAT-file":
            return read_apart(_read_hdf5, path, source, rate)
    return recording_in(path, isolated_call(path, matlab_arrays, path), rate)


def _read_table(path: Path, source: int | None = None, rate: float | None = None) -> Recording:
    """Return the recording in a table of numbers, with or without a header and a column of times."""
    from .positions import is_header  # that module loads the reader of SOFA

    def is_data(line: str) -> bool:
        with contextlib.suppress(ValueError):
            return bool([float(cell) for cell in line.split(delimiter)])
        return False

    wanted = "give one line for each time, one column for each channel"
    with damaged(f"{path} is not a table of samples", wanted):
        lines = [one for one in path.read_text(encoding="utf-8-sig").splitlines() if one.strip() and one[0] not in "#%"]
        delimiter = next((one for one in ";\t," if one in "".join(lines[-1:])), None)
        lines = lines if delimiter == "," else [line.replace(",", ".") for line in lines]
        begins = next((n for n, line in enumerate(lines) if is_data(line)), len(lines))
        head = [cell.strip(' "') for cell in lines[begins - 1].split(delimiter)] if begins else []
        if is_header(head):
            raise InputError(f"{path} is a table of positions", "give it as <positions>", key="positions")
        if begins == len(lines):
            raise InputError(f"{path} is not a table of samples", wanted)
        widths = [len(line.split(delimiter)) for line in lines[begins:]]
        if min(widths) < max(widths):
            problem = f"{path} has lines of {min(widths)} and of {max(widths)} numbers"
            raise InputError(problem, f"{wanted}; delete any other line, such as a sampling rate, and give <rate>")
        table = np.loadtxt(lines[begins:], delimiter=delimiter, ndmin=2)
    first, wide = table[:, 0], table.shape[1] > 1
    counting = wide and np.array_equal(first - first[0], np.arange(len(first)))
    hertz = _rate_of_times(first) if wide and not counting else None
    named = wide and len(head) == table.shape[1] and re.split("[^a-z]", head[0].lower())[0] in TIMES  # perhaps rounded
    arrays = {"recordings": table[:, 1:].T if counting or hertz or named else table.T}
    names = head[-len(arrays["recordings"]) :]
    if len(names) == len(arrays["recordings"]) == len(set(names)):
        arrays["names"] = np.array(names)
    if hertz is not None:
        in_ms = re.search(r"(\b|_)ms\b", "".join(head[:1]).lower())
        arrays["sample_rate"] = np.array(round(1000 * hertz if in_ms else hertz, 6))
    return recording_in(path, arrays, rate)


def _read_meshrir(path: Path, source: int | None = None, rate: float | None = None) -> Recording:
    """Return the responses to one source, the first by default; raise InputError for a damaged folder."""
    places, sources = (_positions(path / name) for name in ("pos_mic.npy", "pos_src.npy"))
    source = wanted_source(source, len(sources))
    missing = [n for n in range(len(places)) if not (path / f"ir_{n}.npy").exists()]
    if missing:
        raise InputError(f"{path} has {len(places)} positions but no ir_{missing[0]}.npy", "copy it again")
    samples = _mapped(path / "ir_0.npy").shape[-1]

    def block(start: int, stop: int, chosen: np.ndarray) -> np.ndarray:
        values = np.empty((len(chosen), stop - start))
        for row, n in enumerate(chosen):
            file, wanted = path / f"ir_{n}.npy", (len(sources), samples)
            data = _mapped(file)
            if data.shape != wanted:
                raise InputError(f"{file} has shape {data.shape}, not {wanted} like ir_0.npy", "copy it again")
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
    with damaged(f"{path} is damaged or truncated", "copy it again"):
        require_regular(path)
        with np.errstate(all="raise"):  # the shape in a damaged header may overflow
            values = np.load(path, mmap_mode="r", allow_pickle=False)
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu" or values.ndim == 0:
        raise InputError(f"{path} does not hold an array of real numbers", "copy it again")
    return values


def _read_hdf5(path: Path, source: int | None = None, rate: float | None = None) -> Recording:
    """Return the recording of an HDF5 file, read in pieces."""
    h5py = needs("h5py")
    require_whole_file(path)

    @contextlib.contextmanager
    def open_array(name: str) -> Iterator[Any]:
        with damaged(f"{path} cannot be read", "copy the file again"), h5py.File(path, "r") as file:
            yield file[name]

    with damaged(f"{path} is not a readable HDF5 file"), h5py.File(path, "r") as file:
        arrays = dict[str, Any]()

        def note(name: str, item: Any) -> None:
            if getattr(item, "shape", None) is not None and item.attrs.get("MATLAB_class") not in (b"char", b"cell"):
                text = h5py.check_string_dtype(item.dtype)
                arrays[name] = np.asarray(item.asstr(errors="replace")[()], str) if text else item
            arrays.update({f"{name}.{key}": np.asarray(value) for key, value in item.attrs.items()})

        note("", file)
        file.visititems(note)
        return recording_in(path, arrays, rate, lambda name: lambda: open_array(name))


FORMATS = (
    Format((".npz", ".npy", ".mat"), read=_read_arrays),
    Format((".csv", ".tsv", ".txt"), read=_read_table),
    Format(
        (),
        _read_meshrir,
        recognises=lambda path: path.is_dir() and ((path / "pos_mic.npy").exists() or (path / "ir_0.npy").exists()),
        source_count=lambda path: len(_positions(path / "pos_src.npy")),
    ),
    Format((".h5", ".hdf5"), read=lambda *given: read_apart(_read_hdf5, *given)),
)
