"""The tab Lessons: a text, a question, the reveal; each step sets the page's own controls.

Everyone who has the page open follows the same lesson. Where a step needs another scene it is opened first
(`Page.open`), and the rest is set as soon as it is there.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from ...model.validation import InputError, StorageError
from ...session.lesson import Lesson, Setting, Step
from ...session.request import OpenRequest
from ..gui.html import complaint
from ..gui.lesson_html import LETTERS, told
from ..lesson_step import carry_out
from ..server.client_values import one_of
from ..server.error_log import log_location

NONE = "No lesson"
BACK, AGAIN, NEXT = "Back", "Set again", "Next"

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Place:
    """Where in the lessons the page is: a lesson and a step of it, from 0, and the choice made, -1 before."""

    lesson: Lesson | None = None
    number: int = 0
    choice: int = -1

    @property
    def step(self) -> Step | None:
        return None if self.lesson is None else self.lesson.steps[self.number]


class LessonsTab:
    """Owns the tab's handles, and what is still to be set. All of it on viser's loop but `show`."""

    def __init__(self, page, lessons: Sequence[Lesson]):
        self._page, gui = page, page.panels.gui
        self._lessons = {lesson.title: lesson for lesson in lessons}
        self.place, self._wanted, self._trouble = Place(), None, ""
        with page.panels.tab("Lessons"):
            self.choice = gui.add_dropdown("Lesson", (NONE, *self._lessons), initial_value=NONE)
            self.ways = gui.add_button_group(
                "Step", (BACK, AGAIN, NEXT), visible=False, hint="Set again puts the controls as this step wants them"
            )
            self.text = gui.add_html("")
            self.answers = gui.add_button_group("Your answer", ("A", "B"), visible=False)
        self._hear(self.choice, lambda value: self.take(one_of(value, self._lessons, NONE)))
        self._hear(self.answers, self.answer)
        self._hear(self.ways, self.go)
        self._redraw()

    def _hear(self, handle, act) -> None:
        async def hear(event) -> None:
            if event.client is not None:
                act(event.target.value)

        (handle.on_click if hasattr(handle, "on_click") else handle.on_update)(hear)

    def take(self, title: str) -> None:
        """Begin a lesson, by its title; any other text ends the one there is."""
        self.place = Place(self._lessons.get(title))
        self._set()

    def go(self, way) -> None:
        """BACK, AGAIN or NEXT."""
        lesson, number = self.place.lesson, self.place.number
        if lesson is None or way not in (BACK, AGAIN, NEXT):
            return
        number += {BACK: -1, AGAIN: 0, NEXT: 1}[way]
        if 0 <= number < len(lesson.steps):
            self.place = Place(lesson, number)
            self._set()

    def answer(self, letter) -> None:
        """Make a choice, by its letter; the first one counts."""
        step, choice = self.place.step, LETTERS.find(str(letter))
        if step is None or self.place.choice >= 0 or len(str(letter)) != 1 or not 0 <= choice < len(step.choices):
            return
        self.place = replace(self.place, choice=choice)
        self._set()

    def _set(self) -> None:
        """Put the page as the place wants it, the scene first."""
        place, self._wanted, self._trouble = self.place, None, ""
        self._redraw()
        if place.lesson is None:
            return
        revealed = place.choice >= 0
        settings = [place.step.page, place.step.then] if revealed else [place.step.page]
        self._guarded(lambda: self._begin(settings, *place.lesson.start(place.number, revealed)))

    def _begin(self, settings: list[Setting], scene, seed: int) -> None:
        """Set the last of `settings`; where another scene is needed first, what came before it in this step, too."""
        viewer, setting = self._page.viewer, settings[-1]
        if viewer is None or viewer.binding.work.scene != scene:
            opening = OpenRequest(scene, start_seed=seed)
            self._page.open(opening)
            self._wanted = opening, settings[-1:] if setting.begins else settings
            self._redraw()
            return
        anew = setting.begins or bool(setting.reset)
        if anew:
            viewer.binding.session.reset(seed)
        carry_out(setting, viewer.main_panel, self._page.nodes.cameras.place_all, anew)

    def show(self, call: Callable[[Callable], object] = lambda function: function()) -> None:
        """Called by the main loop: what waits for a scene is set once it is there, by `call`, on viser's loop."""
        wanted, viewer = self._wanted, self._page.viewer
        if wanted is not None and viewer is not None and viewer.binding.work.opening is wanted[0]:
            self._wanted = None
            call(lambda: self._guarded(lambda: self._complete(wanted[1], viewer)))
        elif wanted is not None and self._page.switcher.idle:  # refused or cancelled
            self._wanted = None
            call(self._redraw)

    def _complete(self, settings: list[Setting], viewer) -> None:
        for setting in settings if viewer is self._page.viewer else ():
            carry_out(setting, viewer.main_panel, self._page.nodes.cameras.place_all, setting is settings[0])
        self._redraw()

    def _guarded(self, act: Callable[[], None]) -> None:
        try:
            act()
        except (InputError, StorageError) as error:
            self._tell(str(error))
        except Exception as error:
            log.exception("a lesson's step could not be set")
            self._tell(f"{type(error).__name__}: {error}; details in {log_location()}")

    def _tell(self, trouble: str) -> None:
        self._trouble = trouble
        self._redraw()

    def _redraw(self) -> None:
        place, step = self.place, self.place.step
        ready = self._wanted is None
        self.text.content = told(place.lesson, place.number, place.choice, ready) + complaint(self._trouble)
        asked = step is not None and bool(step.choices) and place.choice < 0 and ready
        self.answers.visible, self.ways.visible = asked, step is not None
        if asked and self.answers.options != (letters := tuple(LETTERS[: len(step.choices)])):
            self.answers.options = letters
        if step is not None:
            first, last = place.number == 0, place.number == len(place.lesson.steps) - 1
            ways = (*((BACK,) * (not first)), AGAIN, *((NEXT,) * (not last)))
            if self.ways.options != ways:
                self.ways.options = ways
