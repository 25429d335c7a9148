"""Solver states as a table of plain values and a few arrays, and back, to the last bit.

States of one kind are told field by field, in columns. An array is a reference into stacks of arrays of one shape;
those that several states share are kept once. Settings are told once, too. Nothing in such a table is run when it is
read: every value is checked against the field of the state's class.
"""

from __future__ import annotations

import dataclasses
import math
import typing
from collections.abc import Mapping, Sequence

import numpy as np

from .. import solvers
from ..model.from_table import build
from ..model.limits import LIMITS
from ..model.problem import Problem
from ..model.settings import SolverSettings
from ..model.validation import InputError, frozen_array
from .request import plain

LARGEST_COUNT = 10**9  # of steps, sweeps and other whole numbers
KINDS = "fiub"  # of the numbers in an array
FINAL = ("inf", "-inf")


# -- to a table ------------------------------------------------------------------------------------------------------


class _Shelf:
    """Arrays and settings, each kept once."""

    def __init__(self):
        self.stacks: dict[tuple, list] = {}
        self.settings: list[SolverSettings] = []
        self._places: dict[int, dict] = {}
        self._kept: list = []  # so that no identity is used again

    def put(self, array: np.ndarray) -> dict:
        if id(array) not in self._places:
            if array.dtype.kind not in KINDS or not np.isfinite(array).all():
                raise InputError("the run has come to numbers that are not finite; rewind before you save it")
            names = list(self.stacks)
            key = (array.dtype.str, array.shape)
            stack = self.stacks.setdefault(key, [])
            stack.append(array)
            number = names.index(key) if key in names else len(names)
            self._places[id(array)] = {"array": [number, len(stack) - 1]}
            self._kept.append(array)
        return self._places[id(array)]

    def put_settings(self, settings: SolverSettings) -> dict:
        if settings not in self.settings:
            self.settings.append(settings)
        return {"settings": self.settings.index(settings)}


def written(states: Sequence) -> tuple[dict, dict[str, np.ndarray]]:
    """A table for JSON and arrays by name. Raises InputError for a state with numbers that are not finite."""
    shelf, kinds, order = _Shelf(), [], []
    for state in states:
        name = state.solver
        if name not in kinds:
            kinds.append(name)
        order.append(kinds.index(name))
    tables = []
    for number, name in enumerate(kinds):
        mine = [state for state, kind in zip(states, order, strict=True) if kind == number]
        columns = {f.name: [_out(getattr(s, f.name), shelf) for s in mine] for f in dataclasses.fields(mine[0])}
        tables.append({"solver": name, "fields": columns})
    table = {"order": order, "kinds": tables, "settings": [plain(dataclasses.asdict(s)) for s in shelf.settings]}
    return table, {f"states_{i}": np.array(stack) for i, stack in enumerate(shelf.stacks.values())}


def _out(value, shelf: _Shelf):
    """A value of a state as JSON has it."""
    if isinstance(value, np.ndarray):
        return shelf.put(value)
    if isinstance(value, SolverSettings):
        return shelf.put_settings(value)
    if isinstance(value, tuple):
        return {"tuple": [_out(inner, shelf) for inner in value]}
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, float) and not math.isfinite(value):
        if math.isnan(value):
            raise InputError("the run has come to numbers that are not finite; rewind before you save it")
        return {"number": str(value)}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise TypeError(f"a state holds a {type(value).__name__}, which a file cannot")


# -- from a table ----------------------------------------------------------------------------------------------------


def read(table, arrays: Mapping[str, np.ndarray], problem: Problem, solver: str, most: int) -> tuple:
    """The states of a table, `most` at most, all of `solver` or, if that is a chain, of its members.

    Raises InputError for whatever is not of the kind, the shape and the range that a state of `problem` has.
    """
    order, kinds, settings = (_list(table, key) for key in ("order", "kinds", "settings"))
    if not 1 <= len(order) <= most:
        raise InputError(f"states.order has {len(order)} entries; there can be 1 to {most}")
    shelf = [build(SolverSettings, one if isinstance(one, dict) else {}, "settings.") for one in settings]
    made = [_states_of(kind, solver.split("+"), arrays, shelf, problem) for kind in kinds]
    queues, states = [iter(one) for one in made], []
    for number in order:
        state = next(queues[number], None) if isinstance(number, int) and 0 <= number < len(made) else None
        if state is None:
            raise InputError(f"states.order names a state of kind {number}, which is not there")
        states.append(state)
    return tuple(states)


def _list(table, key: str) -> list:
    if not isinstance(table, dict) or not isinstance(table.get(key), list):
        raise InputError(f"states.{key} must be a list")
    return table[key]


