"""Arrivals of the direct sound in impulse responses whose paths are known."""

from dataclasses import replace

import numpy as np
import pytest
import soundfile
from running import refuses

import fdcal
from fdcal.model.measurement import Measurement, load_measurement, save_measurement
from fdcal.recordings.arrivals import first_arrivals

RATE, SPEED = 8000.0, 343.0
SOURCE = np.array([2.4, 1.1, 0.3])  # m


def places(count=16):
    return 0.3 * np.random.default_rng(0).uniform(-1, 1, (count, 3))


def responses(source=SOURCE, reflections=40, noise=1e-3, seed=1, length=4000):
    """Return impulse responses (N, T): direct sound, decaying images at least 1 m farther away, and sensor noise."""
    x, rng = places(), np.random.default_rng(seed)
    far, images = np.linalg.norm(source), rng.normal(size=(reflections, 3))
    images *= (far + rng.uniform(1.0, 40.0, reflections) / np.linalg.norm(images, axis=1))[:, None]
    images *= np.maximum(1, (far + 1.0) / np.linalg.norm(images, axis=1))[:, None]
    t, h = np.arange(length) / RATE, np.zeros((len(x), length))
    for place, sign in [(source, 1.0), *zip(images, rng.choice([-0.7, 0.7], reflections), strict=True)]:
        path = np.linalg.norm(x - place, axis=1)[:, None]
        u = RATE * (t - path / SPEED - 5e-3)
        h += (
            sign * np.exp(-(path - far) / 10) / path * np.sinc(u) * (0.5 + 0.5 * np.cos(np.pi * np.clip(u / 40, -1, 1)))
        )
    return h + noise * np.abs(h).max() * rng.standard_normal(h.shape)


def errors(times, source=SOURCE):
    """Deviations (N,), metres, from the true arrivals, about their median."""
    e = SPEED * times - np.linalg.norm(places() - source, axis=1)
    return e - np.nanmedian(e)


def test_arrivals_are_right_to_a_fiftieth_of_a_sample():
    found = first_arrivals(responses(), RATE)
    assert found is not None
    times, sigma = found
    assert np.isfinite(times).all() and np.nanmin(times) == 0
    assert np.sqrt(np.mean(errors(times) ** 2)) < 1e-3 and 0.2e-3 < SPEED * sigma < 2e-3


def test_an_inverted_and_weak_channel_has_the_right_arrival_and_one_without_direct_sound_has_none():
    h = responses()
    h[3] *= -0.1
    times, _ = first_arrivals(h, RATE)
    assert np.abs(errors(times)).max() < 2e-3
    h = responses()
    h[5] = 0.3 * np.random.default_rng(2).standard_normal(h.shape[1]) * np.abs(h).max()
    times, _ = first_arrivals(h, RATE)
    assert np.isnan(times[5]) and np.sum(np.isfinite(times)) >= 14
    noise = np.random.default_rng(3).standard_normal((16, 4000))
    for diffuse in (noise, noise * np.exp(-np.arange(4000) / 800)):
        assert first_arrivals(diffuse, RATE) is None


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    path, h = tmp_path_factory.mktemp("responses") / "one.wav", responses()
    soundfile.write(path, (0.5 * h / np.abs(h).max()).T, int(RATE), subtype="FLOAT")
    return fdcal.load(path, kind="impulse", sound_speed=SPEED)


def test_an_import_of_impulse_responses_has_arrivals(imported):
    assert imported.arrivals.shape == (1, 16) and imported.arrival_sigma.shape == (1,)
    assert np.abs(errors(imported.arrivals[0])).max() < 2e-3
    assert imported.problem().arrivals is imported.arrivals


def test_arrivals_of_takes_are_stacked_and_selected(imported):
    others = [replace(imported, pressures=np.roll(imported.pressures, n, axis=1)) for n in (1, 2)]
    plain, other = (replace(one, arrivals=None, arrival_sigma=None) for one in others)
    three = Measurement.from_takes([imported, plain, others[1]])
    assert three.arrivals.shape == (3, 16) and np.isnan(three.arrivals[1]).all()
    assert np.array_equal(three.arrivals[2], imported.arrivals[0])
    third = three.of_take(2)
    assert np.array_equal(third.arrivals[2], imported.arrivals[0]) and np.isnan(third.arrivals[:2]).all()
    assert Measurement.from_takes([plain, other]).arrivals is None


def test_a_file_keeps_arrivals_also_without_some_microphones(imported, tmp_path):
    times = np.array(imported.arrivals)
    times[0, 2] = np.nan
    save_measurement(replace(imported, arrivals=times), tmp_path / "one.npz")
    read = load_measurement(tmp_path / "one.npz")
    assert np.array_equal(read.arrivals, times, equal_nan=True)
    assert np.array_equal(read.arrival_sigma, imported.arrival_sigma)
    fewer = load_measurement(tmp_path / "one.npz", ["0", "4"])
    assert np.array_equal(fewer.arrivals, np.delete(times, [0, 4], axis=1), equal_nan=True)


TIMES = np.zeros((1, 3)), np.zeros(16), np.zeros((0, 16)), np.full((1, 16), np.inf), np.full((1, 16), 1e9), [["a"] * 16]
WRONG = [
    *(({"arrivals": times}, "arrivals") for times in TIMES),
    *(({"arrival_sigma": sigma}, "arrival_sigma") for sigma in (-1e-6, [1e-6, 1e-6])),
    ({"arrivals": None}, "arrival_sigma"),
]


@pytest.mark.parametrize(("given", "key"), WRONG)
def test_wrong_arrivals_are_refused(imported, given, key):
    assert refuses("", replace, imported, **given).key == key
