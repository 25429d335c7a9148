"""The tab View: the camera, the theme, and what is drawn over the map."""

from __future__ import annotations

from collections.abc import Callable

import viser

from ...graphics.primitives import Picture
from ...session.history import SessionView
from ..gui import html
from ..gui.binding import Binding
from ..gui.choices import ELLIPSE_SCALES, VIEWS
from ..server.client_values import one_of

ELLIPSES_LATER = "Ellipses appear when the solver has finished."


class ViewTab:
    """Owns the controls of the tab.

    `place`: function that moves the camera of one browser to a view.
    """

    def __init__(self, binding: Binding, place: Callable[[viser.ClientHandle, str], None]):
        self._binding, gui, choices = binding, binding.gui, binding.choices
        self.camera = gui.add_button_group("Camera", tuple(VIEWS))  # a hint would cover the tabs above
        gui.add_html(html.remark("Of this window only: plan view, whole room, array."))
        self.dark = gui.add_checkbox("Dark page", choices.style.dark)
        self.lecture = gui.add_checkbox(
            "Lecture mode", choices.lecture, hint="Large type, the panels folded away; key H ends it, too"
        )
        self.trails = gui.add_checkbox("Trails", choices.trails, hint="Path of each estimate over the last 200 states")
        self.ellipses = gui.add_checkbox("Error ellipses (95 %)", choices.ellipses, hint=ELLIPSES_LATER)
        self.scale = gui.add_dropdown(
            "Ellipse size", tuple(ELLIPSE_SCALES), initial_value=_label_of(choices.ellipse_scale),
            visible=choices.ellipses, hint="Automatic enlarges ellipses that are too small to be seen",
        )  # fmt: skip
        self.ellipses_text = gui.add_html("", visible=False)
        self.release = gui.add_checkbox(
            "Release known", choices.release, hint="Known microphones can be dragged, too",
            visible=bool(len(binding.run.problem.known)),
        )  # fmt: skip
        binding.on(self.release, lambda value: binding.choose(release=bool(value)))
        binding.on(self.trails, lambda value: self.draw(trails=bool(value)))
        binding.on(self.ellipses, lambda value: self.draw(ellipses=bool(value)))
        binding.on_client(self.camera, lambda client, value: place(client, VIEWS[one_of(value, VIEWS, "Top")]))
        binding.on(self.scale, lambda value: self.enlarge(one_of(value, ELLIPSE_SCALES, "Automatic")))
        binding.on(self.dark, self.darken)
        binding.on(self.lecture, self.lecture_mode)
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

    def enlarge(self, label: str) -> None:
        """Draw the error ellipses in one of ELLIPSE_SCALES."""
        self._binding.choose(ellipse_scale=ELLIPSE_SCALES[label])

    def lecture_mode(self, value) -> None:
        """Begin lecture mode, or end it."""
        lecture = bool(value)
        self._binding.choose(lecture=lecture)
        if self.lecture.value != lecture:
            self.lecture.value = lecture

    def refresh(self) -> None:
        """Let the theme follow the choices."""
        self._apply_theme()

    def _apply_theme(self) -> None:
        dark = self._binding.choices.style.dark
        self._binding.gui.configure_theme(dark_mode=dark, show_share_button=False, show_logo=False)

    def show(self, view: SessionView, picture: Picture) -> None:
        """Say how large the ellipses are, or that they come later; called by the main loop.

        `picture`: on the screen.
        """
        binding, wanted = self._binding, self._binding.choices.ellipses
        text = dict(picture.captions).get("ellipses", "") if view.state.finished else ELLIPSES_LATER
        binding.send("ellipse scale", wanted, self.scale, "visible")
        binding.send("text on ellipses", html.remark(text), self.ellipses_text, "content")
        binding.send("has text on ellipses", wanted and bool(text), self.ellipses_text, "visible")


def _label_of(scale: int) -> str:
    return next(label for label, factor in ELLIPSE_SCALES.items() if factor == scale)
