"""Eq. 7: its value, the expansion that it needs, and the search of descent over the lattice."""

from dataclasses import replace

import numpy as np
import pytest
from fields import measured
from running import refuses
from solving import run_from

from fdcal import solvers
from fdcal.acoustics.dictionary import fourier_bessel, max_order, spherical_bessel
from fdcal.acoustics.measure import cached_measurement
from fdcal.cost import eq7
from fdcal.cost.lattice import PlaneLattice
from fdcal.cost.maps import eq7_maps, mode_powers, mode_shape
from fdcal.model.problem import ChannelCorrection
from fdcal.model.scene import load_scene
from fdcal.session.scene_edits import edited

TRUTH = np.random.default_rng(3).uniform(-0.5, 0.5, (24, 2)) + [2.61, 2.31]
MEASUREMENT = measured(TRUTH, [0, 1, 2], highest=150.0)
PROBLEM = MEASUREMENT.problem()
ORDERS = max_order(PROBLEM.wavenumbers, 0.8, 2)
CENTRE = TRUTH.mean(axis=0)
GUESS = TRUTH + np.random.default_rng(4).normal(0, 0.05, TRUTH.shape)
CANDIDATES = np.random.default_rng(5).uniform(-0.6, 0.6, (50, 2)) + CENTRE


def test_the_fit_without_a_microphone_gives_eq_7_with_it_anywhere():
    """It is compared with brute force, a pseudo-inverse for every candidate."""
    for p, k, L in zip(PROBLEM.pressures, PROBLEM.wavenumbers, ORDERS, strict=True):
        (fit,) = eq7.leave_one_out_fits([fourier_bessel(GUESS, k, L, CENTRE)], p[None], 7)
        found = fit.cost_of(fourier_bessel(CANDIDATES, k, L, CENTRE))
        for c, candidate in enumerate(CANDIDATES):
            moved = GUESS.copy()
            moved[7] = candidate
            W = fourier_bessel(moved, k, L, CENTRE)
            assert found[c] == pytest.approx(np.sum(np.abs(W @ (np.linalg.pinv(W) @ p) - p) ** 2), abs=1e-10)


@pytest.mark.parametrize("order", [3, 6])
def test_with_fewer_places_than_functions_the_fit_is_the_mean_at_each_place(order):
    """Seven functions fit any pressures at five places; only differences within one place remain."""
    at, k = np.arange(20) % 5, PROBLEM.wavenumbers[[0, 4, 8]]
    p = PROBLEM.pressures[[0, 4, 8]][:, :20]
    means = np.stack([p[:, at == place].mean(axis=1) for place in at], axis=1)
    for one, mean, wavenumber in zip(p, means, k, strict=True):
        W = fourier_bessel(GUESS[at], wavenumber, order, CENTRE)
        np.testing.assert_allclose(W @ eq7.coefficients(W, one), mean, atol=1e-9)
        distinct = one.reshape(4, 5).mean(axis=0)  # Eq. 5 selects the solution of least norm
        shortest = W[:5].conj().T @ np.linalg.solve(W[:5] @ W[:5].conj().T, distinct)
        np.testing.assert_allclose(eq7.coefficients(W, one), shortest, atol=1e-6 * np.abs(shortest).max())
        (fit,) = eq7.leave_one_out_fits([W], one[None], 7)
        np.testing.assert_allclose(fit.cost_of(W[[7]]), np.sum(np.abs(mean - one) ** 2), atol=1e-9)


def test_functions_as_small_as_rounding_errors_explain_nothing():
    """For an array far smaller than the wavelength, J_l(z) is below 1e-12 from some order on."""
    p = np.random.default_rng(6).normal(size=(1, 24)) + 0j
    enough, ample = (eq7.fit(fourier_bessel(GUESS, 0.1, order, CENTRE)[None], p)[2] for order in (8, 11))
    assert ample == pytest.approx(enough, rel=1e-9)


