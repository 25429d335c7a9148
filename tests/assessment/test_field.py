"""The field between the microphones, and the prediction of each of them by the others."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from fields import measured, rigid_room
from PIL import Image
from running import exit_code, refuses
from scipy.linalg import solve

from fdcal.acoustics.box_field import point_source_pressures as box_field
from fdcal.acoustics.dictionary import dictionary
from fdcal.assessment.field import NOISE_DEFLATION, cross_validate, field_map, interpolated, leave_one_out_errors
from fdcal.cost.noise import DIFFUSE_FLOOR
from fdcal.graphics import exports
from fdcal.model.measurement import Measurement, save_measurement
from fdcal.model.scene import Room
from fdcal.session.api import load

RNG = np.random.default_rng(7)
PLANE = np.array([2.61, 2.31]) + RNG.uniform(-0.5, 0.5, (30, 2))
SPACE = np.array([1.9, 1.6, 1.3]) + RNG.uniform(-0.4, 0.4, (60, 3))
BOX, BOX_SOURCE = Room(size=(4.1, 3.3, 2.6)), (3.6, 0.4, 2.1)
SOURCE = (5.47, 4.53)


def plane(snr_db: float = np.inf, highest: float = 250.0) -> Measurement:
    return measured(PLANE, [0, 1, 2], highest, snr_db)


def space(places=SPACE) -> Measurement:
    frequencies = np.array([60.0, 130.0, 220.0])
    k = (2 * np.pi * frequencies - 3j) / 343.0
    pressures = box_field(BOX, BOX_SOURCE, places, k)
    noise = 1e-6 * np.mean(np.abs(pressures) ** 2, axis=1)
    return Measurement(frequencies, pressures, 343.0, 3, wavenumbers=k, noise_power=noise, positions=places)


def every(measurement: Measurement) -> slice:
    return slice(0, len(measurement.frequencies))


def between(positions, count: int = 40) -> np.ndarray:
    """Points inside the hull of `positions`: weighted means of them."""
    return np.random.default_rng(1).dirichlet(np.full(len(positions), 0.3), count) @ positions


def ratio(errors, pressures) -> np.ndarray:
    """Error of each mode over its pressures, dB."""
    return 10 * np.log10(np.mean(np.abs(errors) ** 2, axis=1) / np.mean(np.abs(pressures) ** 2, axis=1))


@pytest.mark.parametrize("measurement", [plane(40.0), space()], ids=["plane", "space"])
def test_leave_one_out_errors_are_those_of_a_fit_without_the_microphone(measurement):
    problem = measurement.problem()
    modes = slice(2, 3)
    errors = leave_one_out_errors(problem, measurement.positions, modes, problem.noise_power)
    x, p = measurement.positions, problem.pressures[2]
    W = dictionary(x, problem.wavenumbers[2], 12, x.mean(axis=0), problem.dimension)
    v = max(problem.noise_power[2], DIFFUSE_FLOOR)  # the power is 1
    mu = v / (NOISE_DEFLATION * (1 - v))
    for n in (0, 7, 19):
        rest = np.arange(len(p)) != n
        A = W[rest].conj().T @ W[rest] + mu * np.eye(W.shape[1])
        predicted = W[n] @ solve(A, W[rest].conj().T @ p[rest], assume_a="pos")
        assert errors[0, n] == pytest.approx(p[n] - predicted, rel=1e-5, abs=1e-8)


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_field_between_microphones_is_that_of_the_room(dimension):
    measurement, places = (plane(), PLANE) if dimension == 2 else (space(), SPACE)
    points, k = between(places), measurement.wavenumbers
    truth = rigid_room(points, SOURCE, k) if dimension == 2 else box_field(BOX, BOX_SOURCE, points, k)
    found, _ = interpolated(measurement.problem("raw"), places, points, every(measurement), measurement.noise_power)
    error = ratio(found - truth, truth).max()
    assert error < (-45 if dimension == 2 else -40)


def test_one_sigma_covers_the_errors_due_to_noise():
    measurement = plane(30.0)
    points = between(PLANE, 200)
    truth = rigid_room(points, SOURCE, measurement.wavenumbers)
    modes = every(measurement)
    pressure, sigma = interpolated(measurement.problem("raw"), PLANE, points, modes, measurement.noise_power)
    assert 0.2 < np.mean(np.abs(pressure - truth) ** 2) / np.mean(sigma**2) < 1.5


def test_a_displaced_microphone_is_predicted_worst():
    measurement = plane(40.0)
    problem, displaced = measurement.problem(), PLANE.copy()
    inner = int(np.argmin(np.linalg.norm(PLANE - PLANE.mean(axis=0), axis=1)))
    displaced[inner] += [0.05, -0.05]
    found = cross_validate(problem, displaced, every(measurement), problem.noise_power)
    assert int(found.microphones.argmax()) == inner
    power = 10 ** (np.array([found.modes, [found.overall] * len(found.modes)]) / 10)
    assert power[0].mean() == pytest.approx(power[1, 0])


def test_the_map_has_the_unit_of_the_measurement_and_ends_at_the_hull_of_the_array():
    measurement = plane(60.0)
    loud = replace(measurement, pressures=1e6 * measurement.pressures, noise_power=1e12 * measurement.noise_power)
    one, two = (field_map(m, PLANE, [100.0], 0.05) for m in (measurement, loud))
    assert np.allclose(1e6 * one.pressure[:, one.inside], two.pressure[:, two.inside], rtol=1e-6)
    truth = rigid_room(one.points, SOURCE, measurement.wavenumbers[measurement.frequencies == one.frequencies[0]])
    assert ratio(one.pressure[:, one.inside] - truth, truth).max() < -40
    assert 20 < one.inside.sum() < one.inside.size, "corners of the rectangle around it are outside"
    assert np.isnan(one.pressure.real[:, ~one.inside]).all()
    assert np.isnan(one.pressure.imag[:, ~one.inside]).all()


@pytest.mark.parametrize("measurement", [plane(60.0), space()], ids=["plane", "space"])
def test_every_format_holds_the_same_map(measurement, tmp_path):
    found = field_map(measurement, measurement.positions, measurement.frequencies[:2], 0.1)
    for suffix in set(exports.FIELD_WRITERS) - {".png"}:
        exports.FIELD_WRITERS[suffix](tmp_path / "anything", found)
        (tmp_path / "anything").rename(tmp_path / f"map{suffix}")
    with np.load(tmp_path / "map.npz") as archive:
        assert np.array_equal(archive["pressure"], found.pressure, equal_nan=True)
        assert np.array_equal(archive["magnitude"], np.abs(found.pressure), equal_nan=True)
    rows = np.genfromtxt(tmp_path / "map.csv", delimiter=",", names=True)
    assert len(rows) == 2 * found.inside.sum()
    assert np.allclose(rows["real"] + 1j * rows["imag"], found.pressure[:, found.inside].ravel(), rtol=1e-6)
    assert np.allclose(rows["y_m"], np.tile(found.points[:, 1], 2), rtol=1e-6)
    if measurement.dimension == 3:
        return
    exports.FIELD_WRITERS[".png"](tmp_path / "map.png", found)
    pixels = np.asarray(Image.open(tmp_path / "map.png").convert("RGB"))
    assert pixels.shape[1] > 1000 and 0.4 < np.mean(np.all(pixels == 255, axis=-1)) < 0.95, "white outside the array"


OTHER = {
    "fdcal_result": 1,
    "positions": [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], "solver": "joint", "seed": 0, "frequencies": [100.0], "cost": 0,
    "sweeps": 1, "elapsed_s": 1.0, "converged": True, "mean_error_m": None, "max_error_m": None,
}  # fmt: skip


REFUSED = [
    (["--frequencies", "20"], "nothing was measured there"),
    (["--frequencies", "100,-3"], "above zero"),
    (["--frequencies", "low"], "not a list of numbers"),
    (["--step", "0"], "above zero"),
    (["--step", "nan"], "step = nan must be a number"),
    (["--step", "1e-5"], "use a larger one"),
    (["--result", "other.json"], "use the result of this measurement"),
    (["-o", "map.xlsx"], "must end in"),
]


def test_the_command_writes_the_map_and_refuses_bad_options_in_one_line(tmp_path, refused, capsys):
    save_measurement(plane(60.0), tmp_path / "plane.npz")
    (tmp_path / "other.json").write_text(json.dumps(OTHER))
    for options, words in REFUSED:
        assert words in refused("field", "plane.npz", "-o", "map.npz", *options)
    assert not exit_code("field", "plane.npz", "--frequencies", "57,115", "--step", "0.1", "-o", "map.npz")
    assert "57.2, 114." in capsys.readouterr().out
    with np.load("map.npz") as archive:
        assert np.array_equal(archive["microphones"], PLANE) and len(archive["frequencies"]) == 2


def test_microphones_on_a_line_enclose_nothing():
    line = np.linspace(0, 1, 30)[:, None] * [1.0, 0.5] + 2.0
    refuses("enclose no field", lambda: field_map(measured(line, []), line, [100.0]))


@pytest.mark.parametrize("name", ["tiny", "ball3d"])
def test_the_prediction_of_a_faulty_microphone_is_the_field_at_its_place(name):
    measurement = load(name)
    problem, modes = measurement.problem(), slice(0, 12)
    healthy = np.ones(measurement.count, bool)
    healthy[[3, 7]] = False
    found = cross_validate(problem, measurement.positions, modes, healthy=healthy)
    some = replace(problem, pressures=problem.pressures[:, healthy])
    predicted, _ = interpolated(some, measurement.positions[healthy], measurement.positions[~healthy], modes)
    p = problem.pressures[modes][:, ~healthy]
    expected = 10 * np.log10(np.sum(np.abs(p - predicted) ** 2, axis=0) / np.sum(np.abs(p) ** 2, axis=0))
    assert found.microphones[~healthy] == pytest.approx(expected, abs=0.3)
