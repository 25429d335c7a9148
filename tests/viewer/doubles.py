"""Test doubles of a session, its states and its solver, and clients of the page that are not browsers."""

import dataclasses
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from browsing import WAIT

from benchmarks.protocol import CAMERA, connect, messages, send
from fdcal import solvers
from fdcal.assessment.calibration import Channels, Evidence
from fdcal.session.calibration_run import Assessment
from fdcal.session.session import SessionView
from fdcal.viewer.server.client_values import fits, is_plain

INVALID_VALUES = [1e9, -1e9, float("nan"), float("inf"), "many", "", None, [1, 2], {"a": 1}, 10**400, b"\x00"]


def finish(coroutine):
    """Run a coroutine that never waits, because the browser's driver occupies this thread's event loop."""
    with pytest.raises(StopIteration):
        coroutine.send(None)


def wait_until(happened, turn=lambda: None):
    """Wait until `happened` is true, on another thread or after a call of `turn`; return its value."""
    for _ in range(round(WAIT / 0.02)):
        turn()
        if found := happened():
            return found
        time.sleep(0.02)
    pytest.fail("it does not happen")


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

    @property
    def best_positions(self):
        return self.positions

    def next_microphone(self, problem):
        return -1


def assessment(verdict, text, **changes) -> Assessment:
    """What the page receives at the end of a run with three microphones, the first one known."""
    covariance = np.array([0.0, 3e-4, 3e-4])[:, None, None] ** 2 / 2 * np.eye(2)
    numbers = dict(covariance=covariance, evidence=Evidence(1.0), channels=Channels(*np.zeros((5, 3))))
    return Assessment(np.zeros((3, 2)), None, verdict, text, **numbers | changes)


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


class CallRecorder:
    """An object that records all calls of its methods."""

    def __init__(self, calls, name="", **held):
        self.__dict__.update(_calls=calls, _name=name, **held)

    def __getattr__(self, name):
        return CallRecorder(self._calls, f"{self._name}.{name}".lstrip("."))

    def __call__(self, *arguments, **named):
        self._calls.append((self._name, *arguments, *named.items()))


def view_of(states, **changes) -> SessionView:
    return dataclasses.replace(SessionView(states[-1], len(states) - 1, tuple(states)), **changes)


def set_by_client(handle, value, client=True):
    """Do what the server does when a page sets a control to `value`; an impossible value is dropped."""
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
        if search.step == self.search.step:  # the map uses this lattice; its marks use a finer one, which needs no gate
            assert self.gate.acquire(timeout=WAIT)
        cost = np.ones((modes.stop - modes.start, *search.shape[::-1]))
        cost[0, 0, round((self.search.origin[0] - search.origin[0] + n * self.search.step) / search.step)] = 0.5
        return cost


NAN, INFINITE = float("nan"), float("inf")
HOSTILE_CAMERAS = [
    *({name: [bad] * 3} for name in ("position", "look_at", "up_direction") for bad in (NAN, INFINITE, 1e308, -1e308)),
    *({name: [0.0] * count} for name in ("position", "look_at", "up_direction") for count in (0, 2, 4)),
    *({name: bad} for name in ("position", "look_at", "up_direction") for bad in (None, 3, "abc", ["a", "b", "c"])),
    {"position": [[1, 2, 3]] * 3}, {"position": [1e308, 0, 0], "look_at": [-1e308, 0, 0]},
    {"look_at": CAMERA["position"]}, {"up_direction": [0, 0, 0]}, {"up_direction": {"z": 1}}, {"up_direction": True},
    {"wxyz": [0, 0, 0]}, {"wxyz": [NAN] * 4}, {"wxyz": "no"}, {"fov": NAN}, {"fov": 1e308}, {"fov": -1},
    {"near": NAN}, {"far": INFINITE}, {"near": 9.0, "far": 0.1}, {"near": 0},
    {"image_width": NAN}, {"image_width": 10**18}, {"image_height": "wide"}, {"image_height": -5},
]  # fmt: skip


def join(server):
    """Connect to a viser server of this process."""
    return connect(f"ws://127.0.0.1:{server.get_port()}")


def is_served(server) -> bool:
    """Return whether a new client receives the whole page."""
    with join(server) as client:
        send(client, **CAMERA)
        return any(message["type"] == "ReplayDoneMessage" for message in messages(client))
