"""The picture of an array as primitives, which the page and the PNG renderer draw.

`static_picture` has the room, the source, the search domain with its rulers, and the true microphones; `with_estimate`
adds the estimate, `with_floor` a map. Lengths are metres, colours RGB from 0 to 255. `fdcal.graphics.marks` defines the
marks.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import get_args

import numpy as np

from ..model.measurement import Measurement
from ..model.scene import Scene
from ..model.validation import Reals, length_text
from . import glyphs
from .heatmap import relief_sides
from .marks import ESTIMATE, MARKS, Layer, drape, layer_height, lines, marked, mesh, on_layer, strokes, true_microphones
from .primitives import THEMES, Anchor, Floor, Label, Lines, Mesh, Picture, Theme

Box = tuple[float, float, float, float]
Part = Lines | Mesh | Label

PLANE_WALLS = 0.12  # height of the walls of a plane room over its longer side
MIN_SOURCE = 0.012  # a quarter of the least size of a source's mark, over the room's longer side, to be visible
EMPTY_MARGIN = 0.1  # m around the microphones if there is no search domain


def focus_of(measurement: Measurement) -> Box:
    """Return the box (x0, y0, x1, y1) that a picture shows, metres: the search domain, or all known positions."""
    search = measurement.search
    if search is not None:
        low = np.array(search.origin[:2], float) - search.step / 2  # a candidate is the centre of its cell
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
    """Return the height at which the walls are drawn, metres; a plane room has low walls."""
    size = scene.room.size
    if scene.room.dimension == 3 and size is not None:
        return size[2]
    return PLANE_WALLS * float(np.ptp(scene.room.vertices, axis=0).max())


HEIGHT_TICKS = "frame_ticks"  # name of the ruler's ticks; seen from the top they overlap


def frame(focus: Box, z_range: tuple[float, float], marker_radius: float, theme: Theme) -> tuple[Part, ...]:
    """Return the outline of the search domain with its rulers; in space also the edges above its base.

    Seen from the top the numbers of the heights coincide; another label then gives their whole range.
    """
    (x0, y0, x1, y1), (low, high), tick = focus, z_range, 1.2 * marker_radius
    level, corners = low + layer_height(Layer.FRAME, marker_radius), [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    pieces, labels = [glyphs.loop(corners, level)], list[Label]()
    edges: list[tuple[float, float, float, Anchor]] = [(x0, x1, y0, "top-center"), (y0, y1, x0, "center-right")]
    for axis, (start, end, across, anchor) in enumerate(edges):
        ticks, places, texts = glyphs.ruler(start, end, across, axis, tick, level)
        pieces.append(ticks)
        labels += _numbers("xy"[axis], places, texts, anchor)
    labels.append(Label("frame/x", "x (m)", (x1, y0 - 3.8 * marker_radius, level), "top-right"))
    labels.append(Label("frame/y", "y (m)", (x0, y1 + 2.0 * marker_radius, level), "bottom-center"))
    outline = lines("frame", np.concatenate(pieces), theme.foreground, 1.5)
    if high <= low:
        return outline, *labels
    values = glyphs.round_ticks(low, high, 5)
    ticks = np.array([[(x0, y1, z), (x0 - tick, y1, z)] for z in values]).reshape(-1, 2, 3)
    text, place = f"z {low:z.2f} to {high:z.2f} m", (x1, y1 + marker_radius, high)
    return (
        outline,
        *labels,
        lines("frame_uprights", glyphs.stems(glyphs.lift(corners, low), high), theme.grid, 1.5),
        lines("frame_top", glyphs.loop(corners, high), theme.foreground, 1.0),
        lines(HEIGHT_TICKS, ticks, theme.foreground, 1.0),
        Label("frame/range", text, place, "bottom-right"),
        Label("frame/z", "z (m)", (x0, y1, high + 3 * marker_radius), "bottom-center"),
        *_numbers("z", ticks[:, 1] - [0.6 * tick, 0.0, 0.0], glyphs.tick_texts(values), "center-right"),
    )


def _numbers(axis: str, places: np.ndarray, texts: tuple[str, ...], anchor: Anchor) -> list[Label]:
    """Return the numbers of a ruler at `places` (T, 3), metres."""
    return [
        Label(f"frame/{axis}{i}", text, (x, y, z), anchor)
        for i, ((x, y, z), text) in enumerate(zip(places.tolist(), texts, strict=True))
    ]


def room_and_source(scene: Scene, marker_radius: float, theme: Theme) -> list[Part]:
    """Return the walls, the grid on the floor and the source of a scene whose room is not a measured one.

    A source with several positions is marked at each of them, with the number of the take.
    """
    vertices, height, sources = scene.room.vertices, wall_height(scene), np.array(scene.emitter.places, float)
    several, extent = len(sources) > 1, float(np.ptp(vertices, axis=0).max())
    edges = glyphs.loop(vertices, layer_height(Layer.WALLS, marker_radius))
    grid = glyphs.floor_grid(vertices, 1.0 if extent > 3.0 else 0.2, layer_height(Layer.GRID, marker_radius))
    if scene.room.dimension == 3:  # only the edges of a box, since its walls would hide the inside
        feet = np.concatenate([glyphs.lift(vertices, height), sources[: len(sources) == 1]])
        box = np.concatenate([glyphs.loop(vertices, height), glyphs.stems(feet, 0.0)])
        first, colour, width = lines("room/box", box, theme.grid, 1.0), theme.quiet, 1.0  # its lines cross the array
    else:
        edges = np.concatenate([edges, glyphs.loop(vertices, height)])
        first = mesh("room/walls", glyphs.walls(vertices, height), theme.foreground, opacity=0.12)
        colour, width = theme.foreground, 2.0
    parts = [first, lines("room/grid", grid, theme.grid, 1.0), lines("room/edges", edges, colour, width)]
    places = glyphs.lift(sources, layer_height(Layer.SOURCE, marker_radius))
    seen_whole = several or scene.room.dimension == 3  # in a room that is far larger than the array
    radius = max(marker_radius, MIN_SOURCE * extent) if seen_whole else marker_radius
    for number, place in enumerate(places):
        name, text = (f"source/{number}", f"source, take {number}") if several else ("source", "source")
        parts += strokes(name, glyphs.stars(place[None], 2 * radius, arms=4), radius, 0.4, "microphones/true")
        if several and scene.room.dimension == 3:
            parts.append(lines(f"{name}/stem", glyphs.stems(place[None], 0.0), theme.foreground, 2.0))
        x, y, z = place.tolist()
        parts.append(Label(f"{name}/name", text, (x, y - 3 * radius, z), "top-center"))
    return parts


# In radii of a marker, for a search domain that fills the screen: size of a text, and distances.
LETTER, HEIGHT = 1.2, 2.8  # mean width of a letter, margins included; height of a text
BESIDE, ABOVE = 3.2, 3.2  # distance of a name from its microphone, beyond a diamond around it
MARK = 1.2  # radius of another mark
# Directions from the microphone to its name, in the order of preference.
SIDES = (
    *((1, 0), (-1, 0), (0, 1), (0, -1)), *((0.7, 0.7), (-0.7, 0.7), (0.7, -0.7), (-0.7, -0.7)),
    *((2.2, 0), (-2.2, 0), (0, 2.2), (0, -2.2)),
)  # fmt: skip
OUTSIDE = 100.0  # number of hidden marks that is as bad as a text beyond the edge


def name_place(
    text: str, place, marks, focus: tuple[float, float, float, float], marker_radius: float
) -> tuple[tuple[float, float], Anchor]:
    """Return the position, metres, and the anchor of the name of a microphone at `place`.

    It is inside `focus` and hides as few of `marks` as possible.
    """
    width, height = LETTER * len(text) * marker_radius, HEIGHT * marker_radius
    low, high = (np.reshape(marks, (-1, 2)) + reach for reach in (-MARK * marker_radius, MARK * marker_radius))
    found = []
    for across, up in SIDES:
        reach = marker_radius * (ABOVE if across == 0 else BESIDE)
        x, y = float(place[0] + across * reach), float(place[1] + up * reach)
        left = x - width * (0.5 if across == 0 else float(across < 0))
        bottom = y - height * (0.5 if up == 0 else float(up < 0))
        right, top = left + width, bottom + height
        beyond = left < focus[0] or bottom < focus[1] or right > focus[2] or top > focus[3]
        touched = (low[:, 0] < right) & (high[:, 0] > left) & (low[:, 1] < top) & (high[:, 1] > bottom)
        anchor = get_args(Anchor)[int(3 * (1 + np.sign(up)) + 1 - np.sign(across))]  # at the near edge of the text
        found.append((OUTSIDE * beyond + int(touched.sum()), (x, y), anchor))
    return min(found, key=lambda one: one[0])[1:]


NOMINAL = (("microphones/true", "nominal"), ("microphones/error", "deviation"))  # captions for nominal positions
PLANE_MARKER, SPACE_MARKER = 0.0125, 0.016  # radius of a marker over the longer side of the search domain


def compose(
    scene: Scene | None,
    measurement: Measurement,
    positions=None,
    microphone: int | None = None,
    floor: Floor | None = None,
    title: str = "",
    dark: bool = False,
) -> Picture:
    """Return the whole picture; `microphone`: the selected one, which is drawn larger and named."""
    picture = static_picture(scene, measurement, dark, floor)
    if positions is not None:
        picture = with_estimate(picture, measurement, positions, microphone, floor)
    return replace(with_floor(picture, floor), title=title)


def static_picture(
    scene: Scene | None, measurement: Measurement, dark: bool = False, floor: Floor | None = None, lecture: bool = False
) -> Picture:
    """Return the part of the picture that does not change while a solver runs.

    `scene` has room and source; `floor` is a map in relief, on which the true microphones stand, and which `with_floor`
    draws; `lecture`: whether texts, marks and contrast suit a projector.
    """
    theme = THEMES[dark][lecture]
    focus, z_range = focus_of(measurement), z_range_of(scene, measurement)
    base, top = z_range
    extent = max(focus[2] - focus[0], focus[3] - focus[1])
    radius = theme.marks * (PLANE_MARKER if base == top else SPACE_MARKER) * extent
    bounds, parts = focus, []
    if scene is not None and scene.room.response is None:  # the walls and the source of a measured room are unknown
        vertices = scene.room.vertices
        (x0, y0), (x1, y1) = vertices.min(axis=0).tolist(), vertices.max(axis=0).tolist()
        bounds = (x0, y0, x1, y1)
        parts += room_and_source(scene, radius, theme)
    parts += frame(focus, z_range, radius, theme)
    if measurement.positions is not None:
        parts += true_microphones(drape(measurement.positions, floor, radius), z_range, radius, theme)
    if len(measurement.known):
        places = on_layer(drape(measurement.known_positions, floor, radius), base, radius, Layer.KNOWN)
        parts += marked("microphones/known", places, radius)
    captions = NOMINAL if measurement.nominal else ()
    return Picture(theme, focus, bounds, radius, captions=captions, z_range=z_range).plus(*parts)


def with_floor(picture: Picture, floor: Floor | None) -> Picture:
    """Return the picture with a map on the floor, diamonds at its lowest costs and small ones at its other minima.

    None removes the map.
    """
    if floor is None:
        return replace(picture, floor=None)
    if floor.heights is not None:
        picture = picture.plus(*relief_sides(floor, picture.theme))
    radius, curves = picture.marker_radius, {f"same/{i}": curve for i, curve in enumerate(floor.curves[::-1])}
    captions = (*picture.captions, *floor.captions, *((name, curve.text) for name, curve in curves.items()))
    picture = replace(picture, floor=floor, captions=captions)
    for name, curve in curves.items():
        along = glyphs.lift(curve.segments.reshape(-1, 2), floor.height + layer_height(Layer.TRAIL, radius))
        picture = picture.plus(*strokes(name, along.reshape(-1, 2, 3), radius))
    if not floor.show_minima:
        return picture
    for name, places in (("minima", floor.minima), ("lowest", floor.lowest)):
        if places:
            spots, heights = np.array(places), np.full(len(places), floor.height)
            if floor.heights is not None:  # the highest corner of the mark touches the map
                corners = MARKS[name].reach * radius * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
                heights = drape((spots[:, None] + corners).reshape(-1, 2), floor)[:, 2].reshape(-1, 4).max(axis=1)
            spots = np.column_stack([spots, heights + layer_height(Layer.MINIMUM, radius)])
            picture = picture.plus(*marked(name, spots, radius))
    return picture


def with_estimate(
    picture: Picture,
    measurement: Measurement,
    positions,
    microphone: int | None = None,
    floor: Floor | None = None,
    truth: Reals | None = None,
    pointed: Sequence[int] = (),
) -> Picture:
    """Return the picture with the estimated positions and the selected microphone.

    A known microphone also has a cross if its estimate differs from the given position, since the solver corrects given
    positions or the user has moved it. `truth` (N, D), metres, are the true positions as they are drawn; without it,
    those of a blind array are aligned with the estimate.

    `microphone`: the selected one; `pointed`: microphones with a ring around them and a name with their error.
    """
    truth = measurement.aligned_truth(positions) if truth is None else truth
    radius, base, known = picture.marker_radius, picture.z_range[0], measurement.known
    estimates, errors, away = np.asarray(positions, float), None, None
    crossed = np.ones(len(estimates), bool)  # without the known ones whose square would hide the cross
    if len(known):
        crossed[known] = np.linalg.norm(estimates[known] - measurement.known_positions, axis=1) > radius
    if truth is not None:  # lines from each true position to its estimate, unless the marks hide them
        away = np.linalg.norm(estimates - truth, axis=1)
        far = away > radius
        on_relief = floor is not None and floor.heights is not None and estimates.shape[1] == 2
        way = np.linspace(truth[far], estimates[far], ERROR_PIECES + 1 if on_relief else 2)  # (P, F, D)
        points = drape(way.reshape(-1, way.shape[2]), floor, radius / 2)
        points = on_layer(points, base, radius, Layer.ERROR).reshape(*way.shape[:2], 3)
        errors = np.stack([points[:-1], points[1:]], axis=2).reshape(-1, 2, 3)
        truth = drape(truth, floor, radius)
    positions = drape(positions, floor, radius)
    if truth is not None and measurement.blind:
        moved = true_microphones(truth, picture.z_range, radius, picture.theme)
        still = ("microphones/true", "microphones/stems")
        meshes = tuple(part for part in picture.meshes if not part.name.startswith(still))
        kept = tuple(part for part in picture.lines if not part.name.startswith(still))
        picture = replace(picture, meshes=meshes, lines=kept).plus(*moved)
    if errors is not None and len(errors):
        picture = picture.plus(*strokes("microphones/error", errors, radius))
    places = on_layer(positions[crossed], base, radius, Layer.ESTIMATE)
    picture = picture.plus(*marked("microphones/estimate", places, radius))
    minima = np.empty((0, 2)) if floor is None or not floor.show_minima else np.array([*floor.lowest, *floor.minima])
    marks = np.concatenate([positions[:, :2], minima] if truth is None else [positions[:, :2], minima, truth[:, :2]])

    def named(n: int, words: str, name: str) -> Label:
        """Return the name of a microphone where it hides the fewest marks."""
        text = f"microphone {measurement.names[n]}{words}"
        (x, y), anchor = name_place(text, positions[n, :2], np.delete(marks, n, axis=0), picture.focus, radius)
        z = float(on_layer(positions[[n]], base, radius, Layer.SELECTED)[0, 2])
        return Label(name, text, (x, y, z), anchor)

    errors_of = {n: "" if away is None else f": {length_text(away[n], 2)} off" for n in pointed}
    if errors_of:
        rings = on_layer(positions[list(errors_of)], base, radius, Layer.FAULTY)
        labels = [named(n, words, f"pointed/{n}") for n, words in errors_of.items() if n != microphone]
        picture = picture.plus(*marked("microphones/pointed", rings, radius), *labels)
    if microphone is None or not 0 <= microphone < len(positions):
        return picture
    cross = on_layer(positions[[microphone]], base, radius, Layer.SELECTED)
    if truth is not None:
        circle = on_layer(truth[[microphone]], base, radius, Layer.SELECTED_TRUE)
        picture = picture.plus(*marked("selected/true", circle, radius))
    picture = picture.plus(*marked("selected/estimate", cross, radius))
    if picture.z_range[1] > base:  # a line connects the microphone with the map below it
        picture = picture.plus(lines("selected/stem", glyphs.stems(cross, base), ESTIMATE, 2.0))
    return picture.plus(named(microphone, errors_of.get(microphone, ""), "selected/name"))


ERROR_PIECES = 40  # of an error line on a relief; a straight line would go through hills


def row_word(measurement: Measurement) -> str:
    """Return the word for a row of a measurement: "mode", or "row" if there are several takes."""
    return "row" if measurement.take_count > 1 else "mode"
