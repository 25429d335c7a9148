"""The bound of the array of a scene, computed on a thread of its own while its microphones are dragged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...assessment.bound import position_bound
from ...assessment.uncertainty import confidence_factor, ellipse_axes
from ...model.scene import Scene
from ...session.blas_threads import one_blas_thread
from ...session.planning.bounds import request_information, takes_cases
from ...session.planning.layout import Layout
from ...session.planning.plan import degeneracies
from ...session.planning.report import bound_lines, takes_lines
from ...session.planning.request import PlanRequest
from ...session.worker import LatestWorker
from ..gui.html import error_message
from ..gui.plan_choices import PlanChoices
from .prepare import PreparedRun

DETERMINED = "pressures and given positions determine all directions"


@dataclass(frozen=True)
class PlannedArray:
    """What is to be expected of an array before anything is measured."""

    choices: PlanChoices  # for which it was computed
    # (N, D, D) float64, metres, half axes of the 95 % ellipses in rows, the longest last; empty after an error
    axes: np.ndarray
    lines: tuple[str, ...] = ()  # the summary in words
    most: int = 0  # number of frequencies that the array can use
    error: str = ""  # why there is no bound, "" if there is


def can_plan(run: PreparedRun) -> bool:
    """Return whether a run has an array that can be planned: that of a scene, not of a recording."""
    return run.known_scene is not None and run.measurement.positions is not None


def plan_request(run: PreparedRun, choices: PlanChoices) -> PlanRequest:
    """Return what the tab asks for.

    Raises InputError: no calibration is possible under these circumstances.
    """
    measurement = run.measurement
    layout = Layout(run.scene.name, measurement.names, choices.placed(measurement.positions), run.known_scene)
    return PlanRequest(
        layout,
        room=_room(run.scene),
        snr_db=choices.snr_db,
        known=choices.known,
        gain_sigma_db=choices.gain_sigma_db,
        sound_speed=measurement.sound_speed,
        modes=choices.frequencies,
        takes=choices.takes,
    )


def _room(scene: Scene) -> tuple[float, ...] | None:
    """Return the lengths of the room, metres; of one in the plane that is no rectangle those of the box round it."""
    if scene.room.size is not None:
        return tuple(scene.room.size)
    return tuple(np.ptp(scene.room.vertices, axis=0).tolist()) if scene.room.dimension == 2 else None


def planned_array(run: PreparedRun, choices: PlanChoices) -> PlannedArray:
    """Return the bound of the array, or in one line why there is none."""
    try:
        request = plan_request(run, choices)
        with one_blas_thread():
            bound = position_bound(request_information(request), request.prior)
            takes = takes_lines(takes_cases(request), request.takes)
    except ValueError as error:  # an InputError, too
        return PlannedArray(choices, np.zeros((0, 2, 2)), error=error_message(error))
    covariance = np.where(bound.free[:, None, None], bound.covariance, 0.0)
    axes = ellipse_axes(covariance, confidence_factor(0.95, covariance.shape[-1]))
    lines = (*bound_lines(request, bound), *takes, *(degeneracies(request, bound) or (DETERMINED,)))
    return PlannedArray(choices, axes, lines, request.most_modes)


class PlanWorker:
    """Requests the bound of what the tab Plan shows, and returns the newest one."""

    def __init__(self, run: PreparedRun):
        self._possible, self._requested = can_plan(run), PlanChoices()
        self._worker = LatestWorker(lambda choices: planned_array(run, choices), "fdcal-plan")

    def of(self, choices: PlanChoices) -> PlannedArray | None:
        """Return the newest bound, which may be of choices a moment ago; None while there is none or none is wanted."""
        if not choices.shown or not self._possible:
            return None
        if choices != self._requested:
            self._requested = choices
            self._worker.request(choices)
        latest = self._worker.latest
        return None if latest is None else latest.result

    def close(self, timeout: float) -> bool:
        """End the thread after the work in progress; False if that takes longer than `timeout`, s."""
        return self._worker.close(timeout)
