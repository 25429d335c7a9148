"""The Fisher information of a diffuse field, against the formula of Slepian and Bangs with numerical derivatives."""

import numpy as np
import pytest
from scipy.special import j0

from fdcal.acoustics.room_modes import independent_frequencies, mode_count
from fdcal.assessment.bound import Prior, diffuse_information, field_information, position_bound
from fdcal.model.gauge import rigid_motions

SHARE, K = 0.01, [2.0, 5.0, 9.0]


def array(count, dimension, seed=0):
    return 0.3 * np.random.default_rng(seed).normal(size=(count, dimension))


def by_differences(x, dimension):
    """Information by central differences of the covariance; parameters x, log gains, log c and the field's power."""
    N, D = x.shape

    def covariance(parameters, k):
        places, gains = parameters[: N * D].reshape(N, D), np.exp(parameters[N * D : N * D + N])
        r = k * np.linalg.norm(places[:, None] - places[None], axis=-1) / np.exp(parameters[-2])
        kappa = j0(r) if dimension == 2 else np.sinc(r / np.pi)
        return np.outer(gains, gains) * (parameters[-1] * (1 - SHARE) * kappa + SHARE * np.eye(N))

    at, step, total = np.concatenate([x.ravel(), np.zeros(N + 1), [1.0]]), 1e-5, 0.0
    for k in K:
        slopes = [(covariance(at + e, k) - covariance(at - e, k)) / 2 / step for e in step * np.eye(len(at))]
        parts = [np.linalg.solve(covariance(at, k), slope) for slope in slopes]
        F = np.array([[np.trace(a @ b) for b in parts] for a in parts])
        total = total + F[:-1, :-1] - np.outer(F[:-1, -1], F[:-1, -1]) / F[-1, -1]
    return total


@pytest.mark.parametrize(("axes", "dimension"), [(2, 2), (3, 3), (2, 3)])
def test_equals_numerical_derivatives_of_the_covariance(axes, dimension):
    x = array(6, axes)
    expected = by_differences(x, dimension)
    found = diffuse_information(x, K, SHARE, dimension).matrix
    assert np.abs(found - expected).max() < 1e-7 * np.abs(expected).max()


@pytest.mark.parametrize("axes", [2, 3])
def test_rigid_motions_carry_no_information(axes):
    x = array(7, axes)
    F = diffuse_information(x, K, SHARE, axes).matrix[: x.size, : x.size]
    assert np.abs(F @ rigid_motions(x)).max() < 1e-9 * np.abs(F).max()


def test_the_information_of_a_drawn_field_is_that_of_a_diffuse_one_on_average():
    """The Gauss-Newton matrix leaves out a part of the Fisher matrix: they agree where there is little noise."""
    x, k, share = array(12, 2), np.linspace(3, 8, 300), 1e-4
    rng = np.random.default_rng(1)
    distance = np.linalg.norm(x[:, None] - x[None], axis=-1)
    p = []
    for one in k:
        values, vectors = np.linalg.eigh(j0(one * distance))
        z = rng.normal(scale=np.sqrt(0.5), size=(2, len(x)))
        p.append(vectors @ (np.sqrt(np.maximum(values, 0)) * (z[0] + 1j * z[1])))
    prior = Prior(np.array([0, 1, 2]))
    drawn = position_bound(field_information(x, np.array(p), k, share, 2), prior)
    expected = position_bound(diffuse_information(x, k, share, 2), prior)
    assert drawn.rms == pytest.approx(expected.rms, rel=0.25)


def test_microphones_given_exactly_have_no_uncertainty_and_more_of_them_help():
    x = array(10, 2)
    information = diffuse_information(x, K, SHARE, 2)
    three, four = (position_bound(information, Prior(np.arange(n))) for n in (3, 4))
    assert three.sigma[:3].max() < 1e-6
    assert np.all(four.sigma[4:] <= three.sigma[4:] * (1 + 1e-9))


def test_what_is_unknown_can_only_widen_the_bound():
    information, known = diffuse_information(array(10, 2), K, SHARE, 2), np.arange(3)
    exact = position_bound(information, Prior(known)).sigma[3:]
    for prior in (Prior(known, 0.005), Prior(known, gain_sigma=0.1), Prior(known, sound_speed_sigma=0.005)):
        assert np.all(position_bound(information, prior).sigma[3:] >= exact * (1 - 1e-9))


def test_an_unknown_sound_speed_is_an_unknown_size():
    """Blind, one per cent in c adds one per cent in size, in quadrature."""
    information = diffuse_information(array(10, 2), np.linspace(2, 9, 40), 1e-6, 2)
    exact = position_bound(information, Prior()).scale_sigma
    found = position_bound(information, Prior(sound_speed_sigma=0.01)).scale_sigma
    assert found == pytest.approx(np.hypot(exact, 0.01), rel=0.01)


def test_the_bound_falls_with_the_root_of_the_number_of_frequencies():
    x = array(8, 2)
    information = diffuse_information(x, K, SHARE, 2)
    one, four = (position_bound(i, Prior()).rms for i in (information, information.scaled(4.0)))
    assert one == pytest.approx(2 * four)


@pytest.mark.parametrize("size", [(5.0, 4.0), (4.6, 3.8, 2.7)])
def test_the_expected_number_of_modes_is_that_of_the_room(size):
    c, f = 343.0, 300.0 if len(size) == 3 else 900.0
    counts = [np.arange(int(2 * f * length / c) + 1) * c / (2 * length) for length in size]
    modes = np.sqrt(sum(axis**2 for axis in np.meshgrid(*counts, indexing="ij")))
    assert mode_count(size, [f], c)[0] == pytest.approx(np.sum(modes <= f), rel=0.05)


def test_overlapping_resonances_are_not_independent():
    """At high frequencies 2.2 / T60 apart; at low ones as many as there are modes."""
    found = independent_frequencies(1000.0, 2000.0, 0.5, 343.0, (7.0, 6.0, 2.7))
    assert np.allclose(np.diff(found), 4.4, rtol=1e-3)
    low = independent_frequencies(20.0, 60.0, 5.0, 343.0, (4.0, 3.0, 2.5))
    assert len(low) == pytest.approx(np.diff(mode_count((4.0, 3.0, 2.5), [20.0, 60.0], 343.0))[0], abs=1)


def test_the_bound_grows_with_the_sigma_of_the_given_positions():
    """Those of a tape measure: each is known at least as well as stated, and all others the worse for it."""
    x, known = array(9, 2), np.arange(4)
    information = diffuse_information(x, K, SHARE, 2)
    bounds = [position_bound(information, Prior(known, known_sigma=sigma)) for sigma in (0.0, 1e-3, 3e-3, 1e-2)]
    for sigma, one, before in zip((1e-3, 3e-3, 1e-2), bounds[1:], bounds[:-1], strict=True):
        given = one.sigma[known]
        assert np.all(given <= np.sqrt(2) * sigma * (1 + 1e-9)) and np.all(given > before.sigma[known])
        assert one.rms > before.rms
    assert np.all(bounds[0].sigma[known] < 1e-4)
