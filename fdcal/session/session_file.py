"""A session as a file, with which `fdcal view SESSION` continues.

It is a .zip of two files, session.json and session.npz, which may also lie in a folder of their own. The first holds
the scene with the settings of its solver, the seed of the start, the index of the state that was shown, the values of
the page's controls and the states (`fdcal.session.state_codec`). The second holds their arrays and the measurement; it
is a measurement file that `fdcal calibrate` can read. Reading either runs nothing.
"""

import dataclasses
import io
import json
import zipfile
from pathlib import Path

import numpy as np

from ..model.declared import build
from ..model.measurement import load_measurement, save_measurement
from ..model.scene import Scene
from ..model.scene_file import MeasuredScene
from ..model.storage import parse_json, read_archive, require_regular
from ..model.validation import InputError, StorageError, shown
from .history import MAX_STATES
from .request import OpenRequest, plain, table_of
from .state_codec import read_states, write_states

VERSION = 2
TABLE, ARRAYS = "session.json", "session.npz"


UNPACKED_BYTES = 400_000_000  # size that an archive may unpack to
WRITTEN_BYTES = 64_000_000  # size of the states that are written; of longer runs fewer are kept, evenly spaced
KEYS = ("fdcal_session", "scene", "start_seed", "index", "choices", "states")


def write(opening: OpenRequest) -> bytes:
    """Return the bytes of the .zip of a request that has a measurement and states; InputError for NaN or infinity."""
    if opening.measurement is None:
        raise ValueError("a session that is written has a measurement")
    scene = opening.scene
    if isinstance(scene, MeasuredScene):
        scene = dataclasses.replace(scene, file="")  # the measurement itself is in the session
    kept = kept_states(opening.states, opening.index)
    table, arrays = write_states([opening.states[i] for i in kept])
    content = {
        "fdcal_session": VERSION,
        "scene": _finite(table_of(scene)),
        "measured": isinstance(scene, MeasuredScene),  # the scene is a placeholder
        "start_seed": opening.seed,
        "index": kept.index(len(opening.states) - 1 if opening.index is None else opening.index),
        "choices": plain(opening.choices),
        "states": table,
    }
    file = io.BytesIO()
    save_measurement(opening.measurement, file, arrays)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(TABLE, json.dumps(content, allow_nan=False))
        archive.writestr(ARRAYS, file.getvalue())
    return packed.getvalue()


def read(path: str | Path) -> OpenRequest:
    """Return what a session's .zip holds, or its .json with the .npz of the same name beside it."""
    path = Path(path)
    try:
        require_regular(path)
        text, arrays = _of_zip(path) if path.suffix.lower() == ".zip" else _of_two(path)
    except OSError as error:
        raise StorageError(f"cannot read {error.filename or path}: {error.strerror or error}") from error
    try:
        return _opening(_table(text), arrays)
    except InputError as error:
        raise error.within(path) from None


def _of_zip(path: Path) -> tuple[bytes, bytes]:
    try:
        with zipfile.ZipFile(path) as archive:
            if not {TABLE, ARRAYS} <= set(archive.namelist()):
                raise InputError(f"{path} is no session", f"a session holds {TABLE} and {ARRAYS}", key="session")
            _require_small(path, sum(entry.file_size for entry in archive.infolist()))
            return archive.read(TABLE), archive.read(ARRAYS)
    except (InputError, OSError):
        raise
    except Exception as error:  # zipfile, zlib and struct raise anything
        raise InputError(f"{path} is not a .zip file that can be read ({type(error).__name__})") from None


def _of_two(path: Path) -> tuple[bytes, bytes]:
    beside = path.with_suffix(".npz")
    for file in (path, beside):
        require_regular(file)
        _require_small(file, file.stat().st_size)
    return path.read_bytes(), beside.read_bytes()


