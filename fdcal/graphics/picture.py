"""What there is to see, as primitives that any renderer can draw: one picture, two renderers.

Lengths are metres, colours RGB from 0 to 255. `fdcal.graphics.markers` says what the marks look like.
"""

from dataclasses import replace

import numpy as np

from ..model.measurement import Measurement
from ..model.scene import Scene
from ..model.validation import Reals
from . import glyphs
from .heatmap import relief_sides
from .markers import (
    ESTIMATE,
    LOWEST,
    TRUE,
    Layer,
    circles,
    drape,
    known_microphones,
    layer_height,
    lines,
    on_layer,
    strokes,
    true_microphones,
)
from .primitives import Anchor, Floor, Label, Picture, theme_of
from .shadow import relief_shadow
from .surroundings import focus_of, frame, room_and_source, upper_frame, z_range_of

# In radii of a marker: sizes of a text on the screen where the search domain fills it, and distances.
LETTER, HEIGHT = 1.2, 2.8  # width of a letter, with its fraction of the edges; height of a text
BESIDE, ABOVE = 2.6, 3.0  # from the microphone to the near edge of its name
MARK = 1.2  # reach of another mark
# Where the near edge of the name is, from the microphone, and the part of the text that lies there; the first of equals
# is taken.
SIDES: tuple[tuple[float, float, Anchor], ...] = (
    (1, 0, "center-left"),
    (-1, 0, "center-right"),
    (0, 1, "bottom-center"),
    (0, -1, "top-center"),
    (0.7, 0.7, "bottom-left"),
    (-0.7, 0.7, "bottom-right"),
    (0.7, -0.7, "top-left"),
    (-0.7, -0.7, "top-right"),
    (2.2, 0, "center-left"),
    (-2.2, 0, "center-right"),
    (0, 2.2, "bottom-center"),
    (0, -2.2, "top-center"),
)
OUTSIDE = 100.0  # hidden marks that a text beyond the edge is worth


def name_place(
    text: str, place, marks, focus: tuple[float, float, float, float], marker_radius: float
) -> tuple[tuple[float, float], Anchor]:
    """Return where the name of a microphone at `place` stands, metres, and its anchor: in `focus`, clear of `marks`."""
    best, least = SIDES[0], np.inf
    for side in SIDES:
        box = _box(text, place, side, marker_radius)
        beyond = box[0] < focus[0] or box[1] < focus[1] or box[2] > focus[2] or box[3] > focus[3]
        hidden = OUTSIDE * beyond + _hidden(box, np.reshape(marks, (-1, 2)), MARK * marker_radius)
        if hidden < least:
            best, least = side, hidden
    return _point(place, best, marker_radius), best[2]


def _point(place, side: tuple[float, float, Anchor], marker_radius: float) -> tuple[float, float]:
    reach = marker_radius * (ABOVE if side[0] == 0 else BESIDE)
    return float(place[0] + side[0] * reach), float(place[1] + side[1] * reach)


def _box(text: str, place, side: tuple[float, float, Anchor], marker_radius: float) -> np.ndarray:
    """The box (x0, y0, x1, y1) that a name takes on one side of a microphone, metres."""
    width, height = LETTER * len(text) * marker_radius, HEIGHT * marker_radius
    x, y = _point(place, side, marker_radius)
    left = x - width * (0.5 if side[0] == 0 else float(side[0] < 0))
    low = y - height * (0.5 if side[1] == 0 else float(side[1] < 0))
    return np.array([left, low, left + width, low + height])


def _hidden(box: np.ndarray, marks: np.ndarray, reach: float) -> int:
    """How many marks, as squares of half edge `reach`, metres, a box touches."""
    low, high = marks - reach, marks + reach
    touches = (low[:, 0] < box[2]) & (high[:, 0] > box[0]) & (low[:, 1] < box[3]) & (high[:, 1] > box[1])
    return int(touches.sum())


