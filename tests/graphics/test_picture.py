"""The picture has the given positions, colours and extents; no renderer is needed.

A picture without a search domain shows all microphones.

The name of a microphone stands beside it, inside the picture, and hides as few other marks as it can.

Shapes of markers, walls and grids: their areas and lengths, and where they lie.
"""

import dataclasses

import numpy as np
import pytest
from fields import waves
from PIL import Image, ImageDraw

from fdcal.graphics import glyphs, snapshot
from fdcal.graphics import picture as pictures
from fdcal.graphics.camera import camera_for, project
from fdcal.graphics.heatmap import cost_floor
from fdcal.graphics.marks import ESTIMATE, KNOWN, TRUE
from fdcal.graphics.primitives import Mesh
from fdcal.model.arrays import positions_of
from fdcal.model.measurement import Measurement
from fdcal.model.scene import load_scene


def sampled(positions, known=(0, 1, 2), search=None, **more) -> Measurement:
    """Plane waves at the positions: a measurement that needs no simulation."""
    p, f = waves(np.asarray(positions), [1.0, 2.0, 3.0], 6), [50.0, 100.0, 150.0]
    return Measurement(f, p, 343.0, positions=positions, known=known, search=search, **more)


@pytest.fixture(scope="module")
def measurement(scene):
    return sampled(np.random.default_rng(1).uniform([0.5, 0.35], [0.9, 0.75], (12, 2)), search=scene.search)


def parts(drawn):
    return (*drawn.lines, *drawn.meshes, *drawn.labels)


def part(drawn, name):
    """The primitive of that name."""
    found = [p for p in parts(drawn) if p.name == name]
    assert len(found) == 1, f"{len(found)} primitives are called {name}"
    return found[0]


def names(drawn):
    return {p.name for p in parts(drawn)}


def test_circles_at_the_truth_and_crosses_at_the_estimate(scene, measurement):
    estimate = measurement.positions + 0.01
    estimate[:3] = measurement.known_positions
    drawn = pictures.compose(scene, measurement, estimate, microphone=5)
    circles = part(drawn, "microphones/true")
    assert circles.colour == TRUE and part(drawn, "microphones/known").colour == KNOWN
    assert len({TRUE, ESTIMATE, KNOWN}) == 3
    centres = circles.vertices.reshape(12, -1, 3).mean(axis=1)
    np.testing.assert_allclose(centres[:, :2], measurement.positions, atol=1e-6)
    crosses = part(drawn, "microphones/estimate")
    assert crosses.colour == ESTIMATE
    middles = crosses.vertices.reshape(-1, 2, 4, 3).mean(axis=2)  # a cross has two strokes, a stroke has four corners
    np.testing.assert_allclose(middles[..., :2], np.repeat(estimate[3:, None], 2, axis=1), atol=1e-6)
    blind = dataclasses.replace(measurement, positions=None)
    drawn = pictures.compose(scene, blind, measurement.positions, microphone=4)
    assert not names(drawn) & {"microphones/true", "microphones/error", "selected/true"}, "nothing at unknown places"
    assert "microphones/estimate" in names(drawn)


def test_a_known_microphone_that_is_assumed_to_be_elsewhere_has_a_cross_there_and_its_square_where_it_was_given(
    scene, measurement
):
    """Solver robust begins with an array that fits only some of the given positions."""
    estimate = measurement.positions.copy()
    estimate[[1, *range(3, len(estimate))]] += 0.05
    estimate[2] += 1e-4  # the square hides such a small distance
    drawn = pictures.compose(scene, measurement, estimate)
    squares = part(drawn, "microphones/known").vertices.reshape(3, 4, 3).mean(axis=1)
    np.testing.assert_allclose(squares[:, :2], measurement.known_positions, atol=1e-6)
    crosses = part(drawn, "microphones/estimate").vertices.reshape(-1, 2, 4, 3).mean(axis=(1, 2))
    np.testing.assert_allclose(crosses[:, :2], estimate[[1, *range(3, len(estimate))]], atol=1e-6)
    lines = part(drawn, "microphones/error").vertices.reshape(-1, 4, 3)[..., :2]
    assert np.isclose(lines[:, [0, 3]].mean(axis=1), measurement.positions[1], atol=1e-6).all(axis=1).any()
    assert len(lines) == len(crosses)


