"""Arrays in a room of three dimensions."""

import dataclasses

import numpy as np
import pytest

from fdcal.acoustics.box_field import point_source_pressures
from fdcal.acoustics.measure import measure
from fdcal.cost.expansion import usable_modes
from fdcal.graphics.landscape import landscape_panels
from fdcal.model.array_layout import Array
from fdcal.model.arrays import encloses_3d, positions_3d, positions_of
from fdcal.model.gauge import position_errors
from fdcal.model.geometry import ball, box, plane
from fdcal.model.scene_file import load_scene
from fdcal.model.settings import Sensing
from fdcal.model.validation import InputError
from fdcal.session.calibration_run import solve
from fdcal.session.sources import CalibrationInput
from fdcal.solvers import load, with_mode_count


def test_a_ball_is_filled_evenly():
    points = ball(4000, 0.5, np.random.default_rng(0))
    r = np.linalg.norm(points, axis=1)
    assert r.max() <= 0.5
    shares = np.histogram(r**3 / 0.5**3, 8, (0, 1))[0] / 4000
    np.testing.assert_allclose(shares, 1 / 8, atol=4 * np.sqrt(7 / 64 / 4000))
    assert np.abs((points / r[:, None]).mean(axis=0)).max() < 4 / np.sqrt(3 * 4000)
    assert np.array_equal(points, ball(4000, 0.5, np.random.default_rng(0)))


def test_a_box_is_filled_and_a_plane_is_a_lattice():
    points = box(500, (1.0, 0.5, 0.2), np.random.default_rng(0))
    np.testing.assert_allclose(np.ptp(points, axis=0), (1.0, 0.5, 0.2), rtol=0.02)
    assert np.all(np.abs(points) <= [0.5, 0.25, 0.1])
    np.testing.assert_allclose(
        plane((2, 2), (1.0, 0.4)), [[-0.5, -0.2, 0], [0.5, -0.2, 0], [-0.5, 0.2, 0], [0.5, 0.2, 0]]
    )
    assert plane((11, 3), (1.0, 1.0)).shape == (33, 3)


def test_the_convex_hull_of_a_solid_and_of_a_flat_array():
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1.0)])
    assert encloses_3d(cube, np.array([0.2, 0.9, 0.5])) and not encloses_3d(cube, np.array([0.2, 1.1, 0.5]))
    sheet = cube[cube[:, 2] == 0]
    assert encloses_3d(sheet, np.array([0.5, 0.5, 0.0])) and not encloses_3d(sheet, np.array([0.5, 0.5, 0.01]))


def test_a_plane_array_has_two_coordinates_and_stands_at_its_height():
    scene = load_scene("plane3d")
    places = positions_3d(scene)
    np.testing.assert_array_equal(places[:, :2], positions_of(scene))
    np.testing.assert_allclose(places[:, 2], scene.array.center[2])


@pytest.mark.parametrize("name", ["ball3d", "plane3d"])
def test_the_measurement_is_the_field_at_the_microphones(name):
    scene = load_scene(name)
    few = Array("box", (1.9, 1.6, 1.3), count=6, size=(0.6, 0.6, 0.4))
    if name == "plane3d":
        few = Array("plane", (1.9, 1.6, 1.3), shape=(3, 2), size=(0.6, 0.6))
    sensing = Sensing(40.0, 30.0, 90.0, 1.0, 1.0, "continuous")
    scene = dataclasses.replace(
        scene, array=few, measurement=sensing, gauge=dataclasses.replace(scene.gauge, known=(0, 1, 2, 4))
    )
    measured = measure(scene)
    clean = measure(dataclasses.replace(scene, measurement=dataclasses.replace(sensing, snr_db=np.inf)))
    assert (measured.dimension, measured.array_dimension) == (3, 2 if name == "plane3d" else 3)
    np.testing.assert_allclose(
        clean.pressures,
        point_source_pressures(scene.room, scene.source.position, positions_3d(scene), clean.wavenumbers),
        rtol=1e-9,
    )
    assert not clean.noise_power.any() and np.all(clean.wavenumbers.imag < 0) and len(clean.frequencies) > 5
    np.testing.assert_allclose(measured.noise_power, 1e-4 * np.mean(np.abs(clean.pressures) ** 2, axis=1))
    noise = np.mean(np.abs(measured.pressures - clean.pressures) ** 2 / measured.noise_power[:, None])
    assert noise == pytest.approx(1.0, abs=4 / np.sqrt(clean.pressures.size))
    np.testing.assert_array_equal(measure(scene).pressures, measured.pressures)


@pytest.fixture(scope="module", params=["ball3d", "plane3d"])
def shipped(request):
    """A scene that ships and its measurement."""
    scene = load_scene(request.param)
    return scene, measure(scene)


def test_scenes_in_space_are_calibrated_all_at_once(shipped):
    """The figures of the documentation, with a margin."""
    scene, measurement = shipped
    found = solve(CalibrationInput(scene.title, None, measurement, scene.solver, scene.seed))
    assert found.verdict == "good"
    assert position_errors(found.positions, measurement.positions).mean() < 5e-3
    corrected = found.positions[list(measurement.known)] - measurement.known_positions
    assert np.abs(corrected).max() < 2.5e-3, "given positions are measurements, and here they are exact"


def test_the_map_of_one_microphone_is_lowest_at_its_place_in_its_own_layer(shipped):
    scene, measurement = shipped
    solver, problem = load(scene.solver.name), measurement.problem()
    state = solver.init(problem, with_mode_count(problem, scene.solver), 0)
    there = dataclasses.replace(state, positions=measurement.positions)
    for n in (1, 40):
        cost = solver.landscape(problem, there, n, slice(0, 40)).sum(axis=0)
        layer = scene.search.layer(measurement.positions[n, -1])
        assert cost.shape == scene.search.shape[1::-1] == layer.shape[:2]
        lowest = layer.reshape(-1, layer.shape[2])[cost.argmin()]
        assert np.linalg.norm(lowest - measurement.positions[n]) < scene.search.step


def test_the_figure_of_the_paper_refuses_a_field_in_space_and_its_solver_a_plane_array_there(shipped):
    scene, measurement = shipped
    problem = measurement.problem()
    settings = dataclasses.replace(with_mode_count(problem, scene.solver), start="affine")
    if measurement.array_dimension == 2:
        with pytest.raises(InputError, match=r"two-dimensional"):
            load("descent").init(problem, settings, 0)
    else:
        state = load("descent").init(problem, settings, 0)
        assert load("descent").step(problem, state).positions.shape == measurement.positions.shape
    with pytest.raises(InputError, match=r'two-dimensional field.*solver\.name = "joint"'):
        landscape_panels(problem, measurement.positions, 5, [1, 2], 2)
    assert usable_modes(problem, 2) == len(measurement.frequencies)
