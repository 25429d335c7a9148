"""A plane array in a room of three dimensions: the given positions carry its size, not the assumption on the field."""

from dataclasses import replace

import numpy as np
import pytest
from solving import rms, solved

from fdcal.acoustics.box_field import point_source_pressures
from fdcal.model.measurement import Measurement
from fdcal.model.room import Room

ROOM = Room(size=(4.6, 3.8, 2.7), walls="rigid")
SIDE, MODES, SNR = 7, 50, 40.0  # microphones, modes, dB
CORNERS = np.array([0, SIDE - 1, SIDE * (SIDE - 1), SIDE**2 - 1])


@pytest.fixture(scope="module")
def plane():
    """A grid of 1 m by 1 m at a height of 1.2 m, its corners given."""
    axis = np.linspace(-0.5, 0.5, SIDE)
    x = np.array([1.9, 1.6]) + np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    frequencies = np.linspace(60.0, 300.0, MODES)
    k = (2 * np.pi * frequencies - 1.5j) / 343.0
    p = point_source_pressures(ROOM, (4.37, 3.55, 2.45), np.column_stack([x, np.full(len(x), 1.2)]), k)
    p = p / np.sqrt(np.mean(np.abs(p) ** 2, axis=1))[:, None]
    noise = 10 ** (-SNR / 10)
    parts = np.random.default_rng(0).standard_normal((2, *p.shape)) * np.sqrt(noise / 2)
    return Measurement(
        frequencies=frequencies, pressures=p + parts[0] + 1j * parts[1], sound_speed=343.0, dimension=3,
        array_dimension=2, wavenumbers=k, noise_power=np.full(MODES, noise), positions=x, known=CORNERS,
    )  # fmt: skip


def test_given_corners_hold_the_size_of_a_plane_array(plane):
    end = solved(plane)
    np.testing.assert_allclose(end.state.positions[CORNERS], plane.positions[CORNERS], atol=3e-3)
    assert rms(end.state.positions, plane.positions) < 0.01
    assert end.assessment.verdict == "ambiguous"
    assert "nothing would show an error of a given position" in end.assessment.message


def test_a_fifth_given_position_checks_the_corners(plane):
    known = np.sort(np.append(CORNERS, SIDE**2 // 2))
    end = solved(replace(plane, known=known, known_positions=plane.positions[known]))
    assert end.assessment.verdict == "good"
    assert rms(end.state.positions, plane.positions) < 0.005


def test_the_size_follows_the_given_corners(plane):
    middle = plane.positions.mean(axis=0)
    larger = replace(plane, known_positions=middle + 1.02 * (plane.positions[CORNERS] - middle))
    found = solved(larger).state.positions
    np.testing.assert_allclose(found[CORNERS], larger.known_positions, atol=3e-3)
