"""A deconvolved response states the noise that is in it; one that wraps round is recognised."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import FS, noisy, responses
from scipy.signal import chirp, fftconvolve

from fdcal.model.validation import InputError
from fdcal.recordings import impulse_response
from fdcal.recordings.importer import import_recording
from fdcal.recordings.impulse_response import deconvolve
from fdcal.recordings.recording import ImportOptions, read_samples, recording_of

RATE, BAND, COUNT = 1000, (30.0, 300.0), 24  # Hz, Hz, channels


@pytest.mark.parametrize(
    ("recorded_s", "played_s", "response_s"), [(6, 5.5, 2.25), (8, 3, 4.5), (12, 5.5, 0.75), (12, 11, 2.25)]
)
def test_the_noise_is_that_in_the_response_whatever_the_lengths(recorded_s, played_s, response_s, monkeypatch):
    """White noise of known power added to the recording of a sweep, of a flat spectrum S in the band."""
    monkeypatch.setattr(impulse_response, "DECONVOLUTION", replace(impulse_response.DECONVOLUTION, length=response_s))
    rng, t = np.random.default_rng(0), np.arange(int(played_s * RATE)) / RATE
    played, power = chirp(t, 15, played_s, 450), 0.3
    room = rng.standard_normal((COUNT, 100)) * np.exp(-np.arange(100) / 10)
    clean = np.array([np.pad(fftconvolve(played, h), (0, recorded_s * RATE))[: recorded_s * RATE] for h in room])
    noise = np.sqrt(power) * rng.standard_normal(clean.shape)

    def deconvolved(samples):
        made, density = deconvolve(
            recording_of("recording", None, RATE, samples), recording_of("sweep", None, RATE, played[None]), BAND
        )
        return read_samples(made, 0, made.samples), density

    (with_noise, density), (without, _) = deconvolved(clean + noise), deconvolved(clean)
    assert with_noise.shape == (COUNT, response_s * RATE)
    spectrum = np.abs(np.fft.rfft(with_noise - without)) ** 2 / with_noise.shape[1]
    f = np.fft.rfftfreq(with_noise.shape[1], 1 / RATE)
    inside = (f > 40) & (f < 280)
    assert np.mean(density(f[inside])) == pytest.approx(np.mean(spectrum[:, inside]), rel=0.07)
    f = np.linspace(40, 280, 1000)
    S = np.exp(-2j * np.pi * np.outer(f, t)) @ played
    assert np.mean(density(f) * np.abs(S) ** 2) == pytest.approx(power, rel=0.1)


def test_a_recording_hardly_longer_than_the_response_does_not_tell_the_noise():
    rng = np.random.default_rng(0)
    samples, played = rng.standard_normal((3, int(2.8 * RATE))), rng.standard_normal((1, RATE))
    made, density = deconvolve(recording_of("a", None, RATE, samples), recording_of("b", None, RATE, played), BAND)
    assert density is None and made.count == 3


@pytest.fixture
def taken(tmp_path):
    """Function that imports samples (N, T) as impulse responses."""

    def take(samples: np.ndarray, kind: str = "impulse"):
        np.savez(tmp_path / "room.npz", recordings=samples, sample_rate=FS, kind=kind, sound_speed=343.0)
        return import_recording(tmp_path / "room.npz", ImportOptions(array_radius=0.5))

    return take


def test_a_response_that_begins_at_its_end_and_an_echo_of_the_sweep_before_the_end_are_refused(taken):
    samples = np.pad(responses(8), ((0, 0), (0, 2400)))
    for seconds in (0.02, 0.05):
        with pytest.raises(InputError, match=r"wraps round.*numpy\.roll"):
            taken(noisy(np.roll(samples, -int(seconds * FS), axis=1), 60.0))
    samples[:, -200:] += 0.05 * samples[:, :200]
    with pytest.raises(InputError, match=r"rises again by \d+ dB"):
        taken(noisy(samples, 60.0))


def test_a_response_in_noise_or_one_that_begins_late_is_accepted(taken):
    for snr_db in (10.0, 30.0, 60.0, 90.0):
        for silence in ((0, 0), (0, 1000), (0, 4000), (800, 1600)):
            samples = noisy(np.pad(responses(8), ((0, 0), silence)), snr_db)
            impulse_response.require_quiet_end(recording_of("room", "impulse", FS, samples), (20.0, 400.0))
    assert taken(samples)[0].count == 8