NOMINAL = (("microphones/true", "nominal"), ("microphones/error", "deviation"))  # words of the legend
PLANE_MARKER, SPACE_MARKER = 0.0125, 0.016  # radius of a marker, of the longer side of the search domain


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
    scene: Scene | None,
    measurement: Measurement,
    dark: bool = False,
    floor: Floor | None = None,
    lecture: bool = False,
    take: int | None = None,
) -> Picture:
    """Return what stays the same while a solver runs.

    `scene`: for room and source; `floor`: a map in relief, on which the microphones stand, and which `with_floor`
    draws; `lecture`: whether texts, marks and contrast suit a projector; `take`: whose place of the source is
    prominent; None for all places alike.
    """
    theme = theme_of(dark, lecture)
    focus, z_range = focus_of(measurement), z_range_of(scene, measurement)
    base, top = z_range
    radius = (
        theme.marks * (PLANE_MARKER if base == top else SPACE_MARKER) * max(focus[2] - focus[0], focus[3] - focus[1])
    )
    drawn, labels = frame(focus, base, radius, theme)
    if top > base:
        upper_lines, upper_labels = upper_frame(focus, z_range, radius, theme)
        drawn, labels = drawn + upper_lines, labels + upper_labels
    bounds, meshes = focus, ()
    if scene is not None and scene.room.response is None:  # the walls and the source of a measured room are unknown
        vertices = scene.room.vertices
        (x0, y0), (x1, y1) = vertices.min(axis=0).tolist(), vertices.max(axis=0).tolist()
        bounds = (x0, y0, x1, y1)
        room_lines, room_labels, meshes = room_and_source(scene, radius, theme, take)
        drawn, labels = room_lines + drawn, labels + room_labels
    if measurement.positions is not None:
        circle, stems = true_microphones(drape(measurement.positions, floor, radius), z_range, radius, theme)
        meshes, drawn = meshes + circle, drawn + stems
    if len(measurement.known):
        meshes += known_microphones(drape(measurement.known_positions, floor, radius), base, radius)
    captions = NOMINAL if measurement.nominal else ()
    return Picture(theme, focus, bounds, radius, drawn, meshes, labels, captions=captions, z_range=z_range)


def with_floor(picture: Picture, floor: Floor | None) -> Picture:
    """Return the picture with a map on the floor, diamonds at its lowest costs and small ones at its other minima.

    None removes the map.
    """
    if floor is None:
        return replace(picture, floor=None)
    if floor.heights is not None:
        sides, shadow = relief_sides(floor, picture.theme), relief_shadow(floor)
        picture = replace(picture, meshes=picture.meshes + sides, plates=(*picture.plates, shadow))
    if not floor.show_minima:
        return replace(picture, floor=floor)
    radius = picture.marker_radius
    diamond = radius * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    meshes = picture.meshes
    for name, places, reach in (("minima", floor.minima, 2.2), ("lowest", floor.lowest, 2.8)):
        if places:
            loops = np.concatenate([_loop_on(floor, reach * diamond + place, radius) for place in places])
            meshes += strokes(name, loops, radius, LOWEST, 0.45, halo=0.25)
    return replace(picture, floor=floor, meshes=meshes)


def _loop_on(floor: Floor, corners: np.ndarray, marker_radius: float) -> np.ndarray:
    """A level closed line through `corners` (V, 2), metres, that touches the map with its highest corner."""
    top = float(drape(corners, floor)[:, 2].max()) if floor.heights is not None else floor.height
    return glyphs.loop(corners, layer_height(Layer.MINIMUM, marker_radius) + top)


