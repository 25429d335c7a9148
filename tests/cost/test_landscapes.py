"""Maps of any resolution are Eq. 7; a local minimum counts by its prominence."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fdcal import solvers
from fdcal.acoustics.fourier_bessel import max_order
from fdcal.cost import eq7
from fdcal.cost.basins import local_minima, prominent_minima
from fdcal.cost.maps import fine_landscape, interpolate, map_positions, mode_landscapes, mode_shape, refined
from fdcal.model.measurement import Measurement
from fdcal.model.settings import Search, SolverSettings
from fdcal.model.validation import InputError

SEARCH = Search(origin=(1.0, 2.0), size=(0.4, 0.3), step=0.025, radius=0.35)


@pytest.fixture(scope="module")
def problem():
    rng = np.random.default_rng(2)
    positions = np.array(SEARCH.origin) + rng.uniform(0.02, 0.28, (24, 2))
    k = np.array([2.0, 3.5, 5.0])
    angles, phases = rng.uniform(0, 2 * np.pi, (2, 3, 5))
    towards = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    p = np.exp(1j * (k[:, None, None] * (towards @ positions.T) + phases[:, :, None])).sum(axis=1)
    return Measurement(
        frequencies=k * 343 / (2 * np.pi), pressures=p, sound_speed=343.0, positions=positions,
        known=np.arange(5), search=SEARCH,
    ).problem("unit")  # fmt: skip


@pytest.fixture(scope="module")
def state(problem):
    descent = solvers.load("descent")
    return descent.init(problem, SolverSettings(modes=3, first_modes=3, order_offset=1, ample_modes=1), 0)


def test_one_mode_at_a_time_is_the_solvers_landscape(problem, state):
    descent = solvers.load("descent")
    whole = descent.landscape(problem, state, 7, slice(0, 3))
    np.testing.assert_array_equal(mode_landscapes(problem, descent, state, 7, (1, 3)), whole[[0, 2]])


def test_a_fine_map_on_the_solvers_lattice_is_its_landscape(problem, state):
    whole = solvers.load("descent").landscape(problem, state, 7, slice(0, 3))
    for mode in (1, 2, 3):
        fine = fine_landscape(problem, None, state, 7, mode, SEARCH)
        np.testing.assert_allclose(fine, whole[mode - 1], rtol=1e-8)


def test_a_fine_map_is_eq_7_at_every_point(problem, state):
    """Known microphones weigh as much as the others here, as in the brute-force formula."""
    plain = dataclasses.replace(state, settings=dataclasses.replace(state.settings, known_weight=1.0))
    fine, n = refined(SEARCH, 57), 7
    assert max(fine.shape) == 57
    values = fine_landscape(problem, None, plain, n, 2, fine)
    centre = np.array(fine.origin) + fine.step * np.rint((state.centre - fine.origin) / fine.step)
    k, p = problem.wavenumbers[1:2], problem.pressures[1:2]
    L = max_order(k, SEARCH.radius, state.order_offset)
    for row, column in [(0, 0), (10, 40), (41, 56)]:
        positions = np.array(state.positions)
        positions[n] = map_positions(np.array([[row, column]]), fine)[0]
        assert values[row, column] == pytest.approx(eq7.cost(positions, p, k, L, centre)[0], rel=1e-7)


def test_a_finer_lattice_covers_the_same_cells():
    fine = refined(SEARCH, 500)
    for lattice in (SEARCH, fine):
        low = np.array(lattice.origin) - lattice.step / 2
        high = low + lattice.step * np.array(lattice.shape)
        np.testing.assert_allclose(low, [0.9875, 1.9875], atol=1e-9)
        np.testing.assert_allclose(high, [1.4125, 2.3125], atol=fine.step)
    assert fine.shape[0] == 500


def waves(shape, periods):
    y, x = (np.arange(count) / count for count in shape)
    return np.cos(2 * np.pi * periods * x)[None, :] + np.cos(2 * np.pi * periods * y)[:, None]


@pytest.mark.parametrize("periods", [1, 2, 5])
def test_every_minimum_of_an_egg_box_is_found(periods):
    found = local_minima(waves((101, 121), periods))
    assert len(found) == periods**2
    centres = (np.arange(periods) + 0.5) / periods
    expected = {(round(101 * y), round(121 * x)) for y in centres for x in centres}
    assert all(min(abs(r - y) + abs(c - x) for y, x in expected) <= 2 for r, c in found)


def test_a_slope_and_a_lowest_edge_have_no_minimum_inside():
    slope = np.add.outer(np.arange(20.0), np.arange(30.0))
    assert len(local_minima(slope)) == 0
    assert len(local_minima(np.ones((20, 30)))) == 0


def test_a_ripple_does_not_count_and_a_minimum_does():
    valley = np.abs(np.arange(-30, 31))[:, None] * 10.0 + np.zeros((61, 81))
    ripple = valley + np.where(np.arange(81) % 4 == 0, -0.05, 0.0)
    assert len(local_minima(ripple)) == 0, "beads along a valley"
    ripple[30, 50] -= 30
    np.testing.assert_array_equal(local_minima(ripple), [[30, 50]])


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_without_a_threshold_local_minima_are_the_points_below_all_their_neighbours(seed):
    values = np.random.default_rng(seed).random((9, 13))
    padded = np.pad(values, 1, constant_values=np.inf)
    around = [padded[1 + j : 10 + j, 1 + i : 14 + i] for j in (-1, 0, 1) for i in (-1, 0, 1) if i or j]
    expected = np.flatnonzero(values < np.min(around, axis=0))
    found = prominent_minima(values, 0.0)
    assert set(found.tolist()) == set(expected.tolist())
    assert found[0] == values.argmin()
    deeper = prominent_minima(values, 0.3)
    assert set(deeper.tolist()) <= set(found.tolist()) and found[0] in deeper


def test_a_map_is_read_off_between_its_points():
    x, y = (o + SEARCH.step * np.arange(n) for o, n in zip(SEARCH.origin, SEARCH.shape, strict=True))
    values = 3 * x[None, :] - 2 * y[:, None]
    for point in [(1.0, 2.0), (1.013, 2.21), (1.4, 2.3)]:
        assert interpolate(values, SEARCH, point) == pytest.approx(3 * point[0] - 2 * point[1], abs=1e-12)
    assert interpolate(values, SEARCH, (9.0, 9.0)) == pytest.approx(values[-1, -1]), "beyond: the edge"


def test_the_shape_of_a_mode_is_the_recorded_field(problem):
    """The first mode of the fixture is a sum of plane waves, known everywhere."""
    rng = np.random.default_rng(2)
    positions = np.array(SEARCH.origin) + rng.uniform(0.02, 0.28, (24, 2))
    angles, phases = rng.uniform(0, 2 * np.pi, (2, 3, 5))
    x, y = (o + SEARCH.step * np.arange(n) for o, n in zip(SEARCH.origin, SEARCH.shape, strict=True))
    points = np.stack(np.meshgrid(x, y), axis=-1)
    towards = np.stack([np.cos(angles[0]), np.sin(angles[0])], axis=-1)
    field = np.exp(1j * (2.0 * points @ towards.T + phases[0])).sum(axis=-1)
    shape = mode_shape(problem, positions, 1, 4)
    assert shape.shape == field.shape and np.abs(shape).max() == pytest.approx(1.0)
    inside = np.s_[2:11, 2:11]  # among the microphones
    basis = np.stack([field.real[inside].ravel(), field.imag[inside].ravel()], axis=1)
    _, left, *_ = np.linalg.lstsq(basis, shape[inside].ravel(), rcond=None)
    assert left[0] < 1e-8, "one moment of the oscillation"


def test_no_shape_without_a_plane_lattice(problem):
    with pytest.raises(InputError, match="two-dimensional"):
        mode_shape(dataclasses.replace(problem, search=None), np.zeros((24, 2)), 1, 2)


def test_every_minimum_of_an_egg_box_of_three_dimensions_is_found():
    z, y, x = (np.arange(count) / count for count in (21, 31, 41))
    values = np.add.outer(np.cos(4 * np.pi * z), np.add.outer(np.cos(2 * np.pi * y), np.cos(4 * np.pi * x)))
    found = local_minima(values)
    expected = [(21 * h, 31 * j, 41 * i) for h in (0.25, 0.75) for j in (0.5,) for i in (0.25, 0.75)]
    assert len(found) == 4
    assert all(np.abs(np.subtract(found, place)).max(axis=1).min() <= 1 for place in expected)
    lattice = Search(origin=(1.0, 2.0, 3.0), size=(0.4, 0.3, 0.2), step=0.01)
    np.testing.assert_allclose(map_positions([[2, 1, 5]], lattice), [[1.05, 2.01, 3.02]])