@pytest.mark.parametrize("known_weight", [0.01, 1.0, 50.0])
def test_known_weight_multiplies_the_squared_residual_of_the_known_microphones(known_weight):
    """The fit without microphone n, weighted, is the minimum of sum_i w_i |residual_i|^2, found by brute force."""
    n, m = 7, 3
    W = fourier_bessel(GUESS, PROBLEM.wavenumbers[m], ORDERS[m], CENTRE)
    rows = fourier_bessel(CANDIDATES, PROBLEM.wavenumbers[m], ORDERS[m], CENTRE)
    held = eq7.known_weights(PROBLEM, known_weight)
    (fit,) = eq7.leave_one_out_fits([W], PROBLEM.pressures[m : m + 1], n, weights=held)
    weights = np.ones(len(GUESS))
    weights[[0, 1, 2]] = known_weight
    expected = []
    for row in rows:
        moved = W.copy()
        moved[n] = row
        A, b = np.sqrt(weights)[:, None] * moved, np.sqrt(weights) * PROBLEM.pressures[m]
        error = moved @ (np.linalg.pinv(A) @ b) - PROBLEM.pressures[m]
        expected.append(np.sum(weights * np.abs(error) ** 2))
    np.testing.assert_allclose(fit.cost_of(rows), expected, rtol=1e-7)


# Rows of the dictionary exist at all points; the number of microphones limits the modes.


SPREAD = np.random.default_rng(3).uniform(-0.4, 0.4, (24, 2)) + [2.61, 2.31]
PLANE = measured(SPREAD, [0, 1, 2], modes=14).problem()
ARRAYS = [(2, 2), (3, 3), (3, 2)]  # dimensions of the field and of the array


@pytest.mark.parametrize("scale", [1.0, 4.0])
@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_rows_are_those_of_the_dictionary_up_to_a_factor_of_each_column(dimension, D, scale):
    """This holds inside the tables and beyond them."""
    problem = replace(PLANE, dimension=dimension, array_dimension=D)
    expansion = eq7.FieldExpansion(problem, 0)
    points, centre = scale * np.random.default_rng(0).uniform(-0.5, 0.5, (15, D)), np.full(D, 0.01)
    for group in expansion.groups(range(len(expansion.carried.modes))):
        for number, rows in zip(group, expansion.rows(points, centre, group), strict=True):
            order, k = int(expansion.carried.orders[number]), problem.wavenumbers[expansion.carried.modes[number]]
            W = (fourier_bessel if dimension == 2 else spherical_bessel)(points, complex(k), order, centre)
            assert rows.shape == W.shape == (15, eq7.functions(problem, order))
            factor = np.sum(W * rows.conj(), axis=0) / np.sum(np.abs(rows) ** 2, axis=0)
            assert np.all(np.abs(rows * factor - W) < 1e-9 * np.abs(W).max(axis=0))


@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_a_mode_is_usable_if_it_has_fewer_functions_than_there_are_microphones(dimension, D):
    problem = replace(PLANE, dimension=dimension, array_dimension=D)
    count = eq7.functions(problem, int(eq7.carried_modes(problem, 0).orders[-1]))
    arrays = (replace(problem, pressures=np.ones((14, n), complex)) for n in (count, count + 1))
    exactly, more = (eq7.carried_modes(array, 0).modes for array in arrays)
    assert len(exactly) < len(more)


# The search of descent over the lattice ends at the candidate with the lowest Eq. 7.


LATTICE = PlaneLattice(PROBLEM, 2)


def assert_best(positions, n, centre, modes, weight):
    """Check that the search finds the point of the lattice with the least Eq. 7, summed over the modes."""
    numbers = range(len(LATTICE.orders))[modes]
    W = LATTICE.dictionary(positions, centre, numbers)
    fits = eq7.leave_one_out_fits(W, PROBLEM.pressures[modes], n, eq7.known_weights(PROBLEM, weight))
    rows = (LATTICE.dictionary(LATTICE.points, centre, [m])[0] for m in numbers)
    total = sum(fit.cost_of(w) for fit, w in zip(fits, rows, strict=True))
    place, least = LATTICE.best(centre, modes, fits, positions[n])
    assert least == pytest.approx(total.min(), rel=1e-8, abs=1e-11)
    np.testing.assert_array_equal(place, LATTICE.points[total.argmin()])


