"""Legends of the marks and the scale of a map as HTML."""

from __future__ import annotations

from html import escape

import numpy as np

from ...graphics.heatmap import to_rgb
from ...graphics.markers import ESTIMATE, KNOWN, LOWEST, ODD
from ...graphics.primitives import ColourBar, format_number
from .html import CARD, MAX_ERROR_LENGTH


def legend(odd_channels: bool = True) -> str:
    """Return the legend of the marks in the scene, that of odd channels as well where there can be any."""
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
    if odd_channels:
        stroke = f"fill='none' stroke='{_css(ODD)}' stroke-width='1.8'"
        marks["odd channel"] = f"<circle cx='9' cy='9' r='7' {stroke}/><path d='M4 4L14 14' {stroke}/>"
    return f"<div style='{CARD}'>{_marks(marks)}</div>"


def spectrum_legend(curve: bool, inside: str, outside: str, limit: str, line: str) -> str:
    """Return the legend of the plot of the spectrum.

    Parameters
    ----------
    curve : whether the plot has the curve of the spectrum
    inside, outside, limit, line : CSS colours of modes in the map, of other modes, of f_max and of the curve

    Returns
    -------
    str
        HTML.
    """
    marks = {
        "in the map": f"<circle cx='9' cy='9' r='4' fill='{inside}'/>",
        "not in the map": f"<circle cx='9' cy='9' r='3' fill='none' stroke='{outside}' stroke-width='1.6'/>",
        "f<sub>max</sub>": f"<path d='M9 1V17' stroke='{limit}' stroke-width='1.8' stroke-dasharray='5 3'/>",
    }
    marks |= {"mean power": f"<path d='M1 15L6 13L9 3L12 13L17 15' fill='none' stroke='{line}'/>"} if curve else {}
    return f"<div style='{CARD}'>{_marks(marks)}</div>"


def _marks(marks: dict[str, str]) -> str:
    """Return drawings of 18 by 18 pixels, each with its name."""
    return "".join(
        "<span style='white-space: nowrap; margin-right: 1.1em'>"
        f"<svg width='18' height='18' style='vertical-align: -4px'>{mark}</svg> {name}</span>"
        for name, mark in marks.items()
    )


def colour_bar(bar: ColourBar | None, reason: str = "") -> str:
    """Return the scale of a map with ticks and unit, or the reason why there is no map."""
    if bar is None:
        return f"<div style='{CARD} opacity: 0.65'>{escape(reason[:MAX_ERROR_LENGTH]) or 'no map'}</div>"
    gradient = ", ".join(_css(colour) for colour in to_rgb(np.linspace(0, 1, 17), bar.colour_map))
    ticks = "".join(
        f"<div style='position: absolute; left: {100 * share:.2f}%; transform: translateX(-50%); text-align: center;"
        " line-height: 1.1'><div style='width: 1px; height: 5px; margin: 0 auto; background: currentColor'></div>"
        f"{text}</div>"
        for share, text in bar.ticks
    )
    note = f"; values below {format_number(bar.low, 2)} are clipped" if bar.clipped else ""
    return (
        f"<div style='{CARD}'><div style='margin: 0.3em 1em 0 1em'>"
        f"<div style='height: 12px; border-radius: 2px; background: linear-gradient(to right, {gradient})'></div>"
        f"<div style='position: relative; height: 1.7em; font-size: 0.9em'>{ticks}</div></div>"
        f"<div style='opacity: 0.75; text-align: center'>{escape(bar.label)}{note}</div></div>"
    )


def _css(colour) -> str:
    return f"rgb({int(colour[0])},{int(colour[1])},{int(colour[2])})"
