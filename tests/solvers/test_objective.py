"""Laws of what a step minimises: its derivatives, its priors, and what is exact."""

from dataclasses import replace

import numpy as np
import pytest
from fields import measured
from scipy.stats import multivariate_t, t
from solving import rms_of_shape, saved_and_read, solved

from fdcal.cost.likelihood import FieldModel
from fdcal.model.measurement import Measurement
from fdcal.model.settings import SolverSettings
from fdcal.solvers import robust as solver
from fdcal.solvers.robust.arrivals import Arrivals, arrivals_of, updated_sigma
from fdcal.solvers.robust.objective import NU, Objective, Priors, Unknowns

COUNT, MODES = 7, 9
KNOWN = np.array([0, 2, 5])


def draws(*shape):
    return np.random.default_rng(sum(shape)).normal(size=shape)


def unknowns(filters: bool = True, gains: bool = True, log_speed: float = 0.0) -> Unknowns:
    """Return positions within a metre, gains of a tenth, and delays and corners of some channels."""
    channels = 0.1 * draws(COUNT, 2)
    cut = np.where(np.arange(COUNT)[:, None] % 3 == 1, [[0.3, 0.4]], [[0.0, 0.0]])
    cut[4] = -0.2, -0.5
    channels = np.hstack([channels, cut]) if filters else channels
    return Unknowns(0.3 * draws(COUNT, 2), channels, log_speed, gains)


def objective(known_sigma: float = 2e-3, speed_sigma: float = 5e-3, log_speed: float = 0.0) -> Objective:
    pressures, k = draws(MODES, COUNT) + 1j * draws(COUNT, MODES).T, np.linspace(2.0, 6.0, MODES)
    field = FieldModel(k, np.linspace(0.5, 2.0, MODES), np.full(MODES, 0.02), 1 + np.abs(draws(COUNT)), 2)
    places = unknowns().positions[KNOWN] + 1e-3 * draws(len(KNOWN), 2)
    priors = Priors(0.05, 0.03, KNOWN, places, known_sigma, 0.02 * draws(COUNT, 2), speed_sigma)
    return Objective(pressures, field, priors, log_speed)


def slopes(goal: Objective, here: Unknowns, step: float = 1e-6) -> np.ndarray:
    """Gradient by central differences of the cost alone."""
    x = here.vector
    moves = step * np.eye(x.size)
    return np.array([goal.finite_cost(here.at(x + m)) - goal.finite_cost(here.at(x - m)) for m in moves]) / (2 * step)


@pytest.mark.parametrize(
    ("filters", "gains", "spreads"),
    [(True, True, {}), (True, True, {"delay_sigma": 0.1, "corner_sigma": 0.3}), (False, True, {}), (False, False, {})],
    ids=["faulty filters", "filters of all", "gains", "positions"],
)
@pytest.mark.parametrize("log_speed", [0.0, 0.03])
def test_the_gradient_is_that_of_the_cost(filters, gains, spreads, log_speed):
    """This holds for positions, gains, delays, corners and sound speed, also at another speed than the assumed one."""
    here, goal = unknowns(filters, gains, log_speed), objective(log_speed=0.01)
    goal = replace(goal, priors=replace(goal.priors, **spreads))
    gradient = goal.evaluate(here).gradient
    np.testing.assert_allclose(gradient, slopes(goal, here), atol=2e-6 * np.abs(gradient).max())
    assert abs(gradient[-1]) > 1e-3 * np.abs(gradient).max(), "the sound speed counts"


def test_a_faster_sound_is_a_smaller_array_with_shorter_delays_and_higher_corners():
    """The likelihood depends only on the product of wavenumber and length."""
    here, goal = unknowns(log_speed=0.0), objective(speed_sigma=0.0)
    goal = replace(goal, priors=replace(goal.priors.without_given(), gain_sigma=1e6, phase_sigma=1e6))
    faster, channels = 0.04, here.channels.copy()
    channels[:, 2] *= np.exp(faster)
    channels[:, 3] *= np.exp(-faster)
    other = replace(here, positions=here.positions * np.exp(faster), channels=channels, log_speed=faster)
    assert goal.evaluate(other).terms.cost == pytest.approx(goal.evaluate(here).terms.cost, rel=1e-12)


