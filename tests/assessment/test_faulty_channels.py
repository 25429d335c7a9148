"""Faults of single channels are found, and do not move other microphones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from fields import disc, measured, waves
from solving import estimated_at, solved

import fdcal
from fdcal.assessment.assess import Assessment, assess, judged
from fdcal.assessment.calibration import ChannelFault
from fdcal.assessment.channels import exchanged_back, faulty_channels
from fdcal.assessment.findings import precision
from fdcal.assessment.uncertainty import covariance_of
from fdcal.assessment.words import faults_text
from fdcal.model.measurement import Measurement
from fdcal.solvers.interface import Estimate, GivenHypothesis

COUNT, MODES, KNOWN, FAULTY = 20, 32, [0, 5, 11, 17], 7
NAMES = [str(n) for n in range(COUNT)]


def array():
    """Positions within a disc of 0.5 m in the room of `fields.measured`."""
    return disc(COUNT, 0.5, 3, (2.6, 2.3))


def found_in(measurement: Measurement) -> tuple[Assessment, Mapping[int, ChannelFault]]:
    """Assessment of the measurement, and its faulty channels by their numbers."""
    end = solved(measurement)
    return end.assessment, judged(end.estimate, measurement.names).faulty


@pytest.fixture(scope="module")
def healthy():
    return measured(array(), np.array(KNOWN), snr_db=40.0, modes=MODES)


@pytest.fixture(scope="module")
def estimate(healthy):
    return solved(healthy).estimate


def with_noise_of(estimate: Estimate, channel: int, noise: float) -> Estimate:
    noises = np.where(np.arange(COUNT) == channel, noise, estimate.channels.noise)
    return replace(estimate, channels=replace(estimate.channels, noise=noises))


def errors(found: Assessment, measurement: Measurement) -> np.ndarray:
    return np.linalg.norm(found.positions - measurement.positions, axis=1)


def test_a_delay_counts_only_beyond_the_uncertainty_that_the_field_causes(estimate):
    """Blocks of frequencies that disagree ten times more than a diffuse field would make filters less certain, too."""
    sigma = np.full((COUNT, 2), 1e-5 * estimate.problem.sound_speed)  # m, of the delays
    filters = np.zeros((COUNT, 2))
    filters[FAULTY, 0] = 6 * sigma[FAULTY, 0]
    channels = replace(estimate.channels, filters=filters, filter_sigma=sigma)
    for dispersion, kinds in ((1.0, ["delayed"]), (10.0, [])):
        spread = replace(estimate.spread, dispersion=dispersion)
        filtered = replace(estimate, channels=channels, spread=spread)
        found = faulty_channels(filtered, covariance_of(filtered), NAMES)
        assert [one.kind for n, one in found.items() if n == FAULTY] == kinds


def test_channels_that_all_differ_are_not_at_fault(healthy):
    """With gains of 3 dB (one sigma) each gain is found, and none is a fault."""
    gains_db = 3.0 * np.random.default_rng(0).normal(size=COUNT)
    found, faulty = found_in(replace(healthy, pressures=healthy.pressures * 10 ** (gains_db / 20)))
    assert faulty == {} and found.verdict == "good"
    off = found.channels.gain_db - gains_db
    off -= np.median(off)  # the source contains a gain that all channels have in common
    assert np.max(np.abs(off)) < 0.5 and np.mean(np.abs(off) < 2.5 * found.channels.gain_sigma_db) > 0.85
    assert np.max(errors(found, healthy)) < 0.02


def test_a_channel_of_pure_noise_moves_no_other_microphone(healthy):
    p, rng = np.array(healthy.pressures), np.random.default_rng(5)
    power = np.sqrt(np.mean(np.abs(p) ** 2, axis=1))
    p[:, FAULTY] = power * (rng.normal(size=MODES) + 1j * rng.normal(size=MODES)) / np.sqrt(2)
    found, faulty = found_in(replace(healthy, pressures=p))
    assert [(n, one.kind) for n, one in faulty.items()] == [(FAULTY, "dead")] and found.verdict == "good"
    others = ~np.isin(np.arange(COUNT), list(faulty))
    shift = np.linalg.norm(found.positions - solved(healthy).assessment.positions, axis=1)[others]
    # Without this channel the other positions change by less than twice their uncertainty.
    assert np.all(shift < 2 * found.uncertainty[others])


# Each fault multiplies the pressures of a channel, and is found with its kind, unit and value.
GAINS = {
    2: (lambda f: -1.0, "inverted", "", None),
    7: (lambda f: 10 ** (6 / 20), "gain", "dB", 6.0),
    9: (lambda f: np.exp(1j * np.radians(40)), "gain", "degrees", 40.0),
}
FILTERS = {
    7: (lambda f: 1j * f / (40 + 1j * f), "high_pass", "Hz", 40.0),
    13: (lambda f: np.exp(2j * np.pi * f * 2e-4), "delayed", "s", -2e-4),
}


@pytest.mark.parametrize("faults", [GAINS, FILTERS], ids=["gains", "filters"])
def test_each_fault_is_named_with_its_value_and_what_the_model_explains_is_no_mismatch(healthy, faults):
    """This holds for few faults; test_assess.py tests many."""
    p = np.array(healthy.pressures)
    for n, (factor, *_) in faults.items():
        p[:, n] *= factor(healthy.frequencies)
    found, faulty = found_in(replace(healthy, pressures=p))
    assert found.verdict == "good" and faulty.keys() == faults.keys(), found.message
    for n, (_, kind, unit, value) in faults.items():
        assert (faulty[n].kind, faulty[n].unit) == (kind, unit)
        assert faulty[n].value == (value if value is None else pytest.approx(value, rel=0.1))
    # Faulty channels are predicted as well: the model contains their fault.
    assert np.max(errors(found, healthy)) < 0.012


def test_half_of_the_channels_without_signal_are_named_and_the_verdict_counts_them(estimate):
    dead, field = np.setdiff1d(np.arange(COUNT), KNOWN)[:10], estimate.field
    weights, power = np.array(field.terms.precision), field.power[:, None] + field.noise[:, None]
    weights[:, dead] = 1 / power  # the other channels predict nothing of the dead ones
    silent = replace(estimate, field=replace(field, terms=replace(field.terms, precision=weights)))
    found = assess(silent, NAMES)
    assert [fault.kind for fault in found.channels.faults] == 10 * ["dead"] and found.verdict == "model_mismatch"
    sigma = precision(found.uncertainty[np.setdiff1d(np.arange(COUNT), [*KNOWN, *dead])])
    assert found.message.startswith("10 of 20 channels are faulty: microphones 1, ")
    assert f"dead; the other 10 are too few to check these positions; {sigma}; " in found.message
    assert "sigma" not in assess(replace(silent, ended=False), NAMES).message


def test_few_faulty_channels_of_a_small_array_are_too_many_whether_or_not_half_of_them_are_noisy():
    small = solved(measured(disc(10, 0.3, 3, (2.6, 2.3)), np.array([0, 3, 6, 8]), snr_db=40.0, modes=MODES)).estimate
    noise, gains = np.array(small.channels.noise), np.array(small.channels.gains)
    noise[[1, 2]], gains[[4, 5], 1] = 1e4, np.pi
    found = assess(replace(small, channels=replace(small.channels, noise=noise, gains=gains)))
    assert found.verdict == "model_mismatch" and "4 of 10 channels are faulty" in found.message


@pytest.mark.parametrize(("together", "lowest"), [(9, 100), (9, 20), (0, 20)])
def test_in_an_array_too_sparse_for_a_prediction_no_channel_is_dead(together, lowest):
    x = np.concatenate([disc(9, 0.05)[:together], np.random.default_rng(0).uniform(-2, 2, (COUNT - together, 2))])
    f = np.linspace(lowest, 400, MODES)
    p = waves(x, 2 * np.pi * f / 343, noise=1e-3)
    end = estimated_at(Measurement(f, p, 343.0, positions=x, known=np.array([0, 3, 6, 8])))
    assert faulty_channels(end, covariance_of(end), NAMES) == {}


def test_a_noisy_channel_is_reported_with_its_excess_in_decibels(healthy):
    p, rng = np.array(healthy.pressures), np.random.default_rng(6)
    draws = rng.normal(size=(2, MODES)) * np.sqrt(np.mean(np.abs(p) ** 2, axis=1) * 10 ** (-15 / 10) / 2)
    p[:, FAULTY] += draws[0] + 1j * draws[1]
    _, faulty = found_in(replace(healthy, pressures=p))
    assert [(n, one.kind, one.unit) for n, one in faulty.items()] == [(FAULTY, "noisy", "dB")]
    assert faulty[FAULTY].value == pytest.approx(40 - 15, abs=3)  # relative to channels with noise at 40 dB


def test_a_delay_that_the_solver_did_not_look_for_is_found_in_what_the_others_predict(estimate):
    """Descent has no filters, so that the phase against the prediction by the others falls with the frequency."""
    f, terms = estimate.problem.frequencies[estimate.modes], estimate.field.terms
    for delay in (-1e-3, 1e-3):
        delayed = np.array(terms.corrected)
        delayed[:, FAULTY] *= np.exp(-2j * np.pi * f * delay)
        # The prediction by the other channels does not change.
        weighted = terms.weighted + (delayed - terms.corrected) * terms.precision
        field = replace(estimate.field, terms=replace(terms, corrected=delayed, weighted=weighted))
        late = replace(with_noise_of(estimate, FAULTY, 1e4), field=field)
        ((n, one),) = faulty_channels(late, covariance_of(late), NAMES).items()
        assert (n, one.kind) == (FAULTY, "delayed") and one.value == pytest.approx(delay, abs=2e-5)


def test_noise_of_a_channel_whose_exact_position_is_wrong_is_no_fault_of_the_channel(estimate):
    """A solver with exact given positions explains the error of a position by noise of its channel."""
    noisy = with_noise_of(estimate, KNOWN[1], 100.0)
    wrong, positions = np.arange(len(KNOWN)) == 1, np.array(estimate.positions)
    positions[KNOWN[1]] += 0.03, 0.04
    ones = np.ones(len(KNOWN))
    hypothesis = GivenHypothesis(positions, 1e-3 * ones, ones, wrong)
    exact = replace(noisy, given=replace(estimate.given, sigma=0.0, contradicted=hypothesis))
    found = [faulty_channels(of, covariance_of(of), NAMES) for of in (noisy, exact)]
    kinds = [[(n, one.kind) for n, one in faulty.items()] for faulty in found]
    assert kinds[0] == [(KNOWN[1], "noisy")] and kinds[1] == [(KNOWN[1], "misplaced")]


def test_noise_of_a_channel_below_what_the_model_can_show_is_no_fault(estimate):
    noisy = with_noise_of(estimate, FAULTY, 100.0)
    low = replace(noisy, field=replace(estimate.field, noise_fraction=1e-8))
    covariance = np.array(covariance_of(noisy))
    assert list(faulty_channels(noisy, covariance, NAMES)) == [FAULTY]
    assert faulty_channels(low, covariance, NAMES) == {}
    covariance[FAULTY] = 0.03**2 * np.eye(2)  # an error of the position causes an equally large residual
    assert faulty_channels(noisy, covariance, NAMES) == {}


def test_a_given_position_within_its_sigma_is_not_misplaced_and_one_near_another_microphone_not_exchanged(estimate):
    n, covariance = KNOWN[2], covariance_of(estimate)
    moved = np.array(estimate.problem.known_positions)
    moved[2] = estimate.positions[FAULTY] + [0.02, 0.0]
    near = replace(estimate, problem=replace(estimate.problem, known_positions=moved))
    assert [(n, one.kind) for n, one in faulty_channels(near, covariance, NAMES).items()] == [(n, "misplaced")]
    moved = moved.copy()
    moved[2] = estimate.positions[n] + [0.05, 0.0]
    away = replace(estimate, problem=replace(estimate.problem, known_positions=moved))
    ((number, one),) = faulty_channels(away, covariance, NAMES).items()
    assert (number, one.kind, one.unit) == (n, "misplaced", "m") and one.value == pytest.approx(0.05)
    covariance = np.array(covariance)
    covariance[n] = 0.03**2 / 2 * np.eye(2)
    assert faulty_channels(away, covariance, NAMES) == {}


def test_a_free_channel_that_was_exchanged_with_a_given_one_goes_to_its_own_place(estimate):
    n, other, x = KNOWN[0], FAULTY, np.array(estimate.positions)
    x[[n, other]] = x[[other, n]]  # the pressures place the two channels there
    swapped = replace(estimate, positions=x)
    faulty = faulty_channels(swapped, covariance_of(swapped), NAMES)
    assert {(number, one.kind, one.partner) for number, one in faulty.items()} == {
        (n, "swapped", NAMES[other]), (other, "swapped", NAMES[n])
    }  # fmt: skip
    np.testing.assert_array_equal(exchanged_back(swapped, faulty, NAMES), estimate.positions)
    np.testing.assert_array_equal(assess(swapped).positions, estimate.positions)


def test_exchanged_given_positions_are_named_with_their_partner(healthy):
    known = np.array([0, 2, 5, 8, 11, 14, 17, 19])
    given = healthy.positions[known]
    given[[2, 4]] = given[[4, 2]]
    _, faulty = found_in(replace(healthy, known=known, known_positions=given))
    assert [(fault.name, fault.kind, fault.partner) for fault in faulty.values()] == [
        ("5", "swapped", "11"), ("11", "swapped", "5")
    ]  # fmt: skip
    assert faults_text([faulty[5]]) == "microphone 5: swapped with microphone 11"


def test_a_scene_without_noise_has_no_faulty_channel():
    # A model of few microphones leaves 45 dB below the signal unexplained, which becomes the noise of one channel.
    found = fdcal.calibrate(fdcal.simulate(replace(fdcal.load_scene("tiny"), seed=18)), known="none")
    assert [one.name for one in found.channels.faults] == []
