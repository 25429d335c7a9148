"""How a file is broken: bytes, numbers in a text, members and arrays of an archive."""

import io
import re
import zipfile

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
    except Exception:  # it does not suit this array, or is none
        return _bytes(content, rng)
    return file.getvalue()
