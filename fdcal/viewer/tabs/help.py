"""The tab Help: keys, mouse, marks, and what the numbers mean."""

from html import escape

import viser

from ...graphics.annotations import MARKS as DRAWN
from ...model.room import MEASURED_AND_MODELLED
from ..gui.html import CARD
from ..gui.legend_html import legend
from ..hotkeys import KEYS

NUMBERS = {
    "Error (mm)": "distance from an estimated position to the true one, mean and largest over all microphones; of an"
    " array without known microphones after the best rotation, translation and reflection. Where the positions to"
    " compare with are nominal, those of a plan, it is called deviation",
    "Cost (dB)": "the part of the pressures that no sound field explains (Eq. 7 of the paper), over all modes of the"
    " measurement and relative to their power; it falls as the positions improve, with any solver",
    "Step, sweep": "one move of the solver; each microphone moved once",
    "Mode (Hz)": "a peak of the room's power spectrum, numbered from 1 at the lowest frequency. Microphones are"
    " numbered from 0",
    "f_max (Hz)": "highest frequency at which the array can resolve a sound field (Eq. 9)",
    "Order L": "2 L + 1 functions describe the field of a mode (Eq. 3)",
    "&plusmn; &sigma; (mm)": "standard deviation of a position, once the solver has finished",
}
MOUSE = {
    "drag": "rotates the scene; with the right button it moves the scene; the wheel zooms",
    "click a microphone": "shows its map",
    "drag a microphone": "shows the cost there; let go, it rolls into the minimum below it",
    "Shift and drag": "moves its estimate to the pointer; the maps of all other microphones follow",
    "Ctrl+K": "lists all commands by name",
    "W A S D Q E, arrows": "move the camera",
}
MARKS = (
    "<b>Trails</b> are pink. <b>Errors</b> are grey lines from the estimate to the true position. <b>Ellipses</b>"
    " contain the true position with a probability of 95 %. The map is dark where the cost is low: in dark areas the"
    " prediction matches what was recorded. Marks differ in shape as well as colour."
)
MORE = "The documentation, docs/ of the project, and the command <code>fdcal</code>, which lists all commands."


def text() -> str:
    """Return the contents of the tab as HTML."""
    keys = {key.name: escape(key.label) for key in KEYS}
    return (
        f"{_table('Keys', keys)}{_table('Mouse', MOUSE)}{_head('Marks')}"
        f"{legend(DRAWN.values())}<div style='{CARD}'>{MARKS}</div>"
        f"{_table('Numbers', NUMBERS)}{_head('Measured rooms')}<div style='{CARD}'>{MEASURED_AND_MODELLED}</div>"
        f"{_head('More')}<div style='{CARD}'>{MORE}</div>"
    )


def _head(title: str) -> str:
    return f"<div style='{CARD} font-weight: 600; margin-top: 0.4em'>{title}</div>"


def _table(title: str, rows: dict[str, str]) -> str:
    cells = "".join(
        f"<tr><td style='white-space: nowrap; vertical-align: top; padding-right: 0.8em'><b>{name}</b></td>"
        f"<td>{description}</td></tr>"
        for name, description in rows.items()
    )
    return f"{_head(title)}<div style='{CARD}'><table style='border-spacing: 0'>{cells}</table></div>"


def add_help(gui: viser.GuiApi) -> None:
    """Add the contents to the tab, in whose context this is called."""
    gui.add_html(text())
