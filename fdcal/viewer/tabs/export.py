"""What can be taken away: which file, and for pictures where from and how large."""

from __future__ import annotations

from collections.abc import Callable

import viser

from ..background.exports import KINDS
from ..gui import html
from ..gui.binding import PICTURE, Binding
from ..server.client_values import one_of

SEEN = {"Top": "top", "3-D": "3d", "Close": "close"}
SIZES = {"1280 x 800": (1280, 800), "1920 x 1080": (1920, 1080), "3840 x 2160": (3840, 2160)}


class ExportTab:
    """Owns the handles of the tab."""

    def __init__(self, binding: Binding, export: Callable[[viser.ClientHandle, str], None]):
        self._binding, gui, choices = binding, binding.gui, binding.choices
        self.kind = gui.add_dropdown("File", tuple(KINDS), initial_value=choices.export_kind)
        self.told = gui.add_html("")
        self.seen = gui.add_dropdown("Seen from", tuple(SEEN), initial_value=_key(SEEN, choices.export_view))
        self.size = gui.add_dropdown("Size (pixels)", tuple(SIZES), initial_value=_key(SIZES, choices.export_size))
        self.button = gui.add_button("Save", icon=viser.Icon.DOWNLOAD, hint="Of what is shown now")
        binding.on(self.kind, self.choose)
        binding.on(self.seen, lambda value: binding.choose(export_view=SEEN[one_of(value, SEEN, "Top")]))
        binding.on(self.size, lambda value: binding.choose(export_size=SIZES[one_of(value, SIZES, "1280 x 800")]))
        binding.on_page(self.button, lambda client, _: export(client, binding.choices.export_kind))
        self.choose(choices.export_kind)

    def choose(self, value) -> None:
        """Another kind of file; only a picture has a size and a side from which it is seen."""
        kind = one_of(value, KINDS, PICTURE)
        self._binding.choose(export_kind=kind)
        self.told.content = html.remark(KINDS[kind].description)
        self.seen.visible = self.size.visible = kind == PICTURE


def _key(options: dict, value) -> str:
    return next(key for key, option in options.items() if option == value)
