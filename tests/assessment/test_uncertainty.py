"""Laws of the covariances: ellipses cover what they say, whatever the units, the frame and the order of the modes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fields import measured
from scipy.special import jv

from fdcal.assessment.assess import assess
from fdcal.assessment.uncertainty import (
    covariance_of,
    curvature_of,
    ellipse_axes,
    one_sigma,
    scale_sigma_of,
    search_spread_of,
)
from fdcal.model.gauge import align, rigid_motions
from fdcal.model.measurement import Measurement
from fdcal.model.settings import SolverSettings
from fdcal.solvers import load
from fdcal.solvers.estimate import Estimate, TriedOptimum
from fdcal.solvers.robust.result import estimate_at

TRUTH = np.random.default_rng(5).uniform(-0.5, 0.5, (9, 2)) + [2.6, 2.3]
KNOWN, NONE = np.array([0, 4, 7]), np.zeros(0, int)
EVERY = np.ones(len(TRUTH), bool)
K, NOISE, C = np.linspace(0.5, 4.2, 16), 1e-3, 343.0


def diffuse(rng, known=NONE, noise=NOISE, positions=TRUTH, wavenumbers=K) -> Measurement:
    """Pressures of a diffuse field in noise at 9 microphones."""
    apart = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    G = np.linalg.cholesky(jv(0, wavenumbers[:, None, None] * apart) + noise * np.eye(len(positions)))
    draws = rng.standard_normal((2, len(wavenumbers), len(positions), 1)) * np.sqrt(0.5)
    return Measurement(
        wavenumbers * C / (2 * np.pi), (G @ (draws[0] + 1j * draws[1]))[..., 0], C, positions=positions, known=known,
        known_positions=positions[known] if len(known) else None, noise_power=np.full(len(wavenumbers), noise),
    )  # fmt: skip


def at(measurement: Measurement, positions=TRUTH, **settings) -> Estimate:
    """The estimate of positions, whoever found them."""
    chosen = SolverSettings(name="descent", **settings)
    return estimate_at(
        measurement.problem("unit", "all"), chosen, positions, slice(0, len(measurement.frequencies)), True
    )


def ended(measurement: Measurement) -> Estimate:
    """Where solver joint ends that begins at the truth."""
    solver, problem = load("joint"), measurement.problem("unit", "all")
    settings = SolverSettings(name="joint", modes=len(measurement.frequencies))
    state = solver.init(problem, settings, 0, positions=measurement.positions)
    while not state.finished:
        state = solver.step(problem, state)
    return solver.result(problem, state)


@pytest.fixture(scope="module")
def known() -> Estimate:
    return at(diffuse(np.random.default_rng(0), KNOWN))


@pytest.fixture(scope="module")
def blind() -> Estimate:
    return at(diffuse(np.random.default_rng(0)))


@pytest.mark.parametrize("given", [KNOWN, NONE], ids=["known", "blind"])
def test_95_percent_ellipses_cover_95_percent(given):
    """Of draws of a diffuse field; they may cover more, since a room's field is less isotropic than assumed."""
    rng, covered, ratios, free = np.random.default_rng(1), [], [], np.setdiff1d(np.arange(len(TRUTH)), given)
    for _ in range(20):
        found = ended(diffuse(rng, given))
        x = found.positions if len(given) else align(found.positions, TRUTH)
        blocks, error = covariance_of(found if len(given) else replace(found, positions=x)), x - TRUTH
        if not len(given):
            turn = np.linalg.lstsq(found.positions - found.positions.mean(axis=0), x - x.mean(axis=0), rcond=None)[0]
            blocks = turn.T @ blocks @ turn
        ratios.append(np.sum(error[free] ** 2) / np.sum(one_sigma(blocks)[free] ** 2))
        along = np.linalg.solve(blocks[free], error[free][..., None])[..., 0]
        covered.append(np.mean(np.sum(error[free] * along, axis=1) < -2 * np.log(0.05)))
    sampling = np.std(covered) / np.sqrt(len(covered))
    assert np.mean(covered) > 0.95 - 3 * sampling - 0.015
    assert np.sqrt(np.mean(ratios)) > 0.4


