"""Runs of a solver to their end, with the assessment of the end."""

import hashlib
import json
import pickle
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np

from fdcal import solvers
from fdcal.assessment.assess import Assessment, assess, judged
from fdcal.model.gauge import align
from fdcal.model.measurement import Measurement, load_measurement
from fdcal.model.problem import Problem
from fdcal.model.settings import SolverSettings
from fdcal.session.session_file import read_states, write_states
from fdcal.solvers import starts
from fdcal.solvers.interface import Estimate
from fdcal.solvers.robust.result import estimate_at
from fdcal.viewer import opening


@dataclass(frozen=True)
class Solved:
    """The end of a run: problem, last state, the estimate of the solver, and its assessment."""

    problem: Problem
    state: Any
    estimate: Estimate
    assessment: Assessment

    @property
    def faulty(self) -> list[tuple[int, str]]:
        """Number and kind of every faulty channel."""
        names = [str(n) for n in range(len(self.state.positions))]
        return [(n, one.kind) for n, one in judged(self.estimate, names).faulty.items()]


ENDS: dict[bytes, Solved] = {}  # the results of this process: many tests start from the same run


def solved(measurement, solver: str = "robust", **settings) -> Solved:
    """Solve `measurement`, by default with all of its modes; a repeated call returns the earlier result."""
    chosen = SolverSettings(**{"name": solver, "modes": len(measurement.frequencies), **settings})
    key = hashlib.sha256(pickle.dumps((measurement, chosen, starts.RANDOM_STARTS))).digest()
    if key not in ENDS:
        problem = measurement.problem("unit", chosen.known)
        *_, state = solvers.run(problem, chosen, 0)
        estimate = solvers.load(chosen.name).result(problem, state)
        ENDS[key] = Solved(problem, state, estimate, assess(estimate))
    return ENDS[key]


def estimated_at(measurement, positions=None, modes: int | None = None, **settings) -> Estimate:
    """Return the estimate of a solver at `positions`, by default the true ones."""
    positions = measurement.positions if positions is None else positions
    chosen, used = SolverSettings(name="descent", **settings), slice(0, modes or len(measurement.frequencies))
    return estimate_at(measurement.problem("unit", "all"), chosen, positions, used, True)


def simulated_square() -> Measurement:
    """49 microphones of a simulated room, no noise: the measurement that comes with fdcal, with three corners given."""
    shipped, corners = load_measurement(opening.MEASUREMENT), np.array([0, 6, 42])
    return replace(shipped, known=corners, known_positions=shipped.positions[corners])


def run_from(solver, problem, state) -> list:
    """The states of `solver` from `state` to the end, `state` first."""
    states = [state]
    while not states[-1].finished:
        states.append(solver.step(problem, states[-1]))
    return states


def same(one, other, but=()) -> bool:
    """Whether two states, or parts of them, agree to the last bit, and in type."""
    if type(one) is not type(other):
        return isinstance(one, (int, float)) and not isinstance(one, bool) and float(one) == float(other)
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if is_dataclass(one):
        names = [field.name for field in fields(one) if field.name not in but]
        return all(same(getattr(one, name), getattr(other, name)) for name in names)
    return one == other


def saved_and_read(problem, state):
    """Return a state after it was saved in a session file and read again."""
    table, arrays = write_states([state])
    (read,) = read_states(json.loads(json.dumps(table)), arrays, problem, state.settings.name, 1)
    return read


def rms(found, truth, chosen=slice(None)) -> float:
    """Root mean square distance, metres, of the positions `chosen`."""
    return float(np.sqrt(np.mean(np.sum((found - truth)[chosen] ** 2, axis=1))))


def rms_of_shape(found, truth) -> float:
    """Return the root mean square distance after the best rigid motion of the whole array."""
    return rms(align(found, truth), truth)
