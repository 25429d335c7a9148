"""Stand-ins for a session, its states and its solver."""

import dataclasses
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from browsing import WAIT

from fdcal import solvers
from fdcal.session.session import History, SessionView
from fdcal.viewer.server.client_values import fits, is_plain

INVALID_VALUES = [1e9, -1e9, float("nan"), float("inf"), "many", "", None, [1, 2], {"a": 1}, 10**400, b"\x00"]


def finish(coroutine):
    """Run a coroutine that waits for nothing; the browser's driver occupies this thread's event loop."""
    with pytest.raises(StopIteration):
        coroutine.send(None)


@dataclasses.dataclass(frozen=True)
class State:
    positions: np.ndarray
    step: int = 0
    sweep: int = 0
    stage: int = 0
    moved: int = -1
    first: int = 1
    last: int = 3
    automatic: bool = True
    cost: float = 1.0
    finished: bool = False
    converged: bool = False
    seed: int = 0
    order_offset: int = 0
    restart: int = 0
    channels: None = None


class Recorder:
    """A session that records its commands."""

    step_time = 0.001

    def __init__(self, state):
        self.commands = []
        self.view, self.ways = view_of([state]), 0

    def yield_to_ui(self):
        self.ways += 1

    def __getattr__(self, name):
        return lambda *arguments: self.commands.append((name, *arguments))


def view_of(states, **changes) -> SessionView:
    view = SessionView(states[-1], len(states) - 1, len(states), False, "", History(states, len(states)))
    return dataclasses.replace(view, **changes)


def set_by_client(handle, value, client=True):
    """What the server does when a page has set a control to `value`; one that it cannot have is dropped."""
    if not (is_plain({"value": value}) and fits(handle, value)):
        return
    handle._impl.value = value = type(handle.value)(value)
    event = SimpleNamespace(client=object() if client else None, target=SimpleNamespace(value=value))
    for callback in handle._impl.update_cb:
        finish(callback(event))


class Solver:
    """A solver whose maps wait for a gate; the column of the lowest cost is the number of their microphone."""

    def __init__(self, measurement):
        self.gate, self.search = threading.Semaphore(0), measurement.search
        self.TRAITS = solvers.load("joint").TRAITS

    def usable_modes(self, problem, settings):
        return len(problem.frequencies)

    def landscape(self, problem, state, n, modes, search=None):
        search = self.search if search is None else search
        if search.step == self.search.step:  # the lattice of the map; the finer one of its marks needs no gate
            assert self.gate.acquire(timeout=WAIT)
        cost = np.ones((modes.stop - modes.start, *search.shape[::-1]))
        cost[0, 0, round((self.search.origin[0] - search.origin[0] + n * self.search.step) / search.step)] = 0.5
        return cost
