"""What a verdict must detect, what it must not report, and the sound speed from a known length."""

from dataclasses import replace

import numpy as np
import pytest
from fields import measured

from fdcal.acoustics.fourier_bessel import array_f_max
from fdcal.assessment import sound_speed
from fdcal.assessment.ambiguity import ambiguous
from fdcal.assessment.diagnostics import diagnose
from fdcal.assessment.uncertainty import pressures_and_field
from fdcal.assessment.verdict import judge
from fdcal.model.gauge import align, position_errors
from fdcal.model.measurement import Measurement
from fdcal.model.settings import SolverSettings
from fdcal.session.assess import assess
from fdcal.session.calibrate import solve
from fdcal.session.sources import CalibrationInput
from fdcal.solvers import run
from fdcal.solvers.levenberg_marquardt import DAMPING
from fdcal.solvers.position_fit import position_step

GRID = np.linspace(-0.5, 0.5, 5)
TRUTH = np.array([(x, y) for x in GRID for y in GRID]) + [2.6, 2.3]
TRUTH += np.random.default_rng(0).normal(scale=0.03, size=TRUTH.shape)
KNOWN = [0, 4, 22]
HIGHEST = 230.0
ALL = slice(0, None)


def settled(measurement: Measurement, start=TRUTH):
    """Problem and least cost near the truth, as a solver that starts well finds it."""
    problem = measurement.problem()
    p, field = pressures_and_field(problem, start, ALL, problem.noise_power)
    D = 2
    basis = np.eye(start.size)[:, (D * problem.free[:, None] + np.arange(D)).ravel()]
    x, damping = start, DAMPING.first
    for _ in range(25):
        trial = position_step(x, p, field, basis, damping)
        x, damping = trial.unknowns, trial.damping
        if trial.moved < 1e-5:
            break
    return problem, x


def verdict(measurement: Measurement, noise_given=True):
    problem, x = settled(measurement)
    return judge(problem, x, ALL, problem.noise_power if noise_given else None, measurement.names)


def altered(measurement: Measurement, change) -> Measurement:
    pressures = measurement.pressures.copy()
    change(pressures)
    return replace(measurement, pressures=pressures)


def room(known=KNOWN, snr_db=30.0, seed=0, **kind) -> Measurement:
    return measured(TRUTH, known, highest=HIGHEST, snr_db=snr_db, seed=seed, **kind)


@pytest.mark.parametrize("known", [KNOWN, []], ids=["known", "blind"])
@pytest.mark.parametrize("snr_db", [np.inf, 40, 30, 20, 10])
def test_a_right_array_is_good(known, snr_db):
    seed = int(10 * len(known) + min(snr_db, 50))
    source = 5.6 - 0.01 * seed, 4.53
    found = verdict(room(known, snr_db, seed, source=source), noise_given=np.isfinite(snr_db))
    assert found.code == "good", found.text
    assert ("times the noise given" in found.text) == np.isfinite(snr_db)
    assert found.uncertainty.shape == (25,)
    assert np.all(found.uncertainty[known] == 0) and np.all(np.delete(found.uncertainty, known) > 0)


@pytest.mark.parametrize("noise_given", [True, False], ids=["noise given", "noise estimated"])
@pytest.mark.parametrize("known", [KNOWN, []], ids=["known", "blind"])
@pytest.mark.parametrize("kind", ["gain", "phase", "garbage"])
def test_an_odd_channel_is_named_with_the_argument_that_leaves_it_out(kind, known, noise_given):
    rng = np.random.default_rng(1)

    def change(p):
        noise = rng.standard_normal((2, len(p)))
        new = {
            "gain": 0.4 * p[:, 17],
            "phase": -p[:, 17],
            "garbage": np.abs(p).mean(axis=1) * (noise[0] + 1j * noise[1]),
        }
        p[:, 17] = new[kind]

    found = verdict(altered(room(known), change), noise_given)
    assert found.code == "odd_channel", found.text
    assert "leave it out with --exclude 17" in found.worded({"exclude": "--exclude"}) and found.text.startswith(
        "microphone 17"
    )


@pytest.mark.parametrize("snr_db", [np.inf, 30])
@pytest.mark.parametrize("known", [KNOWN, []], ids=["known", "blind"])
def test_a_source_inside_the_array_is_not_good(snr_db, known):
    found = verdict(room(known, snr_db, source=(2.7, 2.4)), noise_given=np.isfinite(snr_db))
    assert found.code in ("model_mismatch", "odd_channel", "known_position"), found.text


