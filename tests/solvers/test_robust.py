"""The solver `robust`: gains come back, faults are found, positions stay; in a measured room and in space, too."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fields import rigid_room, room_frequencies, waves, with_noise
from solving import rms, rms_of_shape, solved

from fdcal import calibrate
from fdcal.acoustics.box_field import point_source_pressures
from fdcal.acoustics.measure import measure
from fdcal.commands.report import summary
from fdcal.model.measurement import Measurement
from fdcal.model.scene import Room, load_scene
from fdcal.session.calibration_run import solve
from fdcal.session.sources import scene_input
from fdcal_bench.rooms import RATE, SPEED, draw_array, draw_source, responses

SIZE, SOURCE, SNR = (5.2, 4.1), (4.8, 3.7), 40.0  # metres, metres, dB
MODES = 34
COUNT = 24
KNOWN = np.array([0, 5, 11, 17])


def measured(change=lambda p, rng, f: p, given=None, known=KNOWN, snr=SNR, modes=slice(MODES)):
    """A measurement in a rigid room whose pressures `change` spoils."""
    rng = np.random.default_rng(4)
    radius, angle = 0.5 * np.sqrt(rng.random(COUNT)), 2 * np.pi * rng.random(COUNT)
    x = np.array([1.7, 1.5]) + np.c_[radius * np.cos(angle), radius * np.sin(angle)]
    frequencies = np.array(room_frequencies(500.0, size=SIZE))[modes]
    k = 2 * np.pi * frequencies / 343 - 0.02j
    p = change(rigid_room(x, SOURCE, k, SIZE), rng, frequencies)
    p = p / np.sqrt(np.mean(np.abs(p) ** 2, axis=1))[:, None]
    p, _ = with_noise(p, snr, rng)
    places = x[known] if given is None else given(x[known])
    return Measurement(frequencies, p, 343.0, positions=x, known=known, known_positions=places, wavenumbers=k)


def test_the_noise_of_few_microphones_in_space_is_not_explained_as_field():
    scene = load_scene("ball3d")
    array, gauge = replace(scene.array, count=16, radius=0.3), replace(scene.gauge, known=(0, 4, 9, 13))
    sensing = replace(scene.measurement, snr_db=60.0)
    measurement = measure(replace(scene, array=array, gauge=gauge, measurement=sensing))
    end, sought = solved(measurement), np.setdiff1d(np.arange(16), measurement.known)
    assert end.assessment.verdict == "good" and end.state.model.directional
    assert rms(end.assessment.positions, measurement.positions, sought) < 0.005
    assert 3e-7 < end.state.model.noise_fraction < 3e-6


@pytest.mark.parametrize(("factor", "sigma", "least"), [(1.006, 0.005, 0.0025), (1.0, 0.003, 0.003)])
def test_given_positions_correct_an_uncertain_sound_speed_and_leave_one_that_is_right(factor, sigma, least):
    right = measured()
    measurement = replace(right, sound_speed=right.sound_speed * factor, wavenumbers=right.wavenumbers / factor)
    exact, found = (solved(measurement, sound_speed_sigma=one).assessment for one in (None, sigma))
    assert abs(found.problem.sound_speed - 343.0) < 3 * found.sound_speed_sigma < 3 * least * 343
    errors = [rms(one.positions, measurement.positions, FREE) for one in (found, exact)]
    assert errors[0] < (min(errors[1], 0.0035) if factor > 1 else 1.3 * errors[1] + 5e-4)
    assert exact.problem.sound_speed == measurement.sound_speed and exact.sound_speed_sigma is None
    assert factor > 1 or np.sum(found.uncertainty**2) > np.sum(exact.uncertainty**2)


def test_without_noise_the_starts_agree_and_one_restart_is_enough():
    quiet = measured()
    p = rigid_room(quiet.positions, SOURCE, quiet.wavenumbers, SIZE)
    measurement = replace(quiet, pressures=p, noise_power=np.zeros(MODES))
    end = solved(measurement)
    assert len(end.state.optima) == 1 and end.assessment.verdict == "good" and not end.faulty
    assert rms(end.assessment.positions, measurement.positions) < 1e-4


def test_an_array_of_three_wavelengths_is_found_with_a_noisy_and_an_inverted_channel():
    rng, frequencies = np.random.default_rng(6), np.linspace(40.0, 320.0, 48)
    x = rng.uniform(0, 3.2, (42, 2))
    p = waves(x, 2 * np.pi * frequencies / 343.0, 40, rng, 1e-4)
    p[:, 7] *= -1
    p[:, 20] = rng.normal(size=(48, 2)) @ [1, 1j] / np.sqrt(2)
    state = solved(Measurement(frequencies, p, 343.0)).state
    healthy = np.arange(42) != 20
    assert rms_of_shape(state.positions[healthy], x[healthy]) < 5e-3 and state.model.channel_noise[20] > 100
    assert abs(state.gains[7, 1]) == pytest.approx(np.pi, abs=0.1)


# The solver finds delays and high-passes of all channels, and is as accurate where there are none.


FREE = np.setdiff1d(np.arange(COUNT), KNOWN)


def filtered(delays: Any = 0.0, corners=None, lowest=0, count=MODES) -> Measurement:
    """A measurement in a rigid room at 50 dB by channels with delays, s, and first-order high-passes, Hz."""

    def change(p, _, f):
        p = p * np.exp(-2j * np.pi * np.outer(f, delays * np.ones(COUNT)))
        return p if corners is None else p / (1 - 1j * corners / f[:, None])

    return measured(change, snr=50.0, modes=slice(lowest, lowest + count))


@pytest.fixture(scope="module")
def matched():
    return solved(filtered())


def test_matched_channels_have_no_filters_and_lose_nothing(matched):
    model, fixed = matched.state.model, solved(filtered(), gains="fixed")
    assert not np.any(model.filters) and model.delay_sigma == model.corner_sigma == 0
    errors = [rms(end.assessment.positions, filtered().positions, FREE) for end in (matched, fixed)]
    assert errors[0] < 1.3 * errors[1] + 5e-4 and errors[1] < 0.004


def test_filters_of_all_channels_come_back_and_the_positions_are_as_exact_as_without(matched):
    """Delays of 0.05 ms (standard deviation) and corners of 20 to 60 Hz."""
    rng = np.random.default_rng(7)
    delays, corners = 5e-5 * rng.standard_normal(COUNT), rng.uniform(20, 60, COUNT)
    end, truth = solved(filtered(delays, corners)), filtered().positions
    assert rms(end.assessment.positions, truth, FREE) < 1.5 * rms(matched.assessment.positions, truth, FREE) + 5e-4
    assert end.assessment.verdict == "good" and not end.faulty
    found, sigma = end.estimate.channels.filters, end.estimate.channels.filter_sigma
    error = found - np.column_stack([343.0 * delays, 2 * np.pi * corners / 343.0])
    # The source contains a common delay, and a common corner frequency is hardly visible.
    error = error - np.median(error, axis=0)
    assert np.all(np.mean(np.abs(error) < 3 * sigma + [2e-4, 0.02], axis=0) > 0.9)


def test_a_narrow_band_does_not_take_a_phase_for_a_delay():
    """Channels differ in phase over less than an octave; however the phases are modelled, the positions stay."""
    plain = filtered(lowest=24, count=16)
    phases = 0.1 * np.random.default_rng(3).standard_normal(COUNT)
    turned = solved(replace(plain, pressures=plain.pressures * np.exp(1j * phases)))
    errors = [rms(end.assessment.positions, plain.positions, FREE) for end in (turned, solved(plain))]
    assert errors[0] < 1.5 * errors[1] + 1e-3


# In a measured room the array is found blind, with errors of millimetres, and the verdict is good.


def test_the_listening_lab_is_found_blind():
    lab = load_scene("listening_lab")  # half of the microphones in two thirds of the width
    array = replace(lab.array, count=32, radius=0.3)
    sensing = replace(lab.measurement, resolution=12.0, highest=820.0)
    inputs = scene_input(replace(lab, array=array, measurement=sensing))
    assert inputs.measurement.blind
    result = solve(inputs)
    errors = inputs.measurement.errors(result.positions)
    assert np.sqrt(np.mean(errors**2)) < 4e-3 and errors.max() < 10e-3, "free gains raise the error by a tenth"
    assert result.uncertainty is not None and np.all(errors < 3 * result.uncertainty)
    assert result.verdict == "good"
    assert "modelled between the microphones" in summary(inputs, result)


# The given positions determine the size of a plane array in a room of three dimensions; the field model does not.


ROOM = Room(size=(4.6, 3.8, 2.7), walls="rigid")
SIDE, PLANE_MODES, PLANE_SNR = 5, 36, 40.0  # number of microphones per side, modes, dB
CORNERS = np.array([0, SIDE - 1, SIDE * (SIDE - 1), SIDE**2 - 1])


@pytest.fixture(scope="module")
def plane():
    """A grid of 1 m by 1 m at a height of 1.2 m, its corners given."""
    axis = np.linspace(-0.5, 0.5, SIDE)
    x = np.array([1.9, 1.6]) + np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    frequencies = np.linspace(60.0, 300.0, PLANE_MODES)
    k = (2 * np.pi * frequencies - 1.5j) / 343.0
    p = point_source_pressures(ROOM, (4.37, 3.55, 2.45), np.column_stack([x, np.full(len(x), 1.2)]), k)
    p = p / np.sqrt(np.mean(np.abs(p) ** 2, axis=1))[:, None]
    p, noise = with_noise(p, PLANE_SNR, np.random.default_rng(0))
    places = {"positions": x, "known": CORNERS}
    return Measurement(frequencies, p, 343.0, 3, 2, wavenumbers=k, noise_power=noise, **places)


def test_the_size_of_a_plane_array_is_that_of_the_given_corners(plane):
    """It does not follow from the assumed field: here the given corners are 2 % too far apart."""
    middle = plane.positions.mean(axis=0)
    larger = middle + 1.02 * (plane.positions - middle)
    end = solved(replace(plane, known_positions=larger[CORNERS]))
    np.testing.assert_allclose(end.state.positions[CORNERS], larger[CORNERS], atol=3e-3)
    assert rms(end.state.positions, larger) < 0.01
    assert end.assessment.verdict == "good"


def test_four_takes_in_a_living_room_are_found_within_their_uncertainty():
    """The room, by image sources with equal walls and 0.4 s, has little noise and few waves at each frequency."""
    room, rng = (5.0, 4.0, 2.6), np.random.default_rng([1, 285, 24, 400])
    places = draw_array(rng, 24, 0.4) + np.array(room) * (0.44, 0.47, 0.5)
    frequencies, takes = np.linspace(25.0, 400.0, 24), []
    for source in [draw_source(rng, room, places.mean(axis=0)) for _ in range(4)]:
        h = responses(places, source, 0.4, 24, room)
        p = np.exp(-2j * np.pi * np.outer(frequencies, np.arange(h.shape[1])) / RATE) @ h.T
        p, noise = with_noise(p, 50.0, rng)
        takes.append(Measurement(frequencies, p, SPEED, dimension=3, noise_power=noise))
    found = calibrate(Measurement.from_takes(takes), known="none")
    error = rms_of_shape(found.positions, places)
    assert found.verdict == "good" and error < 6e-3
    assert error < 1.5 * np.sqrt(np.mean(found.uncertainty**2))