def test_one_sigma_is_the_error_of_rooms():
    """Standing waves are not as diffuse as assumed; the curvature alone would promise too much."""
    claimed, error = [], []
    for seed in range(5):
        found = ended(measured(TRUTH, KNOWN, highest=230, snr_db=40, seed=seed, source=(5.6 - 0.2 * seed, 4.5)))
        claimed.append(np.mean(one_sigma(covariance_of(found)) ** 2))
        error.append(np.mean(np.sum((found.positions - TRUTH) ** 2, axis=1)))
    claimed, error = np.sqrt(np.mean(claimed)), np.sqrt(np.mean(error))
    assert error / 2.5 < claimed < 2.5 * error


def test_what_the_step_left_and_the_assumed_field_move_a_microphone_is_part_of_its_covariance(known):
    rng, none = np.random.default_rng(0), np.zeros_like(TRUTH)
    step, shift = 1e-3 * rng.normal(size=(2, *TRUTH.shape))
    alone = covariance_of(replace(known, spread=replace(known.spread, step=none, shift=none)))
    for a, b in ((step, none), (none, shift), (step, shift)):
        found = covariance_of(replace(known, spread=replace(known.spread, step=a, shift=b)))
        expected = alone + np.einsum("ni,nj->nij", a, a) + np.einsum("ni,nj->nij", b, b)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-18)


def test_known_microphones_have_no_uncertainty_and_noise_adds_to_that_of_the_others(known):
    sigma = one_sigma(covariance_of(known))
    assert not sigma[KNOWN].any() and np.all(np.delete(sigma, KNOWN) > 0)
    noisier = at(diffuse(np.random.default_rng(0), KNOWN, 100 * NOISE))
    assert np.all(np.delete(one_sigma(covariance_of(noisier)), KNOWN) > np.delete(sigma, KNOWN))


@pytest.mark.parametrize("given", [KNOWN, NONE], ids=["known", "blind"])
def test_an_array_twice_as_large_at_half_the_frequencies_has_twice_the_sigma(given):
    rng = np.random.default_rng
    one, two = at(diffuse(rng(3), given)), None
    measurement = diffuse(rng(3), given)
    larger = replace(
        measurement, frequencies=measurement.frequencies / 2, wavenumbers=None, positions=2 * TRUTH,
        known_positions=2 * TRUTH[given] if len(given) else None,
    )  # fmt: skip
    two = at(larger, 2 * TRUTH)
    np.testing.assert_allclose(covariance_of(two), 4 * covariance_of(one), rtol=1e-6, atol=1e-15)
    assert scale_sigma_of(two, EVERY) == pytest.approx(scale_sigma_of(one, EVERY), rel=1e-6)
    louder = at(replace(measurement, pressures=1e3 * measurement.pressures, noise_power=1e6 * measurement.noise_power))
    np.testing.assert_allclose(covariance_of(louder), covariance_of(one), rtol=1e-6, atol=1e-15)


def test_the_covariance_of_a_blind_array_turns_with_it_and_holds_no_motion(blind):
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    measurement = diffuse(np.random.default_rng(0))
    moved = at(measurement, TRUTH @ turn.T + [3.0, -1.0])
    np.testing.assert_allclose(covariance_of(moved), turn @ covariance_of(blind) @ turn.T, rtol=0.02, atol=3e-6)
    R = rigid_motions(TRUTH)
    np.testing.assert_allclose(R.T @ blind.spread.newton @ R, 0, atol=1e-12)
    for v in blind.spread.influences:
        np.testing.assert_allclose(v @ R, 0, atol=1e-9)