@pytest.mark.parametrize("change", [1.04, 0.96])
def test_a_wrong_sound_speed_is_reported_and_estimated(change):
    right = room(snr_db=40)
    wrong = replace(right, sound_speed=343 * change, wavenumbers=right.wavenumbers / change)
    problem, x = settled(wrong)
    found = judge(problem, x, ALL, problem.noise_power)
    assert found.code == "sound_speed" and "add estimate_sound_speed" in found.text
    estimate = sound_speed.from_known(problem, x, ALL, problem.noise_power)
    assert estimate.sound_speed == pytest.approx(343, rel=0.004)
    assert position_errors(estimate.positions, TRUTH).max() < 0.5 * position_errors(x, TRUTH).max()
    assert np.array_equal(estimate.positions[KNOWN], TRUTH[KNOWN])
    assert judge(estimate.problem, estimate.positions, ALL, problem.noise_power).code == "good"


def test_blind_a_known_distance_gives_the_sound_speed():
    right = room([], snr_db=40)
    wrong = replace(right, sound_speed=343 * 1.05, wavenumbers=right.wavenumbers / 1.05)
    problem, x = settled(wrong)
    metres = float(np.linalg.norm(TRUTH[0] - TRUTH[24]))
    found = sound_speed.from_distance(problem, x, (0, 24), metres)
    assert found.sound_speed == pytest.approx(343, rel=0.01)
    assert np.linalg.norm(found.positions[0] - found.positions[24]) == pytest.approx(metres)
    assert position_errors(align(found.positions, TRUTH), TRUTH).max() < 0.02
    with pytest.raises(ValueError, match="two known microphones"):
        sound_speed.from_known(problem, x, ALL, problem.noise_power)


@pytest.mark.parametrize("pair", [(4, 18), (4, 22)], ids=["with an unknown one", "with a known one"])
def test_a_swap_that_involves_a_known_microphone_is_not_good(pair):
    def change(p):
        p[:, list(pair)] = p[:, list(pair[::-1])]

    for noise_given in (True, False):
        found = verdict(altered(room(), change), noise_given)
        assert found.code != "good"
    assert found.code in ("known_position", "odd_channel", "model_mismatch")


def test_an_array_too_wide_for_its_modes_is_undersampled():
    few = TRUTH[[0, 4, 12, 20, 24, 7]]
    measurement = measured(few, [0, 1, 3], highest=HIGHEST, snr_db=40)
    problem, x = settled(measurement, few)
    limit = array_f_max(few, problem.sound_speed, problem.dimension)
    assert limit < HIGHEST
    found = judge(problem, x, ALL, problem.noise_power)
    assert found.code == "undersampled" and "Eq. 9" in found.text
    low = slice(0, int(np.sum(problem.frequencies < limit)))
    assert judge(problem, few, low, problem.noise_power).code != "undersampled"


@pytest.mark.parametrize("count", [8, 9, 10, 11])
def test_a_sparse_array_whose_rim_is_hard_to_predict_is_not_odd(count):
    corners = [[2.2, 1.9], [3.0, 1.9], [2.6, 2.7]]
    for seed in range(6):
        inside = np.random.default_rng(seed).uniform(-0.5, 0.5, (count - 3, 2)) + [2.6, 2.3]
        few = np.array([*corners, *inside])
        measurement = measured(few, [0, 1, 2], highest=38 * count, snr_db=30, seed=seed)
        problem = measurement.problem()
        found = judge(problem, few, ALL, problem.noise_power)
        assert found.code not in ("odd_channel", "known_position"), found.text


def test_too_much_noise_is_reported():
    assert verdict(room(snr_db=0)).code == "too_noisy"


def test_known_microphones_on_one_line_leave_the_side_open():
    line = TRUTH.copy()
    line[[0, 1, 2]] = [[2.1, 2.3], [2.6, 2.3], [3.1, 2.3001]]
    problem, x = settled(measured(line, [0, 1, 2], highest=HIGHEST, snr_db=20), line)
    found = judge(problem, x, ALL, problem.noise_power)
    assert found.code == "ambiguous" and "another array" in found.text


