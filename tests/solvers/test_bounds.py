"""Bounds of every calibration: whatever the file says, it ends, in bounded memory, and moves no microphone away."""

from __future__ import annotations

import itertools
import time
from dataclasses import replace

import numpy as np
import pytest

from fdcal import solvers
from fdcal.model.measurement import Measurement
from fdcal.model.settings import SolverSettings
from fdcal.model.validation import InputError
from fdcal.session.calibrate import solve
from fdcal.session.sources import CalibrationInput
from fdcal.solvers import bounds

SPEED = 343.0
DEFAULT = SolverSettings().name


def diffuse(count: int = 12, modes: int = 16, extent: float = 0.6, known: int = 4, **others) -> Measurement:
    """Pressures of plane waves from everywhere at an array in the plane, with noise 30 dB below."""
    rng = np.random.default_rng(1)
    positions = rng.uniform(-extent / 2, extent / 2, (count, 2))
    frequencies = np.linspace(100.0, 700.0, modes)
    k = 2 * np.pi * frequencies / SPEED
    angles = rng.uniform(0, 2 * np.pi, 40)
    waves = np.exp(-1j * k[:, None, None] * (positions @ np.stack([np.cos(angles), np.sin(angles)])))
    pressures = np.einsum("mnq,mq->mn", waves, rng.normal(size=(modes, 40)) + 1j * rng.normal(size=(modes, 40)))
    pressures = pressures / np.sqrt(80) + 0.02 * rng.normal(size=(2, modes, count)).T.swapaxes(0, 1) @ [1, 1j]
    return Measurement(frequencies, pressures, SPEED, positions=positions, known=range(known), **others)


def inputs_of(measurement: Measurement, **others) -> CalibrationInput:
    settings = SolverSettings(modes=len(measurement.frequencies))
    return CalibrationInput("test", None, measurement, settings, 0, **others)


def test_noise_in_decibels_is_refused():
    with pytest.raises(InputError, match=r"noise_power is .* decibels"):
        diffuse(noise_power=np.full(16, 35.0))


def test_noise_above_the_signal_at_one_frequency_is_refused_with_its_frequency():
    noise = np.full(16, 1e-3)
    noise[3] = 300.0
    with pytest.raises(InputError, match=r"at 220 Hz.*leave that frequency out"):
        diffuse(noise_power=noise)


def test_noise_of_the_power_of_all_that_was_measured_is_accepted():
    """A measurement of noise alone has it, and gets the verdict "too_noisy"."""
    rng = np.random.default_rng(2)
    for seed in range(20):
        p = np.random.default_rng(seed).normal(size=(2, 30, 8))
        Measurement(np.arange(1.0, 31.0), p[0] + 1j * p[1], SPEED, noise_power=np.full(30, 2.0) * rng.uniform(0.8, 1.1))


def test_noise_of_any_unit_is_compared():
    p = diffuse().pressures
    for unit in (1e-150, 1e150):
        Measurement(np.arange(1.0, 17.0), unit * p, SPEED, noise_power=np.full(16, 0.01 * unit**2 if unit < 1 else 0.0))


@pytest.mark.parametrize("k", [1e12, 1e-12])
def test_wavenumbers_of_no_wave_are_refused(k):
    with pytest.raises(InputError, match=r"wavenumbers\[0\].*correct them"):
        diffuse(wavenumbers=k * np.linspace(0.5, 1, 16))


@pytest.mark.parametrize("solver", ["joint", "robust"])
def test_known_positions_in_millimetres_are_refused_before_they_fill_the_memory(solver):
    measurement = diffuse()
    known = 1000 * 10 * measurement.positions[:4]
    wrong = inputs_of(replace_known(measurement, known))
    with pytest.raises(InputError, match=r"known microphones lie up to .* metres"):
        solve(replace(wrong, settings=replace(wrong.settings, name=solver)))


def replace_known(measurement: Measurement, known) -> Measurement:
    keys = ("frequencies", "pressures", "sound_speed")
    table = {key: getattr(measurement, key) for key in keys}
    return Measurement(**table, known=measurement.known, known_positions=known)


