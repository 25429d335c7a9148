"""From a request for a scene to a session that can be shown, on a thread that can be cancelled.

Warmup            compiles the functions of `fdcal.solvers.warmup_calls` during the simulation and afterwards
Preparation       simulates or reads the measurement, and starts a session
DisplayFrame      the frame in which the page draws the states of a session
SessionSwitcher   receives requests from any thread; the main loop executes them and gets the sessions
"""

import collections
import logging
import time
from collections.abc import Mapping
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
from ..session.worker import LatestWorker
from ..solvers import warmup_calls
from ..solvers.interface import RunState, Solver
from .scheduler import Memo

POLL_INTERVAL = 0.05  # s between two checks of the compilation
COMPILE_TIME = 1.0  # s; a function that takes longer is being compiled, a faster one is read from the disk


class Warmup:
    """Compiles the functions that the solver of a scene needs, on a thread that starts at once.

    `close` ends it after the function in progress.
    """

    def __init__(self, scene: Scene):
        self._pieces, self._done = warmup_calls(scene.solver.name), 0
        self._since, self.stop = time.perf_counter(), False
        self._worker = LatestWorker(self._compile, "fdcal-warmup")
        self._worker.request()

    def _compile(self) -> None:
        for _, compile_piece in self._pieces:
            if self.stop:
                return
            self._since = time.perf_counter()
            compile_piece()
            self._done += 1

    @property
    def busy(self) -> bool:
        """Whether a function is still to be compiled; False after a failure, which the solver will report."""
        return self._worker.busy

    @property
    def text(self) -> str:
        """The progress in words; "" unless a compilation takes long."""
        if not self.busy or time.perf_counter() - self._since < COMPILE_TIME:
            return ""
        return f"Compiling (first run only) ... {self._done + 1} of {len(self._pieces)}"

    def close(self, timeout: float) -> bool:
        """End the thread after the function in progress; False if that takes longer than `timeout`, s."""
        self.stop = True
        return self._worker.close(timeout)


class Cancelled(Exception):
    """Raised inside a simulation whose result is no longer wanted."""


@dataclass(frozen=True)
class PreparedRun:
    """A scene, its measurement, and the session that calibrates it, for the page."""

    scene: Scene  # a placeholder if the measurement is from a file and its room is unknown
    measurement: Measurement  # for the picture and the errors
    problem: Problem  # for the solver
    solver: Solver
    session: Session  # its states have the settings of `scene` with a number of modes
    opening: OpenRequest  # the request for which the run was prepared
    reference_cost: ReferenceCost | None = None  # None if it cannot be computed
    warmup: Warmup | None = None  # the compilation in progress, or None

    def close(self, timeout: float) -> None:
        """End the threads of a run that is not shown; wait at most `timeout`, s."""
        if self.warmup is not None:
            self.warmup.close(0.0)
        self.session.close(timeout)

    @property
    def sought(self) -> np.ndarray:
        """Numbers of the microphones whose positions are not given; errors are averaged over these."""
        everyone = np.arange(self.measurement.count)
        return everyone if self.solver.TRAITS.needs_room or not len(self.problem.free) else self.problem.free

    @property
    def known_scene(self) -> Scene | None:
        """The scene, or None if it is a placeholder for an unknown room."""
        return None if isinstance(self.scene, MeasuredScene) else self.scene

    def request_of(self, view: SessionView, choices: Mapping[str, Any]) -> OpenRequest:
        """Return the request that opens the run again, with all its states and their settings and seed."""
        scene, seed = replace(self.scene, solver=view.state.settings), view.state.seed
        return OpenRequest(scene, seed, self.measurement, view.history, view.index, choices)

    @property
    def anchor(self) -> Reals | None:
        """The true positions (N, D), metres, onto which the page moves each state; None if states are not moved."""
        moves = self.measurement.blind and not self.solver.TRAITS.needs_room  # a known room determines the frame
        return self.measurement.positions if moves else None

    def drawn_truth(self, positions: Any) -> Reals | None:
        """Return the true positions as the page draws them beside `positions`; None if they are unknown."""
        return self.measurement.aligned_truth(positions) if self.anchor is None else self.anchor


ROUNDS = 100  # at most, until a placed microphone is drawn where it was placed
NEGLIGIBLE = 1e-12  # m


