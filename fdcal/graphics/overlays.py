"""What can be drawn over a picture: paths, ellipses, faulty channels, solvers, the cost in space, a ball.

Each function takes a picture of `fdcal.graphics.picture` and returns it with more in it.
"""

from dataclasses import replace

import numpy as np

from ..model.validation import Reals, frozen_array
from . import glyphs
from .marks import ELLIPSE, ESTIMATE, MARKS, TRAIL, Layer, drape, layer_height, lines, marked, mesh, on_layer, strokes
from .primitives import Colour, Floor, Lines, Mesh, Picture
from .volume import Volume

_DIAMOND = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # corners
ELLIPSE_SIDES = 36  # of the polygon that is drawn for an ellipse
NO_ELLIPSE = 1e-6  # m, half axis up to which nothing is drawn
SMALL_ELLIPSE = 0.5  # of the radius of a marker: half axis below which an ellipse is hidden by the marks
VISIBLE = 0.03  # of the extent: half axis to which the median ellipse is enlarged


def with_trails(picture: Picture, paths, floor: Floor | None = None) -> Picture:
    """Return the picture with the paths (T, N, D), metres, oldest first, on a map in relief, of what has moved."""
    paths = np.asarray(paths, float)
    if len(paths) < 2:
        return picture
    draped = drape(paths.reshape(-1, paths.shape[2]), floor)
    points = on_layer(draped, picture.z_range[0], picture.marker_radius, Layer.TRAIL).reshape(*paths.shape[:2], 3)
    pieces = np.stack([points[:-1], points[1:]], axis=2).reshape(-1, 2, 3)
    pieces = pieces[np.abs(pieces[:, 1] - pieces[:, 0]).max(axis=1) > 1e-9]
    if not len(pieces):
        return picture
    return picture.plus(lines("trails", pieces, TRAIL, 2.0))


def ellipse_scale(axes, extent: float) -> float:
    """Return the round factor, 1 or more, that makes most error ellipses visible beside `extent`, metres.

    `axes` (N, D, D), metres, half axes in rows, the longest last.
    """
    longest = np.linalg.norm(np.asarray(axes, float)[:, -1], axis=1)
    drawn = longest[longest > NO_ELLIPSE]
    return enlargement(float(np.median(drawn)), extent) if len(drawn) else 1.0


def enlargement(half_axis: float, extent: float) -> float:
    """Return 1, 2, 5, 10, ...: the smallest that makes a half axis visible beside the extent, both in metres."""
    wanted = VISIBLE * extent / half_axis
    if wanted <= 1:
        return 1.0
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(next(power * step for step in (1, 2, 5, 10) if power * step >= wanted * (1 - 1e-9)))


def with_ellipses(
    picture: Picture, positions, axes, floor: Floor | None = None, scale: float = 1.0, note: str = ""
) -> Picture:
    """Return the picture with an error ellipse around each microphone, none where it is no larger than a dot.

    The legend says by how much the ellipses are enlarged, or that they are too small to be seen, and `note` adds to it.
    `axes` as of `ellipse_scale`; in space the two longest span the ellipse. It is drawn `scale` times enlarged.
    """
    axes, positions, radius = scale * np.asarray(axes, float), np.asarray(positions, float), picture.marker_radius
    lengths = np.linalg.norm(axes[:, -1], axis=1)
    seen = np.flatnonzero(lengths > scale * NO_ELLIPSE)
    if not len(seen):
        return picture
    centres = on_layer(drape(positions[seen], floor, radius), picture.z_range[0], radius, Layer.ELLIPSE)
    half, text = np.pad(axes[seen], ((0, 0), (0, 0), (0, 3 - axes.shape[2]))), MARKS["ellipses"].text
    angles = np.linspace(0, 2 * np.pi, ELLIPSE_SIDES + 1)[:, None, None]
    rim = np.cos(angles) * half[:, -1] + np.sin(angles) * half[:, -2] + centres
    pieces = np.stack([rim[:-1], rim[1:]], axis=2).reshape(-1, 2, 3)
    if scale > 1:
        text += f", drawn {scale:g} times larger"
    elif lengths.max() < SMALL_ELLIPSE * radius:
        text += ", too small to be seen"
    captions = (*picture.captions, ("ellipses", f"{text}; {note}" if note else text))
    return replace(picture, captions=captions).plus(lines("ellipses", pieces, ELLIPSE, 2.5))


def with_faulty_channels(picture: Picture, positions, faulty, floor: Floor | None = None) -> Picture:
    """Return the picture with a barred circle around each microphone whose channel, or given position, is faulty."""
    if not len(faulty):
        return picture
    radius = picture.marker_radius
    places = drape(np.asarray(positions, float)[list(faulty)], floor, radius)
    centres = on_layer(places, picture.z_range[0], radius, Layer.FAULTY)
    return picture.plus(*marked("microphones/faulty", centres, radius))


