"""Short windows of a recording: which are used, and how a measurement stores them."""

import io
from dataclasses import replace

import numpy as np
import pytest
from running import refuses
from scipy import signal

from fdcal.model.measurement import Measurement, load_measurement, save_measurement
from fdcal.model.problem import ShortWindows
from fdcal.recordings.recording import ImportOptions, recording_of
from fdcal.recordings.short_windows import SKIP, WINDOW, short_windows

RATE = 8000


def noise(count: int = 6, seconds: float = 3.0, seed: int = 0) -> np.ndarray:
    """Return white noise of which a part is the same in all channels."""
    samples = np.random.default_rng(seed).standard_normal((count + 1, int(seconds * RATE)))
    return samples[1:] + samples[0]


def windows_of(samples: np.ndarray, kind: str = "stationary", takes: int = 1, number: int = 0, **options):
    return short_windows(recording_of("x", kind, RATE, samples), kind, ImportOptions(**options), takes, number)


def test_each_take_has_frequencies_of_its_own_within_the_band():
    parts = [windows_of(noise(), takes=3, number=number, windows="200:3000") for number in range(3)]
    f = np.concatenate([one.frequencies for one in parts])
    assert f.min() >= 200 and f.max() <= 3000 and len(np.unique(f)) == len(f)
    assert all(np.all(np.any(one.pressures, axis=(0, 1))) for one in parts)


def test_a_window_in_a_gap_does_not_count():
    samples = noise()
    samples[:, RATE : 2 * RATE] *= 1e-4
    counts = np.any(windows_of(samples).pressures, axis=2).mean(axis=0)  # of each window, over frequencies
    middle = np.arange(len(counts)) / len(counts)
    assert np.all(counts[(middle > 0.36) & (middle < 0.64)] == 0) and np.all(counts[middle < 0.3] > 0.9)


def test_windows_leave_out_the_direct_sound_and_the_noise_of_an_impulse_response():
    rng, onset, decay = np.random.default_rng(1), 0.1, 0.05
    t = np.arange(2 * RATE) / RATE
    tail = np.where(t > onset, np.exp(-(t - onset) / decay), 0.0) * rng.standard_normal((6, len(t)))
    tail[:, int(onset * RATE)] = 100.0
    direct = 1e-3 * rng.standard_normal(tail.shape) + tail
    found = windows_of(direct, "impulse")
    # With the direct sound in it, a window would be the same in all channels.
    p = found.pressures[:, 0]
    assert np.abs(np.mean(p[:, 0] * np.conj(p[:, 1]))) / np.mean(np.abs(p) ** 2) < 0.5
    last = onset + SKIP + found.pressures.shape[1] * WINDOW / 2 + WINDOW
    assert last < onset + 10 * decay  # and not the two seconds of the recording


@pytest.mark.parametrize(
    ("count", "seconds", "rate", "options"),
    [
        (6, 0.5, RATE, {"windows": "none"}),
        (6, 0.5, RATE, {"dimension": 2}),
        (65, 0.5, RATE, {}),
        (33, 0.5, RATE, {"array_dimension": 3}),
        (6, 0.02, RATE, {}),
    ]
    + [(6, 4.0, rate, {}) for rate in (150, 210, 400)],
)
def test_a_plate_many_channels_or_a_short_or_low_recording_have_no_windows(count, seconds, rate, options):
    recording = recording_of("x", "stationary", rate, noise(count, seconds)[:, : int(seconds * rate)])
    assert short_windows(recording, "stationary", ImportOptions(**options)) is None


@pytest.mark.parametrize("text", ["high", "100", "3000:200", "100:9000", "0:500"])
def test_an_invalid_band_is_refused_with_the_option(text):
    assert refuses("", lambda: windows_of(noise(seconds=0.5), windows=text)).key == "windows"


def measurement(seed: int, windows: ShortWindows | None) -> Measurement:
    rng = np.random.default_rng(seed)
    pressures = rng.standard_normal((8, 6)) + 1j * rng.standard_normal((8, 6))
    return Measurement(np.arange(100.0, 180, 10), pressures, 343.0, 3, windows=windows)