@pytest.mark.parametrize("microphone", [4, None, -1, 99])
def test_the_selected_microphone_stands_out(scene, measurement, microphone):
    drawn = pictures.compose(scene, measurement, measurement.positions, microphone=microphone)
    if microphone != 4:
        assert not any(name.startswith("selected") for name in names(drawn))
        return
    large = np.ptp(part(drawn, "selected/estimate").vertices, axis=0)
    others = part(drawn, "microphones/estimate").vertices.reshape(-1, 8, 3)
    assert (large[:2] > 1.5 * np.ptp(others, axis=1)[:, :2]).all()
    assert part(drawn, "selected/name").text == "microphone 4"


def area(mesh) -> float:
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces].astype(float), 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def test_a_measurement_without_search_domain_is_framed_by_its_microphones(measurement):
    bare = dataclasses.replace(measurement, search=None)
    drawn = pictures.compose(None, bare, measurement.positions)
    x0, y0, x1, y1 = drawn.focus
    inside = (measurement.positions > [x0, y0]) & (measurement.positions < [x1, y1])
    assert inside.all() and "room/walls" not in names(drawn)
    assert pictures.static_picture(None, bare).bounds == drawn.focus


@pytest.fixture(scope="module")
def ball():
    """A scene of three dimensions and a measurement in its search domain, no field computed."""
    scene = load_scene("ball3d")
    positions = np.random.default_rng(1).uniform([1.5, 1.2, 0.9], [2.3, 2.0, 1.7], (12, 3))
    return scene, sampled(positions, known=(0, 1, 2, 3), search=scene.search, dimension=3)


def test_in_space_every_marker_is_at_its_own_height(ball):
    scene, measurement = ball
    estimate = measurement.positions + [0.01, 0.0, 0.02]
    estimate[:4] = measurement.positions[:4]
    drawn = pictures.compose(scene, measurement, estimate, microphone=5)
    for name, expected, corners in (
        ("microphones/true", measurement.positions, 80),
        ("microphones/known", measurement.positions[:4], 4),
        ("microphones/estimate", estimate[4:], 8),
        ("selected/true", measurement.positions[[5]], 80),
        ("selected/estimate", estimate[[5]], 8),
    ):
        centres = part(drawn, name).vertices.reshape(len(expected), corners, 3).mean(axis=1)
        np.testing.assert_allclose(centres, expected, atol=drawn.marker_radius)
        np.testing.assert_allclose(centres[:, :2], expected[:, :2], atol=1e-5)
        assert np.ptp(centres[:, 2] - expected[:, 2]) < 1e-5, "one layer for all"
    stems = part(drawn, "microphones/stems").segments
    np.testing.assert_allclose(
        stems[:, 1], np.column_stack([measurement.positions[:, :2], np.full(12, 0.8)]), atol=1e-5
    )
    corners = part(drawn, "microphones/error").vertices.reshape(-1, 4, 3)
    ends = np.stack([corners[:, [0, 3]].mean(axis=1), corners[:, [1, 2]].mean(axis=1)], axis=1)
    np.testing.assert_allclose(ends[:, 1] - ends[:, 0], np.tile([0.01, 0.0, 0.02], (8, 1)), atol=1e-5)


def test_in_space_the_room_is_a_box_and_the_map_lies_under_the_array(ball):
    scene, measurement = ball
    floor = cost_floor(np.ones((51, 51)), scene.search, height=pictures.z_range_of(scene, measurement)[0])
    drawn = pictures.compose(scene, measurement, measurement.positions, 5, floor)
    assert drawn.z_range == (0.8, 1.8) and drawn.floor.height == 0.8
    edges = np.concatenate([part(drawn, name).segments for name in ("room/edges", "room/box")])
    np.testing.assert_allclose(np.ptp(edges.reshape(-1, 3), axis=0), scene.room.size, atol=0.01)
    assert (np.abs(edges[:, 1] - edges[:, 0])[:, 2] > 2.4).sum() == 5, "four edges and the stem of the source"
    assert "room/walls" not in names(drawn)
    diamond = part(drawn, "lowest").vertices
    assert np.all((diamond[:, 2] > 0.8) & (diamond[:, 2] < 0.8 + drawn.marker_radius))


def test_a_plane_array_is_drawn_at_its_height_in_the_room():
    scene = load_scene("plane3d")
    positions = np.random.default_rng(1).uniform([1.5, 1.2], [2.3, 2.0], (12, 2))
    measurement = sampled(positions, search=scene.search, dimension=3, array_dimension=2)
    drawn = pictures.compose(scene, measurement, positions, 5)
    assert drawn.z_range == (1.2, 1.2)
    for name in ("microphones/true", "microphones/estimate", "microphones/known", "frame"):
        each = part(drawn, name)
        z = (each.segments if hasattr(each, "segments") else each.vertices)[..., 2]
        np.testing.assert_allclose(z, 1.2, atol=drawn.marker_radius)
    assert pictures.compose(None, measurement, positions).z_range == (0.0, 0.0)


