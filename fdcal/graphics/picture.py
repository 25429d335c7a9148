"""What there is to see, as primitives that any renderer can draw: one picture, two renderers.

    backdrop        what stays: room, source, search domain, true and known microphones
    with_estimate   what a step changes: crosses, error lines, the microphone looked at
    with_floor      a map from `fdcal.graphics.heatmap`, and where its lowest cost and its other minima stand
    compose         all of these at once

True microphones are black circles, estimates red crosses, known microphones blue squares, the lowest cost of the map an
amber diamond: shapes first, colours that colour-blind eyes tell apart second. Each has a white halo, which keeps it
legible on the map and on any background.
Lengths are metres, colours RGB from 0 to 255. Markers are flat and have a size in the room, not on the screen.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..model.measurement import Measurement
from ..model.scene import Scene
from ..model.validation import frozen_array
from . import glyphs
from .primitives import DARK, LIGHT, Colour, Floor, Label, Lines, Picture, Solid, Theme

LAYERS = 24  # heights in one radius of a marker: what is drawn over the map lies that little above it
TRUE, ESTIMATE, KNOWN, HALO = (0, 0, 0), (214, 24, 40), (0, 90, 181), (255, 255, 255)
LOWEST = (255, 176, 0)
TRAIL, ERROR = (240, 130, 200), (255, 110, 60)
ELLIPSE = 36  # sides of a drawn ellipse
RACERS = {  # colour, the mark, its corners (0: a plus) and radius in radii of a marker: marks in one place stay apart
    "joint": ("#009e73", "plus", 0, 0.8),  # colours of Okabe and Ito, which colour-blind eyes tell
    "descent": ("#d55e00", "triangle", 3, 1.3),
    "descent+joint": ("#cc79a7", "square", 4, 1.9),
}


def compose(
    scene: Scene | None,
    measurement: Measurement,
    positions=None,
    microphone: int | None = None,
    floor: Floor | None = None,
    title: str = "",
    dark: bool = False,
) -> Picture:
    """The whole picture.

    Parameters
    ----------
    scene : Scene or None, for room and source
    measurement : for true and known microphones, names and the search domain
    positions : (N, D) float64, metres, the estimate; None draws none
    microphone : the one looked at, drawn larger and named
    floor : from `paint`
    """
    picture = backdrop(scene, measurement, dark, floor)
    if positions is not None:
        picture = with_estimate(picture, measurement, positions, microphone, floor)
    return replace(with_floor(picture, floor), title=title)


def with_floor(picture: Picture, floor: Floor | None) -> Picture:
    """The picture with a map on the floor, a diamond where it is lowest, small ones at other minima; None takes all."""
    if floor is None or not floor.marked:
        return replace(picture, floor=floor)
    marker, height = picture.marker, 9 * picture.marker / LAYERS
    reach = marker * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    others = [place for place in floor.minima if np.hypot(*np.subtract(place, floor.minimum)) > marker]
    solids = picture.solids
    if others:
        small = np.concatenate([_loop_on(floor, 1.6 * reach + place, height) for place in others])
        solids += _strokes("minima", small, marker, LOWEST, 0.32, halo=0.25)
    diamond = _loop_on(floor, 2.8 * reach + floor.minimum, height)
    solids += _strokes("lowest", diamond, marker, LOWEST, 0.45, halo=0.25)
    return replace(picture, floor=floor, solids=solids)


def _loop_on(floor: Floor, corners: np.ndarray, z: float) -> np.ndarray:
    """A level closed line through `corners` (V, 2), metres, that touches the map with its highest corner."""
    top = float(drape(corners, floor)[:, 2].max()) if floor.heights is not None else floor.height
    return glyphs.loop(corners, z + top)


def drape(points, floor: Floor | None) -> np.ndarray:
    """Points (P, 2) with the height of the map there : (P, 3), metres; unchanged where the map is flat or missing."""
    points = np.atleast_2d(np.asarray(points, float))
    if floor is None or floor.heights is None or points.shape[1] == 3:
        return points
    place = (points - floor.origin) / np.divide(floor.size, floor.heights.shape[::-1]) - 0.5
    column, row = np.clip(np.rint(place), 0, np.array(floor.heights.shape[::-1]) - 1).astype(int).T
    return np.column_stack([points, floor.height + floor.heights[row, column]])


def backdrop(scene: Scene | None, measurement: Measurement, dark: bool = False, ground: Floor | None = None) -> Picture:
    """What stays the same while a solver runs; on a map with heights, `ground`, the microphones stand on it."""
    theme = DARK if dark else LIGHT
    focus, heights = _focus(measurement), heights_of(scene, measurement)
    base = heights[0]
    marker = (0.0125 if base == heights[1] else 0.016) * max(focus[2] - focus[0], focus[3] - focus[1])
    layer = marker / LAYERS
    lines, labels = _frame(focus, base, marker, theme)
    if heights[1] > base:
        box_lines, box_labels = _box(focus, heights, marker, theme)
        lines, labels = lines + box_lines, labels + box_labels
    bounds, solids = focus, ()
    if scene is not None:
        vertices = scene.room.vertices
        bounds = (*map(float, vertices.min(axis=0)), *map(float, vertices.max(axis=0)))
        room_lines, room_labels, solids = _room(scene, marker, theme)
        lines, labels = room_lines + lines, labels + room_labels
    if measurement.positions is not None:
        true_solids, true_lines = _truth(drape(measurement.positions, ground), heights, marker, theme)
        solids, lines = solids + true_solids, lines + true_lines
    if len(measurement.known):
        solids += _squares(_raised(drape(measurement.known_positions, ground), base, 6 * layer), marker)
    return Picture(theme, focus, bounds, marker, lines, solids, labels, heights=heights)


def _truth(places, heights, marker: float, theme: Theme) -> tuple[tuple[Solid, ...], tuple[Lines, ...]]:
    """True microphones at `places` (N, D), metres; in space with stems down to the floor."""
    base = heights[0]
    centres = _raised(places, base, 4 * marker / LAYERS)
    stems = (_lines("microphones/stems", glyphs.stems(centres, base), theme.faint, 1.0),)
    return _circles("microphones/true", centres, marker, 0.28), stems if heights[1] > base else ()


def _squares(centres: np.ndarray, marker: float) -> tuple[Solid, Solid]:
    """Known microphones at (A, 3), metres."""
    below = centres - [0, 0, marker / LAYERS]
    return (
        _solid("microphones/known_halo", glyphs.squares(below, 1.3 * marker), HALO),
        _solid("microphones/known", glyphs.squares(centres, marker), KNOWN),
    )


def with_estimate(
    picture: Picture, measurement: Measurement, positions, microphone: int | None = None, ground: Floor | None = None
) -> Picture:
    """The picture with the estimate (N, D), metres, and one microphone looked at, on `ground` where that has heights.

    A known microphone that a hand has moved is drawn where it is now supposed to be. The true places of a blind array
    are moved as a whole, to where the estimate is: nothing tells it where it stands.
    """
    truth = measurement.aligned_truth(positions)
    truth = None if truth is None else drape(truth, ground)
    positions, marker, known = drape(positions, ground), picture.marker, measurement.known
    if truth is not None and measurement.blind:
        picture = _with_truth_at(picture, truth)
    layer, solids, base = marker / LAYERS, picture.solids, picture.heights[0]
    if len(known):
        others = tuple(solid for solid in solids if not solid.name.startswith("microphones/known"))
        solids = others + _squares(_raised(positions[known], base, 6 * layer), marker)
    free = np.setdiff1d(np.arange(len(positions)), known)
    if truth is not None:
        pieces = np.stack([_raised(one, base, 2 * layer) for one in (truth, positions)], axis=1)
        moved = np.isin(np.arange(len(truth)), free) | (np.ptp(pieces, axis=1) > 1e-6).any(axis=1)
        solids += _strokes("microphones/error", pieces[moved], marker, TRUE, 0.13, halo=0.2)
    crosses = glyphs.stars(_raised(positions[free], base, 8 * layer), marker)
    solids += _strokes("microphones/estimate", crosses, marker, ESTIMATE, 0.34)
    if microphone is None or not 0 <= microphone < len(positions):
        return replace(picture, solids=solids)
    found = _raised(positions[[microphone]], base, 12 * layer)
    if truth is not None:
        circle = _raised(truth[[microphone]], base, 10 * layer)
        solids += _circles("looked_at/true", circle, marker, 0.44, radius=1.9)
    solids += _strokes("looked_at/estimate", glyphs.stars(found, 1.9 * marker), marker, ESTIMATE, 0.54)
    towards = 0.0 if truth is None else float(truth[microphone, 0] - positions[microphone, 0])
    label = _name_tag(picture, f"microphone {measurement.names[microphone]}", found[0], towards)
    lines = picture.lines
    if picture.heights[1] > base:  # what ties the microphone to the map below it
        lines += (_lines("looked_at/stem", glyphs.stems(found, base), ESTIMATE, 2.0),)
    return replace(picture, lines=lines, solids=solids, labels=(*picture.labels, label))


def _with_truth_at(picture: Picture, places) -> Picture:
    """The picture with its true microphones at `places` (N, D), metres."""
    solids, lines = _truth(places, picture.heights, picture.marker, picture.theme)
    names = {part.name for part in (*solids, *lines)}
    still = [tuple(part for part in parts if part.name not in names) for parts in (picture.solids, picture.lines)]
    return replace(picture, solids=still[0] + solids, lines=still[1] + lines)


def with_trails(picture: Picture, paths, ground: Floor | None = None) -> Picture:
    """The picture with the way of every microphone: `paths` (T, N, D), metres, oldest first; a stay draws nothing."""
    paths = np.asarray(paths, float)
    if len(paths) < 2:
        return picture
    base, z = picture.heights[0], 3 * picture.marker / LAYERS
    flat = _raised(drape(paths.reshape(-1, paths.shape[2]), ground), base, z)
    points = flat.reshape(*paths.shape[:2], 3)
    pieces = np.stack([points[:-1], points[1:]], axis=2).reshape(-1, 2, 3)
    pieces = pieces[np.abs(pieces[:, 1] - pieces[:, 0]).max(axis=1) > 1e-9]
    if not len(pieces):
        return picture
    return replace(picture, lines=(*picture.lines, _lines("trails", pieces, TRAIL, 2.0)))


def with_ellipses(picture: Picture, positions, axes, ground: Floor | None = None) -> Picture:
    """The picture with an error ellipse about each microphone; `axes` (N, D, D), metres, half axes in rows.

    Of an ellipsoid the largest section is drawn. Microphones whose ellipse is no larger than a dot have none.
    """
    axes, positions = np.asarray(axes, float), np.asarray(positions, float)
    base, z = picture.heights[0], 7 * picture.marker / LAYERS
    long, middle = axes[:, -1], axes[:, -2]
    seen = np.flatnonzero(np.linalg.norm(long, axis=1) > 1e-6)
    if not len(seen):
        return picture
    centres = _raised(drape(positions[seen], ground), base, z)
    pad = ((0, 0), (0, 3 - axes.shape[2]))
    long, middle = np.pad(long[seen], pad), np.pad(middle[seen], pad)
    angles = np.linspace(0, 2 * np.pi, ELLIPSE + 1)
    rim = np.cos(angles)[:, None, None] * long + np.sin(angles)[:, None, None] * middle + centres
    pieces = np.stack([rim[:-1], rim[1:]], axis=2).reshape(-1, 2, 3)
    return replace(picture, lines=(*picture.lines, _lines("ellipses", pieces, ERROR, 2.5)))


def with_racers(picture: Picture, placed, free, ground: Floor | None = None) -> Picture:
    """The picture with a mark where each racer supposes each of the microphones `free`.

    placed : dict of names, keys of RACERS, to positions (N, D), metres
    """
    marker, solids = picture.marker, picture.solids
    for i, (name, positions) in enumerate(placed.items()):
        colour, _, corners, reach = RACERS[name]
        z = (14 + 2 * i) * marker / LAYERS
        centres = _raised(drape(np.asarray(positions)[free], ground), picture.heights[0], z)
        if corners:
            marks = glyphs.polygons(centres, reach * marker, corners)
        else:
            marks = glyphs.stars(centres, reach * marker, turn=0.0)
        rgb = tuple(int(colour[j : j + 2], 16) for j in (1, 3, 5))
        solids += _strokes(f"racers/{name.replace('+', '_')}", marks, marker, rgb, 0.3, halo=0.14)
    return replace(picture, solids=solids)


def _name_tag(picture: Picture, text: str, place, towards: float) -> Label:
    """A text beside `place` (3,), metres: not over the truth, which lies `towards` in x, and not beyond the edge."""
    x0, _, x1, _ = picture.focus
    share = (place[0] - x0) / (x1 - x0)
    left = share > 0.8 or (towards > 0 and share > 0.15)
    beside = float(place[0] + (-2.6 if left else 2.6) * picture.marker)
    anchor = "center-right" if left else "center-left"
    return Label("looked_at/name", text, (beside, float(place[1]), float(place[2])), TRUE, anchor)


def headline(measurement: Measurement, positions) -> str:
    """Mean and largest position error in words, or that the truth is not known."""
    if measurement.positions is None:
        return "true positions unknown"
    errors = measurement.errors(positions)
    aligned = ", once aligned" if measurement.blind else ""
    return f"mean error {millimetres(errors.mean())}, largest {millimetres(errors.max())}{aligned}"


def millimetres(length: float) -> str:
    """A length in metres as a text in millimetres: 4.13 mm, 535 mm."""
    return f"{in_millimetres(length)} mm"


def in_millimetres(length: float) -> str:
    """The number of millimetres of a length in metres, three figures below a decimetre."""
    if length < 1e-6:
        return "0"
    return f"{1e3 * length:.3g}" if length < 0.1 else f"{1e3 * length:.0f}"


def _focus(measurement: Measurement) -> tuple[float, float, float, float]:
    """The search domain, or the box about all positions known."""
    search = measurement.search
    if search is not None:
        low = np.array(search.origin[:2], float) - search.step / 2  # a candidate stands in the middle of its cell
        high = low + np.array(search.shape[:2]) * search.step
    else:
        points = measurement.positions if measurement.positions is not None else measurement.known_positions
        points = np.asarray(points, float)[:, :2] if len(points) else np.array([[0.0, 0.0], [1.0, 1.0]])
        low, high = points.min(axis=0) - 0.1, points.max(axis=0) + 0.1
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def heights_of(scene: Scene | None, measurement: Measurement) -> tuple[float, float]:
    """Lowest and highest z of the search domain, or about all positions known; of a plane array twice its height."""
    search = measurement.search
    if measurement.array_dimension == 2:
        height = float(scene.array.center[2]) if scene is not None and scene.room.dimension == 3 else 0.0
        return height, height
    if search is not None:
        return float(search.origin[2]), float(search.origin[2] + search.size[2])
    points = measurement.positions if measurement.positions is not None else measurement.known_positions
    z = np.asarray(points, float)[:, 2] if len(points) else np.array([0.0, 1.0])
    return float(z.min() - 0.1), float(z.max() + 0.1)


def _raised(points, base: float, z: float) -> np.ndarray:
    """Points `z` above where they are : (P, 3), metres; those of two coordinates are at height `base`."""
    return glyphs.lift(points, z + (base if np.shape(points)[1] == 2 else 0.0))


def _frame(focus, base: float, marker: float, theme: Theme) -> tuple[tuple[Lines, ...], tuple[Label, ...]]:
    """Outline of the search domain at height `base`, with rulers in metres."""
    x0, y0, x1, y1 = focus
    level = base + 2 * marker / LAYERS
    pieces = [glyphs.loop([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], level)]
    labels = []
    for axis, (low, high, across, anchor) in enumerate([(x0, x1, y0, "top-center"), (y0, y1, x0, "center-right")]):
        ticks, places, texts = glyphs.ruler(low, high, across, axis, 1.2 * marker, level)
        pieces.append(ticks)
        for i, (place, text) in enumerate(zip(places, texts, strict=True)):
            words = f"{text} m" if i == 0 else text
            labels.append(Label(f"frame/{'xy'[axis]}{i}", words, tuple(map(float, place)), theme.ink, anchor))
    labels.append(Label("frame/x", "x", (x1 + 2.5 * marker, y0, level), theme.ink, "center-left"))
    labels.append(Label("frame/y", "y", (x0, y1 + 2.0 * marker, level), theme.ink, "bottom-center"))
    return (_lines("frame", np.concatenate(pieces), theme.ink, 1.5),), tuple(labels)


def _box(focus, heights, marker: float, theme: Theme) -> tuple[tuple[Lines, ...], tuple[Label, ...]]:
    """The search domain's edges above its base. From the top they fall together, so one text tells of all heights."""
    x0, y0, x1, y1 = focus
    corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    uprights = glyphs.stems(glyphs.lift(corners, heights[0]), heights[1])
    text = f"z {heights[0]:.2f} to {heights[1]:.2f} m"
    label = Label("frame/z", text, (x1, y1 + marker, heights[1]), theme.ink, "bottom-right")
    lines = (
        _lines("frame_uprights", uprights, theme.faint, 1.5),
        _lines("frame_top", glyphs.loop(corners, heights[1]), theme.ink, 1.0),
    )
    return lines, (label,)


