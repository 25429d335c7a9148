"""The tab Maps: the cost maps of single modes beside their sum."""

from __future__ import annotations

import numpy as np

from ...graphics.units import row_word
from ...model.measurement import Measurement
from ..background.cost_maps import CostMap
from ..background.map_grid import MapGridWorker
from ..background.map_panels import count_label
from ..gui.binding import Binding
from ..gui.html import CARD


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
