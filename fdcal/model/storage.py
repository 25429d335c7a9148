"""Files: safe reading of untrusted files, writing without leaving an incomplete file or folder, and the disk cache.

The cache is a folder of .npy and .npz files. The name of each is a hash of all values that determine its content, and
a checksum follows the content. FDCAL_CACHE sets the folder. It may be deleted at any time; a damaged file is made
again. `fdcal.acoustics.measure` stores recordings and measurements in it.
"""

import contextlib
import hashlib
import io
import json
import logging
import os
import secrets
import stat
import tempfile
import time
import tomllib
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np

from .validation import LIMITS, InputError, StorageError, naming, shown

SCHEME = 1  # increase it whenever the results of simulation or spectrum change, so that older cache files are ignored
CACHE_BYTES = 2_000_000_000  # size of the cache above which the least recently used files are deleted
CHECKSUM = 32  # bytes of BLAKE2 at the end of a cache file
TEMPORARY = ".fdcal-"  # prefix of the name of an unfinished file
ABANDONED = 86_400.0  # seconds, age at which an unfinished file is deleted

log = logging.getLogger(__name__)


def write_atomically(path: str | Path, write: Callable[[Path], object], force: bool = False) -> None:
    """Write a file under a temporary name in the same folder and move it to `path` once it is complete.

    `write` is a function that writes a file of a given path; `force` says whether an existing file is overwritten.
    """
    path = Path(os.path.realpath(path))  # the target of a link is replaced, not the link
    if not force and path.exists():
        raise InputError(f"{path} exists", "use <force> to overwrite it", key="path")
    temporary = path.parent / f"{TEMPORARY}{secrets.token_hex(8)}{path.suffix}"
    try:
        temporary.touch(exist_ok=False)
        write(temporary)
        try:
            if not force:
                os.link(temporary, path)  # does not replace a file that has appeared in the meantime
                return
        except FileExistsError:
            raise InputError(f"{path} exists", "use <force> to overwrite it", key="path") from None
        except OSError:  # a file system without hard links
            pass
        os.replace(temporary, path)
    except StorageError:
        raise
    except OSError as error:
        raise StorageError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def damaged(problem: str, remedy: str = "") -> Iterator[None]:
    """Turn a library's error for a damaged file into an InputError that states `problem`, or into a StorageError."""
    try:
        yield
    except (InputError, StorageError):
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.strerror:
            raise StorageError(f"cannot read {error.filename or 'the file'}: {error.strerror}") from error
        raise InputError(f"{problem}: {shown(str(error), 200)}", remedy) from error


def cache_key(*parts: Any) -> str:
    """Return the hash of `parts`, the values of JSON types that determine a cached value."""
    return hashlib.sha256(json.dumps([SCHEME, *parts], sort_keys=True).encode()).hexdigest()


def cache_folder() -> Path:
    """Return the folder of the cache: FDCAL_CACHE, or the system's usual one."""
    if folder := os.environ.get("FDCAL_CACHE"):
        return Path(folder)
    import platformdirs

    return Path(platformdirs.user_cache_dir("fdcal"))


def load_or_make(name: str, make: Callable[..., Any], read: Callable[..., Any], write: Callable[..., Any]):
    """Return the value of the cache file `name`, or that of `make()`, which is then stored.

    `read(file)` and `write(file, value)` use an open file. If the cache cannot be read or written, a warning is logged,
    and the run continues.
    """
    value = load_cached(name, read)
    if value is not None:
        return value
    path, value = cache_folder() / name, make()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        buffer = io.BytesIO()
        write(buffer, value)
        buffer.write(hashlib.blake2b(buffer.getvalue(), digest_size=CHECKSUM).digest())
        write_atomically(path, lambda temporary: temporary.write_bytes(buffer.getbuffer()), force=True)
        files = [f for f in path.parent.glob("*.np[yz]") if len(f.stem) == 64]
        files.sort(key=lambda f: -f.stat().st_mtime_ns)
        totals = np.cumsum([f.stat().st_size for f in files])
        old = [f for f in path.parent.glob(f"{TEMPORARY}*") if f.stat().st_mtime < time.time() - ABANDONED]
        for file in [f for f, total in zip(files[1:], totals[1:], strict=True) if total > CACHE_BYTES] + old:
            file.unlink(missing_ok=True)
    except OSError as error:
        log.warning("nothing is stored in the cache: %s", error)
    return value


def load_cached(name: str, read: Callable[..., Any]):
    """Return the value of a cache file; None if it is missing or damaged."""
    path = cache_folder() / name
    try:
        content = path.read_bytes()
        if hashlib.blake2b(content[:-CHECKSUM], digest_size=CHECKSUM).digest() == content[-CHECKSUM:]:
            value = read(io.BytesIO(content))
            os.utime(path)
            return value
        log.warning("the cache file %s is damaged and is made again", path)
    except (FileNotFoundError, NotADirectoryError):
        pass
    except Exception as error:
        log.warning("the cache file %s cannot be read (%s) and is made again", path, error)
    return None


