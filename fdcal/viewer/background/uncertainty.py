"""The uncertainty of each estimated position, computed on a thread of its own.

Only for a solver that has finished: before that, its positions are not at a minimum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...assessment.error_ellipses import ellipse_axes
from ...assessment.result_parts import Channels
from ...session.worker import LatestWorker
from ...solvers.interface import AssessmentMethod, RunState
from ..gui.html import CONTROLS
from .prepare import PreparedRun

SIGMAS = 2.4477  # half axes of the ellipse that holds 95 % of a bivariate Gaussian, in standard deviations
IDLE_TIME = 0.5  # s without a change before the uncertainty is computed


@dataclass(frozen=True)
class PositionUncertainty:
    """Uncertainty of N positions.

    Attributes
    ----------
    axes : (N, D, D) float64, metres, half axes of the 95 % ellipses in rows, the longest last
    sigma : (N,) float64, metres, one standard deviation
    verdict, text : the verdict and its message, of a solver that finds the gains of the channels; "" of others
    channels : Channels, likewise, or None
    """

    axes: np.ndarray
    sigma: np.ndarray
    verdict: str = ""
    text: str = ""
    channels: Channels | None = None


class UncertaintyWorker:
    """Requests uncertainties and returns the one of the state on the screen.

    Parameters
    ----------
    run : PreparedRun
    """

    def __init__(self, run: PreparedRun):
        self._run, self._state, self._since, self._requested = run, None, 0.0, None
        self._worker = LatestWorker(self._compute, "fdcal-uncertainty")

    def of(self, state: RunState, running: bool, now: float) -> PositionUncertainty | None:
        """Return the uncertainty of `state`, None while there is none yet or where it cannot be determined.

        Parameters
        ----------
        state : of the solver
        running : whether the solver runs
        now : time, s
        """
        if state is not self._state:
            self._state, self._since = state, now
        idle = now - self._since > IDLE_TIME and not running
        if state.finished and idle and state is not self._requested:
            self._requested = state
            self._worker.request(state)
        latest = self._worker.latest
        return latest.result if latest is not None and latest.request[0] is state else None

    def close(self, timeout: float) -> bool:
        """End the thread after the work in progress; False if that takes longer than `timeout`, s."""
        return self._worker.close(timeout)

    def _compute(self, state: RunState) -> PositionUncertainty | None:
        return computed(self._run, state)


def computed(run: PreparedRun, state: RunState) -> PositionUncertainty | None:
    """Return the uncertainty at the end of a run, None where it cannot be determined."""
    if run.solver.TRAITS.assessment is AssessmentMethod.CHANNELS:
        return _of_channels(run, state)
    if run.solver.TRAITS.assessment is not AssessmentMethod.LIKELIHOOD:  # which this covariance belongs to
        return None
    from ...assessment.verdict import judge

    noise = state.assessment_noise
    names = run.measurement.names
    try:
        found = judge(run.problem, np.asarray(state.positions), state.modes, noise, names, state.converged)
    except np.linalg.LinAlgError:  # the field does not determine these positions
        return None
    if not np.isfinite(found.covariance).all():
        return None
    return PositionUncertainty(ellipse_axes(found.covariance, SIGMAS), found.uncertainty)


def _of_channels(run: PreparedRun, state) -> PositionUncertainty | None:
    """What the command line prints of the same state: ellipses, verdict and channels."""
    from ...assessment.channel_verdict import judge  # it loads the compiler

    names = run.measurement.names
    try:
        found = judge(run.problem, state, names)
    except np.linalg.LinAlgError:
        return None
    axes = ellipse_axes(found.covariance, SIGMAS)
    return PositionUncertainty(axes, found.sigma, found.code, found.worded(CONTROLS), found.channels(names))