def with_estimate(
    picture: Picture,
    measurement: Measurement,
    positions,
    microphone: int | None = None,
    floor: Floor | None = None,
    truth: Reals | None = None,
) -> Picture:
    """Return the picture with the estimated positions and the selected microphone.

    A known microphone that is assumed to be elsewhere, by a solver that takes given positions as measurements or since
    the user has moved it, has a cross there, too. The true positions of an array without known microphones are moved as
    a whole to the estimate, for its gauge is free, unless `truth` (N, D), metres, says where they are drawn.

    `microphone`: the selected one.
    """
    truth = measurement.aligned_truth(positions) if truth is None else truth
    radius, known = picture.marker_radius, measurement.known
    crossed = _seen_elsewhere(measurement.known_positions, known, np.asarray(positions, float), radius)
    lined = crossed if truth is None else crossed | _seen_elsewhere(truth[known], known, np.asarray(positions), radius)
    truth = None if truth is None else drape(truth, floor, radius)
    positions = drape(positions, floor, radius)
    if truth is not None and measurement.blind:
        picture = _with_truth_at(picture, truth)
    meshes, base = picture.meshes, picture.z_range[0]
    if len(known):
        others = tuple(mesh for mesh in meshes if not mesh.name.startswith("microphones/known"))
        meshes = others + known_microphones(drape(measurement.known_positions, floor, radius), base, radius)
    if truth is not None:
        pieces = np.stack([on_layer(points, base, radius, Layer.ERROR) for points in (truth, positions)], axis=1)
        meshes += strokes("microphones/error", pieces[lined], radius, TRUE, 0.13, halo=0.2)
    crosses = glyphs.stars(on_layer(positions[crossed], base, radius, Layer.ESTIMATE), radius)
    meshes += strokes("microphones/estimate", crosses, radius, ESTIMATE, 0.34)
    picture = replace(picture, meshes=meshes)
    if microphone is None or not 0 <= microphone < len(positions):
        return picture
    name = f"microphone {measurement.names[microphone]}"
    others = np.delete(positions, microphone, axis=0)[:, :2]
    minima = np.empty((0, 2)) if floor is None or not floor.show_minima else np.array([*floor.lowest, *floor.minima])
    marks = np.concatenate([others, minima] if truth is None else [others, minima, truth[:, :2]])
    return _with_selected(picture, name, positions[microphone], None if truth is None else truth[microphone], marks)


def _seen_elsewhere(places, known: np.ndarray, positions: np.ndarray, radius: float) -> np.ndarray:
    """Whether each of the `positions` (N, D) is free or farther from its place (K, D) than a mark hides : (N,) bool."""
    away = np.ones(len(positions), bool)
    if len(known):
        away[known] = np.linalg.norm(positions[known] - places, axis=1) > radius
    return away


def _with_truth_at(picture: Picture, positions) -> Picture:
    """The picture with its true microphones at `positions` (N, D), metres."""
    meshes, drawn = true_microphones(positions, picture.z_range, picture.marker_radius, picture.theme)
    names = {part.name for part in (*meshes, *drawn)}
    other_meshes = tuple(part for part in picture.meshes if part.name not in names)
    other_lines = tuple(part for part in picture.lines if part.name not in names)
    return replace(picture, meshes=other_meshes + meshes, lines=other_lines + drawn)


def _with_selected(
    picture: Picture, name: str, position: np.ndarray, truth: np.ndarray | None, marks: np.ndarray
) -> Picture:
    """The picture with a larger cross at `position` (D,), a larger circle at the truth (D,), metres, and a name.

    The name hides as few of the other `marks` (P, 2), metres, as it can.
    """
    radius, base, meshes, drawn = picture.marker_radius, picture.z_range[0], picture.meshes, picture.lines
    cross = on_layer(position[None], base, radius, Layer.SELECTED)
    if truth is not None:
        circle = on_layer(truth[None], base, radius, Layer.SELECTED_TRUE)
        meshes += circles("selected/true", circle, radius, 0.44, radius=1.9)
    meshes += strokes("selected/estimate", glyphs.stars(cross, 1.9 * radius), radius, ESTIMATE, 0.54)
    if picture.z_range[1] > base:  # ties the microphone to the map below it
        drawn += (lines("selected/stem", glyphs.stems(cross, base), ESTIMATE, 2.0),)
    (x, y), anchor = name_place(name, position[:2], marks, picture.focus, radius)
    label = Label("selected/name", name, (x, y, float(cross[0, 2])), picture.theme.foreground, anchor)
    return replace(picture, lines=drawn, meshes=meshes, labels=(*picture.labels, label))
