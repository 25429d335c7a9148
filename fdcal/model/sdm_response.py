"""Impulse responses with directions of arrival, from the spatial decomposition method (SDM), as MATLAB files.

p                   (T,) pressure, or (T, 1)
azi_rad, ele_rad    (T,) direction of arrival of each sample, radians
fs                  sampling rate, Hz

SciPy's compiled reader takes the type of a data element as an index and does not check it: a damaged file ends the
process. Therefore the few arrays of a MATLAB file (versions 5 to 7) that fdcal needs are read here. An element is a tag
(type, number of bytes) and data. A variable is an element of type MATRIX; its data are the elements flags, dimensions,
name and values. Source: MathWorks, MAT-File Format, "Level 5 MAT-File Format".
"""

import math
import struct
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .storage import read_bytes
from .validation import LIMITS, InputError, require_array, shown

HEADER = 128  # bytes; the last two tell the byte order, the two before them the version
BYTE_ORDERS = {b"IM": "<", b"MI": ">"}
VERSION = 1  # of the format in versions 5 to 7
FLAGS, DIMENSIONS, NAME = {6}, {5, 6}, {1, 16}  # types of the first three elements of a variable
MATRIX, COMPRESSED = 14, 15  # types of the elements at the top level
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
NUMBER_CLASSES = range(6, 16)  # of variables: double, single, and integers of 8 to 64 bits
OPAQUE_CLASS = 17  # of an object, which has no dimensions
COMPLEX = 0x800  # flag of a variable
MAX_HEAD = 4096  # bytes of a compressed variable that are unfolded to learn its name
MAX_VARIABLE = 64 * 2**20  # bytes that a compressed variable may unfold to


class Element(NamedTuple):
    """Type and data."""

    kind: int
    data: bytes


def read_arrays(data: bytes, names: Collection[str], path: str) -> dict[str, np.ndarray]:
    """Return those of the variables `names` that a file has, each an array of real numbers of its own type."""
    order = BYTE_ORDERS.get(data[HEADER - 2 : HEADER])
    if order is None or struct.unpack(f"{order}H", data[HEADER - 4 : HEADER - 2])[0] >> 8 != VERSION:
        raise InputError(f"{path} is not a MATLAB file of version 5 to 7", "save it with save(..., '-v7')")
    found: dict[str, np.ndarray] = {}
    try:
        for element in _elements(data[HEADER:], order, padded=False):
            name = _name(element, order)
            if name in names and name not in found:
                found[name] = _array(name, _unfolded(element, order, MAX_VARIABLE), order)
    except (ValueError, struct.error, zlib.error) as error:
        cause = str(error) if isinstance(error, ValueError) else "it is cut off or damaged"
        raise InputError(f"{path} is not a MATLAB file that can be read: {cause}", "save it again") from error
    return found


def _elements(data: bytes, order: str, padded: bool = True) -> Iterator[Element]:
    """Yield the elements of some data; `padded` ones end at multiples of 8 bytes."""
    start = 0
    while start < len(data):
        kind, size = struct.unpack_from(f"{order}II", data, start)
        if kind >> 16:  # a small element: size and type share four bytes, the data are the next four
            size, kind, begin, end = kind >> 16, kind & 0xFFFF, start + 4, start + 8
            whole = size <= 4
        else:
            begin = start + 8
            end = begin + size + (-size % 8 if padded else 0)
            whole = begin + size <= len(data)
        if not whole:
            raise ValueError("it is cut off")
        yield Element(kind, data[begin : begin + size])
        start = end


def _unfolded(element: Element, order: str, limit: int, whole: bool = True) -> bytes:
    """Return the data of a variable, of a compressed one the first `limit` bytes; ValueError if it is wanted whole."""
    if element.kind == COMPRESSED:
        unfolding = zlib.decompressobj()
        data = unfolding.decompress(element.data, limit)
        if whole and unfolding.unconsumed_tail:
            raise ValueError(f"a variable has more than {limit:,} bytes")
        element = Element(struct.unpack_from(f"{order}I", data)[0], data[8:])
    if element.kind != MATRIX:
        raise ValueError("it holds something else than variables")
    return element.data


def _name(element: Element, order: str) -> str:
    """Return the name of a variable; "" for an object."""
    head = list(islice(_elements(_unfolded(element, order, MAX_HEAD, whole=False), order), 3))
    if not head or head[0].kind not in FLAGS or len(head[0].data) != 8:
        raise ValueError("a variable has no flags")
    if head[0].data[0 if order == "<" else 3] == OPAQUE_CLASS:
        return ""
    if len(head) < 3 or head[1].kind not in DIMENSIONS or head[2].kind not in NAME:
        raise ValueError("a variable has no dimensions or no name")
    return head[2].data.decode("utf-8", "replace")