@pytest.mark.parametrize("sigma", [1e-3, 0.02])
def test_the_prior_of_a_given_position_is_that_of_student(sigma):
    """A microphone is constrained by the density of its deviation: neither more firmly nor less."""
    here, goal = unknowns(), objective(known_sigma=sigma)
    placed = replace(goal, priors=replace(goal.priors, places=here.positions[KNOWN]))
    density = multivariate_t(np.zeros(2), sigma**2 * np.eye(2), df=NU)
    for away in ([0.5, 0.0], [2.0, -1.0], [30.0, 5.0]):
        places = here.positions[KNOWN] - np.outer([0, 1, 0], sigma * np.array(away))
        moved = replace(goal, priors=replace(goal.priors, places=places))
        rise = moved.evaluate(here, False).cost - placed.evaluate(here, False).cost
        assert rise == pytest.approx(density.logpdf([0, 0]) - density.logpdf(sigma * np.array(away)), rel=1e-6)


def test_the_priors_of_gains_phases_and_sound_speed_are_those_stated():
    here, goal = unknowns(False), objective(speed_sigma=7e-3)
    flat = replace(goal.priors, gain_sigma=1e9, phase_sigma=1e9)
    without, expected = replace(goal, priors=flat).evaluate(here, False).cost, 0.0
    for column, sigma in enumerate((goal.priors.gain_sigma, goal.priors.phase_sigma)):
        e = here.channels[:, column] - goal.priors.offsets[:, column]
        expected += np.sum(t.logpdf(0, NU, scale=sigma) - t.logpdf(e, NU, scale=sigma))
    assert goal.evaluate(here, False).cost - without == pytest.approx(expected, rel=1e-9)
    faster = replace(here, log_speed=0.0105)
    loose = replace(goal, priors=replace(goal.priors, speed_sigma=1e9))
    assert goal.finite_cost(faster) - loose.finite_cost(faster) == pytest.approx(1.5**2 / 2, rel=1e-9)


def test_the_matrix_holds_priors_near_their_centre_as_their_second_derivatives():
    here, goal = unknowns(), objective()
    centred = replace(goal.priors, places=here.positions[KNOWN], offsets=here.channels[:, :2])
    centred = replace(centred, gain_sigma=0.04, phase_sigma=0.06)
    at_centre = replace(goal, priors=centred)
    loose = replace(centred.without_given(), gain_sigma=1e9, phase_sigma=1e9, speed_sigma=0.0)
    springs = np.diag(at_centre.evaluate(here).matrix - replace(goal, priors=loose).evaluate(here).matrix)
    x, step = here.vector, 1e-5
    index = np.concatenate([6 * KNOWN, 6 * KNOWN + 1, [2, 3, x.size - 1]])
    for i in index:
        move = step * np.eye(x.size)[i]
        places = [here.at(y) for y in (x + move, x, x - move)]
        costs = [at_centre.finite_cost(y) - replace(goal, priors=loose).finite_cost(y) for y in places]
        assert springs[i] == pytest.approx((costs[0] - 2 * costs[1] + costs[2]) / step**2, rel=2e-3)


def test_exact_positions_have_no_prior_and_are_not_among_the_unknowns():
    """A very stiff prior would make rounding errors larger than the rest of the cost."""
    here, goal = unknowns(), objective(known_sigma=0.0)
    one, other = goal.evaluate(here), replace(goal, priors=goal.priors.without_given()).evaluate(here)
    assert one.cost == other.cost and np.array_equal(one.matrix, other.matrix)
    assert goal.priors.constrained.tolist() == KNOWN.tolist() and not len(objective().priors.constrained)
    index, free = np.arange(here.vector.size - 1).reshape(COUNT, -1), goal.free(here)
    assert not np.isin(index[KNOWN, :2], free).any() and np.isin(index[[1, 3, 4, 6], :2], free).all()
    assert np.isin(index[:, 2:4], free).all(), "their gains are sought"
    assert set(free) & set(index[:, 4:].ravel()) == set(index[:, 4:][here.channels[:, 2:] != 0])


# The likelihood uses the arrival times of the direct sound: first the term alone, then a calibration.

DISTANCES = np.array([1.0, 1.5, 2.5, 5.0, 1e4])  # m, from the array to each source


