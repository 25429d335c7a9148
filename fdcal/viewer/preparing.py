"""From a scene to a session, in the background, while page and terminal show how far it is; and Ctrl-C."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

import viser

from .. import solvers
from ..measurement import Measurement, Problem
from ..scene import Scene
from ..session import Session
from ..store import cached_measurement
from ..worker import LatestWorker
from . import words

LONGEST = 5.0  # s that an interrupted preparation is waited for


class Stopped(Exception):
    """Raised inside a simulation that nobody waits for any more."""


@dataclass(frozen=True)
class Work:
    """What a page shows: a scene, its measurement, and the session that calibrates it."""

    scene: Scene
    measurement: Measurement
    problem: Problem
    solver: ModuleType
    session: Session


class Progress:
    """How far the simulation is; told by its thread, read by the main one. `stop` ends it."""

    def __init__(self):
        self.done, self.stop = 0.0, False

    def __call__(self, done: float, *_) -> None:
        self.done = float(done)
        if self.stop:
            raise Stopped

    @property
    def text(self) -> str:
        return f"Simulating the room ... {round(100 * self.done)} %" if self.done < 1 else "Preparing the solver ..."


class Interrupt:
    """Ctrl-C as a flag, so that nothing is torn in the middle: the loops look at `came`. A context manager."""

    def __init__(self):
        self.came = False

    def __enter__(self) -> Interrupt:
        self._before = []
        for number in (signal.SIGINT, signal.SIGTERM):
            with contextlib.suppress(ValueError):  # outside the main thread there are no signals to hear
                self._before.append((number, signal.signal(number, self._note)))
        return self

    def _note(self, *_) -> None:
        self.came = True

    def __exit__(self, *_) -> None:
        for number, handler in self._before:
            signal.signal(number, handler)


def prepare(server: viser.ViserServer, scene: Scene, closers: list[Callable], interrupt: Interrupt) -> Work | None:
    """Measurement and session of a scene; None if interrupted. Raises what their making raises."""
    progress = Progress()
    worker = LatestWorker(lambda: _work(scene, progress), name="fdcal-prepare")
    closers.append(lambda: _abandon(worker, progress))
    line, bar = server.gui.add_html(words.waiting(scene.title, "Starting ...")), server.gui.add_progress_bar(0.0)
    worker.request()
    told = ""
    while not worker.wait_for(lambda latest: latest is not None, timeout=0.1):
        if interrupt.came:
            return None
        if progress.text != told:
            told = progress.text
            line.content, bar.value = words.waiting(scene.title, told), 100 * progress.done
            print(f"\r{told:<40}", end="", file=sys.stderr, flush=True)
    print(f"\r{'':<40}\r" if told else "", end="", file=sys.stderr, flush=True)
    line.remove()
    bar.remove()
    worker.close()
    if worker.latest.cause is not None:
        raise worker.latest.cause
    return worker.latest.result


def _abandon(worker: LatestWorker, progress: Progress) -> None:
    """End the simulation and wait for its thread, which may be writing the cache; close the session it has made."""
    progress.stop = True
    if worker.close(LONGEST) and worker.latest is not None and worker.latest.result is not None:
        worker.latest.result.session.close(0.5)


def _work(scene: Scene, progress: Progress) -> Work | None:
    """None where the simulation was stopped."""
    try:
        measurement = cached_measurement(scene, progress)
    except Stopped:
        return None
    progress.done = 1.0
    problem = measurement.problem(scene.solver.weights, scene.solver.known)
    solver = solvers.load(scene.solver.name)
    session = Session(problem, scene.solver, scene.seed, solver)
    _warm_up(problem, solver, session.view.state)
    return Work(scene, measurement, problem, solver, session)


def _warm_up(problem, solver, state) -> None:
    """Compile what a step and a map need, seconds the first time, so that the first click is answered at once."""
    solver.step(problem, state)
    if problem.search is not None:
        solver.landscape(problem, state, int(problem.free[0]), slice(state.first - 1, state.first))
