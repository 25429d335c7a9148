"""The preparation of a session that a request asks for, on a thread whose work can be cancelled.

PreparedRun       a scene, its measurement and its session
DisplayFrame      the frame in which the page draws the states of a session
Preparation       simulates or reads the measurement, compiles what the solver needs, and starts a session
SessionSwitcher   receives requests from any thread; the main loop executes them and gets the sessions
"""

import collections
import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .. import solvers
from ..acoustics.measure import cached_measurement
from ..cost.eq7 import ReferenceCost, reference_cost_of
from ..model.gauge import align, rigid_motion
from ..model.measurement import Measurement
from ..model.problem import Problem
from ..model.scene import MeasuredScene, Scene
from ..model.settings import ALL_MODES, search_around
from ..model.validation import InputError, Reals, StorageError, frozen_array
from ..session.calibration_run import with_estimated_domain
from ..session.session import Session, SessionView
from ..session.sources import OpenRequest, as_given
from ..session.worker import LatestWorker, Memo
from ..solvers.interface import Solver

COMPILE_TIME = 1.0  # s; a longer call compiles a function, and a shorter one reads it from the disk


class Cancelled(Exception):
    """Raised inside a simulation whose result is no longer wanted."""


@dataclass(frozen=True)
class PreparedRun:
    """A scene, its measurement, and the session that calibrates it, for the page."""

    scene: Scene  # a placeholder if the measurement is from a file and its room is unknown
    measurement: Measurement  # for the picture and the errors
    problem: Problem  # for the solver
    solver: Solver
    session: Session  # the settings in its states are those of `scene`, with the number of modes
    opening: OpenRequest  # the request for which the run was prepared
    reference_cost: ReferenceCost | None = None  # None if it cannot be computed

    @property
    def sought(self) -> np.ndarray:
        """Numbers of the microphones whose positions are not given; errors are averaged over these."""
        return self.problem.free if len(self.problem.free) else np.arange(self.measurement.count)

    @property
    def known_scene(self) -> Scene | None:
        """The scene, or None if it is a placeholder for an unknown room."""
        return None if isinstance(self.scene, MeasuredScene) else self.scene

    def request_of(self, view: SessionView, choices: Mapping[str, Any]) -> OpenRequest:
        """Return the request that opens the run again, with all its states and their settings and seed."""
        scene, seed = replace(self.scene, solver=view.state.settings), view.state.seed
        return OpenRequest(scene, seed, self.measurement, view.history, view.index, choices)


ROUNDS = 100  # largest number of iterations until a placed microphone is drawn where it was placed
NEGLIGIBLE = 1e-12  # change of the position that ends the iterations, m


class DisplayFrame:
    """Moves positions (N, D), metres, into the frame in which the page draws, and back.

    The page draws in the frame of the true positions, which therefore do not move during a run. The pressures determine
    a blind array, one without known microphones, only up to a rigid motion and a mirror image. Each of its states is
    moved as a whole onto the true positions before it is drawn, and a position that a user gives is moved back for the
    session. Other arrays are not moved.

    `by` are the numbers of the microphones that determine the motion: all at first, later those whose errors are
    averaged.
    """

    def __init__(self, run: PreparedRun):
        # the true positions (N, D), metres, onto which each state is moved; None if states are not moved
        self._anchor = run.measurement.positions if run.measurement.blind else None
        self.by = np.arange(run.measurement.count)
        self._moved = Memo()

    def positions(self, positions: Any) -> Reals:
        """Return positions as the page draws them."""
        x = np.asarray(positions, float)
        return x if self._anchor is None else align(x, self._anchor, self.by)

    def view(self, view: SessionView) -> SessionView:
        """Return a view whose present state has the positions that the page draws; its history is not changed."""
        if self._anchor is None:
            return view
        if (state := self._moved.get(view.state, self.by)) is None:
            state = replace(view.state, positions=frozen_array(self.positions(view.state.positions), float))
            self._moved.keep(state, view.state, self.by)
        return replace(view, state=state)

    def axes(self, positions: Any, axes: Reals) -> Reals:
        """Return half axes (N, D, D) of ellipses around positions, in rows, as the page draws them."""
        if self._anchor is None:
            return axes
        return axes @ rigid_motion(np.asarray(positions)[self.by], self._anchor[self.by])[0]

    def placed(self, positions: Any, microphone: int, place: Any) -> np.ndarray:
        """Return the position in the session of a microphone that the page is to draw at `place`.

        `positions`: those of the session's state; `place`: the first coordinates or all of them, metres. The position
        is found by iteration, because the motion of the array changes a little if one microphone moves.
        """
        place = np.asarray(place, float)
        if self._anchor is None:
            return place
        moved = np.array(positions, float)
        wanted = self.positions(moved)[microphone]
        wanted[: len(place)] = place
        for _ in range(ROUNDS):
            rotation, centre, target = rigid_motion(moved[self.by], self._anchor[self.by])
            back = (wanted - target) @ rotation.T + centre
            change = float(np.abs(back - moved[microphone]).max())
            moved[microphone] = back
            if change < NEGLIGIBLE:
                break
        return moved[microphone]


