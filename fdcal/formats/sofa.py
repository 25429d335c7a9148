"""SOFA (AES69): impulse responses of several receivers, or of one that was moved.

Data.IR is (M, R, T) or, with several emitters, (M, R, T, E): M measurements with R receivers each. A measurement
places the listener, a receiver stands relative to it and is turned with it. Microphones are all pairs of measurement
and receiver that heard the same source; `--source` names one of several, in the order of the file.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np

from ..checks import InputError
from ..placed import Placed
from ..recording import ZERO_CELSIUS, Recording, sound_speed

NAME = "SOFA"
SUFFIXES = (".sofa",)
SEVERAL = True
SAME = 1e-6  # m: sources closer than this are one


def read(path: Path, source: int | None = None) -> Recording:
    """Recording of a SOFA file, streamed. Raises InputError for a damaged file or a convention without responses."""
    with _opened(path) as file:
        ir = file.variables.get("Data.IR")
        if ir is None or ir.ndim not in (3, 4) or not all(ir.shape):
            kind = getattr(file, "DataType", "unknown")
            raise InputError(f'{path} (DataType {kind}) has no impulse responses in "Data.IR"; give one of type FIR')
        measurements, receivers, samples = ir.shape[:3]
        emitters = ir.shape[3] if ir.ndim == 4 else 1
        rate = _number(file, path, "Data.SamplingRate")
        where = _receivers(file, path, measurements, receivers)
        group, emitter = _source(file, path, measurements, emitters, source)
        kelvin = _values(file, path, "RoomTemperature") if "RoomTemperature" in file.variables else np.zeros(1)
    pairs = np.array([(m, r) for m in group for r in range(receivers)])

    def block(start: int, stop: int, chosen: np.ndarray) -> np.ndarray:
        with _opened(path) as file:
            data, values = file.variables["Data.IR"], np.empty((len(chosen), stop - start))
            for row, (m, r) in enumerate(pairs[chosen]):
                part = (m, r, slice(start, stop)) + ((emitter,) if data.ndim == 4 else ())
                values[row] = np.ma.filled(data[part].astype(float), np.nan)
        return values

    warm = float(np.mean(kelvin))
    return Recording(
        str(path),
        "response",
        rate,
        len(pairs),
        samples,
        block,
        positions=where[pairs[:, 0], pairs[:, 1]],
        sound_speed=sound_speed(warm - ZERO_CELSIUS) if warm > 100 else None,  # 0 K is the default of the format
    )


def write(path: Path, placed: Placed, original: str | None = None) -> None:
    """The positions as receivers: of the `original` file if given, or of one with unit impulses for data.

    Receivers are in the order of the microphones; their names are not kept. Raises InputError where the original has
    another number of receivers, or moves them.
    """
    from . import needs

    sofar = needs("sofar")
    if original is not None and Path(original).suffix.lower() not in SUFFIXES:
        original = None
    try:
        sofa = sofar.Sofa("SingleRoomSRIR") if original is None else sofar.read_sofa(original, verbose=False)
    except Exception as error:
        raise InputError(f"{original} cannot be read: {error}") from error
    count = len(placed.names)
    if original is None:
        sofa.Data_IR = np.ones((1, count, 1))
        sofa.Data_Delay = np.zeros((1, count))
        sofa.GLOBAL_Title = "microphone positions found by fdcal; Data.IR is a placeholder"
        for name in ("View", "Up"):  # one for all: the directions of the microphones are not known
            setattr(
                sofa,
                f"Receiver{name}",
                np.tile(np.array([[1.0, 0, 0]] if name == "View" else [[0, 0, 1.0]]), (count, 1))[:, :, None],
            )
    elif np.shape(sofa.Data_IR)[0] != 1 or np.shape(sofa.Data_IR)[1] != count:
        raise InputError(
            f"{original} has responses of shape {np.shape(sofa.Data_IR)}; positions can be filled in where one"
            f" measurement has all {count} receivers. Leave out --original"
        )
    sofa.ListenerPosition, sofa.ListenerPosition_Type, sofa.ListenerPosition_Units = (
        np.zeros((1, 3)),
        "cartesian",
        "metre",
    )
    sofa.ListenerView, sofa.ListenerUp = np.array([[1.0, 0, 0]]), np.array([[0, 0, 1.0]])
    sofa.ReceiverPosition = placed.positions[:, :, None]
    sofa.ReceiverPosition_Type, sofa.ReceiverPosition_Units = "cartesian", "metre"
    for name in [name for name in vars(sofa) if name.endswith("Descriptions")]:
        sofa.delete(name)  # optional, and with netCDF4 1.7.5 sofar cannot write a text for each
    sofar.write_sofa(str(path), sofa)


@contextlib.contextmanager
def _opened(path: Path):
    """The file by its variables; a reader's fault becomes an InputError."""
    from . import needs

    sofar = needs("sofar")
    try:
        with sofar.SofaStream(str(path)) as stream:
            yield stream._file
    except InputError:
        raise
    except Exception as error:  # a damaged file raises anything
        raise InputError(f"{path} is no SOFA file that can be read: {error}") from error


