"""A step of a lesson as HTML; all that comes from the file is escaped."""

from __future__ import annotations

from html import escape

from ...session.lesson import Lesson
from .html import CARD

LETTERS = "ABCDEF"


def told(taken: Lesson | None, number: int, choice: int, ready: bool = True) -> str:
    """A step of a `fdcal.session.lesson.Lesson`, from 0; with the reveal once a choice is made, from 0, -1 before.

    Nothing is asked about a picture that is not `ready`.
    """
    if taken is None:
        text = (
            "A lesson sets the controls for you, asks, and shows what happens. Everyone who has this page open follows."
        )
        return f"<div style='{CARD}'>{text}</div>"
    step = taken.steps[number]
    parts = [f"<div style='opacity: 0.65'>Step {number + 1} of {len(taken.steps)}</div>"]
    parts += [_paragraphs(step.text)] if choice < 0 else []  # what was read gives way to the reveal
    if not ready:
        parts.append("<p style='margin: 0.5em 0; font-weight: 600'>The picture of this step is being prepared ...</p>")
        return f"<div style='{CARD} line-height: 1.4'>{''.join(parts)}</div>"
    if step.question:
        parts.append(f"<p style='margin: 0.5em 0; font-weight: 600'>{escape(step.question)}</p>")
    for i, text in enumerate(step.choices):
        mark = "" if choice < 0 else " &#10003;" if i == step.answer - 1 else " &#10007;" if i == choice else ""
        bold = "font-weight: 600" if mark else ""
        parts.append(f"<div style='{bold}'>{LETTERS[i]}&ensp;{escape(text)}{mark}</div>")
    if choice >= 0:
        word = "Right." if choice == step.answer - 1 else f"It is {LETTERS[step.answer - 1]}."
        parts.append(f"<p style='margin: 0.5em 0; font-weight: 600'>{word}</p>{_paragraphs(step.reveal)}")
    return f"<div style='{CARD} line-height: 1.4'>{''.join(parts)}</div>"


def _paragraphs(text: str) -> str:
    """Plain text; an empty line begins another paragraph."""
    parts = [escape(" ".join(part.split())) for part in text.split("\n\n") if part.strip()]
    return "".join(f"<p style='margin: 0.5em 0'>{part}</p>" for part in parts)
