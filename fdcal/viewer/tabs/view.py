"""The tab View: the camera, the theme, and what is drawn over the map."""

from collections.abc import Callable

import viser

from ..gui import html
from ..gui.binding import Binding, Tab, Tick
from ..gui.choices import ELLIPSE_SCALES, VIEWS

ELLIPSES_LATER = "Ellipses appear when the solver has finished."


class ViewTab(Tab):
    """Owns the controls of the tab.

    `place`: function that moves the camera of one browser to a view.
    """

    def __init__(self, binding: Binding, place: Callable[[viser.ClientHandle, str], None]):
        self._binding, gui, on, choices = binding, binding.gui, binding.on, binding.choices
        self.camera = binding.on_client(
            gui.add_button_group("Camera", tuple(VIEWS)),  # a hint would cover the tabs above
            lambda client, value: place(client, VIEWS[value]),
        )
        gui.add_html(html.remark("Of this window only: plan view, whole room, array."))
        self.dark = on(gui.add_checkbox("Dark page", choices.style.dark), self.darken)
        self.lecture = on(
            gui.add_checkbox(
                "Lecture mode", choices.lecture, hint="Large type, the panels folded away; key H ends it, too"
            ),
            self.lecture_mode,
        )
        self.trails = on(
            gui.add_checkbox("Trails", choices.trails, hint="Path of each estimate over the last 200 states"),
            lambda value: self.draw(trails=value),
        )
        self.ellipses = on(
            gui.add_checkbox("Error ellipses (95 %)", choices.ellipses, hint=ELLIPSES_LATER),
            lambda value: self.draw(ellipses=value),
        )
        self.scale = on(
            gui.add_dropdown(
                "Ellipse size", tuple(ELLIPSE_SCALES), initial_value=_label_of(choices.ellipse_scale),
                visible=choices.ellipses, hint="Automatic enlarges ellipses that are too small to be seen",
            ),
            lambda value: binding.choose(ellipse_scale=ELLIPSE_SCALES[value]),
        )  # fmt: skip
        self.ellipses_text = gui.add_html("", visible=False)
        self.release = on(
            gui.add_checkbox(
                "Release known", choices.release, hint="Known microphones can be dragged, too",
                visible=bool(len(binding.run.problem.known)),
            ),
            lambda value: binding.choose(release=value),
        )  # fmt: skip
        self.refresh()

    def draw(self, **wanted: bool) -> None:
        """Draw `trails` and `ellipses`, or not."""
        self._binding.choose(**wanted)
        for name, value in wanted.items():
            getattr(self, name).value = value

    def darken(self, dark: bool, preferred: bool = False) -> None:
        """Make the page and the map dark, or light; `preferred`: as a browser is set, not as a user has chosen."""
        self._binding.choose_style(dark=dark)
        self._binding.choose(themed=self._binding.choices.themed or not preferred)
        self.refresh()
        self.dark.value = dark

    def lecture_mode(self, lecture: bool) -> None:
        """Begin lecture mode, or end it."""
        self._binding.choose(lecture=lecture)
        self.lecture.value = lecture

    def refresh(self) -> None:
        """Let the theme follow the choices."""
        dark = self._binding.choices.style.dark
        self._binding.gui.configure_theme(dark_mode=dark, show_share_button=False, show_logo=False)

    def show(self, tick: Tick) -> None:
        """Say how large the ellipses are, or that they come later."""
        wanted, text = self._binding.choices.ellipses, ELLIPSES_LATER
        if tick.view.state.finished:
            text = "" if tick.picture is None else dict(tick.picture.captions).get("ellipses", "")
        self.scale.visible, self.ellipses_text.content = wanted, html.remark(text)
        self.ellipses_text.visible = wanted and bool(text)


def _label_of(scale: int) -> str:
    return next(label for label, factor in ELLIPSE_SCALES.items() if factor == scale)
