"""SOFA (AES69): impulse responses or transfer functions of several receivers, or of one that was moved.

Data.IR is (M, R, N) or, with several emitters, (M, R, N, E) or (M, R, E, N), as the names of its dimensions say: M
measurements with R receivers each, and N samples, which begin Data.Delay later. Data.Real and Data.Imag hold transfer
functions at N evenly spaced frequencies, which are converted into impulse responses. A measurement has the position of
the listener; a receiver has a position relative to the listener and turns with it. Each pair of a measurement and a
receiver that recorded the same source is a microphone; sources are numbered in the order of the file. Positions are
written as receivers, in the order of the microphones, without their names; names 0 to N - 1 determine the order.
"""

import contextlib
import warnings
from pathlib import Path

import numpy as np

from ...model.libraries import isolated_call, needs
from ...model.measurement import MicrophonePositions
from ...model.storage import damaged
from ...model.validation import InputError, StorageError, naming
from ..recording import ZERO_CELSIUS, Recording, sound_speed
from . import Format, read_apart, require_whole_file, wanted_source

AXES = "MRNE"  # measurements, receivers, samples, emitters


SAME_POSITION = 1e-6  # metres, distance up to which two source positions are the same
WHOLE_DELAY = 1e-3  # samples, largest distance of a delay from a whole number
EVEN = 0.01  # largest distance of a frequency from a multiple of the spacing, in spacings
MAX_DELAY = 10_000_000  # largest delay of a response, samples, and largest number of a frequency, in spacings


