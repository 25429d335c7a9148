"""Absolute positions in a room of known size, through the command line."""

import re
from dataclasses import replace

import numpy as np
import pytest
from fields import measured
from running import refuses

from fdcal.acoustics.room_modes import room_symmetries
from fdcal.model.measurement import Measurement, save_measurement
from fdcal.model.scene import load_scene
from fdcal.model.settings import SolverSettings
from fdcal.session.sources import CalibrationInput, with_settings
from fdcal.solvers import room

TRUTH = np.array([[1.0, 0.8], [1.6, 3.9], [2.3, 2.2], [3.4, 0.7], [3.9, 3.1], [4.7, 1.9], [0.6, 2.7], [5.3, 1.1]])
SOURCE, SIZE, MODES = (3.1, 4.4), (6.0, 5.0), 24


def measurement(known=(), noise_reported: bool = True) -> Measurement:
    """Eight microphones in the rigid room, at 40 dB."""
    found = measured(TRUTH, known, snr_db=40, seed=2, source=SOURCE, modes=MODES)
    return replace(found, search=None, noise_power=found.noise_power if noise_reported else None)


@pytest.fixture
def calibrate(calibrate_file):
    """Function that calibrates a measurement with options: exit code, output, error line, result."""

    def run(measured: Measurement, *options):
        save_measurement(measured, "m.npz")
        return calibrate_file(*options)

    return run


def test_eight_microphones_are_found_up_to_the_listed_symmetries(calibrate):
    code, out, _, result = calibrate(measurement(), "--room", "6x5")
    assert (code, result["verdict"], result["solver"]) == (0, "good", "room")
    arrays = {image["map"]: np.array(image["positions"]) for image in result["symmetries"]}
    assert set(arrays) == {"(x, y)", "(6 - x, y)", "(x, 5 - y)", "(6 - x, 5 - y)"}
    assert all(name in out for name in arrays if name != "(x, y)")
    assert np.allclose(arrays["(6 - x, y)"], [6, 0] + np.array(result["positions"]) * [-1, 1])
    errors = {name: np.linalg.norm(array - TRUTH, axis=1) for name, array in arrays.items()}
    best = min(errors.values(), key=np.max)
    assert best.max() < 0.01
    assert result["max_error_m"] == pytest.approx(best.max())
    assert sum(error.max() < 0.1 for error in errors.values()) == 1
    sources = [image.apply(result["source"]) for image in room_symmetries(SIZE)]
    assert min(np.linalg.norm(place - SOURCE) for place in sources) < 0.02
    assert 0.2 < np.sqrt(np.mean(best**2)) / np.sqrt(np.mean(np.square(result["uncertainty_m"]))) < 3
    assert result["left_out_db"] < -30


def test_one_known_microphone_chooses_among_the_symmetries(calibrate):
    code, _, _, result = calibrate(measurement(known=[6]), "--room", "6x5")
    assert code == 0
    assert np.linalg.norm(np.array(result["positions"]) - TRUTH, axis=1).max() < 0.01


def disturbed(measured: Measurement) -> Measurement:
    """Microphone 3 also records something else."""
    pressures = measured.pressures.copy()
    pressures[:, 3] += 0.2 * np.abs(pressures).mean() * np.random.default_rng(5).normal(size=(MODES, 2)) @ [1, 1j]
    return replace(measured, pressures=pressures)


@pytest.mark.parametrize(
    ("measured", "size", "codes", "words"),
    [
        (measurement(), "6.06x5.05", {"room_size"}, "correct --room"),
        (disturbed(measurement()), "6x5", {"odd_channel"}, "--exclude 3"),
        (measurement(noise_reported=False), "6.06x5.05", {"room_size", "model_mismatch"}, ""),
    ],
)
def test_an_untrustworthy_result_is_reported_with_its_cause(calibrate, measured, size, codes, words):
    exit_code, out, _, result = calibrate(measured, "--room", size)
    assert exit_code == 4 and result["verdict"] in codes and words in result["verdict_text"], result["verdict_text"]
    assert result["verdict_text"] in " ".join(out.split())


def test_modes_chosen_by_the_user_must_be_enough():
    problem = measurement().problem()
    state = room.init(problem, SolverSettings(name="room", modes=MODES, room=SIZE), 0)
    refuses("too few for a known room", room.use_modes, problem, state, 4, 5, False)
    assert room.use_modes(problem, state, 1, 12, False).last == 12


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--room", "5.2x5.2"], r"known microphone 7.*outside"),
        (["--room", "6"], "is not the size of a room"),
        (["--room", "6xfive"], "is not the size of a room"),
        (["--room", "6x-5"], "above zero"),
        (["--room", "nanx5"], "above zero"),
        (["--room", "6x5x3"], "the sound field has 2 dimensions"),
        (["--room", "2x1.5"], "smaller than the array"),
        (["--room", "6000x5000"], "too many modes"),
        (["--room", "6x5", "--modes", "2"], "too few for a known room"),
        (["--room", "6x5", "--solver", "joint"], "leave out --solver joint"),
        (["--room", "6x5", "--distance", "0,1,1"], "a known room fixes"),
        (["--solver", "room"], "needs the size of the room"),
    ],
)
def test_a_bad_room_is_refused_in_one_line(calibrate, options, words):
    code, _, line, _ = calibrate(measurement(known=[7] if "7" in words else ()), *options)
    assert code == 2 and re.search(words, line)


def test_a_scene_that_is_no_rectangle_is_refused():
    inputs = CalibrationInput("lshape", load_scene("lshape"), measurement(), load_scene("lshape").solver, 0)
    refuses("is not a rectangle", with_settings, inputs, solver="room", room=(6.0, 5.0))