@pytest.mark.parametrize("known_weight", [1.0, 1000.0])
@pytest.mark.parametrize("n", [0, 23])
def test_the_search_finds_the_best_point_from_any_array_and_with_a_rank_deficient_dictionary(n, known_weight):
    modes, centre = slice(1, 9), LATTICE.nearest(CENTRE)
    mixed = np.where(np.arange(len(GUESS))[:, None] % 2, LATTICE.nearest(GUESS), GUESS)
    threes = np.repeat(mixed[:8], 3, axis=0)  # three microphones at one place carry few functions
    for positions in (mixed, threes):
        assert_best(positions, n, centre, modes, known_weight)
    assert np.linalg.matrix_rank(LATTICE.dictionary(threes, centre, [8])[0], tol=1e-10) <= 8 < 2 * LATTICE.orders[8] + 1


def test_modes_that_the_microphones_cannot_carry_are_refused():
    problem = measured(TRUTH[:8], [0, 1, 2], highest=300.0).problem()
    refuses(r"2L \+ 1 = .* functions for 8 microphones; use at most", eq7.require_modes, problem, 2, 30)
    refuses("were measured; use at most", eq7.require_modes, problem, 2, 1000)


# This cost compares the positions of all solvers, also of those that estimate faulty channels.

FAULTY = (9, 3)  # channel 9 is inverted, channel 3 is dead


def brute_force(problem, positions, offset):
    """Eq. 7 of every mode with fewer functions than microphones, mode by mode, relative to the power, dB."""
    left = power = 0.0
    for p, k in zip(problem.pressures, problem.wavenumbers, strict=True):
        functions = fourier_bessel if problem.dimension == 2 else spherical_bessel
        L = int(max_order(k, problem.search.radius, offset))
        W = functions(positions, complex(k), L, positions.mean(axis=0))
        if W.shape[1] < len(p):
            left += np.sum(np.abs(p - W @ np.linalg.pinv(W, rcond=1e-13) @ p) ** 2)
            power += np.sum(np.abs(p) ** 2)
    return 10 * np.log10(left / power)


@pytest.mark.parametrize("name", ["tiny", "ball3d", "plane3d"])
def test_the_reference_cost_is_equation_7_of_all_modes_at_one_order(name):
    measurement = cached_measurement(load_scene(name))
    problem, rng = measurement.problem(), np.random.default_rng(0)
    for spread in (0.0, 0.01, 0.3):
        positions = measurement.positions + spread * rng.normal(size=measurement.positions.shape)
        assert eq7.ReferenceCost(problem)(positions) == pytest.approx(brute_force(problem, positions, 2), abs=1e-6)
    raw = eq7.ReferenceCost(measurement.problem("raw"))
    assert raw.count == eq7.ReferenceCost(problem).count and raw(measurement.positions) < -30, "in any unit"
    assert np.isnan(raw(np.nan * positions)) and np.isnan(eq7.decibels(np.nan)) and eq7.decibels(0.0) == -160
    far = measurement.positions + np.eye(measurement.count)[:, :1] * 9.0  # the tables do not reach so far
    assert eq7.ReferenceCost(problem)(far) == pytest.approx(brute_force(problem, far, 2), abs=1e-6)
    n, count, search = int(problem.free[0]), eq7.ReferenceCost(problem).count, problem.search
    positions = measurement.positions + 0.02 * rng.normal(size=measurement.positions.shape)
    there = replace(search, origin=tuple(positions[n].tolist()), size=(search.step,) * len(search.size))
    total = eq7_maps(problem, positions, n, range(1, count + 1), 2, there).sum(axis=0)
    assert eq7.decibels(total[0, 0]) == pytest.approx(eq7.ReferenceCost(problem)(positions), abs=1e-6), "as in a map"


def test_few_microphones_lower_the_order_and_too_few_have_no_reference_cost(tiny):
    problem = tiny.problem()
    six = replace(problem, pressures=problem.pressures[:, :6])
    assert eq7.ReferenceCost(six).order_offset < 2 and np.isfinite(eq7.ReferenceCost(six)(tiny.positions[:6]))
    two = replace(problem, pressures=problem.pressures[:, :2])
    refuses("too few", eq7.ReferenceCost, two)
    refuses("search", lambda: eq7.ReferenceCost(replace(problem, search=None)))
    assert eq7.reference_cost_of(two) is None


