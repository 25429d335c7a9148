"""Lessons: a text, a question and its answer on the canvas; each step sets the page's own controls.

All browsers on the page follow the same lesson. A step that needs another scene opens it first (`Page.open`), and sets
the controls as soon as the scene is ready. At the end of a lesson the page returns to what it showed before.
"""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from html import escape
from typing import Any

import viser

from ...graphics.camera import Camera
from ...model.address import SOLVER, parse_address, unit_of
from ...model.scene import Scene
from ...model.validation import InputError, StorageError, parse_modes, shown
from ...session.lesson import MAX_CHOICES, Lesson, LessonProgress, LessonSetting, paragraphs, run_target
from ...session.session import Session, SessionView
from ...session.sources import OpenRequest
from ..html import complaint, error_message, whole
from ..panels import Tabs
from ..prepare import PreparedRun
from ..scene3d import Cameras
from ..server.client_values import fits
from ..session_view import PageParts, Viewer
from ..state import Choices


def plain_choices() -> dict[str, Any]:
    """Return the choices that a page begins with, for an OpenRequest, except those of microphone and theme."""
    return {key: value for key, value in Choices().to_save().items() if key not in ("microphone", "dark")}


def apply_setting(setting: LessonSetting, tabs: Tabs, place: Callable[[str], None], restarted: bool) -> None:
    """Set the controls of a session that already shows the scene of `setting`.

    `place` moves the cameras of all browsers, or of one, to a view; `restarted`: whether the session is at its start,
    or will be after the commands in its queue. InputError if the setting names modes that were not measured.
    """
    setting, count = setting.unfolded(), tabs.binding.modes
    session = tabs.binding.session
    state = session.view.history[0] if restarted else session.view.state
    if (used := setting.modes_in_use(state, count)) is not None:
        session.use_modes(*used)
    if setting.run is not None:
        what, by = run_target(setting.run)
        if what == "end":
            session.play()
        else:
            session.step(by, what)
    if setting.frame is not None:
        show_frame(session, parse_address(setting.frame), session.view.history[: 1 if restarted else None])
    effects: dict[str, Callable[[Any], object]] = {
        "microphone": tabs.map.pick,
        "follow": tabs.map.follow_solver,
        "map": tabs.map.show_as,
        "map_modes": lambda text: tabs.map.choose_modes(None if text == SOLVER else parse_modes(text, count)),
        "quantity": lambda name: tabs.binding.choose(objective=name == "objective"),
        "scale": lambda name: tabs.binding.choose(log=name == "log"),
    }
    for name in ("order_offset", "minima", "trails", "ellipses", "verdict", "panel"):
        effects[name] = lambda value, name=name: tabs.binding.choose(**{name: value})
    effects["view"] = place
    for name, act in effects.items():
        if getattr(setting, name) is not None:
            act(getattr(setting, name))


def show_frame(session: Session, address: Mapping[str, str], states: Sequence) -> None:
    """Show the state of a run that an address names; if the run has not reached it, continue the run to it.

    `states`: those of the run so far.
    """
    unit = unit_of(address)
    if not unit:
        return
    wanted = int(address[unit]) - (unit == "stage")  # a state counts its stages from 0
    reached = [getattr(state, unit) for state in states]
    session.pause()
    if max(reached) >= wanted:
        session.seek(next(index for index, number in enumerate(reached) if number >= wanted))
        return
    session.seek(len(states) - 1)
    session.step(wanted - reached[-1], unit)


@dataclass(frozen=True)
class PageBefore:
    """The state of the page before a lesson."""

    run: PreparedRun
    view: SessionView  # the states of its run
    choices: Choices
    values: Mapping[tuple[str, str], Any]  # values of the controls that a user can set, by the names of `controls_of`
    cameras: Mapping[int, str | Camera]  # view of each browser, see `Cameras.kept_views`

    def put_back(self, viewer: Viewer, cameras: Cameras) -> None:
        """Restore this state in the viewer, which shows the session again; on viser's event loop."""
        viewer.binding.choose(**vars(self.choices))
        for name, handle in controls_of(viewer).items():
            value = self.values.get(name, handle.value)
            if handle.value != value and fits(handle, value):
                handle.value = value
        for tab in viewer.tabs.parts:
            tab.refresh()
        cameras.request_all(self.cameras)


def controls_of(viewer: Viewer) -> dict[tuple[str, str], Any]:
    """Return the controls in the panels that keep a value, unlike buttons, by the name of the tab and their own."""
    return {
        (tab.part, name): handle
        for tab in viewer.tabs.parts
        for name, handle in vars(tab).items()
        if isinstance(handle, viser.GuiInputHandle)
    }


