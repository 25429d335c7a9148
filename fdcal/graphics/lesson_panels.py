"""The panel below the text of a lesson, on the page and in the gallery: a plot or a list of channels, as HTML."""

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import numpy as np

from ..assessment.assess import Assessment
from ..assessment.calibration import Channels
from ..assessment.words import fault_words
from ..model.gauge import position_errors
from ..model.measurement import Measurement
from ..model.validation import mm_text
from .glyphs import round_ticks, tick_texts
from .marks import ESTIMATE, css

MIN_ERROR, MAX_ERROR = 1e-3, 1e6  # mm; smaller and larger errors are drawn as these
WIDTH, HEIGHT, MARGINS = 330, 135, (38, 16, 8, 32)  # size of a chart, and its margins left, top, right, bottom
POINT, LETTER = 3.6, 6.5  # radius of a point, and mean width of a letter, in units of the chart
FEW = 4  # number of channels that a list shows
STYLE = "<style>.mics td, .mics th {padding: 0 0.5em 0 0; text-align: left; white-space: nowrap}</style>"
HEAD = ("mic", "gain<br>(dB)", "phase<br>(&deg;)", "noise<br>(dB)")
FAULTY = f" style='font-weight: 700; color: {css(ESTIMATE)}'"  # row of a channel or a position that is wrong


def lesson_panel(name: str, measurement: Measurement, states: Sequence, found: Assessment | None) -> str:
    """Return a panel of a lesson; "" while what it shows is not known.

    `name`: a value of `LessonSetting.panel`; `states`: states of the run so far; `found`: the assessment of the last
    state, or None.
    """
    truth, known = measurement.positions, measurement.known
    free = np.setdiff1d(np.arange(measurement.count), known)
    if name == "distance" and truth is not None and len(known) and len(free) > 1:
        x = np.linalg.norm(truth[free] - truth[known[0]], axis=1)
        order = np.argsort(x, kind="stable")
        errors = 1e3 * np.array([position_errors(state.positions, truth) for state in states])[:, free[order]]
        mean = np.clip(np.nan_to_num(errors, nan=MAX_ERROR).mean(axis=0), MIN_ERROR, MAX_ERROR)
        x = x[order]
        near, means = x <= np.median(x), []
        for word, half in (("nearer", near), ("farther", ~near)):
            if half.any():  # at equal distances the farther half is empty
                level = float(mean[half].mean())
                means.append((x[half].min(), x[half].max(), level, f"{word} half {mm_text(level / 1e3, 2)} mm"))
        return chart(x, mean, ("distance from the first known microphone (m)", "mean error over the run (mm)"), means)
    if found is None:
        return ""
    if name == "channels":
        more = measurement.count - FEW
        below = f"<div style='opacity: 0.75'>and {more} more</div>" if more > 0 else ""
        return f"<div class='list'>{STYLE}{channel_table(measurement.names, found.channels, FEW)}{below}</div>"
    if name == "prediction":
        errors = np.array(found.evidence.microphones_db)
        faulty = [measurement.names.index(fault.name) for fault in found.channels.faults]
        labels = "microphone", "error of predicting it from the others (dB re power)"
        return chart(np.arange(len(errors)), errors, labels, red=faulty)
    return ""


