"""Bounds of every calibration: whatever the file says, it ends in time and memory, and no microphone diverges."""

import itertools
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from fields import waves
from running import refuses

from fdcal import solvers
from fdcal.acoustics.compiled import OutOfTime, check_deadline, deadline
from fdcal.model.measurement import Measurement
from fdcal.model.settings import Search, SolverSettings
from fdcal.model.validation import InputError
from fdcal.session.calibration_run import solve
from fdcal.session.sources import CalibrationInput
from fdcal.solvers import interface as bounds
from fdcal.solvers.robust import channels
from fdcal.solvers.robust.objective import in_unit_power

SPEED = 343.0


def diffuse(count: int = 12, modes: int = 16, extent: float = 0.6, known: int = 4, **others) -> Measurement:
    """Return pressures of plane waves from all directions at an array in the plane, with noise 30 dB below."""
    positions = np.random.default_rng(1).uniform(-extent / 2, extent / 2, (count, 2))
    frequencies = np.linspace(100.0, 700.0, modes)
    pressures = waves(positions, 2 * np.pi * frequencies / SPEED, noise=1e-3)
    return Measurement(frequencies, pressures, SPEED, positions=positions, known=range(known), **others)


def inputs_of(measurement: Measurement, **others) -> CalibrationInput:
    settings = SolverSettings(modes=len(measurement.frequencies))
    return CalibrationInput("test", None, measurement, settings, 0, **others)


@pytest.mark.parametrize(("values", "words"), [
    ({"noise_power": np.full(16, 35.0)}, r"noise_power is .* decibels"),
    ({"noise_power": np.where(np.arange(16) == 3, 300.0, 1e-3)}, r"at 220 Hz.*leave that frequency out"),
    ({"wavenumbers": 1e12 * np.linspace(0.5, 1, 16)}, r"wavenumbers\[0\].*correct them"),
    ({"wavenumbers": 1e-12 * np.linspace(0.5, 1, 16)}, r"wavenumbers\[0\].*correct them"),
])  # fmt: skip
def test_numbers_that_no_measurement_has_are_refused(values, words):
    refuses(words, diffuse, **values)


@pytest.mark.parametrize("solver", ["joint", "robust"])
def test_what_would_fill_the_memory_is_refused_at_once(solver):
    measurement = diffuse()
    wrong = replace(measurement, positions=None, known_positions=10_000 * measurement.positions[:4])
    with pytest.raises(InputError, match=r"known microphones lie up to .* metres"):
        solve(replace(inputs_of(wrong), settings=SolverSettings(name=solver, modes=16)))
    p = np.random.default_rng(0).normal(size=(2, 60, 3000))
    many = Measurement(np.arange(100.0, 160.0), p[0] + 1j * p[1], SPEED)
    with pytest.raises(InputError, match=r"3000 microphones at 60 frequencies.*use at most 11 frequencies"):
        next(solvers.run(many.problem(), SolverSettings(name=solver, modes=60), 0))


class Stepping:
    """The default solver with another step."""

    def __init__(self, step):
        solver = solvers.load(SolverSettings().name)
        self.TRAITS, self.init, self.now = solver.TRAITS, solver.init, 0.0
        self.step = lambda problem, state: replace(state, **step(self, state), step=state.step + 1)


@pytest.mark.parametrize("step", [
    lambda _, state: {"positions": state.positions + 2.0 ** (state.step + 1) * np.eye(12)[:, 11:]},
    lambda _, state: {"positions": state.positions * np.nan},
], ids=["runs away", "is no number"])  # fmt: skip
def test_a_microphone_that_runs_away_ends_the_run(monkeypatch, step):
    stepping, problem = Stepping(step), diffuse().problem()
    monkeypatch.setattr(solvers, "load", lambda name: stepping)
    *_, end = itertools.islice(solvers.run(problem, SolverSettings(modes=16), 0), 1000)
    assert end.finished and not end.converged
    assert bounds.radius(end.positions) <= bounds.max_radius(problem, 16) < 20.0


def takes_a_second(stepping, state):
    stepping.now += 1.0
    return {"positions": state.positions + 1e-3}


def looks_at_the_deadline(stepping, state):
    while True:
        stepping.now += 1.0
        check_deadline()


@pytest.mark.parametrize(("step", "limit", "end", "moved"), [
    (takes_a_second, 1.0, 2.0, 2), (takes_a_second, 4.5, 5.0, 5), (takes_a_second, None, 91.0, 91),
    (looks_at_the_deadline, 40.0, 41.0, 0),
])  # fmt: skip
def test_the_limit_is_kept_to_a_step_or_trial_and_the_last_state_is_the_answer(monkeypatch, step, limit, end, moved):
    """The limit applies by default, with every solver."""
    stepping = Stepping(step)
    monkeypatch.setattr(solvers, "load", lambda name: stepping)
    inputs = inputs_of(diffuse(), time_limit=limit)
    first = stepping.init(inputs.measurement.problem(), inputs.settings, 0).positions
    result = solve(inputs, clock=lambda: stepping.now)
    assert stepping.now == end and result.verdict == "not_converged" and f"{limit or 90:.3g} s" in result.verdict_text
    assert "processor time" in result.verdict_text and "time_limit" in result.verdict_text
    np.testing.assert_allclose(result.positions, first + 1e-3 * moved, atol=1e-12)


