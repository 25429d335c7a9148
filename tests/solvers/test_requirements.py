"""How many modes a calibration uses unless their number is given."""

import dataclasses

import numpy as np
import pytest
from fields import disc, waves

import fdcal
from fdcal.acoustics.dictionary import array_f_max
from fdcal.model.measurement import Measurement
from fdcal.model.scene import load_scene, scene_names
from fdcal.model.settings import ALL_MODES, Search, SolverSettings
from fdcal.model.validation import LIMITS
from fdcal.session.calibration_run import problem_of
from fdcal.session.scene_edits import edited, table_of
from fdcal.session.sources import measurement_input, with_settings
from fdcal.solvers import load, with_mode_count
from fdcal.solvers.requirements import highest_frequency, mode_count

# These scenes state their number of modes.
PAPER = {"array1_circle", "array2_random", "array2_faults", "fig1_square", "tiny"}


def measurement(highest, count=40, radius=0.4, modes=120, known=()):
    """A diffuse field in the plane, up to `highest` times what the array interpolates."""
    positions, given = disc(count, radius, 5), np.array(known, int)
    limit = array_f_max(positions, 343.0, 2)
    frequencies = np.linspace(20, highest * limit, modes)
    pressures = waves(positions, 2 * np.pi * frequencies / 343.0, 200)
    return Measurement(
        frequencies, pressures, 343.0, positions=positions, known=given, known_positions=positions[given]
    ), limit  # fmt: skip


def count_of(inputs):
    return with_mode_count(problem_of(inputs), inputs.settings).modes


def test_all_modes_that_the_array_can_interpolate_are_used_and_a_number_that_is_given_holds():
    within, _ = measurement(1.0)
    assert count_of(measurement_input(within)) == 120
    assert count_of(measurement_input(within, settings=SolverSettings(modes=57))) == 57
    assert count_of(measurement_input(within, settings=SolverSettings(modes=300))) == 120


@pytest.mark.parametrize("known", [(), (0, 7, 13, 22)])
def test_modes_far_beyond_the_array_are_left_out_by_a_solver_that_interpolates(known):
    beyond, limit = measurement(8.0, modes=400, known=known)
    count = count_of(measurement_input(beyond, settings=SolverSettings("descent")))
    assert count_of(measurement_input(beyond)) == 400, "a likelihood interpolates nothing"
    assert limit < beyond.frequencies[count] < 3 * limit, "the radius is estimated to a factor of 1.5, on the safe side"


def test_known_microphones_far_apart_say_more_than_the_coherence():
    (beyond, limit), (blind, _) = measurement(4.0, modes=200, known=tuple(range(39))), measurement(4.0, modes=200)
    found = highest_frequency(beyond.problem())
    assert 0.99 * limit < found < 1.2 * limit, "half their largest distance is a radius that the array surely has"
    assert found < highest_frequency(blind.problem())


def test_no_solver_is_given_more_modes_than_it_can_use():
    found = fdcal.load("tiny")
    far = dataclasses.replace(found, search=Search((0.46, 0.3), (0.48, 0.48), 0.02, 1.2))
    usable = load("descent").usable_modes(far.problem(), SolverSettings())
    assert 0 < usable < len(found.frequencies)
    inputs = measurement_input(far)
    assert count_of(inputs) == len(found.frequencies)
    assert count_of(with_settings(inputs, "descent")) == usable
    assert count_of(with_settings(with_settings(inputs, "descent"), "joint")) == len(found.frequencies)
    assert count_of(with_settings(with_settings(inputs, modes=9), "descent")) == 9


def test_the_number_of_modes_is_limited_by_memory(monkeypatch):
    found = fdcal.load("tiny")
    monkeypatch.setattr("fdcal.solvers.requirements.LIMITS", dataclasses.replace(LIMITS, pairs=25 * found.count**2))
    assert mode_count(found.problem(), 36, False) == 25


@pytest.mark.parametrize("name", [name for name in scene_names() if name not in PAPER])
def test_a_scene_without_a_number_of_modes_uses_all(name):
    scene = load_scene(name)
    assert scene.solver.modes == ALL_MODES
    assert "modes" not in table_of(scene)["solver"] and edited(scene, {}) == scene, "no number is made up"
