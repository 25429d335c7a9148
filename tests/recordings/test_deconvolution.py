"""The noise stated for a deconvolved response is the noise that is in it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import chirp, fftconvolve

from fdcal.recordings import impulse_response
from fdcal.recordings.impulse_response import deconvolve
from fdcal.recordings.recording import read_samples, recording_of

FS, BAND, COUNT = 1000, (30.0, 300.0), 24  # Hz, Hz, channels


@pytest.mark.parametrize(
    ("recorded_s", "played_s", "response_s"),
    [(6, 3, 2.25), (6, 5.5, 2.25), (8, 3, 4.5), (12, 5.5, 0.75), (12, 11, 2.25), (30, 3, 0.75), (30, 12, 4.5)],
)
def test_the_noise_is_that_in_the_response_whatever_the_lengths(recorded_s, played_s, response_s, monkeypatch):
    """White noise of known power added to the recording of a sweep, of a flat spectrum S in the band."""
    monkeypatch.setattr(impulse_response, "DECONVOLUTION", replace(impulse_response.DECONVOLUTION, length=response_s))
    rng, t = np.random.default_rng(0), np.arange(int(played_s * FS)) / FS
    played, power = chirp(t, 15, played_s, 450), 0.3
    room = rng.standard_normal((COUNT, 100)) * np.exp(-np.arange(100) / 10)
    clean = np.array([np.pad(fftconvolve(played, h), (0, recorded_s * FS))[: recorded_s * FS] for h in room])
    noise = np.sqrt(power) * rng.standard_normal(clean.shape)

    def deconvolved(samples):
        made, density = deconvolve(
            recording_of("recording", None, FS, samples), recording_of("sweep", None, FS, played[None]), BAND
        )
        return read_samples(made, 0, made.samples), density

    (with_noise, density), (without, _) = deconvolved(clean + noise), deconvolved(clean)
    assert with_noise.shape == (COUNT, response_s * FS)
    spectrum = np.abs(np.fft.rfft(with_noise - without)) ** 2 / with_noise.shape[1]
    f = np.fft.rfftfreq(with_noise.shape[1], 1 / FS)
    inside = (f > 40) & (f < 280)
    assert np.mean(density(f[inside])) == pytest.approx(np.mean(spectrum[:, inside]), rel=0.07)
    f = np.linspace(40, 280, 1000)
    S = np.exp(-2j * np.pi * np.outer(f, t)) @ played
    assert np.mean(density(f) * np.abs(S) ** 2) == pytest.approx(power, rel=0.1)


def test_a_recording_hardly_longer_than_the_response_does_not_tell_the_noise():
    rng = np.random.default_rng(0)
    samples, played = rng.standard_normal((3, int(2.8 * FS))), rng.standard_normal((1, FS))
    made, density = deconvolve(recording_of("a", None, FS, samples), recording_of("b", None, FS, played), BAND)
    assert density is None and made.count == 3
