"""From a request for a scene to a session that can be shown, on a thread that can be cancelled.

Warmup            compiles what `fdcal.solvers.warmup_calls` returns, beside the simulation and then beside the page
Preparation       simulates or takes the measurement, and starts a session
DisplayFrame      in which the page draws the states of a session
SessionSwitcher   takes requests from any thread; the main loop executes them and takes what is ready
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

POLL_INTERVAL = 0.05  # s between two looks at the progress
COMPILE_TIME = 1.0  # s; a piece that takes longer is compiled, a faster one is read from the disk


class Warmup:
    """Starts at once; `close` ends it after the piece in progress.

    `scene`: whose solver decides what is compiled. `stop`: whether no other piece is begun.
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
        """Whether something is still to be compiled; False after a failure, which the solver will report."""
        return self._worker.busy

    @property
    def text(self) -> str:
        """The progress in words; "" unless a compilation takes long."""
        if not self.busy or time.perf_counter() - self._since < COMPILE_TIME:
            return ""
        return f"Compiling (first run only) ... {self._done + 1} of {len(self._pieces)}"

    def close(self, timeout: float) -> bool:
        """End the thread after the piece in progress; False if that takes longer than `timeout`, s."""
        self.stop = True
        return self._worker.close(timeout)


class Cancelled(Exception):
    """Raised inside a simulation whose result is no longer wanted."""


@dataclass(frozen=True)
class PreparedRun:
    """What a page shows: a scene, its measurement, and the session that calibrates it."""

    scene: Scene  # a placeholder where a measurement comes from a file and its room is unknown
    measurement: Measurement  # as it is drawn and scored
    problem: Problem  # as the solver receives it
    solver: Solver
    session: Session  # whose states have the settings of `scene` with a number of modes
    opening: OpenRequest  # the request that the run was prepared for
    reference_cost: ReferenceCost | None = None  # the cost of any positions, or None where there is none
    warmup: Warmup | None = None  # what is still being compiled beside the page, or None

    def close(self, timeout: float) -> None:
        """End the threads of a run that is not shown; wait `timeout` at most, s."""
        if self.warmup is not None:
            self.warmup.close(0.0)
        self.session.close(timeout)

    @property
    def sought(self) -> np.ndarray:
        """Numbers of the microphones over which errors are averaged: those whose positions are not given."""
        everyone = np.arange(self.measurement.count)
        return everyone if self.solver.TRAITS.needs_room or not len(self.problem.free) else self.problem.free

    @property
    def known_scene(self) -> Scene | None:
        """The scene, or None where it only stands in for an unknown room."""
        return None if isinstance(self.scene, MeasuredScene) else self.scene

    def request_of(self, view: SessionView, choices: Mapping[str, Any]) -> OpenRequest:
        """Return the request that opens the run again, with all its states.

        Settings and seed are those of the states, which a reset may have changed.
        """
        scene, seed = replace(self.scene, solver=view.state.settings), view.state.seed
        return OpenRequest(scene, seed, self.measurement, view.history, view.index, choices)

    @property
    def anchor(self) -> Reals | None:
        """The true positions onto which the page moves each state (N, D), metres; None where it moves none."""
        moves = self.measurement.blind and not self.solver.TRAITS.needs_room  # a known room determines the frame
        return self.measurement.positions if moves else None

    def drawn_truth(self, positions: Any) -> Reals | None:
        """Return the true positions beside the `positions` that the page draws; None where they are unknown."""
        return self.measurement.aligned_truth(positions) if self.anchor is None else self.anchor


ROUNDS = 100  # at most, until a placed microphone is drawn where it was placed
NEGLIGIBLE = 1e-12  # m


class DisplayFrame:
    """Moves positions (N, D), metres, into the frame in which the page draws, and back.

    That is the frame of the true positions, which therefore stand still during a run. The pressures of a blind array
    determine neither where it stands nor how it is turned nor which of two mirror images it is. Each state is therefore
    moved as a whole onto the true positions before it is drawn, and what a user places is moved back before the session
    gets it. Of every other array nothing is moved.

    `by`: the microphones that determine the motion, all at first; later those whose errors count.
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
        """Return a state with its positions as the page draws them; the same one for the same as last time."""
        if self._anchor is None:
            return state
        return self._moved(
            lambda: replace(state, positions=frozen_array(self.positions(state.positions), float)), state, self.by
        )

    def view(self, view: SessionView) -> SessionView:
        """Return the view of a session with the state that is shown as the page draws it; the history is as it was."""
        return replace(view, state=self.state(view.state))

    def axes(self, positions: Any, axes: Reals) -> Reals:
        """Return half axes (N, D, D) of ellipses around positions, in rows, as the page draws them."""
        if self._anchor is None:
            return axes
        return axes @ rigid_motion(np.asarray(positions)[self.by], self._anchor[self.by])[0]

    def placed(self, positions: Any, microphone: int, place: Any) -> np.ndarray:
        """Return where a session has to place a microphone so that the page draws it at a place, its last state known.

        `positions`: of the state of the session; `place`: its first coordinates or all of them. The array turns a
        little with each microphone, so that the place is found by repetition.
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
    """One request on its way to a run: written by its thread, read by the main loop. Setting `stop` cancels it.

    `task`: what is in progress; `progress`: 0 to 1, of the task; `measurement`: or None until there is one; `run` or
    `error`: set at the end, when it is `done`.
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
        """Note the progress; raise Cancelled once it is no longer wanted."""
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
        """Prepare the run; called on the thread. `error`: InputError where the scene, the measurement or the states
        cannot be used."""
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

    `current`: what is prepared now, or None; `error`: exception for which the last request was refused, or None.
    """

    def __init__(self):
        self._commands: collections.deque[OpenRequest | None] = collections.deque()  # None: cancel
        self._worker = LatestWorker(Preparation.execute, "fdcal-prepare")
        self.current: Preparation | None = None
        self._begun: list[Preparation] = []  # some of which may still be in progress, or compile
        self.error: Exception | None = None

    def open(self, request: OpenRequest) -> None:
        """Prepare a request, and cancel the one in progress. Any thread."""
        self._commands.append(request)

    def cancel(self) -> None:
        """Cancel the request in progress, or dismiss the error of the last one. Any thread."""
        self._commands.append(None)

    # Below: the main loop alone.

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
        """End the threads and close the sessions that were not taken.

        The thread of a preparation may be writing to the cache. A file is moved into its place when it is complete, so
        a thread that is left behind does no harm. A compiler that is left behind can end the interpreter with an error.

        `timeout`: how long to wait for the preparation, s; `compile_timeout`: how long to wait for compilations, which
        cannot be interrupted, s.
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
        """Close the sessions that were cancelled too late, and forget those that compile no longer."""
        for one in self._begun:
            if one.done and one.stop and one.run is not None:
                one.run.close(0.0)
            if one.done and one.warmup is not None and not one.compiling:
                one.warmup.close(0.0)
        self._begun = [one for one in self._begun if not one.done or one.compiling]
