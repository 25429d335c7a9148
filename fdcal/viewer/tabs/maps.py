"""The tab Maps: the cost maps of single modes beside their sum.

They are one image, drawn on a thread of its own: a drag does not wait for it.
"""

from __future__ import annotations

import numpy as np

from ...graphics.panels import Marks, mosaic
from ...graphics.primitives import DARK, LIGHT
from ...graphics.units import row_word
from ...model.measurement import Measurement
from ...session.worker import LatestWorker
from ..background.cost_map import CostMap, count_label
from ..background.prepare import PreparedRun
from ..gui.binding import Binding
from ..gui.html import CARD

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


class MapsTab:
    """Owns the controls of the tab and the thread that draws the maps.

    `image`: control that shows the maps.
    """

    def __init__(self, binding: Binding):
        self._binding, self._shown, gui = binding, None, binding.gui
        self.caption = gui.add_html(caption(None, binding.measurement))
        self.shared = gui.add_checkbox(
            "Same scale", binding.choices.style.shared, hint="One scale for all maps instead of one for each"
        )
        self.image = gui.add_image(np.full((8, 8, 3), 128, np.uint8), format="jpeg", jpeg_quality=92)
        self.image.visible = False
        self.worker = MapGridWorker(binding.run)
        binding.on(self.shared, lambda value: binding.choose_style(shared=bool(value)))

    def show(self, drawn: CostMap | None, now: float) -> None:
        """Bring the maps up to date; called by the main loop."""
        image = self.worker.of(drawn, now)
        if image is self._shown:
            return
        self._shown = image
        self.image.visible = image is not None
        if image is not None:
            self.image.image = image
        self._binding.send("caption", caption(drawn, self._binding.measurement), self.caption, "content")


def caption(drawn: CostMap | None, measurement: Measurement) -> str:
    """Return what the maps show, as HTML."""
    if drawn is None or drawn.panels is None:
        return f"<div style='{CARD} opacity: 0.65'>no maps</div>"
    request, word = drawn.request, row_word(measurement)
    scale = "one scale for all maps" if request.style.shared else "each map with its own scale"
    summed = count_label(measurement, request.modes)
    return (
        f"<div style='{CARD}'>Cost of moving <b>microphone {request.microphone}</b>, {word} by {word} and summed"
        f" ({summed}); {scale}, {'logarithmic' if request.style.log else 'linear'}</div>"
    )
