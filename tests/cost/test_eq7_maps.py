"""Maps of Eq. 7 at a fixed order: what the page shows, whatever the solver and its modes in use."""

import dataclasses

import numpy as np
import pytest

from fdcal.acoustics.fourier_bessel import max_order
from fdcal.acoustics.measurement_cache import cached_measurement
from fdcal.cost import eq7
from fdcal.cost.maps import cost_maps, eq7_maps, refined
from fdcal.cost.reference_cost import ReferenceCost, decibels
from fdcal.model.scene_file import load_scene
from fdcal.model.settings import Search
from fdcal.model.validation import InputError


def case(name):
    measurement = cached_measurement(load_scene(name))
    away = 0.02 * np.random.default_rng(1).normal(size=measurement.positions.shape)
    return measurement.problem(), measurement.positions + away


@pytest.mark.parametrize("offset", [0, 2])
def test_a_map_is_equation_7_with_the_microphone_at_each_point(offset):
    problem, x = case("tiny")
    modes = (1, 5, 20)
    maps = eq7_maps(problem, x, 9, modes, offset)
    candidates = problem.search.layer().reshape(-1, 2)
    k, p = (values[np.array(modes) - 1] for values in (problem.wavenumbers, problem.pressures))
    orders = max_order(k, problem.search.radius, offset)
    expected = eq7.landscape(x, 9, candidates, p, k, orders, x.mean(axis=0)) / np.sum(np.abs(p) ** 2)
    np.testing.assert_allclose(maps.reshape(3, -1), expected, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("name", ["tiny", "plane3d", "ball3d"])
def test_at_the_estimate_all_modes_give_the_number_of_the_status(name):
    problem, x = case(name)
    reference_cost = ReferenceCost(problem)
    n, search = int(problem.free[0]), problem.search
    there = dataclasses.replace(search, origin=tuple(map(float, x[n])), size=(search.step,) * len(search.size))
    total = eq7_maps(problem, x, n, range(1, reference_cost.count + 1), 2, there).sum(axis=0)
    assert reference_cost.count == len(problem.frequencies)
    assert decibels(total[0, 0]) == pytest.approx(reference_cost(x), abs=1e-6)


def test_maps_on_two_lattices_agree_where_they_share_points():
    problem, x = case("tiny")
    search = problem.search
    half = Search(search.origin, search.size, search.step / 2, search.radius)
    coarse, fine = (eq7_maps(problem, x, 9, (3, 17), 2, lattice) for lattice in (search, half))
    np.testing.assert_allclose(fine[:, ::2, ::2], coarse, rtol=1e-9)


def test_a_map_does_not_depend_on_the_modes_in_use_or_on_the_solver():
    from fdcal import solvers

    scene = load_scene("tiny")
    problem = cached_measurement(scene).problem()
    maps = []
    for name, last in (("descent", 1), ("descent", 20), ("joint", 20)):
        solver = solvers.load(name)
        state = solver.init(problem, dataclasses.replace(scene.solver, name=name), 0)
        state = solver.use_modes(problem, state, 1, last, False)
        state = dataclasses.replace(state, positions=cached_measurement(scene).positions)
        maps.append(cost_maps(problem, solver, state, 9, (17,), 2))
    np.testing.assert_array_equal(maps[0], maps[1])
    np.testing.assert_array_equal(maps[0], maps[2])


def test_a_mode_beyond_the_microphones_is_refused():
    problem, x = case("tiny")
    few = dataclasses.replace(problem, pressures=problem.pressures[:, :9])
    with pytest.raises(InputError, match=r"mode 20 .* 9 microphones"):
        eq7_maps(few, x[:9], 5, (1, 20), 2)
    with pytest.raises(InputError, match="search"):
        eq7_maps(dataclasses.replace(problem, search=None), x, 5, (1,), 2)


def test_a_fine_lattice_of_a_box_is_one_layer():
    search = load_scene("ball3d").search
    fine = refined(search)
    assert fine.shape[:2] == (500, 500) and fine.layer(1.2).shape == (500, 500, 3)
