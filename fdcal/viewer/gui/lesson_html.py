"""A step of a lesson as HTML; all texts of the lesson's file are escaped."""

from __future__ import annotations

from html import escape

from ...session.lesson import Lesson, Step
from .html import CARD

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
