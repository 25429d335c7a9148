"""The picture of an array as primitives, which the page and the PNG renderer draw.

`static_picture` has the room, the source, the search domain with its rulers, and the true microphones; `with_estimate`
adds the estimate, `with_floor` a map. The functions at the end add trails, error ellipses, faulty channels, the cost in
space and a ball. Lengths are metres, colours RGB from 0 to 255. `fdcal.graphics.marks` defines the marks.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, get_args

import numpy as np

from ..model.measurement import Measurement
from ..model.scene import Scene
from ..model.validation import Reals, length_text
from . import glyphs, marks
from .heatmap import relief_sides
from .marks import MARKS, Layer, drape, layer_height, lines, marked, mesh, on_layer, strokes
from .primitives import THEMES, Anchor, Colour, Floor, Label, Lines, Mesh, Picture, Theme, mixed

if TYPE_CHECKING:  # the volume loads SciPy
    from .volume import Volume

Box = tuple[float, float, float, float]
Part = Lines | Mesh | Label

PLANE_WALLS = 0.12  # ratio of the height of the walls of a plane room to its longer side
MIN_SOURCE = 0.012  # least ratio of the radius of a visible source's mark to the longer side of the room
FAINTER = 0.32  # fraction of the background in the colour of less important lines
EMPTY_MARGIN = 0.1  # m around the microphones if there is no search domain


def focus_of(measurement: Measurement) -> Box:
    """Return the box (x0, y0, x1, y1) that a picture shows, metres: the search domain or, if none, the microphones."""
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


HEIGHT_TICKS = "frame_ticks"  # name of the ticks of the z ruler, which coincide in the view from the top


def frame(focus: Box, z_range: tuple[float, float], marker_radius: float, theme: Theme) -> list[Part]:
    """Return the outline of the search domain with its rulers, and for an array in space the edges above its base.

    In the view from the top the numbers of the z ruler would coincide; renderers show the label "frame/range" instead.
    """
    (x0, y0, x1, y1), (low, high), tick = focus, z_range, 1.2 * marker_radius
    level, corners = low + layer_height(Layer.FRAME, marker_radius), [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    pieces, rulers = [glyphs.loop(corners, level)], list[tuple[str, np.ndarray, np.ndarray, Anchor]]()
    edges: list[tuple[float, float, float, Anchor]] = [(x0, x1, y0, "top-center"), (y0, y1, x0, "center-right")]
    for axis, (start, end, across, anchor) in enumerate(edges):
        values = glyphs.round_ticks(start, end, 8)
        ticks = np.full((len(values), 2, 3), level)
        ticks[:, :, axis] = values[:, None]
        ticks[:, 0, 1 - axis], ticks[:, 1, 1 - axis] = across, across - tick
        pieces.append(ticks)
        rulers.append(("xy"[axis], ticks[:, 1] - 0.6 * tick * np.eye(3)[1 - axis], values, anchor))
    parts: list[Part] = [lines("frame", np.concatenate(pieces), theme.foreground, 1.5)]
    parts.append(Label("frame/x", "x (m)", (x1, y0 - 3.8 * marker_radius, level), "top-right"))
    parts.append(Label("frame/y", "y (m)", (x0, y1 + 2.0 * marker_radius, level), "bottom-center"))
    if high > low:
        values = glyphs.round_ticks(low, high, 5)
        ticks = np.array([[(x0, y1, z), (x0 - tick, y1, z)] for z in values]).reshape(-1, 2, 3)
        rulers.append(("z", ticks[:, 1] - [0.6 * tick, 0.0, 0.0], values, "center-right"))
        text, place = f"z {low:z.2f} to {high:z.2f} m", (x1, y1 + marker_radius, high)
        parts += [
            lines("frame_uprights", glyphs.stems(glyphs.lift(corners, low), high), theme.grid, 1.5),
            lines("frame_top", glyphs.loop(corners, high), theme.foreground, 1.0),
            lines(HEIGHT_TICKS, ticks, theme.foreground, 1.0),
            Label("frame/range", text, place, "bottom-right"),
            Label("frame/z", "z (m)", (x0, y1, high + 3 * marker_radius), "bottom-center"),
        ]
    for axis, places, values, anchor in rulers:
        for i, ((x, y, z), text) in enumerate(zip(places.tolist(), glyphs.tick_texts(values), strict=True)):
            parts.append(Label(f"frame/{axis}{i}", text, (x, y, z), anchor))
    return parts


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
        # The lines of the box cross the array; therefore they are fainter than the foreground.
        colour, width = mixed(theme.foreground, theme.background, FAINTER), 1.0
        enclosure = lines("room/box", box, theme.grid, 1.0)
    else:
        edges = np.concatenate([edges, glyphs.loop(vertices, height)])
        enclosure = mesh("room/walls", glyphs.walls(vertices, height), theme.foreground, opacity=0.12)
        colour, width = theme.foreground, 2.0
    parts = [enclosure, lines("room/grid", grid, theme.grid, 1.0), lines("room/edges", edges, colour, width)]
    places = glyphs.lift(sources, layer_height(Layer.SOURCE, marker_radius))
    seen_whole = several or scene.room.dimension == 3  # then the room may be far larger than the array
    radius = max(marker_radius, MIN_SOURCE * extent) if seen_whole else marker_radius
    angles = np.pi / 4 * np.arange(4)
    arms = 2 * radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)  # of a source's star
    for number, place in enumerate(places):
        name, text = (f"source/{number}", f"source, take {number}") if several else ("source", "source")
        parts += strokes(name, place + np.stack([-arms, arms], axis=1), radius, 0.4, "microphones/true")
        if several and scene.room.dimension == 3:
            parts.append(lines(f"{name}/stem", glyphs.stems(place[None], 0.0), theme.foreground, 2.0))
        x, y, z = place.tolist()
        parts.append(Label(f"{name}/name", text, (x, y - 3 * radius, z), "top-center"))
    return parts


# In radii of a marker, for a search domain that fills the screen: size of a text, and distances.
LETTER, HEIGHT = 1.2, 2.8  # mean width of a letter, margins included; height of a text
APART = 3.2  # distance of a name from its microphone; a diamond fits in between
MARK = 1.2  # radius of another mark
# Directions from the microphone to its name, in the order of preference.
SIDES = (
    *((1, 0), (-1, 0), (0, 1), (0, -1)), *((0.7, 0.7), (-0.7, 0.7), (0.7, -0.7), (-0.7, -0.7)),
    *((2.2, 0), (-2.2, 0), (0, 2.2), (0, -2.2)),
)  # fmt: skip
OUTSIDE = 100.0  # a text beyond the edge counts as this number of hidden marks


def name_place(
    text: str, place, marks, focus: tuple[float, float, float, float], marker_radius: float
) -> tuple[tuple[float, float], Anchor]:
    """Return the position, metres, and the anchor of the name of a microphone at `place`.

    The name is inside `focus` and hides as few of `marks` as possible.
    """
    width, height = LETTER * len(text) * marker_radius, HEIGHT * marker_radius
    low, high = (np.reshape(marks, (-1, 2)) + reach for reach in (-MARK * marker_radius, MARK * marker_radius))
    found = []
    for across, up in SIDES:
        x, y = (float(at + way * APART * marker_radius) for at, way in zip(place, (across, up), strict=True))
        left = x - width * (0.5 if across == 0 else float(across < 0))
        bottom = y - height * (0.5 if up == 0 else float(up < 0))
        right, top = left + width, bottom + height
        beyond = left < focus[0] or bottom < focus[1] or right > focus[2] or top > focus[3]
        touched = (low[:, 0] < right) & (high[:, 0] > left) & (low[:, 1] < top) & (high[:, 1] > bottom)
        anchor = get_args(Anchor)[int(3 * (1 + np.sign(up)) + 1 - np.sign(across))]  # at the near edge of the text
        found.append((OUTSIDE * beyond + int(touched.sum()), (x, y), anchor))
    return min(found, key=lambda one: one[0])[1:]


NOMINAL = (("microphones/true", "nominal"), ("microphones/error", "deviation"))  # captions for nominal positions
PLANE_MARKER, SPACE_MARKER = 0.0125, 0.016  # ratio of a marker's radius to the longer side of the search domain


def compose(
    scene: Scene | None,
    measurement: Measurement,
    positions=None,
    microphone: int | None = None,
    floor: Floor | None = None,
    title: str = "",
    dark: bool = False,
) -> Picture:
    """Return the whole picture; `microphone`: the selected one, which is drawn larger and with its name."""
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
        parts += marks.true_microphones(drape(measurement.positions, floor, radius), z_range, radius, theme)
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
    radius = picture.marker_radius
    curves = {f"same/{i}": curve for i, curve in enumerate(floor.curves[::-1])}
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

    A known microphone also has a cross if its estimate differs from the given position, because the solver has
    corrected the given position or the user has moved the microphone. `truth` (N, D), metres: the true positions as
    they are drawn; without it, the true positions of an array without known microphones are aligned with the estimate.

    `microphone`: the selected one; `pointed`: microphones with a ring around them and a name with their error.
    """
    truth = measurement.aligned_truth(positions) if truth is None else truth
    radius, base, known = picture.marker_radius, picture.z_range[0], measurement.known
    estimates, errors, away = np.asarray(positions, float), None, None
    crossed = np.ones(len(estimates), bool)  # False for a known microphone whose square would hide the cross
    if len(known):
        crossed[known] = np.linalg.norm(estimates[known] - measurement.known_positions, axis=1) > radius
    if truth is not None:  # a line from each true position to its estimate, unless the marks hide it
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
        moved = marks.true_microphones(truth, picture.z_range, radius, picture.theme)
        unmoved = ("microphones/true", "microphones/stems")
        meshes = tuple(part for part in picture.meshes if not part.name.startswith(unmoved))
        kept = tuple(part for part in picture.lines if not part.name.startswith(unmoved))
        picture = replace(picture, meshes=meshes, lines=kept).plus(*moved)
    if errors is not None and len(errors):
        picture = picture.plus(*strokes("microphones/error", errors, radius))
    places = on_layer(positions[crossed], base, radius, Layer.ESTIMATE)
    picture = picture.plus(*marked("microphones/estimate", places, radius))
    minima = np.empty((0, 2)) if floor is None or not floor.show_minima else np.array([*floor.lowest, *floor.minima])
    others = np.concatenate([positions[:, :2], minima] if truth is None else [positions[:, :2], minima, truth[:, :2]])

    def named(n: int, words: str, name: str) -> Label:
        """Return the label of a microphone, placed where it hides the fewest marks."""
        text = f"microphone {measurement.names[n]}{words}"
        (x, y), anchor = name_place(text, positions[n, :2], np.delete(others, n, axis=0), picture.focus, radius)
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
        picture = picture.plus(lines("selected/stem", glyphs.stems(cross, base), marks.ESTIMATE, 2.0))
    return picture.plus(named(microphone, errors_of.get(microphone, ""), "selected/name"))


