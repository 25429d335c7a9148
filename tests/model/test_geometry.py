"""Arrays in the plane and in space, gauges, drawn sources, search domains, and how lengths are written."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from running import refuses

from fdcal.acoustics.box_field import point_source_pressures
from fdcal.acoustics.measure import measure
from fdcal.model import arrays
from fdcal.model.gauge import align, fixes_gauge, position_errors
from fdcal.model.scene import Array, Gauge, Room, load_scene
from fdcal.model.settings import CELLS, Sensing, search_around
from fdcal.model.validation import InputError, length_text

L_SHAPE = np.array([[0, 0], [6, 0], [6, 3], [4, 3], [4, 5], [0, 5.0]])


def test_circles_rectangles_and_lattices():
    points = arrays.circle(65, 0.35)
    assert np.allclose(np.linalg.norm(points, axis=1), 0.35)
    assert np.allclose(np.linalg.norm(np.diff(points, axis=0, append=points[:1]), axis=1), 0.7 * np.sin(np.pi / 65))
    points = arrays.rectangle((3, 2), (2.0, 1.0))  # x runs fastest
    assert np.allclose(points, [[-1, -0.5], [0, -0.5], [1, -0.5], [-1, 0.5], [0, 0.5], [1, 0.5]])
    assert np.allclose(arrays.rectangle((1, 2), (5.0, 1.0)), [[0, -0.5], [0, 0.5]])
    rng = np.random.default_rng(0)
    assert len(arrays.rectangle_plus_random((2, 2), (0.12, 0.12), 12, 0.04, rng)) == 16, "every free cell"
    with pytest.raises(InputError, match=r"array\.random = 13 is more than the 12 free cells"):
        arrays.rectangle_plus_random((2, 2), (0.12, 0.12), 13, 0.04, rng)


@settings(deadline=None)  # a busy machine must not fail the test
@given(st.integers(0, 2**32), st.integers(1, 40))
def test_random_microphones_are_drawn_without_replacement(seed, extra):
    rngs = np.random.default_rng(seed), np.random.default_rng(seed)
    points, again = (arrays.rectangle_plus_random((3, 3), (0.4, 0.4), extra, 0.04, rng) for rng in rngs)
    assert np.array_equal(points, again), "the same seed gives the same array"
    assert len(np.unique(np.round(points / 0.02), axis=0)) == len(points) == 9 + extra
    assert np.abs(points - 0.02).max() <= 0.2 + 1e-9  # 0.02 is the centre of the cell that begins at 0


@settings(deadline=None)  # a busy machine must not fail the test
@given(st.floats(-10, 10), st.floats(-10, 10), st.sampled_from([0.02, 0.04, 0.017]))
def test_snapping_returns_the_centre_of_the_own_cell_and_is_idempotent(x, y, cell):
    snapped = arrays.snap(np.array([x, y]), cell)
    assert np.abs(snapped - [x, y]).max() <= cell / 2 * (1 + 1e-6)
    assert np.array_equal(arrays.snap(snapped, cell), snapped)
    assert np.allclose(snapped / cell - 0.5, np.round(snapped / cell - 0.5), atol=1e-9)


def test_inside_of_an_l_shape():
    centres = arrays.snap(np.stack(np.meshgrid(np.arange(0, 6.5, 0.1), np.arange(0, 5.5, 0.1)), axis=-1), 0.1)
    assert np.isclose(arrays.in_polygon(centres, L_SHAPE).sum() * 0.01, 26), "square metres"
    points = np.array([[5, 2.9], [3.9, 4.9], [4.1, 3.1], [-0.1, 1], [6.1, 1], [1, 5.1]])
    assert arrays.in_polygon(points, L_SHAPE).tolist() == [True, True, False, False, False, False]
    assert arrays.in_polygon(points, L_SHAPE[::-1]).tolist() == arrays.in_polygon(points, L_SHAPE).tolist()
    assert arrays.in_polygon(points.reshape(3, 2, 2), L_SHAPE).shape == (3, 2)


def test_hulls_of_a_line_of_a_square_and_of_a_solid():
    line = np.array([[0, 0], [1, 1], [2, 2.0]])
    inside = [arrays.hull_meets(line, np.array([place])) for place in ([1.5, 1.5], [2.0, 2.0], [2.5, 2.5], [1.0, 0.5])]
    assert inside == [True, True, False, False]
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1.0)])
    sheet = cube[cube[:, 2] == 0]
    for solid, within, outside in ((cube, (0.2, 0.9, 0.5), (0.2, 1.1, 0.5)), (sheet, (0.5, 0.5, 0), (0.5, 0.5, 0.01))):
        assert [arrays.hull_meets(solid, np.array([place])) for place in (within, outside)] == [True, False]


def test_positions_of_a_scene(edited):
    """Cell centres, read-only; the seed moves only the random microphones; a plane array stands at its height."""
    scene = load_scene("array1_circle")
    positions = arrays.positions_of(scene)
    assert np.array_equal(positions, arrays.snap(positions, scene.room.cell)) and not positions.flags.writeable
    assert np.abs(np.linalg.norm(positions - scene.array.center, axis=1) - 0.35).max() < 0.02 * np.sqrt(0.5)
    one, two = (arrays.positions_of(load_scene(edited({"seed": seed}))) for seed in ("1", "2"))
    assert np.array_equal(one[:9], two[:9]) and not np.array_equal(one[9:], two[9:])
    scene = load_scene("plane3d")
    np.testing.assert_array_equal(arrays.positions_3d(scene)[:, :2], arrays.positions_of(scene))
    np.testing.assert_allclose(arrays.positions_3d(scene)[:, 2], scene.array.center[2])
    changes = {"array.geometry": '"positions"', "array.shape": None, "array.size": None, "array.random": None}
    changes |= {"array.positions": "[[-0.2, -0.2], [0.2, 0], [0, 0.2], [0.13, 0.11]]", "gauge.known": "[0, 1, 2]"}
    expected = [[0.5, 0.34], [0.9, 0.54], [0.7, 0.74], [0.82, 0.66]]
    assert np.allclose(arrays.positions_of(load_scene(edited(changes))), expected)


def across(outline, positions):
    """lshape with another outline, or its own, and microphones at `positions`, the first three known."""
    scene = load_scene("lshape")
    room = scene.room if outline is None else Room(outline=outline, cell=scene.room.cell)
    array = Array(geometry="positions", positions=positions)
    return dataclasses.replace(scene, room=room, array=array, gauge=Gauge(known=(0, 1, 2)))


def test_array_round_a_corner_or_on_both_sides_of_a_slot_is_refused():
    places = ((1.51, 1.91), (2.49, 1.91), (2.49, 2.81), (1.51, 2.81))
    for end in (2.3, 1.0):  # one slot ends between the microphones, the other separates them
        slot = ((0.0, 0.0), (6.0, 0.0), (6.0, 5.0), (2.02, 5.0), (2.02, end), (2.0, end), (2.0, 5.0), (0.0, 5.0))
        refuses("nothing may obstruct", arrays.positions_of, across(slot, places))
    scene = across(None, ((3.91, 4.01), (5.01, 2.91), (3.51, 2.51), (2.51, 2.51)))
    refuses(r"room\.outline.*\(4, 3\).*between the microphones.*array\.center", arrays.positions_of, scene)
    arrays.positions_of(across(None, ((3.91, 2.91), (3.01, 2.91), (3.01, 1.91), (2.51, 2.51))))


# An array in a room of three dimensions measures the field at its microphones.


@pytest.mark.parametrize("name", ["ball3d", "plane3d"])
def test_the_measurement_is_the_field_at_the_microphones(name):
    scene, few = load_scene(name), Array("box", (1.9, 1.6, 1.3), count=6, size=(0.6, 0.6, 0.4))
    if name == "plane3d":
        few = Array("plane", (1.9, 1.6, 1.3), shape=(3, 2), size=(0.6, 0.6))
    sensing = Sensing(40.0, 30.0, 90.0, 1.0, 1.0, "continuous")
    gauge = dataclasses.replace(scene.gauge, known=(0, 1, 2, 4))
    scene = dataclasses.replace(scene, array=few, measurement=sensing, gauge=gauge)
    measured = measure(scene)
    clean = measure(dataclasses.replace(scene, measurement=dataclasses.replace(sensing, snr_db=np.inf)))
    assert (measured.dimension, measured.array_dimension) == (3, 2 if name == "plane3d" else 3)
    there = scene.source.position, arrays.positions_3d(scene)
    field = point_source_pressures(scene.room, *there, clean.wavenumbers)
    np.testing.assert_allclose(clean.pressures, field, rtol=1e-9)
    assert not clean.noise_power.any() and np.all(clean.wavenumbers.imag < 0) and len(clean.frequencies) > 5
    np.testing.assert_allclose(measured.noise_power, 1e-4 * np.mean(np.abs(clean.pressures) ** 2, axis=1))


# Rigid alignment undoes a motion, and position errors remain without it.


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("mirror", [1, -1])
def test_alignment_undoes_any_rigid_motion(dimension, mirror):
    rng = np.random.default_rng(dimension)
    truth = rng.normal(size=(12, dimension))
    Q = np.linalg.qr(rng.normal(size=(dimension, dimension)))[0]
    Q[:, 0] *= mirror
    assert position_errors(align(truth @ Q + rng.normal(size=dimension), truth), truth) == pytest.approx(0, abs=1e-12)
    assert position_errors(align(2 * truth, truth), truth).max() > 0.1, "no scaling"
    flat = np.eye(dimension + 1, dimension)  # these points span the space
    assert fixes_gauge(flat) and not fixes_gauge(flat[:-2]) and not fixes_gauge(np.outer(np.arange(4.0), flat[0] + 1))


# A random source keeps its distances everywhere in the room; if there is no room for it, there is none.


MICROPHONES = np.array([[2.0, 2.0], [2.4, 2.0], [2.0, 2.4]])


@pytest.mark.parametrize("size", [(5.0, 4.0), (5.0, 4.0, 2.5)])
def test_places_keep_their_distances_and_reach_all_of_the_room(size):
    rng = np.random.default_rng(0)
    right = lambda place: place[0] > 0.5  # noqa: E731
    places = np.array([arrays.random_source(size, MICROPHONES, 0.7, rng, right) for _ in range(800)])
    assert places.shape == (800, len(size))
    assert (places >= arrays.WALL_DISTANCE_M).all() and (places <= np.array(size) - arrays.WALL_DISTANCE_M).all()
    assert np.linalg.norm(places[:, None, :2] - MICROPHONES, axis=2).min() > 0.7
    assert places[:, 0].min() > 0.5, "what is not allowed is not drawn"
    rngs = np.random.default_rng(3), np.random.default_rng(3)
    np.testing.assert_array_equal(*(arrays.random_source(size, MICROPHONES, 0.7, one, np.any) for one in rngs))
    assert arrays.random_source(size, MICROPHONES, 9.0, rng, lambda place: True) is None, "a full room"
    assert np.bincount((places[:, 0] > 2.5) * 2 + (places[:, 1] > 2.0)).min() > 100


# A measurement without a search domain gets one: it contains the array and a margin, in any dimension.


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("size", [0.03, 0.7, 4.0])
def test_a_domain_contains_the_array_and_a_margin(dimension, size):
    positions = 3 + size * np.random.default_rng(0).uniform(size=(30, dimension))
    search = search_around(positions)
    low, high = np.array(search.origin), np.add(search.origin, search.size)
    extent = float(np.ptp(positions, axis=0).max())
    assert (positions.min(axis=0) - low > 0.2 * extent).all() and (high - positions.max(axis=0) > 0.2 * extent).all()
    assert max(search.shape) <= CELLS[dimension] + 2
    farthest = np.linalg.norm(positions - (low + high) / 2, axis=1).max()
    assert farthest < search.radius <= np.linalg.norm(search.size) / 2 + 1e-9
    moved, larger = search_around(positions + 7.0), search_around(10 * positions)
    np.testing.assert_allclose(np.subtract(moved.origin, search.origin), 7.0)
    assert moved.size == pytest.approx(search.size) and moved.radius == pytest.approx(search.radius)
    if size > 0.1:  # smaller arrays get the smallest domain
        assert larger.step == pytest.approx(10 * search.step) and larger.radius == pytest.approx(10 * search.radius)


def test_a_blind_array_keeps_its_domain_only_if_this_lies_round_its_true_positions():
    truth = np.random.default_rng(2).uniform(size=(20, 2))
    estimate, around = truth @ [[0.0, -1.0], [1.0, 0.0]] + 9.0, search_around(truth)
    assert search_around(estimate, around, truth) is around
    elsewhere = dataclasses.replace(around, origin=(8.0, 8.0), radius=3.0)
    assert search_around(estimate, elsewhere) is elsewhere
    moved = search_around(estimate, elsewhere, truth)
    np.testing.assert_allclose(moved.origin, around.origin, atol=1e-9)
    assert moved.radius == 3.0


# Lengths are written without exponents; lengths from one metre on are written in metres.


@pytest.mark.parametrize(("length", "digits", "text"), [
    (0.0, 3, "0 mm"), (0.00413, 3, "4.13 mm"), (0.0996, 2, "100 mm"), (1.164, 3, "1.16 m"), (23214.6, 2, "23215 m"),
])  # fmt: skip
def test_lengths_have_no_exponent(length, digits, text):
    assert length_text(length, digits) == text
