"""How far each microphone may be from where it is supposed, on a thread of its own.

Only of a solver that has finished: before, its positions are not at a minimum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...assessment.uncertainty import covariance, ellipse_axes, field_of, one_sigma, spread
from ...session.worker import LatestWorker
from .prepare import Work

SIGMAS = 2.4477  # half axes of the ellipse that covers 95 % of a plane's Gaussian
STILL = 0.5  # s without a change before the uncertainty is reckoned


@dataclass(frozen=True)
class Errors:
    """Uncertainty of N microphones: half axes (N, D, D) of the 95 % ellipses and one sigma (N,), metres."""

    axes: np.ndarray
    sigma: np.ndarray


class Spreads:
    """Asks for uncertainties and hands out that of the state looked at."""

    def __init__(self, work: Work):
        self._work, self._state, self._since, self._asked = work, None, 0.0, None
        self._worker = LatestWorker(self._reckon, "fdcal-spread")

    def of(self, state, running: bool, now: float) -> Errors | None:
        """The uncertainty of `state`, or None: not there yet, or none to be had of these positions."""
        if state is not self._state:
            self._state, self._since = state, now
        if state.finished and not running and state is not self._asked and now - self._since > STILL:
            self._asked = state
            self._worker.request(state)
        latest = self._worker.latest
        return latest.result if latest is not None and latest.request[0] is state else None

    def close(self, timeout: float) -> bool:
        """End the thread after the work under way."""
        return self._worker.close(timeout)

    def _reckon(self, state) -> Errors | None:
        work, positions = self._work, np.asarray(state.positions)
        if work.scene.solver.name == "room":  # which knows more than this covariance does
            return None
        modes = slice(state.first - 1, state.last)
        p, field = field_of(work.problem, positions, modes, None)
        try:
            blocks = covariance(spread(positions, p, field, work.problem.known))
        except np.linalg.LinAlgError:  # positions from which nothing can be told
            return None
        return Errors(ellipse_axes(blocks, SIGMAS), one_sigma(blocks)) if np.isfinite(blocks).all() else None
