"""The tab Lessons: a text, a question and its answer; each step sets the page's own controls.

All browsers that have the page open follow the same lesson. A step that needs another scene opens it first
(`Page.open`), and sets the controls as soon as the scene is ready. What the page showed before the first lesson comes
back with its end (`lesson_settings`).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Protocol

import viser

from ...model.scene import Scene
from ...model.validation import InputError, StorageError, shown
from ...session.lesson import MAX_CHOICES, Lesson, LessonProgress, Setting, Step
from ...session.request import OpenRequest
from ..gui.choices import MAX_RATE
from ..gui.html import CARD, complaint, error_message
from ..lesson_settings import PageBefore, apply_setting, plain_choices

if TYPE_CHECKING:
    from ..panels import Panels
    from ..scene3d.nodes import SceneNodes
    from ..session_switch import SessionSwitcher
    from ..session_view import Viewer

INTRODUCTION = (
    "A lesson sets the controls for you, asks a question, and shows what happens. Everyone who has this page open"
    " follows the same lesson. What the page shows now comes back when the lesson ends."
)
WAITS = 'Your session waits, paused. "End lesson" brings it back, with all controls as they were.'
RACE_WAITS = 'Your session and its race wait, paused. "End lesson" brings them back, with all controls as they were.'


def step_html(lesson: Lesson | None, number: int, choice: int, ready: bool = True, waits: str = "") -> str:
    """Return a step of a lesson, with the answer once one is chosen; before that, its choices are buttons.

    `lesson`: Lesson or None; without one, an introduction is returned; `number`: of the step, from 0; `choice`: the
    answer chosen, from 0; -1 before one is chosen; `ready`: whether the page shows what the step asks about; the
    question is left out until then; `waits`: what waits for the end of the lesson, in words. Returns HTML.
    """
    if lesson is None:
        return f"<div style='{CARD}'>{INTRODUCTION}</div>"
    step = lesson.steps[number]
    place = f"{escape(lesson.title)}, step {number + 1} of {len(lesson.steps)}"
    parts = [f"<div style='opacity: 0.75'>{place}</div>"]
    if number == 0 and choice < 0 and waits:
        parts.append(f"<div style='opacity: 0.75; font-size: 0.9em'>{escape(waits)}</div>")
    if choice < 0:
        parts.append(_paragraphs(step.text))
    if ready:
        parts += _question(step, choice)
    else:
        parts.append(_bold("The picture of this step is being prepared ..."))
    return f"<div style='{CARD} line-height: 1.4'>{''.join(parts)}</div>"


def _question(step: Step, choice: int) -> list[str]:
    """Return the question and, once an answer is chosen, that one, the right one, and why.

    The other choices are left out, so that the button below stays on a small screen.
    """
    parts = [_bold(escape(step.question))] if step.question else []
    if choice < 0:
        return parts
    right = step.answer - 1
    for i in sorted({choice, right}):
        mark = "&#10003;" if i == right else "&#10007;"
        parts.append(
            f"<div style='display: flex; font-weight: 600'><span style='width: 1.4em'>{mark}</span>"
            f"<span style='flex: 1'>{escape(step.choices[i])}</span></div>"
        )
    verdict = "Right." if choice == right else f"The answer is: {escape(step.choices[right])}."
    return [*parts, _bold(verdict), _paragraphs(step.reveal)]


def _bold(html: str) -> str:
    return f"<p style='margin: 0.5em 0; font-weight: 600'>{html}</p>"


def _paragraphs(text: str) -> str:
    """Return plain text as HTML; an empty line begins another paragraph."""
    parts = [escape(" ".join(part.split())) for part in text.split("\n\n") if part.strip()]
    return "".join(f"<p style='margin: 0.5em 0'>{part}</p>" for part in parts)


BACK, RESTORE, NEXT = "Back", "Restore settings", "Next"
NEXT_STEP, NEXT_LESSON = "Next step", "Next lesson: {}"
QUIET = (84, 92, 105)  # of buttons beside the one that comes next
# viser's buttons are one line high; the words of an answer may need more.
WRAPPED = (
    "<style>button[style*='height: 2em'] {height: auto !important; min-height: 2em; padding-block: 0.3em}"
    "button[style*='height: 2em'] .mantine-Button-label {white-space: normal; line-height: 1.25}</style>"
)


class LessonControls:
    """Owns the buttons and the text.

    `titles`: of the lessons, in their order; `tab`: whose methods the buttons call. `lessons`: button of each lesson,
    by its title; `text`: HTML of the step; `answers`: buttons with the words of the answers; `navigation`: group of
    BACK, RESTORE and NEXT; `following`: button that goes to the next step, or starts the next lesson; `end`: button
    that ends the lesson.
    """

    def __init__(self, gui: viser.GuiApi, titles: Sequence[str], tab: LessonsTab):
        gui.add_html(WRAPPED)
        self.text = gui.add_html("")
        self.lessons = {title: _on(gui.add_button(title, color=QUIET), partial(tab.start, title)) for title in titles}
        self.answers = [
            _on(gui.add_button("", color=QUIET, visible=False), partial(tab.answer, number))
            for number in range(MAX_CHOICES)
        ]
        button = gui.add_button("Next lesson", icon=viser.Icon.PLAYER_TRACK_NEXT, visible=False)
        self.following = _on(button, tab.follow)
        self.navigation = gui.add_button_group("Step", (RESTORE,), visible=False)
        _on(self.navigation, lambda: tab.go(self.navigation.value))
        self.end = _on(gui.add_button("End lesson", icon=viser.Icon.X, color=QUIET, visible=False), tab.end)

    def show(self, text: str, answers: Sequence[str], steps: Sequence[str], following: str, lesson: bool) -> None:
        """Bring the controls up to date.

        `text`: HTML of the step; `answers`: that can be given now; `steps`: labels of the navigation; `following`: what
        comes next, once the question is answered; or ""; `lesson`: whether there is a lesson.
        """
        self.text.content = text
        for button in self.lessons.values():
            button.visible = not lesson
        for number, button in enumerate(self.answers):
            button.visible = number < len(answers)
            if button.visible:
                button.label = answers[number]
        self.following.visible = bool(following)
        if following:
            self.following.label = following
        self.navigation.visible = self.end.visible = lesson
        if lesson:
            self.navigation.options = tuple(steps)


def _on(handle, act: Callable[[], object]):
    """Call `act` when a client has clicked a button; return the button."""

    @handle.on_click
    async def _(event) -> None:
        if event.client is not None:
            act()

    return handle


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

    def end_opening(self) -> None:
        """End the opening where it plays."""
        ...


class LessonsTab:
    """Owns the controls of the tab, the settings that wait for a scene, and what the page showed before.

    All methods run on viser's event loop, except `show` and `close`.
    """

    def __init__(self, page: LessonPage, lessons: Sequence[Lesson]):
        self._page = page
        self._lessons = {lesson.title: lesson for lesson in lessons}
        self.progress, self._error = LessonProgress(), ""
        self._before: PageBefore | None = None  # the first lesson
        self._returning: PageBefore | None = None  # what is being opened again after a lesson
        self._requests: list[OpenRequest] = []  # of the lessons since the first
        # What waits for the scene of a request.
        self._pending: tuple[OpenRequest, Callable[[Viewer], None]] | None = None
        with page.panels.tab("Lessons"):
            self.controls = LessonControls(page.panels.gui, tuple(self._lessons), self)
        self._redraw()

    @property
    def active(self) -> bool:
        """Whether a lesson is in progress."""
        return self.progress.lesson is not None

    def start(self, title: str, number: int = 0) -> None:
        """Start a lesson, by its title, at a step, counted from 0; ignore any other text."""
        viewer, lesson = self._page.viewer, self._lessons.get(title)
        if lesson is None:
            return
        if viewer is not None and self.progress.lesson is None:
            self._before = self._returning or PageBefore.of(viewer, self._page.nodes.cameras)
        self._returning = None
        self.progress = LessonProgress(lesson, number)
        self._set_up(fresh=True)

    def open(self, name: str, number: int) -> None:
        """Show a step of a lesson, by the lesson's name and the step's number from 1, unless it is shown already.

        Raises InputError: there is no such lesson or step.
        """
        lesson = next((lesson for lesson in self._lessons.values() if name in (lesson.name, lesson.title)), None)
        if lesson is None or not 1 <= number <= len(lesson.steps):
            remedy = f"use {', '.join(lesson.name for lesson in self._lessons.values())}, and a step that it has"
            raise InputError(f'there is no step {number} of a lesson "{shown(name)}"', remedy, key="lesson", value=name)
        if (self.progress.lesson, self.progress.number) != (lesson, number - 1):
            self.start(lesson.title, number - 1)

    def end(self) -> None:
        """End the lesson, and show what the page showed before, unless the user has opened something else."""
        before, viewer = self._before, self._page.viewer
        self.progress, self._before, self._pending, self._error = LessonProgress(), None, None, ""
        if before is not None and viewer is not None:
            if self._page.switcher.idle and self._left(before, viewer):
                before.close()
            elif viewer.binding.run is before.run and self._page.switcher.idle:
                self._put_back(before, viewer)
            else:
                request, self._returning = before.request(), before
                self._page.open(request)
                self._pending = request, lambda shown: self._put_back(before, shown)
        self._requests = []
        self._redraw()

    def leave(self) -> None:
        """End the lesson, and stay where it is: the user has opened something else."""
        before, self.progress, self._before = self._before, LessonProgress(), None
        self._pending, self._error, self._requests = None, "", []
        if before is not None:
            before.close()
        self._redraw()

    def _left(self, before: PageBefore, viewer: Viewer) -> bool:
        """Whether the user has opened something else during the lesson."""
        opening = viewer.binding.run.opening
        return viewer.binding.run is not before.run and not any(opening is request for request in self._requests)

    def _put_back(self, before: PageBefore, viewer: Viewer) -> None:
        self._returning = None
        before.put_back(viewer, self._page.nodes.cameras)

    def follow(self) -> None:
        """Go to the next step; after the last one, start the next lesson, if there is one."""
        if self.progress.moved(1) is not None:
            self.go(NEXT)
        else:
            self.start(self._next_lesson)

    @property
    def _next_lesson(self) -> str:
        """Title of the lesson after the present one, "" after the last."""
        titles, lesson = list(self._lessons), self.progress.lesson
        place = len(titles) if lesson is None or lesson.title not in titles else titles.index(lesson.title) + 1
        return titles[place] if place < len(titles) else ""

    def go(self, where) -> None:
        """Go BACK or NEXT, or RESTORE the settings of the step; ignore anything else."""
        if where not in (BACK, RESTORE, NEXT):
            return
        progress = self.progress.moved({BACK: -1, RESTORE: 0, NEXT: 1}[where])
        if progress is not None:
            self.progress = progress
            self._set_up()

    def answer(self, number: int) -> None:
        """Give an answer, counted from 0; only the first one counts."""
        step = self.progress.step
        if step is None or self.progress.choice >= 0 or not 0 <= number < len(step.choices):
            return
        self.progress = replace(self.progress, choice=number)
        self._set_up()

    def _set_up(self, fresh: bool = False) -> None:
        """Set the page as the present step requires, the scene first; a `fresh` lesson may begin at any step."""
        progress, self._pending, self._error = self.progress, None, ""
        self._redraw()
        lesson, step = progress.lesson, progress.step
        if lesson is None or step is None:
            return
        revealed = progress.choice >= 0
        settings = [step.page, step.then] if revealed else [step.page]
        if fresh:  # a step leaves out what the steps before it have set
            settings = [one for past in lesson.steps[: progress.number] for one in (past.page, past.then)] + settings
            settings = settings[max(i for i, one in enumerate(settings) if one.begins) :]

        def begin() -> None:
            start = lesson.start(progress.number, revealed)
            if start is None:
                raise InputError(f'the lesson "{lesson.title}" names no scene', "give its first step a scene")
            self._begin(settings, *start, fresh)

        self._guarded(begin)

    def _begin(self, settings: list[Setting], scene: Scene, seed: int, fresh: bool = False) -> None:
        """Apply the last of `settings`; if another scene has to be opened first, all settings of this step."""
        viewer, setting = self._page.viewer, settings[-1]
        first = fresh or (self.progress.number == 0 and len(settings) == 1)
        if viewer is None or first or viewer.binding.run.scene != scene or self._is_before(viewer):
            self._open(OpenRequest(scene, start_seed=seed, choices=plain_choices()), settings)
            return
        restarted = setting.begins or bool(setting.reset)
        if restarted:
            viewer.binding.session.reset(seed)
        self._apply(setting, viewer, restarted)

    def _open(self, request: OpenRequest, settings: list[Setting]) -> None:
        """Open a scene with the controls that a page begins with, so that a lesson depends on nothing before it."""
        self._page.open(request)
        self._requests.append(request)
        waiting = settings[-1:] if settings[-1].begins else settings
        self._pending = request, lambda shown: self._apply_all(waiting, shown)
        self._redraw()

    def _is_before(self, viewer: Viewer) -> bool:
        """Whether the page still shows the session from before the lesson, which no lesson changes."""
        return self._before is not None and viewer.binding.run is self._before.run

    def _apply(self, setting: Setting, viewer: Viewer, restarted: bool) -> None:
        apply_setting(setting, viewer.tabs, self._page.nodes.cameras.request_all, restarted)

    def show(self, call: Callable[[Callable[[], None]], object] = lambda function: function()) -> None:
        """Do what waits for a scene once it is shown; called by the main loop.

        `call`: runs a function on viser's event loop.
        """
        pending, viewer = self._pending, self._page.viewer
        if pending is None:
            return
        request, act = pending
        if viewer is not None and viewer.binding.run.opening is request:
            self._pending = None
            call(lambda: self._guarded(lambda: self._act(act, viewer)))
        elif self._page.switcher.idle:
            self._pending = None
            call(self._give_up)

    def _give_up(self) -> None:
        """Wait no longer: the scene was refused or cancelled, or the user has opened another one."""
        if self._returning is not None:
            self._returning.close()
            self._returning = None
        self._redraw()

    def _act(self, act: Callable[[Viewer], None], viewer: Viewer) -> None:
        if viewer is self._page.viewer:
            act(viewer)
        self._redraw()

    def _apply_all(self, settings: list[Setting], viewer: Viewer) -> None:
        viewer.tabs.run_bar.use_rate(MAX_RATE)  # a lesson does not depend on the speed chosen before
        for setting in settings:
            self._apply(setting, viewer, restarted=setting is settings[0])

    def close(self) -> None:
        """End the threads of a race that waits for the end of a lesson."""
        for before in filter(None, (self._before, self._returning)):
            before.close()

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
        waits = "" if self._before is None else RACE_WAITS if self._before.has_race else WAITS
        text = step_html(lesson, progress.number, progress.choice, ready, waits) + complaint(self._error)
        asked = step is not None and progress.choice < 0 and ready
        steps = (*((BACK,) * (progress.moved(-1) is not None)), RESTORE, *((NEXT,) * (progress.moved(1) is not None)))
        following = NEXT_STEP if progress.moved(1) is not None else NEXT_LESSON.format(self._next_lesson)
        following = following if progress.answered and ready and following != NEXT_LESSON.format("") else ""
        self.controls.show(text, step.choices if asked and step else (), steps, following, lesson is not None)
