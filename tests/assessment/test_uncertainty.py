"""Covariances, ellipses and the Cramer-Rao bound have the right coverage, whatever units, frame and order."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import j0, jv
from scipy.stats import chi2
from solving import estimated_at as at
from solving import run_from

from fdcal.acoustics.box_field import mode_count
from fdcal.assessment.assess import assess
from fdcal.assessment.uncertainty import (
    Prior,
    confidence_factor,
    covariance_of,
    diffuse_information,
    ellipse_axes,
    one_sigma,
    position_bound,
    scale_sigma_of,
    search_spread_of,
)
from fdcal.graphics.figures import enlarged_ellipses
from fdcal.model.gauge import align, rigid_motions
from fdcal.model.measurement import Measurement
from fdcal.model.settings import SolverSettings
from fdcal.solvers import load
from fdcal.solvers.interface import Estimate, TriedOptimum
from fdcal.solvers.robust.result import estimate_at
from fdcal.solvers.robust.spread import sandwich
from fdcal.viewer.session_view import ellipses_of

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


def ended(measurement: Measurement) -> Estimate:
    """Return the end of solver joint that begins at the truth."""
    solver, problem = load("joint"), measurement.problem("unit", "all")
    settings = SolverSettings(name="joint", modes=len(measurement.frequencies))
    begun = solver.init(problem, settings, 0, positions=measurement.positions)
    return solver.result(problem, run_from(solver, problem, begun)[-1])


@pytest.fixture(scope="module")
def known() -> Estimate:
    return at(diffuse(np.random.default_rng(0), KNOWN))


@pytest.fixture(scope="module")
def blind() -> Estimate:
    return at(diffuse(np.random.default_rng(0)))


@pytest.mark.parametrize("given", [KNOWN, NONE], ids=["known", "blind"])
def test_95_percent_ellipses_cover_95_percent(given):
    """This holds for draws of a diffuse field; they may cover more, since fields of rooms are less isotropic.

    `python -m benchmarks claim` tests fields of rooms over many draws.
    """
    rng, covered, ratios, free = np.random.default_rng(1), [], [], np.setdiff1d(np.arange(len(TRUTH)), given)
    for _ in range(3):
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
    assert np.mean(covered) > 0.95 - 3 * sampling - 0.015 and np.sqrt(np.mean(ratios)) > 0.4


def test_known_microphones_have_no_uncertainty_and_noise_adds_to_that_of_the_others(known):
    sigma = one_sigma(covariance_of(known))
    assert not sigma[KNOWN].any() and np.all(np.delete(sigma, KNOWN) > 0)
    reported = diffuse(np.random.default_rng(0), KNOWN, 100 * NOISE)
    for noisier in (reported, replace(reported, noise_power=None)):
        more = one_sigma(covariance_of(at(noisier)))
        assert np.all(np.delete(more, KNOWN) > np.delete(sigma, KNOWN)) and np.mean(more) > 2.5 * np.mean(sigma)
    step = np.zeros_like(known.positions)
    step[3] = [0.01, -0.02]
    added = (covariance_of(replace(known, spread=replace(known.spread, step=step))) - covariance_of(known))[3]
    np.testing.assert_allclose(added, np.outer(step[3], step[3]), err_msg="the remaining step adds, too")


@pytest.mark.parametrize("given", [KNOWN, NONE], ids=["known", "blind"])
def test_an_array_twice_as_large_at_half_the_frequencies_has_twice_the_sigma(given):
    measurement = diffuse(np.random.default_rng(3), given)
    one = at(measurement)
    larger = replace(
        measurement, frequencies=measurement.frequencies / 2, wavenumbers=None, positions=2 * TRUTH,
        known_positions=2 * TRUTH[given] if len(given) else None,
    )  # fmt: skip
    two = at(larger)
    np.testing.assert_allclose(covariance_of(two), 4 * covariance_of(one), rtol=1e-6, atol=1e-15)
    assert scale_sigma_of(two, EVERY) == pytest.approx(scale_sigma_of(one, EVERY), rel=1e-6)
    louder = at(replace(measurement, pressures=1e3 * measurement.pressures, noise_power=1e6 * measurement.noise_power))
    np.testing.assert_allclose(covariance_of(louder), covariance_of(one), rtol=1e-6, atol=1e-15)


def test_the_covariance_of_a_blind_array_turns_with_it_and_contains_no_rigid_motion(blind):
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    moved = at(diffuse(np.random.default_rng(0)), TRUTH @ turn.T + [3.0, -1.0])
    np.testing.assert_allclose(covariance_of(moved), turn @ covariance_of(blind) @ turn.T, rtol=0.02, atol=3e-6)
    R = rigid_motions(TRUTH)
    np.testing.assert_allclose(R.T @ blind.spread.newton @ R, 0, atol=1e-12)


def test_in_the_minimal_frame_the_coordinates_that_it_fixes_are_certain():
    problem = diffuse(np.random.default_rng(0), KNOWN).problem("unit", "minimal")
    found = estimate_at(problem, SolverSettings(name="descent"), TRUTH, slice(0, len(K)), True)
    assert found.ended and not estimate_at(problem, SolverSettings(name="descent"), TRUTH, slice(0, 9), False).ended
    first, second = problem.frame.microphones[:2]
    blocks = covariance_of(found)
    np.testing.assert_allclose(blocks[first], 0, atol=1e-14)
    along = (TRUTH[second] - TRUTH[first]) / np.linalg.norm(TRUTH[second] - TRUTH[first])
    assert np.array([-along[1], along[0]]) @ blocks[second] @ [-along[1], along[0]] < 1e-12
    assert along @ blocks[second] @ along > 0


def test_the_covariance_grows_with_the_disagreement_of_the_blocks_and_is_never_below_the_model(known):
    """Only the part from the data grows, by three quarters of the excess, and equally for all microphones."""
    still = replace(known.spread, step=np.zeros_like(known.spread.step))
    data = still.data.reshape(9, 2, 9, 2)[range(9), :, range(9)]
    for dispersion, excess in ((1.0, 0.0), (0.0, 0.0), (3.0, 1.5)):
        blocks = covariance_of(replace(known, spread=replace(still, dispersion=dispersion)))
        np.testing.assert_allclose(blocks, covariance_of(known, by_model=True) + excess * data, rtol=1e-12, atol=1e-18)


def test_the_uncertainty_that_a_prior_states_is_not_widened(known, blind):
    for found in (known, blind):  # the only prior is that of exact positions
        assert np.trace(found.spread.data) == pytest.approx(np.trace(found.spread.newton), rel=1e-3)
    shares = [
        np.trace(one.data) / np.trace(one.newton)
        for one in (at(diffuse(np.random.default_rng(0), KNOWN), sound_speed_sigma=s).spread for s in (1.0, 0.03, 1e-4))
    ]
    assert shares[0] > 0.99 and shares[1] < 0.9 and shares[2] > 0.999, "prior and data both determine the speed"
    unsure, x = at(diffuse(np.random.default_rng(0)), sound_speed_sigma=0.03), (TRUTH - TRUTH.mean(axis=0)).ravel()
    wide, narrow = (replace(one.spread, dispersion=5.0) for one in (unsure, blind))
    np.testing.assert_allclose(wide.covariance - narrow.covariance, 0.03**2 * np.outer(x, x), atol=1e-9)
    assert unsure.log_speed_sigma == 0.03


def test_modes_measured_twice_add_no_information():
    """Duplicated modes are in one block, so that the dispersion doubles while the covariance is halved."""
    measurement = diffuse(np.random.default_rng(4), wavenumbers=np.linspace(0.5, 4.2, 48))
    twice = replace(
        measurement, frequencies=np.repeat(measurement.frequencies, 2) * np.tile([1.0, 1 + 1e-9], 48), wavenumbers=None,
        pressures=np.repeat(measurement.pressures, 2, axis=0), noise_power=np.repeat(measurement.noise_power, 2),
    )  # fmt: skip
    one, two = (at(each).spread for each in (measurement, twice))
    assert np.trace(two.newton) == pytest.approx(np.trace(one.newton) / 2, rel=0.2)
    assert two.dispersion == pytest.approx(2 * one.dispersion, rel=0.25)


def linear_model(seed: int, blocks: int, scale: float) -> tuple[float, float]:
    """Squared error over the claimed variance, and the dispersion, of a line through Gaussian data.

    Its noise is `scale` times the claimed noise, which the formula in `robust.result` finds.
    """
    rng, truth = np.random.default_rng(seed), np.array([1.0, -2.0])
    A = np.stack([np.ones((blocks, 20)), rng.normal(size=(blocks, 20))], axis=-1)
    y, parts = A @ truth + scale * rng.normal(size=(blocks, 20)), np.swapaxes(A, 1, 2) @ A
    P = np.linalg.inv(parts.sum(axis=0))
    x = P @ np.einsum("bij,bi->j", A, y)
    gradients = -np.einsum("bij,bi->bj", A, y - A @ x)
    return float(np.sum((x - truth) ** 2) / np.trace(P)), sandwich(P, gradients, parts, np.eye(2))


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
def test_the_dispersion_of_a_linear_gaussian_model_is_that_of_its_noise(scale):
    errors, dispersions = np.transpose([linear_model(seed, 10, scale) for seed in range(200)])
    assert np.mean(errors) == pytest.approx(scale**2, rel=0.2)
    assert np.mean(dispersions) == pytest.approx(scale**2, rel=0.1)


def test_the_spread_of_the_search_is_weighted_by_likelihood(known):
    best = TriedOptimum(known.positions, 0.0, True)
    aside = TriedOptimum(known.positions + [0.006, 0.0], 1.0, True)
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
    np.testing.assert_array_equal(apart.covariance, assess(replace(known, tried=(best,))).covariance)


def test_a_faulty_channel_does_not_affect_the_alignment_of_arrays(known):
    moved = known.positions @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + 2.0
    moved[5] += [0.3, 0.4]
    healthy = np.arange(len(TRUTH)) != 5
    tried = (TriedOptimum(known.positions, 0.0, False), TriedOptimum(moved, 0.0, False))
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


def test_the_sigma_of_the_size_is_that_of_stretching_the_array(blind):
    stretch = ((blind.positions - blind.positions.mean(axis=0)) * [1.0, 0.0]).ravel()
    moves = 0.2**2 * np.outer(stretch, stretch)
    wide = replace(blind.spread, newton=moves, data=moves, dispersion=1.0)
    assert scale_sigma_of(replace(blind, spread=wide), EVERY) == pytest.approx(0.2)
    assert scale_sigma_of(replace(blind, spread=replace(wide, dispersion=5.0)), EVERY) == pytest.approx(0.4)


def assert_holds_95_percent(axes: np.ndarray, covariance: np.ndarray) -> None:
    """Half axes in rows are those of the ellipse that holds 95 % of a Gaussian."""
    np.testing.assert_allclose(axes.T @ axes, chi2.ppf(0.95, len(axes)) * covariance, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_every_ellipse_holds_95_percent(dimension):
    """This holds for the formula, on the page and in a figure."""
    maps = np.random.default_rng(dimension).normal(size=(3, dimension, dimension)) * 0.003
    blocks = maps @ maps.swapaxes(1, 2)
    for axes, block in zip(ellipse_axes(blocks, confidence_factor(0.95, dimension)), blocks, strict=True):
        assert_holds_95_percent(axes, block)
        gram = axes @ axes.T
        np.testing.assert_allclose(gram, np.diag(np.diag(gram)), atol=1e-15, err_msg="half axes are at right angles")
    assert confidence_factor(0.5, dimension) == pytest.approx(np.sqrt(chi2.ppf(0.5, dimension)))
    if dimension == 1:
        return
    found = SimpleNamespace(
        room=None, covariance=blocks, uncertainty=np.ones(len(blocks)), verdict="good", verdict_text="", channels=None
    )
    for axes, block in zip(ellipses_of(found), blocks, strict=True):
        assert_holds_95_percent(axes, block)
    if dimension == 2:
        outlines = []
        panel = SimpleNamespace(plot=lambda x, y, *_, **__: outlines.append(np.stack([x, y], axis=1)))
        enlarged_ellipses(panel, np.zeros((1, 2)), blocks[:1], 1.0)
        (outline,) = outlines
        # Two conjugate half axes are a quarter of the outline apart.
        assert_holds_95_percent(outline[[0, len(outline) // 4]], blocks[0])


# The Fisher information of a diffuse field equals the Slepian-Bangs formula with numerical derivatives.


SHARE, WAVENUMBERS = 0.01, [2.0, 5.0, 9.0]


def array(count, dimension, seed=0):
    return 0.3 * np.random.default_rng(seed).normal(size=(count, dimension))


def by_differences(x, dimension):
    """Information by central differences of the covariance; parameters x, log gains, log c and the field's power."""
    N, D = x.shape

    def covariance(parameters, k):
        places, gains = parameters[: N * D].reshape(N, D), np.exp(parameters[N * D : N * D + N])
        r = k * np.linalg.norm(places[:, None] - places[None], axis=-1) / np.exp(parameters[-2])
        kappa = j0(r) if dimension == 2 else np.sinc(r / np.pi)
        return np.outer(gains, gains) * (parameters[-1] * (1 - SHARE) * kappa + SHARE * np.eye(N))

    at, step, total = np.concatenate([x.ravel(), np.zeros(N + 1), [1.0]]), 1e-5, 0.0
    for k in WAVENUMBERS:
        slopes = [(covariance(at + e, k) - covariance(at - e, k)) / 2 / step for e in step * np.eye(len(at))]
        parts = [np.linalg.solve(covariance(at, k), slope) for slope in slopes]
        F = np.array([[np.trace(a @ b) for b in parts] for a in parts])
        total = total + F[:-1, :-1] - np.outer(F[:-1, -1], F[:-1, -1]) / F[-1, -1]
    return total


