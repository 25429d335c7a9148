"""What surrounds the microphones in a picture: room and source, the search domain with its rulers, or a box around all.

Lengths are metres.
"""

from dataclasses import replace

import numpy as np

from ..model.measurement import Measurement
from ..model.scene import Scene
from ..model.settings import Search
from . import glyphs
from .markers import TRUE, Layer, layer_height, lines, mesh, strokes
from .primitives import Anchor, Label, Lines, Mesh, Theme

MARGIN = 0.25  # on all sides of the box, of its longest edge
STEPS = 40  # along its longest edge
MIN_EDGE = 0.4  # m, of its longest edge


def with_display_domain(measurement: Measurement, positions) -> Measurement:
    """Return the measurement as it is to be drawn: with a search domain around the positions (N, D) if it has none.

    For pictures alone: a solver must not take this domain for something known.
    """
    if measurement.search is not None:
        return measurement
    positions = np.asarray(positions, float)
    known = np.asarray(measurement.known_positions, float).reshape(-1, positions.shape[1])
    points = [positions, known]
    if measurement.positions is not None and not measurement.blind:
        points.append(measurement.positions)
    points = np.concatenate(points)
    low, high = points.min(axis=0), points.max(axis=0)
    edge = max(float((high - low).max()), MIN_EDGE)
    step = edge / STEPS
    counts = np.ceil((high - low + 2 * MARGIN * edge) / step)
    origin = (low + high - counts * step) / 2
    search = Search(tuple(map(float, origin)), tuple(map(float, counts * step)), step, radius=edge)
    return replace(measurement, search=search)


Box = tuple[float, float, float, float]

PLANE_WALLS = 0.12  # height of the walls of a plane room, of its longer side
MIN_SOURCE = 0.012  # quarter of the mark of a source in space, of the room's longer side: seen in the whole room
QUIET_SOURCE = 0.5  # size of the marks of the sources that are not of the chosen take, of those that are
EMPTY_MARGIN = 0.1  # m around the microphones where there is no search domain


def focus_of(measurement: Measurement) -> Box:
    """Return the box (x0, y0, x1, y1) that a picture shows, metres: the search domain, or all known positions."""
    search = measurement.search
    if search is not None:
        low = np.array(search.origin[:2], float) - search.step / 2  # a candidate stands in the middle of its cell
        high = low + np.array(search.shape[:2]) * search.step
    else:
        points = measurement.positions if measurement.positions is not None else measurement.known_positions
        points = np.asarray(points, float)[:, :2] if len(points) else np.array([[0.0, 0.0], [1.0, 1.0]])
        low, high = points.min(axis=0) - EMPTY_MARGIN, points.max(axis=0) + EMPTY_MARGIN
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def z_range_of(scene: Scene | None, measurement: Measurement) -> tuple[float, float]:
    """Return the lowest and the highest z that a picture shows, metres; for a plane array its height, twice."""
    search = measurement.search
    if measurement.array_dimension == 2:
        centre = None if scene is None else scene.array.center
        height = float(centre[2]) if centre is not None and len(centre) == 3 else 0.0
        return height, height
    if search is not None:
        return float(search.origin[2]), float(search.origin[2] + search.size[2])
    points = measurement.positions if measurement.positions is not None else measurement.known_positions
    z = np.asarray(points, float)[:, 2] if len(points) else np.array([0.0, 1.0])
    return float(z.min() - EMPTY_MARGIN), float(z.max() + EMPTY_MARGIN)


def wall_height(scene: Scene) -> float:
    """Return the height of the walls as they are drawn, metres; a plane room has low ones."""
    size = scene.room.size
    if scene.room.dimension == 3 and size is not None:
        return size[2]
    return PLANE_WALLS * float(np.ptp(scene.room.vertices, axis=0).max())


def frame(focus: Box, base: float, marker_radius: float, theme: Theme) -> tuple[tuple[Lines, ...], tuple[Label, ...]]:
    """Return the outline of the search domain at height `base`, metres, with its rulers."""
    x0, y0, x1, y1 = focus
    level = base + layer_height(Layer.FRAME, marker_radius)
    pieces = [glyphs.loop([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], level)]
    labels = []
    edges: list[tuple[float, float, float, Anchor]] = [(x0, x1, y0, "top-center"), (y0, y1, x0, "center-right")]
    for axis, (low, high, across, anchor) in enumerate(edges):
        ticks, places, texts = glyphs.ruler(low, high, across, axis, 1.2 * marker_radius, level)
        pieces.append(ticks)
        labels += _numbers("xy"[axis], places, texts, theme, anchor)
    labels.append(Label("frame/x", "x (m)", (x1, y0 - 3.8 * marker_radius, level), theme.foreground, "top-right"))
    labels.append(Label("frame/y", "y (m)", (x0, y1 + 2.0 * marker_radius, level), theme.foreground, "bottom-center"))
    return (lines("frame", np.concatenate(pieces), theme.foreground, 1.5),), tuple(labels)