INTRODUCTION = (
    "A lesson sets the controls for you, asks a question, and shows what happens. Everyone who has this page open"
    " follows the same lesson. When the lesson ends, the page returns to what it shows now."
)
WAITS = 'Your session is paused. "End lesson" returns to it, with all controls as they were.'


NEXT_STEP, NEXT_LESSON, HURRY = "Next step", "Next lesson: {}", "Run to the end"
PREPARED, RUNS = "The scene of this step is being prepared", "The solver is running"


def _button(command: str, text: str, kind: str = "") -> str:
    return f"<button data-do='{command}' class='{kind}'>{escape(text)}</button>"


log = logging.getLogger(__name__)


class LessonsTab:
    """The caption of the lesson that is shown, and the state of the page before the lesson, which is restored after it.

    All methods except `show` run on viser's event loop.
    """

    def __init__(self, page: PageParts, lessons: Sequence[Lesson]):
        self._page = page
        self._lessons = {lesson.title: lesson for lesson in lessons}
        self.progress, self._error = LessonProgress(), ""
        self._before: PageBefore | None = None  # the state of the page before the first lesson
        self._returning: PageBefore | None = None  # the state that is being restored after a lesson
        self._requests: list[OpenRequest] = []  # the requests of lessons since the first lesson
        self._pending: OpenRequest | None = None  # the request whose scene is being prepared
        self._then: Callable[[], object] = lambda: None  # called when the step is set
        self._ended: Callable[[SessionView], bool] | None = None  # returns whether the run of the step has ended
        self._panel = ""  # HTML below the text
        self._left_at: dict[str, int] = {}  # number of the step, from 0, at which each lesson was left, by title
        page.panels.overlay.acts |= {
            "lesson": lambda client, name: self.open(name),
            "answer": lambda client, number: self.answer(whole(number, 0, MAX_CHOICES - 1)),
            "follow": lambda client, value: self.follow(),
            "end": lambda client, value: self.end(),
            "hurry": lambda client, value: page.viewer is not None and page.viewer.tabs.run_bar.hurry(),
            "back": lambda client, value: self.go(-1),
            "restore": lambda client, value: self.go(0),
            "next": lambda client, value: self.go(1),
        }

    @property
    def _awaited(self) -> str:
        """The event for which the step waits, in words; "" if it does not wait."""
        return PREPARED if self._pending is not None else RUNS if self._ended is not None else ""

    @property
    def _next_lesson(self) -> str:
        """Title of the lesson after the present one, "" after the last."""
        titles, lesson = list(self._lessons), self.progress.lesson
        place = len(titles) if lesson is None or lesson.title not in titles else titles.index(lesson.title) + 1
        return titles[place] if place < len(titles) else ""

    @property
    def caption(self) -> str:
        """The HTML of the present step, with its answers as buttons or, after a choice, the right answer.

        It is "" without a lesson. While the step waits, the question or the explanation is left out.
        """
        progress, awaited = self.progress, self._awaited
        lesson, step, number, choice = progress.lesson, progress.step, progress.number, progress.choice
        if lesson is None or step is None:
            return ""
        last, answered, following = len(lesson.steps) - 1, choice >= 0, ""
        if progress.answered and not awaited:
            following = NEXT_STEP if number < last else self._next_lesson and NEXT_LESSON.format(self._next_lesson)
        panel = "" if self._pending is not None else self._panel
        body = "".join(f"<p>{escape(part)}</p>" for part in paragraphs(step.reveal if answered else step.text))
        text = f"<div class='text'>{body}</div>"
        parts = [f"<div class='dim'>{escape(lesson.title)}, step {number + 1} of {last + 1}</div>"]
        if number == 0 and not answered and self._before is not None:
            parts.append(f"<div class='dim'>{escape(WAITS)}</div>")
        if not answered:
            parts.append(text)
        if step.question and (answered or not awaited):
            parts.append(f"<b>{escape(step.question)}</b>")
        if awaited and answered:
            parts.append(f"<div>Your answer: <b>{escape(step.choices[choice])}</b></div>")
        if awaited:
            words = awaited + (
                ". The explanation follows when it has ended." if answered and awaited == RUNS else "&nbsp;..."
            )
            parts.append(f"<div class='awaited'>{words}</div>{panel}")
        elif step.question:
            right = step.answer - 1
            for i in sorted({choice, right} if answered else ()):  # the other answers are left out
                parts.append(f"<div>{'&#10003;' if i == right else '&#10007;'} <b>{escape(step.choices[i])}</b></div>")
            if answered:
                parts.append(f"<b>{'Right.' if choice == right else 'Not quite.'}</b>")
                parts.append(text)
            parts.append(panel)
        if not awaited and not answered and step.choices:
            buttons = "".join(_button(f"answer={i}", text) for i, text in enumerate(step.choices))
            parts.append(f"<div class='choices'>{buttons}</div>")
        steps = _button("follow", following, "first") if following else ""
        steps += _button("hurry", HURRY) if awaited == RUNS else ""
        steps += _button("back", "Back") if number else ""
        steps += _button("restore", "Restore settings") + (
            _button("next", "Next") if number < last and not following else ""
        )
        steps += _button("end", "End lesson")
        return f"{''.join(parts)}{complaint(self._error)}<div class='steps' id='fdcal-steps'>{steps}</div>"

    def list_html(self) -> str:
        """Return the lessons as buttons."""
        items = [f"<div class='dim'>{INTRODUCTION}</div>"]
        for lesson in self._lessons.values():
            at = self._left_at.get(lesson.title, 0)
            more = f", step {at + 1} of {len(lesson.steps)}" if at else ""
            pressed = str(lesson is self.progress.lesson).lower()
            name = escape(lesson.name or lesson.title)
            items.append(
                f"<button data-do='lesson={name}' aria-pressed='{pressed}'>{escape(lesson.title)}{more}</button>"
            )
        return "".join(items) if self._lessons else "<div class='dim'>There are no lessons.</div>"

    def open(self, name: str, number: int | None = None, then: Callable[[], object] = lambda: None) -> None:
        """Show step `number` of a lesson, counted from 1; None for the step at which the lesson was left.

        `name`: name of the lesson, its title, its number in the list, or the beginning of one name only. A step that is
        already shown does not begin again. `then` is called when the step is set. InputError if there is no such lesson
        or step.
        """
        lessons = list(self._lessons.values())
        named = [one for number, one in enumerate(lessons, 1) if name in (one.name, one.title, str(number))]
        named = named or [one for one in lessons if one.name.startswith(name)]
        if len(named) != 1:
            remedy = f"use {', '.join(one.name for one in lessons)}"
            raise InputError(f'there is no lesson "{shown(name)}"', remedy, key="lesson")
        (lesson,) = named
        at = self._left_at.get(lesson.title, 0) if number is None else number - 1
        if not 0 <= at < len(lesson.steps):
            problem = f'there is no step {number} of the lesson "{shown(name)}"'
            raise InputError(problem, f"use 1 to {len(lesson.steps)}", key="step")
        if number is not None and (self.progress.lesson, self.progress.number) == (lesson, at):
            then()
            return
        viewer, self._before = self._page.viewer, self._before or self._returning
        if viewer is not None and self.progress.lesson is None and self._before is None:
            viewer.run.session.pause()
            values = {name: handle.value for name, handle in controls_of(viewer).items()}
            run, choices, views = viewer.run, viewer.binding.choices, self._page.nodes.cameras.kept_views()
            self._before = PageBefore(run, run.session.view, choices, values, views)
        self._returning = None
        self.progress = LessonProgress(lesson, at)
        self._set_up(True, then)

    def end(self) -> None:
        """End the lesson, and restore the page as it was before, unless the user has opened something else."""
        before, requests, viewer = self._before, self._requests, self._page.viewer
        self.leave()
        if before is None or viewer is None:
            return
        idle, opening, cameras = self._page.switcher.idle, viewer.binding.run.opening, self._page.nodes.cameras
        if idle and viewer.binding.run is before.run:
            before.put_back(viewer, cameras)
        elif not idle or any(opening is request for request in requests):
            self._returning, request = before, before.run.request_of(before.view, before.choices.to_save())
            self._open(request, lambda shown: before.put_back(shown, cameras))

    def leave(self) -> None:
        """End the lesson without restoring the page, because the user has opened something else."""
        progress = self.progress
        if progress.lesson is not None:  # it continues at this step next time, or begins again if it was finished
            finished = progress.moved(1) is None and progress.answered
            self._left_at[progress.lesson.title] = 0 if finished else progress.number
        self.progress, self._before, self._pending, self._ended = LessonProgress(), None, None, None
        self._error, self._requests = "", []

    def follow(self) -> None:
        """Go to the next step; after the last one, start the next lesson, if there is one."""
        if self.progress.moved(1) is not None:
            self.go(1)
        elif self._next_lesson:
            self.open(self._next_lesson, 1)

    def go(self, count: int) -> None:
        """Go on by `count` steps, unless the lesson has no such step; 0 sets up the present step again."""
        progress = self.progress.moved(count)
        if progress is not None:
            self.progress = progress
            self._set_up()

    def answer(self, number: int) -> None:
        """Give an answer, counted from 0; later answers are ignored."""
        step = self.progress.step
        if step is None or self.progress.choice >= 0 or not 0 <= number < len(step.choices):
            return
        self.progress = replace(self.progress, choice=number)
        self._set_up()

    def _set_up(self, fresh: bool = False, then: Callable[[], object] = lambda: None) -> None:
        """Set the page for the present step, beginning with the scene; a `fresh` lesson may begin at any step."""
        progress, self._pending, self._ended, self._error, self._then = self.progress, None, None, "", then
        lesson, step = progress.lesson, progress.step
        if lesson is None or step is None:
            return
        revealed = progress.choice >= 0
        settings = [step.page, step.then] if revealed else [step.page]
        if fresh:  # because a step relies on the settings of the steps before it
            settings = [one for past in lesson.steps[: progress.number] for one in (past.page, past.then)] + settings
            settings = settings[max(i for i, one in enumerate(settings) if one.begins) :]
            begun = max(i for i, one in enumerate(settings) if one.begins or one.reset)  # earlier runs have no effect
            settings = [replace(one, run=None) if i < begun else one for i, one in enumerate(settings)]

        with self._guarded():
            start = lesson.start(progress.number, revealed)
            if start is None:
                raise InputError(f'the lesson "{lesson.title}" names no scene', "give its first step a scene")
            self._begin(settings, *start, fresh)

    def _begin(self, settings: list[LessonSetting], scene: Scene, seed: int, fresh: bool = False) -> None:
        """Apply the last of `settings`, or all of them if another scene has to be opened first."""
        viewer, setting = self._page.viewer, settings[-1]
        first = fresh or (self.progress.number == 0 and len(settings) == 1)
        place_all = self._page.nodes.cameras.request_all
        of_lesson = viewer is not None and (self._before is None or viewer.binding.run is not self._before.run)
        if viewer is not None and of_lesson and not first and viewer.binding.run.scene == scene:
            restarted = setting.begins or bool(setting.reset)
            before = viewer.binding.session.view
            if restarted:
                viewer.binding.session.reset(seed)
            apply_setting(setting, viewer.tabs, place_all, restarted)
            self._await(setting, viewer, before, restarted)
            return
        waiting = [setting] if setting.begins else settings

        def apply_all(shown: Viewer) -> None:
            shown.tabs.run_bar.limit_rate(None)  # a lesson does not depend on the speed chosen before
            before = shown.binding.session.view
            for one in waiting:
                apply_setting(one, shown.tabs, place_all, restarted=one is waiting[0])
            self._await(next((one for one in waiting[::-1] if one.run), setting), shown, before, False)

        # The controls have their initial values, so that a lesson does not depend on earlier choices.
        request = OpenRequest(scene, start_seed=seed, choices=plain_choices() | {"objective": False})
        self._requests.append(request)
        self._open(request, apply_all)

    def _open(self, request: OpenRequest, act: Callable[[Viewer], None]) -> None:
        """Open a scene, and call `act` with the viewer that shows it, unless another scene was requested meanwhile."""

        def then(shown: Viewer | None) -> None:
            if self._pending is not request:
                return
            self._pending = self._returning = None
            if shown is not None:  # the scene was not refused or cancelled, and the user has opened no other one
                with self._guarded():
                    act(shown)

        self._pending = request
        self._page.open(request, then)

    def _await(self, setting: LessonSetting, viewer: Viewer, before: SessionView, restarts: bool) -> None:
        """Wait for the end of the run of a setting, if any, before question, explanation and marks are shown."""
        (what, count), first = run_target(setting.run or "0 steps"), before.history[0] if restarts else before.state

        def ended(now: SessionView) -> bool:
            if now.running or (restarts and now is before):  # the commands of the setting have not begun
                return False
            reached = what != "end" and getattr(now.state, what) >= getattr(first, what) + count
            return reached or now.state.finished or bool(now.error)

        self._ended = ended if setting.run else None
        self._mark_named(viewer)
        self._then()

    def _mark_named(self, viewer: Viewer) -> None:
        """Mark the microphones that the step names, unless it still waits."""
        step, choice = self.progress.step, self.progress.choice
        marks = () if step is None or self._awaited else (step.page if choice < 0 else step.then).marks
        viewer.binding.choose(marks=marks)

    def show(self) -> None:
        """Check whether the run for which the step waits has ended, and update the caption; called by the main loop."""
        viewer = self._page.viewer
        if viewer is not None and self.progress.lesson is not None and self._pending is None:
            if self._ended is not None and self._ended(viewer.binding.session.view):
                self._ended = None
                viewer.binding.call(lambda: self._mark_named(viewer))
            self._panel = viewer.tabs.microphones.panel(viewer.binding.choices.panel)
        self._page.panels.overlay.show("caption", self.caption)

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """Show an exception on the page, and log it unless the user caused it."""
        try:
            yield
        except Exception as error:
            if not isinstance(error, (InputError, StorageError)):
                log.exception("a lesson's step could not be set")
            self._error = error_message(error)
