"""The cost maps of single modes beside their sum, in the tab Map.

They are one image, drawn on a thread of its own: a drag does not wait for it.
"""

import numpy as np

from ...graphics.panels import Marks, mosaic
from ...graphics.picture import row_word
from ...graphics.primitives import DARK, LIGHT
from ...model.measurement import Measurement
from ..background.cost_map import CostMap, count_label
from ..background.prepare import PreparedRun
from ..display_frame import drawn_truth
from ..gui.binding import Binding, Tab, Tick
from ..gui.html import CARD

INTERVAL = 0.2  # s at least between two images
PAUSES = 10  # by how much longer that is than an image takes: the map on the floor needs the processor, too


def panel_image(run: PreparedRun, drawn: CostMap) -> np.ndarray | None:
    """Return the maps of single modes beside their sum as one image (H, W, 3) uint8, or None without such maps."""
    request, panels = drawn.request, drawn.panels
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
    truth = drawn_truth(run, positions)
    true = None if truth is None else tuple(truth[n][:2])
    marks = Marks(true, tuple(positions[n][:2]), request.style.minima and drawn.fine)
    return mosaic(
        [*panels.maps, panels.total], captions, panels.search, marks,
        DARK if request.style.dark else LIGHT,
        log=request.style.log, shared=request.style.shared, columns=2 if several or len(panels.modes) < 6 else 3,
    )  # fmt: skip


class MapsPanel(Tab):
    """Owns the controls of the tab and the thread that draws the maps.

    `image`: control that shows the maps.
    """

    def __init__(self, binding: Binding):
        self._binding, gui = binding, binding.gui
        self._shown: np.ndarray | None = None
        self._requested: CostMap | None = None  # whose image was requested last
        self._since = -1e9  # s, when that was
        with gui.add_folder(f"{binding.row.capitalize()} by {binding.row}", expand_by_default=False):
            self.image = gui.add_image(np.full((8, 8, 3), 128, np.uint8), format="jpeg", jpeg_quality=92, visible=False)
            self.caption = gui.add_html(caption(None, binding.measurement))
            self.shared = binding.on(
                gui.add_checkbox(
                    "Same scale", binding.choices.style.shared, hint="One scale for all maps instead of one for each"
                ),
                lambda value: binding.choose_style(shared=value),
            )
        self.worker = binding.threads.start(lambda drawn: panel_image(binding.run, drawn), "fdcal-map-grid")

    def show(self, tick: Tick) -> None:
        """Show the newest image of the map on the floor, perhaps of one before."""
        image = self._newest(tick.drawn, tick.now)
        if image is self._shown:
            return
        self._shown = image
        self.image.visible = image is not None
        if image is not None:
            self.image.image = image
        self.caption.content = caption(tick.drawn, self._binding.measurement)

    def _newest(self, drawn: CostMap | None, now: float) -> np.ndarray | None:
        """Return the newest image; request another one where the map has changed, not more often than is good."""
        if drawn is None or drawn.panels is None:
            self._requested = None
            return None
        last, latest = self._requested, self.worker.latest
        current = last is not None and last.panels is drawn.panels and last.request.style == drawn.request.style
        pause = INTERVAL if latest is None else max(INTERVAL, PAUSES * (latest.ended - latest.began))
        if not current and now - self._since > pause and not self.worker.busy:
            self._requested, self._since = drawn, now
            self.worker.request(drawn)
        return None if latest is None or self._requested is None else latest.result


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