@contextlib.contextmanager
def folder_in_progress(path: str | Path, force: bool = False) -> Iterator[Path]:
    """Yield a temporary folder, whose files are moved to `path` at the end, or deleted if anything fails.

    The folder is made at once, so that a missing permission is known before the work begins. `force` says whether
    `path` may contain files; those with the same names are replaced, and the others stay.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise InputError(f"{path} is a file", "name a folder", key="output")
    if not path.parent.is_dir():
        raise StorageError(f"{path} lies in a folder that does not exist; make it first: mkdir -p {path.parent}")
    if path.is_dir() and not force and any(path.iterdir()):
        raise InputError(f"{path} is not empty", "add <force> to replace files in it, or name another", key="output")
    try:
        with tempfile.TemporaryDirectory(prefix=TEMPORARY, dir=path if path.is_dir() else path.parent) as temporary:
            yield Path(temporary)
            path.mkdir(exist_ok=True)
            for file in sorted(Path(temporary).iterdir()):
                os.replace(file, path / file.name)
    except OSError as error:
        raise StorageError(f"cannot write {path}: {error.strerror or error}") from error


MAX_DOTS = 500  # largest number of dots in a key; the time of the parser grows with the square of their number


def read_bytes(path: str | Path, max_bytes: int = LIMITS.text, what: str = "") -> bytes:
    """Return the content of a regular file of at most `max_bytes`; messages call the file `what`, such as "scene"."""
    if "\0" in str(path):
        raise InputError(f"{shown(str(path))} is not the name of a file: it holds a NUL character", "correct it")
    try:
        require_regular(path)
        with open(path, "rb") as file:
            content = file.read(max_bytes + 1)
    except OSError as error:
        raise StorageError(f"cannot read {what}{what and ' '}{path}: {error.strerror or error}") from error
    if len(content) > max_bytes:
        raise InputError(f"{path} has more than {max_bytes:,} bytes", "give a smaller file")
    return content


def parse_text(content: bytes | str, kind: Literal["TOML", "JSON"], where: object) -> Any:
    """Return the value of a TOML or JSON text, or raise InputError; `where` is the name of the file in messages."""
    try:
        encoding = "utf-8-sig" if kind == "TOML" else "utf-8"
        text = content.decode(encoding) if isinstance(content, bytes) else content
        if kind == "JSON":
            return json.loads(text)
        for number, line in enumerate(text.splitlines(), 1):
            if line.partition("=")[0].count(".") > MAX_DOTS:
                raise ValueError(f"a key of more than {MAX_DOTS} parts in line {number}")
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        deep = isinstance(error, RecursionError)
        reason = "it is nested too deeply" if deep else " ".join(str(error).split(";")[0].split())
        raise InputError(f"{where} is not valid {kind}: {reason}") from error


def load_archive(path: Any, wanted: Callable[[str], bool], called: object = "") -> dict[str, np.ndarray]:
    """Return the arrays of an .npz file, a path or an open file, for whose names `wanted` is true; unpickle nothing.

    `called` is the name of an open file in messages. Raises InputError for a damaged file, or for compressed arrays
    larger than `LIMITS.unfolded` bytes, and StorageError for a file that cannot be read.
    """
    where, table, key = called or path, dict[str, Any](), ""
    try:
        with naming(where), contextlib.ExitStack() as opened:
            file = path
            if isinstance(path, (str, Path)):  # opened here, since NumPy does not close a file that it finds damaged
                require_regular(path)
                file = opened.enter_context(open(path, "rb"))
            with zipfile.ZipFile(file) as archive:
                entries = [entry for entry in archive.infolist() if wanted(entry.filename.removesuffix(".npy"))]
            # A compressed member unpacks to at most the size stated in the directory; a stored one is part of the file.
            stored = sum(entry.file_size for entry in entries if entry.compress_type == zipfile.ZIP_STORED)
            packed = sum(entry.file_size for entry in entries if entry.compress_type != zipfile.ZIP_STORED)
            if stored > file.seek(0, os.SEEK_END):
                raise InputError(f"its arrays should have {stored:,} bytes, more than the file has", "copy it again")
            if packed > LIMITS.unfolded:
                problem = f"it has {packed:.3g} bytes when decompressed, and the limit is {LIMITS.unfolded:.3g}"
                raise InputError(problem, "write it with numpy.savez, which does not compress")
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                for key in filter(wanted, archive.files):
                    table[key] = archive[key]
                    if not isinstance(table[key], np.ndarray):
                        raise ValueError("it does not begin like an array of NumPy")
            return table
    except InputError:
        raise
    except MemoryError:
        raise InputError(f"{where} does not fit into memory", "give WAV, W64, FLAC or HDF5") from None
    except Exception as error:  # a damaged archive can raise any exception of zipfile, zlib or NumPy
        if isinstance(error, OSError) and error.strerror:
            raise StorageError(f"cannot read {where}: {error.strerror}") from error
        problem, remedy = f"{where} is not a readable .npz file ({type(error).__name__})", "write it with numpy.savez"
        if key:
            problem = f'{where}: "{key}" is damaged or not a plain array of numbers ({shown(str(error), 120)})'
            remedy = "write it again"
        raise InputError(problem, remedy, key=key) from error


def require_regular(path: str | Path) -> None:
    """Raise InputError for a device or a pipe, which may never end; OSError if the file is missing."""
    kind = os.stat(path).st_mode
    if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):
        raise InputError(f"{path} is not a regular file", "give a file")


def matlab_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """Return the arrays in a MATLAB file; a field of a structure is called "name.field"."""
    from scipy.io import loadmat

    def flat(name: str, value: Any) -> Iterator[tuple[str, np.ndarray]]:
        if isinstance(value, dict):
            for key, inner in value.items():
                yield from flat(f"{name}.{key}", inner)
        elif not name.startswith(".__"):
            array = np.asarray(value)
            if array.size and all(isinstance(one, str) for one in array.flat):  # a cell array of texts
                array = array.astype(str)
            if array.dtype.kind in "fiucUS":
                yield name[1:], array

    with damaged(f"{path} is not a readable file of MATLAB", "save it again"), open(path, "rb") as file:
        return dict(flat("", loadmat(file, simplify_cells=True)))
