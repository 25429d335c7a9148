"""One page of HTML each: the findings about a recording, and a plan; with tables and figures, without network."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from ..session.doctor import Chart, Finding
from ..session.planning.plan import Plan, plan_lines
from .calibration_figure import enlarged_ellipses, html_table, png_uri
from .markers import ELLIPSE, ESTIMATE, KNOWN, TRUE
from .primitives import fractions

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
FINDINGS_STYLE = (
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
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{escape(title)}</title>'
        f"<style>{FINDINGS_STYLE}</style><h1>{escape(title)}</h1>{table}{''.join(parts)}</html>\n"
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


BINS = 24  # of the histogram of the trials' errors


def draw_plan(plan: Plan) -> Figure:
    """Return the figure of a plan: two to four panels, depending on what it holds."""
    from matplotlib.figure import Figure

    panels = [_draw_bound]
    if plan.advice is not None:
        panels += [_draw_own_sigma, _draw_extra, _draw_sizes]
    if plan.trials is not None:
        panels.append(_draw_trials)
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(5.2 * columns, 4.8 * rows), dpi=100, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for draw, panel in zip(panels, axes, strict=False):
        draw(plan, panel)
    for panel in axes[len(panels) :]:
        panel.set_axis_off()
    return figure


def _draw_bound(plan: Plan, panel: Any) -> None:
    """Draw the microphones from above, with the ellipses of the bound."""
    x, bound = plan.request.layout.positions[:, :2], plan.bound
    enlarged_ellipses(panel, x, bound.covariance[:, :2, :2], plan.request.layout.positions)
    panel.plot(*x[bound.free].T, "o", color=fractions(TRUE), markersize=5, label="microphone")
    if not bound.free.all():
        panel.plot(
            *x[~bound.free].T, "s", color=fractions(KNOWN), fillstyle="none", markersize=9, label="position given"
        )
    panel.set_title(f"Bound: {1e3 * bound.rms:.3g} mm rms")
    _finish(panel)


def _draw_own_sigma(plan: Plan, panel: Any) -> None:
    """Draw one sigma of a microphone at each place of the map."""
    assert plan.advice is not None
    _draw_map(plan, panel, plan.advice.extra.own_sigma, "One sigma of a microphone here", "mm")


def _draw_extra(plan: Plan, panel: Any) -> None:
    """Draw by how much a microphone at each place of the map improves the others."""
    assert plan.advice is not None
    extra = plan.advice.extra
    _draw_map(plan, panel, extra.rms, "Others, with one more microphone here", "mm rms")
    panel.plot(*extra.best[:2], "*", color=fractions(ESTIMATE), markersize=14, label="best place")
    _finish(panel)


def _draw_map(plan: Plan, panel: Any, values: np.ndarray, title: str, unit: str) -> None:
    assert plan.advice is not None
    places, x = plan.advice.extra.places, plan.request.layout.positions
    if values.ndim == 3:  # of an array in space the layer of its best place
        layer = int(np.argmin(np.abs(places[:, 0, 0, 2] - plan.advice.extra.best[2])))
        title += f", z = {places[layer, 0, 0, 2]:.2g} m"
        places, values = places[layer], values[layer]
    drawn = panel.pcolormesh(places[0, :, 0], places[:, 0, 1], 1e3 * values, shading="nearest", cmap="viridis")
    panel.figure.colorbar(drawn, ax=panel, label=unit)
    panel.plot(*x[:, :2].T, "o", color=fractions(TRUE), markeredgecolor="white", markersize=5)
    panel.set_title(title)
    _finish(panel, legend=False)


def _draw_sizes(plan: Plan, panel: Any) -> None:
    """Draw the bound against the size of the array."""
    assert plan.advice is not None
    factors, rms = plan.advice.accuracy.sizes.T
    panel.loglog(factors, 1e3 * rms, "o-", color=fractions(KNOWN))
    panel.axvline(1.0, color="grey", linestyle=":")
    panel.set_xticks(factors, [f"{factor:g}" for factor in factors], minor=False)
    panel.set_xticks([], minor=True)
    _label_plainly(panel.yaxis)
    panel.set_xlabel("size of the array, relative")
    panel.set_ylabel("bound (mm rms)")
    panel.set_title("Wider or smaller?")
    panel.grid(alpha=0.3)


def _draw_trials(plan: Plan, panel: Any) -> None:
    """Draw the errors of the simulated calibrations beside the bound."""
    trials = plan.trials
    assert trials is not None
    rms = 1e3 * trials.rms[np.isfinite(trials.rms)]
    if len(rms):
        low, high = min(rms.min(), 1e3 * trials.bound), max(rms.max(), 1e3 * trials.bound)
        panel.hist(rms, np.geomspace(0.9 * low, 1.1 * high, BINS), color=fractions(ELLIPSE), label="trials")
    panel.axvline(1e3 * trials.bound, color=fractions(TRUE), linestyle="--", label="bound")
    panel.axvline(1e3 * trials.accuracy, color=fractions(KNOWN), linestyle=":", label="wanted")
    panel.set_xscale("log")
    _label_plainly(panel.xaxis)
    panel.set_xlabel("error (mm rms)")
    panel.set_ylabel("trials")
    panel.yaxis.get_major_locator().set_params(integer=True)
    share = f"{trials.accurate:.0%} of {len(trials.verdicts)} trials"  # of which rms errors alone can be shown
    panel.set_title(f"Every microphone within {1e3 * trials.accuracy:g} mm: {share}")
    panel.legend(frameon=False)


def _label_plainly(axis: Any) -> None:
    """Write the numbers of a logarithmic axis without powers of ten: 1, 2, 5, 10."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def _finish(panel: Any, legend: bool = True) -> None:
    panel.set_aspect("equal", adjustable="datalim")
    panel.set_xlabel("x (m)")
    panel.set_ylabel("y (m)")
    if legend:
        panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3, fontsize="small", frameon=False)


PLAN_STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color-scheme:light dark}"
    "img{max-width:100%;background:#fff}table{border-collapse:collapse}td,th{padding:.2rem .8rem;text-align:right;"
    "border-bottom:1px solid #8884}"
)


def plan_html(plan: Plan) -> str:
    """Return the page; it needs no network."""
    name = escape(plan.request.layout.name)
    lines = "".join(f"<li>{escape(line)}</li>" for line in plan_lines(plan))
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Plan: {name}</title><style>{PLAN_STYLE}</style>'
        f"<h1>Plan: {name}</h1><ul>{lines}</ul>"
        f'<img alt="bound of each microphone, maps and trials" src="{png_uri(draw_plan(plan))}">'
        f"{_table(plan)}</html>\n"
    )


def _table(plan: Plan) -> str:
    x, layout = plan.request.layout.positions, plan.request.layout
    rows = []
    for n, name in enumerate(layout.names):
        sigma = f"{1e3 * plan.bound.sigma[n]:.2f}" if plan.bound.free[n] else "given"
        rows.append([name, *(f"{value:.4f}" for value in x[n]), sigma])
    return html_table(["microphone", *(f"{axis} (m)" for axis in "xyz"[: x.shape[1]]), "least one sigma (mm)"], rows)