def _room(scene: Scene, marker: float, theme: Theme):
    """Lines, labels and solids of walls, floor grid and source."""
    vertices, place, layer = scene.room.vertices, np.array([scene.source.position], float), marker / LAYERS
    boxed = scene.room.dimension == 3
    height = scene.room.size[2] if boxed else 0.12 * float(np.ptp(vertices, axis=0).max())
    edges, upper, solids = glyphs.loop(vertices, layer), glyphs.loop(vertices, height), ()
    lines: tuple[Lines, ...] = ()
    if boxed:  # walls of full height would veil what is in the room: its edges are enough
        uprights = glyphs.stems(np.concatenate([glyphs.lift(vertices, height), place]), 0.0)
        lines = (_lines("room/box", np.concatenate([upper, uprights]), theme.faint, 2.0),)
    else:
        edges = np.concatenate([edges, upper])
        solids = (_solid("room/walls", glyphs.walls(vertices, height), theme.ink, opacity=0.12),)
    spacing = 1.0 if np.ptp(vertices, axis=0).max() > 3.0 else 0.2
    grid = glyphs.floor_grid(vertices, spacing, -4 * layer)
    place = glyphs.lift(place, 4 * layer)
    solids += _strokes("source", glyphs.stars(place, 2 * marker, arms=4), marker, TRUE, 0.4)
    lines += (_lines("room/grid", grid, theme.faint, 1.0), _lines("room/edges", edges, theme.ink, 2.0))
    beside = (float(place[0, 0]), float(place[0, 1] - 3 * marker), float(place[0, 2]))
    return lines, (Label("source/name", "source", beside, theme.ink, "top-center"),), solids


