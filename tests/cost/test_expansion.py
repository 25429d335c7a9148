"""Rows of the dictionary over any points, and which modes the microphones can carry."""

from dataclasses import replace

import numpy as np
import pytest
from fields import measured

from fdcal.acoustics.dictionary import fourier_bessel, spherical_bessel
from fdcal.cost.channel_correction import ChannelCorrection
from fdcal.cost.expansion import FieldExpansion, carried_modes, functions, usable_modes
from fdcal.cost.maps import mode_shape, power_shares

TRUTH = np.random.default_rng(3).uniform(-0.4, 0.4, (24, 2)) + [2.61, 2.31]
PLANE = measured(TRUTH, [0, 1, 2], modes=14).problem()
ARRAYS = [(2, 2), (3, 3), (3, 2)]  # dimensions of the field and of the array


@pytest.mark.parametrize("scale", [1.0, 4.0])
@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_rows_are_those_of_the_dictionary_up_to_a_factor_of_each_column(dimension, D, scale):
    """Inside the tables and beyond them."""
    problem = replace(PLANE, dimension=dimension, array_dimension=D)
    expansion = FieldExpansion(problem, 0)
    points, centre = scale * np.random.default_rng(0).uniform(-0.5, 0.5, (15, D)), np.full(D, 0.01)
    for group in expansion.groups(range(len(expansion.carried.modes))):
        for number, rows in zip(group, expansion.rows(points, centre, group), strict=True):
            order, k = int(expansion.carried.orders[number]), problem.wavenumbers[expansion.carried.modes[number]]
            build = fourier_bessel if dimension == 2 else spherical_bessel
            W = build(points, complex(k), order, centre)
            assert rows.shape == W.shape == (15, functions(problem, order))
            factor = np.sum(W * rows.conj(), axis=0) / np.sum(np.abs(rows) ** 2, axis=0)
            assert np.all(np.abs(rows * factor - W) < 1e-9 * np.abs(W).max(axis=0))


@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_a_mode_is_carried_that_has_fewer_functions_than_there_are_microphones(dimension, D):
    problem = replace(PLANE, dimension=dimension, array_dimension=D)
    count = functions(problem, int(carried_modes(problem, 0).orders[-1]))
    exactly, more = (
        carried_modes(replace(problem, pressures=np.ones((14, n), complex)), 0).modes for n in (count, count + 1)
    )
    assert len(exactly) < len(more)


def test_usable_modes_end_at_the_first_that_is_not_carried():
    problem = replace(PLANE, wavenumbers=PLANE.wavenumbers[[0, 1, 13, 2]], pressures=PLANE.pressures[:4, :9])
    assert carried_modes(problem, 2).modes.tolist() == [0, 1, 3]
    assert usable_modes(problem, 2) == 2


def test_shares_of_power_add_up_to_one():
    state = type("State", (), {"channels": None})
    assert power_shares(PLANE, state, (1, 4, 9)).sum() == pytest.approx(1.0)


def test_the_shape_of_a_mode_depends_neither_on_phase_nor_on_gains_that_are_known():
    shape = mode_shape(PLANE, TRUTH, 6, 2)
    turned = mode_shape(replace(PLANE, pressures=PLANE.pressures * np.exp(0.8j)), TRUTH, 6, 2)
    gains, noise = np.exp(1j * np.linspace(0, 1, 24)), np.linspace(1, 4, 24)
    played = replace(PLANE, pressures=PLANE.pressures * gains)
    corrected = mode_shape(played, TRUTH, 6, 4, ChannelCorrection(gains, noise))
    np.testing.assert_allclose(turned, shape, atol=1e-9)
    np.testing.assert_allclose(corrected, mode_shape(PLANE, TRUTH, 6, 4), atol=0.02)