def test_a_limit_that_passes_before_there_are_positions_is_refused():
    readings = itertools.count(0.0, 1.0)  # each reading of the clock is one second later
    with pytest.raises(InputError, match=r"2 s of processor time were used up before.*time_limit"):
        solve(inputs_of(diffuse(), time_limit=2.0), clock=lambda: next(readings))


def test_the_limit_grows_with_the_array_only_beyond_64_microphones():
    assert bounds.time_limit(diffuse(count=64, modes=64).problem(), 64) == 90.0
    assert bounds.time_limit(diffuse(count=128, modes=64).problem(), 64) == 360.0


def test_noise_alone_ends_in_time():
    p, known = np.random.default_rng(3).normal(size=(2, 12, 12)), 4
    places, frequencies = diffuse().positions[:known], np.linspace(100.0, 700.0, 12)
    measurement = Measurement(frequencies, p[0] + 1j * p[1], SPEED, known=range(known), known_positions=places)
    began, result = time.process_time(), solve(inputs_of(measurement))
    assert time.process_time() - began < 60 and result.verdict != "good"
    assert bounds.radius(result.positions) <= bounds.max_radius(measurement.problem(), 12)


# A calibration ends one step after its time limit at the latest, and returns the best positions so far.

COUNT, MODES = 12, 16


def absurd(kind: str) -> Measurement:
    """Return random pressures, at ordinary or very high frequencies; for "twins" each channel has a near copy."""
    rng = np.random.default_rng(5)
    p = rng.normal(size=(MODES, COUNT)) + 1j * rng.normal(size=(MODES, COUNT))
    if kind == "twins":
        p[:, COUNT // 2 :] = p[:, : COUNT // 2] + 1e-3 * p[:, COUNT // 2 :]
    frequencies = np.linspace(100, 12_000 if kind == "high" else 900, MODES)
    positions = rng.uniform(-0.3, 0.3, (COUNT, 2))
    search = Search((-0.4, -0.4), (0.8, 0.8), 0.05, 1.0)
    return Measurement(frequencies, p, SPEED, positions=positions, known=range(3), search=search)


CASES = [("noise", "joint"), ("twins", "robust"), ("high", "robust"), ("noise", "descent"), ("twins", "descent")]


@pytest.mark.parametrize(("kind", "solver"), CASES)
def test_whatever_is_in_the_file_the_calibration_ends_at_its_limit(kind, solver):
    readings = itertools.count(1.0)  # each reading of the clock is one second later
    settings = SolverSettings(name=solver, modes=2 if solver == "descent" else MODES, first_modes=2)
    inputs = replace(inputs_of(absurd(kind), time_limit=20.0), settings=settings)
    result = solve(inputs, clock=lambda: next(readings))
    assert next(readings) == 23  # 22 is the first reading after the limit, and the clock is not read again
    assert result.verdict == "not_converged" and not result.converged and "20 s" in result.verdict_text
    assert np.isfinite(result.positions).all() and result.positions.shape == (COUNT, 2)


def test_a_deadline_holds_in_its_own_thread_and_context_only():
    with deadline(1.0, lambda: 2.0):
        with ThreadPoolExecutor(1) as other:
            other.submit(check_deadline).result()
        with pytest.raises(OutOfTime):
            check_deadline()
    check_deadline()


def test_the_candidates_of_a_relocation_are_bounded_whatever_the_wavenumber(monkeypatch):
    """Without a bound an array of 300 wavelengths would take tens of millions of candidates."""
    problem, solver = in_unit_power(absurd("high").problem()), solvers.load("robust")
    positions = np.random.default_rng(0).uniform(-4, 4, (COUNT, 2))
    state = solver.init(problem, SolverSettings(name="robust", modes=MODES), 0, positions)
    noisy = np.where(np.arange(COUNT) == 5, 100.0, 1.0)
    sizes, predicted = [], channels._predicted

    def count(x, q, candidates, *others):
        sizes.append(len(candidates))
        return predicted(x, q, candidates, *others)

    monkeypatch.setattr(channels, "_predicted", count)
    channels.relocated(problem, replace(state, model=replace(state.model, channel_noise=noisy)))
    assert sizes and 100 < max(sizes) < 1.2 * channels.CANDIDATES
