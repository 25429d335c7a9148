"""Which given positions fix an array: hypotheses compared with a free array, and the answer of the solver."""

from dataclasses import replace

import numpy as np
import pytest
from fields import disc, measured
from solving import rms, rms_of_shape, solved

from fdcal.model.validation import frozen_array
from fdcal.solvers import load
from fdcal.solvers.robust.given import FreeArray, free_array, hypotheses, mirror_advantage, resolved
from fdcal.solvers.robust.objective import Unknowns, in_unit_power

COUNT, MODES, KNOWN = 24, 28, np.array([0, 5, 9, 14, 18, 23])


def array(count=COUNT):
    return disc(count, 0.5, 3, (2.6, 2.3))


def free(x, sigma=1e-3, turn=0.7):
    """The array `x`, turned, with uncorrelated errors of `sigma`."""
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    noise = sigma * np.random.default_rng(1).normal(size=x.shape)
    return FreeArray(Unknowns((x + noise) @ rotation, np.zeros((len(x), 2))), sigma**2 * np.eye(x.size))


def likeliest(places, x=None, known=KNOWN, **changed):
    x = array() if x is None else x
    return hypotheses(free(x), known, places, changed.get("stated"))[0]


def test_right_positions_are_all_held_and_put_the_array_in_their_frame():
    x = array()
    best = likeliest(x[KNOWN])
    assert np.all(best.right) and np.array_equal(best.order, np.arange(6)) and best.sigma < 2e-3
    assert np.max(np.abs(best.positions - x)) < 5e-3


@pytest.mark.parametrize(("count", "away"), [(6, [0.04, -0.03]), (8, [-0.3, 0.1]), (20, [-0.3, 0.1])])
def test_a_wrong_position_constrains_nothing(count, away):
    x, known = array(40), np.arange(0, 2 * count, 2)
    places = x[known]
    places[5] += away
    best = likeliest(places, x, known)
    assert np.flatnonzero(~best.right).tolist() == [5] and np.max(np.abs(best.positions - x)) < 5e-3


@pytest.mark.parametrize("count", [3, 12])
def test_exchanged_positions_are_corrected(count):
    x, known = array(), np.arange(0, 2 * count, 2)
    order = np.arange(count)
    order[[0, 2]] = 2, 0
    best = likeliest(x[known][order], known=known)
    assert np.array_equal(best.order, order) and np.all(best.right)
    assert np.max(np.abs(best.positions - x)) < 5e-3


def test_two_positions_so_close_that_an_exchange_hardly_matters_are_held_as_given():
    """An exchange is rare, so that it is not assumed if the pressures hardly depend on it."""
    x = array()
    x[KNOWN[3]] = x[KNOWN[1]] + [0.0024, -0.0018]
    exchanged = np.array([0, 3, 2, 1, 4, 5])
    found = hypotheses(free(x), KNOWN, x[KNOWN][exchanged], None)
    assert np.array_equal(found[0].order, np.arange(6)) and np.all(found[0].right)
    other = next(one for one in found if np.array_equal(one.order, exchanged))
    assert np.max(np.abs(found[0].positions - x)) < 6e-3 and other.log_evidence > found[0].log_evidence - 6.0


def test_positions_that_are_all_inaccurate_are_all_held_less_firmly():
    x, rng = array(), np.random.default_rng(5)
    best = likeliest(x[KNOWN] + 0.015 * rng.normal(size=(6, 2)))
    assert np.all(best.right) and 0.008 < best.sigma < 0.03
    assert likeliest(x[KNOWN] + 0.015 * rng.normal(size=(6, 2)), stated=0.004).sigma <= 0.004


def test_the_frame_changes_no_evidence():
    x = array()
    places = x[KNOWN] + 0.01 * np.random.default_rng(2).normal(size=(6, 2))
    one, other = (hypotheses(free(x), KNOWN, p, None) for p in (places, places[:, ::-1] + [3.0, -1.0]))
    assert np.allclose([h.log_evidence for h in one], [h.log_evidence for h in other], atol=1e-6)


@pytest.fixture(scope="module")
def healthy():
    return measured(array(), KNOWN, snr_db=40.0, modes=MODES)


def given(measurement, change):
    """`measurement` with the given positions changed by `change` (A, D), metres."""
    return replace(measurement, known_positions=measurement.positions[measurement.known] + change)


def test_the_array_is_that_without_the_wrong_position(healthy):
    wrong = np.zeros((6, 2))
    wrong[2] = 0.05, -0.02
    end, right = solved(given(healthy, wrong)), np.delete(KNOWN, 2)
    without = solved(replace(healthy, known=right, known_positions=healthy.positions[right])).assessment
    assert end.assessment.verdict == "good" and end.faulty == [(KNOWN[2], "misplaced")]
    away = np.linalg.norm(end.assessment.positions - without.positions, axis=1)
    assert np.max(away / without.uncertainty) < 0.5
    assert end.state.model.contradicted.tolist() == [False, False, True, False, False, False]


