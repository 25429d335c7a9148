"""The cost along a line, mode by mode and summed, computed on a thread of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ...cost.maps import eq7_cut
from ...cost.reference_cost import LOWEST
from ...session.worker import LatestWorker
from ...solvers.interface import RunState
from ..gui.choices import Line
from .map_panels import shown_modes
from .prepare import PreparedRun

POINTS = 121  # along the line
MAX_MODES = 12  # that are drawn one by one
NEAR = 0.05  # of the length of the line: a position further from it has no mark in the plot


@dataclass(frozen=True)
class CutRequest:
    """A cut to be computed."""

    revision: int  # counts the states on the screen
    microphone: int  # counted from 0
    modes: tuple[int, ...]  # counted from 1
    order_offset: int  # added to ceil(k R) in the order of every mode
    line: Line  # its ends, metres
    state: RunState = field(compare=False)  # of the solver


@dataclass(frozen=True)
class Cut:
    """The cost along a line."""

    request: CutRequest
    distance: np.ndarray  # (S,) float64, metres from the first end
    modes: tuple[int, ...]  # those drawn one by one, counted from 1
    single: np.ndarray  # (K, S) float64, dB re the power of all modes of the request
    total: np.ndarray  # (S,) float64, likewise, of their sum
    # estimate, truth: distance of the foot of a position on the line, metres; None where it is not near
    estimate: float | None
    truth: float | None


class CutWorker:
    """Requests cuts and returns the newest; all of it on the caller's thread except `_compute`.

    `notify`: called when there is a new cut.
    """

    def __init__(self, run: PreparedRun, notify: Callable[[], None] = lambda: None):
        self._run, self._requested = run, None
        self.worker = LatestWorker(self._compute, "fdcal-cut", notify=notify)

    def newest(self, wanted: CutRequest) -> tuple[Cut | None, Exception | None]:
        """Request a cut; return the newest one, perhaps an older one, and what kept it from being computed."""
        if wanted != self._requested:
            self._requested = wanted
            self.worker.request(wanted)
        latest = self.worker.latest
        return (None, None) if latest is None else (latest.result, latest.cause)

    def close(self, timeout: float) -> bool:
        """End the thread after the cut in progress; False if that takes longer than `timeout`, s."""
        return self.worker.close(timeout)

    def _compute(self, request: CutRequest) -> Cut:
        """On the thread."""
        run, n, modes, state = self._run, request.microphone, request.modes, request.state
        positions, ends = np.asarray(state.positions), np.array(request.line)
        points = np.linspace(ends[0], ends[1], POINTS)
        points = np.concatenate([points, np.tile(positions[n, 2:], (POINTS, 1))], axis=1)
        costs = eq7_cut(run.problem, positions, n, modes, request.order_offset, points, state.channels)
        drawn = shown_modes(len(modes), MAX_MODES)
        truth = run.measurement.aligned_truth(positions)
        return Cut(
            request,
            np.linspace(0.0, float(np.linalg.norm(ends[1] - ends[0])), POINTS),
            tuple(modes[i] for i in drawn),
            _decibels(costs[drawn]),
            _decibels(costs.sum(axis=0)),
            foot(positions[n, :2], ends),
            None if truth is None else foot(truth[n][:2], ends),
        )


def _decibels(cost: np.ndarray) -> np.ndarray:
    return 10 * np.log10(np.maximum(cost, LOWEST))


def foot(place, ends: np.ndarray) -> float | None:
    """Return how far along a line the foot of a position lies, metres; None where the position is not near the line.

    `place` (2,) float64, metres; `ends` (2, 2) float64, metres.
    """
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    if length == 0:
        return None
    offset = np.asarray(place, float) - ends[0]
    distance = float(offset @ along / length)
    off = abs(float(along[0] * offset[1] - along[1] * offset[0])) / length
    return distance if 0 <= distance <= length and off <= NEAR * length else None
