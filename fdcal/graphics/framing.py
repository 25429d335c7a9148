"""The extent of a picture of a measurement without a search domain: a box around all positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..model.measurement import Measurement
from ..model.settings import Search

MARGIN = 0.25  # on all sides of the box, of its longest edge
STEPS = 40  # along its longest edge
MIN_EDGE = 0.4  # m, of its longest edge


def with_display_domain(measurement: Measurement, positions) -> Measurement:
    """Return the measurement as it is to be drawn: with a search domain around the positions if it has none.

    For pictures alone: a solver must not take this domain for something known.

    `positions` (N, D) float64, metres, the estimate.
    """
    if measurement.search is not None:
        return measurement
    positions = np.asarray(positions, float)
    known = np.asarray(measurement.known_positions, float).reshape(-1, positions.shape[1])
    points = [positions, known]
    if measurement.positions is not None and not measurement.blind:
        points.append(measurement.positions)
    points = np.concatenate(points)
    low, high = points.min(axis=0), points.max(axis=0)
    edge = max(float((high - low).max()), MIN_EDGE)
    step = edge / STEPS
    counts = np.ceil((high - low + 2 * MARGIN * edge) / step)
    origin = (low + high - counts * step) / 2
    search = Search(tuple(map(float, origin)), tuple(map(float, counts * step)), step, radius=edge)
    return replace(measurement, search=search)
