"""One page of HTML each: the findings about a recording, and a plan; with tables and figures, without network."""

from collections.abc import Sequence
from functools import partial
from html import escape
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from ..model.validation import length_text
from ..session.doctor import Chart, Finding
from ..session.planning.advice import ExtraMicrophone
from ..session.planning.plan import Plan, plan_lines
from ..session.planning.trials import Trials
from .calibration_figure import enlarged_ellipses, html_page, html_table, png_uri, position_table
from .markers import ELLIPSE, ESTIMATE, KNOWN, TRUE
from .primitives import fractions

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


def draw_finding(finding: Finding) -> Figure:
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


BINS = 24  # of the histogram of the trials' errors


def draw_plan(plan: Plan) -> Figure:
    """Return the figure of a plan: one to five panels, depending on what it holds."""
    panels = [partial(_draw_bound, plan)]
    if plan.advice is not None:
        extra, x = plan.advice.extra, plan.request.layout.positions
        panels.append(partial(_draw_map, extra, x, extra.own_sigma, "One sigma of a microphone here", "mm", False))
        panels.append(partial(_draw_map, extra, x, extra.rms, "Others, with one more microphone here", "mm rms", True))
        panels.append(partial(_draw_sizes, plan.advice.accuracy.sizes))
    if plan.trials is not None:
        panels.append(partial(_draw_trials, plan.trials))
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(5.2 * columns, 4.8 * rows), dpi=100, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for draw, panel in zip(panels, axes, strict=False):
        draw(panel)
    for panel in axes[len(panels) :]:
        panel.set_axis_off()
    return figure


def _draw_bound(plan: Plan, panel: Any) -> None:
    """Draw the microphones from above, with the ellipses of the bound."""
    x, bound = plan.request.layout.positions[:, :2], plan.bound
    enlarged_ellipses(panel, x, bound.covariance[:, :2, :2], plan.request.layout.positions)
    panel.plot(*x[bound.free].T, "o", color=fractions(TRUE), markersize=5, label="microphone")
    if not bound.free.all():
        given = {"color": fractions(KNOWN), "fillstyle": "none", "markersize": 9, "label": "position given"}
        panel.plot(*x[~bound.free].T, "s", **given)
    _finish(panel, f"Bound: {length_text(bound.rms)} rms")


def _draw_map(
    extra: ExtraMicrophone, x: np.ndarray, values: np.ndarray, title: str, unit: str, best: bool, panel: Any
) -> None:
    """Draw values in metres at each place of the map for one more microphone; `best`: whether its place is marked."""
    places = extra.places
    if values.ndim == 3:  # of an array in space the layer of its best place
        layer = int(np.argmin(np.abs(places[:, 0, 0, 2] - extra.best[2])))
        title += f", z = {places[layer, 0, 0, 2]:.2g} m"
        places, values = places[layer], values[layer]
    drawn = panel.pcolormesh(places[0, :, 0], places[:, 0, 1], 1e3 * values, shading="nearest", cmap="viridis")
    panel.figure.colorbar(drawn, ax=panel, label=unit)
    panel.plot(*x[:, :2].T, "o", color=fractions(TRUE), markeredgecolor="white", markersize=5)
    if best:
        panel.plot(*extra.best[:2], "*", color=fractions(ESTIMATE), markersize=14, label="best place")
    _finish(panel, title, legend=best)


def _draw_sizes(sizes: np.ndarray, panel: Any) -> None:
    """Draw the bound against the size of the array."""
    factors, rms = sizes.T
    panel.loglog(factors, 1e3 * rms, "o-", color=fractions(KNOWN))
    panel.axvline(1.0, color="grey", linestyle=":")
    panel.set_xticks(factors, [f"{factor:g}" for factor in factors], minor=False)
    panel.set_xticks([], minor=True)
    _label_plainly(panel.yaxis)
    panel.set(xlabel="size of the array, relative", ylabel="bound (mm rms)", title="Wider or smaller?")
    panel.grid(alpha=0.3)


def _draw_trials(trials: Trials, panel: Any) -> None:
    """Draw the errors of the simulated calibrations beside the bound."""
    rms = 1e3 * trials.rms[np.isfinite(trials.rms)]
    if len(rms):
        low, high = min(rms.min(), 1e3 * trials.bound), max(rms.max(), 1e3 * trials.bound)
        panel.hist(rms, np.geomspace(0.9 * low, 1.1 * high, BINS), color=fractions(ELLIPSE), label="trials")
    panel.axvline(1e3 * trials.bound, color=fractions(TRUE), linestyle="--", label="bound")
    panel.axvline(1e3 * trials.accuracy, color=fractions(KNOWN), linestyle=":", label="wanted")
    panel.set_xscale("log")
    _label_plainly(panel.xaxis)
    panel.yaxis.get_major_locator().set_params(integer=True)
    fraction = f"{trials.accurate:.0%} of {len(trials.verdicts)} trials"  # of which rms errors alone can be shown
    title = f"Every microphone within {1e3 * trials.accuracy:g} mm: {fraction}"
    panel.set(xlabel="error (mm rms)", ylabel="trials", title=title)
    panel.legend(frameon=False)


def _label_plainly(axis: Any) -> None:
    """Write the numbers of a logarithmic axis without powers of ten: 1, 2, 5, 10."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def _finish(panel: Any, title: str, legend: bool = True) -> None:
    panel.set_aspect("equal", adjustable="datalim")
    panel.set(xlabel="x (m)", ylabel="y (m)", title=title)
    if legend:
        panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3, fontsize="small", frameon=False)


PLAN_STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color-scheme:light dark}"
    "img{max-width:100%;background:#fff}table{border-collapse:collapse}td,th{padding:.2rem .8rem;text-align:right;"
    "border-bottom:1px solid #8884}"
)


def plan_html(plan: Plan) -> str:
    """Return the page; it needs no network."""
    layout, bound, lines = plan.request.layout, plan.bound, [f"<li>{escape(line)}</li>" for line in plan_lines(plan)]
    picture = f'<img alt="bound of each microphone, maps and trials" src="{png_uri(draw_plan(plan))}">'
    sigma = [f"{1e3 * one:.2f}" if free else "given" for one, free in zip(bound.sigma, bound.free, strict=True)]
    table = position_table(layout.names, layout.positions, {"least one sigma (mm)": sigma})
    return html_page(f"Plan: {layout.name}", PLAN_STYLE, f"<ul>{''.join(lines)}</ul>{picture}{table}")
