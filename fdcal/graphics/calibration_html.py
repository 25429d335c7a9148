"""A calibration as HTML for a notebook: verdict, picture, table."""

from __future__ import annotations

import base64
from html import escape

from ..assessment.calibration import Calibration
from .calibration_figure import draw_calibration
from .landscape_figure import figure_bytes

ROWS = 12  # microphones that are listed; the first ones


def calibration_html(result: Calibration) -> str:
    """Return the verdict with its text, the figure of `draw_calibration`, and a table of the microphones."""
    picture = base64.b64encode(figure_bytes(draw_calibration(result), "png")).decode()
    f = result.frequencies
    used = f"solver {escape(result.solver)}, {len(f)} modes, {f[0]:.1f} to {f[-1]:.1f} Hz, {result.elapsed:.1f} s"
    return (
        f"<p><b>{escape(result.verdict)}</b>: {escape(result.verdict_text)}<br>{used}</p>"
        f'<img alt="positions of the microphones" style="max-width:100%" src="data:image/png;base64,{picture}">'
        f"{_table(result)}"
    )


def _table(result: Calibration) -> str:
    axes = "xyz"[: result.positions.shape[1]]
    heads = ["microphone", *(f"{axis} (m)" for axis in axes), "one sigma (mm)", "error (mm)"]
    rows = [_row(result, n) for n in range(min(ROWS, len(result.names)))]
    head = "".join(f"<th>{text}</th>" for text in heads)
    rest = len(result.names) - len(rows)
    more = f'<tr><td colspan="{len(heads)}">and {rest} more</td></tr>' if rest else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}{more}</tbody></table>"


def _row(result: Calibration, n: int) -> str:
    name = result.names[n]
    sigma = "" if result.uncertainty is None else f"{1e3 * result.uncertainty[n]:.2f}"
    cells = [escape(name), *(f"{value:.4f}" for value in result.positions[n])]
    cells += ["known" if name in (result.known or ()) else sigma]
    cells += ["" if result.errors is None else f"{1e3 * result.errors[n]:.2f}"]
    return f"<tr>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
