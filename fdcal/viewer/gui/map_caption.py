"""What a map shows, in words: its local minima, its cost at the estimate and the orders of its modes."""

from __future__ import annotations

import numpy as np

from ...acoustics.dictionary import max_order
from ...cost.reference_cost import decibels
from ...graphics.primitives import format_number
from ...graphics.units import row_word
from ...model.measurement import Measurement
from ..background.cost_maps import CostMap
from ..background.map_panels import count_label, modes_label, of_take
from ..background.prepare import PreparedRun
from . import html


def orders_text(run: PreparedRun, drawn: CostMap | None) -> str:
    """Return the orders of the modes of a map of Eq. 7, as "order L = 3 to 8, ceil(k R) + 2"; "" for others."""
    if drawn is None or drawn.request.order_offset is None or run.problem.search is None:
        return ""
    k = run.problem.wavenumbers[np.asarray(drawn.request.modes) - 1]
    orders = max_order(k, run.problem.search.radius, drawn.request.order_offset)
    low, high = int(orders.min()), int(orders.max())
    text = f"order L = {low if low == high else f'{low} to {high}'}, ceil(k R) + {drawn.request.order_offset}"
    last, word = drawn.request.state.last, row_word(run.measurement)
    used = of_take(run, tuple(range(1, last + 1)), drawn.request.take)
    if drawn.request.custom_modes or drawn.request.modes[-1] == used[-1]:
        return text
    return f"{text}; higher {word}s, up to {last}, have too many functions for {run.measurement.count} microphones"


def caption(drawn: CostMap | None, measurement: Measurement, orders: str = "") -> str:
    """Return what a map shows: its local minima, the cost at the estimated position, the lowest cost.

    `measurement`: whose modes or, of several takes, rows are summed; `orders`: of the modes, in words. Returns HTML.
    """
    if drawn is None:
        return ""
    request, count = drawn.request, drawn.minima
    if request.style.shape:
        text = "Snapshot of the field reconstructed at the estimated positions (Eq. 6)"
        return f"<div style='{html.CARD}'>{text}</div>"
    minima = "no local minimum" if not count else "1 local minimum" if count == 1 else f"{count} local minima"
    several, modes = len(request.modes) > 1, request.modes
    what = f"sum of {count_label(measurement, modes)}" if several else f"{modes_label(measurement, modes)} alone"
    if request.order_offset is None:
        here, lowest = format_number(drawn.cost_here, 4), format_number(drawn.lowest, 4)
    else:
        here, lowest = (f"{decibels(cost):.1f} dB" for cost in (drawn.cost_here, drawn.lowest))
    what = f"microphone {request.microphone}, {what}"
    what += f": <b>{minima}</b> in the map" if request.style.minima else ""
    lowest = f", lowest {lowest}" if request.style.minima else ""
    orders = f"<br>{drawn.note}" * bool(drawn.note) + (f"<br>{orders}" if orders else "")
    orders = f"<br>{drawn.volume.text}{orders}" if drawn.volume is not None and drawn.volume.text else orders
    return f"<div style='{html.CARD}'>{what}<br>cost at the estimate <b>{here}</b>{lowest}{orders}</div>"
