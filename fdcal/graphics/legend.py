"""The legend of a picture: exactly the marks that are drawn in it, in one order, for every renderer.

legend_of   the entries of a picture
MARKS       every mark that has an entry, by the name of its part

A symbol is drawn in a square from -1 to 1, y upwards. The page, the PNG and the test of both read the same entries.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .glyphs import polygons, stars
from .markers import CUT, ELLIPSE, ESTIMATE, KNOWN, LOWEST, ODD, TRAIL, TRUE, solver_mark
from .overlays import ELLIPSE_TEXT
from .primitives import Area, Lines, Mesh, Picture
from .theme import Colour

CIRCLE_SIDES = 24
OUTLINE: Colour = (128, 128, 128)  # of an area, which may be as light as the page
LOW_COST: Colour = (59, 82, 139)  # of COLOUR_MAP, at a quarter of the scale
COMPARED = "comparison/"  # begins the names of the parts of compared solvers
HALO = "_halo"  # ends the names of the parts below a mark

Path = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Entry:
    """One mark of a legend."""

    name: str  # of the part of the picture that it explains
    text: str  # what the mark stands for
    paths: tuple[Path, ...]  # its lines, each a sequence of corners from -1 to 1
    colour: Colour
    width: float = 0.26  # of its lines, in halves of the symbol's edge
    filled: bool = False  # whether the first path is filled
    halo: bool = True  # whether it has a halo, as in the scene
    halo_colour: Colour = (255, 255, 255)


def _path(points: np.ndarray) -> Path:
    return tuple((float(x), float(y)) for x, y in points[:, :2])


def _ring(radius: float, squeezed: float = 1.0) -> Path:
    angles = 2 * np.pi * np.arange(CIRCLE_SIDES + 1) / CIRCLE_SIDES
    return _path(radius * np.column_stack([np.cos(angles), squeezed * np.sin(angles)]))


def _star(radius: float, turn: float = np.pi / 4) -> tuple[Path, ...]:
    return tuple(_path(pair) for pair in stars(np.zeros((1, 3)), radius, turn=turn))


def _diamond(radius: float) -> Path:
    return ((radius, 0.0), (0.0, radius), (-radius, 0.0), (0.0, -radius), (radius, 0.0))


def _square(half: float) -> Path:
    return ((-half, -half), (half, -half), (half, half), (-half, half), (-half, -half))


LEVEL: Path = ((-0.9, 0.0), (0.9, 0.0))
MARKS = {
    entry.name: entry
    for entry in (
        Entry("microphones/true", "true", (_ring(0.58),), TRUE, 0.22),
        Entry("microphones/estimate", "estimate", _star(0.75), ESTIMATE, 0.28),
        Entry("microphones/known", "known", (_square(0.5),), KNOWN, 0.1, filled=True),
        Entry("microphones/error", "error", (LEVEL,), TRUE, 0.14),
        Entry("lowest", "lowest cost", (_diamond(0.56),), LOWEST),
        Entry("minima", "other minimum", (_diamond(0.38),), LOWEST, 0.2),
        Entry("isosurfaces", "isosurface", (_ring(0.75), _ring(0.35)), LOW_COST, 0.2, halo=False),
        Entry("slice", "slice", (_square(0.6),), LOW_COST, 0.1, filled=True, halo=False),
        Entry("trails", "trail", (LEVEL,), TRAIL, 0.24, halo=False),
        Entry("ellipses", ELLIPSE_TEXT, (_ring(0.8, 0.5),), ELLIPSE, 0.24, halo=False),
        Entry("cut", "cut from A to B", (LEVEL,), CUT, 0.24, halo=False),
        Entry("microphones/odd", "odd channel", (_ring(0.66), ((-0.47, 0.47), (0.47, -0.47))), ODD, 0.2),
    )
}


def legend_of(picture: Picture) -> tuple[Entry, ...]:
    """Return the entries of a picture: areas of its map, the marks that can be seen in the order of MARKS, solvers.

    `picture`: its `captions` add words to entries.
    """
    seen = {part.name for part in (*picture.meshes, *picture.lines) if _is_visible(part, picture)}
    seen |= {"isosurfaces"} if picture.surfaces else set()
    seen |= {"slice"} if picture.plates else set()
    captions = dict(picture.captions)
    entries = [entry for name, entry in MARKS.items() if name in seen]
    names = [part.name for part in picture.meshes if part.name.startswith(COMPARED) and not part.name.endswith(HALO)]
    entries += [compared_entry(name, captions.get(name, name.removeprefix(COMPARED))) for name in names]
    if picture.areas:  # the slice has the colours of the areas
        entries = [replace(entry, filled=False) if entry.name == "slice" else entry for entry in entries]
    named = tuple(replace(entry, text=captions.get(entry.name, entry.text)) for entry in entries)
    return tuple(area_entry(area) for area in picture.areas) + named


def area_entry(area: Area) -> Entry:
    """Return the entry of an area of a map, which has a colour and no mark."""
    return Entry(area.name, area.text, (_square(0.75),), area.colour, 0.1, filled=True, halo_colour=OUTLINE)


def compared_entry(name: str, solver: str) -> Entry:
    """Return the entry of a compared solver, whose marks are the part `name`."""
    mark = solver_mark(solver)
    if mark.corners:
        sides = polygons(np.zeros((1, 3)), 0.7, mark.corners)
        paths: tuple[Path, ...] = (_path(np.concatenate([sides[:, 0], sides[:1, 0]])),)
    else:
        paths = _star(0.8, turn=0.0)
    return Entry(name, solver, paths, mark.rgb, 0.24)


def _is_visible(part: Mesh | Lines, picture: Picture) -> bool:
    """Whether a part has anything to be seen: an error line shorter than a marker lies below its marks."""
    if isinstance(part, Lines):
        return bool(len(part.segments))
    if part.name != "microphones/error":
        return bool(len(part.faces))
    corners = part.vertices.reshape(-1, 4, 3)  # a bar each, from its first corner to its second
    return bool((np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1) > picture.marker_radius).any())
