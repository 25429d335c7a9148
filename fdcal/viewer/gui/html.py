"""Status, legend and colour bar as HTML. Everything that comes from a file or a solver is escaped."""

from __future__ import annotations

from html import escape

import numpy as np

from ...graphics.heatmap import cost_label, to_rgb
from ...graphics.markers import ESTIMATE, KNOWN, LOWEST
from ...graphics.primitives import ColourBar, format_number
from ...graphics.units import format_mm, mm_text
from ...model.measurement import Measurement
from ...session.history import SessionView
from ..server.error_log import log_location

MOST_ROWS = 100  # of the table
CARD = "padding: 0.15em 0.75em; font-size: 0.86em; line-height: 1.5;"


def state_word(view: SessionView) -> str:
    """What the solver is doing."""
    if view.error:
        return "Stopped by an error"
    if view.running:
        return "Running"
    if view.state.finished:
        return "Finished, nothing moves any more" if view.state.converged else "Finished, sweeps used up"
    return "Paused"


def modes_text(measurement: Measurement, first: int, last: int) -> str:
    """Modes in use and their frequencies."""
    f = measurement.frequencies
    if first == last:
        return f"mode {first}, {f[last - 1]:.1f} Hz"
    return f"modes {first} to {last}, {f[first - 1]:.1f} to {f[last - 1]:.1f} Hz"


def error_text(measurement: Measurement, positions) -> str:
    """Mean and largest position error."""
    if measurement.positions is None:
        return "unknown (no true positions)"
    errors = measurement.errors(positions)
    aligned = ", once aligned" if measurement.blind else ""
    return f"mean <b>{format_mm(errors.mean())}</b>, largest {format_mm(errors.max())}{aligned}"


def status(view: SessionView, measurement: Measurement, weights: str = "unit", fault: str = "", note: str = "") -> str:
    """The lines at the top of the panel; `fault` is one of the page itself, `note` what it does beside."""
    state, unit = view.state, cost_label(weights).removeprefix("cost ")
    rows = [
        ("Progress", f"step {state.step}, sweep {state.sweep}, stage {state.stage + 1}"),
        ("In use", escape(modes_text(measurement, state.first, state.last))),
        ("Error", error_text(measurement, state.positions)),
        ("Cost", f"{format_number(state.cost, 4)} <span style='opacity: 0.65'>{unit}</span>"),
    ]
    cells = "".join(
        f"<tr><td style='opacity: 0.65; padding-right: 0.9em; vertical-align: top'>{name}</td><td>{text}</td></tr>"
        for name, text in rows
    )
    told = [view.error[:400]] if view.error else []
    told += [f"The page could not be brought up to date: {fault[:400]}"] if fault else []
    error = "".join(
        f"<div style='color: #d61828; overflow-wrap: anywhere'>{escape(f'{text}; details in {log_location()}')}</div>"
        for text in told
    )
    head = f"<div style='font-size: 1.15em; font-weight: 600'>{state_word(view)}</div>"
    error += f"<div style='opacity: 0.65'>{escape(note)}</div>" if note else ""
    return f"<div style='{CARD}'>{head}{error}<table style='border-spacing: 0'>{cells}</table></div>"


def waiting(title: str, text: str) -> str:
    """The line shown before there is a session."""
    return f"<div style='{CARD}'><b>{escape(title)}</b><br>{escape(text)}</div>"