def test_in_the_least_frame_the_coordinates_that_it_fixes_are_certain(blind):
    problem = diffuse(np.random.default_rng(0), KNOWN).problem("unit", "minimal")
    found = estimate_at(problem, SolverSettings(name="descent"), TRUTH, slice(0, len(K)), True)
    first, second = problem.frame.microphones[:2]
    blocks = covariance_of(found)
    np.testing.assert_allclose(blocks[first], 0, atol=1e-14)
    along = (TRUTH[second] - TRUTH[first]) / np.linalg.norm(TRUTH[second] - TRUTH[first])
    assert np.array([-along[1], along[0]]) @ blocks[second] @ [-along[1], along[0]] < 1e-12
    assert along @ blocks[second] @ along > 0


def test_the_covariance_is_enlarged_to_what_the_modes_disagree_by(known):
    """Microphone by microphone, by the larger of single modes and groups, and never made smaller."""
    plain, D = curvature_of(known), 2
    for sizes in ((3.0, 0.5), (0.5, 3.0), (0.1, 0.1)):
        influences = []
        for size in sizes:
            v = np.zeros((2, len(TRUTH) * D))
            v[0, D * 1] = v[1, D * 2 + 1] = size * 0.05
            influences.append(v)
        still = np.zeros_like(known.spread.step)
        small = replace(known.spread, influences=tuple(influences), step=still, shift=still)
        blocks = covariance_of(replace(known, spread=small))
        largest = max(sizes) * 0.05
        for n in (1, 2):
            trace = max(largest**2, np.trace(plain[n]))
            np.testing.assert_allclose(blocks[n], plain[n] * trace / np.trace(plain[n]))
        np.testing.assert_allclose(blocks[3:], plain[3:])


def test_the_step_that_is_left_adds_to_the_covariance(known):
    still = replace(known, spread=replace(known.spread, step=np.zeros_like(known.spread.step)))
    step = np.zeros_like(known.positions)
    step[3] = [0.01, -0.02]
    moving = replace(known, spread=replace(known.spread, step=step))
    np.testing.assert_allclose((covariance_of(moving) - covariance_of(still))[3], np.outer(step[3], step[3]))


def test_modes_measured_twice_say_nothing_new():
    """Neighbours that err alike count as one in their groups: the disagreement does not become smaller."""
    measurement = diffuse(np.random.default_rng(4), wavenumbers=np.linspace(0.5, 4.2, 48))
    twice = replace(
        measurement, frequencies=np.repeat(measurement.frequencies, 2) * np.tile([1.0, 1 + 1e-9], 48), wavenumbers=None,
        pressures=np.repeat(measurement.pressures, 2, axis=0), noise_power=np.repeat(measurement.noise_power, 2),
    )  # fmt: skip
    single, grouped = (
        [np.sum(found.spread.influences[i] ** 2) for found in (at(measurement), at(twice))] for i in (0, 1)
    )
    assert single[1] == pytest.approx(single[0] / 2, rel=0.1), "single modes take the copy for another observation"
    assert 0.6 < grouped[1] / grouped[0] < 1.6, "groups of 8 hold both copies"


@pytest.mark.parametrize("modes", [8, 16])
def test_the_disagreement_of_few_modes_is_estimated_without_bias(modes):
    """Of the field as assumed J is P on average, however few modes it is taken from: their mean is put back."""
    k, ratio = np.linspace(1.0, 4.0, modes), []
    for seed in range(10):
        found = at(diffuse(np.random.default_rng(seed), KNOWN, wavenumbers=k))
        gradients = found.spread.influences[0]
        np.testing.assert_allclose(gradients.sum(axis=0), 0, atol=1e-9)
        ratio.append(np.sum(gradients**2) / np.trace(found.spread.newton))
    assert 0.2 < np.mean(ratio) < 1.7


