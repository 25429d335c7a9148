"""A search domain for a measurement that has none, from positions that a solver without one estimates."""

from __future__ import annotations

import time
from dataclasses import replace

from .. import solvers
from ..model.given_positions import with_search_domain
from ..model.measurement import Measurement
from ..model.settings import SolverSettings, search_round
from ..model.validation import InputError
from .blas_threads import one_blas_thread
from .calibrate import last_state, problem_of
from .sources import CalibrationInput, Progress

SOLVER = "robust"  # estimates the positions where the solver of the run needs a search domain itself
SECONDS = 20.0  # of processor time for the estimate


def with_estimated_domain(
    measurement: Measurement, settings: SolverSettings, seed: int, progress: Progress | None = None
) -> Measurement:
    """Return a measurement with a search domain: its own, or one round an estimate of the positions.

    `settings`: of the run. Its solver estimates the positions, so that they are in its axes; solver robust does so for
    one that needs a search domain. A known room is the domain itself; `progress`: as of
    `fdcal.session.calibrate.states_of`. Returns as it is where the positions cannot be estimated.
    """
    if measurement.search is not None:
        return measurement
    if settings.room is not None and len(settings.room) == measurement.array_dimension:
        corners = [(0.0,) * len(settings.room), settings.room]
        return replace(measurement, search=search_round(corners))
    needs_search = solvers.load(settings.name).TRAITS.needs_search
    chosen = replace(settings, name=SOLVER if needs_search else settings.name, start=None)
    inputs = CalibrationInput(measurement=measurement, name="", scene=None, settings=chosen, seed=seed)
    try:
        problem = problem_of(inputs)
        inputs = replace(inputs, settings=solvers.with_mode_count(problem, chosen), time_limit=SECONDS)
        with one_blas_thread():
            state = last_state(inputs, progress, problem, time.process_time)[0]
    except InputError:
        return measurement
    return with_search_domain(measurement, state.best_positions)