@pytest.mark.parametrize(("axes", "dimension"), [(2, 2), (3, 3), (2, 3)])
def test_the_information_equals_numerical_derivatives_of_the_covariance(axes, dimension):
    x = array(6, axes)
    expected = by_differences(x, dimension)
    found = diffuse_information(x, WAVENUMBERS, SHARE, dimension).matrix
    assert np.abs(found - expected).max() < 1e-7 * np.abs(expected).max()
    if axes == dimension:
        assert np.abs(found[: x.size, : x.size] @ rigid_motions(x)).max() < 1e-9 * np.abs(found).max()


def test_additional_unknowns_can_only_raise_the_bound():
    """For a blind array, an uncertainty of 1 % in c adds 1 % to that of the size, in quadrature."""
    information, known = diffuse_information(array(10, 2), WAVENUMBERS, SHARE, 2), np.arange(3)
    exact = position_bound(information, Prior(known)).sigma[3:]
    for prior in (Prior(known, 0.005), Prior(known, gain_sigma=0.1), Prior(known, sound_speed_sigma=0.005)):
        assert np.all(position_bound(information, prior).sigma[3:] >= exact * (1 - 1e-9))
    one, four = (position_bound(each, Prior()).rms for each in (information, information.scaled(4.0)))
    assert one == pytest.approx(2 * four)
    long = diffuse_information(array(10, 2), np.linspace(2, 9, 40), 1e-6, 2)
    sizes = [position_bound(long, Prior(sound_speed_sigma=sigma)).scale_sigma for sigma in (0.0, 0.01)]
    assert sizes[1] == pytest.approx(np.hypot(sizes[0], 0.01), rel=0.01)


