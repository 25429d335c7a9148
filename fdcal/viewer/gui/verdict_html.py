"""The verdict on a finished run as HTML: a coloured line with the words of `fdcal calibrate`."""

from __future__ import annotations

from html import escape

from ...session.assess import Assessment
from .html import CARD

GOOD, DOUBTFUL = "#1a7f37", "#c2410c"


def verdict_html(found: Assessment | None) -> str:
    """Return the code, the words, which name one sigma and odd channels, and the leave-one-out error; "" for None."""
    if found is None:
        return ""
    colour = GOOD if found.verdict == "good" else DOUBTFUL
    error = found.evidence.leave_one_out_db
    figures = "" if error is None else f"leave-one-out error {error:.1f} dB"
    text = f"<b>{escape(found.verdict)}</b>: {escape(found.verdict_text)}"
    rest = f"<span style='opacity: 0.75'>; {figures}</span>" if figures else ""
    return (
        f"<div style='{CARD} font-size: 0.8em; line-height: 1.35'>"
        f"<div style='border-left: 4px solid {colour}; padding-left: 0.6em'>"
        f"<span style='color: {colour}'>{text}</span>{rest}</div></div>"
    )
