"""Legends of the marks and the scale of a map as HTML."""

from collections.abc import Iterable
from html import escape

import numpy as np

from ...graphics.annotations import HALO_WIDTH, Entry
from ...graphics.heatmap import to_rgb
from ...graphics.primitives import ColourBar, format_number
from .html import CARD

EDGE = 18  # pixels, of a symbol


def legend(entries: Iterable[Entry]) -> str:
    """Return the entries of a legend, each with its symbol."""
    return f"<div style='{CARD}'>{_marks({escape(entry.text): symbol(entry) for entry in entries})}</div>"


def symbol(entry: Entry) -> str:
    """Return the symbol of an entry as SVG."""
    half, corners = EDGE / 2, [(np.array(path) * [1.0, -1.0] + 1) * EDGE / 2 for path in entry.paths]
    paths = ["M" + "L".join(f"{x:.3g} {y:.3g}" for x, y in path) for path in corners]
    layers = [(_css(entry.halo_colour), entry.width + HALO_WIDTH)] if entry.halo else []
    drawn = ""
    for colour, width in (*layers, (_css(entry.colour), entry.width)):
        for i, path in enumerate(paths):
            fill = colour if entry.filled and i == 0 else "none"
            style = f"fill='{fill}' stroke='{colour}' stroke-width='{width * half:.3g}' stroke-linejoin='round'"
            drawn += f"<path d='{path}' {style}/>"
    return _svg(drawn)


def _svg(mark: str) -> str:
    """A drawing of EDGE by EDGE pixels; its size follows the text."""
    style = "width: 1.4em; height: 1.4em; vertical-align: -0.35em"
    return f"<svg viewBox='0 0 {EDGE} {EDGE}' style='{style}'>{mark}</svg>"


def spectrum_legend(curve: bool, inside: str, outside: str, limit: str, line: str) -> str:
    """Return the legend of the plot of the spectrum.

    `curve`: whether the plot has the curve of the spectrum; `inside`, `outside`, `limit`, `line`: CSS colours of modes
    in the map, of other modes, of f_max and of the curve. Returns HTML.
    """
    marks = {
        "in the map": f"<circle cx='9' cy='9' r='4' fill='{inside}'/>",
        "not in the map": f"<circle cx='9' cy='9' r='3' fill='none' stroke='{outside}' stroke-width='1.6'/>",
        "f<sub>max</sub>": f"<path d='M9 1V17' stroke='{limit}' stroke-width='1.8' stroke-dasharray='5 3'/>",
    }
    marks |= {"mean power": f"<path d='M1 15L6 13L9 3L12 13L17 15' fill='none' stroke='{line}'/>"} if curve else {}
    return f"<div style='{CARD}'>{_marks({name: _svg(mark) for name, mark in marks.items()})}</div>"


def _marks(marks: dict[str, str]) -> str:
    """Return drawings, each with its name."""
    return "".join(
        f"<span style='white-space: nowrap; margin-right: 1.1em; display: inline-block'>{mark} {name}</span>"
        for name, mark in marks.items()
    )


def colour_bar(bar: ColourBar) -> str:
    """Return the scale of a map with ticks, and its label beside it."""
    gradient = ", ".join(_css(colour) for colour in to_rgb(np.linspace(0, 1, 17), bar.colour_map))
    ticks = "".join(
        f"<div style='position: absolute; left: {100 * share:.2f}%; transform: translateX(-50%); text-align: center;"
        " line-height: 1.1'><div style='width: 1px; height: 5px; margin: 0 auto; background: currentColor'></div>"
        f"{text}</div>"
        for share, text in bar.ticks
    )
    ends = (("below", bar.low, bar.clipped), ("above", bar.high, bar.capped))
    beyond = " and ".join(f"{side} {format_number(value, 3)}" for side, value, there in ends if there)
    note = f"values {beyond} are clipped" if beyond else ""
    words = "<br>".join(filter(None, (escape(bar.label), note)))
    layout = "display: flex; align-items: center; gap: 0.5em; line-height: 1.2"
    return (
        f"<div style='{CARD} {layout}'><div style='margin: 0.3em 1em 0 1em; flex: 1; min-width: 150px'>"
        f"<div style='height: 12px; border-radius: 2px; background: linear-gradient(to right, {gradient})'></div>"
        f"<div style='position: relative; height: 1.7em'>{ticks}</div></div>"
        f"<div style='opacity: 0.85; text-align: center'>{words}</div></div>"
    )


def _css(colour) -> str:
    return f"rgb({int(colour[0])},{int(colour[1])},{int(colour[2])})"


def canvas_legend(bar: ColourBar | None, entries: Iterable[Entry]) -> str:
    """Return what stands on the canvas: the colour bar of the map, if there is one, and the marks that are drawn."""
    scale = "" if bar is None else colour_bar(bar)
    return f"<div class='fdcal-legend'>{scale}{legend(entries)}</div>"
