"""Files: writing without leaving a half, the disk cache, and the result of a calibration.

    write_atomically        every output of fdcal: to a temporary name, then moved into place
    cached_recordings       of a scene's simulation    cached_measurement   of a whole scene
    cached_arrays           of anything else             kept_measurement   where it is in the cache
    save_result, load_result    the JSON file of `fdcal calibrate`

The cache is a folder of .npy and .npz files, named by a hash of all that produced them and ending in a checksum of
their own. FDCAL_CACHE names the folder. It may be deleted at any time; a damaged file in it is made anew.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import logging
import os
import secrets
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import platformdirs

from .validation import InputError, StorageError

SCHEME = 1  # raise it with every change to what simulation or spectrum compute: older cache files are then ignored
CACHE_BYTES = 2_000_000_000  # the files used longest ago are dropped beyond this
CHECKSUM = 32  # bytes of BLAKE2 at the end of a cache file
TEMPORARY = ".fdcal-"  # what the name of an unfinished file begins with

log = logging.getLogger(__name__)


def write_atomically(path: str | Path, write: Callable[[Path], object], force: bool = False) -> None:
    """Have `write(temporary)` write a file, and move it to `path` once it is whole.

    The temporary file lies in the same folder and is gone whatever ends the writing, Ctrl-C included.

    Raises
    ------
    InputError
        `path` exists and `force` is not set.
    StorageError
        The folder is missing, or the system refuses.
    """
    path = Path(path)
    if not force and path.exists():
        raise InputError(f"{path} exists", "use <force> to overwrite it", key="path", value=path)
    temporary = path.parent / f"{TEMPORARY}{secrets.token_hex(8)}{path.suffix}"
    try:
        temporary.touch(exist_ok=False)
        write(temporary)
        _move(temporary, path, force)
    except StorageError:
        raise
    except OSError as error:
        raise StorageError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _move(temporary: Path, path: Path, force: bool) -> None:
    """Give the file its name; without `force` it does not replace one that appeared meanwhile."""
    if force:
        os.replace(temporary, path)
        return
    try:
        os.link(temporary, path)
    except FileExistsError:
        raise InputError(f"{path} exists", "use <force> to overwrite it", key="path", value=path) from None
    except OSError:  # a file system without hard links
        os.replace(temporary, path)


def cached_arrays(kind: str, parts: list, make: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Arrays by name from the cache, or those of `make()`, which are put there.

    `parts` is all that decides them, of what JSON holds; `kind` keeps them apart from others.
    """

    def read(file) -> dict[str, np.ndarray]:
        with np.load(file) as archive:
            return dict(archive)

    return load_or_make(f"{cache_key(kind, *parts)}.npz", make, read, lambda file, table: np.savez(file, **table))


def cache_key(*parts) -> str:
    return hashlib.sha256(json.dumps([SCHEME, *parts], sort_keys=True).encode()).hexdigest()


def cache_folder() -> Path:
    """Folder of the cache: FDCAL_CACHE, or where the system keeps such files."""
    return Path(os.environ.get("FDCAL_CACHE") or platformdirs.user_cache_dir("fdcal"))


def load_or_make(name: str, make, read, write):
    """Value of a cache file, or of `make()`, which is then written. The cache never stops a run: it only warns."""
    value = load_cached(name, read)
    if value is not None:
        return value
    path, value = cache_folder() / name, make()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, lambda temporary: _write_checked(temporary, value, write), force=True)
        _bound(path.parent)
    except OSError as error:
        log.warning("nothing is kept in the cache: %s", error)
    return value


def load_cached(name: str, read):
    """Value of a cache file; None where there is none that can be read."""
    path = cache_folder() / name
    try:
        content = path.read_bytes()
        if _checksum(memoryview(content)[:-CHECKSUM]) == content[-CHECKSUM:]:
            value = read(io.BytesIO(content))
            os.utime(path)
            return value
        log.warning("the cache file %s is damaged and is made anew", path)
    except (FileNotFoundError, NotADirectoryError):
        pass
    except Exception as error:
        log.warning("the cache file %s cannot be read (%s) and is made anew", path, error)
    return None


def _write_checked(path: Path, value, write) -> None:
    """Write a cache file: the value, then the checksum of what was written."""
    buffer = io.BytesIO()
    write(buffer, value)
    with open(path, "wb") as file:
        file.write(buffer.getbuffer())
        file.write(_checksum(buffer.getbuffer()))


def _checksum(content) -> bytes:
    return hashlib.blake2b(content, digest_size=CHECKSUM).digest()


def _bound(folder: Path) -> None:
    """Drop the cache files used longest ago until the rest fits in CACHE_BYTES, and what a killed run once left."""
    files = sorted((f for f in folder.glob("*.np[yz]") if len(f.stem) == 64), key=lambda f: -f.stat().st_mtime_ns)
    totals = np.cumsum([f.stat().st_size for f in files])
    old = [f for f in folder.glob(f"{TEMPORARY}*") if f.stat().st_mtime < time.time() - 86_400]
    for file in [f for f, total in zip(files[1:], totals[1:], strict=True) if total > CACHE_BYTES] + old:
        file.unlink(missing_ok=True)
