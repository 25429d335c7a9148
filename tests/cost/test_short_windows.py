"""The likelihood of short windows: derivatives, information, and what leaves it unchanged."""

from dataclasses import replace

import numpy as np
import pytest

from fdcal.cost import short_windows as short

N, T, F, W = 6, 2, 5, 20
SPACE = np.arange(3)


def some_field(rng) -> short.ShortField:
    return replace(
        short.first_field(0.1 * rng.standard_normal((N, 3)), T),
        channels=0.05 * rng.standard_normal((N, 2)),
        spectrum=np.array([0.2, -0.1, 0.15, 0.05, -0.3, 0.1, 0.2]),
        directions=np.array([[[0.6, 0.8, 0.0], [0.0, 1.0, 0.0]], [[0.0, -0.6, 0.8], [-0.6, 0.0, -0.8]]]),
        powers=np.array([[[-1.0, -2.0], [-1.5, -1.0]], [[-0.5, 0.2], [-2.0, -2.5]]]),
        curvature=np.array([[0.3, 0.1], [0.8, 0.2]]),
    )


def drawn(field: short.ShortField, rng, windows: int = W, frequencies: int = F) -> short.ShortLikelihood:
    """Return windows drawn from the model of a field, each with its own power."""
    k, takes = np.tile(np.linspace(4, 40, frequencies), T), np.repeat(np.arange(T), frequencies)
    N = len(field.positions)
    found, each = np.empty((len(k), windows, N), complex), np.unique(k)
    K = short.anisotropic_kernel(field.positions, each, field.spectrum, 0.0, False)[0]
    along = (each - each[0]) / (each[-1] - each[0])
    noise = np.exp(np.interp(along, np.linspace(0, 1, len(field.noise)), field.noise))
    x = field.positions
    for g, (one, take) in enumerate(zip(k, takes, strict=True)):
        m = int(np.searchsorted(each, one))
        C = K[m] + noise[m] * np.eye(N)
        for powers, v, q in zip(field.powers[take], field.directions[take], field.curvature[take], strict=True):
            h = np.exp(-1j * one * (-x @ v + q / 2 * (np.sum(x**2, axis=1) - (x @ v) ** 2)))
            C = C + np.exp(np.interp(along[m], [0, 1], powers)) * np.outer(h, h.conj())
        L = np.linalg.cholesky(C)
        z = (rng.standard_normal((windows, N)) + 1j * rng.standard_normal((windows, N))) / np.sqrt(2)
        gain = np.exp(field.channels[:, 0] + 1j * field.channels[:, 1])
        found[g] = gain * (z @ L.T) * np.exp(rng.standard_normal((windows, 1)))
    return short.ShortLikelihood(k, takes, found, 0.0)


@pytest.mark.parametrize("ring", [0.1, -0.3])  # the second power is negative
def test_the_gradient_is_that_of_the_cost(ring):
    rng = np.random.default_rng(0)
    field = some_field(rng)
    likelihood = drawn(field, rng)
    field = replace(field, spectrum=np.array([*field.spectrum[:5], ring, 0.2]))
    likelihood.pressures[3, 4:7] = 0
    likelihood = replace(likelihood, dispersion=2.5, bandwidth=1.5)
    here = replace(field, positions=field.positions + 0.01 * rng.standard_normal((N, 3)))
    every, some = (short.free_parameters(here, np.arange(*axes), True, 7) for axes in ((3,), (2,)))
    terms, h = likelihood.terms(here, every), 1e-6
    numerical = [
        (likelihood.terms(short.advanced(here, e)).cost - likelihood.terms(short.advanced(here, -e)).cost) / (2 * h)
        for e in h * np.eye(len(terms.gradient))
    ]
    assert np.abs(terms.gradient - numerical).max() < 1e-5 * np.abs(terms.gradient).max()
    part = likelihood.terms(here, some)
    np.testing.assert_allclose(part.scores, terms.scores[:, some], atol=1e-9)
    np.testing.assert_allclose(part.fisher, terms.fisher[np.ix_(some, some)], atol=1e-9)


def test_the_covariance_of_the_scores_is_the_information():
    rng = np.random.default_rng(1)
    field = some_field(rng)
    likelihood = drawn(field, rng, windows=60, frequencies=40)
    terms = likelihood.terms(field, short.free_parameters(field, np.arange(3), True, 7))
    values, vectors = np.linalg.eigh(terms.fisher)
    kept = values > 1e-3 * values[-1]
    assert 0.8 < np.mean(np.sum((terms.scores @ vectors[:, kept]) ** 2, axis=0) / values[kept]) < 1.25


