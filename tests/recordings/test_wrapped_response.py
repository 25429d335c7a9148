"""A response that wraps round, as after a circular deconvolution, is recognised and reported."""

from __future__ import annotations

import numpy as np
import pytest
from recorded import FS, noisy, responses

from fdcal.model.validation import InputError
from fdcal.recordings.import_options import ImportOptions
from fdcal.recordings.importer import import_recording


@pytest.fixture
def taken(tmp_path):
    """Function that imports samples (N, T) as impulse responses."""

    def take(samples: np.ndarray, kind: str = "impulse"):
        np.savez(tmp_path / "room.npz", recordings=samples, sample_rate=FS, kind=kind, sound_speed=343.0)
        return import_recording(tmp_path / "room.npz", ImportOptions(array_radius=0.5))

    return take


@pytest.mark.parametrize("seconds", [0.02, 0.05])
def test_a_response_that_begins_at_its_end_is_refused(seconds, taken):
    silence = np.pad(responses(8), ((0, 0), (0, 2400)))
    with pytest.raises(InputError, match=r"wraps round.*numpy\.roll"):
        taken(noisy(np.roll(silence, -int(seconds * FS), axis=1), 60.0))


def test_an_echo_of_the_sweep_before_the_end_is_refused(taken):
    samples = np.pad(responses(8), ((0, 0), (0, 2400)))
    samples[:, -200:] += 0.05 * samples[:, :200]
    with pytest.raises(InputError, match=r"rises again by \d+ dB"):
        taken(noisy(samples, 60.0))


@pytest.mark.parametrize("snr_db", [10.0, 30.0, 90.0])
@pytest.mark.parametrize("silence", [0, 1000, 4000])
def test_a_response_in_noise_is_accepted(snr_db, silence, taken):
    samples = np.pad(responses(8), ((0, 0), (0, silence)))
    assert taken(noisy(samples, snr_db))[0].count == 8


def test_a_response_that_begins_late_is_accepted(taken):
    samples = np.pad(responses(8), ((0, 0), (800, 1600)))
    assert taken(noisy(samples, 60.0))[0].count == 8
