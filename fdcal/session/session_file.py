"""A session as a file, with which `fdcal view SESSION` continues.

It is a .zip of two files, session.json and session.npz, which may also lie in a folder of their own. The first holds
the scene with the settings of its solver, the seed of the start, the index of the state that was shown, the values of
the page's controls and the states. The second holds their arrays and the measurement; it is a measurement file that
`fdcal calibrate` can read. Each value of a state is checked against the type that the state's class declares for the
field. Reading either file runs nothing.
"""

import dataclasses
import io
import json
import math
import sys
import types
import typing
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import solvers
from ..model.measurement import load_measurement, save_measurement
from ..model.problem import Problem
from ..model.scene import MeasuredScene, Scene
from ..model.settings import SolverSettings
from ..model.storage import parse_json, read_archive, require_regular
from ..model.validation import LIMITS, InputError, StorageError, build, convert, frozen_array, shown, shown_literal
from ..solvers.interface import RunState
from .scene_edits import plain, table_of
from .session import MAX_STATES
from .sources import OpenRequest

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
        if path.suffix.lower() == ".zip":
            with zipfile.ZipFile(path) as archive:
                if not {TABLE, ARRAYS} <= set(archive.namelist()):
                    raise InputError(f"{path} is no session", f"a session holds {TABLE} and {ARRAYS}", key="session")
                _require_small(path, sum(entry.file_size for entry in archive.infolist()))
                text, arrays = archive.read(TABLE), archive.read(ARRAYS)
        else:
            for file in (path, path.with_suffix(".npz")):
                require_regular(file)
                _require_small(file, file.stat().st_size)
            text, arrays = path.read_bytes(), path.with_suffix(".npz").read_bytes()
    except InputError:
        raise
    except OSError as error:
        raise StorageError(f"cannot read {error.filename or path}: {error.strerror or error}") from error
    except Exception as error:  # zipfile, zlib and struct raise anything
        raise InputError(f"{path} is not a .zip file that can be read ({type(error).__name__})") from None
    try:
        return _opening(text, arrays)
    except InputError as error:
        raise error.within(path) from None


def _require_small(name: str | Path, size: int) -> None:
    """Raise InputError for what would fill the memory; no entry of an archive gives more bytes than it says."""
    if size > UNPACKED_BYTES:
        problem = f"{name} would take {size / 1e6:.0f} MB of memory"
        raise InputError(problem, f"a session takes {UNPACKED_BYTES / 1e6:.0f} MB at most", key="session", value=size)


