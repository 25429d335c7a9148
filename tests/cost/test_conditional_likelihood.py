"""The conditional likelihood: a smaller bias by a field that is not isotropic, and none by the noise."""

from dataclasses import replace

import numpy as np
import pytest

from fdcal.cost.channel_field import ChannelField, Conditional
from fdcal.cost.channel_likelihood import channel_terms
from fdcal.model.gauge import rigid_motions

COUNT, MODES, WAVES = 40, 60, 12
LOUD = 20.0  # amplitude of the first wave over that of the others
K = np.linspace(2.0, 7.0, MODES)  # rad/m


def few_waves(rng, share, dimension=3):
    """Positions (N, D), pressures (M, N) of plane waves, one of them loud, from the same directions in every mode."""
    x = rng.uniform(-0.35, 0.35, (COUNT, dimension))
    u = rng.normal(size=(WAVES, dimension))
    u /= np.linalg.norm(u, axis=1)[:, None]
    a = (rng.normal(size=(MODES, WAVES)) + 1j * rng.normal(size=(MODES, WAVES))) * np.where(np.arange(WAVES), 1, LOUD)
    p = np.einsum("mq,mqn->mn", a, np.exp(-1j * K[:, None, None] * (u @ x.T)))
    p /= np.sqrt(np.mean(np.abs(p) ** 2, axis=1))[:, None]
    noise = rng.normal(size=(2, MODES, COUNT)) * np.sqrt(share / 2)
    return x, p + noise[0] + 1j * noise[1]


def assumed(share, conditional, dimension=3):
    ones = np.ones(MODES)
    field = ChannelField(K, ones, share * ones, np.ones(COUNT), dimension)
    chosen = Conditional(50.0, 0.1, False, np.zeros((1, COUNT)))
    return replace(field, conditional=chosen) if conditional else field


def newton_step(x, p, field):
    """RMS of the step (metres) from the true positions to the minimum of the cost, without rigid motions."""
    g, H = channel_terms(x, np.zeros((COUNT, 2)), p, field).newton()
    D, motions = x.shape[1], rigid_motions(x)
    g, H = g[:, :D].ravel(), H[:, :D, :, :D].reshape(x.size, x.size)
    held = np.linalg.svd(motions)[0][:, motions.shape[1] :]
    step = held @ np.linalg.solve(held.T @ H @ held, held.T @ g)
    return np.sqrt(np.sum(step**2) / COUNT)


@pytest.mark.parametrize(("dimension", "most"), ((2, 0.75), (3, 0.5)))
@pytest.mark.parametrize("seed", range(4))
def test_a_loud_wave_moves_the_minimum_less_than_that_of_a_random_field(seed, dimension, most):
    x, p = few_waves(np.random.default_rng(seed), 1e-4, dimension)
    random, conditional = (newton_step(x, p, assumed(1e-4, kind, dimension)) for kind in (False, True))
    assert conditional < most * random


def test_the_noise_has_no_part_in_the_mean_gradient():
    share, repeats = 1e-2, 100
    rng = np.random.default_rng(0)
    x, clean = few_waves(rng, 0.0)
    field = assumed(share, True)
    corrected = replace(field, conditional=replace(field.conditional, weight=0.0))
    untouched = replace(corrected, conditional=replace(corrected.conditional, reference=np.full((1, COUNT), -20.0)))
    noise = rng.normal(size=(repeats, 2, MODES, COUNT)) * np.sqrt(share / 2)

    def gradient(p, field):
        return channel_terms(x, np.zeros((COUNT, 2)), p, field).gradient

    def part_of_noise(field):
        """Mean change of the gradient by noise over its standard error, RMS over positions and gains."""
        change = [gradient(clean + n[0] + 1j * n[1], field) - gradient(clean, untouched) for n in noise]
        error = np.std(change, axis=0) / np.sqrt(repeats)
        return np.sqrt(np.mean((np.mean(change, axis=0) / error) ** 2))

    assert part_of_noise(corrected) < 1.3
    assert part_of_noise(untouched) > 2.0, "without the trace it has one"
