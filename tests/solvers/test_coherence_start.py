"""The coherence start: right for arrays of several wavelengths, where an affine image of the low modes is not."""

from __future__ import annotations

import numpy as np
import pytest

from fdcal import solvers
from fdcal.model.gauge import align
from fdcal.model.measurement import Measurement
from fdcal.model.settings import SolverSettings
from fdcal.solvers.initial_positions import affine
from fdcal.solvers.robust.coherence import coherence_start, pair_distances

FREQUENCIES = np.linspace(40.0, 320.0, 48)
K = 2 * np.pi * FREQUENCIES / 343.0


def diffuse(x, k, rng, noise: float = 0.0) -> np.ndarray:
    """Pressures (M, N), of unit power on average, at x (N, D): 40 plane waves a mode, from random directions."""
    directions = rng.normal(size=(len(k), 40, x.shape[1]))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    waves = np.exp(1j * k[:, None, None] * (directions @ x.T))
    drawn = rng.normal(size=(2, len(k), 40)) / np.sqrt(80)
    p = np.einsum("md,mdn->mn", drawn[0] + 1j * drawn[1], waves) * np.sqrt(1 - noise)
    e = rng.normal(size=(2, *p.shape)) * np.sqrt(noise / 2)
    return p + e[0] + 1j * e[1]


def rms(x, truth) -> float:
    return float(np.sqrt(np.mean(np.sum((align(x, truth) - truth) ** 2, axis=1))))


@pytest.mark.parametrize("D", [2, 3])
def test_distances_of_near_pairs_follow_from_the_coherence(D):
    rng = np.random.default_rng(1)
    x = rng.uniform(0, 1.0, (12, D))
    k = np.linspace(1.0, 6.0, 600)
    found, _ = pair_distances(diffuse(x, k, rng, 0.01), k, 0.01, D)
    np.testing.assert_allclose(found, found.T)
    apart = np.linalg.norm(x[:, None] - x[None], axis=-1)
    pairs = np.triu_indices(12, 1)
    assert np.median(np.abs(np.log(found[pairs] / apart[pairs]))) < 0.06


@pytest.mark.parametrize("noise", [1e-3, 0.1])
def test_an_array_of_three_wavelengths(noise):
    rng = np.random.default_rng(2)
    x = rng.uniform(0, 3.2, (50, 2))
    p = diffuse(x, K, rng, noise)
    assert rms(coherence_start(p, K, noise, 2, 2), x) < 0.2
    unknown = coherence_start(p, K, None, 2, 2)
    assert rms(unknown, x) < 0.2, "the noise is chosen by likelihood where none is reported"
    problem = Measurement(pressures=p, frequencies=FREQUENCIES, sound_speed=343.0).problem("unit")
    assert rms(affine(problem, len(K)), x) > 0.4, "the low modes are not affine over so large an array"


def test_robust_finds_an_array_of_three_wavelengths_with_a_noisy_and_an_inverted_channel():
    rng = np.random.default_rng(3)
    x = rng.uniform(0, 3.2, (50, 2))
    p = diffuse(x, K, rng, 1e-4)
    p[:, 7] *= -1
    p[:, 20] = (rng.normal(size=len(K)) + 1j * rng.normal(size=len(K))) / np.sqrt(2)
    problem = Measurement(pressures=p, frequencies=FREQUENCIES, sound_speed=343.0).problem("unit")
    state = list(solvers.run(problem, SolverSettings(name="robust", modes=len(K)), 0))[-1]
    sound = np.arange(50) != 20
    assert rms(state.positions[sound], x[sound]) < 5e-3
    assert state.model.channel_noise[20] > 100
    assert abs(state.gains[7, 1]) == pytest.approx(np.pi, abs=0.1)


def test_the_start_does_not_depend_on_how_microphones_are_numbered():
    rng = np.random.default_rng(4)
    x, order = rng.uniform(0, 2.0, (20, 2)), rng.permutation(20)
    p = diffuse(x, K, rng)
    one, other = coherence_start(p, K, 1e-2, 2, 2), coherence_start(p[:, order], K, 1e-2, 2, 2)
    assert rms(other, one[order]) < 1e-3
