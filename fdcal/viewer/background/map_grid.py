"""The maps of single modes beside their sum as one image, drawn on a thread of its own: a drag does not wait for it."""

from __future__ import annotations

import numpy as np

from ...graphics.panels import Marks, mosaic
from ...graphics.primitives import DARK, LIGHT
from ...session.worker import LatestWorker
from .cost_maps import Map
from .prepare import Work

MOST_PANELS = 9  # maps of single modes side by side
INTERVAL = 0.2  # s between two images


class SideBySide:
    """Asks for images and hands out the newest; all of it on the caller's thread but `_draw`."""

    def __init__(self, work: Work):
        self._work, self._asked, self._since = work, None, -1e9
        self._worker = LatestWorker(self._draw, "fdcal-panels")

    def of(self, drawn: Map | None, now: float) -> np.ndarray | None:
        """The newest image (H, W, 3) uint8, perhaps of a map before `drawn`; None where there are no single maps."""
        if drawn is None or drawn.costs is None:
            self._asked = None
            return None
        asked = self._asked is not None and self._asked.costs is drawn.costs
        asked = asked and self._asked.request.look == drawn.request.look
        if not asked and now - self._since > INTERVAL and not self._worker.busy:
            self._asked, self._since = drawn, now
            self._worker.request(drawn)
        latest = self._worker.latest
        return None if latest is None or self._asked is None else latest.result

    def close(self, timeout: float) -> bool:
        """End the thread after the image under way."""
        return self._worker.close(timeout)

    def _draw(self, drawn: Map) -> np.ndarray:
        """On the thread."""
        wanted, costs, measurement = drawn.request, drawn.costs, self._work.measurement
        n, f = wanted.microphone, measurement.frequencies
        shown = np.unique(np.linspace(0, len(costs) - 1, min(len(costs), MOST_PANELS)).round().astype(int))
        captions = [f"{wanted.modes[i]}: {f[wanted.modes[i] - 1]:.1f} Hz" for i in shown]
        captions.append(f"sum of {len(costs)}" if len(costs) > 1 else "sum (one mode)")
        here = np.asarray(wanted.state.positions)
        truth = measurement.aligned_truth(here)
        marks = Marks(None if truth is None else tuple(truth[n][:2]), tuple(here[n][:2]))
        return mosaic(
            [*costs[shown], costs.sum(axis=0)], captions, self._work.problem.search, marks,
            DARK if wanted.look.dark else LIGHT,
            log=wanted.look.log, shared=wanted.look.shared, columns=2 if len(shown) < 6 else 3,
        )  # fmt: skip
