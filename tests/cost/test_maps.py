"""Maps of Eq. 7 and of the likelihood."""

from dataclasses import replace

import numpy as np
import pytest
from fields import measured
from running import refuses

from fdcal import solvers
from fdcal.acoustics.dictionary import fourier_bessel, max_order
from fdcal.acoustics.measure import cached_measurement
from fdcal.cost import eq7
from fdcal.cost import maps as cost
from fdcal.cost.basins import basins_of
from fdcal.cost.eq7 import ORDER_OFFSET, known_weights
from fdcal.cost.likelihood import isotropic_field, likelihood_terms
from fdcal.cost.noise import DIFFUSE_FLOOR
from fdcal.model.measurement import Measurement
from fdcal.model.problem import ChannelCorrection, Problem
from fdcal.model.scene import load_scene
from fdcal.model.settings import Search, SolverSettings
from fdcal.solvers import joint as joint

SEARCH = Search(origin=(1.0, 2.0), size=(0.4, 0.3), step=0.025, radius=0.35)
TRUTH = np.random.default_rng(4).uniform([2.2, 1.9], [3.0, 2.7], (24, 2))
PLANE = measured(TRUTH, np.arange(4), modes=14).problem("unit")
GUESS = TRUTH + np.random.default_rng(5).normal(0, 0.01, TRUTH.shape)


@pytest.fixture(scope="module")
def waves():
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


def case(name):
    measurement = cached_measurement(load_scene(name))
    away = 0.02 * np.random.default_rng(1).normal(size=measurement.positions.shape)
    return measurement.problem(), measurement.positions + away


@pytest.mark.parametrize("offset", [0, 2])
def test_a_map_is_equation_7_with_the_microphone_at_each_point(offset):
    problem, x = case("tiny")
    modes = (1, 5, 20)
    maps = cost.eq7_maps(problem, x, 9, modes, offset)
    candidates = problem.search.layer().reshape(-1, 2)
    k, p = (values[np.array(modes) - 1] for values in (problem.wavenumbers, problem.pressures))
    each = list(zip(k, max_order(k, problem.search.radius, offset), strict=True))
    W, rows = ([fourier_bessel(at, *one, x.mean(axis=0)) for one in each] for at in (x, candidates))
    fits = eq7.leave_one_out_fits(W, p, 9)
    expected = [fit.cost_of(w) for fit, w in zip(fits, rows, strict=True)] / np.sum(np.abs(p) ** 2)
    np.testing.assert_allclose(maps.reshape(3, -1), expected, rtol=1e-6, atol=1e-12)


def test_what_has_no_map_is_refused(waves):
    problem, x = case("tiny")
    few = replace(problem, pressures=problem.pressures[:, :9])
    refuses(r"frequency 20 .* 9 microphones; .* lower frequencies", cost.eq7_maps, few, x[:9], 5, (1, 20), 2)
    refuses("search", lambda: cost.eq7_maps(replace(problem, search=None), x, 5, (1,), 2))
    refuses("order", cost.eq7_maps, PLANE, GUESS, 9, (14,), 12)
    refuses("in a plane", lambda: cost.cost_volume(*case("plane3d"), 10, (1, 2), 2))
    refuses("two-dimensional field.*on the page", lambda: cost.landscape_panels(*case("plane3d"), 5, [1, 2], 2))
    refuses("two-dimensional", lambda: cost.mode_shape(replace(waves, search=None), np.zeros((24, 2)), 1, 2))
    refuses("two other microphones", lambda: cost.mode_shape(waves, np.zeros((2, 2)), 1, 2, None, 0))
    displaced = np.where(np.arange(24)[:, None] == 3, np.nan, ROUGH)
    with pytest.raises(np.linalg.LinAlgError, match="finite"):
        cost.likelihood_maps(MEASURED.problem(), displaced, N, MODES, noise_of(MEASURED.problem(), 1e-3))


@pytest.mark.parametrize("known_weight", [1.0, 1000.0])
def test_a_map_of_descent_is_weighted_eq_7_at_every_point_of_any_lattice(waves, known_weight):
    """This also holds if a known microphone is moved; its weight is then 1."""
    x = np.random.default_rng(7).uniform(SEARCH.origin, np.add(SEARCH.origin, SEARCH.size), (24, 2))
    k, p, fine = waves.wavenumbers[[0, 2]], waves.pressures[[0, 2]], cost.refined(SEARCH, 57)
    orders = max_order(k, SEARCH.radius, 1)
    for n, centre in ((2, np.array([1.2, 2.15])), (7, np.array([1.21, 2.13]))):
        maps = cost.descent_maps(waves, x, n, (1, 3), 1, known_weight, centre, fine)
        assert maps.shape == (2, *fine.shape[::-1]) and max(fine.shape) == 57
        weights = np.where(np.arange(24) < 5, known_weight, 1.0)
        weights[n] = 1.0
        for row, column in [(0, 0), (10, 40), (41, 56)]:
            moved = x.copy()
            moved[n] = cost.map_positions(np.array([[row, column]]), fine)[0]
            for m in range(2):
                W = np.sqrt(weights)[:, None] * fourier_bessel(moved, k[m], int(orders[m]), centre)
                b = np.sqrt(weights) * p[m]
                expected = np.sum(np.abs(W @ np.linalg.lstsq(W, b, rcond=None)[0] - b) ** 2)
                assert maps[m, row, column] == pytest.approx(expected, rel=1e-7)
    nearest = np.array(SEARCH.origin) + SEARCH.step * np.rint((x.mean(axis=0) - SEARCH.origin) / SEARCH.step)
    about = cost.descent_maps(waves, x, 7, (1, 2), 1, 1.0, nearest)
    np.testing.assert_array_equal(cost.descent_maps(waves, x, 7, (1, 2), 1), about)


