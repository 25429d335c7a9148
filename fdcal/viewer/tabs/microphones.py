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
from ...graphics.glyphs import round_ticks, tick_texts
from ...model.gauge import position_errors
from ...model.measurement import Measurement
from ...model.validation import mm_text
from ...session.session import SessionView
from ..binding import Binding, Tab
from ..html import CARD, remark
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


def channel_table(measurement: Measurement, found: PositionUncertainty | None, most: int = MAX_ROWS) -> str:
    """Return a table of the channels, the faulty ones first, with the verdict above all of them; "" without channels.

    `most`: rows at most.
    """
    if found is None or found.channels is None:
        return ""
    channels, sought = found.channels, found.channels.gains_sought
    faults = {fault.name: fault_words(fault) for fault in channels.faults}
    names = [str(name) for name in measurement.names]
    rows = []
    for n in sorted(range(len(names)), key=lambda n: (names[n] not in faults, n))[:most]:
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
    verdict = f"<b>Verdict: {escape(found.verdict.replace('_', ' '))}</b><br>{escape(found.text)}"
    return _card(verdict if most == MAX_ROWS else "", HEAD, rows)


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


WIDE, HIGH, EDGES = 330, 135, (38, 16, 8, 32)  # of a chart, its own units; left, top, right, bottom
FEW = 4  # rows of a list on the canvas


def chart(
    x: np.ndarray, y: np.ndarray, labels: tuple[str, str], means: Sequence[tuple] = (), red: Sequence[int] = ()
) -> str:
    """Return points (P,) as SVG with both axes.

    `labels`: of both axes, with their units; `means`: horizontal lines, each from where to where, how high, and a word;
    `red`: the points that are red.
    """
    left, top, right, bottom = EDGES
    low, high = min(0.0, float(y.min())), max(0.0, 1.15 * float(y.max()), *(1.15 * level for *_, level, _ in means))
    first, last = float(x.min()), float(x.max())

    def across(value: float) -> float:
        return left + 8 + (WIDE - left - right - 16) * (value - first) / max(last - first, 1e-9)

    def down(value: float) -> float:
        return HIGH - bottom - (HIGH - top - bottom) * (value - low) / max(high - low, 1e-9)

    parts = [f"<path class='axes' d='M{left} {top}V{HIGH - bottom}H{WIDE - right}'/>"]
    for value, text in zip(ticks := round_ticks(low, high, 4), tick_texts(ticks), strict=True):
        parts.append(f"<text x='{left - 5}' y='{down(value) + 4:.1f}' text-anchor='end'>{text}</text>")
    for value, text in zip(ticks := round_ticks(first, last, 5), tick_texts(ticks), strict=True):
        parts.append(f"<text x='{across(value):.1f}' y='{HIGH - bottom + 14}' text-anchor='middle'>{text}</text>")
    parts.append(f"<text x='{left}' y='10'>{labels[1]}</text>")
    parts.append(f"<text x='{WIDE - right}' y='{HIGH - 3}' text-anchor='end'>{labels[0]}</text>")
    for a, b, level, word in means:
        parts.append(f"<path class='mean' d='M{across(a):.1f} {down(level):.1f}H{across(b):.1f}'/>")
        at, end = (a, "start") if a - first < last - b else (b, "end")
        place = f"x='{across(at):.1f}' y='{down(level) - 5:.1f}' text-anchor='{end}'"
        parts.append(f"<text class='mean' {place}>{word}</text>")
    for i, (a, b) in enumerate(zip(x, y, strict=True)):
        parts.append(f"<circle class='{'wrong' if i in red else ''}' cx='{across(a):.1f}' cy='{down(b):.1f}' r='3.6'/>")
    return f"<svg class='chart' viewBox='0 0 {WIDE} {HIGH}' role='img' aria-label='{labels[1]}'>{''.join(parts)}</svg>"


class MicrophonesTab(Tab):
    """Owns the plot and the tables."""

    where = "Mics"
    interval = 0.3

    def __init__(self, binding: Binding):
        self._binding, gui = binding, binding.gui
        self.error_by_distance = ErrorByDistance(gui, binding.measurement)
        self.table, self.channels, self.given = gui.add_html(""), gui.add_html(""), gui.add_html("")

    def panel(self, name: str) -> str:
        """Return what a lesson shows below its text, as `LessonSetting.panel` calls it; "" while it is not known."""
        state, measurement = self._binding.state, self._binding.measurement
        if name == "distance" and (drawn := self.error_by_distance.data(state.view)) is not None:
            x, mean, _ = drawn
            near = x <= np.median(x)
            halves = []
            for word, half in (("nearer", near), ("farther", ~near)):
                level = float(mean[half].mean())
                halves.append((x[half].min(), x[half].max(), level, f"{word} half {mm_text(level / 1e3, 2)} mm"))
            labels = "distance from the first known microphone (m)", "mean error over the run (mm)"
            return chart(x, mean, labels, halves)
        if state.found is None or state.uncertainty is None:
            return ""
        channels = state.uncertainty.channels
        if name == "channels":
            more = remark(f"and {measurement.count - FEW} more") if measurement.count > FEW else ""
            return f"<div class='list'>{STYLE}{channel_table(measurement, state.uncertainty, FEW)}{more}</div>"
        if name == "prediction":
            y, faults = np.array(state.found.evidence.microphones_db), () if channels is None else channels.faults
            faulty = [list(measurement.names).index(fault.name) for fault in faults]
            labels = "microphone", "error of what the others predict (dB re its power)"
            return chart(np.arange(len(y)), y, labels, red=faulty)
        return ""

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
        """Bring the plot up to date."""
        if (drawn := self.data(view)) is not None and self.plot is not None:
            self.plot.show(drawn, decades_of(*drawn[1:]))

    def data(self, view: SessionView) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Return distances, m, mean errors over the run up to the state that is shown, and its errors, mm; or None."""
        return None if self.plot is None else self._drawn(lambda: self._compute(view), view.state, view.index)

    def _compute(self, view: SessionView) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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
        return self._x, errors[0], errors[1]
