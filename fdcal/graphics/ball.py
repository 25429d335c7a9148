"""A microphone that rolls over its map: a ball with its shadow, and the path downhill."""

from dataclasses import replace

import numpy as np

from ..model.types import Reals
from ..model.validation import frozen_array
from . import glyphs
from .markers import ESTIMATE, Layer, drape, layer_height, lines, mesh
from .primitives import Colour, Floor, Picture

RADIUS = 1.7  # of the ball, in radii of a marker
SIDES = 20  # around the ball
BRIGHT: Colour = (236, 74, 88)  # of its side that faces the light
WHITE: Colour = (255, 255, 255)
# Colour, radius, and distance of the middle towards the light, in radii of the ball.
PARTS = (
    ("microphones/ball", ESTIMATE, 1.0, 0.0),
    ("ball/bright", BRIGHT, 0.74, 0.32),
    ("ball/highlight", WHITE, 0.2, 0.84),
)
LIGHT = np.array([-0.45, 0.2, 0.87])  # towards the light, of unit length
PATH_WIDTH = 3.0  # pixels


def along(points: Reals, share: float) -> Reals:
    """Return the place on a path (P, D) at a share of the time, 0 to 1: it starts slowly and comes to rest slowly."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = lengths[-1] * share * share * (3 - 2 * share)
    return np.array([np.interp(at, lengths, column) for column in points.T])


def with_ball(picture: Picture, place, floor: Floor | None, path=None, text: str = "") -> Picture:
    """Return the picture with a ball in place of the cross of the selected microphone.

    `place` (D,) float64, metres; `floor`: a map in relief, on which the ball lies, or None; `path` (P, D) float64,
    metres, downhill, or None; `text`: beside the ball, in place of the name of the microphone; the name for "".
    """
    radius, base = picture.marker_radius, picture.z_range[0]
    ball = RADIUS * radius
    ground = _on(np.asarray(place, float)[None], floor, base, ball)[
        0
    ]  # on the edges of a hole that is too narrow for it
    in_space = len(place) == 3
    above = np.array([0.0, 0.0, 0.0 if in_space else layer_height(Layer.MINIMUM, radius)])
    centre = ground + above + [0.0, 0.0, 0.0 if in_space else 0.75 * ball]
    meshes = tuple(part for part in picture.meshes if not part.name.startswith("selected/estimate"))
    for name, colour, size, distance in PARTS:
        meshes += (mesh(name, sphere(centre + distance * ball * LIGHT, size * ball), colour),)
    if not in_space:
        shadow = ground + above - 0.5 * ball * np.append(LIGHT[:2], 0.0)
        meshes += (mesh("ball/shadow", glyphs.annuli(shadow[None], 0.55 * ball, 1.1 * ball), (0, 0, 0), 0.3),)
    drawn = picture.lines
    if path is not None and len(path) > 1:
        way = _on(np.asarray(path, float), floor, base) + above
        drawn += (lines("ball/path", np.stack([way[:-1], way[1:]], axis=1), WHITE, PATH_WIDTH),)
    raised = in_space or (floor is not None and floor.heights is not None)
    x, y, z = (centre + 1.3 * ball * np.array([0.0, not raised, raised])).tolist()
    above = {"text": text or None, "position": (x, y, z), "anchor": "bottom-center"} if text or raised else {}
    labels = tuple(
        replace(label, **{**above, "text": text or label.text}) if label.name == "selected/name" else label
        for label in picture.labels
    )
    return replace(picture, meshes=meshes, lines=drawn, labels=labels)


def _on(points: np.ndarray, floor: Floor | None, base: float, radius: float = 0.0) -> np.ndarray:
    """Points (P, 3), metres, on a map, its highest place within a radius, or at its height."""
    draped = drape(points, floor, radius)
    return draped if draped.shape[1] == 3 else glyphs.lift(draped, base)


def sphere(centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V, 3), metres, and faces (F, 3) of a ball."""
    rows = SIDES // 2
    polar, around = np.meshgrid(np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, SIDES + 1), indexing="ij")
    unit = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1)
    corner = (np.arange(rows)[:, None] * (SIDES + 1) + np.arange(SIDES)).ravel()[:, None]
    faces = np.concatenate([corner + [0, SIDES + 1, SIDES + 2], corner + [0, SIDES + 2, 1]])
    return centre + radius * unit.reshape(-1, 3), frozen_array(faces, np.int32)
