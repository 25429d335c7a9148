"""The picture holds what it was given: positions, colours, extents. No renderer takes part."""

import dataclasses

import numpy as np
import pytest
import trimesh

from fdcal import solvers
from fdcal.graphics.camera import camera_for, project
from fdcal.graphics.heatmap import cost_floor
from fdcal.graphics.markers import ESTIMATE, HALO, KNOWN, SOLVER_MARKS, TRUE, solver_mark
from fdcal.graphics.overlays import with_comparison, with_ellipses, with_trails
from fdcal.graphics.picture import compose, static_picture, with_estimate
from fdcal.graphics.surroundings import z_range_of
from fdcal.graphics.units import error_summary
from fdcal.model.arrays import positions_of
from fdcal.model.measurement import Measurement
from fdcal.model.scene_file import load_scene


@pytest.fixture(scope="module")
def scene():
    return load_scene("tiny")


def listen(positions, known=(0, 1, 2), search=None, seed=0, **more) -> Measurement:
    """Plane waves at the positions: a measurement that needs no simulation."""
    rng = np.random.default_rng(seed)
    angles, phases = rng.uniform(0, 2 * np.pi, (2, 3, 6))
    k = np.array([1.0, 2.0, 3.0])
    towards = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    p = np.exp(1j * (k[:, None, None] * (towards @ np.asarray(positions)[:, :2].T) + phases[:, :, None])).sum(axis=1)
    known = np.array(known, int)
    return Measurement(
        frequencies=k * 343 / (2 * np.pi),
        pressures=p,
        sound_speed=343.0,
        positions=positions,
        known=known,
        known_positions=np.asarray(positions)[known],
        search=search,
        **more,
    )


@pytest.fixture(scope="module")
def measurement(scene):
    positions = np.random.default_rng(1).uniform([0.5, 0.35], [0.9, 0.75], (12, 2))
    return listen(positions, search=scene.search)


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
    drawn = compose(scene, measurement, estimate, microphone=5)
    circles = part(drawn, "microphones/true")
    assert circles.colour == TRUE
    centres = circles.vertices.reshape(12, -1, 3).mean(axis=1)
    np.testing.assert_allclose(centres[:, :2], measurement.positions, atol=1e-6)
    crosses = part(drawn, "microphones/estimate")
    assert crosses.colour == ESTIMATE
    middles = crosses.vertices.reshape(-1, 2, 4, 3).mean(axis=2)  # two strokes a cross, four corners a stroke
    np.testing.assert_allclose(middles[:, 0, :2], estimate[3:], atol=1e-6)
    np.testing.assert_allclose(middles[:, 1, :2], estimate[3:], atol=1e-6)


def test_error_lines_join_truth_and_estimate(scene, measurement):
    estimate = measurement.positions.copy()
    estimate[3:] = estimate[:2:-1] + 0.01
    drawn = compose(scene, measurement, estimate)
    corners = part(drawn, "microphones/error").vertices.reshape(-1, 4, 3)[..., :2]
    np.testing.assert_allclose(corners[:, [0, 3]].mean(axis=1), measurement.positions[3:], atol=1e-6)
    np.testing.assert_allclose(corners[:, [1, 2]].mean(axis=1), estimate[3:], atol=1e-6)


def test_known_microphones_are_squares_of_their_own_colour(scene, measurement):
    drawn = compose(scene, measurement, measurement.positions)
    squares = part(drawn, "microphones/known")
    assert squares.colour == KNOWN
    centres = squares.vertices.reshape(3, 4, 3).mean(axis=1)
    np.testing.assert_allclose(centres[:, :2], measurement.positions[:3], atol=1e-6)
    assert len({TRUE, ESTIMATE, KNOWN}) == 3


def test_a_known_microphone_that_is_assumed_to_be_elsewhere_has_a_cross_there_and_its_square_where_it_was_given(
    scene, measurement
):
    """Solver robust begins with an array that fits the given positions only in part."""
    estimate = measurement.positions.copy()
    estimate[1] += 0.05
    estimate[2] += 1e-4  # its square covers that
    drawn = compose(scene, measurement, estimate)
    squares = part(drawn, "microphones/known").vertices.reshape(3, 4, 3).mean(axis=1)
    np.testing.assert_allclose(squares[:, :2], measurement.known_positions, atol=1e-6)
    crosses = part(drawn, "microphones/estimate").vertices.reshape(-1, 2, 4, 3).mean(axis=(1, 2))
    np.testing.assert_allclose(crosses[:, :2], estimate[[1, *range(3, len(estimate))]], atol=1e-6)
    lines = part(drawn, "microphones/error").vertices.reshape(-1, 4, 3)[..., :2]
    assert np.isclose(lines[:, [0, 3]].mean(axis=1), measurement.positions[1], atol=1e-6).all(axis=1).any()
    assert len(lines) == len(crosses)


