"""The verdict on the end of a run, computed on a thread of its own: what `fdcal calibrate` prints.

Only for a solver that has finished; an earlier state is not at a minimum.
"""

from dataclasses import dataclass

import numpy as np

from ...assessment.calibration import Channels
from ...assessment.uncertainty import confidence_factor, ellipse_axes
from ...session.calibration_run import Assessment, assess_state, healthy_microphones
from ...session.process import one_blas_thread
from ...session.session import SessionView
from ...session.sources import CalibrationInput
from ...solvers.interface import RunState
from ..gui.html import CONTROLS
from .prepare import PreparedRun
from .threads import Threads


@dataclass(frozen=True)
class PositionUncertainty:
    """Uncertainty of N positions."""

    axes: np.ndarray  # (N, D, D) float64, metres, half axes of the 95 % ellipses in rows, the longest last
    sigma: np.ndarray  # (N,) float64, metres, one standard deviation
    # verdict, text: the verdict and its message
    verdict: str = ""
    text: str = ""
    channels: Channels | None = None  # of a solver that finds the gains of the channels, or None


def uncertainty_of(found: Assessment | None) -> PositionUncertainty | None:
    """Return the uncertainty at the end of a run, None before it and where it cannot be determined.

    In a known room each position has images; their ellipses are not drawn.

    `found`: Assessment of the state on the screen, or None.
    """
    if found is None or found.room is not None or not np.isfinite(found.covariance).all():
        return None
    axes = ellipse_axes(found.covariance, confidence_factor(0.95, found.covariance.shape[-1]))
    return PositionUncertainty(axes, found.uncertainty, found.verdict, found.verdict_text, found.channels)


IDLE_TIME = 0.3  # s without a change before the verdict is computed


class VerdictWorker:
    """Requests verdicts on a thread of the session, and returns the one on the state on the screen."""

    def __init__(self, run: PreparedRun, threads: Threads):
        self._run, self._state, self._since = run, None, 0.0
        self._requested: RunState | None = None  # compared by identity
        self._lineage, self._sought = None, run.sought  # of the last verdict
        self._worker = threads.start(self._compute, "fdcal-verdict", wakes=True)

    def of(self, state: RunState, running: bool, now: float) -> Assessment | None:
        """Return the assessment of `state`, None while there is none.

        `state`: of the solver; `running`: whether the solver runs; `now`: time, s.
        """
        if state is not self._state:
            self._state, self._since = state, now
        idle = now - self._since > IDLE_TIME and not running
        if state.finished and idle and state is not self._requested:
            self._requested = state
            self._worker.request(state)
        latest = self._worker.latest
        return latest.result if latest is not None and latest.request[0] is state else None

    def pending(self, view: SessionView) -> bool:
        """Return whether there will be an assessment of the state that is shown."""
        latest = self._worker.latest
        done = latest is not None and latest.request[0] is view.state
        return view.state.finished and not view.running and not done

    def sought(self, view: SessionView, found: Assessment | None) -> np.ndarray:
        """Return the microphones whose errors count; once the verdict on a run names faulty channels, without these.

        `found`: the assessment of its state, or None.
        """
        if found is not None or view.history.lineage is not self._lineage:
            self._lineage = view.history.lineage
            self._sought = healthy_microphones(self._run.sought, self._run.measurement.names, found)
        return self._sought

    def _compute(self, state: RunState) -> Assessment:
        run = self._run
        inputs = CalibrationInput(run.scene.name, run.known_scene, run.measurement, state.settings, state.seed)
        with one_blas_thread():
            return assess_state(inputs, run.problem, state, CONTROLS)
