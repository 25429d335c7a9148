"""The maps of single modes beside their sum as one image, drawn on a thread of its own: a drag does not wait for it."""

from __future__ import annotations

import numpy as np

from ...graphics.panels import Marks, mosaic
from ...graphics.primitives import DARK, LIGHT
from ...graphics.units import row_word
from ...session.worker import LatestWorker
from .cost_maps import CostMap
from .prepare import PreparedRun

INTERVAL = 0.2  # s at least between two images
PAUSES = 10  # by how much longer that is than an image takes: the map on the floor needs the processor, too


class MapGridWorker:
    """Requests images and returns the newest; all of it on the caller's thread except `_draw`."""

    def __init__(self, run: PreparedRun):
        self._run, self._since = run, -1e9
        self._requested: CostMap | None = None
        self.worker = LatestWorker(self._draw, "fdcal-map-grid")

    def of(self, drawn: CostMap | None, now: float) -> np.ndarray | None:
        """Return the newest image, perhaps of a map before `drawn`.

        `drawn`: the map on the floor, or None; `now`: time, s. Returns (H, W, 3) uint8, or None where there are no maps
        of single modes.
        """
        if drawn is None or drawn.panels is None:
            self._requested = None
            return None
        last = self._requested
        current = last is not None and last.panels is drawn.panels and last.request.style == drawn.request.style
        latest = self.worker.latest
        pause = INTERVAL if latest is None else max(INTERVAL, PAUSES * (latest.ended - latest.began))
        if not current and now - self._since > pause and not self.worker.busy:
            self._requested, self._since = drawn, now
            self.worker.request(drawn)
        return None if latest is None or self._requested is None else latest.result

    def close(self, timeout: float) -> bool:
        """End the thread after the image in progress; False if that takes longer than `timeout`, s."""
        return self.worker.close(timeout)

    def _draw(self, drawn: CostMap) -> np.ndarray | None:
        """On the thread."""
        request, panels, run = drawn.request, drawn.panels, self._run
        if panels is None:
            return None
        n, f, takes = request.microphone, run.measurement.frequencies, run.measurement.takes
        several = run.measurement.take_count > 1 and request.take is None
        captions = [
            f"{mode}: {f[mode - 1]:.1f} Hz" + (f", take {takes[mode - 1]}" if several else "") for mode in panels.modes
        ]
        captions.append(
            f"sum of {len(request.modes)}" if len(request.modes) > 1 else f"sum (one {row_word(run.measurement)})"
        )
        positions = np.asarray(request.state.positions)
        truth = run.measurement.aligned_truth(positions)
        true = None if truth is None else tuple(truth[n][:2])
        marks = Marks(true, tuple(positions[n][:2]), request.style.minima)
        return mosaic(
            [*panels.maps, panels.total], captions, panels.search, marks,
            DARK if request.style.dark else LIGHT,
            log=request.style.log, shared=request.style.shared, columns=2 if several or len(panels.modes) < 6 else 3,
        )  # fmt: skip