def test_the_spread_of_the_search_is_weighted_by_likelihood(known):
    best = TriedOptimum(known.positions, 0.0, False, True)
    aside = TriedOptimum(known.positions + [0.006, 0.0], 1.0, False, True)
    healthy, weight = np.ones(len(TRUTH), bool), np.exp(-1) / (1 + np.exp(-1))
    found = search_spread_of(replace(known, tried=(best, aside)), healthy)
    np.testing.assert_allclose(found, np.sqrt(weight) * 0.006)
    for shift in (1e3, -1e3):
        shifted = tuple(replace(one, score=one.score + shift) for one in (best, aside))
        np.testing.assert_allclose(search_spread_of(replace(known, tried=shifted), healthy), found)
    elsewhere = replace(aside, same_frame=False)
    np.testing.assert_allclose(search_spread_of(replace(known, tried=(best, elsewhere)), healthy), 0, atol=1e-12)
    assert not search_spread_of(replace(known, tried=()), healthy).any()
    apart = assess(replace(known, tried=(best, aside)))
    np.testing.assert_allclose(apart.search_spread, found)
    np.testing.assert_array_equal(apart.covariance, assess(replace(known, tried=(best,))).covariance)


def test_a_faulty_channel_does_not_place_the_arrays_on_each_other(known):
    moved = known.positions @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + 2.0
    moved[5] += [0.3, 0.4]
    healthy = np.arange(len(TRUTH)) != 5
    tried = (TriedOptimum(known.positions, 0.0, False, False), TriedOptimum(moved, 0.0, False, False))
    found = search_spread_of(replace(known, tried=tried), healthy)
    np.testing.assert_allclose(found, np.where(healthy, 0.0, 0.5 / np.sqrt(2)), atol=1e-12)


def test_the_place_of_a_dead_channel_does_not_count_for_the_size(blind):
    away, healthy = np.array(blind.positions), np.arange(len(TRUTH)) != 3
    away[3] += [4.0, -3.0]
    newton = np.array(blind.spread.newton)
    newton[6:8, 6:8] += 100.0 * np.eye(2)
    loose = replace(blind, positions=away, spread=replace(blind.spread, newton=newton))
    assert scale_sigma_of(loose, healthy) == pytest.approx(scale_sigma_of(blind, healthy), rel=1e-12)
    assert scale_sigma_of(loose, EVERY) > 2 * scale_sigma_of(blind, EVERY)


def test_the_sigma_of_the_size_is_that_of_the_move_that_stretches(blind):
    stretch = ((blind.positions - blind.positions.mean(axis=0)) * [1.0, 0.0]).ravel()
    wide = replace(blind.spread, newton=0.2**2 * np.outer(stretch, stretch), influences=(np.zeros((1, stretch.size)),))
    assert scale_sigma_of(replace(blind, spread=wide), EVERY) == pytest.approx(0.2)
    influences = 0.3 * stretch[None], 0.1 * stretch[None]
    by_modes = replace(blind.spread, newton=np.zeros((stretch.size,) * 2), influences=influences)
    assert scale_sigma_of(replace(blind, spread=by_modes), EVERY) == pytest.approx(0.3)


def test_an_uncertain_sound_speed_makes_the_size_of_a_blind_array_as_uncertain():
    measurement = diffuse(np.random.default_rng(0))
    sure, unsure = at(measurement), at(measurement, sound_speed_sigma=0.03)
    x = (TRUTH - TRUTH.mean(axis=0)).ravel()
    np.testing.assert_allclose(unsure.spread.newton - sure.spread.newton, 0.03**2 * np.outer(x, x), atol=1e-9)
    assert unsure.log_speed_sigma == 0.03


def test_ellipse_axes_are_those_of_the_covariance():
    blocks = np.array([[[4.0, 0.0], [0.0, 9.0]], [[2.0, 1.0], [1.0, 2.0]]])
    axes = ellipse_axes(blocks, factor=2.0)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=2), [[4, 6], [2, 2 * np.sqrt(3)]])
    np.testing.assert_allclose(np.einsum("nka,nkb->nab", axes, axes) / 4, blocks, atol=1e-12)
