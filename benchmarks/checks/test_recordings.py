"""Recordings of a simulated room from file to positions: parts of a recording, and the error that is claimed."""

from pathlib import Path

import numpy as np
import recorded
import soundfile
from recorded import FS, SPEED, noisy, places, write_places
from scipy.signal import chirp, fftconvolve

import fdcal
from fdcal.model.gauge import align
from fdcal.recordings.importer import import_recording, import_summary
from fdcal.recordings.recording import ImportOptions
from fdcal.session.calibration_run import solve
from fdcal.session.sources import measurement_input

COUNT = 16
SOURCES = ((4.3, 3.4, 0.8), (0.6, 3.2, 2.3), (4.4, 0.5, 2.5))  # m
FEW = 40  # rows of a calibration: the time grows with their number, and the laws hold for any number


def responses(source: int) -> np.ndarray:
    """Impulse responses (COUNT, 2400) of one place of the source."""
    return recorded.responses(COUNT, SOURCES[source])


def playing(source: int, seconds: float, seed: int) -> np.ndarray:
    """What the array records of noise (COUNT, T) of unit power."""
    signal = np.random.default_rng(seed).standard_normal(int(seconds * FS) + 2399)
    heard = np.array([fftconvolve(signal, h, mode="valid") for h in responses(source)])
    return heard / np.sqrt(np.mean(heard**2))


def write(path: Path, samples: np.ndarray, rate: int = FS) -> Path:
    soundfile.write(path, 0.9 * np.atleast_2d(samples).T / np.abs(samples).max(), rate, subtype="FLOAT")
    return path


def rms(positions: np.ndarray) -> float:
    truth = places(COUNT)
    return float(np.sqrt(np.mean(np.sum((align(positions, truth) - truth) ** 2, axis=1))))


def test_a_source_that_is_carried_round_gives_smaller_errors_if_the_recording_is_split(tmp_path):
    samples = np.concatenate([playing(s, 12, s) for s in range(3)], axis=1)
    carried = write(tmp_path / "carried.wav", noisy(samples, 40))
    parts, report = import_recording(carried, ImportOptions(sound_speed=SPEED, split=12.0, max_rows=FEW))
    assert parts.take_count == 3
    assert "24 to 36 s" in import_summary(parts, report)
    whole = fdcal.load(carried, sound_speed=SPEED, max_rows=FEW)
    errors = [rms(fdcal.calibrate(one, known="none", solver="joint").positions) for one in (parts, whole)]
    assert errors[0] < errors[1]


def test_the_uncertainty_of_few_microphones_in_a_room_is_not_too_small(tmp_path):
    """The verdict doubts the known positions here, which is a false alarm and not a wrong claim."""
    t = np.arange(5 * FS) / FS
    sweep = chirp(t, 20, 5, 500, method="logarithmic") * np.minimum(1, 20 * np.minimum(t, 5 - t))
    played = np.concatenate([sweep, np.zeros(FS)])
    samples = noisy(np.array([fftconvolve(played, h)[: len(played)] for h in recorded.responses()]), 30)
    known = str(write_places(tmp_path / "known.csv", places()[:5]))
    options = ImportOptions(known=known, sound_speed=SPEED, max_rows=80)
    measurement, _ = import_recording(write(tmp_path / "a.wav", samples), options)
    result = solve(measurement_input(measurement, "a"))
    error = np.sqrt(np.mean(np.sum((result.positions - places()) ** 2, axis=1)))
    assert error < 1.8 * np.sqrt(np.mean(np.square(result.uncertainty)))
