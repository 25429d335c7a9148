"""The marks of a picture: their colours, the order in which they cover each other, and their shapes.

True microphones are black circles, estimates red crosses, known microphones blue squares, the lowest cost of the map an
orange diamond, faulty channels violet circles with a bar. The shapes differ first; the colours differ for colour-blind
eyes, too. A white halo around each keeps it legible on the map and on any background.

Marks are flat and have a size in the room, not on the screen: lengths are metres, colours RGB from 0 to 255.
"""

import enum

import numpy as np

from ..model.validation import frozen_array
from . import glyphs
from .primitives import Colour, Floor, Lines, Mesh, Theme

TRUE, ESTIMATE, KNOWN, HALO = (0, 0, 0), (214, 24, 40), (0, 90, 181), (255, 255, 255)
LOWEST = (255, 132, 0)
TRAIL, ELLIPSE, FAULTY = (240, 130, 200), (255, 110, 60), (128, 0, 255)
CUT = (0, 95, 95)
HALO_WIDTH = 0.34  # of a mark of microphones, in radii of a marker, on both sides together


class Layer(enum.IntEnum):
    """Height of each mark over the floor, in layers: what is higher covers what is lower."""

    GRID = -4
    WALLS = 1
    FRAME = 2
    ERROR = 2
    TRAIL = 3
    TRUE = 4
    SOURCE = 4
    KNOWN = 6
    ELLIPSE = 7
    ESTIMATE = 8
    MINIMUM = 9
    FAULTY = 9
    SELECTED_TRUE = 10
    SELECTED = 12
    CUT = 13


LAYERS_PER_RADIUS = 24  # layers in the height of one radius of a marker


def layer_height(layer: int, marker_radius: float) -> float:
    """Return the height of a layer over the floor, metres."""
    return layer * marker_radius / LAYERS_PER_RADIUS


def on_layer(points, base: float, marker_radius: float, layer: int) -> np.ndarray:
    """Return points (P, 2) on the floor at height `base`, or (P, 3) in space, raised to a layer : (P, 3), metres."""
    return glyphs.lift(points, layer_height(layer, marker_radius) + (base if np.shape(points)[1] == 2 else 0.0))


def drape(points, floor: Floor | None, radius: float = 0.0) -> np.ndarray:
    """Return points (P, 2) with the height that a map in relief has there : (P, 3), metres.

    `radius`: of a flat mark at each point, which lies above the slope: the highest height within it counts. Points stay
    unchanged where the map is flat or missing, or where they have a height.
    """
    points = np.atleast_2d(np.asarray(points, float))
    if floor is None or floor.heights is None or points.shape[1] == 3:
        return points
    counts = np.array(floor.heights.shape[::-1])
    cell = np.divide(floor.size, counts)
    reach = (radius + float(cell.max()) / 2) * np.arange(-1, 2) if radius else np.zeros(1)
    around = np.stack(np.meshgrid(reach, reach), axis=-1).reshape(-1, 1, 2)
    place = (points + around - floor.origin) / cell - 0.5
    column, row = np.moveaxis(np.clip(np.rint(place), 0, counts - 1).astype(int), 2, 0)
    return np.column_stack([points, floor.height + floor.heights[row, column].max(axis=0)])


def lines(name: str, segments, colour: Colour, width: float) -> Lines:
    """Return frozen line segments (S, 2, 3), metres, `width` pixels wide."""
    return Lines(name, frozen_array(segments, np.float32), colour, width)


def mesh(name: str, triangles: glyphs.Triangles, colour: Colour, opacity: float = 1.0) -> Mesh:
    """Return a frozen mesh of vertices (V, 3), metres, and faces (F, 3)."""
    vertices, faces = triangles
    return Mesh(name, frozen_array(vertices, np.float32), frozen_array(faces, np.int32), colour, opacity)


def _with_halo(
    name: str, mark: glyphs.Triangles, wider: glyphs.Triangles, colour: Colour, marker_radius: float
) -> tuple[Mesh, Mesh]:
    """Return a mark, and below it, by one layer, its halo: a wider one."""
    vertices, faces = wider
    below = vertices - [0, 0, layer_height(1, marker_radius)], faces
    return mesh(f"{name}_halo", below, HALO), mesh(name, mark, colour)


def strokes(
    name: str, segments: np.ndarray, marker_radius: float, colour: Colour, width: float, halo: float = HALO_WIDTH
) -> tuple[Mesh, Mesh]:
    """Return bars along (S, 2, 3), metres, and their halo, one layer below, by `halo` wider, in radii of a marker."""
    wider = glyphs.strokes(segments, (width + halo) * marker_radius, halo / 2 * marker_radius)
    return _with_halo(name, glyphs.strokes(segments, width * marker_radius), wider, colour, marker_radius)


def circles(
    name: str, centres: np.ndarray, marker_radius: float, width: float, radius: float = 1.0
) -> tuple[Mesh, Mesh]:
    """Return black circles around (P, 3), metres, and their halo; `width`, `radius` in radii of a marker."""
    ring, wider = (
        glyphs.annuli(centres, radius * marker_radius, each * marker_radius) for each in (width, width + HALO_WIDTH)
    )
    return _with_halo(name, ring, wider, TRUE, marker_radius)


def known_microphones(positions, base: float, marker_radius: float) -> tuple[Mesh, Mesh]:
    """Return squares at the known microphones (K, 2 or 3), metres, and their halo."""
    centres = on_layer(positions, base, marker_radius, Layer.KNOWN)
    square, wider = (glyphs.squares(centres, edge * marker_radius) for edge in (1.0, 1.3))
    return _with_halo("microphones/known", square, wider, KNOWN, marker_radius)


def true_microphones(
    positions, z_range: tuple[float, float], marker_radius: float, theme: Theme
) -> tuple[Mesh | Lines, ...]:
    """Return circles at the true positions (N, 2 or 3), metres; in space with stems down to the floor."""
    base, top = z_range
    centres = on_layer(positions, base, marker_radius, Layer.TRUE)
    stems = (lines("microphones/stems", glyphs.stems(centres, base), theme.grid, 1.0),)
    return *circles("microphones/true", centres, marker_radius, 0.28), *(stems if top > base else ())
