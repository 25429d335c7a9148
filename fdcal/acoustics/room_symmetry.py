"""The symmetries of a rectangular or box-shaped room: mirror images and exchanged axes."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class RoomSymmetry:
    """A symmetry of a room, which leaves all pressures in it unchanged."""

    size: tuple[float, ...]  # (D,) float, metres
    order: tuple[int, ...]  # (D,) int, axis that each coordinate is taken from
    flipped: tuple[bool, ...]  # (D,) bool, whether a coordinate is counted from the far wall

    def apply(self, points) -> np.ndarray:
        """Return `points` (..., D), metres, mirrored and with axes exchanged."""
        points = np.asarray(points, float)[..., self.order]
        return np.where(self.flipped, np.asarray(self.size) - points, points)

    def __str__(self) -> str:
        names = ["xyz"[a] for a in self.order]
        parts = [f"{s:g} - {n}" if f else n for n, s, f in zip(names, self.size, self.flipped, strict=True)]
        return f"({', '.join(parts)})"


def room_symmetries(size) -> list[RoomSymmetry]:
    """Return every symmetry of a room of `size` (D,), metres, the identity first.

    They are mirror images along its axes, with axes of equal length exchanged.
    """
    D = len(size)
    orders = [o for o in itertools.permutations(range(D)) if all(size[a] == size[b] for a, b in enumerate(o))]
    flips = itertools.product((False, True), repeat=D)
    return [RoomSymmetry(tuple(size), order, flipped) for flipped, order in itertools.product(flips, orders)]


def nearest_symmetry(points, to, size) -> RoomSymmetry:
    """Return the symmetry of a room that brings points nearest to others in the least-squares sense.

    `points`, `to` (N, D) float64, metres; `size` (D,) float, of the room, metres.
    """
    return min(room_symmetries(size), key=lambda image: float(np.sum((image.apply(points) - to) ** 2)))