class DisplayFrame:
    """Moves positions (N, D), metres, into the frame in which the page draws, and back.

    This is the frame of the true positions, which therefore do not move during a run. The pressures determine a blind
    array only up to a rigid motion and a mirror image. Each of its states is moved as a whole onto the true positions
    before it is drawn, and a position that a user gives is moved back for the session. Other arrays are not moved.

    `by` are the microphones that determine the motion: all at first, later those whose errors are averaged.
    """

    def __init__(self, run: PreparedRun):
        self._anchor = run.anchor
        self.by = np.arange(run.measurement.count)
        self._moved = Memo()

    def positions(self, positions: Any) -> Reals:
        """Return positions as the page draws them."""
        x = np.asarray(positions, float)
        return x if self._anchor is None else align(x, self._anchor, self.by)

    def state(self, state: RunState) -> RunState:
        """Return a state with its positions as the page draws them; the last result is reused for the same state."""
        if self._anchor is None:
            return state
        return self._moved(
            lambda: replace(state, positions=frozen_array(self.positions(state.positions), float)), state, self.by
        )

    def view(self, view: SessionView) -> SessionView:
        """Return a view whose present state has the positions that the page draws; its history is not changed."""
        return replace(view, state=self.state(view.state))

    def axes(self, positions: Any, axes: Reals) -> Reals:
        """Return half axes (N, D, D) of ellipses around positions, in rows, as the page draws them."""
        if self._anchor is None:
            return axes
        return axes @ rigid_motion(np.asarray(positions)[self.by], self._anchor[self.by])[0]

    def placed(self, positions: Any, microphone: int, place: Any) -> np.ndarray:
        """Return the position in the session of a microphone that the page is to draw at `place`.

        `positions` are those of the session's state; `place` has the first coordinates or all of them. The array turns
        a little if a microphone moves, so that the position is found by iteration.
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


class Preparation:
    """The preparation of a run for a request; its thread writes the attributes, and the main loop reads them.

    Setting `stop` cancels it. `task` is in progress, and `progress`, 0 to 1, is that of the task; `measurement` is None
    at first; at the end `done` is set, and `run` or `error`.
    """

    def __init__(self, request: OpenRequest):
        read = request.measurement is not None or isinstance(request.scene, MeasuredScene)
        self.request, self.task, self.progress = request, READING if read else SIMULATING, 0.0
        self.stop = self.done = False
        self._since = time.perf_counter()
        self.warmup: Warmup | None = None
        self.measurement: Measurement | None = None
        self.run: PreparedRun | None = None
        self.error: Exception | None = None

    def __call__(self, progress: float, *_) -> None:
        """Set the progress; raise Cancelled if the run is no longer wanted."""
        self.progress = float(progress)
        if self.stop:
            raise Cancelled

    @property
    def compiling(self) -> bool:
        """Whether its compilation is in progress."""
        return self.warmup is not None and self.warmup.busy

    @property
    def text(self) -> str:
        """The progress in words."""
        if self.progress < 1:
            if self.progress:
                return f"{self.task} ... {round(100 * self.progress)} %"
            slow = self.task == SIMULATING and time.perf_counter() - self._since > COMPILE_TIME
            return "Preparing the simulation ..." if slow else f"{self.task} ..."
        return (self.warmup.text if self.warmup else "") or "Preparing the solver ..."

    def execute(self) -> None:
        """Prepare the run, on the thread; `error` is an InputError if scene, measurement or states cannot be used."""
        try:
            self(0.0)
            self.warmup = Warmup(self.request.scene)
            self.run = _prepare(self.request, self, self.warmup)
        except Exception as error:
            self.error = None if isinstance(error, Cancelled) else error
        if self.run is None and self.warmup is not None:
            self.warmup.close(0.0)
        self.done = True


def _prepare(opening: OpenRequest, progress: Preparation, warmup: Warmup) -> PreparedRun:
    scene, source = opening.scene, opening.measurement
    if source is None:
        source = cached_measurement(scene, progress)
    progress.measurement = measurement = as_given(scene, source)
    progress(1.0)
    while warmup.busy:
        progress(1.0)
        time.sleep(POLL_INTERVAL)
    if source.search is None:
        if opening.states:  # a search domain around the last state, or around an estimate made for it
            truth = source.positions if measurement.blind else None
            source = replace(source, search=search_around(opening.states[-1].positions, truth=truth))
        else:
            progress.task = "Estimating the positions, for a search domain"
            source = with_estimated_domain(source, scene.solver, opening.seed, progress)
            progress(1.0)
        progress.measurement = measurement = as_given(scene, source)
        opening = replace(opening, measurement=source)
    problem = source.problem(scene.solver.weights, scene.solver.known)
    if opening.fewer_modes:
        count = solvers.load(scene.solver.name).usable_modes(problem, scene.solver)
        if scene.solver.modes != ALL_MODES and 0 < count < scene.solver.modes:
            first = min(scene.solver.first_modes, count)
            scene = replace(scene, solver=replace(scene.solver, modes=count, first_modes=first))
    solver, settings = solvers.load(scene.solver.name), solvers.with_mode_count(problem, scene.solver)
    reference_cost = reference_cost_of(problem)
    cost = None if reference_cost is None else reference_cost.of
    session = Session(problem, settings, opening.seed, solver, opening.states, opening.index, cost)
    try:
        # Compile what a step and a map need, seconds the first time, so that the first click is answered at once.
        state = session.view.history[0]
        solver.step(problem, state)
        if problem.search is not None:
            solver.landscape(problem, state, int(problem.free[0]), slice(state.first - 1, state.first))
    except BaseException as error:
        session.close(0.5)
        if opening.states and isinstance(error, Exception) and not isinstance(error, InputError):
            raise InputError(f"the solver cannot continue from the given states: {error!r}", key="states") from error
        raise
    if opening.play:
        session.play()
    search, truth = measurement.search, measurement.positions
    if search is not None and truth is not None and measurement.blind and not solver.TRAITS.needs_room:
        search = search_around(session.view.history[0].positions, search, truth)
    if search is not measurement.search:  # only the maps need it; a blind array is solved without a domain
        measurement, problem = replace(measurement, search=search), replace(problem, search=search)
    return PreparedRun(scene, measurement, problem, solver, session, opening, reference_cost, warmup)


log = logging.getLogger(__name__)

COMPILE_TIMEOUT = 60.0  # s; the longest compilation takes 8 s of processor time


class SessionSwitcher:
    """Prepares the newest request on a thread of its own.

    `current` is the preparation in progress, or None; `error` the exception of the last request, or None.
    """

    def __init__(self):
        self._commands: collections.deque[OpenRequest | None] = collections.deque()  # None: cancel
        self._worker = LatestWorker(Preparation.execute, "fdcal-prepare")
        self.current: Preparation | None = None
        self._begun: list[Preparation] = []  # those that may still be in progress, or compile
        self.error: Exception | None = None

    def open(self, request: OpenRequest) -> None:
        """Prepare a request, and cancel the one in progress. Any thread."""
        self._commands.append(request)

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
        """Whether a compilation is in progress, for the session that is shown or for one that was cancelled."""
        return any(one.compiling for one in self._begun)

    def poll(self) -> PreparedRun | None:
        """Execute the commands that wait; return the run that is ready, once, or None."""
        while self._commands:
            self._begin(self._commands.popleft())
        self._close_cancelled()
        finished = self.current
        if finished is None or not finished.done:
            return None
        self.current = None
        if finished.error is not None:
            self.refuse(finished.error)
        return finished.run

    def refuse(self, error: Exception) -> None:
        """Refuse the last request; log an exception that is not the user's."""
        if not isinstance(error, (InputError, StorageError)):
            log.error("a request could not be opened", exc_info=error)
        self.error = error

    def close(self, timeout: float = 1.0, compile_timeout: float = COMPILE_TIMEOUT) -> None:
        """End the threads and close the sessions that are not shown.

        Wait at most `timeout` for the preparation and `compile_timeout` for compilations, s, which cannot be
        interrupted. A preparation that continues does no harm, since files of the cache are moved to their place when
        they are complete. A compilation that continues may crash the interpreter at its exit.
        """
        self._begin(None)
        self._worker.close(timeout)
        end = time.perf_counter() + compile_timeout
        for one in self._begun:
            if one.warmup is not None:
                one.warmup.close(max(end - time.perf_counter(), 0.0))
        self._close_cancelled()

    def _begin(self, request: OpenRequest | None) -> None:
        if self.current is not None:
            self.current.stop = True
        self.current, self.error = None, None
        if request is not None:
            self.current = Preparation(request)
            self._begun.append(self.current)
            self._worker.request(self.current)

    def _close_cancelled(self) -> None:
        """Close sessions that were ready before they were cancelled, and forget preparations that have ended."""
        for one in self._begun:
            if one.done and one.stop and one.run is not None:
                one.run.close(0.0)
            if one.done and one.warmup is not None and not one.compiling:
                one.warmup.close(0.0)
        self._begun = [one for one in self._begun if not one.done or one.compiling]
