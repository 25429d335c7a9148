"""The frame of a picture where nothing tells within which bounds to look: a box about where everything is supposed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..model.measurement import Measurement
from ..model.settings import Search

BESIDE, STEPS = 0.25, 40  # of the longest edge of the box: left free on all sides; and steps along it
SMALLEST = 0.4  # m, longest edge at least


def with_display_domain(measurement: Measurement, positions) -> Measurement:
    """The measurement as it is to be drawn : with a search domain about `positions` (N, D), metres, if it has none.

    For pictures alone: no solver may take what is drawn for what is known.
    """
    if measurement.search is not None:
        return measurement
    points = [
        np.asarray(positions, float),
        np.asarray(measurement.known_positions, float).reshape(-1, np.shape(positions)[1]),
    ]
    if measurement.positions is not None and not measurement.blind:
        points.append(measurement.positions)
    points = np.concatenate(points)
    low, high = points.min(axis=0), points.max(axis=0)
    edge = max(float((high - low).max()), SMALLEST)
    step = edge / STEPS
    counts = np.ceil((high - low + 2 * BESIDE * edge) / step)
    origin = (low + high - counts * step) / 2
    search = Search(tuple(map(float, origin)), tuple(map(float, counts * step)), step, radius=edge)
    return replace(measurement, search=search)
