"""The variables of a SOFA file: numbers, positions in metres, and which responses belong to one source.

open_sofa             the file; any error of its reader becomes an InputError
values_of             a variable, complete and finite
impulse_responses     Data.IR and the order of its axes
receiver_positions    where each receiver stood in each measurement
sources_of            which measurements are of the same source
measurements_of       the measurements and the emitter of one source
delays_of             whole samples by which each response begins late
"""

from __future__ import annotations

import contextlib
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...model.validation import InputError

AXES = "MRNE"  # measurements, receivers, samples, emitters


@dataclass(frozen=True)
class SofaTolerances:
    """What counts as equal in a SOFA file."""

    same_position: float = 1e-6  # distance of two sources that are one, metres
    whole_delay: float = 1e-3  # distance of a delay from a whole number, samples
    max_delay: int = 10_000_000  # samples


TOLERANCES = SofaTolerances()


@contextlib.contextmanager
def open_sofa(path: Path):
    """Yield the open file with its `variables`; any error of its reader becomes an InputError."""
    from . import needs

    sofar = needs("sofar")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about conventions that have been replaced, which are read all the same
            with sofar.SofaStream(str(path)) as stream:
                yield stream._file
    except InputError:
        raise
    except Exception as error:  # a damaged file raises anything
        raise InputError(f"{path} is not a SOFA file that can be read: {error}") from error


def values_of(file, path: Path, name: str) -> np.ndarray:
    """Return a variable as real numbers; raise InputError where it is missing, empty or not finite."""
    if name not in file.variables:
        raise InputError(f'{path} has no "{name}"', "write it with the library of the format", key=name)
    values = np.ma.filled(np.ma.asarray(file.variables[name][:]).astype(float), np.nan)
    if not values.size or not np.all(np.isfinite(values)):
        raise InputError(f'{path}: "{name}" is empty or not finite', "fill it in", key=name)
    return values


def number_of(file, path: Path, name: str) -> float:
    """Return a variable that has one value; raise InputError where it has several."""
    values = np.unique(values_of(file, path, name))
    if len(values) > 1:
        raise InputError(
            f'{path}: "{name}" has different values, {values[0]:g} and {values[-1]:g}', "use one for all", key=name
        )
    return float(values[0])


def cartesian(file, path: Path, name: str) -> np.ndarray:
    """Return a position or direction as x, y, z along axis 1 : (I or M or R, 3, ...) float64, metres."""
    values = values_of(file, path, name)
    if values.ndim < 2 or values.shape[1] != 3:
        raise InputError(f'{path}: "{name}" has shape {values.shape}', "give each position three coordinates", key=name)
    variable = file.variables[name]
    kind, units = (str(getattr(variable, key, "")).strip().lower() for key in ("Type", "Units"))
    if kind in ("", "cartesian"):
        if "deg" in units:
            raise InputError(f'{path}: "{name}" is cartesian but in degrees', 'make its Type "spherical"', key=name)
        return values
    if kind != "spherical":
        raise InputError(f'{path}: "{name}" is of Type "{kind}"', "use cartesian or spherical", key=name)
    azimuth, elevation, radius = np.moveaxis(values, 1, 0)
    if "rad" not in units:
        azimuth, elevation = np.radians(azimuth), np.radians(elevation)
    across = radius * np.cos(elevation)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), radius * np.sin(elevation)], axis=1)


def receiver_positions(file, path: Path, measurements: int, receivers: int) -> np.ndarray:
    """Return where each receiver stood in each measurement : (M, R, 3) float64, metres."""
    listener = each_of(cartesian(file, path, "ListenerPosition"), path, "ListenerPosition", measurements)
    local = cartesian(file, path, "ReceiverPosition")
    if local.ndim == 2:
        local = local[:, :, None]
    local = each_of(local, path, "ReceiverPosition", receivers)
    local = each_of(np.moveaxis(local, 2, 0), path, "ReceiverPosition", measurements)  # (M, R, 3)
    if "ListenerView" in file.variables and "ListenerUp" in file.variables:
        view = each_of(cartesian(file, path, "ListenerView"), path, "ListenerView", measurements)
        up = each_of(cartesian(file, path, "ListenerUp"), path, "ListenerUp", measurements)
        side = np.cross(up, view)
        axes = np.stack([view, side, np.cross(view, side)], axis=1)
        length = np.linalg.norm(axes, axis=2, keepdims=True)
        if np.any(length < 1e-9):
            raise InputError(f"{path}: ListenerView and ListenerUp are not two directions", "correct them")
        local = np.einsum("mri,mij->mrj", local, axes / length)
    return listener[:, None] + local


