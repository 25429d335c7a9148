"""A step of a lesson as HTML; all texts of the lesson's file are escaped."""

from __future__ import annotations

from html import escape

from ...session.lesson import Lesson, Step
from .html import CARD

LETTERS = "ABCDEF"
INTRODUCTION = (
    "A lesson sets the controls for you, asks a question, and shows what happens. Everyone who has this page open"
    " follows the same lesson."
)


def step_html(lesson: Lesson | None, number: int, choice: int, ready: bool = True) -> str:
    """Return a step of a lesson, with the answer once one is chosen.

    Parameters
    ----------
    lesson : Lesson or None; without one, an introduction is returned
    number : int, of the step, from 0
    choice : int, the answer chosen, from 0; -1 before one is chosen
    ready : bool, whether the page shows what the step asks about; the question is left out until then

    Returns
    -------
    str
        HTML.
    """
    if lesson is None:
        return f"<div style='{CARD}'>{INTRODUCTION}</div>"
    step = lesson.steps[number]
    parts = [f"<div style='opacity: 0.65'>Step {number + 1} of {len(lesson.steps)}</div>"]
    if choice < 0:
        parts.append(_paragraphs(step.text))
    if ready:
        parts += _question(step, choice)
    else:
        parts.append(_bold("The picture of this step is being prepared ..."))
    return f"<div style='{CARD} line-height: 1.4'>{''.join(parts)}</div>"


def _question(step: Step, choice: int) -> list[str]:
    """Return the question, its choices and, once one is chosen, the answer."""
    parts = [_bold(escape(step.question))] if step.question else []
    right = step.answer - 1
    for i, text in enumerate(step.choices):
        mark = "" if choice < 0 else " &#10003;" if i == right else " &#10007;" if i == choice else ""
        weight = "font-weight: 600" if mark else ""
        parts.append(f"<div style='{weight}'>{LETTERS[i]}&ensp;{escape(text)}{mark}</div>")
    if choice >= 0:
        parts += [_bold("Right." if choice == right else f"The answer is {LETTERS[right]}."), _paragraphs(step.reveal)]
    return parts


def _bold(html: str) -> str:
    return f"<p style='margin: 0.5em 0; font-weight: 600'>{html}</p>"


def _paragraphs(text: str) -> str:
    """Return plain text as HTML; an empty line begins another paragraph."""
    parts = [escape(" ".join(part.split())) for part in text.split("\n\n") if part.strip()]
    return "".join(f"<p style='margin: 0.5em 0'>{part}</p>" for part in parts)
