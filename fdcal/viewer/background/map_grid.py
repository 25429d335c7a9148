"""The maps of single modes beside their sum as one image, drawn on a thread of its own: a drag does not wait for it."""

from __future__ import annotations

import numpy as np

from ...graphics.panels import Marks, mosaic
from ...graphics.primitives import DARK, LIGHT
from ...session.worker import LatestWorker
from .cost_maps import CostMap
from .prepare import PreparedRun

MAX_PANELS = 9  # maps of single modes side by side
INTERVAL = 0.2  # s between two images


class MapGridWorker:
    """Requests images and returns the newest; all of it on the caller's thread except `_draw`.

    Parameters
    ----------
    run : PreparedRun
    """

    def __init__(self, run: PreparedRun):
        self._run, self._since = run, -1e9
        self._requested: CostMap | None = None
        self.worker = LatestWorker(self._draw, "fdcal-map-grid")

    def of(self, drawn: CostMap | None, now: float) -> np.ndarray | None:
        """Return the newest image, perhaps of a map before `drawn`.

        Parameters
        ----------
        drawn : the map on the floor, or None
        now : time, s

        Returns
        -------
        (H, W, 3) uint8, or None where there are no maps of single modes
        """
        if drawn is None or drawn.costs is None:
            self._requested = None
            return None
        last = self._requested
        current = last is not None and last.costs is drawn.costs and last.request.style == drawn.request.style
        if not current and now - self._since > INTERVAL and not self.worker.busy:
            self._requested, self._since = drawn, now
            self.worker.request(drawn)
        latest = self.worker.latest
        return None if latest is None or self._requested is None else latest.result

    def close(self, timeout: float) -> bool:
        """End the thread after the image in progress; False if that takes longer than `timeout`, s."""
        return self.worker.close(timeout)

    def _draw(self, drawn: CostMap) -> np.ndarray | None:
        """On the thread."""
        request, costs, run = drawn.request, drawn.costs, self._run
        if costs is None or run.problem.search is None:
            return None
        n, f = request.microphone, run.measurement.frequencies
        shown = np.unique(np.linspace(0, len(costs) - 1, min(len(costs), MAX_PANELS)).round().astype(int))
        captions = [f"{request.modes[i]}: {f[request.modes[i] - 1]:.1f} Hz" for i in shown]
        captions.append(f"sum of {len(costs)}" if len(costs) > 1 else "sum (one mode)")
        positions = np.asarray(request.state.positions)
        truth = run.measurement.aligned_truth(positions)
        marks = Marks(None if truth is None else tuple(truth[n][:2]), tuple(positions[n][:2]))
        return mosaic(
            [*costs[shown], costs.sum(axis=0)], captions, run.problem.search, marks,
            DARK if request.style.dark else LIGHT,
            log=request.style.log, shared=request.style.shared, columns=2 if len(shown) < 6 else 3,
        )  # fmt: skip
