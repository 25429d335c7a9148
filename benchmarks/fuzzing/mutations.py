"""Ways to break a file: its bytes, numbers in a text, members and arrays of an archive."""

import io
import re
import zipfile
from collections.abc import Callable

import h5py
import numpy as np

NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][+-]?\d+)?")
ODD = (
    b"0", b"-1", b"1e400", b"-1e308", b"nan", b"inf", b"1e-320", b"9" * 400, b"9" * 5000, b"0x" + b"f" * 4000, b"1_0",
    b"true", b'"text"', b"[]", b"{}", b"[[[]]]", b"null", b"", b"\x00", b"1979-05-27", b"2147483648", b"1e12",
)  # fmt: skip
DEPTH = 3000  # of lists inside lists: far beyond what Python recurses into
ARRAYS = (
    lambda a, rng: a[:-1],
    lambda a, rng: a[..., :-1],
    lambda a, rng: a[None],
    lambda a, rng: a.T,
    lambda a, rng: np.full_like(a, np.nan) if a.dtype.kind in "fc" else a - 1,
    lambda a, rng: a * 1e300 if a.dtype.kind in "fc" else a * 2**40,
    lambda a, rng: a * 1e-300 if a.dtype.kind in "fc" else a * 0,
    lambda a, rng: -a if a.dtype.kind in "fci" else a,
    lambda a, rng: a.astype(str),
    lambda a, rng: a.astype(bool),
    lambda a, rng: np.array(1e12),
    lambda a, rng: np.array([], a.dtype),
    lambda a, rng: np.array([[]]),
    lambda a, rng: np.repeat(a[None], 3, axis=0),
    lambda a, rng: np.where(rng.random(a.shape) < 0.1, np.inf, a) if a.dtype.kind in "fc" else a[::-1],
)