SIMULATING, READING = "Simulating the room", "Reading the measurement"
Then = Callable[[Any], object]  # gets the Viewer of a session when it is shown, or None if it will not be shown


class Preparation:
    """The preparation of a run for a request; its thread writes the attributes, and the main loop reads them.

    `task`: the task in progress, in words; `progress`: its progress, 0 to 1; `measurement`: None at first; `compiling`:
    whether a function is being compiled, which nothing can interrupt. At the end `done` is set, and `run` or `error`.
    """

    def __init__(self, request: OpenRequest, then: Then = lambda viewer: None):
        read = request.measurement is not None or isinstance(request.scene, MeasuredScene)
        self.request, self.then, self.task, self.progress = request, then, READING if read else SIMULATING, 0.0
        self.done = self.compiling = self._cancelled = False
        self._since = time.perf_counter()
        self.measurement: Measurement | None = None
        self.run: PreparedRun | None = None
        self.error: Exception | None = None

    def __call__(self, progress: float, *_) -> None:
        """Set the progress; raise Cancelled if the run is no longer wanted."""
        self.progress = float(progress)
        if self._cancelled:
            raise Cancelled

    def cancel(self) -> None:
        """End the preparation as soon as possible, or the session if it is ready."""
        self._cancelled = True
        if self.done and self.run is not None:
            self.run.session.close(0.0)

    @property
    def text(self) -> str:
        """The progress in words."""
        slow = time.perf_counter() - self._since > COMPILE_TIME
        if self.progress == 1:
            return "Compiling (first run only) ..." if self.compiling and slow else "Preparing the solver ..."
        if self.progress:
            return f"{self.task} ... {round(100 * self.progress)} %"
        return "Preparing the simulation ..." if slow and self.task == SIMULATING else f"{self.task} ..."

    def execute(self) -> None:
        """Prepare the run, on the thread; `error` is an InputError if scene, measurement or states cannot be used."""
        try:
            self(0.0)
            self.run = self._prepared()
        except Exception as error:
            self.error = None if isinstance(error, Cancelled) else error
        self.compiling, self.done = False, True
        if self._cancelled:  # the request may have been cancelled after the last check
            self.cancel()

    def _prepared(self) -> PreparedRun:
        opening, scene = self.request, self.request.scene
        source = cached_measurement(scene, self) if opening.measurement is None else opening.measurement
        self.measurement = measurement = as_given(scene, source)
        for _, compile_piece in solvers.warmup_calls(scene.solver.name):
            self(1.0)
            self._since, self.compiling = time.perf_counter(), True
            compile_piece()
            self.compiling = False
        self(1.0)
        if source.search is None:
            if opening.states:  # a search domain around the last state, or around an estimate made for this purpose
                truth = source.positions if measurement.blind else None
                source = replace(source, search=search_around(opening.states[-1].positions, truth=truth))
            else:
                self.task = "Estimating the positions to define a search domain"
                source = with_estimated_domain(source, scene.solver, opening.seed, self)
                self(1.0)
            self.measurement = measurement = as_given(scene, source)
            opening = replace(opening, measurement=source)
        problem = source.problem(scene.solver.weights, scene.solver.known)
        solver = solvers.load(scene.solver.name)
        if opening.fewer_modes and scene.solver.modes != ALL_MODES:
            count = solver.usable_modes(problem, scene.solver)
            if 0 < count < scene.solver.modes:
                first = min(scene.solver.first_modes, count)
                scene = replace(scene, solver=replace(scene.solver, modes=count, first_modes=first))
        settings, reference_cost = solvers.with_mode_count(problem, scene.solver), reference_cost_of(problem)
        cost = None if reference_cost is None else reference_cost.of
        session = Session(problem, settings, opening.seed, solver, opening.states, opening.index, cost)
        try:  # the first map and step load what later ones use, so that the first click is answered at once
            state = session.view.history[0]
            if solver.TRAITS.needs_search or opening.states:  # the step also checks that the solver can continue
                solver.step(problem, state)
            if problem.search is not None:
                solver.landscape(problem, state, int(problem.free[0]), slice(state.first - 1, state.first))
        except BaseException as error:
            session.close(0.5)
            if opening.states and isinstance(error, Exception) and not isinstance(error, InputError):
                fault = f"the solver cannot continue from the given states: {error!r}"
                raise InputError(fault, key="states") from error
            raise
        if opening.play:
            session.play()
        search, truth = measurement.search, measurement.positions
        if search is not None and truth is not None and measurement.blind:
            # Only maps need this domain: the solver needs none for an array without known microphones.
            search = search_around(session.view.history[0].positions, search, truth)
            measurement, problem = replace(measurement, search=search), replace(problem, search=search)
        return PreparedRun(scene, measurement, problem, solver, session, opening, reference_cost)