@pytest.mark.parametrize("size", [(5.0, 4.0), (4.6, 3.8, 2.7)])
def test_the_expected_number_of_modes_is_that_of_the_room(size):
    c, f = 343.0, 300.0 if len(size) == 3 else 900.0
    counts = [np.arange(int(2 * f * length / c) + 1) * c / (2 * length) for length in size]
    modes = np.sqrt(sum(axis**2 for axis in np.meshgrid(*counts, indexing="ij")))
    assert mode_count(size, [f], c)[0] == pytest.approx(np.sum(modes <= f), rel=0.05)


def test_the_bound_grows_with_the_sigma_of_the_given_positions():
    """A given position is known at least as well as stated; a larger sigma makes all others less certain."""
    x, known = array(9, 2), np.arange(4)
    information = diffuse_information(x, WAVENUMBERS, SHARE, 2)
    bounds = [position_bound(information, Prior(known, known_sigma=sigma)) for sigma in (0.0, 1e-3, 3e-3, 1e-2)]
    for sigma, one, before in zip((1e-3, 3e-3, 1e-2), bounds[1:], bounds[:-1], strict=True):
        given = one.sigma[known]
        assert np.all(given <= np.sqrt(2) * sigma * (1 + 1e-9)) and np.all(given > before.sigma[known])
        assert one.rms > before.rms
    assert np.all(bounds[0].sigma[known] < 1e-6)
    assert np.all(bounds[0].sigma[4:] <= position_bound(information, Prior(np.arange(3))).sigma[4:] * (1 + 1e-9))