@pytest.fixture(scope="module")
def run():
    """`tiny` with faulty channels, calibrated: its problem, and the states of the run."""
    faults = {"inverted": [FAULTY[0]], "dead": [FAULTY[1]], "gain_db": 1.0, "phase_deg": 5.0}
    scene = edited(load_scene("tiny"), {f"faults.{key}": value for key, value in faults.items()})
    measurement, solver = cached_measurement(scene), solvers.load(scene.solver.name)
    problem = measurement.problem(scene.solver.weights, scene.solver.known)
    return problem, run_from(solver, problem, solver.init(problem, scene.solver, scene.seed))


def test_a_map_at_the_estimate_is_the_reference_cost(run):
    problem, states = run
    state, reference_cost, search = states[-1], eq7.ReferenceCost(problem), problem.search
    there = replace(search, origin=tuple(map(float, state.positions[7])), size=(search.step,) * 2)
    modes = range(1, reference_cost.count + 1)
    total = eq7_maps(problem, state.positions, 7, modes, 2, there, state.channels).sum(axis=0)
    assert eq7.decibels(total[0, 0]) == pytest.approx(reference_cost.of(state), abs=1e-6)
    alone = [eq7_maps(problem, state.positions, 7, (mode,), 2, there, state.channels)[0, 0, 0] for mode in modes]
    powers = mode_powers(problem, solvers.load(state.solver), state, modes, 2)
    assert powers @ alone / powers.sum() == pytest.approx(total[0, 0], rel=1e-9)


def test_gains_multiplied_into_the_pressures_are_removed_again(tiny):
    problem, x, rng = tiny.problem(), tiny.positions, np.random.default_rng(3)
    gains = np.exp(0.3 * rng.normal(size=len(x)) + 3j * rng.normal(size=len(x)))
    spoiled = replace(problem, pressures=problem.pressures * gains)
    channels = ChannelCorrection(gains, np.ones(len(x)))
    assert eq7.ReferenceCost(spoiled)(x, channels) == pytest.approx(eq7.ReferenceCost(problem)(x), abs=1e-6)
    assert eq7.ReferenceCost(spoiled)(x) > eq7.ReferenceCost(problem)(x) + 20
    maps = (eq7_maps(spoiled, x, 9, (1, 5), 2, None, channels), eq7_maps(problem, x, 9, (1, 5), 2))
    np.testing.assert_allclose(*maps, rtol=1e-6, atol=1e-12)
    turned = replace(spoiled, pressures=spoiled.pressures * np.exp(0.8j))  # the phase of a mode is unknown
    turned_shape, level = mode_shape(turned, x, 5, 2, channels, 9)
    shape, right = mode_shape(problem, x, 5, 2, None, 9)
    np.testing.assert_allclose(turned_shape, shape, atol=1e-9)
    assert level == pytest.approx(right, abs=1e-9)


def test_a_channel_of_infinite_noise_is_as_if_it_were_left_out(tiny):
    problem, x = tiny.problem(), np.array(tiny.positions)
    low = slice(0, 8)  # one microphone fewer can carry these modes
    problem = replace(problem, pressures=problem.pressures[low], wavenumbers=problem.wavenumbers[low])
    x[:-1] += 0.01 * np.random.default_rng(4).normal(size=x[:-1].shape)
    x[-1] = x[:-1].mean(axis=0)  # the centre of the expansion does not change
    noise = np.append(np.ones(len(x) - 1), 1e14)
    fewer = replace(problem, pressures=problem.pressures[:, :-1])
    assert eq7.ReferenceCost(problem).count == eq7.ReferenceCost(fewer).count == 8
    expected = eq7.ReferenceCost(fewer)(x[:-1])
    assert eq7.ReferenceCost(problem)(x, ChannelCorrection(np.ones(len(x)), noise)) == pytest.approx(expected, abs=1e-6)
