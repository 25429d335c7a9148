"""Laws of the starts: affine, from the coherence, and random, and of the choice among many."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from fields import measured, waves
from running import refuses
from scipy.spatial.distance import pdist
from solving import rms_of_shape

from fdcal import solvers
from fdcal.model.gauge import align, position_errors
from fdcal.model.measurement import Measurement
from fdcal.model.settings import SolverSettings
from fdcal.solvers import starts
from fdcal.solvers.robust import search
from fdcal.solvers.robust.state import SEARCH

KNOWN = [0, 1, 2, 3]


def affine_problem(D, known, offsets=1.0):
    """Problem of pressures that are exactly affine in the positions, and the truth (N, D)."""
    rng = np.random.default_rng(D)
    truth = rng.uniform(-0.5, 0.5, (30, D)) + 2.5
    base = measured(truth[:, :2], [])
    modes = len(base.frequencies)
    slopes = base.wavenumbers.real[:, None] * (rng.normal(size=(modes, D)) + 1j * rng.normal(size=(modes, D)))
    pressures = slopes @ (truth - truth.mean(axis=0)).T + offsets * rng.normal(size=(modes, 1))
    chosen = {"known": known, "known_positions": truth[known] if known else None}
    affine = replace(base, dimension=D, array_dimension=D, pressures=pressures, positions=truth, search=None, **chosen)
    return affine.problem("raw"), truth


@pytest.mark.parametrize("D", [2, 3])
def test_the_affine_start_is_exact_for_an_affine_field(D):
    problem, truth = affine_problem(D, KNOWN[: D + 1])
    for lowest in (None, 8, 40):
        np.testing.assert_allclose(starts.affine(problem, 40, lowest), truth, atol=1e-9)


@pytest.mark.parametrize("D", [2, 3])
def test_a_blind_affine_start_is_an_affine_image_of_the_truth(D):
    """The pressures of an affine field do not determine which image."""
    problem, truth = affine_problem(D, [])
    found = starts.affine(problem, 40)
    extended = np.column_stack([truth, np.ones(len(truth))])
    image = extended @ np.linalg.lstsq(extended, found, rcond=None)[0]
    np.testing.assert_allclose(found, image, atol=1e-9)
    assert np.linalg.matrix_rank(found - found.mean(axis=0), tol=1e-6) == D


def test_a_random_start_fills_the_search_domain_and_keeps_the_known():
    truth = np.random.default_rng(7).uniform(-0.5, 0.5, (40, 2)) + [2.61, 2.31]
    problem = measured(truth, KNOWN).problem()
    one, again, other = (starts.random(problem, np.random.default_rng(seed)) for seed in (0, 0, 1))
    assert np.array_equal(one, again) and not np.array_equal(one, other)
    assert np.array_equal(one[KNOWN], truth[KNOWN])
    low, high = np.array(problem.search.origin), np.add(problem.search.origin, problem.search.size)
    assert np.all((one >= low) & (one <= high)) and np.ptp(one, axis=0).min() > 0.8
    refuses("needs a search domain", lambda: starts.random(replace(problem, search=None), np.random.default_rng(0)))


FREQUENCIES = np.linspace(40.0, 320.0, 48)
K = 2 * np.pi * FREQUENCIES / 343.0


@pytest.mark.parametrize(("D", "noise"), [(2, 0.01), (3, 0.01), (2, 0.3)])
def test_distances_of_near_pairs_follow_from_the_coherence(D, noise):
    """Noise lowers the coherence as a distance does, unless it is taken into account."""
    rng = np.random.default_rng(1)
    x, k = rng.uniform(0, 1.0, (12, D)), np.linspace(1.0, 6.0, 600)
    found, _ = starts.pair_distances(waves(x, k, 40, rng, noise), k, noise, D)
    np.testing.assert_allclose(found, found.T)
    apart, pairs = np.linalg.norm(x[:, None] - x[None], axis=-1), np.triu_indices(12, 1)
    off = np.log(found[pairs] / apart[pairs])
    assert np.median(np.abs(off)) < 0.06 if noise < 0.1 else abs(np.median(off)) < 0.05


@pytest.mark.parametrize("noise", [1e-3, 0.1])
def test_the_coherence_gives_a_start_for_an_array_of_three_wavelengths(noise):
    rng = np.random.default_rng(5)
    x = rng.uniform(0, 3.2, (50, 2))
    p = waves(x, K, 40, rng, noise)
    assert rms_of_shape(starts.coherence_start(p, K, noise, 2, 2), x) < 0.2
    unknown = starts.coherence_start(p, K, None, 2, 2)
    assert rms_of_shape(unknown, x) < 0.2, "the noise is chosen by likelihood where none is reported"
    problem = Measurement(pressures=p, frequencies=FREQUENCIES, sound_speed=343.0).problem("unit")
    assert rms_of_shape(starts.affine(problem, len(K)), x) > 0.4, "the low modes are not affine over so large an array"


def test_the_shape_of_a_start_does_not_depend_on_the_unit_of_length():
    """This also holds for a plane array whose start is sought in space."""
    x, k = np.pad(np.random.default_rng(1).uniform(0, 0.6, (12, 2)), ((0, 0), (0, 1))), np.linspace(1.0, 6.0, 100)
    p = waves(x, k, 40, 1, 0.01)
    metres, kilometres = (starts.coherence_start(p, k * unit, 0.01, 3, 3) for unit in (1.0, 1e3))
    np.testing.assert_allclose(1e3 * pdist(kilometres), pdist(metres), rtol=0, atol=1e-9)


@pytest.mark.parametrize(("extent", "seen"), [(0.1, [3, 5]), (3.2, [])])
def test_inverted_channels_are_detected_if_the_array_is_small_compared_with_the_wavelength(extent, seen):
    x, sign = np.random.default_rng(6).uniform(0, extent, (12, 2)), np.where(np.isin(range(12), [3, 5]), -1, 1)
    problem = Measurement(FREQUENCIES, sign * waves(x, K, 40, 1, 0.01), 343.0).problem("unit")
    assert np.flatnonzero(starts.inverted(problem)).tolist() == seen


def three_wavelengths(noise=1e-4, known=(), wrong=0.0):
    """A problem of 42 microphones over 3.2 m, the first state of the solver at the truth, and the truth (N, 2)."""
    x = np.random.default_rng(6).uniform(0, 3.2, (42, 2))
    p, given = waves(x, K, 40, np.random.default_rng(1), noise), list(known)
    places = x[given] + wrong * (np.arange(len(given)) == 1)[:, None] if given else None
    problem = Measurement(FREQUENCIES, p, 343.0, known=given, known_positions=places).problem("unit")
    settings = SolverSettings(name="robust", modes=len(K))
    return problem, solvers.load("robust").init(problem, settings, 0, x), x


def searched(problem, state):
    """The first restart after the search for starts."""
    state = replace(state, progress=replace(state.progress, stage=SEARCH, steps=0))
    while state.progress.stage == SEARCH:
        state = solvers.load("robust").step(problem, state)
    return state


def test_low_frequencies_first_reach_an_array_that_a_fit_to_all_frequencies_misses():
    problem, state, x = three_wavelengths()
    start = x + np.random.default_rng(2).normal(0, 0.5, x.shape)
    gradually, at_once = (search.fitted(problem, state, start, n) for n in (5, len(K)))
    assert rms_of_shape(gradually.positions, x) < 5e-3 < 0.2 < rms_of_shape(at_once.positions, x)
    assert gradually.cost < at_once.cost - search.WORSE, "the likelihood shows which of them is right"


def test_before_the_first_step_given_positions_are_where_they_are_given():
    problem = measured(np.random.default_rng(4).uniform(2.0, 2.6, (12, 2)), KNOWN).problem("unit")
    state = solvers.load("robust").init(problem, solvers.with_mode_count(problem, SolverSettings()), 0)
    np.testing.assert_array_equal(state.positions[KNOWN], problem.known_positions)


def test_the_search_ends_when_two_starts_agree_and_none_has_ended_elsewhere():
    problem, state, x = three_wavelengths()
    one = search.fitted(problem, state, x, len(K))
    state = replace(state, starts=(one,), progress=replace(state.progress, stage=SEARCH, steps=0))
    assert not search.is_complete(problem, state)
    (again,) = (state := search.step(problem, state)).starts
    assert again.hits == 2 and search.is_complete(problem, state)
    elsewhere = replace(one, positions=one.positions * 1.3, cost=one.cost + 1)
    assert not search.is_complete(problem, replace(state, starts=(again, elsewhere)))
    assert search.is_complete(problem, replace(state, starts=(replace(again, hits=search.AGREEING), elsewhere)))


def test_four_arrays_are_refined_at_most_none_far_less_likely_and_singular_ones_if_there_are_no_others():
    problem, state, x = three_wavelengths()
    one = search.fitted(problem, state, x, len(K))
    singular, far, *near = (replace(one, cost=cost) for cost in (np.inf, 101.0, *np.arange(6.0)))
    for found, refined in ((near, near[:4]), ([near[0], far, singular], near[:1]), ([singular], [singular])):
        assert search.likely(problem, replace(state, starts=tuple(found))) == tuple(refined)


def test_the_likeliest_candidate_is_the_array_and_others_are_different_arrays():
    problem, state, x = three_wavelengths(0.1)
    begun = searched(problem, state)
    assert rms_of_shape(begun.positions, x) < 0.03 and len(begun.starts) < search.MAX_RESTARTS
    for one, other in combinations(begun.starts, 2):
        assert one.cost < other.cost and not search.same_array(problem, other, one.positions)


def test_a_wrong_given_position_moves_no_other_microphone_of_the_likeliest_candidate():
    problem, state, x = three_wavelengths(known=(0, 5, 9, 14, 20), wrong=0.3)
    assert np.delete(position_errors(searched(problem, state).positions, x), 5).max() < 0.02


@pytest.mark.parametrize("D", [2, 3])
def test_an_array_is_aligned_with_the_given_positions_that_agree(D):
    rng = np.random.default_rng(D)
    x, turn = rng.normal(size=(7, D)), np.linalg.qr(rng.normal(size=(D, D)))[0]
    places = x @ turn + 3.0
    places[2] += 1.0
    chosen = starts.best_subset(x, places)
    off = np.linalg.norm(align(x, places, chosen) - places, axis=1)
    assert len(chosen) == D + 1 and np.flatnonzero(off > 1e-9).tolist() == [2]
