"""One page of HTML each: the findings about a recording, and a plan; with tables and figures, without network."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from ..model.validation import length_text
from .calibration_figure import MARK_SCALE, enlarged_ellipses, html_page, html_table, png_uri, position_table
from .marks import TRUE, plot_marks
from .primitives import fractions

if TYPE_CHECKING:
    from ..session.doctor import Answer, Chart
    from ..session.plan import Plan

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
FINDINGS_STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}img{max-width:100%}"
    "td,th{text-align:left;vertical-align:top;padding:.2rem .8rem .2rem 0}"
)
MANY = 24  # microphones whose names an axis holds; curves with names of their own


def doctor_page(title: str, findings: Sequence[Answer]) -> str:
    """Return the page."""
    rows = [
        [TITLES[one.question], STATES[one.state], "" if one.value is None else f"{one.value:.3g} {one.unit}", one.text]
        for one in findings
    ]
    parts = [
        f"<h2>{escape(TITLES[one.question])}</h2><p><b>{STATES[one.state]}</b>: {escape(one.text)}</p>"
        f'<img src="{png_uri(draw_finding(one))}" alt="{escape(TITLES[one.question])}">'
        for one in findings
        if one.charts
    ]
    table = html_table(["question", "answer", "figure", "in words"], rows)
    return html_page(title, FINDINGS_STYLE, f"{table}{''.join(parts)}")


def draw_finding(finding: Answer) -> Figure:
    """Return the charts of a finding, side by side."""
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


def draw_plan(plan: Plan) -> Figure:
    """Return the figure of a plan: the microphones from above, with the ellipses of the bound."""
    figure = Figure(figsize=(5.2, 4.8), dpi=100, layout="constrained")
    panel, bound, positions = figure.subplots(), plan.bound, plan.request.layout.positions
    x = positions[:, :2]
    enlarged_ellipses(panel, x, bound.covariance[:, :2, :2], positions)
    panel.plot(*x[bound.free].T, "o", color=fractions(TRUE), markersize=5, label="microphone")
    plot_marks(panel, "microphones/known", x[~bound.free], "position given", MARK_SCALE)
    panel.set_aspect("equal", adjustable="datalim")
    panel.set(xlabel="x (m)", ylabel="y (m)", title=f"Least error: {length_text(bound.rms)} rms")
    panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3, fontsize="small", frameon=False)
    return figure


PLAN_STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color-scheme:light dark}"
    "img{max-width:100%;background:#fff}table{border-collapse:collapse}td,th{padding:.2rem .8rem;text-align:right;"
    "border-bottom:1px solid #8884}"
)


def plan_html(plan: Plan, sentences: tuple[Sequence[str], Sequence[str]], table: Sequence[Sequence[str]]) -> str:
    """Return the page; it needs no network. `sentences`, `table`: what `fdcal.session.plan` says of the plan."""
    layout, bound, (before, (caption, advice)) = plan.request.layout, plan.bound, sentences
    listed = "".join(f"<li>{escape(line)}</li>" for line in before)
    picture = f'<img alt="least error of each microphone" src="{png_uri(draw_plan(plan))}">'
    sigma = [f"{1e3 * one:.2f}" if free else "given" for one, free in zip(bound.sigma, bound.free, strict=True)]
    head, *rows = table
    promised = f"<p>{escape(caption)}</p>{html_table(head, rows)}<p>{escape(advice)}</p>"
    places = position_table(layout.names, layout.positions, {"least one sigma (mm)": sigma})
    return html_page(f"Plan: {layout.name}", PLAN_STYLE, f"<ul>{listed}</ul>{promised}{picture}{places}")
