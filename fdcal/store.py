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
import dataclasses
import hashlib
import io
import json
import logging
import math
import os
import secrets
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import platformdirs

from .arrays import positions_of
from .checks import InputError, StorageError
from .measurement import Measurement, measure, require_measurable
from .measurement_file import load_measurement, save_measurement
from .scene import Scene

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
        raise InputError(f"{path} exists; use --force to overwrite it")
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
        raise InputError(f"{path} exists; use --force to overwrite it") from None
    except OSError:  # a file system without hard links
        os.replace(temporary, path)


def cached_recordings(scene: Scene, progress=None) -> np.ndarray:
    """What the scene's microphones record, (N, T) float64: from the cache, or simulated and put there.

    Raises InputError as `fdcal.fdtd.simulate` does.
    """
    positions = positions_of(scene)
    key = _key("recordings", dataclasses.asdict(scene.room), dataclasses.asdict(scene.source), positions.tolist())

    def make() -> np.ndarray:
        from .fdtd import simulate

        return simulate(scene.room, scene.source, positions, progress)

    return _cached(f"{key}.npy", make, np.load, np.save)


def cached_measurement(scene: Scene, progress=None) -> Measurement:
    """What `measure` gives for the scene: from the cache, or made, with `cached_recordings` if any, and put there.

    Raises InputError as `measure` does.
    """
    require_measurable(scene)

    def write(file, measurement: Measurement) -> None:
        save_measurement(measurement, file)

    def make() -> Measurement:
        recordings = cached_recordings(scene, progress) if scene.room.dimension == 2 else None
        return measure(scene, recordings, progress)

    return _cached(_measurement_name(scene), make, load_measurement, write)


def kept_measurement(scene: Scene) -> Measurement | None:
    """What `cached_measurement` gives at once; None where it would have to be made."""
    return _kept(_measurement_name(scene), load_measurement)


def _measurement_name(scene: Scene) -> str:
    table = dataclasses.asdict(scene)
    for name in ("name", "title", "solver"):  # these change nothing that is measured
        del table[name]
    return f"{_key('measurement with its spectrum', table)}.npz"


def cached_arrays(kind: str, parts: list, make: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Arrays by name from the cache, or those of `make()`, which are put there.

    `parts` is all that decides them, of what JSON holds; `kind` keeps them apart from others.
    """

    def read(file) -> dict[str, np.ndarray]:
        with np.load(file) as archive:
            return dict(archive)

    return _cached(f"{_key(kind, *parts)}.npz", make, read, lambda file, table: np.savez(file, **table))


def _key(*parts) -> str:
    return hashlib.sha256(json.dumps([SCHEME, *parts], sort_keys=True).encode()).hexdigest()


def cache_folder() -> Path:
    """Folder of the cache: FDCAL_CACHE, or where the system keeps such files."""
    return Path(os.environ.get("FDCAL_CACHE") or platformdirs.user_cache_dir("fdcal"))


def _cached(name: str, make, read, write):
    """Value of a cache file, or of `make()`, which is then written. The cache never stops a run: it only warns."""
    value = _kept(name, read)
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


def _kept(name: str, read):
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
    kept = np.cumsum([f.stat().st_size for f in files])
    old = [f for f in folder.glob(f"{TEMPORARY}*") if f.stat().st_mtime < time.time() - 86_400]
    for file in [f for f, total in zip(files[1:], kept[1:], strict=True) if total > CACHE_BYTES] + old:
        file.unlink(missing_ok=True)


# Of each key of a result: what it must be, and the number of dimensions of an array (0: a single value).
RESULT = {
    "positions": (float, 2),
    "solver": (str, 0),
    "seed": (int, 0),
    "frequencies": (float, 1),
    "cost": (float, 0),
    "sweeps": (int, 0),
    "elapsed_s": (float, 0),
    "converged": (bool, 0),
    "mean_error_m": (float, 0),
    "max_error_m": (float, 0),
}
NEWER = {  # a file of an older fdcal lacks these
    "uncertainty_m": (float, 1),
    "residual_to_noise": (float, 0),
    "verdict": (str, 0),
    "verdict_text": (str, 0),
    "sound_speed": (float, 0),
    "left_out_db": (float, 0),
    "left_out_microphones_db": (float, 1),
    "left_out_frequencies_db": (float, 1),
}
NULLABLE = ("mean_error_m", "max_error_m")  # null without truth


def save_result(result: dict, path: str | Path, force: bool = False) -> None:
    """Write the result of a calibration as JSON: the keys of RESULT and any others; arrays become lists.

    Raises InputError (a key is missing or of another kind; the file exists) and StorageError.
    """
    table = {
        key: value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value for key, value in result.items()
    }
    _checked(table, "the result")
    text = json.dumps(table, indent=1, allow_nan=False) + "\n"
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"), force)


def load_result(path: str | Path) -> dict:
    """Result of a calibration from its JSON file; `positions` (N, D) and `frequencies` (M,) are float64 arrays.

    Raises InputError naming the key that is missing or malformed, and StorageError.
    """
    try:
        table = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise StorageError(f"cannot read {path}: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{path} is not valid JSON: {error}".replace("\n", " ")) from error
    if not isinstance(table, dict):
        raise InputError(f"{path} must hold one JSON object with the keys {', '.join(RESULT)}")
    return _checked(table, str(path))


def _checked(table: dict, where: str) -> dict:
    """`table` with its arrays as arrays, or InputError naming the key."""
    checked = dict(table)
    for key, (kind, dimensions) in (RESULT | NEWER).items():
        if key in NEWER and key not in table:
            continue
        if key not in table:
            raise InputError(f'{where} has no "{key}"; write it with `fdcal calibrate -o`')
        value = table[key]
        if value is None and key in NULLABLE:
            continue
        words = f"{dimensions}-dimensional list of numbers" if dimensions else f"value of type {kind.__name__}"
        if not _is(value, kind, dimensions):
            raise InputError(f'{where}: "{key}" must be a {words}, finite throughout')
        checked[key] = np.array(value, dtype=float) if dimensions else value
    if checked["positions"].shape[1] not in (2, 3):
        raise InputError(f'{where}: "positions" of shape {checked["positions"].shape} must be (N, 2) or (N, 3), metres')
    rows = len(checked["positions"])
    if len(checked.get("uncertainty_m", range(rows))) != rows:
        raise InputError(f'{where}: "uncertainty_m" must hold {rows} numbers, one for each row of "positions"')
    for key in ("names", "excluded"):
        if not all(isinstance(name, str) for name in _list_of(checked.get(key, []))):
            raise InputError(f'{where}: "{key}" must be a list of texts')
    return checked


def _list_of(value) -> list:
    return value if isinstance(value, list) else [None]


def _is(value, kind: type, dimensions: int) -> bool:
    """Whether a value out of JSON is a `kind`, or a list of that many dimensions of finite numbers."""
    if not dimensions:
        accepted = (int, float) if kind is float else kind
        right = isinstance(value, accepted) and (kind is bool or not isinstance(value, bool))
        with contextlib.suppress(OverflowError):  # a whole number beyond all floats
            return right and (kind is not float or math.isfinite(value))
        return False
    try:
        array = np.array(value)
    except ValueError:
        return False
    return array.ndim == dimensions and array.size > 0 and array.dtype.kind in "if" and bool(np.isfinite(array).all())
