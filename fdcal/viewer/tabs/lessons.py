"""The tab Lessons: a text, a question and its answer; each step sets the page's own controls.

All browsers that have the page open follow the same lesson. A step that needs another scene opens it first
(`Page.open`), and sets the controls as soon as the scene is ready.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

from ...model.scene import Scene
from ...model.validation import InputError, StorageError
from ...session.lesson import Lesson, Setting, Step
from ...session.request import OpenRequest
from ..gui.html import complaint, error_message
from ..gui.lesson_html import LETTERS, step_html
from ..lesson_step import apply_setting, restore
from ..server.client_values import one_of

if TYPE_CHECKING:
    from ..gui.choices import Choices
    from ..gui.layout import Panels
    from ..scene3d.nodes import SceneNodes
    from ..session_switch import SessionSwitcher
    from ..session_view import Viewer

NONE = "No lesson"
BACK, RESTORE, NEXT = "Back", "Restore", "Next"

log = logging.getLogger(__name__)


class LessonPage(Protocol):
    """What the tab uses of the page (`page.Page`)."""

    panels: Panels
    nodes: SceneNodes
    viewer: Viewer | None
    switcher: SessionSwitcher

    def open(self, request: OpenRequest) -> None:
        """Show something else as soon as it is ready."""
        ...


@dataclass(frozen=True)
class LessonProgress:
    """Where in the lessons the page is.

    Attributes
    ----------
    lesson : Lesson or None
    number : int, of the step, from 0
    choice : int, the answer chosen, from 0; -1 before one is chosen
    """

    lesson: Lesson | None = None
    number: int = 0
    choice: int = -1

    @property
    def step(self) -> Step | None:
        return None if self.lesson is None else self.lesson.steps[self.number]

    def moved(self, steps: int) -> LessonProgress | None:
        """Return the progress at the beginning of another step; None where the lesson has no such step."""
        number = self.number + steps
        if self.lesson is None or not 0 <= number < len(self.lesson.steps):
            return None
        return LessonProgress(self.lesson, number)


class LessonsTab:
    """Owns the controls of the tab, and the settings that wait for a scene.

    All methods run on viser's event loop, except `show`.
    """

    def __init__(self, page: LessonPage, lessons: Sequence[Lesson]):
        self._page, gui = page, page.panels.gui
        self._lessons = {lesson.title: lesson for lesson in lessons}
        self.progress, self._error = LessonProgress(), ""
        self._before: Choices | None = None  # of the page before the first lesson
        self._pending: tuple[OpenRequest, list[Setting]] | None = None  # settings that wait for their scene
        with page.panels.tab("Lessons"):
            self.choice = gui.add_dropdown("Lesson", (NONE, *self._lessons), initial_value=NONE)
            self.navigation = gui.add_button_group(
                "Step", (BACK, RESTORE, NEXT), visible=False, hint="Restore: restore this step's settings"
            )
            self.text = gui.add_html("")
            self.answers = gui.add_button_group("Your answer", ("A", "B"), visible=False)
        self._on(self.choice, lambda value: self.start(one_of(value, self._lessons, NONE)))
        self._on(self.answers, self.answer)
        self._on(self.navigation, self.go)
        self._redraw()

    def _on(self, handle, act: Callable[[object], None]) -> None:
        """Call `act(value)` when a client has changed a control."""

        async def respond(event) -> None:
            if event.client is not None:
                act(event.target.value)

        (handle.on_click if hasattr(handle, "on_click") else handle.on_update)(respond)

    def start(self, title: str) -> None:
        """Start a lesson, by its title; any other text ends the present one."""
        viewer, lesson = self._page.viewer, self._lessons.get(title)
        if viewer is not None and lesson is not None and self.progress.lesson is None:
            self._before = viewer.binding.choices
        self.progress = LessonProgress(lesson)
        self._set_up()
        if viewer is not None and lesson is None and self._before is not None:
            restore(self._before, viewer.main_panel)
            self._before = None

    def go(self, where) -> None:
        """Go BACK or NEXT, or RESTORE the settings of the step; ignore anything else."""
        if where not in (BACK, RESTORE, NEXT):
            return
        progress = self.progress.moved({BACK: -1, RESTORE: 0, NEXT: 1}[where])
        if progress is not None:
            self.progress = progress
            self._set_up()

    def answer(self, letter) -> None:
        """Answer the question, by the letter of the answer; only the first answer counts."""
        step, choice = self.progress.step, LETTERS.find(str(letter))
        if step is None or self.progress.choice >= 0 or len(str(letter)) != 1 or not 0 <= choice < len(step.choices):
            return
        self.progress = replace(self.progress, choice=choice)
        self._set_up()

    def _set_up(self) -> None:
        """Set the page as the present step requires, the scene first."""
        progress, self._pending, self._error = self.progress, None, ""
        self._redraw()
        lesson, step = progress.lesson, progress.step
        if lesson is None or step is None:
            return
        revealed = progress.choice >= 0
        settings = [step.page, step.then] if revealed else [step.page]

        def begin() -> None:
            start = lesson.start(progress.number, revealed)
            if start is None:
                raise InputError(f'the lesson "{lesson.title}" names no scene', "give its first step a scene")
            self._begin(settings, *start)

        self._guarded(begin)

    def _begin(self, settings: list[Setting], scene: Scene, seed: int) -> None:
        """Apply the last of `settings`; if another scene has to be opened first, all settings of this step."""
        viewer, setting = self._page.viewer, settings[-1]
        if viewer is None or viewer.binding.run.scene != scene:
            request = OpenRequest(scene, start_seed=seed)
            self._page.open(request)
            self._pending = request, settings[-1:] if setting.begins else settings
            self._redraw()
            return
        restarted = setting.begins or bool(setting.reset)
        if restarted:
            viewer.binding.session.reset(seed)
        self._apply(setting, viewer, restarted)

    def _apply(self, setting: Setting, viewer: Viewer, restarted: bool) -> None:
        apply_setting(setting, viewer.main_panel, self._page.nodes.cameras.request_all, restarted)

    def show(self, call: Callable[[Callable[[], None]], object] = lambda function: function()) -> None:
        """Apply the settings that wait for a scene once it is shown; called by the main loop.

        Parameters
        ----------
        call : runs a function on viser's event loop
        """
        pending, viewer = self._pending, self._page.viewer
        if pending is None:
            return
        if viewer is not None and viewer.binding.run.opening is pending[0]:
            self._pending = None
            call(lambda: self._guarded(lambda: self._apply_all(pending[1], viewer)))
        elif self._page.switcher.idle:  # the scene was refused or cancelled
            self._pending = None
            call(self._redraw)

    def _apply_all(self, settings: list[Setting], viewer: Viewer) -> None:
        for setting in settings if viewer is self._page.viewer else ():
            self._apply(setting, viewer, restarted=setting is settings[0])
        self._redraw()

    def _guarded(self, act: Callable[[], None]) -> None:
        """Call `act`; show an exception on the page, and log it unless it is the user's."""
        try:
            act()
        except Exception as error:
            if not isinstance(error, (InputError, StorageError)):
                log.exception("a lesson's step could not be set")
            self._error = error_message(error)
            self._redraw()

    def _redraw(self) -> None:
        progress, lesson, step = self.progress, self.progress.lesson, self.progress.step
        ready = self._pending is None
        self.text.content = step_html(lesson, progress.number, progress.choice, ready) + complaint(self._error)
        self.navigation.visible = step is not None
        if lesson is None or step is None:
            self.answers.visible = False
            return
        self.answers.visible = bool(step.choices) and progress.choice < 0 and ready
        if self.answers.visible:
            _set_options(self.answers, tuple(LETTERS[: len(step.choices)]))
        first, last = progress.number == 0, progress.number == len(lesson.steps) - 1
        _set_options(self.navigation, (*((BACK,) * (not first)), RESTORE, *((NEXT,) * (not last))))


def _set_options(handle, options: tuple[str, ...]) -> None:
    """Set the buttons of a group where they differ: buttons that are sent again lose the focus."""
    if handle.options != options:
        handle.options = options