ERROR_PIECES = 40  # number of pieces of an error line on a relief, because a straight line would go through hills


_DIAMOND = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # corners
ELLIPSE_SIDES = 36  # number of sides of the polygon that is drawn for an ellipse
NO_ELLIPSE = 1e-6  # half axis up to which nothing is drawn, m
SMALL_ELLIPSE = 0.5  # half axis below which the marks hide an ellipse, in radii of a marker
VISIBLE = 0.03  # half axis to which the median ellipse is enlarged, as a fraction of the extent


def with_trails(picture: Picture, paths, floor: Floor | None = None) -> Picture:
    """Return the picture with the paths (T, N, D), metres, of the microphones that have moved.

    `paths`: the positions in each state, the oldest first; `floor`: the map, on which the paths lie if it is a relief.
    """
    paths = np.asarray(paths, float)
    draped = drape(paths.reshape(-1, paths.shape[2]), floor)
    points = on_layer(draped, picture.z_range[0], picture.marker_radius, Layer.TRAIL).reshape(*paths.shape[:2], 3)
    pieces = np.stack([points[:-1], points[1:]], axis=2).reshape(-1, 2, 3)
    pieces = pieces[np.abs(pieces[:, 1] - pieces[:, 0]).max(axis=1) > 1e-9]
    return picture.plus(lines("trails", pieces, marks.TRAIL, 2.0)) if len(pieces) else picture