def test_neither_the_power_of_a_window_nor_a_turn_about_the_vertical_changes_the_likelihood():
    rng = np.random.default_rng(2)
    field = replace(some_field(rng), spectrum=np.array([0, 0, 0, 0, -0.3, 0.1, 0.2]))
    likelihood = drawn(field, rng)
    louder = replace(likelihood, pressures=likelihood.pressures * np.exp(rng.standard_normal((2 * F, W, 1))))
    before = [one.terms(field).cost for one in (likelihood, louder)]
    turn = np.array([[np.cos(1), -np.sin(1), 0], [np.sin(1), np.cos(1), 0], [0, 0, 1]])
    turned = replace(field, positions=field.positions @ turn, directions=field.directions @ turn)
    other = replace(field, positions=1.1 * field.positions)
    assert np.allclose(before, [one.terms(turned).cost for one in (likelihood, louder)], rtol=1e-12, atol=1e-6)
    # The cost of a window contains N log of its power, whatever the positions.
    assert np.diff(before) == pytest.approx(np.diff([one.terms(other).cost for one in (likelihood, louder)]))


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_vertical_is_the_axis_of_least_sound_for_a_level_an_upright_and_a_spatial_array(dimension):
    rng = np.random.default_rng(3)
    field = replace(some_field(rng), spectrum=np.array([0.2, -0.1, 0.0, 0.0, -0.3, 0.0, 0.14]))
    field.positions[:, dimension:] = 0
    k = np.linspace(4, 40, 7)
    before = short.anisotropic_kernel(field.positions, k, field.spectrum, 0.0, False)[0]
    cases = short.upright(field, SPACE[:dimension])
    assert [tuple(axes) for _, axes in cases] == [[(0, 1), (0, 2)], [(0, 1, 2)]][dimension - 2]
    for turned, axes in cases:
        after = short.anisotropic_kernel(turned.positions, k, turned.spectrum, 0.0, False)[0]
        assert np.allclose(after, before, atol=1e-12)
        assert np.allclose(np.delete(turned.positions, axes, axis=1), 0)
        moves = short.free_parameters(turned, axes)[: 5 * N].reshape(N, 5)
        assert np.array_equal(np.flatnonzero(moves.all(axis=0)), axes)
    some = short.free_parameters(field, SPACE, spectrum=5)[5 * N : 5 * N + len(field.spectrum)]
    assert np.array_equal(np.flatnonzero(some), range(5)), "the first ones"
    upwards = turned.spectrum[4]  # in the last case z is free; a larger value means less sound from above
    level = [-upwards / 2 + turned.spectrum[0], -upwards / 2 - turned.spectrum[0]]
    assert upwards >= max(level[axis] for axis in axes if axis < 2) and np.allclose(turned.spectrum[2:4], 0, atol=1e-12)


def test_direct_sound_and_a_reflection_are_found_one_after_the_other():
    rng = np.random.default_rng(5)
    powers = np.array([0.5, -0.5])[:, None] * np.ones((T, 2, 2))
    field = replace(some_field(rng), powers=powers, curvature=np.zeros((T, 2)))
    alone = replace(field, powers=powers[:, :0], directions=field.directions[:, :0], curvature=field.curvature[:, :0])
    likelihood = drawn(field, rng, windows=60)
    direct = short.with_wave(likelihood, alone)
    both = short.with_wave(likelihood, direct)
    assert np.all(np.sum(direct.directions * field.directions[:, :1], axis=2) > 0.95)
    assert both.directions.shape == field.directions.shape
    assert np.all(np.diff([likelihood.terms(one).cost for one in (alone, direct, both)]) < 0)


@pytest.mark.parametrize("bandwidth", [0.0, 1.5])
def test_the_cost_of_another_place_is_that_of_the_covariance_there(bandwidth):
    """Log det C + tr C^-1 S, with the scatter S at the present array, from the whole covariance of each array."""
    rng = np.random.default_rng(6)
    field = some_field(rng)
    likelihood = replace(drawn(field, rng), bandwidth=bandwidth)
    places = np.vstack([field.positions, 0.1 * rng.standard_normal((4, 3))])
    found = short.costs_of_places(likelihood, field, places, 0.0)
    _, inverse, scatter, windows = short._observed(likelihood, field)
    for n in range(N):
        costs = []
        for place in places[[n, -2, -1]]:
            moved = np.array(field.positions)
            moved[n] = place
            inverse = short._observed(likelihood, replace(field, positions=moved))[1]
            costs.append(-windows @ np.linalg.slogdet(inverse)[1] + np.sum(inverse * scatter.swapaxes(1, 2)).real)
        assert np.allclose(found[n, [n, -2, -1]] - found[n, n], np.array(costs) - costs[0], atol=1e-8)
