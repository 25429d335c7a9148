"""The methods that `python -m benchmarks comparison` sets beside fdcal give exact answers to exact input."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

from fdcal.model.gauge import align
from fdcal_bench.methods import (
    coherence,
    cross_spectra,
    distances_of_coherence,
    first_arrivals,
    positions_of_arrivals,
    robust_scaling,
    time_differences,
)
from fdcal_bench.rooms import draw_array

SPEED, RATE = 343.0, 8000.0
FREQUENCIES = np.arange(50.0, 2000.0, 10.0)
SOURCES = 3.0 * np.array([[x, y, 0.6 * z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) + [0.3, 0.2, 0.1]


def rms(found, truth) -> float:
    return float(np.sqrt(np.mean(np.sum((align(found, truth) - truth) ** 2, axis=1))))


def test_the_coherence_of_a_diffuse_field_gives_the_distances_and_the_shape():
    x = draw_array(np.random.default_rng(0), 16, 0.5)
    distances = squareform(pdist(x))
    found = distances_of_coherence(np.sinc(2 * distances[..., None] * FREQUENCIES / SPEED), FREQUENCIES, SPEED)
    assert np.allclose(found, distances, atol=1e-5)
    assert rms(robust_scaling(found), x) < 1e-4


def test_wrong_distances_of_a_few_pairs_hardly_move_the_array():
    x = draw_array(np.random.default_rng(0), 16, 0.5)
    distances = squareform(pdist(x))
    for i, j in ((0, 5), (3, 9), (2, 14)):
        distances[i, j] = distances[j, i] = distances[i, j] + 0.7
    assert rms(robust_scaling(distances), x) < 0.005


def test_coherence_is_one_for_equal_channels_and_zero_for_unrelated_ones():
    rng = np.random.default_rng(0)
    one, other = rng.standard_normal((2, 80000))
    _, spectra = cross_spectra(np.array([one, 2 * one, other]), RATE, 256)
    gamma = coherence(spectra)
    assert np.allclose(gamma[0, 1], 1) and np.abs(gamma[0, 2]).max() < 0.25


@pytest.mark.parametrize("exact", [True, False])
def test_exact_arrival_times_give_exact_positions(exact):
    x = draw_array(np.random.default_rng(0), 16, 0.5)
    late = np.linspace(0.0, 0.02, len(SOURCES))  # unknown times of emission
    times = np.linalg.norm(SOURCES[:, None] - x, axis=-1) / SPEED + late[:, None]
    given = SOURCES if exact else SOURCES + np.random.default_rng(1).normal(scale=0.05, size=SOURCES.shape)
    found = positions_of_arrivals(times, given, SPEED, 0.05, np.zeros(3))
    assert rms(found, x) < (1e-6 if exact else 0.02)


def test_delays_between_samples_are_found_in_impulses_and_in_noise():
    late = np.array([0.0, 3.25, -5.5]) + 40.0  # samples
    t = np.arange(400)
    pulses = np.array([np.sinc(t - d) * np.exp(-(((t - d) / 40) ** 2)) for d in late])
    pulses += 0.8 * np.roll(pulses, 30, axis=1)  # a reflection
    assert np.allclose(first_arrivals(pulses, RATE) * RATE, late, atol=0.07)
    size = 32000
    noise = np.fft.rfft(np.random.default_rng(2).standard_normal(size))
    recorded = np.array([np.fft.irfft(noise * np.exp(-2j * np.pi * np.fft.rfftfreq(size) * d), size) for d in late])
    assert np.allclose(time_differences(recorded, RATE, 0.003) * RATE, late - late[0], atol=0.07)


def test_the_segments_of_a_decaying_field_count_alike():
    rng = np.random.default_rng(3)
    shared, own = rng.standard_normal((2, 16000))
    fall = 10 ** (-np.arange(16000) / 16000)  # 20 dB
    early = np.arange(16000) < 2000
    one, other = shared * fall, np.where(early, shared, own) * fall  # the beginning agrees, what follows does not
    weighted = coherence(cross_spectra(np.array([one, other]), RATE, 128)[1])[0, 1].mean()
    alike = coherence(cross_spectra(np.array([one, other]), RATE, 128, decays=True)[1])[0, 1].mean()
    assert alike < 0.25 < weighted
