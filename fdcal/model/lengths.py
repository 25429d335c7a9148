"""Lengths as texts."""

from __future__ import annotations


def format_mm(length: float) -> str:
    """Return a length in metres as a text in millimetres: "4.13 mm", "535 mm"."""
    return f"{mm_text(length)} mm"


def length_text(length: float, digits: int = 3) -> str:
    """Return a length in metres as a text, in metres from 1 m on: "4.13 mm", "1.16 m".

    `length`: metres; `digits`: of a length below a decimetre; from there on millimetres are whole, and metres have
    three digits.
    """
    return f"{mm_text(length, digits)} mm" if length < 0.9995 else f"{length:.{max(3, len(str(int(length))))}g} m"


def mm_text(length: float, digits: int = 3) -> str:
    """Return the number of millimetres of a length in metres, with `digits` digits below a decimetre."""
    if length < 1e-6:
        return "0"
    return f"{1e3 * length:.{digits}g}" if length < 0.0995 else f"{1e3 * length:.0f}"