@pytest.mark.parametrize("solver", ["joint", "robust"])
def test_more_microphones_than_memory_are_refused_at_once(solver):
    rng = np.random.default_rng(0)
    p = rng.normal(size=(2, 60, 3000))
    measurement = Measurement(np.arange(100.0, 160.0), p[0] + 1j * p[1], SPEED)
    with pytest.raises(InputError, match=r"3000 microphones at 60 frequencies.*use at most 11 modes"):
        next(solvers.run(measurement.problem(), SolverSettings(name=solver, modes=60), 0))


class Runaway:
    """A solver that moves one microphone away, a metre more with every step."""

    def __init__(self, solver):
        self.solver, self.TRAITS = solver, solver.TRAITS
        self.init = solver.init

    def step(self, problem, state):
        positions = state.positions.copy()
        positions[-1] += 2.0 ** (state.step + 1)
        return replace(state, positions=positions, step=state.step + 1)


def test_a_microphone_that_runs_away_ends_the_run(monkeypatch):
    runaway = Runaway(solvers.load(DEFAULT))
    monkeypatch.setattr(solvers, "load", lambda name: runaway)
    problem = diffuse().problem()
    *_, end = itertools.islice(solvers.run(problem, SolverSettings(modes=16), 0), 1000)
    assert end.finished and not end.converged
    assert bounds.radius(end.positions) <= bounds.farthest(problem, 16) < 20.0


def test_positions_that_are_no_numbers_end_the_run(monkeypatch):
    runaway = Runaway(solvers.load(DEFAULT))
    monkeypatch.setattr(runaway, "step", lambda problem, state: replace(state, positions=state.positions * np.nan))
    monkeypatch.setattr(solvers, "load", lambda name: runaway)
    *_, end = itertools.islice(solvers.run(diffuse().problem(), SolverSettings(modes=16), 0), 1000)
    assert end.finished and not end.converged and np.isfinite(end.positions).all()


def test_a_time_limit_gives_the_best_so_far():
    result = solve(inputs_of(diffuse(), time_limit=1e-9))
    assert result.verdict == "not_converged" and not result.converged
    assert "processor time" in result.verdict_text and "time_limit" in result.verdict_text
    assert np.isfinite(result.positions).all()


def test_an_interrupt_gives_the_best_so_far():
    def interrupt(done, note):
        if "sweep 3" in note:
            raise KeyboardInterrupt

    result = solve(inputs_of(diffuse()), interrupt)
    assert result.verdict == "not_converged" and "interrupted" in result.verdict_text


def test_a_run_that_never_ends_is_ended(monkeypatch):
    """The limit holds without being asked for, whatever the solver."""
    endless = Runaway(solvers.load(DEFAULT))
    monkeypatch.setattr(endless, "step", lambda problem, state: replace(state, step=state.step + 1))
    monkeypatch.setattr(solvers, "load", lambda name: endless)
    seconds = iter(range(0, 10**6, 7))
    result = solve(inputs_of(diffuse()), clock=lambda: next(seconds))
    assert result.verdict == "not_converged" and "45 s" in result.verdict_text


def test_the_limit_grows_with_the_array_only_beyond_64_microphones():
    assert bounds.time_limit(diffuse(count=64, modes=64).problem(), 64) == 45.0
    assert bounds.time_limit(diffuse(count=128, modes=64).problem(), 64) == 180.0


@pytest.mark.parametrize("known", [0, 4])
def test_noise_alone_ends_in_time(known):
    rng = np.random.default_rng(3)
    p = rng.normal(size=(2, 20, 16))
    places = diffuse(count=16).positions[:known]
    frequencies = np.linspace(100.0, 700.0, 20)
    measurement = Measurement(frequencies, p[0] + 1j * p[1], SPEED, known=range(known), known_positions=places)
    began = time.process_time()
    result = solve(inputs_of(measurement))
    assert time.process_time() - began < 60 and result.verdict != "good"
    assert bounds.radius(result.positions) <= bounds.farthest(measurement.problem(), 20)
