"""Laws of what a step minimises: its derivatives, its priors, and what is exact."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_t, t

from fdcal.cost.likelihood import FieldModel
from fdcal.solvers.robust.objective import NU, Objective, Priors, Unknowns, free_directions

COUNT, MODES = 7, 9
KNOWN = np.array([0, 2, 5])


def draws(*shape):
    return np.random.default_rng(sum(shape)).normal(size=shape)


def unknowns(filters: bool = True, gains: bool = True, log_speed: float = 0.0) -> Unknowns:
    """Positions in a metre, gains of a tenth, and delays and corners of some channels."""
    channels = 0.1 * draws(COUNT, 2)
    cut = np.where(np.arange(COUNT)[:, None] % 3 == 1, [[0.3, 0.4]], [[0.0, 0.0]])
    cut[4] = -0.2, -0.5
    channels = np.hstack([channels, cut]) if filters else channels
    return Unknowns(0.3 * draws(COUNT, 2), channels, log_speed, gains)


def objective(known_sigma: float = 2e-3, speed_sigma: float = 5e-3, log_speed: float = 0.0) -> Objective:
    pressures = draws(MODES, COUNT) + 1j * draws(COUNT, MODES).T
    k = np.linspace(2.0, 6.0, MODES)
    noise = 1 + np.abs(draws(COUNT))
    field = FieldModel(k, np.linspace(0.5, 2.0, MODES), np.full(MODES, 0.02), noise, 2)
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
    """By positions, gains, delays, corners and the sound speed, at another speed than the wavenumbers' own, too."""
    here, goal = unknowns(filters, gains, log_speed), objective(log_speed=0.01)
    goal = replace(goal, priors=replace(goal.priors, **spreads))
    gradient = goal.evaluate(here).gradient
    np.testing.assert_allclose(gradient, slopes(goal, here), atol=2e-6 * np.abs(gradient).max())
    assert abs(gradient[-1]) > 1e-3 * np.abs(gradient).max(), "the sound speed counts"


def test_a_faster_sound_is_a_smaller_array_with_shorter_delays_and_higher_corners():
    """The likelihood depends on wavenumber times length alone."""
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
    here = unknowns()
    goal = objective(known_sigma=sigma)
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
    without = replace(goal, priors=flat).evaluate(here, False).cost
    expected = 0.0
    for column, sigma in enumerate((goal.priors.gain_sigma, goal.priors.phase_sigma)):
        e = here.channels[:, column] - goal.priors.offsets[:, column]
        expected += np.sum(t.logpdf(0, NU, scale=sigma) - t.logpdf(e, NU, scale=sigma))
    assert goal.evaluate(here, False).cost - without == pytest.approx(expected, rel=1e-9)
    faster = replace(here, log_speed=0.0105)
    loose = replace(goal, priors=replace(goal.priors, speed_sigma=1e9))
    assert goal.finite_cost(faster) - loose.finite_cost(faster) == pytest.approx(1.5**2 / 2, rel=1e-9)


def test_the_matrix_holds_priors_near_their_centre_as_their_second_derivatives():
    here = unknowns()
    goal = objective()
    centred = replace(
        goal.priors, places=here.positions[KNOWN], offsets=here.channels[:, :2], gain_sigma=0.04, phase_sigma=0.06
    )
    at_centre = replace(goal, priors=centred)
    loose = replace(centred.without_given(), gain_sigma=1e9, phase_sigma=1e9, speed_sigma=0.0)
    springs = np.diag(at_centre.evaluate(here).matrix - replace(goal, priors=loose).evaluate(here).matrix)
    x, step = here.vector, 1e-5
    index = np.concatenate([6 * KNOWN, 6 * KNOWN + 1, [2, 3, x.size - 1]])
    for i in index:
        move = step * np.eye(x.size)[i]
        costs = [
            at_centre.finite_cost(here.at(y)) - replace(goal, priors=loose).finite_cost(here.at(y))
            for y in (x + move, x, x - move)
        ]
        assert springs[i] == pytest.approx((costs[0] - 2 * costs[1] + costs[2]) / step**2, rel=2e-3)


def test_exact_positions_are_no_prior_but_no_unknowns():
    """A prior however stiff would swamp the rest of the cost in rounding."""
    here, goal = unknowns(), objective(known_sigma=0.0)
    alone = replace(goal, priors=goal.priors.without_given())
    one, other = goal.evaluate(here), alone.evaluate(here)
    assert one.cost == other.cost and np.array_equal(one.matrix, other.matrix)
    assert goal.priors.constrained.tolist() == KNOWN.tolist() and not len(objective().priors.constrained)
    index = np.arange(here.vector.size - 1).reshape(COUNT, -1)
    free = free_directions(here, goal.priors.constrained)
    assert not np.isin(index[KNOWN, :2], free).any() and np.isin(index[[1, 3, 4, 6], :2], free).all()
    assert np.isin(index[:, 2:4], free).all(), "their gains are sought"
    assert set(free) & set(index[:, 4:].ravel()) == set(index[:, 4:][here.channels[:, 2:] != 0])
