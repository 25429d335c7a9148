"""Where array and source stand in the room of a case."""

from dataclasses import dataclass

import numpy as np

from .spec import Spec

TRIES = 200
WALL = 0.25  # metres that the array keeps from the walls
RANGES = {2: ((4.5, 9.0), (3.5, 7.0)), 3: ((4.5, 8.0), (3.6, 6.5), (2.5, 3.6))}  # metres, of drawn rooms


@dataclass(frozen=True)
class Placement:
    """Array and source in their room, metres.

    points : (N, D); source : (D,); second : (D,) or None, of a second source; size : (D,) of the room or None;
    radius : of the array
    """

    points: np.ndarray
    source: np.ndarray
    second: np.ndarray | None
    size: np.ndarray | None
    radius: float


def place(spec: Spec, array: np.ndarray, rng, shape=None) -> Placement | None:
    """Return a placement of `array` (N, D), metres, whose source is where the spec wants it; None if none was found.

    shape : `finite_elements.Shape` of the room, which fixes the source, or None for a drawn box
    """
    half = np.abs(array).max(axis=0)
    if spec.dimension == 3 and array.shape[1] == 2:
        array, half = np.c_[array, np.zeros(len(array))], np.r_[half, 0.05]
    for _ in range(TRIES):
        placed = _drawn(spec, array, half, rng) if shape is None else _in_shape(array, shape, rng)
        placed = _with_source(spec, placed, rng)
        if placed is not None or shape is not None:
            return placed
    return None


def moved_sources(spec: Spec, placed: Placement, rng) -> list[Placement]:
    """Return a placement for each take: that of the first, and sources of the same kind elsewhere in a drawn box."""
    every = [placed]
    for _ in range(TRIES * spec.takes):
        if len(every) == spec.takes:
            break
        moved = _with_source(spec, _moved(placed, rng.uniform(0.15, placed.size - 0.15)), rng)
        every += [] if moved is None else [moved]
    return every


def _drawn(spec: Spec, array, half, rng) -> Placement:
    margin = half + WALL
    drawn = spec.size_of_room or [rng.uniform(*limits) for limits in RANGES[spec.dimension]]
    size = np.array(drawn)
    if np.any(size < 2 * margin + 0.05):
        size = np.maximum(size, 2 * margin + 0.6)
    points = array + rng.uniform(margin, size - margin)
    rng.uniform(0.2, 1, len(size))  # a draw that earlier cases made, kept so that a seed gives the same case
    source = rng.uniform(0.15, size - 0.15)
    return Placement(points, source, None, size, _radius(points))


def _in_shape(array, shape, rng) -> Placement:
    points = array + np.array(shape.centre) + rng.uniform(-0.2, 0.2, 2)
    return Placement(points, np.array(shape.source), None, None, _radius(points))


def _radius(points) -> float:
    return float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())


def _with_source(spec: Spec, placed: Placement, rng) -> Placement | None:
    """Return `placed` with the source that the spec wants; None if the draw does not allow it."""
    points, middle = placed.points, placed.points.mean(axis=0)

    def nearest(source) -> float:
        return float(np.linalg.norm(points - source, axis=1).min())

    if spec.source == "far":
        outside = np.linalg.norm(placed.source - middle) > placed.radius + 0.4 or spec.size > 2.2
        far = nearest(placed.source) > (1.0 if spec.size <= 2.2 else 0.6) and outside
        return placed if far or placed.size is None else None
    if spec.source == "two":
        second = rng.uniform(0.15, placed.size - 0.15)
        apart = nearest(placed.source) > 1 and nearest(second) > 1
        return _moved(placed, placed.source, second) if apart else None
    if spec.source == "near":
        source = _beside(placed, middle, nearest, rng)
        return _moved(placed, source) if (source > 0.1).all() and (source < placed.size - 0.1).all() else None
    source = middle + 0.3 * placed.radius * rng.standard_normal(len(middle)) / np.sqrt(len(middle))
    return _moved(placed, source) if nearest(source) > 0.04 else None


def _beside(placed: Placement, middle, nearest, rng) -> np.ndarray:
    """Return a source 0.3 m from the nearest microphone, outside the array."""
    direction = rng.standard_normal(len(middle))
    direction /= np.linalg.norm(direction)
    source = middle
    for distance in np.arange(0, 6, 0.01):
        source = middle + direction * distance
        if nearest(source) > 0.3 and distance > 0.9 * placed.radius:
            break
    return source


def _moved(placed: Placement, source, second=None) -> Placement:
    return Placement(placed.points, source, second, placed.size, placed.radius)
