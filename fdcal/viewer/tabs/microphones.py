"""The tab Mics: the error of each microphone against its distance from the first known one, and tables.

The tables are of the positions, of gain, phase and noise of each channel, and of the given positions as corrected.
"""

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
import viser
from viser import uplot

from ...assessment.words import fault_words
from ...model.gauge import position_errors
from ...model.measurement import Measurement
from ...model.validation import mm_text
from ...session.session import SessionView
from ..binding import Binding, Tab
from ..html import CARD
from ..plots import BLUE, RED, Plot, decades_of, dots
from ..scheduler import Memo
from ..state import PageState, PositionUncertainty

MAX_ROWS = 100  # of a table
GIVEN_HEAD = ("mic", "difference<br>(mm)", "&sigma;<br>(mm)", "given<br>(m)", "found<br>(m)")
HEAD = ("mic", "gain<br>(dB)", "phase<br>(&deg;)", "noise<br>(dB)")
MIN_ERROR, MAX_ERROR = 1e-3, 1e6  # mm, drawn for anything below, since logarithms have no zero, and above
STYLE = "<style>.mics td, .mics th {padding: 0 0.5em 0 0; text-align: left; white-space: nowrap}</style>"
SELECTED = " style='font-weight: 700; background: rgba(31,120,200,0.15)'"  # row of the microphone of the map
FAULTY = f" style='font-weight: 700; color: {RED}'"  # row of a channel or a position that is wrong


def _card(above: str, head: Sequence[str], rows: Sequence[str], below: str = "") -> str:
    """Return a table in small type, with texts above and below."""
    columns = "".join(f"<th>{text}</th>" for text in head)
    return (
        f"<div style='{CARD} font-size: var(--note); overflow-x: auto'>{above}<table class='mics'><tr>{columns}</tr>"
        f"{''.join(rows)}</table>{below}</div>"
    )


def _row(cells: Sequence[str], style: str = "") -> str:
    return f"<tr{style}>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"


def _named(name: str, faulty: bool) -> str:
    return ("&#9888; " if faulty else "") + escape(name)


def channel_table(measurement: Measurement, found: PositionUncertainty | None) -> str:
    """Return the verdict and a table of the channels, the faulty ones first; "" where there are none."""
    if found is None or found.channels is None:
        return ""
    channels, sought = found.channels, found.channels.gains_sought
    faults = {fault.name: fault_words(fault) for fault in channels.faults}
    names = [str(name) for name in measurement.names]
    rows = []
    for n in sorted(range(len(names)), key=lambda n: (names[n] not in faults, n))[:MAX_ROWS]:
        fault = faults.get(names[n], "")
        style = FAULTY if fault else ""
        cells = (
            _named(names[n], bool(fault)),
            f"{channels.gain_db[n]:+z.2f}" + (f" &plusmn; {channels.gain_sigma_db[n]:.2f}" if sought else ""),
            f"{channels.phase_deg[n]:+z.1f}" + (f" &plusmn; {channels.phase_sigma_deg[n]:.1f}" if sought else ""),
            f"{channels.noise_db[n]:+z.1f}",
        )
        rows.append(_row(cells, style))
        if fault:  # in a row of its own, for the panel is narrow
            rows.append(f"<tr{style}><td colspan='{len(HEAD)}' style='white-space: normal'>{escape(fault)}</td></tr>")
    return _card(f"<b>Verdict: {escape(found.verdict.replace('_', ' '))}</b><br>{escape(found.text)}", HEAD, rows)


def given_table(found: PositionUncertainty | None) -> str:
    """Return a table of the given positions as corrected, the most corrected first; "" where there are none."""
    if found is None or found.channels is None or not found.channels.given:
        return ""
    rows = []
    for one in sorted(found.channels.given, key=lambda one: -one.difference)[:MAX_ROWS]:
        places = (",<br>".join(f"{x:z.4f}" for x in place) for place in (one.given, one.found))
        cells = _named(one.name, one.wrong), mm_text(one.difference), f"&plusmn; {mm_text(one.sigma)}", *places
        rows.append(_row(cells, FAULTY if one.wrong else ""))
    return _card("<b>Given positions</b>", GIVEN_HEAD, rows)