def test_trails_follow_each_microphone_and_skip_rests(scene, measurement):
    start = measurement.positions
    paths = np.stack([start, start, start + [0.01, 0.0], start + [0.01, 0.02]])
    paths[:, 4] = start[4]  # this one never moves
    segments = part(pictures.with_trails(pictures.compose(scene, measurement), paths), "trails").segments
    assert segments.shape == (2 * 11, 2, 3)
    for n in (0, 7, 11):
        for ends in (paths[1:3, n], paths[2:4, n]):
            assert (np.abs(segments[:, :, :2] - ends).max(axis=(1, 2)) < 1e-6).any()
    assert "trails" not in names(pictures.with_trails(pictures.compose(scene, measurement), paths[:1]))


def test_ellipses_have_the_half_axes_given(scene, measurement):
    axes = np.tile(np.array([[0.0, 0.004], [0.02, 0.0]]), (12, 1, 1))
    axes[:3] = 0  # the first three are known
    drawn = pictures.with_ellipses(pictures.compose(scene, measurement), measurement.positions, axes)
    # The first corner of all ellipses, then the second, and so on.
    away = part(drawn, "ellipses").segments[:, 0, :2].reshape(-1, 9, 2) - measurement.positions[3:]
    np.testing.assert_allclose(np.abs(away[..., 0]).max(axis=0), 0.02, rtol=1e-4)
    np.testing.assert_allclose((away[..., 0] / 0.02) ** 2 + (away[..., 1] / 0.004) ** 2, 1.0, rtol=1e-3)
    nothing = pictures.with_ellipses(pictures.compose(scene, measurement), measurement.positions, 0 * axes)
    assert "ellipses" not in names(nothing)


def test_a_measured_room_has_no_walls_and_no_source_in_any_picture():
    scene = load_scene("listening_lab")
    picture = pictures.static_picture(scene, sampled(positions_of(scene), search=scene.search, dimension=3))
    parts = [part.name for part in (*picture.meshes, *picture.lines, *picture.labels)]
    assert not [name for name in parts if name.startswith(("room", "source"))]
    assert picture.bounds == picture.focus
    corners = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    pixels = project(camera_for(picture, (640, 480), "3d"), (640, 480), corners)
    assert (pixels >= 0).all() and (pixels <= (640, 480)).all(), "there is no floor at z = 0 to stand on"


def test_heights_have_a_ruler_where_it_is_visible_and_no_text_covers_another():
    scene = load_scene("ball3d")
    picture = pictures.static_picture(scene, sampled(positions_of(scene), search=scene.search, dimension=3))
    image, size = ImageDraw.Draw(Image.new("RGB", (900, 700))), (900, 700)
    letters = snapshot.font(14)
    for view, shown in (("top", "frame/range"), ("close", "frame/z")):
        texts = snapshot.uncovered(image, picture, camera_for(picture, size, view, (90, 60, 40, 60)), letters)
        names = {label.name for label, _ in texts}
        assert shown in names and len({"frame/range", "frame/z"} & names) == 1
        numbers = [float(label.text) for label, _ in texts if label.name[:7] == "frame/z" and label.text[0].isdigit()]
        low, high = picture.z_range
        assert len(numbers) >= 3 * (view == "close") and all(low <= number <= high for number in numbers)
        boxes = np.array(
            [image.textbbox(at, label.text, letters, snapshot.ANCHORS[label.anchor]) for label, at in texts]
        )
        apart = (boxes[:, None, :2] > boxes[None, :, 2:]).any(axis=2)
        assert (apart | apart.T | np.eye(len(boxes), dtype=bool)).all()


FOCUS, RADIUS, TEXT = (0.0, 0.0, 1.0, 1.0), 0.0125, "microphone 12"


def box_of(place, anchor):
    """What the text covers, by the meaning of its anchor."""
    vertical, horizontal = anchor.split("-")
    width, height = pictures.LETTER * len(TEXT) * RADIUS, pictures.HEIGHT * RADIUS
    x = place[0] - width * {"left": 0, "center": 0.5, "right": 1}[horizontal]
    y = place[1] - height * {"bottom": 0, "center": 0.5, "top": 1}[vertical]
    return x, y, x + width, y + height


def covered(box, marks):
    x, y = np.reshape(marks, (-1, 2)).T
    return int(((x > box[0]) & (x < box[2]) & (y > box[1]) & (y < box[3])).sum())