def _opening(text: bytes, packed: bytes) -> OpenRequest:
    """Return the request that the two files of a session hold."""
    table = parse_json(text, TABLE)
    if not isinstance(table, dict) or not set(KEYS) <= set(table):
        raise InputError("it is not a session", f"{TABLE} of a session holds {', '.join(KEYS)}", key="session")
    if table["fdcal_session"] != VERSION:
        found = shown(table["fdcal_session"], 20)
        remedy = f"this fdcal reads version {VERSION}"
        raise InputError(f"fdcal_session = {found!r}", remedy, key="fdcal_session", value=found)
    for key, kind in (("scene", dict), ("choices", dict), ("start_seed", int), ("index", int)):
        convert(table[key], kind, key)
    described = dict(table["scene"])
    if isinstance(sensing := described.get("measurement"), dict) and sensing.get("snr_db") == "inf":
        described["measurement"] = {**sensing, "snr_db": float("inf")}  # the one key that may be infinite
    scene = build(MeasuredScene if table.get("measured") is True else Scene, described)
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
    max_count = min(MAX_STATES, max(2, WRITTEN_BYTES // largest))
    if len(run) <= max_count:
        return list(range(len(run)))
    even = np.linspace(0, len(run) - 1, max_count - 1).round().astype(int).tolist()
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


LARGEST_COUNT = 10**9  # of steps, sweeps and other whole numbers
NUMERIC_KINDS = "fiub"  # NumPy's kinds of number that an array may hold
INFINITE = ("inf", "-inf")
PLACES = ("positions", "shape", "origin", "centre", "place")  # arrays of coordinates, metres


class StateReader:
    """Values out of JSON, checked against the types and the problem, which determines the shapes and ranges."""

    def __init__(self, arrays: Mapping[str, np.ndarray], settings: list[SolverSettings], problem: Problem):
        self._arrays, self._settings = arrays, settings
        self._read: dict[tuple, np.ndarray] = {}  # an array is the same object wherever it is referred to
        self._hints: dict[type, dict[str, Any]] = {}
        modes, count = problem.pressures.shape
        D = problem.array_dimension
        self._shapes = {
            "positions": (count, D), "origin": (count, D), "shape": (count, D),
            "centre": (D,), "place": (D,), "walls": (D + 2,), "gains": (count, 2), "offsets": (count, 2),
            "noise": (modes,), "noise_power": (modes,), "power": (modes,), "channel_noise": (count,),
            "filters": (count, 2), "places": problem.known_positions.shape, "contradicted": problem.known.shape,
        }  # fmt: skip
        self._ranges = {"moved": (-1, count - 1), "turn": (0, max(len(problem.free) - 1, 0))}
        self._ranges |= {"first": (1, modes), "last": (1, modes), "restart": (-1, LARGEST_COUNT)}

    def require_fields(self, key: str, table: Any, Record: type) -> None:
        """Raise InputError unless `table` has the fields of a dataclass."""
        names = {field.name for field in dataclasses.fields(Record)}
        if not isinstance(table, dict) or set(table) != names:
            others = ", ".join(sorted(set(table) ^ names)) if isinstance(table, dict) else "all fields"
            problem = f"{key}: fields that differ from those of this version of fdcal: {shown(others, 300)}"
            raise InputError(problem, "open the file with the version that wrote it", key=key)

    def record(self, key: str, table: Any, Record: type) -> Any:
        """A frozen dataclass out of a dict of its fields."""
        self.require_fields(key, table, Record)
        hints = self._hints.setdefault(Record, typing.get_type_hints(Record))
        return Record(**{name: self._value(name, table[name], hints[name]) for name in table})

    def _value(self, key: str, value: Any, hint: Any) -> Any:
        """A value of the type `hint`."""
        options = typing.get_args(hint) if typing.get_origin(hint) in (typing.Union, types.UnionType) else (hint,)
        if value is None and type(None) in options:
            return None
        if isinstance(value, dict) and len(value) == 1:
            (kind, inner), *_ = value.items()
            for option in options:
                found = self._composed(key, kind, inner, option)
                if found is not None:
                    return found
        elif isinstance(value, bool):
            if bool in options:
                return value
        elif isinstance(value, int) and int in options:
            low, high = self._ranges.get(key, (0, LARGEST_COUNT))
            if low <= value <= high:
                return value
            problem = f"states.{key} = {shown(value)} must be from {low} to {high}"
            raise InputError(problem, key=f"states.{key}", value=value)
        elif isinstance(value, (int, float)) and float in options and abs(value) <= sys.float_info.max:
            return float(value)
        elif isinstance(value, str) and any(value in typing.get_args(option) for option in options):
            return value
        raise InputError(f"states.{key} holds {shown(value)!r}, which is impossible", key=f"states.{key}")

    def _composed(self, key: str, kind: str, inner: Any, option: Any) -> Any:
        """A value that is more than one JSON value, of the type `option`; None if it is not of that type."""
        if kind == "array" and np.ndarray in (option, typing.get_origin(option)):
            return self._array(key, inner)
        if kind == "settings" and option is SolverSettings:
            there = isinstance(inner, int) and 0 <= inner < len(self._settings)
            return self._settings[inner] if there else None
        if kind == "record" and dataclasses.is_dataclass(option) and option is not SolverSettings:
            return self.record(f"states.{key}", inner, typing.cast(type, option))
        if kind == "tuple" and typing.get_origin(option) is tuple and isinstance(inner, list):
            return tuple(self._value(key, one, typing.get_args(option)[0]) for one in inner)
        if kind == "number" and option is float and inner in INFINITE:
            return float(inner)
        return None

    def _array(self, key: str, place: Any) -> np.ndarray:
        """One of the stacked arrays, frozen."""
        stack = None
        if isinstance(place, list) and len(place) == 2 and all(isinstance(i, int) and i >= 0 for i in place):
            stack = self._arrays.get(f"states_{place[0]}")
        if stack is None or stack.ndim < 1 or place[1] >= len(stack):
            raise InputError(f"states.{key} refers to an array that is not there", key=f"states.{key}")
        if tuple(place) not in self._read:
            array = stack[place[1]]
            if array.dtype.kind not in NUMERIC_KINDS or not np.isfinite(array).all():
                raise InputError(f"states.{key} must be finite numbers", key=f"states.{key}")
            self._read[tuple(place)] = frozen_array(array, array.dtype)
        array, wanted = self._read[tuple(place)], self._shapes.get(key)
        if wanted is not None and array.shape != wanted:
            remedy = f"with this measurement it is {wanted}"
            raise InputError(f"states.{key} has shape {array.shape}", remedy, key=f"states.{key}", value=array.shape)
        if key in PLACES and np.abs(array).max(initial=0.0) > LIMITS.coordinate:
            raise InputError(f"states.{key} is too far away", f"use coordinates up to {LIMITS.coordinate:g} m")
        return array


NOT_FINITE = "the run has reached numbers that are not finite", "rewind before you save it"


class _StateWriter:
    """Values of states as JSON has them, with arrays and settings, each kept once."""

    def __init__(self):
        self.stacks: dict[tuple, list[np.ndarray]] = {}
        self.settings: list[SolverSettings] = []
        self._references: dict[int, tuple[np.ndarray, dict]] = {}  # with the array, so that its identity stays its own

    def value(self, value: Any) -> Any:
        """Return a value of a state as JSON has it."""
        if isinstance(value, np.ndarray):
            return self._array(value)
        if isinstance(value, SolverSettings):
            if value not in self.settings:
                self.settings.append(value)
            return {"settings": self.settings.index(value)}
        if dataclasses.is_dataclass(value):
            return {"record": {f.name: self.value(getattr(value, f.name)) for f in dataclasses.fields(value)}}
        if isinstance(value, tuple):
            return {"tuple": [self.value(inner) for inner in value]}
        value = value.item() if isinstance(value, np.generic) else value
        if isinstance(value, float) and not math.isfinite(value):
            if math.isnan(value):
                raise InputError(*NOT_FINITE)
            return {"number": str(value)}
        if value is None or isinstance(value, (bool, int, float, str)):
            return value
        raise TypeError(f"a state holds a {type(value).__name__}, which a file cannot")

    def _array(self, array: np.ndarray) -> dict:
        if id(array) not in self._references:
            if array.dtype.kind not in NUMERIC_KINDS or not np.isfinite(array).all():
                raise InputError(*NOT_FINITE)
            key = (array.dtype.str, array.shape)
            stack = self.stacks.setdefault(key, [])
            stack.append(array)
            self._references[id(array)] = array, {"array": [list(self.stacks).index(key), len(stack) - 1]}
        return self._references[id(array)][1]


def write_states(states: Sequence[RunState]) -> tuple[dict, dict[str, np.ndarray]]:
    """Return the states as a table for JSON and arrays by name; InputError for numbers that are not finite."""
    writer = _StateWriter()
    kinds = list(dict.fromkeys(state.solver for state in states))
    tables = []
    for name in kinds:
        mine = [state for state in states if state.solver == name]
        columns = {f.name: [writer.value(getattr(s, f.name)) for s in mine] for f in dataclasses.fields(mine[0])}
        tables.append({"solver": name, "fields": columns})
    order = [kinds.index(state.solver) for state in states]
    table = {"order": order, "kinds": tables, "settings": [plain(dataclasses.asdict(s)) for s in writer.settings]}
    return table, {f"states_{i}": np.array(stack) for i, stack in enumerate(writer.stacks.values())}


def read_states(
    table: Any, arrays: Mapping[str, np.ndarray], problem: Problem, solver: str, max_count: int
) -> tuple[RunState, ...]:
    """Return the states, `max_count` at most, of a table of `write_states` out of JSON and its arrays.

    InputError for what is not of the type, the shape and the range that a state of `problem` has.
    """
    for key in ("order", "kinds", "settings"):
        if not isinstance(table, dict) or not isinstance(table.get(key), list):
            raise InputError(f"states.{key} must be a list", key=f"states.{key}")
    order, kinds, settings = table["order"], table["kinds"], table["settings"]
    if not 1 <= len(order) <= max_count:
        remedy = f"a session holds 1 to {max_count} states"
        raise InputError(f"states.order has {len(order)} entries", remedy, key="states.order", value=len(order))
    read_settings = [build(SolverSettings, one if isinstance(one, dict) else {}, "settings.") for one in settings]
    reader = StateReader(arrays, read_settings, problem)
    State, what, queues, states = solvers.load(solver).State, f"states of {solver}", [], []
    for kind in kinds:
        if not isinstance(kind, dict) or not isinstance(kind.get("fields"), dict):
            raise InputError("states.kinds must be tables with solver and fields", key="states.kinds")
        name, columns = kind.get("solver"), kind["fields"]
        if name != solver:
            remedy = f"the scene has solver.name = {shown_literal(solver)}"
            raise InputError(f"states are of solver {shown_literal(name)}", remedy, key="states.kinds", value=name)
        reader.require_fields(what, columns, State)
        lengths = {len(column) if isinstance(column, list) else -1 for column in columns.values()}
        if len(lengths) != 1 or -1 in lengths:
            raise InputError(f"{what} must have columns of one length", key="states.kinds")
        rows = zip(*columns.values(), strict=True)
        queues.append(iter([reader.record(what, dict(zip(columns, row, strict=True)), State) for row in rows]))
    for number in order:
        state = next(queues[number], None) if isinstance(number, int) and 0 <= number < len(queues) else None
        if state is None:
            fault = f"states.order names a state of kind {shown(number)}, which is not there"
            raise InputError(fault, key="states.order")
        states.append(state)
    return tuple(states)