def ellipse_scale(axes, extent: float) -> float:
    """Return the least factor of 1, 2, 5, 10, ... that makes half of the ellipses visible beside `extent`, metres.

    `axes` (N, D, D), metres, half axes in rows, the longest last.
    """
    longest = np.linalg.norm(np.asarray(axes, float)[:, -1], axis=1)
    drawn = longest[longest > NO_ELLIPSE]
    if not len(drawn) or np.median(drawn) >= VISIBLE * extent:
        return 1.0
    wanted = VISIBLE * extent / float(np.median(drawn))
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(next(power * step for step in (1, 2, 5, 10) if power * step >= wanted * (1 - 1e-9)))


def with_ellipses(
    picture: Picture, positions, axes, floor: Floor | None = None, scale: float = 1.0, note: str = ""
) -> Picture:
    """Return the picture with an error ellipse around each microphone whose ellipse is larger than a dot.

    The ellipses are drawn enlarged by `scale`. The legend states this factor, or that the ellipses are too small to be
    seen, and then `note`. `axes`: see `ellipse_scale`; in space the two longest half axes span the ellipse.
    """
    axes, positions, radius = scale * np.asarray(axes, float), np.asarray(positions, float), picture.marker_radius
    lengths = np.linalg.norm(axes[:, -1], axis=1)
    seen = np.flatnonzero(lengths > scale * NO_ELLIPSE)
    if not len(seen):
        return picture
    centres = on_layer(drape(positions[seen], floor, radius), picture.z_range[0], radius, Layer.ELLIPSE)
    half = np.pad(axes[seen], ((0, 0), (0, 0), (0, 3 - axes.shape[2])))
    text = MARKS["ellipses"].text
    angles = np.linspace(0, 2 * np.pi, ELLIPSE_SIDES + 1)[:, None, None]
    rim = np.cos(angles) * half[:, -1] + np.sin(angles) * half[:, -2] + centres
    pieces = np.stack([rim[:-1], rim[1:]], axis=2).reshape(-1, 2, 3)
    if scale > 1:
        text += f", drawn {scale:g} times larger"
    elif lengths.max() < SMALL_ELLIPSE * radius:
        text += ", too small to be seen"
    captions = (*picture.captions, ("ellipses", f"{text}; {note}" if note else text))
    return replace(picture, captions=captions).plus(lines("ellipses", pieces, marks.ELLIPSE, 2.5))


