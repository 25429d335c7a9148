"""Solver states as a table of plain values and a few arrays, and back, to the last bit.

    {"order": [0, 0, 1], "kinds": [{"solver": "joint", "fields": {field: [a value of every state]}}],
     "settings": [table]}

`order` says of which kind each state is. A value is a JSON value or one of

    {"array": [s, i]}        array i of the stack `states_s`; arrays of one shape are stacked, shared ones written once
    {"settings": i}          entry i of `settings`
    {"record": {field: value}}, {"tuple": [value]}, {"number": "inf"}

Reading runs nothing: every value is checked against the type that the state's class declares for the field.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .. import solvers
from ..model.from_table import build
from ..model.problem import Problem
from ..model.settings import SolverSettings
from ..model.validation import InputError, shown, shown_literal
from ..solvers.interface import RunState
from .request import plain
from .state_values import NUMERIC_KINDS, StateReader


def _not_finite() -> InputError:
    return InputError("the run has reached numbers that are not finite", "rewind before you save it")


class _ArrayStore:
    """Arrays and settings, each kept once."""

    def __init__(self):
        self.stacks: dict[tuple, list[np.ndarray]] = {}
        self.settings: list[SolverSettings] = []
        self._references: dict[int, tuple[np.ndarray, dict]] = {}  # with the array, so that its identity stays its own

    def put(self, array: np.ndarray) -> dict:
        if id(array) not in self._references:
            if array.dtype.kind not in NUMERIC_KINDS or not np.isfinite(array).all():
                raise _not_finite()
            key = (array.dtype.str, array.shape)
            stack = self.stacks.setdefault(key, [])
            stack.append(array)
            self._references[id(array)] = array, {"array": [list(self.stacks).index(key), len(stack) - 1]}
        return self._references[id(array)][1]

    def put_settings(self, settings: SolverSettings) -> dict:
        if settings not in self.settings:
            self.settings.append(settings)
        return {"settings": self.settings.index(settings)}


def write_states(states: Sequence[RunState]) -> tuple[dict, dict[str, np.ndarray]]:
    """Return the states as a table for JSON and arrays by name.

    Raises InputError for a state with numbers that are not finite.
    """
    store = _ArrayStore()
    kinds = list(dict.fromkeys(state.solver for state in states))
    tables = []
    for name in kinds:
        mine = [state for state in states if state.solver == name]
        columns = {f.name: [_out(getattr(s, f.name), store) for s in mine] for f in dataclasses.fields(mine[0])}
        tables.append({"solver": name, "fields": columns})
    order = [kinds.index(state.solver) for state in states]
    table = {"order": order, "kinds": tables, "settings": [plain(dataclasses.asdict(s)) for s in store.settings]}
    return table, {f"states_{i}": np.array(stack) for i, stack in enumerate(store.stacks.values())}


def _out(value: Any, store: _ArrayStore) -> Any:
    """A value of a state as JSON has it."""
    if isinstance(value, np.ndarray):
        return store.put(value)
    if isinstance(value, SolverSettings):
        return store.put_settings(value)
    if dataclasses.is_dataclass(value):
        return {"record": {f.name: _out(getattr(value, f.name), store) for f in dataclasses.fields(value)}}
    if isinstance(value, tuple):
        return {"tuple": [_out(inner, store) for inner in value]}
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, float) and not math.isfinite(value):
        if math.isnan(value):
            raise _not_finite()
        return {"number": str(value)}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise TypeError(f"a state holds a {type(value).__name__}, which a file cannot")


def read_states(
    table: Any, arrays: Mapping[str, np.ndarray], problem: Problem, solver: str, most: int
) -> tuple[RunState, ...]:
    """Return the states of a table.

    `table`: what JSON gives of the table of `write_states`; `arrays`: the arrays, by name; `problem`: that the states
    are of; `solver`: name of the solver; of a chain, states of each of its members are possible; `most`: number of
    states at most. Raises InputError for whatever is not of the type, the shape and the range that a state of `problem`
    has.
    """
    order, kinds, settings = (_list(table, key) for key in ("order", "kinds", "settings"))
    if not 1 <= len(order) <= most:
        remedy = f"a session holds 1 to {most} states"
        raise InputError(f"states.order has {len(order)} entries", remedy, key="states.order", value=len(order))
    read_settings = [build(SolverSettings, one if isinstance(one, dict) else {}, "settings.") for one in settings]
    reader = StateReader(arrays, read_settings, problem)
    queues, states = [iter(_states_of(kind, solver.split("+"), reader)) for kind in kinds], []
    for number in order:
        state = next(queues[number], None) if isinstance(number, int) and 0 <= number < len(queues) else None
        if state is None:
            raise InputError(
                f"states.order names a state of kind {shown(number)}, which is not there", key="states.order"
            )
        states.append(state)
    return tuple(states)


def _list(table: Any, key: str) -> list:
    if not isinstance(table, dict) or not isinstance(table.get(key), list):
        raise InputError(f"states.{key} must be a list", key=f"states.{key}")
    return table[key]


def _states_of(table: Any, members: list[str], reader: StateReader) -> list[RunState]:
    """The states of one of `members`."""
    if not isinstance(table, dict) or not isinstance(table.get("fields"), dict):
        raise InputError("states.kinds must be tables with solver and fields", key="states.kinds")
    name, columns = table.get("solver"), table["fields"]
    if name not in members:
        remedy = f"the scene has solver.name = {shown_literal('+'.join(members))}"
        raise InputError(f"states are of solver {shown_literal(name)}", remedy, key="states.kinds", value=name)
    State, what = solvers.load(name).State, f"states of {name}"
    reader.require_fields(what, columns, State)
    lengths = {len(column) if isinstance(column, list) else -1 for column in columns.values()}
    if len(lengths) != 1 or -1 in lengths:
        raise InputError(f"states of {name} must have columns of one length", key="states.kinds")
    rows = zip(*columns.values(), strict=True)
    return [reader.record(what, dict(zip(columns, row, strict=True)), State) for row in rows]