def simulated_arrivals(positions, dimension, sigma=5e-3, scatter=1e-3, takes=5, seed=0):
    """Arrivals of sources at several distances, one of them an outlier and one missing, and the sources."""
    rng, (N, D) = np.random.default_rng(seed), positions.shape
    sources = rng.normal(size=(takes, dimension))
    sources *= (np.resize(DISTANCES, takes) / np.linalg.norm(sources, axis=1))[:, None]
    x = np.pad(positions, ((0, 0), (0, dimension - D)))
    paths = np.linalg.norm(x[None] - sources[:, None], axis=2) + scatter * rng.normal(size=(takes, N))
    paths -= np.median(paths, axis=1, keepdims=True)
    used = np.ones((takes, N), bool)
    if scatter:
        paths[1, 3] += 0.3
        used[2, 5], paths[2, 5] = False, 0.0
    return Arrivals(paths, used, np.full(takes, sigma), np.full(takes, 1e-3), dimension)


def array(count=12, axes=3, seed=1):
    return 0.2 * np.random.default_rng(seed).normal(size=(count, axes))


@pytest.mark.parametrize(("axes", "dimension", "delayed"), [(3, 3, True), (2, 3, False), (2, 2, True)])
def test_gradient_is_that_of_differences(axes, dimension, delayed):
    """This holds for coordinates, delays of the channels, if any, and the sound speed."""
    x = array(axes=axes)
    arrivals = simulated_arrivals(x, dimension)
    y, log_speed, h = x + 4e-3 * np.random.default_rng(2).normal(size=x.shape), 0.01, 1e-6
    delays = 1e-3 * np.random.default_rng(5).normal(size=len(x)) * delayed
    steps = h * np.random.default_rng(6).normal(size=(9, x.size + delayed * len(x) + 1))
    steps[0, :-1] = 0.0  # the sound speed alone

    def cost(step) -> float:
        later = delays + step[x.size : -1] if delayed else None
        return arrivals.terms(y + step[: x.size].reshape(x.shape), log_speed + step[-1], False, later).cost

    expected = np.array([cost(step) - cost(-step) for step in steps]) / (2 * h)
    found = arrivals.terms(y, log_speed, True, delays if delayed else None)
    assert np.allclose(steps @ found.gradient.sum(axis=0) / h, expected, atol=1e-4 * np.abs(expected).max())
    assert np.linalg.eigvalsh(found.matrix).min() > -1e-6 * np.linalg.eigvalsh(found.matrix).max()


@pytest.mark.parametrize("seed", [9, 1])  # only one seed puts the farthest source at the bound of its distance
def test_the_matrix_is_the_slope_of_the_gradient_where_residuals_are_small(seed):
    x, h, steps = array(), 1e-5, np.random.default_rng(0).normal(size=(6, 12, 3))
    arrivals = simulated_arrivals(x, 3, scatter=3e-4, seed=seed)
    ends = [[arrivals.terms(x + step).gradient.sum(axis=0) for step in sign * h * steps] for sign in (1, -1)]
    matrix = arrivals.terms(x).matrix[:-1]
    assert np.allclose(np.subtract(*ends) / (2 * h), steps.reshape(6, -1) @ matrix, atol=0.01 * matrix.max())


def test_an_array_that_is_moved_turned_and_mirrored_costs_the_same():
    x, rng = array(), np.random.default_rng(3)
    arrivals, y = simulated_arrivals(x, 3), x + 4e-3 * rng.normal(size=x.shape)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0] @ np.diag([1, 1, -1])
    one, other = arrivals.terms(y), arrivals.terms(y @ turn.T + [3.0, -2.0, 1.0])
    assert other.cost == pytest.approx(one.cost, rel=1e-7)
    slopes = one.gradient[:, :-1].sum(axis=0).reshape(x.shape) @ turn.T
    assert np.allclose(other.gradient[:, :-1].sum(axis=0).reshape(x.shape), slopes, atol=1e-4 * np.abs(slopes).max())


def test_an_outlier_has_no_weight():
    x = array()
    terms = simulated_arrivals(x, 3, sigma=1e-3).terms(x)
    assert terms.weight[1, 3] < 1e-3 * np.median(terms.weight) and np.all(terms.weight[2, 5] == 0)
    assert np.abs(terms.residual[1, 3]) == pytest.approx(0.3, abs=5e-3)


