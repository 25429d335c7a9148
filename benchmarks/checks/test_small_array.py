"""A cube of 14 cm, from WAV to positions: its frequencies reach as far as so small an array can interpolate."""

import dataclasses

import numpy as np
import pytest
import soundfile

import fdcal
from fdcal.acoustics.dictionary import array_f_max
from fdcal.recordings.importer import import_recording
from fdcal.recordings.recording import ImportOptions

FS, SPEED, SECONDS, SIDE = 12000, 343.0, 0.4, 0.14
ROOM, SOURCE, CENTRE = np.array([4.6, 3.8, 2.7]), np.array([3.9, 3.1, 2.1]), np.array([1.6, 1.5, 1.2])
REFLECTION, ORDER = 0.75, 2


def images() -> tuple[np.ndarray, np.ndarray]:
    """Places (I, 3) and amplitudes (I,) of the images of the source in a room whose walls reflect alike."""
    n = np.stack(np.meshgrid(*[np.arange(-ORDER, ORDER + 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
    signs = np.stack(np.meshgrid(*[[1, -1]] * 3, indexing="ij"), -1).reshape(-1, 3)
    places = (2 * n[:, None] * ROOM + signs * SOURCE).reshape(-1, 3)
    bounces = np.where(signs > 0, 2 * np.abs(n[:, None]), np.abs(n[:, None] - 1) + np.abs(n[:, None]))
    return places, REFLECTION ** bounces.sum(axis=-1).ravel()


def responses(points: np.ndarray) -> np.ndarray:
    """Impulse responses (N, T) of the room, band-limited to 60 to 5000 Hz by slopes so gentle that they hardly ring."""
    places, amplitudes = images()
    samples = int(FS * SECONDS)
    f = np.fft.rfftfreq(samples, 1 / FS)
    band = np.sin(np.pi / 2 * np.clip((f - 5) / 80, 0, 1) * np.clip((0.48 * FS - f) / 600, 0, 1)) ** 2
    d = np.linalg.norm(points[:, None] - places, axis=2)
    p = np.empty((len(points), len(f)), complex)
    for row, one in zip(p, d, strict=True):
        phase = np.exp(-2j * np.pi * f[1] * one / SPEED) * np.ones((len(f), 1))
        phase[0] = 1.0
        row[:] = np.cumprod(phase, axis=0) @ (amplitudes / one)  # exp(-2 pi j f d / c), f in equal steps
    return np.roll(np.fft.irfft(p * band, samples, axis=1), int(0.1 * FS), axis=1)


@pytest.fixture(scope="module")
def cube(tmp_path_factory):
    """Path of a WAV file, and the true positions, metres."""
    rng, path = np.random.default_rng(1), tmp_path_factory.mktemp("cube") / "cube.wav"
    points = CENTRE + rng.uniform(-SIDE / 2, SIDE / 2, (64, 3))
    samples = responses(points)
    samples = np.pad(samples, ((0, 0), (0, FS // 20)))
    noise = 1e-5 * np.sqrt(np.mean(samples**2)) * rng.normal(size=samples.shape)
    soundfile.write(path, (0.9 * (samples + noise) / np.abs(samples).max()).T, FS, subtype="FLOAT")
    return path, points


@pytest.fixture(scope="module")
def imported(cube):
    return import_recording(cube[0], ImportOptions(sound_speed=SPEED))


def test_the_band_and_the_number_of_frequencies_follow_from_the_array(cube, imported):
    path, points = cube
    limit = array_f_max(points, SPEED, 3)
    measurement, report = imported
    assert limit / 1.5 < measurement.frequencies[-1] <= report.highest_frequency < 1.5 * limit
    assert len(measurement.frequencies) > 80
    radius = float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())
    assert 0.08 < 2 * np.pi * measurement.frequencies[0] * radius / SPEED < 0.2
    stated, _ = import_recording(path, ImportOptions(sound_speed=SPEED, array_radius=radius, max_rows=30))
    assert 0.9 * limit < stated.frequencies[-1] <= limit and len(stated.frequencies) <= 30


def test_the_cube_is_found_to_a_fifth_of_a_millimetre(cube, imported):
    found = fdcal.calibrate(dataclasses.replace(imported[0], positions=cube[1]))
    assert found.mean_error < 0.2e-3
