"""The verdict on a finished run as HTML: a coloured line with the words of `fdcal calibrate`."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from ...session.assess import Assessment
from .html import CARD

# On a light page and on a dark one.
GOOD, DOUBTFUL = "light-dark(#1a7f37, #4cc26b)", "light-dark(#c2410c, #fb923c)"
LINES = 2  # of the words that are shown before a click shows all of them
STYLE = (
    "<style>.fdcal-verdict summary {list-style: none; cursor: pointer}"
    ".fdcal-verdict summary::-webkit-details-marker {display: none}"
    ".fdcal-verdict:not([open]) summary div {display: -webkit-box; -webkit-box-orient: vertical; overflow: hidden;"
    f" -webkit-line-clamp: {LINES}}}</style>"
)


def verdict_html(found: Assessment | None) -> str:
    """Return the code, the words, which name one sigma and odd channels, and the leave-one-out error; "" for None.

    Long words are cut after LINES lines, so that the controls below stay where they are; a click shows all of them.
    """
    if found is None:
        return ""
    colour = GOOD if found.verdict == "good" else DOUBTFUL
    error = found.evidence.leave_one_out_db
    figures = "" if error is None else f"leave-one-out error {error:.1f} dB"
    text = f"<b>{escape(verdict_word(found.verdict))}</b>: {escape(found.verdict_text)}"
    rest = f"<div style='opacity: 0.75'>{figures}</div>" if figures else ""
    return (
        f"{STYLE}<div style='{CARD} font-size: 0.8em; line-height: 1.35; padding-bottom: 0.5em'>"
        f"<div style='border-left: 4px solid {colour}; padding-left: 0.6em'><details class='fdcal-verdict'>"
        f"<summary title='Click to read all of it' style='color: {colour}'><div>{text}</div></summary></details>{rest}"
        "</div></div>"
    )


def verdict_word(code: str) -> str:
    """Return the code of a verdict as words: "model mismatch" of "model_mismatch"."""
    return code.replace("_", " ")


def sound(sought: np.ndarray, names: Sequence[str], found: Assessment | None) -> np.ndarray:
    """Return the microphones whose errors are averaged: those sought, without the odd channels of an assessment.

    Parameters
    ----------
    sought : (K,) int64
    names : of all microphones
    found : Assessment or None
    """
    faults = () if found is None or found.channels is None else found.channels.faults
    faulty = {fault.name for fault in faults if fault.kind != "misplaced"}
    kept = np.array([n for n in sought if names[n] not in faulty], np.int64)
    return kept if len(kept) else sought
