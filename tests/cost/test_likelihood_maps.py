"""Laws of the likelihood's maps over the search lattice."""

from dataclasses import replace

import numpy as np
import pytest
from fields import measured

from fdcal.cost.likelihood import isotropic_field, likelihood_terms
from fdcal.cost.maps import likelihood_maps, refined
from fdcal.cost.noise import DIFFUSE_FLOOR
from fdcal.model.problem import Problem
from fdcal.model.settings import Search, SolverSettings
from fdcal.model.validation import InputError
from fdcal.solvers import joint as joint

TRUTH = np.random.default_rng(3).uniform(-0.5, 0.5, (24, 2)) + [2.61, 2.31]
MEASURED = measured(TRUTH, [0, 1, 2], highest=250.0, snr_db=40)
ROUGH = TRUTH + np.random.default_rng(4).normal(0, 0.02, TRUTH.shape)
MODES = slice(1, 40, 6)
N = 7
CELLAR = Search((2.01, 1.71, 0.4), (1.2, 1.0, 0.6), 0.1, 0.8)
AREA = Search((1.81, 1.51), (1.6, 1.2), 0.08, 0.8)  # no square, and wider than the array


def noise_of(problem: Problem, share: float, modes=MODES) -> np.ndarray:
    return share * np.mean(np.abs(problem.pressures[modes]) ** 2, axis=1)


def directly(problem: Problem, positions, noise, search, modes=MODES) -> np.ndarray:
    """The same maps, point by point: the cost with the microphone there, but for N log v."""
    layer = search.layer(float(positions[N, -1]))
    p = problem.pressures[modes]
    field = isotropic_field(p, problem.wavenumbers[modes], noise, problem.dimension)
    costs = []
    for point in layer.reshape(-1, layer.shape[-1]):
        moved = np.where(np.arange(len(positions))[:, None] == N, point, positions)
        costs.append(likelihood_terms(moved, p, field, derivatives=False).costs)
    maps = np.transpose(costs) - len(positions) * np.log(noise)[:, None]
    return maps.reshape(-1, *layer.shape[:2])


def assert_same(maps, expected):
    assert maps.shape == expected.shape
    span = np.ptp(expected, axis=(1, 2))
    assert np.all(span > 1.0), "a flat map shows nothing"
    assert np.all(np.abs(maps - expected).max(axis=(1, 2)) < 1e-7 * span)


def in_space(planar: bool) -> tuple[Problem, np.ndarray]:
    """A field of three dimensions at microphones in space or in a plane; that the pressures do not fit is no matter."""
    heights = np.random.default_rng(5).uniform(0.4, 1.0, len(TRUTH))
    positions = ROUGH if planar else np.column_stack([ROUGH, heights])
    search = AREA if planar else CELLAR
    problem = MEASURED.problem()
    return replace(problem, dimension=3, array_dimension=2 if planar else 3, search=search), positions


@pytest.mark.parametrize("share", [1e-1, 1e-3, 1e-6])
def test_maps_in_the_plane_are_the_likelihood_at_every_point(share):
    problem = replace(MEASURED.problem(), search=AREA)
    noise = noise_of(problem, share)
    assert_same(likelihood_maps(problem, ROUGH, N, MODES, noise), directly(problem, ROUGH, noise, AREA))


@pytest.mark.parametrize("share", [1e-2, 1e-6])
@pytest.mark.parametrize("planar", [True, False])
def test_maps_of_a_field_in_space_are_the_likelihood_at_every_point(planar, share):
    problem, positions = in_space(planar)
    noise = noise_of(problem, share)
    maps = likelihood_maps(problem, positions, N, MODES, noise)
    assert_same(maps, directly(problem, positions, noise, problem.search))


@pytest.mark.parametrize("away", [0.0, 1.0, 2.5, 40.0])
def test_microphones_far_out_change_no_law_nor_the_tables_of_those_that_are_not(away):
    problem = replace(MEASURED.problem(), search=AREA)
    noise = noise_of(problem, 1e-4)
    before = likelihood_maps(problem, ROUGH, N, MODES, noise)
    displaced = ROUGH.copy()
    displaced[3] += away
    assert_same(likelihood_maps(problem, displaced, N, MODES, noise), directly(problem, displaced, noise, AREA))
    np.testing.assert_allclose(likelihood_maps(problem, ROUGH, N, MODES, noise), before, rtol=1e-9)


def test_positions_that_are_none_are_refused():
    problem, displaced = MEASURED.problem(), ROUGH.copy()
    displaced[3, 0] = np.nan
    with pytest.raises(np.linalg.LinAlgError, match="finite"):
        likelihood_maps(problem, displaced, N, MODES, noise_of(problem, 1e-3))


def test_a_finer_lattice_shows_the_same_surface():
    problem = replace(MEASURED.problem(), search=AREA)
    fine, noise = refined(AREA, 45), noise_of(problem, 1e-3)
    assert_same(likelihood_maps(problem, ROUGH, N, MODES, noise, fine), directly(problem, ROUGH, noise, fine))


def test_the_joint_solver_shows_the_likelihood_with_no_less_noise_than_the_kernel_bears():
    problem = MEASURED.problem()
    begun = joint.init(problem, SolverSettings(name="joint", modes=40), 0)
    for share, shown in ((1e-3, 1e-3), (1e-10, DIFFUSE_FLOOR)):
        model = replace(begun.model, noise=noise_of(problem, share, slice(None)))
        state = replace(begun, positions=ROUGH, model=model)
        expected = directly(problem, ROUGH, noise_of(problem, shown), problem.search)
        assert_same(joint.landscape(problem, state, N, MODES), expected)
    with pytest.raises(InputError, match="search domain"):
        joint.landscape(replace(problem, search=None), begun, N, MODES)