def with_volume(picture: Picture, volume: Volume | None) -> Picture:
    """Return the picture with isosurfaces and minima of the cost of a microphone in space; None adds nothing.

    The minima are diamonds, upright and level, so that they show from every side; the lowest are the largest.
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


BALL_RADIUS = MARKS["microphones/ball"].reach  # of the ball, in radii of a marker
BALL_SIDES = 20  # around the ball
BALL_BRIGHT: Colour = (236, 74, 88)  # of its side that faces the light
WHITE: Colour = (255, 255, 255)
# Colour, radius, and distance of the middle towards the light, in radii of the ball.
BALL_PARTS = (
    ("microphones/ball", ESTIMATE, 1.0, 0.0),
    ("ball/bright", BALL_BRIGHT, 0.74, 0.32),
    ("ball/highlight", WHITE, 0.2, 0.84),
)
BALL_LIGHT = np.array([-0.45, 0.2, 0.87])  # towards the light, of unit length
PATH_WIDTH = 3.0  # pixels


def along(points: Reals, fraction: float) -> Reals:
    """Return the place on a path (P, D) at a fraction of the time, 0 to 1: it starts and ends slowly."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = lengths[-1] * fraction * fraction * (3 - 2 * fraction)
    return np.array([np.interp(at, lengths, column) for column in points.T])


def ball_centre(picture: Picture, place, floor: Floor | None) -> np.ndarray:
    """Return the middle (3,), metres, of a ball at `place` (D,), on the edges of a hole that is too narrow for it."""
    ball = BALL_RADIUS * picture.marker_radius
    ground = _on(np.asarray(place, float)[None], floor, picture.z_range[0], ball)[0]
    above = layer_height(Layer.MINIMUM, picture.marker_radius)  # of what stands on a map
    return ground if len(place) == 3 else ground + [0.0, 0.0, above + 0.75 * ball]


def with_ball(picture: Picture, place, floor: Floor | None, path=None, text: str = "") -> Picture:
    """Return the picture with a ball in place of the cross of the selected microphone.

    `place` (D,) float64, metres; `floor`: a map in relief, on which the ball lies, or None; `path` (P, D) float64,
    metres, downhill, or None; `text`: beside the ball, in place of the name of the microphone; the name for "".
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
        way = _on(np.asarray(path, float), floor, base) + [0.0, 0.0, rise]
        colour = picture.theme.foreground if in_space else WHITE  # seen beside what is below it
        drawn.append(lines("ball/path", np.stack([way[:-1], way[1:]], axis=1), colour, PATH_WIDTH))
    raised = text or in_space or (floor is not None and floor.heights is not None)
    above = {"position": tuple(centre.tolist()), "anchor": "bottom-center", "lift": 1.3 * ball} if raised else {}
    labels = tuple(
        replace(label, **above, text=text or label.text) if label.name == "selected/name" else label
        for label in picture.labels
    )
    # the ball covers both crosses of its microphone: where no other estimate has one, there is none
    sizes = {part.name: len(part.vertices) for part in picture.meshes}
    alone = sizes.get("microphones/estimate") == sizes.get("selected/estimate")
    covered = ("selected/estimate", "microphones/estimate") if alone else ("selected/estimate",)
    meshes = tuple(part for part in picture.meshes if not part.name.startswith(covered))
    return replace(picture, meshes=meshes, labels=labels).plus(*drawn)


def _on(points: np.ndarray, floor: Floor | None, base: float, radius: float = 0.0) -> np.ndarray:
    """Return points (P, 3), metres, on a map: at its highest place within a radius, or at its level if it is flat."""
    draped = drape(points, floor, radius)
    return draped if draped.shape[1] == 3 else glyphs.lift(draped, base)


def sphere(centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V, 3), metres, and faces (F, 3) of a ball."""
    rows = BALL_SIDES // 2
    polar, around = np.linspace(0, np.pi, rows + 1)[:, None], np.linspace(0, 2 * np.pi, BALL_SIDES + 1)
    parts = np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)
    unit = np.stack(np.broadcast_arrays(*parts), axis=-1)
    corner = (np.arange(rows)[:, None] * (BALL_SIDES + 1) + np.arange(BALL_SIDES)).ravel()[:, None]
    faces = np.concatenate([corner + [0, BALL_SIDES + 1, BALL_SIDES + 2], corner + [0, BALL_SIDES + 2, 1]])
    return centre + radius * unit.reshape(-1, 3), frozen_array(faces, np.int32)