@pytest.mark.parametrize("microphone", [4, None, -1, 99])
def test_the_selected_microphone_stands_out(scene, measurement, microphone):
    drawn = compose(scene, measurement, measurement.positions, microphone=microphone)
    if microphone != 4:
        assert not any(name.startswith("selected") for name in names(drawn))
        return
    large = np.ptp(part(drawn, "selected/estimate").vertices, axis=0)
    others = part(drawn, "microphones/estimate").vertices.reshape(-1, 8, 3)
    assert (large[:2] > 1.5 * np.ptp(others, axis=1)[:, :2]).all()
    assert part(drawn, "selected/name").text == "microphone 4"


def test_without_truth_nothing_is_drawn_at_it(scene, measurement):
    blind = dataclasses.replace(measurement, positions=None)
    drawn = compose(scene, blind, measurement.positions, microphone=4)
    assert not names(drawn) & {"microphones/true", "microphones/error", "selected/true"}
    assert "microphones/estimate" in names(drawn)
    assert error_summary(blind, measurement.positions) == "true positions unknown"


def area(mesh) -> float:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).area


def test_halos_are_white_wider_and_below(scene, measurement):
    drawn = compose(scene, measurement, measurement.positions + 0.02, microphone=4)
    halos = [solid for solid in drawn.meshes if solid.name.endswith("_halo")]
    assert len(halos) >= 5
    for halo in halos:
        over = part(drawn, halo.name.removesuffix("_halo"))
        assert halo.colour == HALO and over.colour != HALO
        assert area(halo) > 1.3 * area(over)
        assert halo.vertices[:, 2].max() < over.vertices[:, 2].min()


def test_pictures_are_frozen(scene, measurement):
    drawn = compose(scene, measurement, measurement.positions, 4, cost_floor(np.ones((25, 25)), scene.search, True))
    arrays = [lines.segments for lines in drawn.lines] + [solid.vertices for solid in drawn.meshes] + [drawn.floor.rgb]
    assert not any(array.flags.writeable for array in arrays)
    with pytest.raises(dataclasses.FrozenInstanceError):
        drawn.title = "another"


def test_what_stays_is_shared_between_pictures(scene, measurement):
    """A renderer recognises by identity that a primitive need not be sent again."""
    static = static_picture(scene, measurement)
    first = with_estimate(static, measurement, measurement.positions, 3)
    second = with_estimate(static, measurement, measurement.positions + 0.01, 4)
    for name in ("microphones/true", "room/walls", "frame", "room/grid"):
        assert part(first, name) is part(second, name)


