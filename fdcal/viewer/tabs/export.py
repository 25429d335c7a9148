"""The tab Export: which file to save, and the view and the size of a picture."""

from __future__ import annotations

from collections.abc import Callable

import viser

from ..background.exports import KINDS
from ..gui import html
from ..gui.binding import Binding
from ..gui.choices import PICTURE, VIEWS
from ..server.client_values import one_of

SIZES = {"1280 x 800": (1280, 800), "1920 x 1080": (1920, 1080), "3840 x 2160": (3840, 2160)}


class ExportTab:
    """Owns the controls of the tab.

    `export`: function that sends a kind of file to one browser.
    """

    def __init__(self, binding: Binding, export: Callable[[viser.ClientHandle, str], None]):
        self._binding, gui, choices = binding, binding.gui, binding.choices
        self.kind = gui.add_dropdown("File", tuple(KINDS), initial_value=choices.export_kind)
        self.description = gui.add_html("")
        self.view = gui.add_dropdown("Camera view", tuple(VIEWS), initial_value=_label(VIEWS, choices.export_view))
        self.size = gui.add_dropdown("Size (pixels)", tuple(SIZES), initial_value=_label(SIZES, choices.export_size))
        self.button = gui.add_button("Save", icon=viser.Icon.DOWNLOAD, hint="Save what is shown now")
        binding.on(self.kind, self.choose)
        binding.on(self.view, lambda value: binding.choose(export_view=VIEWS[one_of(value, VIEWS, "Top")]))
        binding.on(self.size, lambda value: binding.choose(export_size=SIZES[one_of(value, SIZES, "1280 x 800")]))
        binding.on_client(self.button, lambda client, _: export(client, binding.choices.export_kind))
        self.choose(choices.export_kind)

    def choose(self, value) -> None:
        """Choose a kind of file; only a picture has a view and a size."""
        kind = one_of(value, KINDS, PICTURE)
        self._binding.choose(export_kind=kind)
        self.description.content = html.remark(KINDS[kind].description)
        self.view.visible = self.size.visible = kind == PICTURE

    def refresh(self) -> None:
        """Let what depends on the kind of file follow the choices."""
        self.choose(self._binding.choices.export_kind)


def _label(options: dict, value) -> str:
    return next(label for label, option in options.items() if option == value)