def chart(
    x: np.ndarray, y: np.ndarray, labels: tuple[str, str], means: Sequence[tuple] = (), red: Sequence[int] = ()
) -> str:
    """Return points (P,) as SVG with both axes.

    `labels`: texts of both axes, with units; `means`: horizontal lines, each with its two ends, its height and its
    text; `red`: indices of the points that are red.
    """
    left, top, right, bottom = MARGINS
    low, high = min(0.0, float(y.min())), max(0.0, (1.35 if means else 1.15) * float(y.max()))
    first, last = float(x.min()), float(x.max())

    def across(value: float) -> float:
        return left + 8 + (WIDTH - left - right - 16) * (value - first) / max(last - first, 1e-9)

    def down(value: Any) -> Any:
        return HEIGHT - bottom - (HEIGHT - top - bottom) * (value - low) / max(high - low, 1e-9)

    parts = [f"<path class='axes' d='M{left} {top}V{HEIGHT - bottom}H{WIDTH - right}'/>"]
    for value, text in zip(ticks := round_ticks(low, high, 4), tick_texts(ticks), strict=True):
        parts.append(f"<text x='{left - 5}' y='{down(value) + 4:.1f}' text-anchor='end'>{text}</text>")
    for value, text in zip(ticks := round_ticks(first, last, 5), tick_texts(ticks), strict=True):
        parts.append(f"<text x='{across(value):.1f}' y='{HEIGHT - bottom + 14}' text-anchor='middle'>{text}</text>")
    parts.append(f"<text x='{left}' y='10'>{labels[1]}</text>")
    parts.append(f"<text x='{WIDTH - right}' y='{HEIGHT - 3}' text-anchor='end'>{labels[0]}</text>")
    for a, b, level, word in means:
        parts.append(f"<path class='mean' d='M{across(a):.1f} {down(level):.1f}H{across(b):.1f}'/>")
        at, end = (a, "start") if a - first < last - b else (b, "end")
        beside = [across(value) - across(at) for value in x]
        covers = np.array([0 < (-d if end == "end" else d) + POINT < LETTER * len(word) + 2 * POINT for d in beside])
        rows = down(level) - 5, down(level) + 13, top + 8  # of the word: above the line, below it, at the top
        hidden = [np.sum(np.abs(down(y[covers]) - (row - 4)) < 5 + POINT) for row in rows]
        place = f"x='{across(at):.1f}' y='{rows[int(np.argmin(hidden))]:.1f}' text-anchor='{end}'"
        parts.append(f"<text class='mean' {place}>{word}</text>")
    for i, (a, b) in enumerate(zip(x, y, strict=True)):
        kind = "wrong" if i in red else ""
        parts.append(f"<circle class='{kind}' cx='{across(a):.1f}' cy='{down(b):.1f}' r='{POINT}'/>")
    box = f"viewBox='0 0 {WIDTH} {HEIGHT}'"
    return f"<svg class='chart' {box} role='img' aria-label='{labels[1]}'>{''.join(parts)}</svg>"


def channel_table(names: Sequence[str], channels: Channels, count: int) -> str:
    """Return a table of the channels, the faulty ones first, `count` channels at most."""
    faults = {fault.name: fault_words(fault) for fault in channels.faults}
    rows = []
    for n in sorted(range(len(names)), key=lambda n: (names[n] not in faults, n))[:count]:
        fault, sought = faults.get(names[n], ""), channels.gains_sought
        style = FAULTY if fault else ""
        cells = (
            named(names[n], bool(fault)),
            f"{channels.gain_db[n]:+z.2f}" + (f" &plusmn; {channels.gain_sigma_db[n]:.2f}" if sought else ""),
            f"{channels.phase_deg[n]:+z.1f}" + (f" &plusmn; {channels.phase_sigma_deg[n]:.1f}" if sought else ""),
            f"{channels.noise_db[n]:+z.1f}",
        )
        rows.append((cells, style))
        if fault:  # in a separate row, because the panel is narrow
            rows.append(((escape(fault),), style))
    return table(HEAD, rows)


def table(head: Sequence[str], rows: Iterable[tuple[Sequence[str], str]]) -> str:
    """Return a table in small type; `rows`: cells and style of each row; a single cell spans all columns."""
    columns = "".join(f"<th>{text}</th>" for text in head)
    body = ""
    for cells, style in rows:
        wide = f" colspan='{len(head)}' style='white-space: normal'" if len(cells) == 1 else ""
        body += f"<tr{style}>{''.join(f'<td{wide}>{cell}</td>' for cell in cells)}</tr>"
    return (
        "<div style='padding: 0.15em 0.75em; line-height: 1.5; font-size: var(--note); overflow-x: auto'>"
        f"<table class='mics'><tr>{columns}</tr>{body}</table></div>"
    )


def named(name: str, faulty: bool) -> str:
    """Return the name of a microphone, after a warning sign if it is faulty."""
    return ("&#9888; " if faulty else "") + escape(name)
