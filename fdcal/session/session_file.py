"""A session as a file, with which `fdcal view SESSION` continues.

It is a .zip of two files. session.json holds the scene with the settings of its solver, the seed of the start, the
index of the state that was shown, the values of the page's controls and the states; infinity is written as Python's
json module writes it. session.npz holds the arrays of the states and the measurement; it is a measurement file that
`fdcal calibrate` can read. msgspec reads each state as its class declares it. Reading executes no code of either file.
"""

import dataclasses
import io
import json
import math
import pickle
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from .. import solvers
from ..model.measurement import load_measurement, save_measurement
from ..model.problem import Problem
from ..model.scene import MeasuredScene, Scene
from ..model.storage import damaged, load_archive, parse_text, require_regular
from ..model.validation import LIMITS, InputError, build, convert, evenly_spaced, frozen_array, naming, refusal, shown
from ..solvers.interface import RunState
from .scene_edits import plain, table_of
from .session import MAX_STATES
from .sources import OpenRequest

VERSION = 4
TABLE, ARRAYS = "session.json", "session.npz"
UNPACKED_BYTES = 400_000_000  # largest size of an archive when it is unpacked
WRITTEN_BYTES = 64_000_000  # largest size of the states in a file; of longer runs fewer are written, evenly spaced
KEYS = ("fdcal_session", "scene", "start_seed", "index", "choices", "states")