def _lines(name: str, segments, colour: Colour, width: float) -> Lines:
    return Lines(name, frozen_array(segments, np.float32), colour, width)


def _solid(name: str, triangles, colour: Colour, opacity: float = 1.0) -> Solid:
    return Solid(name, frozen_array(triangles[0], np.float32), frozen_array(triangles[1], np.int32), colour, opacity)


def _circles(name: str, centres, marker: float, width: float, radius: float = 1.0) -> tuple[Solid, Solid]:
    """Circles of true microphones on wider white ones, a layer lower; widths and radius in radii of a marker."""
    below = centres - [0, 0, marker / LAYERS]
    return (
        _solid(f"{name}_halo", glyphs.annuli(below, radius * marker, (width + 0.34) * marker), HALO),
        _solid(name, glyphs.annuli(centres, radius * marker, width * marker), TRUE),
    )


def _strokes(
    name: str, segments, marker: float, colour: Colour, width: float, halo: float = 0.34
) -> tuple[Solid, Solid]:
    """Bars on wider white ones, a layer lower; widths in radii of a marker."""
    below = segments - [0, 0, marker / LAYERS]
    return (
        _solid(f"{name}_halo", glyphs.strokes(below, (width + halo) * marker, halo / 2 * marker), HALO),
        _solid(name, glyphs.strokes(segments, width * marker), colour),
    )