def test_the_probability_of_given_positions_does_not_depend_on_where_near_the_minimum_a_run_ended(healthy):
    end, away = solved(healthy), 3e-4 * np.random.default_rng(0).normal(size=healthy.positions.shape)
    away[KNOWN] = 0.0
    beside = load("robust").result(end.problem, replace(end.state, positions=end.state.positions + away))
    one, other = (estimate.given.probability(np.arange(len(KNOWN))) for estimate in (end.estimate, beside))
    assert other == pytest.approx(one, abs=0.02)


def test_positions_that_are_all_inaccurate_do_not_deform_the_array(healthy):
    away = np.random.default_rng(7).normal(size=(6, 2))
    away *= 0.02 / np.linalg.norm(away, axis=1)[:, None]
    end, accurate = solved(given(healthy, away)), solved(healthy)
    found, truth = end.assessment, healthy.positions
    assert rms_of_shape(found.positions, truth) < 1.5 * rms_of_shape(accurate.assessment.positions, truth) + 5e-4
    assert found.verdict == "good" and end.state.model.known_sigma > 5e-3
    assert "the given positions are inaccurate" in found.message
    assert rms(found.positions, truth) < 2 * np.sqrt(np.mean(found.uncertainty**2))
    assert np.max(found.uncertainty) < 0.05


def test_a_wrong_sound_speed_is_reported_and_no_position_is_blamed(healthy):
    wrong = replace(healthy, sound_speed=1.05 * healthy.sound_speed, wavenumbers=healthy.wavenumbers / 1.05)
    for solver in ("robust", "joint"):
        end = solved(wrong, solver)
        assert end.assessment.verdict == "known_position" and end.faulty == []
        assert "a given position or the sound speed is wrong" in end.assessment.message


def test_a_wrong_position_and_a_wrong_sound_speed_with_equally_good_fits_are_not_distinguished():
    """Three positions determine few lengths, so that with noise either explanation is possible."""
    three = measured(array(), KNOWN[:3], snr_db=40.0, modes=MODES)
    found = solved(given(three, [[0, 0], [0.04, -0.02], [0, 0]]), "joint").assessment
    assert found.verdict != "good" and "sound speed is wrong" in found.message


def test_the_distance_of_an_exact_position_from_its_microphone_is_reported(healthy):
    """The position never moves, so that the result does not show the distance."""
    wrong, away = np.zeros((6, 2)), 0.03
    wrong[2] = 0.8 * away, -0.6 * away
    end = solved(given(healthy, wrong), "joint")
    assert end.faulty == [(KNOWN[2], "misplaced")]
    assert np.array_equal(end.state.positions[KNOWN], healthy.positions[KNOWN] + wrong)
    assert rms(end.state.positions, healthy.positions, np.arange(COUNT) != KNOWN[2]) < 6e-3, "the array is not bent"
    channels = end.assessment.channels
    assert channels is not None
    (fault,), row = channels.faults, channels.given[2]
    assert row.wrong and fault.value == pytest.approx(row.difference) == pytest.approx(away, abs=5e-3)
    assert np.linalg.norm(np.array(row.found) - healthy.positions[KNOWN[2]]) < 5e-3


def test_a_channel_at_an_exact_position_that_is_exchanged_is_put_back(healthy):
    pressures, partner = healthy.pressures.copy(), 7
    pressures[:, [KNOWN[1], partner]] = pressures[:, [partner, KNOWN[1]]]
    end = solved(replace(healthy, pressures=pressures), "joint")
    assert sorted(end.faulty) == sorted([(KNOWN[1], "swapped"), (partner, "swapped")])
    assert rms(end.assessment.positions, healthy.positions) < 3e-3


def test_the_mirror_image_of_an_array_is_turned_back_and_has_the_opposite_advantage(healthy):
    """Given positions count as before; only the mirror image differs, and the pressures fit both."""
    problem, right = in_unit_power((end := solved(healthy)).problem), end.state
    places = right.positions * [-1.0, 1.0] + [2 * healthy.known_positions[:, 0].mean(), 0.0]
    mirrored = replace(right, positions=frozen_array(places, float))
    assert rms(places, healthy.positions) > 0.1
    assert rms(resolved(problem, mirrored).positions, healthy.positions) < 0.01
    one, other = (mirror_advantage(problem, s, free_array(problem, s, 0)) for s in (right, mirrored))
    assert one > 10 and other == pytest.approx(-one, rel=0.05)


def test_given_positions_on_a_line_do_not_exclude_the_mirror_image_and_the_verdict_says_so():
    """Their distance from the line matters only if it exceeds the accuracy of the array, which is worse at 20 dB."""
    x, along = array(), np.linspace(-0.06, 0.06, 4)[:, None] * [0.6, 0.8]
    verdicts = {}
    for across in (0.0005, 0.05):
        x[:4] = [2.6, 2.3] + along + across * np.array([1, -1, -1, 1])[:, None] * [-0.8, 0.6]
        end = solved(measured(x, np.arange(4), snr_db=20.0, modes=MODES))
        verdicts[across] = end.assessment
        assert (end.estimate.given.mirror_advantage < 3) == (across < 0.01)
    assert verdicts[0.0005].verdict == "ambiguous" and "mirror image" in verdicts[0.0005].message
    assert "mirror image" not in verdicts[0.05].message