def table(
    measurement: Measurement,
    positions: np.ndarray,
    sigma: np.ndarray | None,
    selected: int,
    sought: np.ndarray | slice = slice(None),
) -> str:
    """Return a table of the microphones, those with the largest errors first and the known ones last.

    `positions` (N, D) float64, metres, estimated; `sigma` (N,) float64, metres, one standard deviation of each, or
    None; `selected`: the microphone of the map, counted from 0; `sought`: numbers of the microphones by which a blind
    array is aligned; all unless given. Returns HTML, MAX_ROWS rows at most.
    """
    errors, known = measurement.errors(positions, sought), set(measurement.known.tolist())
    order = errors if errors is not None else sigma if sigma is not None else np.zeros(len(positions))
    rows = []
    for n in sorted(range(len(positions)), key=lambda n: (n in known, -float(order[n]), n))[:MAX_ROWS]:
        cells = [
            escape(str(measurement.names[n])) + (" known" if n in known else ""),
            ", ".join(f"{x:z.3f}" for x in positions[n]),
            *([] if errors is None else [_millimetres(errors[n])]),
            "" if sigma is None or n in known else _millimetres(float(sigma[n])),
        ]
        rows.append(_row(cells, SELECTED if n == selected else ""))
    error = [] if errors is None else [f"{'off nominal' if measurement.nominal else 'error'}<br>(mm)"]
    more = len(positions) - MAX_ROWS
    below = f"<div style='opacity: 0.65'>and {more} more with smaller errors</div>" if more > 0 else ""
    return STYLE + _card("", ("mic<br>", "position<br>(m)", *error, "&plusmn; &sigma;<br>(mm)"), rows, below)


FINEST = 1e-5  # metres, in the table: finer digits mean nothing, as a sigma of 0.00411 mm beside an error of 0


def _millimetres(length: float) -> str:
    """An error or a sigma, metres, as millimetres."""
    text = mm_text(length)
    return text if length >= FINEST or text == "0" else f"&lt; {mm_text(FINEST)}"


class MicrophonesTab(Tab):
    """Owns the plot and the tables."""

    interval = 0.3

    def __init__(self, binding: Binding):
        self._binding, gui = binding, binding.gui
        self.error_by_distance = ErrorByDistance(gui, binding.measurement)
        self.table, self.channels, self.given = gui.add_html(""), gui.add_html(""), gui.add_html("")

    def inputs(self, state: PageState) -> tuple:
        """Return what plot and tables show."""
        return state.view.state, state.view.index, state.microphone, state.uncertainty

    def show(self, tick: PageState) -> None:
        """Bring plot and tables up to date."""
        view, found, measurement = tick.view, tick.uncertainty, self._binding.measurement
        self.error_by_distance.show(view)
        sigma = None if found is None else found.sigma
        sought = slice(None) if tick.sought is None else tick.sought
        self.table.content = table(measurement, np.asarray(view.state.positions), sigma, tick.microphone, sought)
        self.channels.content, self.given.content = channel_table(measurement, found), given_table(found)


class ErrorByDistance:
    """Owns the plot of the paper's Fig. 5: errors now, and their mean over the run, on one logarithmic axis.

    There is no plot for an array without true positions or without known microphones.
    """

    def __init__(self, gui: viser.GuiApi, measurement: Measurement):
        self._truth, self._drawn = measurement.positions, Memo()
        self._states: list[Any] = []  # whose errors are in _sums
        self._sums: list[np.ndarray] = []  # of the errors up to each state, (N,) float64, mm
        self.plot: Plot | None = None
        if self._truth is None or not len(measurement.known):
            return
        first = measurement.known[0]
        distance = np.linalg.norm(self._truth - self._truth[first], axis=1)
        free = np.setdiff1d(np.arange(measurement.count), measurement.known)
        self._order = free[np.argsort(distance[free], kind="stable")]
        self._x = distance[self._order]
        series = (
            uplot.Series(label="distance (m)"),
            uplot.Series(label="mean over the run", stroke=RED, width=0, points=dots(7, RED, RED)),
            uplot.Series(label="now", stroke=BLUE, width=0, points=dots(7, BLUE, "transparent")),
        )
        self.plot = Plot(gui, f"Error (mm) against distance from known microphone {first}", series, "distance (m)")

    def show(self, view: SessionView) -> None:
        """Bring the plot up to date. The run ends with the state that is shown."""
        if self.plot is None or self._drawn.get(view.state, view.index):
            return
        self._drawn(lambda: True, view.state, view.index)
        history, kept = view.history, min(len(self._states), len(view.history))
        while kept and self._states[kept - 1] is not history[kept - 1]:
            kept -= 1
        self._states[kept:] = history[kept:]
        del self._sums[kept:]
        for state in history[kept:]:
            errors = 1e3 * position_errors(state.positions, self._truth)
            self._sums.append(errors + (self._sums[-1] if self._sums else 0.0))
        mean = self._sums[view.index] / (view.index + 1)
        here = self._sums[view.index] - (self._sums[view.index - 1] if view.index else 0.0)
        errors = [  # finite, as uPlot needs them
            np.clip(np.nan_to_num(values[self._order], nan=MAX_ERROR), MIN_ERROR, MAX_ERROR) for values in (mean, here)
        ]
        self.plot.show((self._x, *errors), decades_of(*errors))