def _array(name: str, data: bytes, order: str) -> np.ndarray:
    """Return a variable as an array of real numbers."""
    flags, dimensions, _, *values = islice(_elements(data, order), 4)
    flag = struct.unpack(f"{order}I", flags.data[:4])[0]
    if flag & 0xFF not in NUMBER_CLASSES or flag & COMPLEX or not values or values[0].kind not in NUMBERS:
        raise ValueError(f'"{name}" is no array of real numbers')
    shape = np.frombuffer(dimensions.data, f"{order}i4").tolist()
    numbers = np.frombuffer(values[0].data, order + NUMBERS[values[0].kind])
    if min(shape, default=-1) < 0 or math.prod(shape) != len(numbers):
        raise ValueError(f'"{name}" has {len(numbers)} numbers and not {" x ".join(map(str, shape))}')
    return numbers.reshape(shape, order="F")


KEYS = ("p", "azi_rad", "ele_rad", "fs")


DIRECT_SOUND = 0.1  # level at which the direct sound begins, as a fraction of the peak
SEGMENTS = 20  # parts of equal length whose peaks are compared; the fewest samples
END_PEAK = 5.0  # peak of the last part at most, as a multiple of that of the quietest one
SAMPLE_RATES = (100.0, 1e6)  # Hz
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
    pressure, azimuth, elevation, sample_rate = _variables(Path(path))
    start = direct_sound(pressure, str(path))
    require_unwrapped(pressure, start, str(path))
    across = np.cos(elevation)
    directions = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)], axis=1)
    times = np.arange(len(pressure)) / sample_rate
    return SdmResponse(pressure[start:], directions[start:], times[start:], sample_rate)


def direct_sound(pressure: np.ndarray, path: str = "response") -> int:
    """Return the first sample (T,) whose magnitude reaches a tenth of the peak; InputError for silence."""
    level = np.abs(pressure)
    if not level.max() > 0:
        raise InputError(f"{path}: the response is silent", "measure it again", key="p")
    return int(np.argmax(level >= DIRECT_SOUND * level.max()))


def require_unwrapped(pressure: np.ndarray, start: int, path: str = "response") -> None:
    """Raise InputError for a response (T,) that begins at the end of the file.

    The sound of a room dies away. If the last samples are louder than the quietest ones after the direct sound, they
    are the beginning of the response, from a circular deconvolution, and the waves of the file are in a wrong order.
    """
    segments = min(SEGMENTS, len(pressure) - start)
    peaks = np.array([np.abs(part).max() for part in np.array_split(pressure[start:], segments)])
    if len(pressure) - start < len(pressure) / 2 or peaks[-1] > END_PEAK * peaks.min():
        problem = f"{path}: the response wraps round: its beginning is at the end of the file"
        remedy = "shift it so that it begins with the direct sound, and take the silence before it off the end"
        raise InputError(problem, remedy, key="p")


def _variables(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return pressure, azimuth and elevation, each (T,), and the sampling rate of a file, checked."""
    table = read_arrays(read_bytes(path, LIMITS.unfolded), KEYS, str(path))
    remedy = f"give {', '.join(KEYS[:-1])} (T,) and {KEYS[-1]}"
    for key in KEYS:
        if key not in table:
            raise InputError(f'{path} has no "{key}"', remedy, key=key)
    columns = [require_array(f"{path}: {key}", np.ravel(table[key]), "real", (None,)) for key in KEYS]
    pressure, azimuth, elevation, rate = columns
    if not SEGMENTS <= len(pressure) <= MAX_SAMPLES:
        raise InputError(f"{path}: p has {len(pressure)} samples", f"give {SEGMENTS} to {MAX_SAMPLES}", key="p")
    for key, column in (("azi_rad", azimuth), ("ele_rad", elevation)):
        if len(column) != len(pressure):
            problem = f"{path}: {key} has {len(column)} samples and p has {len(pressure)}"
            raise InputError(problem, "give one direction for each sample", key=key)
    low, high = SAMPLE_RATES
    if len(rate) != 1 or not low <= rate[0] <= high:
        problem = f"{path}: fs = {shown(rate.tolist())} is no sampling rate"
        raise InputError(problem, f"use {low:g} to {high:g} Hz", key="fs")
    return pressure, azimuth, elevation, float(rate[0])
