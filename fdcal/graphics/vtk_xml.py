"""VTK's XML files, which ParaView reads: images (.vti) and points (.vtp), as texts. The library itself is not needed.

Numbers are little-endian, in base64, behind their length as 64 bits.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from xml.sax.saxutils import quoteattr

import numpy as np

TYPES = {"f": ("Float64", "<f8"), "i": ("Int64", "<i8"), "u": ("UInt8", "u1"), "U": ("String", None)}


def image(
    shape: Sequence[int], origin: Sequence[float], spacing: Sequence[float], fields: Mapping[str, np.ndarray]
) -> str:
    """An image of nx, ny, nz points.

    Parameters
    ----------
    shape : nx, ny, nz
    origin, spacing : (3,), metres, of the first point and between points
    fields : a value of each point, x fastest, then y, by name
    """
    extent = " ".join(f"0 {n - 1}" for n in shape)
    place, steps = (" ".join(repr(float(x)) for x in values) for values in (origin, spacing))
    body = "".join(_array(name, np.ravel(values)) for name, values in fields.items())
    whole = f'<ImageData WholeExtent="{extent}" Origin="{place}" Spacing="{steps}"><Piece Extent="{extent}">'
    return _file("ImageData", f"{whole}\n<PointData>\n{body}</PointData>\n</Piece></ImageData>")


def points(places: np.ndarray, lines: np.ndarray, fields: Mapping[str, np.ndarray]) -> str:
    """Points with lines between some of them.

    Parameters
    ----------
    places : (P, 3), metres
    lines : (S, 2) numbers of points
    fields : (P,) or (P, 3) of numbers, or (P,) of texts, by name
    """
    count, lines = len(places), np.reshape(lines, (-1, 2)).astype(int)
    body = "".join(_array(name, values) for name, values in fields.items())
    cells = _cells("Verts", np.arange(count)[:, None]) + _cells("Lines", lines)
    piece = f'<PolyData><Piece NumberOfPoints="{count}" NumberOfVerts="{count}" NumberOfLines="{len(lines)}">'
    where = f"<Points>\n{_array('Points', np.asarray(places, float))}</Points>\n"
    return _file("PolyData", f"{piece}\n<PointData>\n{body}</PointData>\n{where}{cells}</Piece></PolyData>")


def _file(kind: str, body: str) -> str:
    head = f'<VTKFile type="{kind}" version="1.0" byte_order="LittleEndian" header_type="UInt64">'
    return f'<?xml version="1.0"?>\n{head}\n{body}\n</VTKFile>\n'


def _cells(name: str, members: np.ndarray) -> str:
    """Cells of as many points each as `members` (C, m) has columns."""
    ends = members.shape[1] * np.arange(1, len(members) + 1)
    return f"<{name}>\n{_array('connectivity', members.ravel())}{_array('offsets', ends)}</{name}>\n"


def _array(name: str, values: np.ndarray) -> str:
    values = np.asarray(values)
    word, dtype = TYPES["u" if values.dtype.kind == "b" else values.dtype.kind]
    if dtype is None:
        data = b"".join(text.encode() + b"\0" for text in values.tolist())
    else:
        data = np.ascontiguousarray(values, dtype).tobytes()
    text = base64.b64encode(len(data).to_bytes(8, "little") + data).decode("ascii")
    size = f'NumberOfTuples="{len(values)}"' if dtype is None else ""
    size += f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
    return f'<DataArray type="{word}" Name={quoteattr(name)} {size} format="binary">{text}</DataArray>\n'