def with_faulty_channels(picture: Picture, positions, faulty, floor: Floor | None = None) -> Picture:
    """Return the picture with a barred circle around each microphone whose channel, or given position, is faulty."""
    if not len(faulty):
        return picture
    radius = picture.marker_radius
    places = drape(np.asarray(positions, float)[list(faulty)], floor, radius)
    centres = on_layer(places, picture.z_range[0], radius, Layer.FAULTY)
    return picture.plus(*marked("microphones/faulty", centres, radius))


def with_volume(picture: Picture, volume: "Volume | None") -> Picture:
    """Return the picture with isosurfaces and minima of the cost of a microphone in space; None adds nothing.

    Each minimum has a vertical and a horizontal diamond, so that it is visible from every side; the lowest have the
    largest ones.
    """
    if volume is None:
        return picture
    radius = picture.marker_radius
    lowest, others = ((), ()) if volume.minima is None else (volume.minima.lowest, volume.minima.others)
    for name, places in (("minima", others), ("lowest", lowest)):
        if len(places):
            loops = [glyphs.loop(np.roll(_DIAMOND, turn, axis=1), 0.0) for turn in (0, 1)]
            shape = MARKS[name].reach * radius * np.concatenate(loops)
            segments = (np.array(places)[:, None, None, :] + shape).reshape(-1, 2, 3)
            picture = picture.plus(*strokes(name, segments, radius))
    if volume.surface is None:
        return picture
    return replace(picture, captions=(*picture.captions, ("isosurfaces", volume.text)), surfaces=(volume.surface,))


BALL_RADIUS = MARKS["microphones/ball"].reach  # radius of the ball, in radii of a marker
BALL_SIDES = 20  # number of faces around the ball
BALL_BRIGHT: Colour = (236, 74, 88)  # colour of the side of the ball that faces the light
WHITE: Colour = (255, 255, 255)
# Name, colour, radius, and distance of the centre towards the light; lengths in radii of the ball.
BALL_PARTS = (
    ("microphones/ball", marks.ESTIMATE, 1.0, 0.0),
    ("ball/bright", BALL_BRIGHT, 0.74, 0.32),
    ("ball/highlight", WHITE, 0.2, 0.84),
)
BALL_LIGHT = np.array([-0.45, 0.2, 0.87])  # towards the light, of unit length
PATH_WIDTH = 3.0  # pixels


