"""The tab View: the camera, the theme, and what is drawn over the map."""

from __future__ import annotations

from collections.abc import Callable

import viser

from ...session.history import SessionView
from ..gui import html
from ..gui.binding import Binding
from ..gui.choices import VIEWS
from ..server.client_values import one_of

ELLIPSES_LATER = "Ellipses appear when the solver has finished."


class ViewTab:
    """Owns the controls of the tab.

    Parameters
    ----------
    binding : Binding
    place : function that moves the camera of one browser to a view
    """

    def __init__(self, binding: Binding, place: Callable[[viser.ClientHandle, str], None]):
        self._binding, gui, choices = binding, binding.gui, binding.choices
        self.camera = gui.add_button_group(
            "Camera", tuple(VIEWS), hint="This window only: plan view, whole room, array"
        )
        self.dark = gui.add_checkbox("Dark page", choices.style.dark)
        self.trails = gui.add_checkbox("Trails", choices.trails, hint="Path of each estimate over the last 200 states")
        self.ellipses = gui.add_checkbox("Error ellipses (95 %)", choices.ellipses, hint=ELLIPSES_LATER)
        self.release = gui.add_checkbox(
            "Release known", choices.release, hint="Known microphones can be dragged, too",
            visible=bool(len(binding.run.problem.known)),
        )  # fmt: skip
        self.ellipses_later = gui.add_html(html.remark(ELLIPSES_LATER), visible=False)
        binding.on(self.release, lambda value: binding.choose(release=bool(value)))
        binding.on(self.trails, lambda value: self.draw(trails=bool(value)))
        binding.on(self.ellipses, lambda value: self.draw(ellipses=bool(value)))
        binding.on_client(self.camera, lambda client, value: place(client, VIEWS[one_of(value, VIEWS, "Top")]))
        binding.on(self.dark, self.darken)
        self._apply_theme()

    def draw(self, **wanted: bool) -> None:
        """Draw `trails` and `ellipses`, or not."""
        self._binding.choose(**wanted)
        for name, value in wanted.items():
            handle = getattr(self, name)
            if handle.value != value:
                handle.value = value

    def darken(self, value) -> None:
        """Make the page and the map dark, or light."""
        dark = bool(value)
        self._binding.choose_style(dark=dark)
        self._apply_theme()
        if self.dark.value != dark:
            self.dark.value = dark

    def _apply_theme(self) -> None:
        dark = self._binding.choices.style.dark
        self._binding.gui.configure_theme(dark_mode=dark, show_share_button=False, show_logo=False)

    def show(self, view: SessionView) -> None:
        """Say that the ellipses come later while the solver has not finished; called by the main loop."""
        later = self._binding.choices.ellipses and not view.state.finished
        self._binding.send("ellipses later", later, self.ellipses_later, "visible")
