"""Clocks of channels, from a stationary recording alone."""

import numpy as np
import pytest
from scipy.signal import oaconvolve, resample_poly

from fdcal.assessment.words import clock_words
from fdcal.recordings.recording import Recording, recording_of
from fdcal.recordings.synchrony import ChannelDelays, channel_delays

N, RATE, T = 5, 4000, 48_000
BAD = 3
NAMES = tuple(str(n) for n in range(N))


@pytest.fixture(scope="module")
def sound() -> np.ndarray:
    """Return noise with different random reverberation in each channel, and independent noise 20 dB below (N, T)."""
    rng, decay = np.random.default_rng(5), np.exp(-np.arange(800) / 150)
    played = rng.standard_normal(T)
    heard = np.array([oaconvolve(played, decay * rng.standard_normal(800))[:T] for _ in range(N)])
    return heard + 0.1 * heard.std() * rng.standard_normal((N, T))


def delays_of(samples: np.ndarray) -> ChannelDelays:
    found = channel_delays(recording_of("take", "stationary", RATE, samples))
    assert found is not None
    return found


def faults(samples: np.ndarray) -> dict[str, str]:
    return in_words(delays_of(samples))


def in_words(found: ChannelDelays) -> dict[str, str]:
    """Return the faults in words."""
    return {name: clock_words(*fault) for name, fault in found.faults(NAMES).items()}


def noise_like(row: np.ndarray) -> np.ndarray:
    """Noise (T,) as loud as a channel, so that the same channel is chosen as the reference."""
    return row.std() * np.random.default_rng(1).standard_normal(len(row))


def drifting(row: np.ndarray, ppm: float) -> np.ndarray:
    """Return a channel (T,) with a slower clock, whose delay grows."""
    fine = resample_poly(row, 16, 1)
    return np.interp(16 * np.arange(len(row)) * (1 - 1e-6 * ppm), np.arange(len(fine)), fine)


@pytest.mark.parametrize("channel", range(N))
def test_the_fault_of_a_channel_is_named_whatever_the_channel(sound, channel):
    def changed(row):
        return np.where((np.arange(N) == channel)[:, None], row, sound)

    lost, at, own = 12, 20_000, sound[channel]
    ((name, words),) = faults(changed(np.concatenate([own[:at], own[at + lost :], np.zeros(lost)]))).items()
    assert name == str(channel) and words.startswith(f"jumps by {-1e3 * lost / RATE:+.3g} ms at about")
    assert float(words.split()[-2]) == pytest.approx(at / RATE, abs=2)
    for ppm in (-60.0, 25.0):
        ((name, words),) = faults(changed(drifting(own, ppm))).items()
        assert name == str(channel) and words.startswith("drifts by")
        assert float(words.split()[2]) == pytest.approx(ppm, abs=2)
    for kept in (int(0.3 * T), int(0.8 * T)):
        ((name, words),) = faults(changed(np.concatenate([own[:kept], noise_like(own)[kept:]]))).items()
        assert name == str(channel) and words.startswith("has another clock")
    # If the channel is silent or contains only noise, its delay is unknown; the other channels are healthy.
    for loudness in (0, 1):
        found = delays_of(changed(loudness * noise_like(own)))
        assert found.faults(NAMES) == {} and found.unknown(NAMES) == [str(channel)]


def test_channels_of_one_clock_have_no_fault_and_independent_noise_or_little_sound_is_unknown(sound):
    assert faults(sound) == {}
    found = delays_of(np.random.default_rng(3).standard_normal((N, T)))
    assert np.isnan(found.delays[:, 1:]).all() and found.faults(NAMES) == {} and found.unknown(NAMES) == list(NAMES)
    assert channel_delays(recording_of("take", "stationary", RATE, sound[:, :20_000])) is None


def test_sound_that_fills_a_small_part_of_the_band_has_no_fault(sound):
    fine = resample_poly(sound, 12, 1, axis=1)
    fine += 0.02 * fine.std() * np.random.default_rng(6).standard_normal(fine.shape)
    found = channel_delays(recording_of("take", "stationary", 12 * RATE, fine))
    assert found is not None and found.faults(NAMES) == {} and found.unknown(NAMES) == []


def test_a_drift_shows_in_ten_minutes_as_in_twelve_seconds(sound):
    """The sound repeats, so that a drifting channel can be computed at any time while its clock drifts on."""
    fine = resample_poly(np.tile(sound[BAD], 3), 16, 1)[16 * T : 1 - 16 * T]

    def block(start, stop, channels):
        n = np.arange(start, stop)
        rows = sound[:, n % T]
        rows[BAD] = np.interp(16 * n * (1 - 80e-6) % (16 * T), np.arange(len(fine)), fine)
        return rows[channels]

    found = channel_delays(Recording("take", "stationary", RATE, N, 50 * T, block))
    assert found is not None
    ((name, words),) = in_words(found).items()
    assert name == str(BAD) and words.startswith("drifts by")
    assert float(words.split()[2]) == pytest.approx(80, rel=0.02)