@pytest.fixture
def measured() -> Measurement:
    return measurement(2, windows_of(noise(seconds=0.3)))


def test_a_file_keeps_windows_and_leaves_out_those_of_a_microphone(measured):
    file = io.BytesIO()
    save_measurement(measured, file)
    same, fewer = (load_measurement(io.BytesIO(file.getvalue()), excluded) for excluded in ((), ("2",)))
    for name in ("frequencies", "takes", "pressures", "length"):
        assert np.array_equal(getattr(same.windows, name), getattr(measured.windows, name))
    assert np.array_equal(fewer.windows.pressures, measured.windows.pressures[..., [0, 1, 3, 4, 5]])


def test_takes_are_joined_and_separated_with_their_windows(measured):
    other = measurement(3, windows_of(noise(seconds=0.2, seed=3)))
    both = Measurement.from_takes([measured, measurement(4, None), other])
    assert set(both.windows.takes.tolist()) == {0, 2}
    third = both.of_take(2).windows
    kept = np.any(third.pressures, axis=(0, 2))
    assert np.array_equal(third.pressures[:, kept], other.windows.pressures[:, np.any(other.windows.pressures, (0, 2))])
    assert both.of_take(1).windows is None


@pytest.mark.parametrize(
    ("name", "value"),
    [("frequencies", np.full(3, -1.0)), ("takes", np.full(3, -1)), ("pressures", np.zeros((2, 4, 6), complex))],
)
def test_windows_of_impossible_values_are_refused(name, value):
    possible = {"frequencies": np.full(3, 100.0), "takes": np.zeros(3, int), "pressures": np.ones((3, 4, 6), complex)}
    refuses("", ShortWindows, **possible | {name: value}, length=WINDOW)


def test_a_measurement_refuses_windows_of_another_number_of_microphones(measured):
    refuses("microphones", lambda: replace(measured, windows=measured.windows.of_microphones(np.arange(4))))


def test_many_channels_have_windows_at_fewer_frequencies_unless_they_are_sought_in_space():
    samples = noise(64, 2.0)
    recording = recording_of("x", "stationary", RATE, samples)
    few = windows_of(samples[:8])
    assert short_windows(recording, "stationary", ImportOptions(array_dimension=3)) is None
    many = short_windows(recording, "stationary", ImportOptions())
    assert many is not None and len(many.frequencies) < len(few.frequencies)
    assert np.array_equal(windows_of(2.0**31 * samples[:8]).pressures, few.pressures), "whole numbers of 32 bits"


@pytest.mark.parametrize("beyond", ["noise", "images"])
def test_windows_end_where_the_band_of_the_sound_ends(beyond):
    """The windows of 64 microphones went up to 4 kHz although their recording had been made with 4 kHz sampling."""
    rng, sound = np.random.default_rng(0), signal.butter(12, 1000, fs=RATE, output="sos")
    samples = signal.sosfiltfilt(sound, noise(seconds=6.0))
    if beyond == "noise":  # without coherence, 30 dB below the sound
        samples += 0.03 * samples.std() * rng.standard_normal(samples.shape)
    else:  # the mirrored spectrum of a coarse change of the sampling rate, 60 dB below the sound
        samples += 1e-3 * samples * np.cos(np.pi * np.arange(samples.shape[1]))
    for options in ({}, {"array_dimension": 3}):
        f = windows_of(samples, **options).frequencies
        assert 900 < f.max() < 1300 and len(f) > 15, "the frequencies lie closer together then"
    assert windows_of(samples, windows="100:3000").frequencies.max() > 2900, "a given band is used as it is"


def test_near_the_end_of_the_band_a_window_holds_sound_of_other_frequencies_and_is_not_used():
    low = signal.sosfiltfilt(signal.butter(20, 900, fs=RATE, output="sos"), noise(seconds=10.0))
    assert 800 < windows_of(low).frequencies.max() < 900
