"""From a request for a scene to a session that can be shown, on a thread that can be cancelled.

What `fdcal.solvers.warmup` names is compiled on a thread of its own, beside the simulation and then beside the page.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ... import solvers
from ...acoustics.measure import cached_measurement
from ...cost.reference_cost import ReferenceCost, reference_cost_of
from ...model.given_positions import with_search_domain
from ...model.measurement import Measurement
from ...model.problem import Problem
from ...model.scene import Scene
from ...model.scene_file import MeasuredScene
from ...model.settings import ALL_MODES
from ...model.validation import InputError
from ...session.calibration_run import with_estimated_domain
from ...session.session import Session
from ...session.sources import OpenRequest, as_given
from ...session.worker import LatestWorker
from ...solvers.interface import RunState, Solver
from ...solvers.warmup import warmup_calls

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
    def ended(self) -> bool:
        """Whether `close` was called and the thread has ended."""
        return self.stop and self._worker.close(0.0)

    @property
    def text(self) -> str:
        """The progress in words; "" while nothing takes long."""
        if not self.busy or time.perf_counter() - self._since < COMPILE_TIME:
            return ""
        return f"Compiling (first run only) ... {self._done + 1} of {len(self._pieces)}"

    def wait(self, poll: Callable[[], object]) -> None:
        """Wait for all pieces; `poll` is called now and then, and may raise."""
        while self.busy and self._done < len(self._pieces):
            poll()
            time.sleep(POLL_INTERVAL)

    def close(self, timeout: float) -> bool:
        """End the thread after the piece in progress; False if that takes longer than `timeout`, s."""
        self.stop = True
        return self._worker.close(timeout)


class Cancelled(Exception):
    """Raised inside a simulation whose result is no longer wanted."""


@dataclass(frozen=True)
class PreparedRun:
    """What a page shows: a scene, its measurement, and the session that calibrates it."""

    scene: Scene  # Scene; for a measurement from a file one that stands in for its unknown room
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


class PreparationProgress:
    """Progress of the preparation: written by its thread, read by the main one. Setting `stop` cancels it.

    `task`: what is in progress; `done`: 0 to 1, of the task; `measurement`: or None until there is one.
    """

    def __init__(self):
        self.task, self.done, self.stop = "Simulating the room", 0.0, False
        self.warmup: Warmup | None = None
        self.measurement: Measurement | None = None

    def __call__(self, done: float, *_) -> None:
        self.done = float(done)
        if self.stop:
            raise Cancelled

    @property
    def ended(self) -> bool:
        """Whether it was cancelled or closed, and none of its threads still compiles."""
        return self.stop if self.warmup is None else self.warmup.ended

    @property
    def text(self) -> str:
        """The progress in words."""
        if self.done < 1:
            return f"{self.task} ... {round(100 * self.done)} %"
        return (self.warmup.text if self.warmup else "") or "Preparing the solver ..."


def prepare_run(opening: OpenRequest, progress: PreparationProgress) -> PreparedRun:
    """Simulate or take the measurement, pose the problem and start a session.

    `opening`: what is to be shown; `progress`: kept up to date; its `stop` cancels the preparation. Raises InputError:
    the scene, the measurement or the states cannot be used; Cancelled: `progress.stop` has been set.
    """
    warmup = progress.warmup = Warmup(opening.scene)
    try:
        return _prepare(opening, progress, warmup)
    except BaseException:
        warmup.close(0.0)
        raise


def _prepare(opening: OpenRequest, progress: PreparationProgress, warmup: Warmup) -> PreparedRun:
    scene, source = opening.scene, opening.measurement
    if source is None:
        source = cached_measurement(scene, progress)
    progress.measurement = measurement = as_given(scene, source)
    progress(1.0)
    warmup.wait(lambda: progress(1.0))
    if source.search is None:
        source = _with_domain(opening, source, progress)
        progress.measurement = measurement = as_given(scene, source)
        opening = replace(opening, measurement=source)
    problem = source.problem(scene.solver.weights, scene.solver.known)
    if opening.fewer_modes:
        scene = _with_available_modes(scene, problem)
    solver, settings = solvers.load(scene.solver.name), solvers.with_mode_count(problem, scene.solver)
    reference_cost = reference_cost_of(problem)
    cost = None if reference_cost is None else reference_cost.of
    session = Session(problem, settings, opening.seed, solver, opening.states, opening.index, cost)
    try:
        _compile_step_and_map(problem, solver, session.view.history[0])
    except BaseException as error:
        session.close(0.5)
        if opening.states and isinstance(error, Exception) and not isinstance(error, InputError):
            raise InputError(f"the solver cannot continue from the given states: {error!r}", key="states") from error
        raise
    if opening.play:
        session.play()
    return PreparedRun(scene, measurement, problem, solver, session, opening, reference_cost, warmup)


def _with_domain(opening: OpenRequest, source: Measurement, progress: PreparationProgress) -> Measurement:
    """Return the measurement with a search domain round the last state, or round an estimate made for it."""
    if opening.states:
        blind = as_given(opening.scene, source).blind
        return with_search_domain(source, opening.states[-1].positions, blind)
    progress.task = "Estimating the positions, for a search domain"
    found = with_estimated_domain(source, opening.scene.solver, opening.seed, progress)
    progress(1.0)
    return found


def _with_available_modes(scene: Scene, problem: Problem) -> Scene:
    """Limit the modes of the scene to those that its solver can use."""
    settings = scene.solver
    count = solvers.load(settings.name).usable_modes(problem, settings)
    if settings.modes == ALL_MODES or not 0 < count < settings.modes:
        return scene
    return replace(scene, solver=replace(settings, modes=count, first_modes=min(settings.first_modes, count)))


def _compile_step_and_map(problem: Problem, solver: Solver, state: RunState) -> None:
    """Compile what a step and a map need, seconds the first time, so that the first click is answered at once."""
    solver.step(problem, state)
    if problem.search is not None:
        solver.landscape(problem, state, int(problem.free[0]), slice(state.first - 1, state.first))
