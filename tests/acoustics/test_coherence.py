"""The extent of an array from the coherence of its pressures."""

import numpy as np
import pytest

from fdcal.acoustics.coherence import array_radius
from fdcal.model.geometry import ball


def diffuse(positions, wavenumbers, seed=0, waves=300):
    """Pressures (M, N) of plane waves from everywhere."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(positions.shape[1], waves))
    phases = positions @ (directions / np.linalg.norm(directions, axis=0))
    weights = rng.normal(size=(len(wavenumbers), waves)) + 1j * rng.normal(size=(len(wavenumbers), waves))
    return np.array([np.exp(1j * k * phases) @ w for k, w in zip(wavenumbers, weights, strict=True)])


def disc(count, radius, seed=1):
    rng = np.random.default_rng(seed)
    r, angle = radius * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    return np.stack([r * np.cos(angle), r * np.sin(angle)], axis=1)


@pytest.mark.parametrize("radius", [0.07, 0.4, 1.5])
@pytest.mark.parametrize("dimension", [2, 3])
def test_the_radius_is_found_to_a_factor_of_one_and_a_half_whatever_the_gains(radius, dimension):
    rng = np.random.default_rng(3)
    positions = disc(40, radius) if dimension == 2 else ball(40, radius, rng)
    k = np.linspace(0.2, 6, 50) / radius
    p = diffuse(positions, k)
    found = array_radius(p, k, dimension)
    assert found is not None and radius / 1.5 < found < 1.5 * radius
    assert array_radius(p * np.exp(0.5 * rng.normal(size=40)), k, dimension) == pytest.approx(found, rel=0.05)


def test_no_radius_is_claimed_where_nothing_tells():
    positions, k = disc(40, 0.5), np.linspace(40, 80, 30)
    assert array_radius(diffuse(positions, k), k, 2) is None, "the array is incoherent throughout"
    k = np.linspace(0.4, 12, 3)
    assert array_radius(diffuse(positions, k), k, 2) is None, "three frequencies are too few"
