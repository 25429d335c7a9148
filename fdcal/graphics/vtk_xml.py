"""Texts of VTK's XML files, which ParaView reads: images (.vti) and points (.vtp). VTK itself is not needed.

Numbers are little-endian, in base64, after their length in bytes as a 64-bit number. Format: "VTK File Formats",
https://docs.vtk.org/en/latest/design_documents/VTKFileFormats.html.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from xml.sax.saxutils import quoteattr

import numpy as np

# By the kind of a dtype: VTK's name of the type, and the dtype in the file; None for texts.
TYPES = {"f": ("Float64", "<f8"), "i": ("Int64", "<i8"), "u": ("UInt8", "u1"), "U": ("String", None)}
SINGLE = ("Float32", "<f4")


def image(
    shape: Sequence[int], origin: Sequence[float], spacing: Sequence[float], fields: Mapping[str, np.ndarray]
) -> str:
    """Return the text of an image file (.vti).

    `shape`: points along x, y and z; `origin`, `spacing` (3,), metres, of the first point and between points; `fields`:
    by name, a value for each point, x fastest, then y.
    """
    extent = " ".join(f"0 {n - 1}" for n in shape)
    first, steps = (" ".join(repr(float(x)) for x in values) for values in (origin, spacing))
    body = "".join(_array(name, np.ravel(values)) for name, values in fields.items())
    whole = f'<ImageData WholeExtent="{extent}" Origin="{first}" Spacing="{steps}"><Piece Extent="{extent}">'
    return _file("ImageData", f"{whole}\n<PointData>\n{body}</PointData>\n</Piece></ImageData>")


def points(positions: np.ndarray, lines: np.ndarray, fields: Mapping[str, np.ndarray]) -> str:
    """Return the text of a file of points with lines between some of them (.vtp).

    `positions` (P, 3), metres; `lines` (S, 2), indices of points; `fields`: by name, (P,) or (P, 3) numbers or (P,)
    texts.
    """
    count, lines = len(positions), np.reshape(lines, (-1, 2)).astype(int)
    body = "".join(_array(name, values) for name, values in fields.items())
    cells = _cells("Verts", np.arange(count)[:, None]) + _cells("Lines", lines)
    piece = f'<PolyData><Piece NumberOfPoints="{count}" NumberOfVerts="{count}" NumberOfLines="{len(lines)}">'
    where = f"<Points>\n{_array('Points', np.asarray(positions, float))}</Points>\n"
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
    single = values.dtype == np.float32
    vtk_type, dtype = SINGLE if single else TYPES["u" if values.dtype.kind == "b" else values.dtype.kind]
    if dtype is None:
        data = b"".join(text.encode() + b"\0" for text in values.tolist())
    else:
        data = np.ascontiguousarray(values, dtype).tobytes()
    text = base64.b64encode(len(data).to_bytes(8, "little") + data).decode("ascii")
    size = f'NumberOfTuples="{len(values)}"' if dtype is None else ""
    size += f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
    return f'<DataArray type="{vtk_type}" Name={quoteattr(name)} {size} format="binary">{text}</DataArray>\n'
