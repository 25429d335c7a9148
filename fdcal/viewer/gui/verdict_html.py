"""The verdict on a finished run as HTML: a coloured line with the words of `fdcal calibrate`."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

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
