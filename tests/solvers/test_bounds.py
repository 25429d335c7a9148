"""Bounds of every calibration: whatever the file says, it ends in time and memory, and no microphone diverges."""

import itertools
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from fdcal import solvers
from fdcal.model.measurement import Measurement
from fdcal.model.settings import Search, SolverSettings
from fdcal.model.validation import InputError
from fdcal.session.calibration_run import solve
from fdcal.session.sources import CalibrationInput
from fdcal.solvers import interface as bounds
from fdcal.solvers import room
from fdcal.solvers.interface import OutOfTime, check_deadline, deadline
from fdcal.solvers.robust import channels
from fdcal.solvers.robust.objective import in_unit_power

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
    assert bounds.radius(end.positions) <= bounds.max_radius(problem, 16) < 20.0


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
    assert bounds.radius(result.positions) <= bounds.max_radius(measurement.problem(), 20)


# Deadlines: whatever the file says, a calibration ends at its limit plus a step, with the best positions so far.

COUNT, MODES = 12, 16
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


def absurd_inputs(measurement: Measurement, solver: str, limit: float) -> CalibrationInput:
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
    result = solve(absurd_inputs(absurd(kind), solver, 15.0), clock=clock)
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
    inputs = absurd_inputs(absurd("noise"), "joint", limit)
    first = counted.init(inputs.measurement.problem(), inputs.settings, 0).positions
    result = solve(inputs, clock=lambda: counted.now)
    assert limit < counted.now <= limit + 1.0 and counted.steps == counted.now
    np.testing.assert_allclose(result.positions, first + 1e-3 * counted.steps, atol=1e-12)


def test_a_step_of_many_trials_is_given_up_at_the_limit(monkeypatch):
    counted = Counted(solvers.load("joint"), trials=10**9)
    monkeypatch.setattr(solvers, "load", lambda name: counted)
    inputs = absurd_inputs(absurd("noise"), "joint", 40.0)
    first = counted.init(inputs.measurement.problem(), inputs.settings, 0).positions
    result = solve(inputs, clock=lambda: counted.now)
    assert counted.now == 41.0 and result.verdict == "not_converged"
    np.testing.assert_allclose(result.positions, first, atol=1e-12)


def test_the_lattice_searches_of_solver_room_look_at_the_deadline():
    problem = absurd("noise").problem()
    x, noise = np.random.default_rng(0).uniform(0.5, 2.0, (COUNT, 2)), np.full(MODES, 0.01)
    p, k, walls = problem.pressures, problem.wavenumbers, np.array([0.3, 0.3, 0.0, 0.0])
    for one_search in (
        lambda: room.find_arrays(p, noise, k, SIZE),
        lambda: room.find_sources(x, p, k, SIZE),
        lambda: room.relocate(x, walls, p, k, SIZE),
    ):
        clock = Readings()
        with deadline(2.0, clock), pytest.raises(OutOfTime):
            one_search()
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
