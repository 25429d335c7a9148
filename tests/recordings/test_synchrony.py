"""Clocks of channels, from a stationary recording alone."""

import numpy as np
import pytest
from scipy.signal import oaconvolve, resample_poly

from fdcal.recordings.recording import recording_of
from fdcal.recordings.synchrony import channel_delays

N, RATE, T = 5, 4000, 48_000
BAD = 3
NAMES = tuple(str(n) for n in range(N))


@pytest.fixture(scope="module")
def sound() -> np.ndarray:
    """Noise through other random reverberation for each channel, and noise of their own 20 dB below (N, T)."""
    rng, decay = np.random.default_rng(5), np.exp(-np.arange(800) / 150)
    played = rng.standard_normal(T)
    heard = np.array([oaconvolve(played, decay * rng.standard_normal(800))[:T] for _ in range(N)])
    return heard + 0.1 * heard.std() * rng.standard_normal((N, T))


def faults(samples: np.ndarray) -> dict[str, str]:
    found = channel_delays(recording_of("take", "stationary", RATE, samples))
    assert found is not None
    return found.faults(NAMES)


def changed(sound: np.ndarray, channel: int, row: np.ndarray) -> np.ndarray:
    out = sound.copy()
    out[channel] = row
    return out


def test_channels_of_one_clock_have_no_fault(sound):
    assert faults(sound) == {}


@pytest.mark.parametrize("channel", range(N))
def test_lost_samples_are_named_whatever_the_channel(sound, channel):
    lost, at = 12, 20_000
    row = np.concatenate([sound[channel, :at], sound[channel, at + lost :], np.zeros(lost)])
    found = faults(changed(sound, channel, row))
    assert list(found) == [str(channel)]
    assert found[str(channel)].startswith(f"jumps by {-1e3 * lost / RATE:+.3g} ms at about")
    assert float(found[str(channel)].split()[-2]) == pytest.approx(at / RATE, abs=2)


@pytest.mark.parametrize("ppm", [-60.0, 25.0])
def test_a_clock_of_another_speed_is_a_drift(sound, ppm):
    fine = resample_poly(sound[BAD], 16, 1)
    row = np.interp(16 * np.arange(T) * (1 - 1e-6 * ppm), np.arange(len(fine)), fine)
    (words,) = faults(changed(sound, BAD, row)).values()
    assert words.startswith("drifts by") and float(words.split()[2]) == pytest.approx(ppm, abs=2)


def test_a_channel_that_stops_sharing_the_clock_is_named(sound):
    row = np.concatenate([sound[BAD, :24_000], np.random.default_rng(1).standard_normal(24_000)])
    (words,) = faults(changed(sound, BAD, row)).values()
    assert words.startswith("shares no clock")


def test_a_short_recording_says_nothing(sound):
    assert channel_delays(recording_of("take", "stationary", RATE, sound[:, :20_000])) is None
