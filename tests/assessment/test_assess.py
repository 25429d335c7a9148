"""The verdict on the result of a solver: every row of the table, their order, what must and must not be reported."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import solving
from fields import jittered_grid, measured, with_noise
from scipy.stats import kstest
from solving import estimated_at as at
from solving import run_from
from test_faulty_channels import KNOWN, MODES, array

from fdcal.acoustics.dictionary import array_f_max
from fdcal.assessment.assess import _unused_agreement, assess, judged
from fdcal.assessment.calibration import ChannelFault
from fdcal.assessment.findings import FINDINGS, ROOM_RESIDUAL, first_finding
from fdcal.assessment.uncertainty import covariance_of
from fdcal.model.gauge import align
from fdcal.model.measurement import Measurement
from fdcal.solvers import robust
from fdcal.solvers.interface import Estimate, TriedOptimum

TRUTH, CORNERS, HIGHEST = jittered_grid(), [0, 4, 22], 230.0


def room(known=CORNERS, snr_db=30.0, seed=0, **kind) -> Measurement:
    return measured(TRUTH, np.array(known, int), highest=HIGHEST, snr_db=snr_db, seed=seed, **kind)


@pytest.fixture(scope="module")
def healthy() -> Measurement:
    return measured(array(), np.array(KNOWN), snr_db=40.0, modes=MODES)


@pytest.fixture(scope="module")
def solved(healthy):
    """Problem and last state of a healthy array."""
    end = solving.solved(healthy)
    return end.problem, end.state


@pytest.fixture(scope="module")
def estimate(solved) -> Estimate:
    """A healthy array with its likeliest optimum only, so that only the changes of a test are found."""
    found = robust.result(*solved)
    return replace(found, tried=(TriedOptimum(found.positions, 0.0, True),))


@pytest.fixture(scope="module")
def blind(healthy) -> Estimate:
    found = solving.solved(replace(healthy, known=np.zeros(0, int), known_positions=None)).estimate
    return replace(found, tried=(TriedOptimum(found.positions, 0.0, False),))


# --- each row of FINDINGS applies under its condition ----------------------------------------------------------------


def with_share(e: Estimate, share: float) -> Estimate:
    return replace(e, field=replace(e.field, noise_fraction=share))


def with_channel_noise(e: Estimate, count: int, factor: float) -> Estimate:
    noise = np.array(e.channels.noise)
    noise[np.setdiff1d(np.arange(len(noise)), KNOWN)[:count]] *= factor
    return replace(e, channels=replace(e.channels, noise=noise))


def as_single_wave(e: Estimate) -> Estimate:
    k = 3 * np.real(e.problem.wavenumbers)[:, None]  # at this k the phases spread over the array
    return replace(e, problem=replace(e.problem, pressures=np.exp(-1j * k * (e.positions @ [0.6, 0.8]))))


def with_inverted(e: Estimate, count: int) -> Estimate:
    gains = np.array(e.channels.gains)
    gains[-count:, 1] = np.pi
    return replace(e, channels=replace(e.channels, gains=gains))


def with_given_moved(e: Estimate, count: int, metres: float = 2.0) -> Estimate:
    places = np.array(e.problem.known_positions)
    for i in range(count):
        places[i] += [metres, 3.0 * i]
    return replace(e, problem=replace(e.problem, known_positions=places))


def with_agreement(e: Estimate, probability: float) -> Estimate:
    return replace(e, given=replace(e.given, probability=lambda kept: probability))


def with_frequencies(e: Estimate, factor: float) -> Estimate:
    return replace(e, problem=replace(e.problem, frequencies=factor * e.problem.frequencies))


def with_step(e: Estimate, sigmas: float) -> Estimate:
    step = np.zeros_like(e.spread.step)
    step[1, 0] = -sigmas * e.spread.sigma[1, 0]
    return replace(e, spread=replace(e.spread, step=step))


def with_given_noise(e: Estimate, noise: float) -> Estimate:
    return replace(e, problem=replace(e.problem, noise_power=np.full(len(e.problem.frequencies), noise)))


def with_stretching(e: Estimate, sigma: float) -> Estimate:
    x = (e.positions - e.positions.mean(axis=0)).ravel()
    return replace(e, spread=replace(e.spread, newton=e.spread.newton + sigma**2 * np.outer(x, x)))


def with_tried(e: Estimate, *scores: float, apart: float = 0.1) -> Estimate:
    """Return an estimate with other optima, `apart` metres from the likeliest and from each other, and less likely."""
    rng = np.random.default_rng(0)
    others = [e.positions + apart * rng.normal(size=e.positions.shape) for _ in scores]
    tried = [TriedOptimum(x, score, True) for x, score in zip(others, scores, strict=True)]
    return replace(e, tried=(TriedOptimum(e.positions, 0.0, True), *tried))


def with_newton(e: Estimate, factor: float) -> Estimate:
    return replace(e, spread=replace(e.spread, newton=factor * e.spread.newton))


def with_loose_given(e: Estimate) -> Estimate:
    """Return an estimate in which one given position is held only by its own prior."""
    newton, n, D = np.array(e.spread.newton), e.problem.known[0], e.positions.shape[1]
    block = slice(D * n, D * n + D)
    newton[block, :] = newton[:, block] = 0.0
    newton[block, block] = np.eye(D) / (e.given.stiffness[0] + 1.0)
    return replace(e, spread=replace(e.spread, newton=newton))


ROWS: list[tuple[str, str, Callable[[Estimate], Estimate]]] = [
    ("too_noisy", "40 % of the power", lambda e: with_share(e, 0.4)),
    ("model_mismatch", "single wave", as_single_wave),
    ("model_mismatch", "7 of 20 channels are faulty", lambda e: with_inverted(e, 7)),
    ("model_mismatch", "no sound field without sources explains", lambda e: with_channel_noise(e, 3, 1e4)),
    ("model_mismatch", "8 of 20 microphones", lambda e: with_channel_noise(e, 8, 6.0)),
    ("undersampled", "Eq. 9", lambda e: replace(with_frequencies(e, 10.0), interpolates=True)),
    ("not_converged", "still moved", lambda e: replace(e, ended=False)),
    ("known_position", "known microphone 0 and 5", lambda e: with_given_moved(e, 2)),
    ("known_position", "such a disagreement in 1 of 1000", lambda e: with_agreement(e, 1e-3)),
    ("model_mismatch", "times what the noise explains", lambda e: with_given_noise(with_share(e, 0.01), 0.003)),
    ("model_mismatch", "free of noise", lambda e: with_given_noise(with_share(e, 0.01), 0.0)),
    ("sound_speed", "would be 403 m/s, not 343 m/s", lambda e: replace(e, log_speed=0.16)),
    ("scale_undetermined", "but the size of the array is hardly determined", lambda e: with_stretching(e, 0.2)),
    ("ambiguous", "mirror image of the array fits", lambda e: replace(e, given=replace(e.given, mirror_advantage=1.0))),
    ("ambiguous", "explains the pressures as well", lambda e: with_tried(e, 1.0)),
    ("ambiguous", "may stand elsewhere", lambda e: with_share(with_channel_noise(e, 1, 5.0), 5e-4)),
    ("ambiguous", "the positions are uncertain by", lambda e: with_newton(e, 1e3)),
    ("ambiguous", "an error of a given position would not be noticed", with_loose_given),
    ("good", "no check contradicts the positions found", lambda e: e),
]
BLIND = 12  # only an array without given positions reaches this row
# The changes that lead to the two rows of a pair exclude each other.
EXCLUDED = {
    (2, 4), (2, 15), (4, 15), (7, 12), (7, 16), (7, 17), (8, 12), (9, 10), (12, 17), (14, 16), (16, 17),
}  # fmt: skip


def first_row(found: Estimate, scale: float | None = None) -> int:
    seen = judged(found, [str(n) for n in range(len(found.positions))], scale)
    return next(i for i, row in enumerate(FINDINGS) if row.applies(seen, row.limit))


def test_the_rows_tried_here_are_those_of_the_table():
    assert [code for code, _, _ in ROWS] == [row.code for row in FINDINGS] and FINDINGS[-1].code == "good"
    for row in FINDINGS:
        assert row.reason or not row.limit, f"{row.code}: a limit has a reason"


EVERY_ROW = [pytest.param(n, id=f"{n}-{ROWS[n][0]}") for n in range(len(ROWS))]


@pytest.fixture
def begun(estimate, blind):
    """Function that maps rows of the table to the estimate that these rows alter."""
    return lambda *chosen: blind if BLIND in chosen else estimate


@pytest.mark.parametrize("row", EVERY_ROW)
def test_every_row_can_be_the_verdict(begun, row):
    code, words, altered = ROWS[row]
    found = altered(begun(row))
    verdict = assess(found)
    assert (first_row(found), verdict.verdict) == (row, code) and words in verdict.message


def test_a_contradiction_of_windows_and_rows_is_reported(estimate):
    few, many = (assess(replace(estimate, window_ratio=ratio)).message for ratio in (1.5, 9.0))
    assert "spectra" not in few and "long spectra are 3.0 sigma apart" in many


def test_an_array_that_was_not_found_contradicts_no_given_position(estimate):
    moved = with_given_moved(estimate, 2)
    assert {fault.name for fault in assess(moved).channels.faults} == {"0", "5"}
    for lost, verdict in (
        (replace(moved, ended=False), "not_converged"),
        (with_step(moved, 5.0), "not_converged"),
        (replace(with_frequencies(moved, 10.0), interpolates=True), "undersampled"),
    ):
        found = assess(lost)
        assert found.verdict == verdict and found.channels.faults == ()
        assert not any(one.wrong for one in found.channels.given)


@pytest.mark.parametrize("row", EVERY_ROW)
def test_an_earlier_row_hides_a_later_one(begun, row):
    for later in range(row + 1, len(ROWS)):
        if (row, later) not in EXCLUDED:
            assert first_row(ROWS[row][2](ROWS[later][2](begun(row, later)))) == row, later


@pytest.mark.parametrize(("row", "altered"), [
    (0, lambda e, limit, by: with_given_noise(with_share(e, limit * by), limit)),
    (8, lambda e, limit, by: with_agreement(e, limit / by)), (6, lambda e, limit, by: with_step(e, limit * by)),
    (9, lambda e, limit, by: with_given_noise(with_share(e, limit * by * 0.01 + ROOM_RESIDUAL), 0.01)),
    (10, lambda e, limit, by: with_given_noise(with_share(e, limit * by), 0.0)),
    (11, lambda e, limit, by: replace(e, log_speed=np.log1p(limit * by))),
])  # fmt: skip
def test_a_limit_is_where_the_verdict_changes(estimate, row, altered):
    limit = FINDINGS[row].limit
    assert first_row(altered(estimate, limit, 1.02)) == row
    assert first_row(altered(estimate, limit, 0.98)) == len(FINDINGS) - 1


# --- the quantities that the rows read -------------------------------------------------------------------------------


def test_the_residual_is_divided_by_the_noise_of_every_mode_and_channel(estimate):
    """Without a field C = v tau, and the chi-square is sum |q|^2 / (v tau) over its degrees of freedom."""
    field, tau = estimate.field, estimate.channels.noise
    q, (M, N), D = field.terms.corrected, field.terms.corrected.shape, estimate.positions.shape[1]

    def figure(noise: np.ndarray) -> float:
        v = noise[:, None] * tau
        terms = replace(field.terms, weighted=q / v, precision=1 / v)
        found = replace(estimate, field=replace(field, noise=noise, terms=terms))
        return judged(found, [""] * N, faulty={}).residual_to_noise

    noise = field.noise * np.linspace(0.5, 2.0, M)
    expected = np.sum(np.abs(q) ** 2 / (noise[:, None] * tau)) / (M * N - N * (D + 2) / 2)
    assert figure(noise) == pytest.approx(expected, rel=1e-9)
    assert figure(4 * noise) == pytest.approx(expected / 4, rel=1e-9)


def test_reported_noise_of_unused_modes_does_not_affect_the_verdict(estimate):
    half, noise = slice(0, MODES // 2), np.array(estimate.problem.noise_power)
    noise[half.stop :] *= 1e-6
    for modes, count in ((half, 1), (slice(None), 0)):
        found = replace(estimate, modes=modes, problem=replace(estimate.problem, noise_power=noise))
        given = judged(found, [""] * len(estimate.positions)).given_noise
        assert (given == pytest.approx(float(np.median(noise[half])))) == bool(count)


def test_another_optimum_counts_by_its_evidence_and_its_distance(estimate):
    assert first_row(with_tried(estimate, 50.0, 60.0)) == len(FINDINGS) - 1
    assert first_row(with_tried(estimate, 1.0, apart=1e-4)) == len(FINDINGS) - 1, "the same optimum"
    rival = TriedOptimum(estimate.positions @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + 3.0, 1.0, False)
    assert first_row(replace(estimate, tried=(*estimate.tried, rival))) == len(FINDINGS) - 1, "moved as a whole"


def test_the_remedy_for_another_array_asks_for_the_microphones_that_may_stand_elsewhere(estimate):
    places = np.array(estimate.positions)
    places[[8, 13]] += 0.3
    tried = (TriedOptimum(estimate.positions, 0.0, True), TriedOptimum(places, 1.0, True))
    assert "give the positions of microphones 8 and 13 (<known>)" in assess(replace(estimate, tried=tried)).message


def test_the_loosest_given_microphone_does_not_depend_on_its_own_prior(estimate):
    """sigma = (P^-1 - spring)^-1: a stiffer or softer spring on its own position changes P, and nothing else."""
    D = estimate.positions.shape[1]
    for n, index in zip(estimate.problem.known.tolist(), range(len(KNOWN)), strict=True):
        block = slice(D * n, D * n + D)
        own = np.linalg.inv(estimate.spread.newton[block, block]) - estimate.given.stiffness[index] * np.eye(D)
        found = []
        for spring in (1e3, 1e5, 1e7):
            newton, stiffness = np.zeros_like(estimate.spread.newton), np.full(len(KNOWN), 1e-6)
            for m in KNOWN:
                newton[D * m : D * m + D, D * m : D * m + D] = 1e-8 * np.eye(D)
            newton[block, block] = np.linalg.inv(own + spring * np.eye(D))
            stiffness[index] = spring
            given = replace(estimate.given, stiffness=stiffness)
            one = replace(estimate, spread=replace(estimate.spread, newton=newton), given=given)
            found.append(judged(one, [""] * len(estimate.positions)).loosest)
        assert found == pytest.approx([np.sqrt(np.trace(np.linalg.inv(own)))] * 3, rel=1e-5)


def test_given_positions_that_are_wrong_leave_the_others_to_place_the_array(estimate):
    """In the plane three of four suffice; with two right ones, none of them can be judged."""
    names, seen = [str(n) for n in range(len(estimate.positions))], []
    with_probability = replace(estimate.given, probability=lambda kept: seen.append(kept) or 0.5)
    for wrong in (0, 1, 3):
        found = judged(replace(with_given_moved(estimate, wrong), given=with_probability), names)
        assert np.isinf(found.loosest) == (wrong == 3)
        assert found.agreement == (1.0 if wrong == 3 else 0.5)
    assert [int(np.sum(kept)) for kept in seen] == [4, 3]
    carried = replace(with_probability, carry_scale=True, probability=lambda kept: 1e-9)
    assert judged(replace(estimate, given=carried), names).agreement == 1.0


def test_a_given_or_faulty_microphone_is_not_reported_to_stand_elsewhere(estimate):
    found = with_share(with_channel_noise(estimate, KNOWN[0], 5.0), 5e-4)
    names, others = [""] * len(found.positions), np.setdiff1d(np.arange(len(found.positions)), KNOWN)
    assert judged(found, names).noisiest in others
    faulty = {n: ChannelFault("", "noisy", 9.0, "dB") for n in others.tolist()}
    assert judged(found, names, faulty=faulty).noisiest == -1
    assert "may stand elsewhere" not in assess(found).message


def test_given_positions_with_a_stated_sigma_may_contradict_the_pressures(solved):
    problem, state = solved
    errors = 0.003 * np.array([[1, 1], [-1, 1], [1, -1], [-1, -1]])
    moved = replace(problem, known_positions=problem.known_positions + errors)
    stated = replace(state, model=replace(state.model, known_sigma=5e-4))
    assert "do not agree" in assess(robust.result(moved, stated)).message


def test_given_positions_that_the_solver_did_not_get_check_the_array(blind):
    """They contradict an array that is 3 % too large, as with a wrong temperature, but not a right one."""
    names = [str(n) for n in range(len(blind.positions))]
    truth, turn = array(), np.array([[0.6, -0.8], [-0.8, -0.6]])
    for size, code in ((1.0, "good"), (1.03, "known_position"), (0.97, "known_position")):
        unused = {n: size * truth[n] @ turn + [5.0, 1.0] for n in KNOWN}
        found = assess(blind, names, unused=unused)
        assert found.verdict == code and ("found without them" in found.message) == (code != "good"), found.message
        few = dict(list(unused.items())[:1])
        assert assess(blind, names, unused=few).verdict == "good", "one position checks nothing"
        flat = replace(blind, given=replace(blind.given, carry_scale=True))
        assert assess(flat, names, unused=unused).verdict == "scale_undetermined", "the pressures show no size"


def test_the_disagreement_with_unused_positions_is_as_probable_as_it_says(blind):
    """If array and list are drawn from their covariances, a fraction p of the probabilities is below p."""
    rng, D = np.random.default_rng(3), 2
    covariance = blind.spread.covariance
    root, drawn = np.linalg.cholesky(covariance + 1e-18 * np.eye(len(covariance))), []
    for _ in range(300):
        moved = blind.positions + (root @ rng.standard_normal(len(root))).reshape(-1, D)
        listed = blind.positions[KNOWN] + blind.given.expected_sigma * rng.standard_normal((len(KNOWN), D))
        drawn.append(_unused_agreement(replace(blind, positions=moved), dict(zip(KNOWN, listed, strict=True)), 1.0))
    assert kstest(drawn, "uniform").pvalue > 1e-3


def test_unequal_gains_do_not_count_as_unequal_residuals(estimate):
    """Noise that is equal before the gains is noise of the channels."""
    gains = np.array(estimate.channels.gains)
    gains[np.setdiff1d(np.arange(len(gains)), KNOWN)[:8], 0] -= np.log(2)
    found = with_channel_noise(estimate, 8, 4.0)
    found = replace(found, channels=replace(found.channels, gains=gains, spread=np.ones(2)))
    assert "times that of the median one" not in assess(found).message


def test_a_noisy_channel_counts_with_other_large_residuals_and_is_a_single_fault_without_them(estimate):
    """In a wrong basin several microphones have large residuals, and one may be large enough to be called noisy."""
    two = with_share(with_channel_noise(estimate, 2, 5.0), 5e-4)
    three = np.array(two.channels.noise)
    three[np.setdiff1d(np.arange(len(three)), KNOWN)[2]] *= 40.0
    assert "3 of 20 microphones" in assess(replace(two, channels=replace(two.channels, noise=three))).message
    alone = np.array(estimate.channels.noise)
    alone[np.setdiff1d(np.arange(len(alone)), KNOWN)[:2]] *= 40.0
    found = assess(with_share(replace(estimate, channels=replace(estimate.channels, noise=alone)), 5e-4))
    assert found.verdict == "good" and "noisy" in {one.kind for one in found.channels.faults}


def test_a_sound_speed_is_impossible_beyond_its_limit_plus_four_sigmas_and_always_beyond_15_percent(estimate):
    for ratio, sigma, possible in ((1.04, 0.0, True), (1.06, 0.0, False), (1.06, 0.01, True), (1.16, 1.0, False)):
        found = replace(estimate, log_speed=float(np.log(ratio)), log_speed_sigma=sigma)
        assert (assess(found).verdict == "good") == possible, ratio
    found = assess(estimate, scale=1.2)
    assert found.verdict == "sound_speed" and "given distance" in found.message


def test_a_given_distance_stretches_positions_sigma_and_sound_speed_alike(estimate):
    one, larger = assess(estimate), assess(estimate, scale=1.01)
    centre = one.positions.mean(axis=0)
    np.testing.assert_allclose(larger.positions - centre, 1.01 * (one.positions - centre))
    np.testing.assert_allclose(larger.covariance, 1.01**2 * one.covariance)
    assert larger.problem.sound_speed == pytest.approx(1.01 * one.problem.sound_speed)
    np.testing.assert_allclose(larger.problem.wavenumbers, one.problem.wavenumbers / 1.01)


def test_a_faulty_channel_does_not_count_in_the_residual(estimate):
    n, terms = 7, estimate.field.terms
    weighted, precision = np.array(terms.weighted), np.array(terms.precision)
    weighted[:, n] *= 100.0
    precision[:, n] *= 3.0
    terms = replace(terms, weighted=weighted, precision=precision)
    spoilt = replace(estimate, field=replace(estimate.field, terms=terms))
    faulty, names = {n: ChannelFault("", "noisy", 20.0, "dB")}, [""] * len(estimate.positions)
    figures = [judged(one, names, faulty=faulty).residual_to_noise for one in (estimate, spoilt)]
    assert figures[0] == pytest.approx(figures[1], rel=1e-12)


def test_gains_that_the_solver_found_do_not_increase_the_prediction_error(estimate):
    """The leave-one-out errors are computed from the pressures after correction of gains and delays."""
    rng, before = np.random.default_rng(0), assess(estimate).evidence
    gains = 0.3 * rng.normal(size=estimate.channels.gains.shape)
    pressures = estimate.problem.pressures * np.exp(gains @ np.array([1.0, 1.0j]))
    channels = replace(estimate.channels, gains=estimate.channels.gains + gains, spread=np.ones(2))
    found = replace(estimate, problem=replace(estimate.problem, pressures=pressures), channels=channels)
    after = assess(found).evidence
    assert after.leave_one_out_db == pytest.approx(before.leave_one_out_db, abs=0.05)
    np.testing.assert_allclose(after.microphones_db, before.microphones_db, atol=0.1)


# --- verdicts of every solver ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", ["robust", "joint"])
def test_every_solver_finds_a_healthy_array_good(healthy, solver):
    found = solving.solved(healthy, solver).assessment
    assert found.verdict == "good" and found.message.startswith("no check contradicts the positions found")
    assert found.channels.faults == () and "inaccurate" not in found.message and "noise" not in found.message
    assert 0.5 < found.evidence.residual_to_noise < 2 and not found.positions.flags.writeable
    assert np.all((found.uncertainty > 0) == ~np.isin(np.arange(len(found.positions)), KNOWN)) or solver == "robust"
    assert np.linalg.norm(found.positions - healthy.positions, axis=1).max() < 0.01
    if solver == "joint":
        same = assess(at(healthy, found.positions))
        assert same.verdict == "good", "the solver does not matter"
        np.testing.assert_allclose(same.uncertainty, found.uncertainty, rtol=0.1)


@pytest.mark.parametrize("known", [[], CORNERS])
def test_a_faulty_channel_is_named_by_solvers_that_seek_no_gains(known):
    """A weak channel of a blind array, and a channel of garbage in a measurement without reported noise."""
    measurement, rng = room(known), np.random.default_rng(1)
    p = np.array(measurement.pressures)
    noise = rng.standard_normal((2, len(p)))
    p[:, 17] = np.abs(p).mean(axis=1) * (noise[0] + 1j * noise[1]) if known else 0.4 * p[:, 17]
    altered = replace(measurement, pressures=p, **({"noise_power": None} if known else {}))
    ends = [at(altered), *([] if known else [solving.solved(altered, "joint").estimate])]
    for found in map(assess, ends):
        assert [fault.name for fault in found.channels.faults] == ["17"] and found.verdict == "good", found.message
        assert "faulty: microphone 17" in found.message


def test_a_source_inside_the_array_is_not_good():
    found = assess(at(room([], source=(2.7, 2.4))))
    assert found.verdict in ("model_mismatch", "known_position"), found.message


def test_an_array_too_wide_for_its_modes_is_undersampled():
    few = TRUTH[[0, 4, 12, 20, 24, 7]]
    measurement = measured(few, np.array([0, 1, 3]), highest=HIGHEST, snr_db=40)
    limit = array_f_max(few, 343.0, 2)
    assert limit < HIGHEST
    found = assess(at(measurement, few))
    assert found.verdict == "undersampled" and "Eq. 9" in found.message
    assert assess(at(measurement, few, int(np.sum(measurement.frequencies < limit)))).verdict != "undersampled"


def test_the_scale_of_a_plane_in_space_is_undetermined_without_known_microphones():
    """A sound field in space, sampled on a plane: sinc in place of J_0."""
    rng, count = np.random.default_rng(2), 160
    k, directions = np.linspace(1.0, 5.0, count), rng.normal(size=(count, 60, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    waves = np.exp(-1j * k[:, None, None] * np.einsum("mda,na->mdn", directions[..., :2], TRUTH))
    pressures = ((rng.normal(size=(count, 1, 60)) + 1j * rng.normal(size=(count, 1, 60))) @ waves)[:, 0]
    pressures, noise = with_noise(pressures, 40, rng)
    blind = Measurement(k * 343 / (2 * np.pi), pressures, 343.0, 3, 2, noise_power=noise, positions=TRUTH)
    for known, code in (([], "scale_undetermined"), (CORNERS, "good")):
        found = assess(at(replace(blind, known=known, known_positions=TRUTH[known])))
        assert found.verdict == code, found.message


def test_without_noise_the_right_array_is_accepted_and_one_wrong_by_millimetres_is_not():
    truth = np.random.default_rng(0).uniform(-0.5, 0.5, (28, 2)) + [2.61, 2.31]
    measurement = measured(truth, np.array([0, 1, 2]), highest=120.0, source=(2.0, 3.2))
    measurement = replace(measurement, noise_power=np.zeros(len(measurement.frequencies)))
    assert assess(at(measurement, truth)).verdict == "good"
    wrong = truth + np.random.default_rng(1).normal(0, 0.005, truth.shape)
    wrong[:3] = truth[:3]
    assert assess(at(measurement, wrong)).verdict == "model_mismatch"


def test_remedies_of_an_ambiguous_array_name_unused_modes_and_the_least_certain_microphones(estimate):
    rows = [one for one in FINDINGS if one.code == "ambiguous" and "another array" not in one.reason]
    names, known = [str(n) for n in range(len(estimate.positions))], estimate.problem.known
    sigma = np.sqrt(np.trace(covariance_of(estimate), axis1=1, axis2=2))
    for row in rows:
        finding, seen = replace(row, applies=lambda *_: True, words=lambda _: "uncertain"), judged(estimate, names)
        of_modes = (replace(seen, estimate=replace(estimate, modes=m)) for m in (slice(0, 5), slice(None)))
        few, every = (first_finding(one, [finding])[1] for one in of_modes)
        assert few == every.replace("uncertain; ", "uncertain; use <modes> 10, or ")
        asked = [int(n) for n in re.findall(r"\d+", every.partition("of microphones")[2].partition("(<known>)")[0])]
        others = np.setdiff1d(np.arange(len(sigma)), [*known, *asked])
        assert len(asked) == 4 and not np.isin(asked, known).any() and sigma[asked].min() >= sigma[others].max()


# --- the verdict depends on the result, not on the course of the run ------------------------------------------------


@pytest.mark.parametrize("known", ["all", "none"])
def test_the_same_end_has_the_same_sigma(healthy, known):
    """The path does not matter: the run starts again from its end with one microphone moved away."""
    measurement = healthy if known == "all" else replace(healthy, known=np.zeros(0, int), known_positions=None)
    problem, first = (end := solving.solved(measurement)).problem, end.state
    start = np.array(first.positions)
    start[int(problem.free[3])] += 0.2 * np.array([0.6, 0.8])
    other = run_from(robust, problem, robust.init(problem, first.settings, 0, positions=start))[-1]
    x = other.positions if len(problem.known) else align(other.positions, first.positions)
    assert np.linalg.norm(x - first.positions, axis=1).max() < 5e-5
    sigmas = (assess(robust.result(problem, state)).uncertainty for state in (first, other))
    np.testing.assert_allclose(*sigmas, rtol=0.1)