def test_cost_maps_without_an_order_are_the_solvers_landscape_on_any_lattice(waves):
    descent = solvers.load("descent")
    state = descent.init(waves, SolverSettings(modes=3, first_modes=3, order_offset=1, ample_modes=1), 0)
    weights = known_weights(waves, state.settings.known_weight)
    whole = descent.landscape(waves, state, 7, slice(0, 3)) / np.sum(weights * np.abs(waves.pressures[[0, 2]]) ** 2)
    np.testing.assert_allclose(cost.cost_maps(waves, descent, state, 7, (1, 3), None), whole[[0, 2]], rtol=1e-12)
    half = Search(SEARCH.origin, SEARCH.size, SEARCH.step / 2, SEARCH.radius)
    fine = cost.cost_maps(waves, descent, state, 7, (3, 1), None, half)
    np.testing.assert_allclose(fine[:, ::2, ::2], whole[[2, 0]], rtol=1e-9)


def test_a_layer_of_the_volume_is_the_map_of_that_height_also_with_gains_and_noise_of_the_channels():
    problem, x = case("ball3d")
    search, modes, n = problem.search, (1, 20, 60), np.arange(len(x))
    px, py = (o + search.step * np.arange(n) for o, n in zip(search.origin[:2], search.shape[:2], strict=True))
    for channels in (None, ChannelCorrection(np.exp(0.1 * np.sin(n) + 0j), 1 + n / len(x))):
        layer = cost.eq7_maps(problem, x, 10, modes, 2, None, channels).sum(axis=0)
        volume = cost.cost_volume(problem, x, 10, modes, 2, channels)
        np.testing.assert_allclose(volume.on(px, py, x[10, 2])[0], layer, rtol=1e-6)
    coarse = cost.cost_volume(problem, x, 10, modes, 2, channels, negligible=1e-3)
    np.testing.assert_allclose(coarse.on(px, py, x[10, 2])[0], layer, rtol=0.05)
    assert coarse.modes[-1].values.size < volume.modes[-1].values.size
    assert cost.cost_volume(problem, x, 10, modes, 2, cancelled=lambda: True) is None
    assert volume.on(px, py, 1.2, lambda: True) is None


@pytest.fixture(scope="module", params=["descent", "joint"])
def name(request):
    return request.param


@pytest.fixture(scope="module")
def solver(name):
    return solvers.load(name)


@pytest.fixture(scope="module")
def state(name, solver):
    return solver.init(PLANE, solvers.with_mode_count(PLANE, SolverSettings(name=name, modes=8, first_modes=3)), 0)


@pytest.mark.parametrize("order_offset", [ORDER_OFFSET, None])
@pytest.mark.parametrize("modes", [(1, 2, 3, 4), (6, 5, 4), (3,)])
def test_each_partial_sum_is_the_map_of_its_modes(solver, state, modes, order_offset):
    fine = cost.refined(PLANE.search, 60)
    sums = list(cost.partial_sums(PLANE, solver, state, 9, modes, order_offset, fine))
    assert [one.modes for one in sums] == [modes[: i + 1] for i in range(len(modes))]
    for one in sums:
        maps = cost.cost_maps(PLANE, solver, state, 9, one.modes, order_offset, fine)
        if order_offset is not None:  # the order does not depend on the solver or its modes
            assert np.array_equal(
                maps, cost.eq7_maps(PLANE, state.positions, 9, one.modes, order_offset, fine, state.channels)
            )
        np.testing.assert_allclose(one.cost, maps.sum(axis=0), rtol=1e-9, atol=1e-12 * np.ptp(one.cost))
        assert one.minima.count == len(basins_of(one.cost).minima)