def _values(file, path: Path, name: str) -> np.ndarray:
    """A variable as real numbers. Raises InputError where it is missing, empty or not finite."""
    if name not in file.variables:
        raise InputError(f'{path} has no "{name}"; write it with the format\'s own library')
    values = np.ma.filled(np.ma.asarray(file.variables[name][:]).astype(float), np.nan)
    if not values.size or not np.all(np.isfinite(values)):
        raise InputError(f'{path}: "{name}" is empty or not finite; fill it in')
    return values


def _number(file, path: Path, name: str) -> float:
    values = np.unique(_values(file, path, name))
    if len(values) > 1:
        raise InputError(f'{path}: "{name}" has different values, {values[0]:g} and {values[-1]:g}; use one for all')
    return float(values[0])


def _cartesian(file, path: Path, name: str) -> np.ndarray:
    """A place or direction as x, y, z along axis 1 : (I or M or R, 3, ...) float64, metres."""
    values = _values(file, path, name)
    if values.ndim < 2 or values.shape[1] != 3:
        raise InputError(f'{path}: "{name}" has shape {values.shape}; each place must have three coordinates')
    variable = file.variables[name]
    kind, units = (str(getattr(variable, key, "")).strip().lower() for key in ("Type", "Units"))
    if kind in ("", "cartesian"):
        if "deg" in units:
            raise InputError(f'{path}: "{name}" is cartesian but in degrees; its Type should be "spherical"')
        return values
    if kind != "spherical":
        raise InputError(f'{path}: "{name}" is of Type "{kind}"; use cartesian or spherical')
    azimuth, elevation, radius = np.moveaxis(values, 1, 0)
    if "rad" not in units:
        azimuth, elevation = np.radians(azimuth), np.radians(elevation)
    across = radius * np.cos(elevation)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), radius * np.sin(elevation)], axis=1)


def _receivers(file, path: Path, measurements: int, receivers: int) -> np.ndarray:
    """Where each receiver stood in each measurement : (M, R, 3) float64, metres."""
    listener = _each(_cartesian(file, path, "ListenerPosition"), path, "ListenerPosition", measurements)
    local = _cartesian(file, path, "ReceiverPosition")
    if local.ndim == 2:
        local = local[:, :, None]
    local = _each(local, path, "ReceiverPosition", receivers)
    local = _each(np.moveaxis(local, 2, 0), path, "ReceiverPosition", measurements)  # (M, R, 3)
    if "ListenerView" in file.variables and "ListenerUp" in file.variables:
        view = _each(_cartesian(file, path, "ListenerView"), path, "ListenerView", measurements)
        up = _each(_cartesian(file, path, "ListenerUp"), path, "ListenerUp", measurements)
        side = np.cross(up, view)
        axes = np.stack([view, side, np.cross(view, side)], axis=1)
        length = np.linalg.norm(axes, axis=2, keepdims=True)
        if np.any(length < 1e-9):
            raise InputError(f"{path}: ListenerView and ListenerUp are no two directions; mend them")
        local = np.einsum("mri,mij->mrj", local, axes / length)
    return listener[:, None] + local


def _each(values: np.ndarray, path: Path, name: str, count: int) -> np.ndarray:
    """Values for each of `count`, one for all repeated."""
    if len(values) not in (1, count):
        raise InputError(f'{path}: "{name}" has {len(values)} rows where 1 or {count} fit; mend it')
    return np.broadcast_to(values, (count, *values.shape[1:])) if len(values) == 1 else values


def _source(file, path: Path, measurements: int, emitters: int, wanted: int | None) -> tuple[np.ndarray, int]:
    """Measurements of one source, and its emitter."""
    places = _each(_cartesian(file, path, "SourcePosition"), path, "SourcePosition", measurements)
    firsts: list[int] = []
    member = np.zeros(measurements, int)
    for m in range(measurements):
        near = [g for g, f in enumerate(firsts) if np.linalg.norm(places[m] - places[f]) < SAME]
        member[m] = near[0] if near else len(firsts)
        if not near:
            firsts.append(m)
    count = len(firsts) * emitters
    wanted = 0 if wanted is None else wanted
    if not 0 <= wanted < count:
        raise InputError(f"--source {wanted} is not there; {path} has sources 0 to {count - 1}")
    return np.flatnonzero(member == wanted // emitters), wanted % emitters