@pytest.mark.parametrize("place", [(x, y) for x in (0.02, 0.5, 0.98) for y in (0.02, 0.5, 0.98)])
def test_a_name_stays_inside_the_picture_and_off_its_microphone(place):
    box = box_of(*pictures.name_place(TEXT, place, [], FOCUS, RADIUS))
    assert box[0] >= 0 and box[1] >= 0 and box[2] <= 1 and box[3] <= 1
    assert not covered((box[0] - RADIUS, box[1] - RADIUS, box[2] + RADIUS, box[3] + RADIUS), [place])


def test_areas_of_markers():
    """A ring of many corners, a bar and a square have the areas of the textbook."""
    centres = np.array([[0.0, 0.0, 0.0], [3.0, 1.0, 0.0]])
    for triangles, expected in (
        (glyphs.annuli(centres, 2.0, 0.2, corners=400), 2 * np.pi * (2.1**2 - 1.9**2)),
        (glyphs.squares(centres, 0.3), 2 * 0.09),
        (glyphs.strokes(centres[None], 0.1, extension=0.5), 0.1 * (np.sqrt(10) + 1.0)),
    ):
        assert area(Mesh("x", *triangles, (0, 0, 0))) == pytest.approx(expected, rel=1e-3)
    vertices, faces = glyphs.strokes(np.zeros((1, 2, 3)), 0.1)
    assert np.isfinite(vertices).all() and len(faces) == 2, "a bar of no length"
    ends = np.array([[[0, 0, 0], [1, 2, 2]], [[0, 0, 0], [0, 0, 1]], [[0, 0, 0], [1, 0, 0]]], float)
    corners = glyphs.strokes(ends, 0.1, extension=0.5)[0].reshape(3, 4, 3)
    np.testing.assert_allclose(np.linalg.norm(corners[:, 0] - corners[:, 3], axis=1), 0.1)
    np.testing.assert_allclose(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1), [4, 2, 2])


@pytest.mark.parametrize("name", ["tiny", "lshape", "array1_circle"])
def test_walls_are_a_closed_band_of_the_right_area(name):
    vertices = load_scene(name).room.vertices
    mesh = Mesh("walls", *glyphs.walls(vertices, 0.5), (0, 0, 0))
    assert area(mesh) == pytest.approx(0.5 * np.linalg.norm(vertices - np.roll(vertices, -1, axis=0), axis=1).sum())
    assert len(mesh.faces) == 2 * len(vertices)


@pytest.mark.parametrize("view", ["top", "close"])
def test_the_name_of_a_ball_stands_above_it_in_every_view(scene, measurement, view):
    floor = cost_floor(np.ones((60, 50)), scene.search, relief=True)
    estimate, size = measurement.positions, (900, 700)
    drawn = pictures.with_ball(pictures.compose(scene, measurement, estimate, 5, floor), estimate[5], floor)
    camera = camera_for(drawn, size, view)
    ball = project(camera, size, part(drawn, "microphones/ball").vertices)
    texts = snapshot.uncovered(ImageDraw.Draw(Image.new("RGB", size)), drawn, camera, snapshot.font(14))
    (place,) = (at for label, at in texts if label.name == "selected/name")
    assert ball[:, 1].min() - 10 < place[1] < ball[:, 1].min() and abs(place[0] - ball[:, 0].mean()) < 3


def test_a_map_in_relief_is_a_block_from_its_heights_down_to_its_level(scene, measurement):
    cost = np.random.default_rng(2).uniform(1, 2, (9, 11))
    floor = cost_floor(cost, scene.search, relief=True, height=0.5)
    drawn = pictures.compose(scene, measurement, floor=floor)
    sides = [part(drawn, f"relief_sides/{axis}") for axis in "xy"]
    assert sides[0].colour != sides[1].colour, "the light comes from one side"
    x0, y0 = floor.origin
    for side, axis in zip(sides, (0, 1), strict=True):
        low, high = side.vertices.min(axis=0), side.vertices.max(axis=0)
        np.testing.assert_allclose(
            np.unique(side.vertices[:, axis]), [(x0, y0)[axis], (x0, y0)[axis] + floor.size[axis]], atol=1e-6
        )
        assert low[2] == 0.5 and high[2] == pytest.approx(0.5 + np.delete(floor.heights, slice(1, -1), 1 - axis).max())
        assert area(side) > 0
    flat = pictures.compose(scene, measurement, floor=cost_floor(cost, scene.search))
    assert not [name for name in names(flat) if name.startswith("relief_sides")]
