"""The data elements of MATLAB files of version 5, checked before SciPy reads them.

SciPy's compiled reader takes the type of an element as an index and does not check it: a damaged file ends the process.
An element is a tag (type, number of bytes) and data. A variable is an element of type MATRIX; its data are the elements
flags, dimensions, name and values, or the values' real and imaginary parts. Source: MathWorks, MAT-File Format.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Collection, Iterator
from itertools import islice
from typing import NamedTuple

from .validation import InputError

HEADER = 128  # bytes; the last two tell the byte order
BYTE_ORDERS = {b"IM": "<", b"MI": ">"}
HEADER_KINDS = (6, 5, 1)  # types of the first three elements of a variable: flags, dimensions and name
FLAGS_SIZE = 8  # bytes
MATRIX, COMPRESSED = 14, 15  # types of the elements at the top level
NUMBERS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13})  # types of elements that hold real numbers
NUMBER_CLASSES = range(6, 16)  # of variables: double, single, and integers of 8 to 64 bits
MAX_HEAD = 4096  # bytes of a compressed variable that are unfolded to learn its name
MAX_VARIABLE = 64 * 2**20  # bytes of a variable that is read, unfolded; a longer one counts as cut off


class Element(NamedTuple):
    """Type and data."""

    kind: int
    data: bytes


def require_readable(data: bytes, names: Collection[str], path: str) -> None:
    """Raise InputError unless the variables `names` in the data of a file are whole arrays of numbers.

    Variables that are missing are left to the caller; so are files of other versions, which SciPy reads without
    compiled code or refuses.

    Parameters
    ----------
    data : bytes
        The whole file.
    names : collection of str
        The variables that will be read.
    path : str
        Named in the message.

    Raises
    ------
    InputError
        An element is cut off or of an unknown type; a variable is too large, or is no array of numbers.
    """
    order = BYTE_ORDERS.get(data[HEADER - 2 : HEADER])
    version = data[HEADER - 4 : HEADER - 2]
    if 0 in data[:4] or version in (b"\x00\x02", b"\x02\x00"):  # versions 4 and 7.3
        return
    try:
        if order is None:
            raise ValueError("no byte order")
        for element in _elements(data[HEADER:], order, padded=False):
            _require_variable(element, order, names)
    except (ValueError, struct.error, zlib.error) as error:
        raise InputError(f"{path} is not a MATLAB file that can be read ({error})", "save it again") from error


def _elements(data: bytes, order: str, padded: bool = True) -> Iterator[Element]:
    """Yield the elements of some data; `padded` ones end at multiples of 8 bytes."""
    start = 0
    while start < len(data):
        kind, size = struct.unpack_from(f"{order}II", data, start)
        if kind >> 16:  # a small element: size and type share four bytes, the data are the next four
            size, kind, begin, end = kind >> 16, kind & 0xFFFF, start + 4, start + 8
            fits = size <= 4
        else:
            begin = start + 8
            end = begin + size + (-size % 8 if padded else 0)
            fits = begin + size <= len(data)
        if not fits:
            raise ValueError("it is cut off")
        yield Element(kind, data[begin : begin + size])
        start = end


def _require_variable(element: Element, order: str, names: Collection[str]) -> None:
    """Raise ValueError for a variable that has no header, or that is one of `names` and no array of numbers."""
    header = list(islice(_elements(_unfolded(element, order, MAX_HEAD), order), len(HEADER_KINDS)))
    if tuple(part.kind for part in header) != HEADER_KINDS or len(header[0].data) != FLAGS_SIZE:
        raise ValueError("a variable has no header")
    name = header[2].data.decode("latin1")
    if name not in names:
        return
    values = list(_elements(_unfolded(element, order, MAX_VARIABLE), order))[len(HEADER_KINDS) :]
    variable_class = struct.unpack(f"{order}I", header[0].data[:4])[0] & 0xFF
    if variable_class not in NUMBER_CLASSES or not values or any(part.kind not in NUMBERS for part in values):
        raise ValueError(f'"{name}" is no array of numbers')


def _unfolded(element: Element, order: str, limit: int) -> bytes:
    """Return the data of a variable, of a compressed one at most the first `limit` bytes."""
    if element.kind == COMPRESSED:
        data = zlib.decompressobj().decompress(element.data, limit)
        element = Element(struct.unpack_from(f"{order}I", data)[0], data[8:])
    if element.kind != MATRIX:
        raise ValueError("it holds more than variables")
    return element.data