def test_the_shape_of_a_mode_is_the_recorded_field(waves):
    """The first mode of the fixture is a sum of plane waves, known everywhere."""
    rng = np.random.default_rng(2)
    positions = np.array(SEARCH.origin) + rng.uniform(0.02, 0.28, (24, 2))
    angles, phases = rng.uniform(0, 2 * np.pi, (2, 3, 5))
    x, y = (o + SEARCH.step * np.arange(n) for o, n in zip(SEARCH.origin, SEARCH.shape, strict=True))
    points = np.stack(np.meshgrid(x, y), axis=-1)
    towards = np.stack([np.cos(angles[0]), np.sin(angles[0])], axis=-1)
    field = np.exp(1j * (2.0 * points @ towards.T + phases[0])).sum(axis=-1)
    shape, _ = cost.mode_shape(waves, positions, 1, 4)
    assert shape.shape == field.shape and np.abs(shape).max() == pytest.approx(1.0)
    inside = np.s_[2:11, 2:11]  # the part of the lattice among the microphones
    basis = np.stack([field.real[inside].ravel(), field.imag[inside].ravel()], axis=1)
    _, left, *_ = np.linalg.lstsq(basis, shape[inside].ravel(), rcond=None)
    assert left[0] < 1e-8, "a snapshot of the oscillation"


# The maps of the likelihood over the search lattice obey these laws.


PLACES = np.random.default_rng(3).uniform(-0.5, 0.5, (24, 2)) + [2.61, 2.31]
MEASURED = measured(PLACES, [0, 1, 2], highest=250.0, snr_db=40)
ROUGH = PLACES + np.random.default_rng(4).normal(0, 0.02, PLACES.shape)
MODES = slice(1, 40, 6)
N = 7
CELLAR = Search((2.01, 1.71, 0.4), (1.2, 1.0, 0.6), 0.1, 0.8)
AREA = Search((1.81, 1.51), (1.6, 1.2), 0.08, 0.8)  # the domain is not square, and wider than the array


def noise_of(problem: Problem, share: float, modes=MODES) -> np.ndarray:
    return share * np.mean(np.abs(problem.pressures[modes]) ** 2, axis=1)


def directly(problem: Problem, positions, noise, search, modes=MODES) -> np.ndarray:
    """Return the same maps point by point: the cost with the microphone there, without N log v."""
    layer, p = search.layer(float(positions[N, -1])), problem.pressures[modes]
    field = isotropic_field(p, problem.wavenumbers[modes], noise, problem.dimension)
    costs = []
    for point in layer.reshape(-1, layer.shape[-1]):
        moved = np.where(np.arange(len(positions))[:, None] == N, point, positions)
        costs.append(likelihood_terms(moved, p, field, derivatives=False).costs)
    return (np.transpose(costs) - len(positions) * np.log(noise)[:, None]).reshape(-1, *layer.shape[:2])


def assert_same(maps, expected):
    assert maps.shape == expected.shape
    span = np.ptp(expected, axis=(1, 2))
    assert np.all(span > 1.0), "a flat map shows nothing"
    assert np.all(np.abs(maps - expected).max(axis=(1, 2)) < 1e-7 * span)


@pytest.mark.parametrize("share", [1e-1, 1e-6])
@pytest.mark.parametrize(("dimension", "D"), [(2, 2), (3, 2), (3, 3)])
def test_maps_are_the_likelihood_at_every_point(dimension, D, share):
    """This holds for fields and arrays in a plane and in space; the pressures need not fit."""
    positions = np.column_stack([ROUGH, np.random.default_rng(5).uniform(0.4, 1.0, len(ROUGH))])[:, :D]
    search = CELLAR if D == 3 else AREA
    problem = replace(MEASURED.problem(), dimension=dimension, array_dimension=D, search=search)
    noise = noise_of(problem, share)
    maps = cost.likelihood_maps(problem, positions, N, MODES, noise)
    assert_same(maps, directly(problem, positions, noise, problem.search))


@pytest.mark.parametrize("away", [1.0, 40.0])
def test_a_distant_microphone_leaves_maps_exact_and_does_not_change_later_ones(away):
    problem = replace(MEASURED.problem(), search=AREA)
    noise = noise_of(problem, 1e-4)
    before = cost.likelihood_maps(problem, ROUGH, N, MODES, noise)
    displaced = ROUGH.copy()
    displaced[3] += away
    assert_same(cost.likelihood_maps(problem, displaced, N, MODES, noise), directly(problem, displaced, noise, AREA))
    np.testing.assert_allclose(cost.likelihood_maps(problem, ROUGH, N, MODES, noise), before, rtol=1e-9)


def test_the_map_of_the_joint_solver_assumes_at_least_the_noise_that_the_kernel_needs():
    problem = MEASURED.problem()
    begun = joint.init(problem, SolverSettings(name="joint", modes=40), 0)
    for share, shown in ((1e-3, 1e-3), (1e-10, DIFFUSE_FLOOR)):
        model = replace(begun.model, noise=noise_of(problem, share, slice(None)))
        state = replace(begun, positions=ROUGH, model=model)
        expected = directly(problem, ROUGH, noise_of(problem, shown), problem.search)
        assert_same(joint.landscape(problem, state, N, MODES), expected)
    refuses("search domain", lambda: joint.landscape(replace(problem, search=None), begun, N, MODES))
