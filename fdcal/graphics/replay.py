"""A whole run as one HTML file that plays offline: the page's scene, curves and table with a slider, without a server.

The file holds the states as base64 of little-endian numbers; positions are float32 relative to the centre of the array,
accurate to a ten-millionth of its size. It loads nothing, and its content security policy forbids it to. It is far
smaller than a recording of the page's scene, faster to write, and shows more (curves, table, steps).
"""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from ..cost.yardstick import Yardstick
from ..model.gauge import align
from ..model.measurement import Measurement
from ..model.scene import Scene
from .surroundings import focus_of, wall_height, z_range_of

MAX_BYTES = 4_500_000  # of a file; of a longer run fewer states are kept, evenly spaced
STATE_NUMBERS = ("step", "sweep", "stage", "moved", "first", "last")  # of a state, in the file as they are called here
MOST_COSTS = 400  # states whose cost is computed, evenly spaced
BASE_BYTES, NAME_BYTES = 100_000, 60  # of the page itself, and of what it holds about one microphone
TEMPLATE = Path(__file__).with_name("replay.html")


def replay_html(
    scene: Scene | None,
    measurement: Measurement,
    states: Sequence,
    title: str,
    yardstick: Yardstick | None = None,
    sought=None,
) -> str:
    """Return the HTML of a run.

    Parameters
    ----------
    scene : for walls and source, or None
    measurement : for names, true and known microphones
    states : of any solver, oldest first, at least one. Beyond MAX_BYTES fewer of them are kept, evenly spaced, with the
        first and the last
    title : str
    yardstick : Yardstick, the cost of every state; without it no cost is shown
    sought : numbers of the microphones whose errors count; those that are not known unless given
    """
    scored, shape = measurement.positions is not None, states[0].positions.shape
    kept = [states[i] for i in _kept_states(len(states), scored, shape)]
    data = _static_data(scene, measurement) | _state_data(measurement, kept, yardstick, sought)
    data |= {"title": title, "taken": len(states)}
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")  # so that no tag ends in it
    return TEMPLATE.read_text(encoding="utf-8").replace("@TITLE@", escape(title), 1).replace("@DATA@", text, 1)


def _kept_states(count: int, scored: bool, shape: tuple[int, int]) -> np.ndarray:
    """Indices of the states to be kept of `count`, the positions of which have `shape`."""
    each = (4 * shape[0] * shape[1] + 4 * len(STATE_NUMBERS) + 8 * (3 if scored else 1)) * 4 / 3
    most = max(2, int((MAX_BYTES - NAME_BYTES * shape[0] - BASE_BYTES) / each))
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def _static_data(scene: Scene | None, measurement: Measurement) -> dict:
    """What stays the same: names, known microphones, the room."""
    data = {
        "names": list(measurement.names),
        "known": measurement.known.tolist(),
        "aligned": bool(measurement.blind),  # each state is moved as a whole to the true positions
        "dimension": measurement.array_dimension,
        "frequencies": np.round(measurement.frequencies, 3).tolist(),
        "focus": focus_of(measurement),
        "heights": z_range_of(scene, measurement),
        "outline": None,
        "source": None,
        "tall": 0.0,
    }
    if scene is not None and scene.source is not None:
        outline = np.asarray(scene.room.vertices, float).tolist()
        data |= {"outline": outline, "source": list(scene.source.position), "tall": wall_height(scene)}
    return data


def _state_data(measurement: Measurement, states: Sequence, yardstick, sought) -> dict:
    """What changes from state to state."""
    positions, truth = np.array([state.positions for state in states], float), measurement.positions
    if measurement.blind and truth is not None:
        positions = np.array([align(estimate, truth) for estimate in positions])
    origin = positions[-1].mean(axis=0)
    data = {
        "count": len(states),
        "origin": origin.tolist(),
        "positions": _packed(positions - origin, "<f4"),
        "truth": None if truth is None else _packed(truth - origin, "<f4"),
        "mean": None,
        "largest": None,
        "cost": None if yardstick is None else _packed(_costs(states, yardstick), "<f8"),
    }
    if truth is not None:
        free = np.setdiff1d(np.arange(measurement.count), measurement.known) if sought is None else sought
        errors = np.linalg.norm(positions - truth, axis=2)[:, free if len(free) else slice(None)]
        data |= {"mean": _packed(errors.mean(axis=1), "<f8"), "largest": _packed(errors.max(axis=1), "<f8")}
    return data | {name: _packed([getattr(state, name) for state in states], "<i4") for name in STATE_NUMBERS}


def _costs(states: Sequence, yardstick: Yardstick) -> np.ndarray:
    """Cost of each state, dB; of a long run that of MOST_COSTS states, and straight lines between them."""
    computed = np.unique(np.linspace(0, len(states) - 1, min(len(states), MOST_COSTS)).round().astype(int))
    costs = np.array([yardstick.of(states[i]) for i in computed])
    finite = np.isfinite(costs)
    return np.interp(np.arange(len(states)), computed[finite], costs[finite]) if finite.any() else np.zeros(len(states))


def _packed(values, dtype: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype).tobytes()).decode("ascii")
