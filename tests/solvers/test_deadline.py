"""Whatever the file says, a calibration ends at its limit plus a step, with the best positions so far."""

from __future__ import annotations

import itertools
import threading
from dataclasses import replace

import numpy as np
import pytest

from fdcal import solvers
from fdcal.model.measurement import Measurement
from fdcal.model.settings import Search, SolverSettings
from fdcal.session.calibrate import solve
from fdcal.session.sources import CalibrationInput
from fdcal.solvers import residual_noise
from fdcal.solvers.deadline import OutOfTime, check_deadline, deadline
from fdcal.solvers.room import array_search, source_search

COUNT, MODES, SPEED = 12, 16, 343.0
SIZE = (3.0, 2.5)  # of the room of solver "room"


def absurd(kind: str) -> Measurement:
    """Random pressures, at ordinary or very high frequencies; of "twins", every channel is there twice, nearly."""
    rng = np.random.default_rng(5)
    p = rng.normal(size=(MODES, COUNT)) + 1j * rng.normal(size=(MODES, COUNT))
    if kind == "twins":
        p[:, COUNT // 2 :] = p[:, : COUNT // 2] + 1e-3 * p[:, COUNT // 2 :]
    frequencies = np.linspace(100, 12_000 if kind == "high" else 900, MODES)
    positions = rng.uniform(-0.3, 0.3, (COUNT, 2))
    search = Search((-0.4, -0.4), (0.8, 0.8), 0.05, 1.0)
    return Measurement(frequencies, p, SPEED, positions=positions, known=range(3), search=search)


def inputs_of(measurement: Measurement, solver: str, limit: float) -> CalibrationInput:
    modes = 2 if solver == "descent" else MODES
    settings = SolverSettings(name=solver, modes=modes, first_modes=2, room=SIZE if solver == "room" else None)
    if solver == "room":
        measurement = replace(measurement, positions=None, known=(), known_positions=None)
    return CalibrationInput("test", None, measurement, settings, 0, time_limit=limit)


class Readings:
    """A clock that goes on by a second each time it is read."""

    def __init__(self):
        self.count = 0

    def __call__(self) -> float:
        self.count += 1
        return float(self.count)


CASES = [
    *itertools.product(["noise", "twins", "high"], ["joint", "robust"]),
    ("noise", "descent"),
    ("twins", "descent"),
    ("noise", "room"),
]


@pytest.mark.parametrize(("kind", "solver"), CASES)
def test_whatever_is_in_the_file_the_calibration_ends_at_its_limit(kind, solver):
    clock = Readings()
    result = solve(inputs_of(absurd(kind), solver, 15.0), clock=clock)
    assert clock.count == 17  # the start, and the first reading past the limit: nothing goes on after that
    assert result.verdict == "not_converged" and not result.converged and "15 s" in result.verdict_text
    assert np.isfinite(result.positions).all() and result.positions.shape == (COUNT, 2)


class Counted:
    """A solver whose steps take a second each; with `trials`, its steps look at the deadline between their trials."""

    def __init__(self, solver, trials: int = 0):
        self.solver, self.TRAITS, self.init, self.now, self.steps = solver, solver.TRAITS, solver.init, 0.0, 0
        self.trials = trials

    def step(self, problem, state):
        self.steps += 1
        for _ in range(self.trials):
            self.now += 1.0
            check_deadline()
        self.now += 1.0
        return replace(state, positions=state.positions + 1e-3, step=state.step + 1)


@pytest.mark.parametrize("limit", [1.0, 4.5, 20.0])
def test_the_limit_is_kept_to_a_step_and_its_last_state_is_the_answer(monkeypatch, limit):
    counted = Counted(solvers.load("joint"))
    monkeypatch.setattr(solvers, "load", lambda name: counted)
    inputs = inputs_of(absurd("noise"), "joint", limit)
    first = counted.init(inputs.measurement.problem(), inputs.settings, 0).positions
    result = solve(inputs, clock=lambda: counted.now)
    assert limit < counted.now <= limit + 1.0 and counted.steps == counted.now
    np.testing.assert_allclose(result.positions, first + 1e-3 * counted.steps, atol=1e-12)


def test_a_step_of_many_trials_is_given_up_at_the_limit(monkeypatch):
    counted = Counted(solvers.load("joint"), trials=10**9)
    monkeypatch.setattr(solvers, "load", lambda name: counted)
    inputs = inputs_of(absurd("noise"), "joint", 40.0)
    first = counted.init(inputs.measurement.problem(), inputs.settings, 0).positions
    result = solve(inputs, clock=lambda: counted.now)
    assert counted.now == 41.0 and result.verdict == "not_converged"
    np.testing.assert_allclose(result.positions, first, atol=1e-12)


def test_the_lattice_searches_of_solver_room_look_at_the_deadline():
    problem = absurd("noise").problem()
    x, noise = np.random.default_rng(0).uniform(0.5, 2.0, (COUNT, 2)), np.full(MODES, 0.01)
    p, k, walls = problem.pressures, problem.wavenumbers, np.array([0.3, 0.3, 0.0, 0.0])
    for search in (
        lambda: array_search.likeliest(p, noise, k, SIZE),
        lambda: source_search.sources(x, p, k, SIZE, 3),
        lambda: source_search.relocated(x, walls, p, k, SIZE),
    ):
        clock = Readings()
        with deadline(2.0, clock), pytest.raises(OutOfTime):
            search()
        assert clock.count == 3


def test_a_deadline_holds_in_its_own_thread_and_context_only():
    found = []

    def other():
        try:
            check_deadline()
            found.append("free")
        except OutOfTime:
            found.append("ended")

    with deadline(1.0, lambda: 2.0):
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
        with pytest.raises(OutOfTime):
            check_deadline()
    check_deadline()
    assert found == ["free"]


def test_the_candidates_of_a_relocation_are_bounded_whatever_the_wavenumber(monkeypatch):
    """Without a bound an array of 300 wavelengths would take tens of millions of candidates."""
    measurement = absurd("high")
    positions = np.random.default_rng(0).uniform(-4, 4, (COUNT, 2))
    sizes = []

    def count(x, worst, candidates, p, field):
        sizes.append(len(candidates))
        return np.zeros((len(p), len(worst), len(candidates)))

    monkeypatch.setattr(residual_noise, "likelihood_landscapes", count)
    problem, modes = measurement.problem(), slice(0, MODES)
    residual = residual_noise.noise_at(problem, positions, modes)
    residual_noise.relocated(problem, positions, modes, replace(residual, noise=1e-3, spread=0.0))
    assert sizes and max(sizes) < 1.1 * residual_noise.LIMITS.candidates