def write(opening: OpenRequest) -> bytes:
    """Return the bytes of the .zip of a request that has a measurement and states; raise InputError for NaN."""
    assert opening.measurement is not None
    scene = opening.scene
    if isinstance(scene, MeasuredScene):
        scene = dataclasses.replace(scene, file="")  # the measurement itself is in the session
    kept = kept_states(opening.states, opening.index)
    table, arrays = write_states([opening.states[i] for i in kept])
    content = {
        "fdcal_session": VERSION,
        "scene": table_of(scene),
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
        archive.writestr(TABLE, json.dumps(content))
        archive.writestr(ARRAYS, file.getvalue())
    return packed.getvalue()


def read(path: str | Path) -> OpenRequest:
    """Return the request that opens the session in a .zip file."""
    with damaged(f"{path} is not a .zip file that can be read"):
        require_regular(Path(path))
        with zipfile.ZipFile(path) as archive:
            if not {TABLE, ARRAYS} <= set(archive.namelist()):
                raise InputError(f"{path} is not a session", f"a session holds {TABLE} and {ARRAYS}", key="session")
            # zipfile never unpacks more bytes of an entry than the entry declares
            if (size := sum(entry.file_size for entry in archive.infolist())) > UNPACKED_BYTES:
                limit = f"a session takes {UNPACKED_BYTES / 1e6:.0f} MB at most"
                raise InputError(f"{path} would take {size / 1e6:.0f} MB of memory", limit, key="session")
            text, arrays = archive.read(TABLE), archive.read(ARRAYS)
    with naming(path):
        table = parse_text(text, "JSON", TABLE)
        if not isinstance(table, dict) or not set(KEYS) <= set(table):
            raise InputError("it is not a session", f"{TABLE} of a session holds {', '.join(KEYS)}", key="session")
        if table["fdcal_session"] != VERSION:
            raise refusal("fdcal_session", table["fdcal_session"], "is another version", f"fdcal reads {VERSION}")
        for key, kind in (("scene", dict), ("choices", dict), ("start_seed", int), ("index", int)):
            convert(table[key], kind, key)
        scene = build(MeasuredScene if table.get("measured") is True else Scene, table["scene"])
        if isinstance(scene, MeasuredScene):
            scene = dataclasses.replace(scene, file="")  # a session reads no other file
        stacks = load_archive(io.BytesIO(arrays), lambda key: key.startswith("states_"), ARRAYS)
        measurement = load_measurement(io.BytesIO(arrays), called=ARRAYS)
        own = scene.room.dimension, scene.array.dimension
        if (measurement.dimension, measurement.array_dimension) != own:
            found = measurement.dimension, measurement.array_dimension
            problem = f"the measurement has a field and an array of {found[0]} and {found[1]} dimensions, the scene of"
            raise InputError(f"{problem} {own[0]} and {own[1]}", "use the files of one session", key="session")
        problem = measurement.problem(scene.solver.weights, scene.solver.known)
        made = read_states(table["states"], stacks, problem, scene.solver.name, MAX_STATES)
        return OpenRequest(scene, table["start_seed"], measurement, made, table["index"], table["choices"])


def kept_states(run, index: int | None) -> list[int]:
    """Return the indices of the states to keep: all, or fewer if the file would be too large, `index` among them."""
    # about the size of the largest state, bytes
    largest = max(len(pickle.dumps(state)) for state in (run[0], run[len(run) // 2], run[-1]))
    max_count = min(MAX_STATES, max(2, WRITTEN_BYTES // largest))
    if len(run) <= max_count:
        return list(range(len(run)))
    return sorted({*evenly_spaced(len(run), max_count - 1).tolist(), len(run) - 1 if index is None else index})


LARGEST_COUNT = 10**9  # largest number of steps, sweeps and the like
OTHER_VERSION = "open the file with the version of fdcal that wrote it"
NOT_FINITE = "the run has reached numbers that are not finite", "rewind the run before you save it"
NUMERIC_KINDS = "fiub"  # NumPy's kinds of number that an array may hold
PLACES = ("positions", "stage_start", "centre")  # arrays of coordinates, metres


class StateReader:
    """Reads states from JSON; checks them against their types, and against the shapes and ranges of the problem."""

    def __init__(self, arrays: Mapping[str, np.ndarray], problem: Problem):
        self._arrays = arrays
        self._read: dict[tuple, np.ndarray] = {}  # each array is read once, also if several states refer to it
        (M, N), D = problem.pressures.shape, problem.array_dimension
        self._shapes = {
            "positions": (N, D), "stage_start": (N, D), "centre": (D,), "gains": (N, 2), "offsets": (N, 2),
            "noise": (M,), "noise_power": (M,), "power": (M,), "channel_noise": (N,), "filters": (N, 2),
            "places": problem.known_positions.shape, "contradicted": problem.known.shape,
        }  # fmt: skip
        self._ranges = {"moved": (-1, N - 1), "turn": (0, max(len(problem.free) - 1, 0))}
        self._ranges |= {"first": (1, M), "last": (1, M), "restart": (-1, LARGEST_COUNT)}

    def state(self, table: dict[str, Any], State: type) -> Any:
        """Return the state that a dict of its fields describes."""
        try:
            state = msgspec.convert(table, State, dec_hook=self._array)
        except msgspec.ValidationError as error:
            problem, at, place = str(error).rpartition(" - at `$")
            key = f"states{place.removesuffix('`')}" if at else "states"
            raise InputError(f"{key}: {shown(problem if at else str(error), 200)}", OTHER_VERSION, key=key) from error
        self._check("states", state, table)
        return state

    def _array(self, kind: Any, place: Any) -> np.ndarray:
        """Return one of the stacked arrays, frozen. If it is missing, msgspec adds the key to the ValueError."""
        stack = None
        if isinstance(place, list) and len(place) == 2 and all(isinstance(i, int) and i >= 0 for i in place):
            stack = self._arrays.get(f"states_{place[0]}")
        if stack is None or stack.ndim < 1 or place[1] >= len(stack):
            raise ValueError("it refers to an array that the file does not hold")
        if tuple(place) not in self._read:
            array = stack[place[1]]
            if array.dtype.kind not in NUMERIC_KINDS or not np.isfinite(array).all():
                raise ValueError("an array must hold finite numbers")
            self._read[tuple(place)] = frozen_array(array, array.dtype)
        return self._read[tuple(place)]

    def _check(self, key: str, value: Any, given: Any) -> None:
        """Raise InputError unless a state of this problem can have `value` in field `key`; `given`: as in the file."""
        name = f"states.{key}"
        if dataclasses.is_dataclass(value) and value is not given:
            fields = [field.name for field in dataclasses.fields(value)]
            if others := set(given) ^ set(fields):  # msgspec would fill in missing fields and skip unknown ones
                raise InputError(f"{key}: unknown or missing: {shown(sorted(others), 300)}", OTHER_VERSION, key=key)
            for field in fields:
                self._check(field, getattr(value, field), given[field])
        elif isinstance(value, tuple):
            for one, inner in zip(value, given, strict=True):
                self._check(key, one, inner)
        elif isinstance(value, np.ndarray):
            if value.shape != self._shapes.get(key, value.shape):
                raise InputError(f"{name} has shape {value.shape}", f"it must be {self._shapes[key]}", key=name)
            if key in PLACES and np.abs(value).max(initial=0.0) > LIMITS.coordinate:
                raise InputError(f"{name} is too far away", f"use coordinates up to {LIMITS.coordinate:g} m", key=name)
        elif isinstance(value, int) and not isinstance(value, bool):
            low, high = self._ranges.get(key, (0, LARGEST_COUNT))
            if not low <= value <= high:
                raise InputError(f"{name} = {shown(value)} must be from {low} to {high}", key=name)
        elif isinstance(value, float) and math.isnan(value):
            raise InputError(f"{name} = nan must be a number", key=name)


def write_states(states: Sequence[RunState]) -> tuple[dict, dict[str, np.ndarray]]:
    """Return states of one solver as a table for JSON and arrays by name.

    Each array is written once, in a stack of arrays of the same type and shape. In its place the table holds the number
    of the stack and the index in it. Raises InputError for NaN, or for an array with an infinite value.
    """
    stacks: dict[tuple, list[np.ndarray]] = {}
    references: dict[int, tuple[np.ndarray, list[int]]] = {}  # the array is kept, so that no other array gets its id

    def encoded(value: Any) -> Any:
        if isinstance(value, np.generic):
            return value.item()
        if not isinstance(value, np.ndarray):
            raise TypeError(f"a state holds a {type(value).__name__}, which cannot be written")
        if id(value) not in references:
            if value.dtype.kind not in NUMERIC_KINDS or not np.isfinite(value).all():
                raise InputError(*NOT_FINITE)
            key = (value.dtype.str, value.shape)
            stack = stacks.setdefault(key, [])
            stack.append(value)
            references[id(value)] = value, [list(stacks).index(key), len(stack) - 1]
        return references[id(value)][1]

    rows = [msgspec.to_builtins(state, enc_hook=encoded) for state in states]
    if "NaN" in json.dumps(rows):
        raise InputError(*NOT_FINITE)
    table = {"solver": states[0].solver, "rows": rows}
    return table, {f"states_{i}": np.array(stack) for i, stack in enumerate(stacks.values())}


def read_states(
    table: Any, arrays: Mapping[str, np.ndarray], problem: Problem, solver: str, max_count: int
) -> tuple[RunState, ...]:
    """Return the states, at most `max_count`, of a table that `write_states` made, and of its arrays.

    Raises InputError if the type, shape or range of a value is not that of a state of `problem`.
    """
    rows, name = (table.get("rows"), table.get("solver")) if isinstance(table, dict) else (None, None)
    if not isinstance(rows, list) or not all(isinstance(entry, dict) for entry in rows):
        raise InputError("states.rows must be a list of tables", key="states.rows")
    if not 1 <= len(rows) <= max_count:
        raise InputError(f"states.rows has {len(rows)} entries", f"it holds 1 to {max_count}", key="states.rows")
    if name != solver:
        raise refusal("states.solver", name, "is not that of the scene", f'the scene has solver.name = "{solver}"')
    reader = StateReader(arrays, problem)
    return tuple(reader.state(row, solvers.load(solver).State) for row in rows)
