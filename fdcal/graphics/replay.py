"""A whole run as one HTML file that plays offline: what the page shows, with a slider, in a browser without a server.

The file holds the states as base64 of little-endian numbers, positions as float32 relative to a point amid them, which
is good to a ten-millionth of the array. It loads nothing, and its own policy forbids it to. It is far smaller, sooner
written and shows more (curves, table, steps) than a recording of the page's scene.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from ..model.gauge import align
from ..model.measurement import Measurement
from ..model.scene import Scene
from .heatmap import cost_label
from .picture import static_picture

MAX_BYTES = 4_500_000  # of a file; longer runs are told by fewer states, evenly taken
NUMBERS = ("step", "sweep", "stage", "moved", "first", "last")
TEMPLATE = Path(__file__).with_name("replay.html")


def replay_html(
    scene: Scene | None, measurement: Measurement, states: Sequence, title: str, weights: str = "unit"
) -> str:
    """The HTML of a run.

    Parameters
    ----------
    scene : Scene or None, for the walls and the source
    measurement : Measurement, of microphones' names, the truth and the known ones
    states : of any solver, oldest first, one at least; beyond MAX_BYTES fewer of them, evenly taken, the first and
        the last among them
    title : str
    weights : of the modes, which give the cost its unit
    """
    chosen = [states[i] for i in _chosen(len(states), measurement.positions is not None, states[0].positions.shape)]
    table = _still(scene, measurement) | _moving(measurement, chosen)
    name, _, unit = cost_label(weights).partition(" (")
    table |= {"title": title, "taken": len(states), "cost_name": name, "cost_unit": unit.removesuffix(")")}
    text = json.dumps(table, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")  # no tag ends in it
    return TEMPLATE.read_text(encoding="utf-8").replace("@TITLE@", escape(title), 1).replace("@DATA@", text, 1)


def _chosen(count: int, told: bool, shape: tuple[int, int]) -> np.ndarray:
    """Numbers of the states to be kept of `count`, positions of which have `shape`."""
    each = (4 * shape[0] * shape[1] + 4 * len(NUMBERS) + 8 * (3 if told else 1)) * 4 / 3
    most = max(2, int((MAX_BYTES - 60 * shape[0] - 100_000) / each))
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def _still(scene: Scene | None, measurement: Measurement) -> dict:
    """What stays: names, known microphones, the room."""
    picture, D = static_picture(scene, measurement), measurement.array_dimension
    table = {
        "names": list(measurement.names),
        "known": measurement.known.tolist(),
        "aligned": bool(measurement.blind),  # each state is moved as a whole onto the truth
        "dimension": D,
        "frequencies": np.round(measurement.frequencies, 3).tolist(),
        "focus": picture.focus,
        "heights": picture.z_range,
        "outline": None,
        "source": None,
        "tall": 0.0,
    }
    if scene is not None:
        outline = np.asarray(scene.room.vertices, float)
        tall = scene.room.size[2] if scene.room.dimension == 3 else 0.12 * float(np.ptp(outline, axis=0).max())
        table |= {"outline": outline.tolist(), "source": list(scene.source.position), "tall": tall}
    return table


def _moving(measurement: Measurement, states: Sequence) -> dict:
    """What changes, state by state."""
    positions = np.array([state.positions for state in states], float)
    if measurement.blind and measurement.positions is not None:
        positions = np.array([align(places, measurement.positions) for places in positions])
    truth, origin = measurement.positions, positions[-1].mean(axis=0)
    table = {
        "count": len(states),
        "origin": [*map(float, origin)],
        "positions": _packed(positions - origin, "<f4"),
        "truth": None if truth is None else _packed(truth - origin, "<f4"),
        "mean": None,
        "largest": None,
        "cost": _packed([state.cost for state in states], "<f8"),
    }
    if truth is not None:
        errors = np.linalg.norm(positions - truth, axis=2)
        table |= {"mean": _packed(errors.mean(axis=1), "<f8"), "largest": _packed(errors.max(axis=1), "<f8")}
    return table | {name: _packed([getattr(state, name) for state in states], "<i4") for name in NUMBERS}


def _packed(values, dtype: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype).tobytes()).decode("ascii")
