"""The controls of the tab Lessons: buttons alone, so that the keyboard's shortcuts work after each click.

A list keeps the focus after a choice, and takes the next key as a letter to search for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import viser

from ...session.lesson import MAX_CHOICES

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

    `titles`: of the lessons, in their order. `lessons`: button of each lesson, by its title; `text`: HTML of the step;
    `answers`: buttons with the words of the answers; `navigation`: group of BACK, RESTORE and NEXT; `following`: button
    that goes to the next step, or starts the next lesson; `end`: button that ends the lesson.
    """

    def __init__(self, gui: viser.GuiApi, titles: Sequence[str]):
        gui.add_html(WRAPPED)
        self.text = gui.add_html("")
        self.lessons = {title: gui.add_button(title, color=QUIET) for title in titles}
        self.answers = [gui.add_button("", color=QUIET, visible=False) for _ in range(MAX_CHOICES)]
        self.following = gui.add_button("Next lesson", icon=viser.Icon.PLAYER_TRACK_NEXT, visible=False)
        self.navigation = gui.add_button_group("Step", (RESTORE,), visible=False)
        self.end = gui.add_button("End lesson", icon=viser.Icon.X, color=QUIET, visible=False)

    def listen(
        self,
        start: Callable[[str], object],
        answer: Callable[[int], object],
        go: Callable[[object], object],
        follow: Callable[[], object],
        end: Callable[[], object],
    ) -> None:
        """Call `start(title)`, `answer(number)`, `go(label)`, `follow()` and `end()` when a client has clicked."""
        for title, button in self.lessons.items():
            _on(button, lambda _, title=title: start(title))
        for number, button in enumerate(self.answers):
            _on(button, lambda _, number=number: answer(number))
        _on(self.navigation, go)
        _on(self.following, lambda _: follow())
        _on(self.end, lambda _: end())

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
        if lesson and self.navigation.options != tuple(steps):  # buttons that are sent again lose the focus
            self.navigation.options = tuple(steps)


def _on(handle, act: Callable[[object], object]) -> None:
    """Call `act(value)` when a client has clicked a button."""

    @handle.on_click
    async def _(event) -> None:
        if event.client is not None:
            act(event.target.value)
