"""Arrays: geometry, cell centres, and the checks of a scene's array."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fdcal.model.array_layout import Array, Gauge
from fdcal.model.arrays import positions_of
from fdcal.model.geometry import (
    circle,
    convex_hull,
    crosses_polygon,
    encloses,
    in_polygon,
    rectangle,
    rectangle_plus_random,
    snap,
)
from fdcal.model.room import Room
from fdcal.model.scene_file import load_scene
from fdcal.model.validation import InputError

L_SHAPE = np.array([[0, 0], [6, 0], [6, 3], [4, 3], [4, 5], [0, 5.0]])


def test_circle_is_evenly_spaced():
    points = circle(65, 0.35)
    assert np.allclose(np.linalg.norm(points, axis=1), 0.35)
    assert np.allclose(np.linalg.norm(np.diff(points, axis=0, append=points[:1]), axis=1), 0.7 * np.sin(np.pi / 65))


def test_rectangle_runs_along_x_first():
    points = rectangle((3, 2), (2.0, 1.0))
    assert np.allclose(points, [[-1, -0.5], [0, -0.5], [1, -0.5], [-1, 0.5], [0, 0.5], [1, 0.5]])
    assert np.allclose(rectangle((1, 2), (5.0, 1.0)), [[0, -0.5], [0, 0.5]])


@settings(deadline=None)  # a busy machine is no fault
@given(st.integers(0, 2**32), st.integers(1, 40))
def test_random_microphones_are_drawn_without_replacement(seed, extra):
    draw = [rectangle_plus_random((3, 3), (0.4, 0.4), extra, 0.04, np.random.default_rng(seed)) for _ in range(2)]
    assert np.array_equal(*draw), "the same seed gives the same array"
    points = draw[0]
    assert len(np.unique(np.round(points / 0.02), axis=0)) == len(points) == 9 + extra
    assert np.abs(points - 0.02).max() <= 0.2 + 1e-9  # the cells round 0 are centred on 0.02


def test_random_microphones_fill_every_free_cell_and_no_more():
    rng = np.random.default_rng(0)
    assert len(rectangle_plus_random((2, 2), (0.12, 0.12), 12, 0.04, rng)) == 16
    with pytest.raises(InputError, match=r"array\.random = 13 is more than the 12 free cells"):
        rectangle_plus_random((2, 2), (0.12, 0.12), 13, 0.04, rng)


@settings(deadline=None)  # a busy machine is no fault
@given(st.floats(-10, 10), st.floats(-10, 10), st.sampled_from([0.02, 0.04, 0.017]))
def test_snapping_returns_the_centre_of_the_own_cell_and_is_idempotent(x, y, cell):
    snapped = snap(np.array([x, y]), cell)
    assert np.abs(snapped - [x, y]).max() <= cell / 2 * (1 + 1e-6)
    assert np.array_equal(snap(snapped, cell), snapped)
    assert np.allclose(snapped / cell - 0.5, np.round(snapped / cell - 0.5), atol=1e-9)


def test_inside_of_an_l_shape():
    points = np.array([[5, 2.9], [3.9, 4.9], [4.1, 3.1], [-0.1, 1], [6.1, 1], [1, 5.1]])
    assert in_polygon(points, L_SHAPE).tolist() == [True, True, False, False, False, False]
    assert in_polygon(points, L_SHAPE[::-1]).tolist() == in_polygon(points, L_SHAPE).tolist()
    assert in_polygon(points.reshape(3, 2, 2), L_SHAPE).shape == (3, 2)


def test_inside_counts_the_area():
    centres = snap(np.stack(np.meshgrid(np.arange(0, 6.5, 0.1), np.arange(0, 5.5, 0.1)), axis=-1), 0.1)
    assert np.isclose(in_polygon(centres, L_SHAPE).sum() * 0.01, 26)


@settings(deadline=None)  # a busy machine is no fault
@given(st.floats(-3, 3), st.floats(-3, 3))
def test_hull_of_a_square(x, y):
    if abs(max(abs(x), abs(y)) - 1) > 1e-6:
        assert encloses(rectangle((2, 2), (2.0, 2.0)), np.array([x, y])) == (max(abs(x), abs(y)) < 1)


def test_hull_of_a_line_is_the_line():
    line = np.array([[0, 0], [1, 1], [2, 2.0]])
    assert encloses(line, np.array([1.5, 1.5]))
    assert encloses(line, np.array([2.0, 2.0]))
    assert not encloses(line, np.array([2.5, 2.5]))
    assert not encloses(line, np.array([1.0, 0.5]))


def test_positions_are_cell_centres_and_read_only():
    scene = load_scene("array1_circle")
    positions = positions_of(scene)
    assert np.array_equal(positions, snap(positions, scene.room.cell))
    radii = np.linalg.norm(positions - scene.array.center, axis=1)
    assert np.abs(radii - 0.35).max() < 0.02 * np.sqrt(0.5)
    with pytest.raises(ValueError, match="read-only"):
        positions[0] = 0


def test_the_seed_moves_only_the_random_microphones(edited):
    one, two = (positions_of(load_scene(edited({"seed": seed}))) for seed in ("1", "2"))
    assert np.array_equal(one[:9], two[:9])
    assert not np.array_equal(one[9:], two[9:])


def test_positions_given_one_by_one(edited):
    changes = {"array.geometry": '"positions"', "array.shape": None, "array.size": None, "array.random": None}
    changes |= {"array.positions": "[[-0.2, -0.2], [0.2, 0], [0, 0.2], [0.13, 0.11]]", "gauge.known": "[0, 1, 2]"}
    expected = [[0.5, 0.34], [0.9, 0.54], [0.7, 0.74], [0.82, 0.66]]
    assert np.allclose(positions_of(load_scene(edited(changes))), expected)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"array.size": "[0.04, 0.4]"}, ["microphones 0 and 1 in one cell", "larger array"]),
        ({"array.random": "200"}, ["array.random = 200", "use at most"]),
        ({"array.center": "[0.1, 0.54]"}, ["microphone 0", "outside the room", "change array.center"]),
        (
            {"room.size": None, "room.outline": "[[0, 0], [1.68, 0], [1.68, 1.2], [0.6, 1.2], [0.6, 0.6], [0, 0.6]]"},
            ["microphone 6 at (0.5, 0.74) m", "in a wall"],
        ),
        ({"source.position": "[2.0, 1.1]"}, ["source.position = [2.0, 1.1] m", "outside the room", "move it"]),
        ({"source.position": "[0.75, 0.6]"}, ["source.position", "inside the array", "convex hull"]),
        ({"gauge.known": "[0, 5]"}, ["gauge.known = [0, 5]", "three microphones"]),
        ({"gauge.known": "[0, 1, 2]"}, ["gauge.known = [0, 1, 2]", "not on one line"]),
        ({"gauge.known": "[0, 5, 16]"}, ["gauge.known names microphone 16", "0 to 15"]),
        ({"gauge.known": "[0, 5, 5]"}, ["gauge.known", "twice"]),
        ({"gauge.known": None, "gauge.free": "[]"}, ["no microphone to be found"]),
        ({"search.origin": "[0.7, 0.3]"}, ["microphone 3", "search domain", "search.origin or search.size"]),
    ],
)
def test_bad_array_names_key_value_and_remedy(edited, changes, words):
    with pytest.raises(InputError) as caught:
        positions_of(load_scene(edited(changes)))
    for word in words:
        assert word in str(caught.value)


def test_hull_is_the_corners_alone():
    square = rectangle((5, 4), (2.0, 2.0))
    corners = {(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)}
    assert {tuple(point) for point in convex_hull(square).tolist()} == corners
    assert len(convex_hull(square)) == 4
    assert len(convex_hull(np.array([[0, 0], [1, 1], [2, 2.0]]))) == 2
    assert len(convex_hull(circle(17, 1.0))) == 17


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        ((-2, 0), (2, 0.5), True),  # right through
        ((0, 0), (0.1, 0.2), True),  # within
        ((0, 0), (0, 5), True),  # ends within
        ((-2, 1.1), (2, 1.1), False),  # past it
        ((1.5, 0), (4, 0), False),  # before it
        ((0.5, 2), (2, 0.5), False),  # past a corner
        ((0.4, 2), (2, 0.4), False),
        ((0, 1.9), (1.9, 0), True),  # cuts a corner off
    ],
)
def test_wall_that_crosses_a_square(a, b, expected):
    square = convex_hull(rectangle((3, 3), (2.0, 2.0)))
    assert crosses_polygon(np.array(a, float), np.array(b, float), square) == expected
    assert crosses_polygon(np.array(b, float), np.array(a, float), square) == expected


def across(outline, positions):
    """lshape with another outline, or its own, and microphones at `positions`, the first three known."""
    scene = load_scene("lshape")
    room = scene.room if outline is None else Room(outline=outline, cell=scene.room.cell)
    array = Array(geometry="positions", positions=positions)
    return dataclasses.replace(scene, room=room, array=array, gauge=Gauge(known=(0, 1, 2)))


def test_array_round_the_inner_corner_is_refused():
    scene = across(None, ((3.91, 4.01), (5.01, 2.91), (3.51, 2.51), (2.51, 2.51)))
    with pytest.raises(InputError, match=r"room\.outline.*\(4, 3\).*between the microphones.*array\.center"):
        positions_of(scene)
    positions_of(across(None, ((3.91, 2.91), (3.01, 2.91), (3.01, 1.91), (2.51, 2.51))))


@pytest.mark.parametrize("end", [2.3, 1.0])  # a slot that ends between the microphones, and one that parts them
def test_array_on_both_sides_of_a_slot_is_refused(end):
    slot = ((0.0, 0.0), (6.0, 0.0), (6.0, 5.0), (2.02, 5.0), (2.02, end), (2.0, end), (2.0, 5.0), (0.0, 5.0))
    places = ((1.51, 1.91), (2.49, 1.91), (2.49, 2.81), (1.51, 2.81))
    with pytest.raises(InputError, match="nothing may obstruct"):
        positions_of(across(slot, places))
