"""Where the name of a microphone stands: beside it, where it hides the fewest other marks."""

from __future__ import annotations

import numpy as np

from .primitives import Anchor

# In radii of a marker: sizes of a text on the screen where the search domain fills it, and distances.
LETTER, HEIGHT = 1.2, 2.8  # width of a letter, with its share of the edges; height of a text
BESIDE, ABOVE = 2.6, 3.0  # from the microphone to the near edge of its name
MARK = 1.2  # reach of another mark
# Where the near edge of the name is, from the microphone, and the part of the text that lies there; the first of equals
# is taken.
SIDES: tuple[tuple[float, float, Anchor], ...] = (
    (1, 0, "center-left"),
    (-1, 0, "center-right"),
    (0, 1, "bottom-center"),
    (0, -1, "top-center"),
    (0.7, 0.7, "bottom-left"),
    (-0.7, 0.7, "bottom-right"),
    (0.7, -0.7, "top-left"),
    (-0.7, -0.7, "top-right"),
    (2.2, 0, "center-left"),
    (-2.2, 0, "center-right"),
    (0, 2.2, "bottom-center"),
    (0, -2.2, "top-center"),
)
OUTSIDE = 100.0  # hidden marks that a text beyond the edge is worth


def name_place(
    text: str, place, marks, focus: tuple[float, float, float, float], marker_radius: float
) -> tuple[tuple[float, float], Anchor]:
    """Return where a name stands, metres, and its anchor.

    `place` (2,) float64, metres, of the microphone; `marks` (P, 2) float64, metres, of the other marks; `focus`: box
    (x0, y0, x1, y1), metres, which the name does not leave if it can; `marker_radius`: metres.
    """
    best, least = SIDES[0], np.inf
    for side in SIDES:
        box = _box(text, place, side, marker_radius)
        beyond = box[0] < focus[0] or box[1] < focus[1] or box[2] > focus[2] or box[3] > focus[3]
        hidden = OUTSIDE * beyond + _hidden(box, np.reshape(marks, (-1, 2)), MARK * marker_radius)
        if hidden < least:
            best, least = side, hidden
    return _point(place, best, marker_radius), best[2]


def _point(place, side: tuple[float, float, Anchor], marker_radius: float) -> tuple[float, float]:
    reach = marker_radius * (ABOVE if side[0] == 0 else BESIDE)
    return float(place[0] + side[0] * reach), float(place[1] + side[1] * reach)


def _box(text: str, place, side: tuple[float, float, Anchor], marker_radius: float) -> np.ndarray:
    """The box (x0, y0, x1, y1) that a name takes on one side of a microphone, metres."""
    width, height = LETTER * len(text) * marker_radius, HEIGHT * marker_radius
    x, y = _point(place, side, marker_radius)
    left = x - width * (0.5 if side[0] == 0 else float(side[0] < 0))
    low = y - height * (0.5 if side[1] == 0 else float(side[1] < 0))
    return np.array([left, low, left + width, low + height])


def _hidden(box: np.ndarray, marks: np.ndarray, reach: float) -> int:
    """How many marks, as squares of half edge `reach`, metres, a box touches."""
    low, high = marks - reach, marks + reach
    touches = (low[:, 0] < box[2]) & (high[:, 0] > box[0]) & (low[:, 1] < box[3]) & (high[:, 1] > box[1])
    return int(touches.sum())