def _states_of(table, members: list[str], arrays, settings, problem: Problem) -> list:
    """The states of one of `members`."""
    if not isinstance(table, dict) or not isinstance(table.get("fields"), dict):
        raise InputError("states.kinds must be tables with solver and fields")
    name = table.get("solver")
    if name not in members:
        raise InputError(f'states are of solver {str(name)[:40]!r}; the scene has solver.name = "{"+".join(members)}"')
    State, columns = solvers.load(name).State, table["fields"]
    hints = typing.get_type_hints(State)
    names = [field.name for field in dataclasses.fields(State)]
    if set(columns) != set(names):
        odd = sorted(set(columns) ^ set(names))
        raise InputError(f"states of {name} differ in {', '.join(odd)}; the file is of another version of fdcal")
    lengths = {len(column) if isinstance(column, list) else -1 for column in columns.values()}
    if len(lengths) != 1 or -1 in lengths:
        raise InputError(f"states of {name} must have columns of one length")
    cache: dict = {}
    rows = zip(*(columns[key] for key in names), strict=True)
    return [
        State(
            **{
                key: _in(key, value, hints[key], arrays, settings, problem, cache)
                for key, value in zip(names, row, strict=True)
            }
        )
        for row in rows
    ]


def _in(key: str, value, hint, arrays, settings, problem: Problem, cache: dict):
    """A value out of JSON, of the type `hint`."""
    options = typing.get_args(hint) or (hint,)
    if value is None and type(None) in options:
        return None
    if isinstance(value, dict) and len(value) == 1:
        (kind, inner), wanted = *value.items(), options
        if kind == "array" and np.ndarray in wanted:
            return _array(key, inner, arrays, problem, cache)
        if kind == "settings" and SolverSettings in wanted and isinstance(inner, int) and 0 <= inner < len(settings):
            return settings[inner]
        if kind == "tuple" and tuple in wanted and key == "best":
            return _best(inner, arrays, problem, cache)
        if kind == "number" and float in wanted and inner in FINAL:
            return float(inner)
    elif isinstance(value, bool):
        if bool in options:
            return value
    elif isinstance(value, int) and int in options:
        low, high = _range(key, problem)
        if low <= value <= high:
            return value
        raise InputError(f"states.{key} = {value} must be from {low} to {high}")
    elif isinstance(value, (int, float)) and float in options and math.isfinite(value):
        return float(value)
    elif isinstance(value, str) and str in options and len(value) < 100 and value.isidentifier():
        return value
    raise InputError(f"states.{key} holds {str(value)[:60]!r}, which cannot be")


def _range(key: str, problem: Problem) -> tuple[int, int]:
    """Least and greatest of a whole number."""
    modes, count = problem.pressures.shape
    ranges = {"moved": (-1, count - 1), "turn": (0, max(len(problem.free) - 1, 0)), "degree": (1, 3)}
    ranges |= {"first": (1, modes), "last": (1, modes)}
    return ranges.get(key, (0, LARGEST_COUNT))


def _best(value, arrays, problem: Problem, cache: dict) -> tuple:
    """The end of an attempt, as `fdcal.solvers.joint_state.State.best` tells it."""
    arrays_of = ("positions", "shape", "noise", "noise_power")
    keys = ("best", "best", *arrays_of, "best")
    if not isinstance(value, list) or len(value) != len(keys):
        raise InputError(f"states.best must have {len(keys)} entries")
    kinds = (float, bool, *(np.ndarray for _ in arrays_of), bool)
    parts = zip(keys, value, kinds, strict=True)
    return tuple(_in(key, part, kind, arrays, (), problem, cache) for key, part, kind in parts)


def _array(key: str, place, arrays, problem: Problem, cache: dict) -> np.ndarray:
    """One of the stacked arrays, frozen, the same object wherever it is referred to."""
    if not (isinstance(place, list) and len(place) == 2 and all(isinstance(i, int) and i >= 0 for i in place)):
        raise InputError(f"states.{key} refers to an array that is not there")
    stack = arrays.get(f"states_{place[0]}")
    if stack is None or stack.ndim < 1 or place[1] >= len(stack):
        raise InputError(f"states.{key} refers to an array that is not there")
    if tuple(place) not in cache:
        array = stack[place[1]]
        if array.dtype.kind not in KINDS or not np.isfinite(array).all():
            raise InputError(f"states.{key} must be finite numbers")
        cache[tuple(place)] = frozen_array(array, array.dtype)
    array = cache[tuple(place)]
    wanted = _shape(key, problem)
    if wanted is not None and array.shape != wanted:
        raise InputError(f"states.{key} has shape {array.shape}; with this measurement it is {wanted}")
    if key in ("positions", "shape", "centre") and np.abs(array).max(initial=0.0) > LIMITS.coordinate:
        raise InputError(f"states.{key} is too far away; use coordinates up to {LIMITS.coordinate:g} m")
    return array


def _shape(key: str, problem: Problem) -> tuple | None:
    """Shape of an array of a state; None where any may be."""
    modes, count = problem.pressures.shape
    D = problem.array_dimension
    shapes = {"positions": (count, D), "shape": (count, D), "centre": (D,), "noise": (modes,), "noise_power": (modes,)}
    return shapes.get(key)