@contextlib.contextmanager
def open_sofa(path: Path):
    """Yield the open file with its `variables`; an error in the file becomes an InputError that names it."""
    sofar = needs("sofar")
    require_whole_file(path)
    with naming(path), damaged(f"{path} is not a readable SOFA file"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about deprecated conventions, which are read nevertheless
        with sofar.SofaStream(str(path)) as stream:
            yield stream._file


def values_of(file, name: str) -> np.ndarray:
    """Return a variable as real numbers; raise InputError if it is missing, empty or not finite."""
    if name not in file.variables:
        raise InputError(f'it has no "{name}"', "write the file with a SOFA library", key=name)
    values = np.ma.filled(np.ma.asarray(file.variables[name][:]).astype(float), np.nan)
    if not values.size or not np.all(np.isfinite(values)):
        raise InputError(f'"{name}" is empty or not finite', "fill it in", key=name)
    return values


def cartesian(file, name: str, count: int | None = None) -> np.ndarray:
    """Return a position or direction as x, y, z along axis 1, for each of `count` : (count, 3, ...) float64, metres."""
    values = values_of(file, name)
    values = values if count is None else each_of(values, name, count)
    if values.ndim < 2 or values.shape[1] != 3:
        raise InputError(f'"{name}" has shape {values.shape}', "give each position three coordinates", key=name)
    kind, units = (str(getattr(file.variables[name], key, "")).strip().lower() for key in ("Type", "Units"))
    prefix = {"milli": 1e-3, "mm": 1e-3, "centi": 1e-2, "cm": 1e-2}
    values = values * next((scale for unit, scale in prefix.items() if units.startswith(unit)), 1.0)
    if kind in ("", "cartesian"):
        if "deg" in units:
            raise InputError(f'"{name}" is cartesian but in degrees', 'make its Type "spherical"', key=name)
        return values
    if kind != "spherical":
        raise InputError(f'"{name}" is of Type "{kind}"', "use cartesian or spherical", key=name)
    azimuth, elevation, radius = np.moveaxis(values, 1, 0)
    if "rad" not in units:
        azimuth, elevation = np.radians(azimuth), np.radians(elevation)
    return from_spherical(azimuth, elevation, radius)


def from_spherical(azimuth: np.ndarray, elevation: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Return x, y, z along axis 1 of angles, radians, and radii."""
    across = radius * np.cos(elevation)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), radius * np.sin(elevation)], axis=1)


def receiver_positions(file, measurements: int, receivers: int) -> np.ndarray:
    """Return where each receiver stood in each measurement : (M, R, 3) float64, metres."""
    listener = cartesian(file, "ListenerPosition", measurements)
    local = cartesian(file, "ReceiverPosition")
    if local.ndim == 2:
        local = local[:, :, None]
    local = each_of(local, "ReceiverPosition", receivers)
    local = each_of(np.moveaxis(local, 2, 0), "ReceiverPosition", measurements)  # (M, R, 3)
    if "ListenerView" in file.variables and "ListenerUp" in file.variables:
        view = cartesian(file, "ListenerView", measurements)
        side = np.cross(cartesian(file, "ListenerUp", measurements), view)
        axes = np.stack([view, side, np.cross(view, side)], axis=1)
        length = np.linalg.norm(axes, axis=2, keepdims=True)
        if np.any(length < 1e-9):
            raise InputError("ListenerView and ListenerUp are not two directions", "correct them")
        local = np.einsum("mri,mij->mrj", local, axes / length)
    return listener[:, None] + local


def placed_receivers(path: Path) -> np.ndarray:
    """Return the positions (N, 3), metres, of the channels of the first source; the responses are not read."""
    with open_sofa(path) as file:
        _, shape, _ = responses(file)
        return receiver_positions(file, shape["M"], shape["R"])[sources_of(file, shape["M"]) == 0].reshape(-1, 3)


def each_of(values: np.ndarray, name: str, count: int) -> np.ndarray:
    """Return one row of values for each of `count`; a single row is repeated."""
    if len(values) not in (1, count):
        raise InputError(f'"{name}" has {len(values)} rows', f"give 1 or {count}", key=name)
    return np.broadcast_to(values, (count, *values.shape[1:])) if len(values) == 1 else values


def sources_of(file, measurements: int) -> np.ndarray:
    """Return the number of the source position of each measurement : (M,) int64, numbered in the order of the file."""
    places = cartesian(file, "SourcePosition", measurements)
    firsts, member = list[np.ndarray](), list[int]()
    for place in places:
        near = [g for g, first in enumerate(firsts) if np.linalg.norm(place - first) < SAME_POSITION]
        member.append(near[0] if near else len(firsts))
        firsts += [] if near else [place]
    return np.array(member)


def responses(file) -> tuple[list[str], dict[str, int], tuple[str, ...]]:
    """Return the names of the data variables, a dictionary of lengths by the letters of AXES, and the order of axes."""
    names = ["Data.Real", "Data.Imag"] if "Data.Real" in file.variables else ["Data.IR"]
    found = [file.variables.get(name) for name in names]
    if any(one is None or one.ndim not in (3, 4) or not all(one.shape) or one.shape != found[0].shape for one in found):
        held = f'neither "Data.IR" nor "Data.Real" of 3 or 4 axes (DataType {getattr(file, "DataType", "unknown")})'
        raise InputError(f"it has {held}", "give responses or transfer functions")
    named = tuple(found[0].dimensions)
    if sorted(named) != sorted(AXES[: found[0].ndim]):  # other names: the order of the format is assumed
        named = tuple(AXES[: found[0].ndim])
    return names, {"E": 1} | dict(zip(named, found[0].shape, strict=True)), named


def frequencies_of(file, count: int) -> tuple[float, int]:
    """Return the spacing, Hz, of the frequencies of transfer functions, and the first frequency divided by it."""
    f = values_of(file, "N").ravel() * _kilo(file, "N")
    step = (f[-1] - f[0]) / max(len(f) - 1, 1)
    if len(f) != count or len(f) < 2 or not 0 < step <= 1e7 or f[0] < 0 or f[-1] > MAX_DELAY * step:
        raise InputError(f'"N" must hold {count} ascending frequencies', "write them in Hz", key="N")
    below = round(f[0] / step)
    if np.abs(f - step * (below + np.arange(count))).max() > EVEN * step:
        raise InputError('the frequencies "N" are not evenly spaced from 0', "write impulse responses", key="N")
    return float(step), below


def _kilo(file, name: str) -> float:
    return 1000.0 if str(getattr(file.variables[name], "Units", "")).lower().startswith("k") else 1.0


def delays_of(file, shape: dict[str, int], emitter: int) -> np.ndarray:
    """Return the delay of each response after the earliest one, in whole samples : (M, R) int64."""
    count = shape["M"], shape["R"]
    if "Data.Delay" not in file.variables:
        return np.zeros(count, np.int64)
    delay = values_of(file, "Data.Delay")
    if delay.ndim == 3:
        delay = delay[:, :, min(emitter, delay.shape[2] - 1)]
    if delay.ndim != 2 or delay.shape[0] not in (1, count[0]) or delay.shape[1] not in (1, count[1]):
        raise InputError(f'"Data.Delay" has shape {delay.shape}', f"give shape {count}", key="Data.Delay")
    delay = np.broadcast_to(delay - delay.min(), count)
    if np.abs(delay - np.round(delay)).max() > WHOLE_DELAY or delay.max() > MAX_DELAY:
        problem = f'"Data.Delay" differs by up to {delay.max():g} samples, not by whole numbers up to {MAX_DELAY:,}'
        raise InputError(problem, "write the responses with their delays included", key="Data.Delay")
    return np.round(delay).astype(np.int64)


def _read(path: Path, source: int | None = None, rate: float | None = None) -> Recording:
    """Return the recording of a SOFA file, read in pieces."""
    with open_sofa(path) as file:
        names, shape, axes = responses(file)
        step, below, odd = 0.0, 0, False
        if len(names) > 1:
            step, below = frequencies_of(file, shape["N"])
            bins = below + shape["N"]
            last = [file.variables[name][tuple(-1 if axis == "N" else slice(None) for axis in axes)] for name in names]
            # The last frequency is half the sampling rate only if its value is real.
            odd = bool(np.any(np.abs(last[1]) > 1e-6 * np.max(np.abs(last))))
            shape |= {"N": 2 * bins - 2 + odd}
            rates = [round(step * shape["N"], 6)]
        else:
            rates = np.unique(values_of(file, "Data.SamplingRate")) * _kilo(file, "Data.SamplingRate")
        if len(rates) > 1:
            values = f"{rates[0]:g} and {rates[-1]:g}"
            raise InputError(f'"Data.SamplingRate" is {values}', "use one for all", key="Data.SamplingRate")
        positions = receiver_positions(file, shape["M"], shape["R"])
        member = sources_of(file, shape["M"])
        wanted = wanted_source(source, (int(member.max()) + 1) * shape["E"])
        group, emitter = np.flatnonzero(member == wanted // shape["E"]), wanted % shape["E"]
        delays = delays_of(file, shape, emitter)
        speed = None
        if "RoomTemperature" in file.variables:
            kelvin = float(np.mean(values_of(file, "RoomTemperature")))
            if "cels" in str(getattr(file.variables["RoomTemperature"], "Units", "")).lower():
                kelvin += ZERO_CELSIUS
            if 100 < kelvin < 1000:  # 0 K is the default of the format
                speed = sound_speed(kelvin - ZERO_CELSIUS)
    pairs = np.array([(m, r) for m in group for r in range(shape["R"])])
    delays = delays[pairs[:, 0], pairs[:, 1]]
    samples = shape["N"] + int(delays.max())

    def block(start: int, stop: int, chosen: np.ndarray) -> np.ndarray:
        values = np.zeros((len(chosen), stop - start))
        with open_sofa(path) as file:
            data = [file.variables[name] for name in names]
            for row, (m, r), begin in zip(values, pairs[chosen], delays[chosen].tolist(), strict=True):
                first, last = (min(max(sample - begin, 0), shape["N"]) for sample in (start, stop))
                index = {"M": int(m), "R": int(r), "N": slice(first, last) if step == 0 else slice(None), "E": emitter}
                parts = [np.ma.filled(one[tuple(index[axis] for axis in axes)].astype(float), np.nan) for one in data]
                part = parts[0]
                if step:
                    part = np.fft.irfft(np.pad(parts[0] + 1j * parts[1], (below, 0)), shape["N"])[first:last]
                row[first + begin - start : last + begin - start] = part
        return values

    positions = positions[pairs[:, 0], pairs[:, 1]]
    return Recording(
        str(path), "impulse", float(rates[0]), len(pairs), samples, block,
        positions=positions, sound_speed=speed, lowest=step * below,
    )  # fmt: skip


def _source_count(path: Path) -> int:
    """Return the number of sources: source positions times emitters."""
    with open_sofa(path) as file:
        _, shape, _ = responses(file)
        return len(np.unique(sources_of(file, shape["M"]))) * shape["E"]


def _write(path: Path, placed: MicrophonePositions) -> None:
    """Write the positions as the receivers of one measurement, whose responses are unit impulses."""
    sofar = needs("sofar")
    count = len(placed.names)
    positions, numbers = placed.positions, {str(n): n for n in range(count)}
    if set(placed.names) == set(numbers):  # the names are the numbers of the channels
        positions = positions[np.argsort([numbers[name] for name in placed.names])]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sofa = sofar.Sofa("SingleRoomSRIR")
        sofa.Data_IR, sofa.Data_Delay = np.ones((1, count, 1)), np.zeros((1, count))
        sofa.GLOBAL_Title = "microphone positions found by fdcal; Data.IR is a placeholder"
        sofa.ReceiverPosition = positions[:, :, None]
        sofa.ReceiverPosition_Type, sofa.ReceiverPosition_Units = "cartesian", "metre"
        for name, direction in (("View", [1.0, 0, 0]), ("Up", [0, 0, 1.0])):  # orientations are unknown
            setattr(sofa, f"Receiver{name}", np.tile(direction, (count, 1))[:, :, None])
        for name in [name for name in vars(sofa) if name.endswith("Descriptions")]:
            sofa.delete(name)  # optional, and with netCDF4 1.7.5 sofar cannot write a text for each receiver
        try:
            sofar.write_sofa(str(path), sofa)
        except RuntimeError as error:  # from HDF5, which does not report a full disk
            raise StorageError(f"the file cannot be written; is the disk full? ({error})") from error


FORMATS = (
    Format(
        (".sofa",),
        read=lambda *given: read_apart(_read, *given),
        write=lambda path, placed: isolated_call(path, _write, path, placed),
        source_count=lambda path: isolated_call(path, _source_count, path),
    ),
)