def each_of(values: np.ndarray, path: Path, name: str, count: int) -> np.ndarray:
    """Return values for each of `count`; one for all is repeated."""
    if len(values) not in (1, count):
        raise InputError(f'{path}: "{name}" has {len(values)} rows', f"give 1 or {count}", key=name)
    return np.broadcast_to(values, (count, *values.shape[1:])) if len(values) == 1 else values


def sources_of(file, path: Path, measurements: int) -> np.ndarray:
    """Return the place of the source of each measurement : (M,) int64; places count in the order of the file."""
    places = each_of(cartesian(file, path, "SourcePosition"), path, "SourcePosition", measurements)
    firsts: list[int] = []
    member = np.zeros(measurements, np.int64)
    for m in range(measurements):
        near = [g for g, f in enumerate(firsts) if np.linalg.norm(places[m] - places[f]) < TOLERANCES.same_position]
        member[m] = near[0] if near else len(firsts)
        if not near:
            firsts.append(m)
    return member


def measurements_of(file, path: Path, measurements: int, emitters: int, wanted: int | None) -> tuple[np.ndarray, int]:
    """Return the measurements of one source, and its emitter; sources are counted in the order of the file."""
    member = sources_of(file, path, measurements)
    count = (int(member.max()) + 1) * emitters
    wanted = 0 if wanted is None else wanted
    if not 0 <= wanted < count:
        raise InputError(
            f"source = {wanted} does not exist", f"{path} has sources 0 to {count - 1}", key="source", value=wanted
        )
    return np.flatnonzero(member == wanted // emitters), wanted % emitters


def impulse_responses(file, path: Path):
    """Return the variable Data.IR, its shape as a dict of AXES, and the order of its axes.

    Raises InputError: the file has no impulse responses.
    """
    ir = file.variables.get("Data.IR")
    if ir is None or ir.ndim not in (3, 4) or not all(ir.shape):
        kind = getattr(file, "DataType", "unknown")
        raise InputError(f'{path} (DataType {kind}) has no impulse responses in "Data.IR"', "give one of type FIR")
    named = tuple(ir.dimensions)
    if sorted(named) != sorted(AXES[: ir.ndim]):  # other names: the order of the format is assumed
        named = tuple(AXES[: ir.ndim])
    return ir, {"E": 1} | dict(zip(named, ir.shape, strict=True)), named


def delays_of(file, path: Path, shape: dict[str, int], emitter: int) -> np.ndarray:
    """Return the number of samples by which each response begins later than the first of all : (M, R) int64.

    Raises InputError: a delay is not a whole number of samples, or too long.
    """
    count = shape["M"], shape["R"]
    if "Data.Delay" not in file.variables:
        return np.zeros(count, np.int64)
    delay = values_of(file, path, "Data.Delay")
    if delay.ndim == 3:
        delay = delay[:, :, min(emitter, delay.shape[2] - 1)]
    if delay.ndim != 2 or delay.shape[0] not in (1, count[0]) or delay.shape[1] not in (1, count[1]):
        raise InputError(f'{path}: "Data.Delay" has shape {delay.shape}', f"give shape {count}", key="Data.Delay")
    delay = np.broadcast_to(delay - delay.min(), count)
    if np.abs(delay - np.round(delay)).max() > TOLERANCES.whole_delay or delay.max() > TOLERANCES.max_delay:
        raise InputError(
            f'{path}: "Data.Delay" differs by {delay.max():g} samples, which is not a whole number that can be applied',
            "write the responses with their delays included",
            key="Data.Delay",
        )
    return np.round(delay).astype(np.int64)
