"""A plan as one page of HTML: what it says, its figure, and a table of the microphones."""

from __future__ import annotations

import base64
from html import escape

from ..session.planning.plan import Plan, plan_lines
from .landscape_figure import figure_bytes
from .plan_figure import draw_plan

STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color-scheme:light dark}"
    "img{max-width:100%;background:#fff}table{border-collapse:collapse}td,th{padding:.2rem .8rem;text-align:right;"
    "border-bottom:1px solid #8884}"
)


def plan_html(plan: Plan) -> str:
    """Return the page; it needs no network."""
    picture = base64.b64encode(figure_bytes(draw_plan(plan), "png")).decode()
    name = escape(plan.request.layout.name)
    lines = "".join(f"<li>{escape(line)}</li>" for line in plan_lines(plan))
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Plan: {name}</title><style>{STYLE}</style>'
        f"<h1>Plan: {name}</h1><ul>{lines}</ul>"
        f'<img alt="bound of each microphone, maps and trials" src="data:image/png;base64,{picture}">'
        f"{_table(plan)}</html>\n"
    )


def _table(plan: Plan) -> str:
    x, layout = plan.request.layout.positions, plan.request.layout
    heads = ["microphone", *(f"{axis} (m)" for axis in "xyz"[: x.shape[1]]), "least one sigma (mm)"]
    rows = []
    for n, name in enumerate(layout.names):
        sigma = f"{1e3 * plan.bound.sigma[n]:.2f}" if plan.bound.free[n] else "given"
        cells = [escape(name), *(f"{value:.4f}" for value in x[n]), sigma]
        rows.append(f"<tr>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>")
    head = "".join(f"<th>{text}</th>" for text in heads)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
