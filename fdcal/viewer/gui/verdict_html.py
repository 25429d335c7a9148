"""The verdict on a finished run as HTML: a coloured line with the words of `fdcal calibrate`."""

from __future__ import annotations

from html import escape

from ...session.calibrate import Assessment
from .html import CARD

# On a light page and on a dark one.
GOOD, DOUBTFUL = "light-dark(#1a7f37, #4cc26b)", "light-dark(#c2410c, #fb923c)"
LINE = 50  # characters of the words that fit into a line at least
LINES = 2  # of the words that are shown before a click shows all of them; one more where channels are odd
STYLE = (
    "<style>.fdcal-verdict summary {list-style: none; cursor: pointer}"
    ".fdcal-verdict summary::-webkit-details-marker {display: none}"
    ".fdcal-verdict[open] .fdcal-more {display: none}"
    ".fdcal-verdict:not([open]) summary div:first-child {display: -webkit-box; -webkit-box-orient: vertical;"
    " overflow: hidden}</style>"
)


def verdict_html(found: Assessment | None) -> str:
    """Return the code, the words, which name one sigma and odd channels, and the leave-one-out error; "" for None.

    Long words are cut, so that the controls below stay where they are; "show all" shows all of them.
    """
    if found is None:
        return ""
    colour = GOOD if found.verdict == "good" else DOUBTFUL
    error = found.evidence.leave_one_out_db
    figures = "" if error is None else f"leave-one-out error {error:.1f} dB"
    text = f"<b>{escape(verdict_word(found.verdict))}</b>: {escape(found.verdict_text)}"
    lines = LINES + bool(found.channels is not None and found.channels.faults)
    more = "<u class='fdcal-more'>show all</u>" if figures and len(text) > LINE * lines else ""
    rest = f"<div style='opacity: 0.85'>{' &ensp;'.join(filter(None, (figures, more)))}</div>" if figures else ""
    return (
        f"{STYLE}<div style='{CARD} font-size: 0.8em; line-height: 1.35; padding-bottom: 0.5em'>"
        f"<div style='border-left: 4px solid {colour}; padding-left: 0.6em'><details class='fdcal-verdict'>"
        f"<summary title='Click to read all of it'>"
        f"<div style='color: {colour}; -webkit-line-clamp: {lines}'>{text}</div>{rest}</summary></details></div></div>"
    )


def verdict_word(code: str) -> str:
    """Return the code of a verdict as words: "model mismatch" of "model_mismatch"."""
    return code.replace("_", " ")