def along(points: Reals, fraction: float) -> Reals:
    """Return the point on a path (P, D) at a fraction of the time, 0 to 1: the motion starts and ends slowly."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = lengths[-1] * fraction * fraction * (3 - 2 * fraction)
    return np.array([np.interp(at, lengths, column) for column in points.T])


def ball_centre(picture: Picture, place, floor: Floor | None) -> np.ndarray:
    """Return the centre (3,), metres, of a ball at `place` (D,); if a valley is too narrow, it lies on the rim."""
    ball = BALL_RADIUS * picture.marker_radius
    ground = _on_map(np.asarray(place, float)[None], floor, picture.z_range[0], ball)[0]
    above = layer_height(Layer.MINIMUM, picture.marker_radius)  # height of the marks on a map
    return ground if len(place) == 3 else ground + [0.0, 0.0, above + 0.75 * ball]


def with_ball(picture: Picture, place, floor: Floor | None, path=None, text: str = "") -> Picture:
    """Return the picture with a ball instead of the cross of the selected microphone.

    `place` (D,) float64, metres: position of the ball; `floor`: a map in relief, on which the ball lies, or None;
    `path` (P, D) float64, metres: its path downhill, or None; `text`: the text beside the ball; "": the microphone's
    name.
    """
    ball, base = BALL_RADIUS * picture.marker_radius, picture.z_range[0]
    in_space, centre = len(place) == 3, ball_centre(picture, place, floor)
    drawn: list[Mesh | Lines] = [
        mesh(name, sphere(centre + distance * ball * BALL_LIGHT, size * ball), colour)
        for name, colour, size, distance in BALL_PARTS
    ]
    if not in_space:
        shadow = centre - [*(0.5 * ball * BALL_LIGHT[:2]), 0.75 * ball]
        drawn.append(mesh("ball/shadow", glyphs.annuli(shadow[None], 0.55 * ball, 1.1 * ball), (0, 0, 0), 0.3))
    if path is not None and len(path) > 1:
        rise = 0.0 if in_space else layer_height(Layer.MINIMUM, picture.marker_radius)
        way = _on_map(np.asarray(path, float), floor, base) + [0.0, 0.0, rise]
        colour = picture.theme.foreground if in_space else WHITE  # it contrasts with what lies below the path
        drawn.append(lines("ball/path", np.stack([way[:-1], way[1:]], axis=1), colour, PATH_WIDTH))
    raised = text or in_space or (floor is not None and floor.heights is not None)
    above = {"position": tuple(centre.tolist()), "anchor": "bottom-center", "lift": 1.3 * ball} if raised else {}
    labels = tuple(
        replace(label, **above, text=text or label.text) if label.name == "selected/name" else label
        for label in picture.labels
    )
    # The ball covers both crosses of its microphone. If no other estimate has a cross, the picture shows none.
    sizes = {part.name: len(part.vertices) for part in picture.meshes}
    alone = sizes.get("microphones/estimate") == sizes.get("selected/estimate")
    covered = ("selected/estimate", "microphones/estimate") if alone else ("selected/estimate",)
    meshes = tuple(part for part in picture.meshes if not part.name.startswith(covered))
    return replace(picture, meshes=meshes, labels=labels).plus(*drawn)


def _on_map(points: np.ndarray, floor: Floor | None, base: float, radius: float = 0.0) -> np.ndarray:
    """Return points (P, 3), metres, on a map: as high as `drape` lifts them, or at its level if it is flat."""
    draped = drape(points, floor, radius)
    return draped if draped.shape[1] == 3 else glyphs.lift(draped, base)


def sphere(centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V, 3), metres, and faces (F, 3) of a ball."""
    polar, around = np.linspace(0, np.pi, BALL_SIDES // 2 + 1)[:, None], np.linspace(0, 2 * np.pi, BALL_SIDES + 1)
    parts = np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)
    unit = np.stack(np.broadcast_arrays(*parts), axis=-1)
    return centre + radius * unit.reshape(-1, 3), glyphs.grid_faces(*unit.shape[:2])