def test_scatter_and_sigma_are_those_of_the_times():
    x = array(count=40)
    arrivals = simulated_arrivals(x, 3, scatter=3e-3)
    assert np.allclose(arrivals.scatter(x), np.hypot(1e-3, 3e-3), rtol=0.4)
    sigma, none = arrivals.sigma, np.zeros((x.size + 1,) * 2)
    for _ in range(20):
        now = replace(arrivals, sigma=sigma)
        sigma = updated_sigma(now, now.terms(x), none)
    assert np.all((sigma > 1.5e-3) & (sigma < 4e-3))
    wrong = replace(arrivals, paths=arrivals.paths + np.random.default_rng(5).uniform(0, 1, arrivals.paths.shape))
    assert np.all(wrong.scatter(x) > 0.05)


def test_a_take_with_too_few_arrivals_says_nothing():
    problem = takes_of(2).problem(known="none")
    times = np.array(problem.arrivals)
    times[1, 3:] = np.nan
    found = arrivals_of(replace(problem, arrivals=times), None)
    assert found is not None and len(found.paths) == 1
    assert arrivals_of(replace(problem, arrivals=0 * times + np.nan), None) is None


def test_arrival_times_that_channels_delay_cost_nothing_at_these_delays():
    x = array()
    arrivals, delays = simulated_arrivals(x, 3, scatter=0.0), 0.02 * np.random.default_rng(3).normal(size=12)
    late = replace(arrivals, paths=arrivals.paths + delays)
    assert late.terms(x, 0.0, False, delays).cost == pytest.approx(arrivals.terms(x, 0.0, False).cost, abs=1e-9)
    assert late.terms(x, 0.0, False).cost > 10


SOURCES = ((5.47, 4.53), (0.61, 4.38), (0.52, 0.83), (5.23, 0.47))  # m, in a rigid room of 6 x 5 m


def takes_of(count: int, snr_db: float = 15.0) -> Measurement:
    """Takes of 16 microphones in a plane field with noise, with arrivals that are right to 1 mm."""
    rng = np.random.default_rng(6)
    x, each = np.array([2.0, 1.7]) + 1.2 * rng.uniform(size=(16, 2)), []
    for seed, source in enumerate(SOURCES[:count]):
        one = measured(x, (), snr_db=snr_db, seed=seed, source=source, modes=16)
        times = (np.linalg.norm(x - np.array(source), axis=1) + 1e-3 * rng.normal(size=16)) / 343.0
        each.append(replace(one, search=None, arrivals=times[None], arrival_sigma=1e-3 / 343.0))
    return Measurement.from_takes(each)


def without(measurement: Measurement) -> Measurement:
    return replace(measurement, arrivals=None, arrival_sigma=None)


@pytest.fixture(scope="module")
def four():
    return takes_of(4)


def test_arrivals_of_several_takes_make_an_array_exact(four):
    before, after = (rms_of_shape(solved(one).estimate.positions, four.positions) for one in (without(four), four))
    assert after < min(4e-3, 0.3 * before)


def test_wrong_times_change_nothing():
    right, rng = takes_of(2), np.random.default_rng(7)
    wrong = replace(right, arrivals=rng.uniform(0, 8e-3, right.arrivals.shape))
    plain, found = (solved(one).estimate.positions for one in (without(right), wrong))
    assert rms_of_shape(found, plain) < 0.2 * rms_of_shape(plain, right.positions)


def test_a_step_of_the_solver_starts_from_the_last_sources(four, monkeypatch):
    problem, counts = four.problem(known="none"), []
    state = solver.init(problem, SolverSettings(modes=len(four.frequencies)), 0, four.positions)
    search = Arrivals._sources
    monkeypatch.setattr(Arrivals, "_sources", lambda *args: counts.append(1) or search(*args))
    solver.step(problem, state)
    seen = len(counts)
    monkeypatch.setattr(Objective, "with_start", lambda self, _: self)
    solver.step(problem, state)
    assert 0 < seen < len(counts) - seen


def test_the_origin_of_a_take_is_arbitrary(four):
    shifted = replace(four, arrivals=four.arrivals + np.array([0.0, 1.0, -0.2, 30.0])[:, None])
    one, other = (arrivals_of(measurement.problem(known="none"), None) for measurement in (four, shifted))
    np.testing.assert_allclose(other.paths, one.paths, atol=1e-9)


def test_the_sigmas_of_the_arrivals_survive_a_session(four):
    end = solved(four)
    sigma, read = end.state.model.arrival_sigma, saved_and_read(end.problem, end.state)
    assert sigma is not None and np.array_equal(read.model.arrival_sigma, sigma)
