"""From an opening to a session, on a thread that can be stopped."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import ModuleType

from ... import solvers
from ...acoustics.measurement_cache import cached_measurement
from ...cost.eq7 import usable_modes
from ...model.measured_scene import MeasuredScene
from ...model.measurement import Measurement, Problem
from ...model.scene import Scene
from ...model.validation import InputError
from ...session.request import OpenRequest, as_given
from ...session.session import Session
from .warmup import Rehearsal


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
    opening: OpenRequest
    rehearsal: Rehearsal | None = None  # what is still being compiled beside the page

    @property
    def told(self) -> Scene | None:
        """The scene, or None where it only stands in for a room that nobody has told."""
        return None if isinstance(self.scene, MeasuredScene) else self.scene


class Progress:
    """How far the simulation is; told by its thread, read by the main one. `stop` ends it."""

    def __init__(self):
        self.done, self.stop = 0.0, False
        self.rehearsal: Rehearsal | None = None
        self.measurement: Measurement | None = None  # as soon as there is one

    def __call__(self, done: float, *_) -> None:
        self.done = float(done)
        if self.stop:
            raise Stopped

    @property
    def text(self) -> str:
        if self.done < 1:
            return f"Simulating the room ... {round(100 * self.done)} %"
        return (self.rehearsal.text if self.rehearsal else "") or "Preparing the solver ..."


def work_of(opening: OpenRequest, progress: Progress) -> Work:
    """Measurement, problem and session of an opening. Raises what their making raises, and Stopped."""
    rehearsal = progress.rehearsal = Rehearsal(opening.scene)
    try:
        return _work_of(opening, progress, rehearsal)
    except BaseException:
        rehearsal.stop = True
        raise


def _work_of(opening: OpenRequest, progress: Progress, rehearsal: Rehearsal) -> Work:
    scene, measurement = opening.scene, opening.measurement
    if measurement is None:
        measurement = cached_measurement(scene, progress)
    progress.measurement = as_given(scene, measurement)
    progress(1.0)
    rehearsal.wait_for_first(lambda: progress(1.0))
    problem = measurement.problem(scene.solver.weights, scene.solver.known)
    measurement = progress.measurement
    if opening.fewer_modes:
        scene = _with_modes_there_are(scene, problem)
    solver = solvers.load(scene.solver.name)
    session = Session(problem, scene.solver, opening.seed, solver, opening.states, opening.index)
    try:
        _warm_up(problem, solver, session.view.history[0])
    except BaseException as error:
        session.close(0.5)
        if opening.states and isinstance(error, Exception) and not isinstance(error, InputError):
            raise InputError(f"the solver cannot go on from the states given: {error!r}") from error
        raise
    if opening.play:
        session.play()
    return Work(scene, measurement, problem, solver, session, opening, rehearsal)


def _with_modes_there_are(scene: Scene, problem: Problem) -> Scene:
    """The scene with no more modes asked for than were measured and, by descent, can be carried."""
    own, count = scene.solver, len(problem.frequencies)
    if own.name.startswith("descent"):
        count = usable_modes(problem, own.order_offset)
    if not 0 < count < own.modes:
        return scene
    return replace(scene, solver=replace(own, modes=count, first_modes=min(own.first_modes, count)))


def _warm_up(problem, solver, state) -> None:
    """Compile what a step and a map need, seconds the first time, so that the first click is answered at once."""
    solver.step(problem, state)
    if problem.search is not None:
        solver.landscape(problem, state, int(problem.free[0]), slice(state.first - 1, state.first))
