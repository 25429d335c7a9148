"""Arrays as one compressed text for a page that unpacks them in the browser (`replay_page/unpack.js`).

Integers of four bytes are stored as differences along the first axis, and of every array the lowest bytes of all values
come first, then the second ones: what hardly changes compresses to nearly nothing. The compression is that of zlib,
which browsers know by the name "deflate".
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping

import numpy as np


def packed(arrays: Mapping[str, np.ndarray]) -> dict:
    """Return arrays as values that JSON has.

    `arrays`: of int16, int32, float32 or float64. A wrap round of differences is undone by the next one. Returns
    "arrays", name to [type, shape], in order; "bytes", the base64 text of all of them.

    Examples
    --------
    >>> arrays = {"step": np.arange(5, dtype="<i4"), "cost": np.array([0.5, -2.0])}
    >>> unpacked(packed(arrays))["cost"]
    array([ 0.5, -2. ])
    """
    listed = {name: np.asarray(values) for name, values in arrays.items()}
    content = b"".join(_planes(values) for values in listed.values())
    return {
        "arrays": {name: [_code(values), list(values.shape)] for name, values in listed.items()},
        "bytes": base64.b64encode(zlib.compress(content, 9)).decode("ascii"),
    }


def unpacked(data: Mapping) -> dict[str, np.ndarray]:
    """Return the arrays of `packed`."""
    content, at, arrays = zlib.decompress(base64.b64decode(data["bytes"])), 0, {}
    for name, (code, shape) in data["arrays"].items():
        kind = np.dtype("<" + code)
        size = int(np.prod(shape))
        planes = np.frombuffer(content, np.uint8, size * kind.itemsize, at).reshape(kind.itemsize, size)
        values = np.ascontiguousarray(planes.T).view(kind).reshape(shape)
        arrays[name] = np.cumsum(values, axis=0, dtype=kind) if code == "i4" else values
        at += size * kind.itemsize
    return arrays


def _code(values: np.ndarray) -> str:
    return f"{values.dtype.kind}{values.dtype.itemsize}"


def _planes(values: np.ndarray) -> bytes:
    """Return the bytes of an array, the lowest of all values first."""
    if _code(values) == "i4" and len(values):
        values = np.concatenate([values[:1], np.diff(values, axis=0)]).astype(values.dtype)
    flat = np.ascontiguousarray(values, values.dtype.newbyteorder("<")).reshape(-1, 1)
    return flat.view(np.uint8).reshape(len(flat), -1).T.tobytes()
