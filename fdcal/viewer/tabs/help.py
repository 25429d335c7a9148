"""The tab Help: keys, what shapes and colours mean, what the numbers are, where more is told."""

from __future__ import annotations

from html import escape

import viser

from ..gui.html import CARD, legend
from ..hotkeys import KEYS

NUMBERS = {
    "Error (mm)": "from a supposed place to the true one, mean and largest over all microphones; of an array without"
    " known microphones after the best motion and mirror",
    "Cost": "what no sound field explains of the pressures (Eq. 7 of the paper), summed over the modes in use; without"
    " dimension, for each mode is scaled to unit RMS",
    "Step, sweep, stage": "one move of the solver; each microphone once; one set of modes",
    "Mode (Hz)": "a peak of the room's power spectrum, counted from the lowest. Microphones count from 0",
    "f_max (Hz)": "up to which the array can follow a field (Eq. 9)",
    "Order L": "2 L + 1 functions describe the field of a mode (Eq. 3)",
    "&plusmn; (mm)": "one sigma of a place, once the solver has finished",
}
HANDS = {
    "drag": "turns the scene; with the right button it shifts it, the wheel comes closer",
    "click a microphone": "shows its map",
    "drag a microphone": "moves its supposed place, and every map but its own follows",
    "Ctrl+K": "all commands, to be found by name",
    "W A S D Q E, arrows": "move the camera",
}


def text() -> str:
    """The whole tab as HTML."""
    keys = {key.face: escape(key.label) for key in KEYS}
    marks = (
        "<b>Trails</b> are pink, <b>errors</b> grey lines from cross to circle, <b>ellipses</b> hold 95 %. The map is"
    )
    marks += " dark where the cost is low. Every mark has a shape of its own: none is told by its colour alone."
    more = "README.md and docs/ of the project, and <code>fdcal --help</code>."
    return (
        f"{_table('Keys', keys)}{_table('Mouse', HANDS)}{_head('Marks')}{legend()}<div style='{CARD}'>{marks}</div>"
        f"{_table('Numbers', NUMBERS)}{_head('More')}<div style='{CARD}'>{more}</div>"
    )


def _head(title: str) -> str:
    return f"<div style='{CARD} font-weight: 600; margin-top: 0.4em'>{title}</div>"


def _table(title: str, rows: dict[str, str]) -> str:
    cells = "".join(
        f"<tr><td style='white-space: nowrap; vertical-align: top; padding-right: 0.8em'><b>{name}</b></td>"
        f"<td>{told}</td></tr>"
        for name, told in rows.items()
    )
    return f"{_head(title)}<div style='{CARD}'><table style='border-spacing: 0'>{cells}</table></div>"


def add_help(gui: viser.GuiApi) -> None:
    """Fill the tab, in whose context this is called."""
    gui.add_html(text())