def legend() -> str:
    """What the markers mean."""
    diamond, small = "<path d='M9 3L15 9L9 15L3 9Z' fill='none'", "<path d='M9 6L12 9L9 12L6 9Z' fill='none'"
    circle, cross, white = (
        "<circle cx='9' cy='9' r='5.5' fill='none'",
        "<path d='M4 4L14 14M14 4L4 14'",
        "stroke='#fff'",
    )
    marks = {
        "true": f"{circle} {white} stroke-width='5'/>{circle} stroke='#000' stroke-width='2'/>",
        "estimate": f"{cross} {white} stroke-width='5.5'/>{cross} stroke='{_css(ESTIMATE)}' stroke-width='2.6'/>",
        "known": "<rect x='3' y='3' width='12' height='12' fill='#fff'/>"
        f"<rect x='5' y='5' width='8' height='8' fill='{_css(KNOWN)}'/>",
        "lowest cost": f"{diamond} {white} stroke-width='4.5'/>{diamond} stroke='{_css(LOWEST)}' stroke-width='2.4'/>",
        "other minimum": f"{small} {white} stroke-width='4'/>{small} stroke='{_css(LOWEST)}' stroke-width='1.8'/>",
    }
    return f"<div style='{CARD}'>{_marks(marks)}</div>"


def spectrum_legend(curve: bool, inside: str, outside: str, limit: str, line: str) -> str:
    """What the marks of the spectrum mean; `curve` where there is one, colours as CSS has them."""
    marks = {
        "in the map": f"<circle cx='9' cy='9' r='4' fill='{inside}'/>",
        "not in it": f"<circle cx='9' cy='9' r='3' fill='none' stroke='{outside}' stroke-width='1.6'/>",
        "f<sub>max</sub>": f"<path d='M9 1V17' stroke='{limit}' stroke-width='1.8' stroke-dasharray='5 3'/>",
    }
    marks |= {"mean power": f"<path d='M1 15L6 13L9 3L12 13L17 15' fill='none' stroke='{line}'/>"} if curve else {}
    return f"<div style='{CARD}'>{_marks(marks)}</div>"


def _marks(marks: dict[str, str]) -> str:
    """Drawings of 18 by 18 pixels, each with its name."""
    return "".join(
        "<span style='white-space: nowrap; margin-right: 1.1em'>"
        f"<svg width='18' height='18' style='vertical-align: -4px'>{mark}</svg> {name}</span>"
        for name, mark in marks.items()
    )


def colour_bar(bar: ColourBar | None, trouble: str = "") -> str:
    """The scale of the map, with ticks and unit, or why there is none."""
    if bar is None:
        return f"<div style='{CARD} opacity: 0.65'>{escape(trouble[:400]) or 'no map'}</div>"
    gradient = ", ".join(_css(colour) for colour in to_rgb(np.linspace(0, 1, 17), bar.colour_map))
    ticks = "".join(
        f"<div style='position: absolute; left: {100 * share:.2f}%; transform: translateX(-50%); text-align: center;"
        " line-height: 1.1'><div style='width: 1px; height: 5px; margin: 0 auto; background: currentColor'></div>"
        f"{text}</div>"
        for share, text in bar.ticks
    )
    note = f"; lower values share the darkest colour ({format_number(bar.low, 2)})" if bar.clipped else ""
    return (
        f"<div style='{CARD}'><div style='margin: 0.3em 1em 0 1em'>"
        f"<div style='height: 12px; border-radius: 2px; background: linear-gradient(to right, {gradient})'></div>"
        f"<div style='position: relative; height: 1.7em; font-size: 0.9em'>{ticks}</div></div>"
        f"<div style='opacity: 0.75; text-align: center'>{escape(bar.label)}{note}</div></div>"
    )


def remark(text: str) -> str:
    """A sentence below a control."""
    return f"<div style='{CARD} opacity: 0.75'>{escape(text)}</div>"


def complaint(text: str) -> str:
    """Why what was written into a field is not taken."""
    return f"<div style='{CARD} color: #d61828'>{escape(text)}</div>" if text else ""