def broken(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the content of a file, broken in one or two ways."""
    for _ in range(rng.integers(1, 3)):
        packed = content[:2] == b"PK" and rng.random() < 0.7
        content = _archive(content, rng) if packed else _bytes(content, rng)
    return content


def _bytes(content: bytes, rng: np.random.Generator) -> bytes:
    a, b = sorted(rng.integers(0, len(content) + 1, 2).tolist())
    numbers = list(NUMBER.finditer(content[:200_000])) if content[:1].isascii() else []
    kind = int(rng.integers(8))
    if kind == 0:
        flipped = bytearray(content)
        for place in rng.integers(0, max(1, len(content)), int(rng.integers(1, 9))).tolist() if content else ():
            flipped[place] ^= 1 << int(rng.integers(8))
        return bytes(flipped)
    if kind == 1:
        return content[:a]
    if kind == 2:
        return content[:a] + content[b:]
    if kind == 3:
        return content[:b] + content[a:]
    if kind == 4:
        return content[:a] + rng.bytes(int(rng.integers(1, 40))) + content[a:]
    if kind == 5:
        brackets = (b"[" * DEPTH, b"{" * DEPTH, b'{"a":' * DEPTH, b"a." * DEPTH)[int(rng.integers(4))]
        return content[:a] + brackets + content[a:]
    if numbers:
        match = numbers[int(rng.integers(len(numbers)))]
        return content[: match.start()] + ODD[int(rng.integers(len(ODD)))] + content[match.end() :]
    return content[:a] + b"\0" * int(rng.integers(1, 9)) + content[b:]


def _archive(content: bytes, rng: np.random.Generator) -> bytes:
    """Return an archive with one member broken, left out, or announcing more than there is."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except Exception:  # broken already
        return _bytes(content, rng)
    if not members:
        return content
    name = sorted(members)[int(rng.integers(len(members)))]
    kind = int(rng.integers(5))
    if kind == 0:
        del members[name]
    elif kind == 1:
        members[name] = _bytes(members[name], rng)
    elif kind == 2 and name.endswith(".npy"):
        header = io.BytesIO()
        shape = tuple(int(n) for n in 10 ** rng.integers(0, 16, int(rng.integers(1, 3))))
        np.lib.format.write_array_header_1_0(header, {"descr": "<c16", "fortran_order": False, "shape": shape})
        members[name] = header.getvalue() + members[name][-64:]
    elif name.endswith(".npy"):
        members[name] = _array(members[name], rng)
    else:
        members[name] = broken(members[name], rng)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, value in members.items():
            archive.writestr(key, value)
    return packed.getvalue()


def _array(content: bytes, rng: np.random.Generator) -> bytes:
    file = io.BytesIO()
    change = ARRAYS[int(rng.integers(len(ARRAYS)))]
    try:
        with np.errstate(all="ignore"):
            np.save(file, change(np.load(io.BytesIO(content), allow_pickle=False), rng))
    except Exception:  # the change does not suit this array, or the content is no array
        return _bytes(content, rng)
    return file.getvalue()


Change = Callable[[h5py.File, str, np.random.Generator], None]  # of the dataset of this name

DTYPES = (
    "i1", ">u8", "f2", ">f8", "c16", "?", "S3", h5py.string_dtype(), h5py.vlen_dtype(float), h5py.ref_dtype,
    h5py.regionref_dtype, h5py.enum_dtype({"a": 0, "b": 1}), np.dtype([("r", "f8"), ("i", "i4", (2, 2))]), "V5",
    np.dtype([("a", [("b", h5py.string_dtype())])]), np.dtype("(3,)f8"), np.dtype("S60000"),
)  # fmt: skip
SHAPES = ((), (0,), (1,), (3, 0), (2, 3, 4, 5, 6), (10**6, 10**6), (2**62, 2), (1,) * 32)
VALUES = (
    1, -1.5, "text", b"\xff\xfe", [], [1.0, 2.0], "x" * 60_000, np.nan, h5py.Empty("f8"), np.array([b"a", b"bc"]),
    np.array((1, 2.0), [("a", "i4"), ("b", "f8")]), True, 2**63 - 1, np.zeros((2, 2, 2)),
)  # fmt: skip


def _replace(file: h5py.File, name: str, **kind) -> None:
    """Put an empty dataset of another kind in the place of a dataset, with the same attributes."""
    old = dict(file[name].attrs)
    del file[name]
    new = file.create_dataset(name, **kind)
    for key in old.keys() - {"CLASS", "NAME", "REFERENCE_LIST", "DIMENSION_LIST"}:
        new.attrs[key] = old[key]


def _data_type(file: h5py.File, name: str, rng: np.random.Generator) -> None:
    _replace(file, name, shape=file[name].shape, dtype=DTYPES[int(rng.integers(len(DTYPES)))])


def _dataspace(file: h5py.File, name: str, rng: np.random.Generator) -> None:
    shape = SHAPES[int(rng.integers(len(SHAPES)))]
    huge = np.prod(shape, dtype=float) > 1e6
    _replace(file, name, shape=shape, dtype="f8", **({"chunks": (1000, 2)} if huge else {}))


def _null(file: h5py.File, name: str, rng: np.random.Generator) -> None:
    _replace(file, name, data=h5py.Empty("f8"))


def _layout(file: h5py.File, name: str, rng: np.random.Generator) -> None:
    shape, kind = file[name].shape or (1,), int(rng.integers(4))
    if kind == 0:
        _replace(file, name, shape=shape, dtype="f8", external=[("/etc/passwd", 0, 10**6)])
    elif kind == 1:
        layout = h5py.VirtualLayout(shape, "f8")
        layout[...] = h5py.VirtualSource("/etc/passwd", "x", shape)
        del file[name]
        file.create_virtual_dataset(name, layout)
    elif kind == 2:
        chunks = tuple(min(length, 5) or 1 for length in shape)
        _replace(file, name, shape=shape, dtype="f8", chunks=chunks, compression="gzip", fletcher32=True, shuffle=True)
    else:
        _replace(file, name, shape=shape, maxshape=(None,) * len(shape), dtype="f8", fillvalue=np.nan)


def _attribute(file: h5py.File, name: str, rng: np.random.Generator) -> None:
    place = file[name] if rng.random() < 0.7 else file
    keys = sorted(place.attrs) or ["Units"]
    key = keys[int(rng.integers(len(keys)))]
    if rng.random() < 0.2:
        place.attrs.pop(key, None)
    else:
        place.attrs[key] = VALUES[int(rng.integers(len(VALUES)))]


def _link(file: h5py.File, name: str, rng: np.random.Generator) -> None:
    kind = int(rng.integers(6))
    del file[name]
    if kind == 0:
        file[name] = h5py.ExternalLink("/etc/passwd", "/x")
    elif kind == 1:
        file[name] = h5py.SoftLink(f"/{name}")  # to itself
    elif kind == 2:
        file[name] = h5py.SoftLink("/nowhere")
    elif kind == 3:
        file[name] = file["/"]
    elif kind == 4:
        file.create_group(name)["inside"] = h5py.ExternalLink("other.h5", "/x")
    else:
        file[name] = np.dtype("f8")


CHANGES: tuple[Change, ...] = (_data_type, _dataspace, _null, _layout, _attribute, _link)


def restructured(content: bytes, change: Change, name: str, rng: np.random.Generator) -> bytes:
    """Return the content of an HDF5 file after a change of its dataset `name`."""
    held = io.BytesIO(content)
    with h5py.File(held, "a") as file:
        change(file, name, rng)
    return held.getvalue()


def broken_structure(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the content of an HDF5 file with another structure, broken bytes of its headers, or both."""
    if rng.random() < 0.7:
        with h5py.File(io.BytesIO(content), "r") as file:
            names = sorted(name for name in file if isinstance(file[name], h5py.Dataset))
        for _ in range(int(rng.integers(1, 3))):
            change, name = CHANGES[int(rng.integers(len(CHANGES)))], names[int(rng.integers(len(names)))]
            try:
                content = restructured(content, change, name, rng)
            except Exception:  # the change does not suit this dataset after the previous change
                continue
        if rng.random() < 0.6:
            return content
    if rng.random() < 0.5:
        return broken(content, rng)
    changed = bytearray(content)  # headers: near a signature or a data type, where bytes say how to read the others
    for place in rng.integers(0, len(content), int(rng.integers(1, 40))).tolist():
        changed[place] = int(rng.choice([0, 1, 2, 3, 6, 8, 9, 127, 128, 255]))
    return bytes(changed)
