"""One given distance sets the size of a blind array: right, with a small error, and by mistake."""

from dataclasses import replace

import pytest

import fdcal


@pytest.fixture(scope="module")
def blind():
    measurement = fdcal.load("tiny")
    true = float(((measurement.positions[0] - measurement.positions[15]) ** 2).sum() ** 0.5)

    def run(metres: float, solver: str):
        length = (0, 15, metres * true)
        return fdcal.calibrate(measurement, known="none", solver=solver, distance=length, estimate_sound_speed=True)

    return run


@pytest.mark.parametrize(("factor", "solver"), [(1.0, "robust"), (1.02, "joint")])
def test_the_sound_speed_follows_the_distance(blind, factor, solver):
    found = blind(factor, solver)
    assert found.verdict == "good"
    assert found.sound_speed == pytest.approx(343 * factor, rel=5e-3)


@pytest.mark.parametrize(("factor", "solver"), [(0.8, "robust"), (1.12, "joint"), (300.0, "joint")])
def test_a_distance_that_no_air_explains_is_doubted(blind, factor, solver):
    found = blind(factor, solver)
    assert found.verdict == "sound_speed"
    assert "the distance or the sound speed is wrong" in found.verdict_text


@pytest.mark.parametrize("factor", [0.85, 1.06])
def test_given_positions_that_no_air_explains_are_doubted(factor):
    measurement = fdcal.load("tiny")
    known = {n: factor * measurement.positions[n] for n in (0, 5, 7)}
    found = fdcal.calibrate(measurement, solver="robust", known=known, estimate_sound_speed=True)
    assert found.verdict == "sound_speed"
    assert "the position of a microphone or the sound speed is wrong" in found.verdict_text


@pytest.mark.parametrize("given", [{"distance": (0, 15, None), "known": "none"}, {}])
def test_solver_robust_estimates_the_sound_speed_too(given):
    """From a given distance, or from the known microphones, of a measurement whose sound speed is 2 % too low."""
    measurement = fdcal.load("tiny")
    x, slow = measurement.positions, 0.98 * measurement.sound_speed
    slower = replace(measurement, sound_speed=slow, wavenumbers=measurement.wavenumbers / 0.98)
    if "distance" in given:
        given = given | {"distance": (0, 15, float(((x[0] - x[15]) ** 2).sum() ** 0.5))}
    found = fdcal.calibrate(slower, solver="robust", estimate_sound_speed=True, **given)
    assert found.sound_speed == pytest.approx(measurement.sound_speed, rel=5e-3)
    assert found.max_error < 5e-3