def map_lines(drawn) -> str:
    """What is to be read off a CostMap: its local minima, and the cost at the estimated position."""
    if drawn is None:
        return ""
    if drawn.request.style.shape:
        text = "Sound pressure at one moment, from what the microphones heard and where they are supposed to be (Eq. 6)"
        return f"<div style='{CARD}'>{text}</div>"
    count = drawn.minima
    minima = "no local minimum" if not count else "1 local minimum" if count == 1 else f"{count} local minima"
    modes = len(drawn.request.modes)
    what = f"sum of {modes} modes" if modes > 1 else f"mode {drawn.request.modes[0]} alone"
    return (
        f"<div style='{CARD}'>microphone {drawn.request.microphone}, {what}: <b>{minima}</b> inside<br>"
        f"cost at the cross <b>{format_number(drawn.cost_here, 4)}</b>, lowest {format_number(drawn.lowest, 4)}</div>"
    )


def modes_lines(measurement: Measurement, used, limit: float, order: int | None) -> str:
    """How high the modes of the map go, what the array can follow (f_max, Eq. 9), and a warning beyond it."""
    f, count = float(measurement.frequencies[used[-1] - 1]), measurement.count
    lines = [f"highest in the map: mode {used[-1]}, <b>{f:.1f} Hz</b>"]
    highest = f"<b>{limit:.0f} Hz</b>" if np.isfinite(limit) else "none, all are in one place"
    lines += [f"f<sub>max</sub> of the supposed positions (Eq. 9): {highest}"]
    if order is not None:
        lines += [f"order L = <b>{order}</b>: {2 * order + 1} functions for {count} microphones"]
    beyond = f > limit
    if beyond:
        lines += ["<span style='color: #d61828'>&#9888; modes beyond f<sub>max</sub> are in the map</span>"]
    return f"<div style='{CARD}'>{'<br>'.join(lines)}</div>"


def table(measurement: Measurement, positions, sigma, looked_at: int) -> str:
    """Microphones, worst first: error and uncertainty (one sigma), mm; known ones last."""
    errors, known = measurement.errors(positions), set(measurement.known.tolist())
    order = errors if errors is not None else sigma if sigma is not None else np.zeros(len(positions))
    rows = []
    for n in sorted(range(len(positions)), key=lambda n: (n in known, -float(order[n]), n))[:MOST_ROWS]:
        name = escape(str(measurement.names[n])) + (" known" if n in known else "")
        place = ", ".join(f"{x:.3f}" for x in positions[n])
        error = "" if errors is None else f"<td>{mm_text(errors[n])}</td>"
        spread = "" if sigma is None or n in known else mm_text(float(sigma[n]))
        bold = " style='font-weight: 700; background: rgba(31,120,200,0.15)'" if n == looked_at else ""
        rows.append(f"<tr{bold}><td>{name}</td><td>{place}</td>{error}<td>{spread}</td></tr>")
    columns = (
        "mic<br>",
        "position<br>(m)",
        *(() if errors is None else ("error<br>(mm)",)),
        "&plusmn; &sigma;<br>(mm)",
    )
    head = "".join(f"<th>{text}</th>" for text in columns)
    style = "<style>.mics td, .mics th {padding: 0 0.5em 0 0; text-align: left; white-space: nowrap}</style>"
    more = len(positions) - MOST_ROWS
    below = f"<div style='opacity: 0.65'>and {more} better ones</div>" if more > 0 else ""
    return (
        f"{style}<div style='{CARD} font-size: 0.74em; overflow-x: auto'><table class='mics'>"
        f"<tr>{head}</tr>{''.join(rows)}</table>{below}</div>"
    )


def panels_caption(drawn) -> str:
    """What the maps side by side (of cost_maps.CostMap) show."""
    if drawn is None or drawn.costs is None:
        return f"<div style='{CARD} opacity: 0.65'>no maps</div>"
    n, modes, look = drawn.request.microphone, len(drawn.request.modes), drawn.request.style
    scale = "one scale" if look.shared else "each its own scale"
    return (
        f"<div style='{CARD}'>Cost of moving <b>microphone {n}</b>, mode by mode and summed"
        f" ({modes} mode{'s' if modes > 1 else ''}); {scale}, {'logarithmic' if look.log else 'linear'}</div>"
    )


def _css(colour) -> str:
    return f"rgb({int(colour[0])},{int(colour[1])},{int(colour[2])})"