def _require_small(name: str | Path, size: int) -> None:
    """Raise InputError for what would fill the memory; no entry of an archive gives more bytes than it says."""
    if size > UNPACKED_BYTES:
        problem = f"{name} would take {size / 1e6:.0f} MB of memory"
        raise InputError(problem, f"a session takes {UNPACKED_BYTES / 1e6:.0f} MB at most", key="session", value=size)


def _table(text: bytes) -> dict:
    table = parse_json(text, TABLE)
    if not isinstance(table, dict) or not set(KEYS) <= set(table):
        raise InputError("it is not a session", f"{TABLE} of a session holds {', '.join(KEYS)}", key="session")
    if table["fdcal_session"] != VERSION:
        found = shown(table["fdcal_session"], 20)
        remedy = f"this fdcal reads version {VERSION}"
        raise InputError(f"fdcal_session = {found!r}", remedy, key="fdcal_session", value=found)
    for key, kind in (("scene", dict), ("choices", dict), ("start_seed", int), ("index", int)):
        if not isinstance(table[key], kind) or isinstance(table[key], bool):
            raise InputError(f"{key} must be of type {kind.__name__}")
    return table


def _opening(table: dict, packed: bytes) -> OpenRequest:
    scene = build(MeasuredScene if table.get("measured") is True else Scene, _infinite(table["scene"]))
    if isinstance(scene, MeasuredScene):
        scene = dataclasses.replace(scene, file="")  # a session reads no other file
    try:
        with zipfile.ZipFile(io.BytesIO(packed)) as archive:
            _require_small(ARRAYS, sum(entry.file_size for entry in archive.infolist()))
        arrays = read_archive(io.BytesIO(packed), lambda key: key.startswith("states_"))
    except InputError:
        raise
    except Exception as error:  # a damaged archive raises anything
        raise InputError(f"{ARRAYS} is damaged or holds more than plain arrays ({type(error).__name__})") from None
    measurement = load_measurement(io.BytesIO(packed), called=ARRAYS)
    own = scene.room.dimension, scene.array.dimension
    if (measurement.dimension, measurement.array_dimension) != own:
        found = measurement.dimension, measurement.array_dimension
        problem = f"the measurement has a field and an array of {found[0]} and {found[1]} dimensions, the scene of"
        raise InputError(f"{problem} {own[0]} and {own[1]}", "use the files of one session", key="session", value=found)
    problem = measurement.problem(scene.solver.weights, scene.solver.known)
    made = read_states(table["states"], arrays, problem, scene.solver.name, MAX_STATES)
    return OpenRequest(scene, table["start_seed"], measurement, made, table["index"], table["choices"])


def kept_states(run, index: int | None) -> list[int]:
    """Return the indices of the states to keep: all, or so many that the file stays small, state `index` among them."""
    largest = max(state_bytes(state) for state in (run[0], run[len(run) // 2], run[-1]))
    most = min(MAX_STATES, max(2, WRITTEN_BYTES // largest))
    if len(run) <= most:
        return list(range(len(run)))
    even = np.linspace(0, len(run) - 1, most - 1).round().astype(int).tolist()
    return sorted({*even, len(run) - 1 if index is None else index})


def state_bytes(record) -> int:
    """Return about how many bytes a state, or a record inside it, takes."""
    values = [getattr(record, field.name) for field in dataclasses.fields(record)]
    arrays = sum(value.nbytes for value in values if isinstance(value, np.ndarray))
    return 200 + arrays + sum(state_bytes(value) for value in values if dataclasses.is_dataclass(value))


def _finite(value):
    """Return a table with infinity as a text: a scene's SNR may be infinite, and JSON has no infinity."""
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_finite(inner) for inner in value]
    return "inf" if value == float("inf") else value


def _infinite(table: dict) -> dict:
    """Return the inverse of `_finite` for the one key that may be infinite."""
    sensing = table.get("measurement")
    if isinstance(sensing, dict) and sensing.get("snr_db") == "inf":
        return {**table, "measurement": {**sensing, "snr_db": float("inf")}}
    return table