@pytest.mark.parametrize("dark", [False, True])
def test_the_foreground_is_legible_on_its_background(scene, measurement, dark):
    """Contrast of texts and rulers is at least 7 to 1 (WCAG, level AAA)."""

    def luminance(colour):
        c = np.array(colour) / 255
        return np.where(c <= 0.03928, c / 12.92, ((c + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722]

    theme = static_picture(scene, measurement, dark).theme
    low, high = sorted([luminance(theme.foreground), luminance(theme.background)])
    assert (high + 0.05) / (low + 0.05) >= 7


def test_the_error_summary_is_in_millimetres(measurement):
    text = error_summary(measurement, measurement.positions + np.array([0.003, 0.004]))
    assert text == "mean error 5 mm, largest 5 mm"


def test_a_measurement_without_search_domain_is_framed_by_its_microphones(measurement):
    bare = dataclasses.replace(measurement, search=None)
    drawn = compose(None, bare, measurement.positions)
    x0, y0, x1, y1 = drawn.focus
    inside = (measurement.positions > [x0, y0]) & (measurement.positions < [x1, y1])
    assert inside.all() and "room/walls" not in names(drawn)
    assert static_picture(None, bare).bounds == drawn.focus


@pytest.fixture(scope="module")
def ball():
    """A scene of three dimensions and a measurement in its search domain, no field computed."""
    scene = load_scene("ball3d")
    positions = np.random.default_rng(1).uniform([1.5, 1.2, 0.9], [2.3, 2.0, 1.7], (12, 3))
    return scene, listen(positions, known=(0, 1, 2, 3), search=scene.search, dimension=3)


def test_in_space_every_marker_is_at_its_own_height(ball):
    scene, measurement = ball
    estimate = measurement.positions + [0.01, 0.0, 0.02]
    estimate[:4] = measurement.positions[:4]
    drawn = compose(scene, measurement, estimate, microphone=5)
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
    floor = cost_floor(np.ones((51, 51)), scene.search, height=z_range_of(scene, measurement)[0])
    drawn = compose(scene, measurement, measurement.positions, 5, floor)
    assert drawn.z_range == (0.8, 1.8) and drawn.floor.height == 0.8
    edges = np.concatenate([part(drawn, name).segments for name in ("room/edges", "room/box")])
    np.testing.assert_allclose(np.ptp(edges.reshape(-1, 3), axis=0), scene.room.size, atol=0.01)
    upright = np.abs(edges[:, 1] - edges[:, 0])[:, 2] > 2.4
    assert upright.sum() == 5, "four edges and the stem of the source"
    assert "room/walls" not in names(drawn)
    diamond = part(drawn, "lowest").vertices
    assert np.all((diamond[:, 2] > 0.8) & (diamond[:, 2] < 0.8 + drawn.marker_radius))


def test_a_plane_array_is_drawn_at_its_height_in_the_room():
    scene = load_scene("plane3d")
    positions = np.random.default_rng(1).uniform([1.5, 1.2], [2.3, 2.0], (12, 2))
    measurement = listen(positions, search=scene.search, dimension=3, array_dimension=2)
    drawn = compose(scene, measurement, positions, 5)
    assert drawn.z_range == (1.2, 1.2)
    for name in ("microphones/true", "microphones/estimate", "microphones/known", "frame"):
        each = part(drawn, name)
        z = (each.segments if hasattr(each, "segments") else each.vertices)[..., 2]
        np.testing.assert_allclose(z, 1.2, atol=drawn.marker_radius)
    assert compose(None, measurement, positions).z_range == (0.0, 0.0)


def test_trails_follow_each_microphone_and_skip_rests(scene, measurement):
    start = measurement.positions
    paths = np.stack([start, start, start + [0.01, 0.0], start + [0.01, 0.02]])
    paths[:, 4] = start[4]  # this one never moves
    segments = part(with_trails(compose(scene, measurement), paths), "trails").segments
    assert segments.shape == (2 * 11, 2, 3)
    for n in (0, 7, 11):
        for ends in (paths[1:3, n], paths[2:4, n]):
            assert (np.abs(segments[:, :, :2] - ends).max(axis=(1, 2)) < 1e-6).any()
    assert "trails" not in names(with_trails(compose(scene, measurement), paths[:1]))


def test_ellipses_have_the_half_axes_given(scene, measurement):
    axes = np.tile(np.array([[0.0, 0.004], [0.02, 0.0]]), (12, 1, 1))
    axes[:3] = 0  # known
    drawn = with_ellipses(compose(scene, measurement), measurement.positions, axes)
    rims = part(drawn, "ellipses").segments[:, 0, :2].reshape(-1, 9, 2)  # a corner of all, then the next
    away = rims - measurement.positions[3:]
    np.testing.assert_allclose(np.abs(away[..., 0]).max(axis=0), 0.02, rtol=1e-4)
    np.testing.assert_allclose((away[..., 0] / 0.02) ** 2 + (away[..., 1] / 0.004) ** 2, 1.0, rtol=1e-3)
    nothing = with_ellipses(compose(scene, measurement), measurement.positions, 0 * axes)
    assert "ellipses" not in names(nothing)


def test_compared_solvers_have_marks_of_different_shape_and_colour_at_their_estimates(measurement):
    picture = static_picture(None, measurement)
    placed = {name: measurement.positions + 0.01 * i for i, name in enumerate(solvers.names())}
    drawn = with_comparison(picture, placed, np.array([3, 4]))
    marks = {
        solid.name: solid for solid in drawn.meshes if solid.name.startswith("comparison/") and "halo" not in solid.name
    }
    count = len(placed)
    assert len(marks) == count and len({mark.colour for mark in marks.values()}) == count
    assert len({len(mark.faces) for mark in marks.values()}) == count, "shapes differ, too"
    for (name, positions), mark in zip(placed.items(), marks.values(), strict=True):
        middles = np.split(mark.vertices[:, :2], 2)
        for middle, n in zip(middles, (3, 4), strict=True):
            np.testing.assert_allclose(middle.mean(axis=0), positions[n], atol=1e-6, err_msg=name)


def test_a_measured_room_has_no_walls_and_no_source_in_any_picture():
    scene = load_scene("listening_lab")
    places = positions_of(scene)
    measurement = Measurement(
        np.array([100.0]), np.ones((1, 64), complex), 343.0, 3, positions=places, search=scene.search
    )
    picture = static_picture(scene, measurement)
    parts = [part.name for part in (*picture.meshes, *picture.lines, *picture.labels)]
    assert not [name for name in parts if name.startswith(("room", "source"))]
    assert picture.bounds == picture.focus
    corners = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    pixels = project(camera_for(picture, (640, 480), "3d"), (640, 480), corners)
    assert (pixels >= 0).all() and (pixels <= (640, 480)).all(), "there is no floor at z = 0 to stand on"


def test_a_solver_that_is_added_has_a_mark_of_its_own(monkeypatch):
    monkeypatch.setattr(solvers, "names", lambda: ["descent", "descent+joint", "joint", "newest"])
    marks = {solver_mark(name) for name in solvers.names()}
    assert len({mark.shape for mark in marks}) == len({mark.colour for mark in marks}) == 4
    assert solver_mark("from another machine") in SOLVER_MARKS