def upper_frame(
    focus: Box, z_range: tuple[float, float], marker_radius: float, theme: Theme
) -> tuple[tuple[Lines, ...], tuple[Label, ...]]:
    """Return the edges of a search domain in space above its base, with a ruler of heights at its left edge.

    From the top its numbers coincide, and one label gives the whole range of heights.
    """
    x0, y0, x1, y1 = focus
    low, high = z_range
    corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    uprights = glyphs.stems(glyphs.lift(corners, low), high)
    ticks, places, texts = glyphs.upright_ruler((x0, y1), low, high, 1.2 * marker_radius)
    text = f"z {low:.2f} to {high:.2f} m"
    labels = (
        Label("frame/range", text, (x1, y1 + marker_radius, high), theme.foreground, "bottom-right"),
        Label("frame/z", "z (m)", (x0, y1, high + 3 * marker_radius), theme.foreground, "bottom-center"),
        *_numbers("z", places, texts, theme, "center-right"),
    )
    return (
        lines("frame_uprights", uprights, theme.grid, 1.5),
        lines("frame_top", np.concatenate([glyphs.loop(corners, high), ticks]), theme.foreground, 1.0),
    ), labels


def _numbers(axis: str, places: np.ndarray, texts: tuple[str, ...], theme: Theme, anchor: Anchor) -> list[Label]:
    """The numbers of a ruler at `places` (T, 3), metres."""
    return [
        Label(f"frame/{axis}{i}", text, (x, y, z), theme.foreground, anchor)
        for i, ((x, y, z), text) in enumerate(zip(places.tolist(), texts, strict=True))
    ]


def room_and_source(
    scene: Scene, marker_radius: float, theme: Theme, take: int | None = None
) -> tuple[tuple[Lines, ...], tuple[Label, ...], tuple[Mesh, ...]]:
    """Return the walls, the grid on the floor and the source of a scene that is no measured room.

    Of several places of the source each is marked with its take; where one take is chosen, the others are drawn small.
    """
    room_lines, meshes = _room(scene, marker_radius, theme)
    places = glyphs.lift(np.array(scene.emitter.places, float), layer_height(Layer.SOURCE, marker_radius))
    several = len(places) > 1
    extent = float(np.ptp(scene.room.vertices, axis=0).max())
    seen_whole = several or scene.room.dimension == 3  # in a room that is far larger than the array
    radius = max(marker_radius, MIN_SOURCE * extent) if seen_whole else marker_radius
    labels = []
    for number, place in enumerate(places):
        chosen = take in (None, number)
        size, colour = (radius, theme.foreground) if chosen else (QUIET_SOURCE * radius, theme.quiet)
        name, text = (f"source/{number}", f"take {number}") if several else ("source", "source")
        meshes += strokes(name, glyphs.stars(place[None], 2 * size, arms=4), size, TRUE, 0.4)
        if several and scene.room.dimension == 3:
            room_lines += (lines(f"{name}/stem", glyphs.stems(place[None], 0.0), colour, 2.0 if chosen else 1.0),)
        x, y, z = place.tolist()
        text = f"source, {text}" if several and chosen else text
        labels.append(Label(f"{name}/name", text, (x, y - 3 * size, z), colour, "top-center"))
    return room_lines, tuple(labels), meshes


def _room(scene: Scene, marker_radius: float, theme: Theme) -> tuple[tuple[Lines, ...], tuple[Mesh, ...]]:
    """Walls and floor grid; a box by its edges alone, for walls of full height would veil what is in the room."""
    vertices, height = scene.room.vertices, wall_height(scene)
    extent = float(np.ptp(vertices, axis=0).max())
    edges = glyphs.loop(vertices, layer_height(Layer.WALLS, marker_radius))
    grid = glyphs.floor_grid(vertices, 1.0 if extent > 3.0 else 0.2, layer_height(Layer.GRID, marker_radius))
    if scene.room.dimension == 3:
        sources = np.array(scene.emitter.places, float)
        feet = np.concatenate([glyphs.lift(vertices, height), sources[: len(sources) == 1]])
        box = np.concatenate([glyphs.loop(vertices, height), glyphs.stems(feet, 0.0)])
        meshes, before = (), (lines("room/box", box, theme.grid, 1.0),)
    else:
        edges = np.concatenate([edges, glyphs.loop(vertices, height)])
        meshes, before = (mesh("room/walls", glyphs.walls(vertices, height), theme.foreground, opacity=0.12),), ()
    grid_lines = lines("room/grid", grid, theme.grid, 1.0)
    strong = not before  # the edges of a room that is higher than the array cross the picture of it
    colour, width = (theme.foreground, 2.0) if strong else (theme.quiet, 1.0)
    return (*before, grid_lines, lines("room/edges", edges, colour, width)), meshes
