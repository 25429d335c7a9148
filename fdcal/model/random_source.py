"""A random place for a source in a rectangular room: away from the walls and from the microphones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

WALL_DISTANCE_M = 0.1  # of a source from every wall at least: half the depth of a small loudspeaker
DRAWS = 500  # before a room is taken to have no place


def random_source(
    size, microphones: np.ndarray, clearance: float, rng: np.random.Generator, allowed: Callable[[np.ndarray], bool]
) -> np.ndarray | None:
    """Return a place drawn evenly over the room, rounded to a millimetre.

    `size` (2,) or (3,) sequence of float, lengths of the room, metres; `microphones` (N, 2 or 3) float64, metres.
    Without heights in a room with a height, horizontal distances count; `clearance`: least distance from every
    microphone, metres; `allowed`: whether a place, (2 or 3,) float64, is possible otherwise. Returns (2 or 3,) float64
    or None, none where no place was found.
    """
    size = np.asarray(size, float)
    for _ in range(DRAWS):
        place = np.round(WALL_DISTANCE_M + rng.random(len(size)) * (size - 2 * WALL_DISTANCE_M), 3)
        away = np.linalg.norm(microphones - place[: microphones.shape[1]], axis=1).min()
        if away > clearance and allowed(place):
            return place
    return None
