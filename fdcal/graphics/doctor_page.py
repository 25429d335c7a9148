"""The findings about a recording as one page of HTML: a table, and the pictures that each finding rests on."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

from ..session.doctor import Chart, Finding
from .calibration_figure import html_table, png_uri

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TITLES = {
    "samples": "Samples of each channel",
    "wrapped": "Do the responses wrap round?",
    "synchronous": "Do the channels share one clock?",
    "field": "Is this one sound field?",
    "measured": "Are the low frequencies measured?",
    "channels": "Which channels differ?",
    "list": "Does the list fit?",
}
STATES = {"fine": "fine", "differs": "differs, harmless", "fault": "fault", "unknown": "not known"}
STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}img{max-width:100%}"
    "td,th{text-align:left;vertical-align:top;padding:.2rem .8rem .2rem 0}"
)
MANY = 24  # microphones whose names an axis holds; curves with names of their own


def doctor_page(title: str, findings: Sequence[Finding]) -> str:
    """Return the page."""
    rows = [[TITLES[one.question], STATES[one.state], _figure_text(one), one.text] for one in findings]
    parts = [
        f"<h2>{escape(TITLES[one.question])}</h2><p><b>{STATES[one.state]}</b>: {escape(one.text)}</p>"
        f'<img src="{png_uri(draw_finding(one))}" alt="{escape(TITLES[one.question])}">'
        for one in findings
        if one.charts
    ]
    table = html_table(["question", "answer", "figure", "in words"], rows)
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{escape(title)}</title><style>{STYLE}</style>'
        f"<h1>{escape(title)}</h1>{table}{''.join(parts)}</html>\n"
    )


def _figure_text(one: Finding) -> str:
    return "" if one.value is None else f"{one.value:.3g} {one.unit}"


def draw_finding(finding: Finding) -> Figure:
    """Return the charts of a finding, side by side."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5 * len(finding.charts), 3.4), dpi=100, layout="constrained")
    for chart, panel in zip(finding.charts, figure.subplots(1, len(finding.charts), squeeze=False)[0], strict=True):
        _draw(chart, panel)
    return figure


def _draw(chart: Chart, panel) -> None:
    for number, curve in enumerate(chart.curves):
        label = curve.label if len(chart.curves) <= MANY else None
        panel.plot(curve.x, curve.y, "osD^v"[number % 5] if curve.marks else "-", markersize=4, alpha=0.8, label=label)
    if chart.limit is not None:
        panel.axhline(chart.limit, color="grey", linestyle="--", linewidth=1)
    if chart.names and len(chart.names) <= MANY:
        panel.set_xticks(range(len(chart.names)), chart.names, rotation=90 if max(map(len, chart.names)) > 2 else 0)
    if chart.equal:
        panel.set_aspect("equal", adjustable="datalim")
    panel.set(xlabel=chart.x, ylabel=chart.y)
    panel.grid(alpha=0.3)
    if 1 < len(chart.curves) <= MANY:
        panel.legend(fontsize="x-small", ncols=2 if len(chart.curves) > 6 else 1)
