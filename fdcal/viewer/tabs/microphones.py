"""The tab Mics: a plot of errors over the distance from the first known microphone, and tables.

The tables have the positions, gain, phase and noise of each channel, and the corrections of the given positions.
"""

from html import escape

import numpy as np

from ...assessment.calibration import Channels
from ...graphics.lesson_panels import FAULTY, STYLE, channel_table, lesson_panel, named, table
from ...model.measurement import Measurement
from ...model.validation import mm_text
from ...session.worker import Memo
from ..html import CARD
from ..state import Binding, PageState, Tab

MAX_ROWS = 100  # largest number of rows of a table
GIVEN_HEAD = ("mic", "difference<br>(mm)", "&sigma;<br>(mm)", "given<br>(m)", "found<br>(m)")
SELECTED = " style='font-weight: 700; background: rgba(31,120,200,0.15)'"  # row of the microphone of the map


def given_table(channels: Channels | None) -> str:
    """Return a table of the given positions and their corrections, the largest first; "" if none is given."""
    if channels is None or not channels.given:
        return ""
    rows = []
    for one in sorted(channels.given, key=lambda one: -one.difference)[:MAX_ROWS]:
        places = (",<br>".join(f"{x:z.4f}" for x in place) for place in (one.given, one.found))
        cells = named(one.name, one.wrong), mm_text(one.difference), f"&plusmn; {mm_text(one.sigma)}", *places
        rows.append((cells, FAULTY if one.wrong else ""))
    return f"<div style='{CARD}'><b>Given positions</b></div>{table(GIVEN_HEAD, rows)}"


def position_table(
    measurement: Measurement, positions: np.ndarray, sigma: np.ndarray | None, selected: int, sought: np.ndarray | slice
) -> str:
    """Return a table of the microphones, the largest errors, or else the largest `sigma`, first, the known ones last.

    `positions` (N, D) float64, metres, are the estimates; `sigma` (N,) float64, metres, is their standard deviation, or
    None; `selected` is the microphone of the map, counted from 0; `sought` are the numbers of the microphones by which
    an array without known microphones is aligned. The table has MAX_ROWS rows at most.
    """
    errors, known = measurement.errors(positions, sought), set(measurement.known.tolist())
    order = errors if errors is not None else sigma if sigma is not None else np.zeros(len(positions))
    rows = []
    for n in sorted(range(len(positions)), key=lambda n: (n in known, -float(order[n]), n))[:MAX_ROWS]:
        cells = [
            escape(str(measurement.names[n])) + (" known" if n in known else ""),
            ", ".join(f"{x:z.3f}" for x in positions[n]),
            *([] if errors is None else [_millimetres(errors[n])]),
            *([] if sigma is None else ["" if n in known else _millimetres(float(sigma[n]))]),
        ]
        rows.append((cells, SELECTED if n == selected else ""))
    error = [] if errors is None else [f"{'off nominal' if measurement.nominal else 'error'}<br>(mm)"]
    more = len(positions) - MAX_ROWS
    below = f"<div style='{CARD} opacity: 0.65'>and {more} more</div>" if more > 0 else ""
    sigmas = [] if sigma is None else ["&plusmn; &sigma;<br>(mm)"]
    return STYLE + table(("mic<br>", "position<br>(m)", *error, *sigmas), rows) + below


FINEST = 1e-5  # metres, smallest length in the table


def _millimetres(length: float) -> str:
    """Return an error or a sigma, metres, in millimetres as a text."""
    text = mm_text(length)
    return text if length >= FINEST or text == "0" else f"&lt; {mm_text(FINEST)}"


class MicrophonesTab(Tab):
    """Owns the chart of the errors over the distance and the tables."""

    part, where = "microphones", "Mics"
    interval = 0.3

    def __init__(self, binding: Binding):
        self._binding, self._panel, gui = binding, Memo(), binding.gui
        self.by_distance, self.table = gui.add_html(""), gui.add_html("")
        self.channels, self.given = gui.add_html(""), gui.add_html("")

    def panel(self, name: str) -> str:
        """Return the panel of a lesson, by its name in `LessonSetting.panel`; "" while its content is not known."""
        state, view = self._binding.state, self._binding.state.view
        data = self._binding.measurement, view.history[: view.index + 1], state.found
        return self._panel(lambda: lesson_panel(name, *data), name, view.state, view.index, state.found)

    def inputs(self, state: PageState) -> tuple:
        """Return the values on which plot and tables depend."""
        return state.view.state, state.view.index, state.microphone, state.found, state.axes

    def show(self, tick: PageState) -> None:
        """Update plot and tables."""
        view, measurement = tick.view, self._binding.measurement
        found = tick.found if tick.axes is not None else None
        self.by_distance.content = lesson_panel("distance", measurement, view.history[: view.index + 1], None)
        sigma, channels = (None, None) if found is None else (found.uncertainty, found.channels)
        sought = slice(None) if tick.sought is None else tick.sought
        positions = np.asarray(view.state.positions)
        self.table.content = position_table(measurement, positions, sigma, tick.microphone, sought)
        self.given.content = given_table(channels)
        if found is not None:
            verdict = f"<b>Verdict: {escape(found.verdict.replace('_', ' '))}</b><br>{escape(found.verdict_text)}"
            rows = channel_table(measurement.names, found.channels, MAX_ROWS)
            self.channels.content = f"<div style='{CARD} font-size: var(--note)'>{verdict}</div>{rows}"
        else:
            self.channels.content = ""