def test_other_minima_and_a_stop_before_the_end_are_reported():
    measurement = room()
    problem, x = settled(measurement)
    rival = x + np.random.default_rng(0).normal(scale=0.2, size=x.shape)
    figures = diagnose(problem, x, ALL, problem.noise_power)
    assert "another array" in ambiguous(problem, x, figures, [(rival, 2.0)])
    assert ambiguous(problem, x, figures, [(rival, 200.0)]) == ""
    assert judge(problem, x, ALL, problem.noise_power).code == "good"
    assert judge(problem, x, ALL, problem.noise_power, converged=False).code == "not_converged"


def test_the_scale_of_a_plane_in_space_is_not_determined_blind():
    """A sound field in space, sampled on a plane: sinc in place of J_0."""
    rng = np.random.default_rng(2)
    k = np.linspace(1.0, 5.0, 24)
    directions = rng.normal(size=(24, 60, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    waves = np.exp(-1j * k[:, None, None] * np.einsum("mda,na->mdn", directions[..., :2], TRUTH))
    amplitudes = rng.normal(size=(24, 1, 60)) + 1j * rng.normal(size=(24, 1, 60))
    pressures = (amplitudes @ waves)[:, 0]
    power = np.mean(np.abs(pressures) ** 2, axis=1)
    blind = Measurement(
        frequencies=k * 343 / (2 * np.pi),
        pressures=pressures,
        sound_speed=343.0,
        dimension=3,
        array_dimension=2,
        noise_power=1e-4 * power,
    )
    for known, code in (([], "scale_undetermined"), (KNOWN, "good")):
        problem = replace(blind, known=known, known_positions=TRUTH[known]).problem()
        found = judge(problem, TRUTH, ALL, 1e-4 * np.ones(24))
        assert found.code == code, found.text


def test_a_source_beside_the_array_is_no_mismatch_where_there_is_no_noise():
    """The kernel of a diffuse field alone cannot explain it to the last decibel; the near model of the end can."""
    truth = np.random.default_rng(7).uniform(-0.5, 0.5, (40, 2)) + [2.61, 2.31]
    measurement = measured(truth, [0, 1, 2], source=(3.6, 2.9))
    result = solve(CalibrationInput("beside", None, measurement, SolverSettings(name="joint", modes=40), 0))
    assert result.max_error < 1e-3
    assert result.verdict == "good", result.verdict_text


@pytest.mark.parametrize("source", [(2.0, 3.2), (5.47, 4.53)], ids=["near", "far"])
def test_without_noise_the_right_array_is_accepted_and_one_wrong_by_millimetres_is_not(source):
    """The kernel of a diffuse field distinguishes neither: its own residual exceeds the noise."""
    truth = np.random.default_rng(0).uniform(-0.5, 0.5, (40, 2)) + [2.61, 2.31]
    measurement = measured(truth, [0, 1, 2], highest=120.0, source=source)
    problem = replace(measurement, noise_power=np.zeros(len(measurement.frequencies))).problem()
    assert judge(problem, truth, ALL, problem.noise_power).code == "good"
    wrong = truth + np.random.default_rng(1).normal(0, 0.003, truth.shape)
    wrong[:3] = truth[:3]
    found = judge(problem, wrong, ALL, problem.noise_power)
    assert found.code == "model_mismatch" and "1 is expected" in found.text


def test_calibrate_reports_a_wrong_array_where_there_is_no_noise():
    """The verdict of a whole calibration, of an end with the near model with errors of 5 mm added."""
    truth = np.random.default_rng(7).uniform(-0.5, 0.5, (40, 2)) + [2.61, 2.31]
    measurement = measured(truth, [0, 1, 2], highest=120.0)
    measurement = replace(measurement, noise_power=np.zeros(len(measurement.frequencies)))
    problem, settings = measurement.problem(), SolverSettings(name="joint", modes=12)
    *_, state = run(problem, settings, 0)
    assert state.field.near_field
    spoilt = truth + np.random.default_rng(1).normal(0, 0.005, truth.shape)
    spoilt[:3] = truth[:3]
    inputs = CalibrationInput("x", None, measurement, settings, 0)
    codes = [assess(inputs, problem, replace(state, positions=x)).verdict for x in (state.positions, spoilt)]
    assert codes == ["good", "model_mismatch"]