log = logging.getLogger(__name__)

COMPILE_TIMEOUT = 60.0  # s; the longest compilation takes 8 s of processor time


class SessionSwitcher:
    """Prepares the newest request on its own thread.

    `current` is the preparation in progress, or None; `error` the exception of the last request, or None. `call` runs
    a function on viser's event loop.
    """

    def __init__(self, call: Callable[[Callable[[], object]], object] = lambda function: function()):
        self._commands: collections.deque[Preparation | None] = collections.deque()  # None: cancel
        self._worker, self._call = LatestWorker(Preparation.execute, "fdcal-prepare"), call
        self.current: Preparation | None = None
        self.error: Exception | None = None

    def open(self, request: OpenRequest, then: Then = lambda viewer: None) -> None:
        """Prepare a request, and cancel the one in progress. Any thread.

        `then` is called once: with the viewer of the session, or with None if it is not shown.
        """
        self._commands.append(Preparation(request, then))

    def cancel(self) -> None:
        """Cancel the request in progress, or dismiss the error of the last one. Any thread."""
        self._commands.append(None)

    # Only the main loop calls the methods below.

    @property
    def idle(self) -> bool:
        """Whether no request waits or is in progress."""
        return not self._commands and self.current is None

    @property
    def compiling(self) -> bool:
        """Whether a compilation is in progress, perhaps for a request that was cancelled."""
        running = self._worker.running
        return running is not None and running[0].compiling

    def poll(self) -> Preparation | None:
        """Execute the commands that wait; return the preparation whose run is ready, once, or None."""
        while self._commands:
            self._begin(self._commands.popleft())
        finished = self.current
        if finished is None or not finished.done:
            return None
        self.current = None
        if finished.run is None:
            self.refuse(finished)
        return None if finished.run is None else finished

    def refuse(self, preparation: Preparation, error: Exception | None = None) -> None:
        """Refuse a request because of its own error or `error`; log an exception that the user did not cause."""
        self.error = error or preparation.error
        if self.error is not None and not isinstance(self.error, (InputError, StorageError)):
            log.error("a request could not be opened", exc_info=self.error)
        self._call(lambda: preparation.then(None))

    def close(self, timeout: float = 1.0) -> None:
        """End the thread, and the session that is not shown; wait at most `timeout`, s, longer for a compilation.

        A compilation that continued could crash the interpreter at its exit. A simulation may continue, because files
        of the cache are moved to their place only when they are complete.
        """
        self._begin(None)
        self._worker.close(COMPILE_TIMEOUT if self.compiling else timeout)

    def _begin(self, preparation: Preparation | None) -> None:
        if (before := self.current) is not None:
            before.cancel()
            self._call(lambda: before.then(None))
        self.current, self.error = preparation, None
        if preparation is not None:
            self._worker.request(preparation)
