"""A session stops within one step, rewinds at once, survives an exception and obeys only the newest command."""

import math
import threading
import time
from dataclasses import FrozenInstanceError, dataclass, replace

import numpy as np
import pytest

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.model.scene import load_scene
from fdcal.model.validation import InputError, StorageError
from fdcal.session import session as module
from fdcal.session.session import Session, SolverRun, StateCosts
from fdcal.session.worker import Lane, LatestWorker, Scheduler

WAIT = 20.0  # s, the bound of every wait; no wait reaches it unless the law is violated


@dataclass(frozen=True)
class Count:
    """A state that counts: three steps make a sweep, and twelve steps the run."""

    step: int = 0
    first: int = 1
    last: int = 3
    automatic: bool = True
    seed: int = 0

    positions: tuple = ((0.0, 0.0), (1.0, 1.0))
    moved: int = -1

    @property
    def sweep(self):
        return self.step // 3

    @property
    def stage(self):
        return self.step // 6

    @property
    def finished(self):
        return self.step >= 12


class Counter:
    """A solver whose steps wait at a gate, so that a test decides when each one ends."""

    def __init__(self, gated=False):
        self.gate = threading.Semaphore(0) if gated else None
        self.began = threading.Semaphore(0)
        self.fail_at = None

    def init(self, problem, settings, seed):
        if seed < 0:
            raise ValueError("seed below zero")
        return Count(seed=seed)

    def step(self, problem, state):
        self.began.release()
        if self.gate is not None:
            assert self.gate.acquire(timeout=WAIT)
        if state.step == self.fail_at:
            raise RuntimeError("the matrix is singular")
        return replace(state, step=state.step + 1)

    def use_modes(self, problem, state, first, last, automatic):
        return replace(state, first=first, last=last, automatic=automatic)


@pytest.fixture
def make():
    sessions = []

    def build(solver, seed=0, **options):
        sessions.append(Session(None, None, seed, module=solver, **options))
        return sessions[-1]

    yield build
    for session in sessions:
        assert session.close(WAIT), "the solver thread is still alive"


def test_pause_stops_within_the_step_under_way(make):
    solver = Counter(gated=True)
    session = make(solver)
    session.play()
    assert solver.began.acquire(timeout=WAIT)
    session.pause()  # the first step is still running
    solver.gate.release()
    assert session.wait_for(lambda view: view.count == 2 and not view.running, WAIT)
    session.step()  # this command starts the next step
    solver.gate.release()
    assert session.wait_for(lambda view: view.count == 3, WAIT)
    assert solver.began.acquire(timeout=WAIT) and not solver.began.acquire(blocking=False)


def test_play_ends_where_the_solver_finishes_and_each_view_is_consistent(make):
    session, seen = make(Counter()), []
    session.play()
    assert session.wait_for(lambda view: seen.append(view) or (view.state.finished and not view.running), WAIT)
    assert session.view.count == 13
    for view in seen:
        assert view.history[view.index] is view.state and len(view.history) == view.count
    with pytest.raises(FrozenInstanceError):
        seen[0].index = 3
    session.play()
    session.step()
    session.seek(12)
    assert session.wait_for(lambda view: view.index == 12 and not view.running and view.count == 13, WAIT)


def test_a_run_stops_after_the_requested_number_of_sweeps_or_stages(make):
    for commands in (((1, "step", 1), (1, "sweep", 3), (1, "stage", 6)), ((2, "sweep", 6), (9, "stage", 12))):
        session = make(Counter())
        for times, unit, end in commands:
            session.step(times, unit)
            assert session.wait_for(lambda view, end=end: view.state.step == end and not view.running, WAIT)


def test_seek_is_bounded_and_pauses_and_going_on_from_an_older_state_drops_the_later_ones(make):
    session = make(Counter())
    session.step(unit="sweep")
    assert session.wait_for(lambda view: view.count == 4 and not view.running, WAIT)
    before = session.view.history
    assert [state.step for state in before[1:3]] == [1, 2] and before[-1].step == 3
    with pytest.raises(IndexError):
        before[4]
    for index, shown in ((-7, 0), (10**6, 3)):
        session.seek(index)
        assert session.wait_for(lambda view, shown=shown: view.index == shown and view.count == 4, WAIT)
        assert not session.view.running
    session.seek(1)
    assert session.wait_for(lambda view: view.index == 1, WAIT)
    assert session.view.count == 4 and session.view.history is before
    session.step()
    assert session.wait_for(lambda view: view.index == 2, WAIT)
    assert [state.step for state in session.view.history] == [0, 1, 2]
    assert [state.step for state in before] == [0, 1, 2, 3], "a published history has changed"


def test_modes_change_the_state_looked_at_and_reset_restarts_from_the_last_seed_given(make):
    session = make(Counter(), seed=4)
    session.step()
    session.use_modes(2, 5, False)
    assert session.wait_for(lambda view: view.state.last == 5, WAIT)
    view = session.view
    assert (view.state.first, view.state.automatic, view.count, view.state.step) == (2, False, 2, 1)
    session.reset(9)
    assert session.wait_for(lambda view: view.state.seed == 9, WAIT)
    session.step()
    session.reset()
    assert session.wait_for(lambda view: view.count == 1 and view.state.step == 0 and view.state.seed == 9, WAIT)


def test_an_exception_pauses_the_session_and_is_shown(make, caplog):
    solver = Counter()
    solver.fail_at = 2
    session = make(solver)
    session.play()
    assert session.wait_for(lambda view: view.error == "RuntimeError: the matrix is singular", WAIT)
    assert not session.view.running and session.view.state.step == 2
    assert "the matrix is singular" in caplog.text
    session.reset(-1)  # this time `init` fails
    assert session.wait_for(lambda view: "seed below zero" in view.error, WAIT)
    assert session.view.count == 3, "a failed reset must leave the states alone"
    solver.fail_at = None
    session.step()
    assert session.wait_for(lambda view: view.state.step == 3 and view.error == "", WAIT)


@pytest.mark.parametrize("name", ["joint", "robust", "descent"])
def test_whatever_is_pressed_the_solver_goes_on_or_says_why_not(name, kernels, caplog):
    """Commands may come in any order; an impossible one changes nothing and stops nothing."""
    scene, rng, refused = load_scene("tiny"), np.random.default_rng(5), 0
    problem = cached_measurement(scene).problem()
    settings = solvers.with_mode_count(problem, replace(scene.solver, name=name, start=None))
    run = SolverRun(problem, settings, 0, None, (), None, lambda: None, StateCosts())
    rows, count = problem.pressures.shape
    for _ in range(40):
        first, last = sorted(rng.integers(1, rows + 1, 2).tolist())
        command = [
            (SolverRun.use_modes, first, last, bool(rng.integers(2))), (SolverRun.pause,),
            (SolverRun.use_modes, 1, int(rng.integers(1, 8)), False), (SolverRun.play,),
            (SolverRun.step, 1, "step"), (SolverRun.step, 1, "sweep"),
            (SolverRun.seek, int(rng.integers(9))), (SolverRun.reset, int(rng.integers(3))),
            (SolverRun.place, int(rng.integers(count)), tuple(rng.uniform(-1, 2, 2).tolist()), None),
        ][int(rng.integers(9))]  # fmt: skip
        before = run.view
        run.execute(*command)
        if run.view.refused:
            refused += 1
            assert run.view.state is before.state and run.view.running == before.running, command
        if run.view.running:
            run.execute(SolverRun.advance)
        state = run.view.state
        assert not run.view.error and not caplog.records, (command, run.view.error)
        assert np.all(np.isfinite(state.positions)) and 1 <= state.first <= state.last <= rows
    assert refused or name == "descent"


def test_close_ends_the_thread_while_playing_and_an_error_in_the_first_init_reaches_the_caller():
    with pytest.raises(ValueError, match="seed below zero"):
        Session(None, None, -1, module=Counter())
    solver = Counter(gated=True)
    session = Session(None, None, 0, module=solver)
    session.play()
    assert solver.began.acquire(timeout=WAIT)
    assert not session.close(timeout=0.0)  # the running step delays the end
    solver.gate.release()
    assert session.close(WAIT) and not session.view.running


def test_worker_runs_the_newest_request_only():
    began, gate, done = threading.Semaphore(0), threading.Semaphore(0), []

    def work(number):
        began.release()
        assert gate.acquire(timeout=WAIT)
        done.append(number)
        return number * 10

    worker = LatestWorker(work)
    assert worker.latest is None and not worker.busy
    worker.request(0)
    assert began.acquire(timeout=WAIT)
    for number in range(1, 50):  # the first request is still running
        worker.request(number)
    assert worker.busy
    gate.release(2)
    assert worker.wait_for(lambda latest: latest is not None and latest.request == (49,), WAIT)
    assert done == [0, 49] and worker.latest.result == 490 and worker.close(WAIT)


def test_the_threads_of_a_page_end_after_the_work_in_progress():
    threads, began, done = Scheduler(), threading.Event(), []
    threads.worker(lambda _: (began.set(), time.sleep(0.2), done.append("work"))).request(0)
    assert began.wait(WAIT)
    threads.close(WAIT)
    assert done == ["work"]


def test_workers_of_a_lane_take_turns_and_a_long_computation_gives_way_between_its_parts():
    lane, done, gate, told = Lane("fdcal-lane"), [], threading.Semaphore(0), []

    def parts(name):
        for number in range(3):
            assert gate.acquire(timeout=WAIT)
            yield done.append(f"{name}{number}")

    long = LatestWorker(parts, lane=lane, notify=lambda: told.append(long.latest.request))
    quick = LatestWorker(done.append, lane=lane)
    long.request("a")
    quick.request("quick")  # the first part has not ended
    gate.release()
    assert quick.wait_for(lambda latest: latest is not None, WAIT) and done == ["a0", "quick"] and long.busy
    gate.release(2)
    assert long.wait_for(lambda latest: latest is not None, WAIT)
    assert lane.close(WAIT) and done == ["a0", "quick", "a1", "a2"] and told == [("a",)]


@pytest.mark.parametrize("error", [InputError("too many"), StorageError("disk full"), PermissionError("no")])
def test_a_worker_reports_an_exception_and_continues_and_logs_only_what_its_caller_does_not_report(error, caplog):
    worker = LatestWorker(lambda cause: cause if isinstance(cause, int) else (_ for _ in ()).throw(cause))
    worker.request(error)
    assert worker.wait_for(lambda latest: latest is not None, WAIT)
    assert worker.latest.error is error and not caplog.records
    worker.request(RuntimeError("a fault"))
    assert worker.wait_for(lambda latest: "a fault" in str(latest.error), WAIT)
    assert "a fault" in caplog.text and "Traceback" in caplog.text and worker.latest.result is None
    worker.request(4)
    assert worker.wait_for(lambda latest: latest.result == 4, WAIT)
    assert worker.latest.error is None and worker.close(WAIT)


# -- user moves, stages, other solvers, long runs -----------------------------------------------


def test_a_slow_pace_holds_up_no_command(make):
    session = make(Counter())
    session.pace(1e-3)  # one step in 1000 s
    session.play()
    assert session.wait_for(lambda view: view.running, WAIT)
    session.pause()
    assert session.wait_for(lambda view: not view.running, WAIT)
    session.pace(0)
    session.play()
    assert session.wait_for(lambda view: view.state.finished, WAIT)


def test_a_session_that_yields_takes_no_step_but_obeys_commands(make, monkeypatch):
    monkeypatch.setattr(module, "YIELD_TIME", 1.5)
    session = make(Counter())
    assert math.isnan(session.view.cost), "without a reference cost"
    session.yield_to_ui()
    session.play()
    session.use_modes(2, 3, False)
    assert session.wait_for(lambda view: view.state.first == 2, WAIT)
    assert session.view.running and session.view.state.step == 0
    assert session.wait_for(lambda view: view.state.finished, WAIT)


def test_a_user_interface_that_always_asks_does_not_stop_the_solver(make):
    session = make(Counter())
    session.play()
    for _ in range(round(WAIT / 0.01)):
        session.yield_to_ui()
        if session.view.state.step > 3:
            return
        time.sleep(0.01)
    pytest.fail("no step is taken")


def test_a_microphone_placed_by_the_user_is_a_state_of_its_own(make):
    session = make(Counter())
    session.step()
    assert session.wait_for(lambda view: view.count == 2, WAIT)
    for x in (0.1, 0.2, 0.3):  # the three moves are one drag
        session.place(1, (x, 0.5), gesture="a")
    assert session.wait_for(lambda view: view.state.positions[1][0] == 0.3, WAIT)
    assert session.view.count == 3 and session.view.state.step == 1
    session.place(0, (0.7, 0.7), gesture="b")
    assert session.wait_for(lambda view: view.state.positions[0][0] == 0.7, WAIT)
    view = session.view
    assert view.count == 4 and not view.state.positions.flags.writeable
    assert view.state.positions.tolist() == [[0.7, 0.7], [0.3, 0.5]]
    assert tuple(view.history[1].positions[1]) == (1.0, 1.0), "an earlier state has changed"


def test_a_long_run_keeps_a_bounded_history(make, monkeypatch):
    monkeypatch.setattr(module, "MAX_STATES", 8)
    session = make(Counter())
    before = session.view.lineage
    session.play()
    assert session.wait_for(lambda view: view.state.finished and not view.running, WAIT)
    view = session.view
    steps = [state.step for state in view.history]
    assert len(steps) <= 9 and view.index == len(steps) - 1 and view.lineage is before
    assert steps[0] == 0 and steps[-1] == 12 and steps == sorted(set(steps))
    assert 6 in steps, "the first state of a stage stays"


class Slow:
    """A reference cost that takes far longer than a step, and notes how often it is used."""

    def __init__(self, seconds=0.0):
        self.seconds, self.used = seconds, 0

    def __call__(self, positions):
        self.used += 1
        end = time.thread_time() + self.seconds
        while time.thread_time() < end:
            pass
        return -10.0 - self.used


def test_the_state_that_is_shown_has_its_cost_and_the_others_get_theirs_at_rest(make):
    session = make(Counter(), reference_cost=Slow())
    assert session.view.cost == -11.0
    session.play()
    assert session.wait_for(lambda view: view.state.finished and not view.running, WAIT)
    assert session.view.cost < -11.0
    end = time.monotonic() + WAIT
    while session.view.costs.missing(session.view.history):
        assert time.monotonic() < end
        time.sleep(0.01)
    costs = [session.view.costs.of(state) for state in session.view.history]
    assert len(set(costs)) == len(costs) == 13 and session.view.costs.count == 13, "each was computed once"
    session.seek(4)
    assert session.wait_for(lambda view: view.index == 4, WAIT) and session.view.cost == costs[4]


def test_a_drag_does_not_wait_for_costs_and_its_last_place_gets_one(make, monkeypatch):
    monkeypatch.setattr(module, "YIELD_TIME", 0.1)
    reference_cost = Slow(0.02)
    session, end = make(Counter(), reference_cost=reference_cost), time.monotonic() + 0.5
    moves = 0
    while time.monotonic() < end:
        moves += 1
        session.place(1, (0.001 * moves, 0.5), gesture="drag")
        assert session.wait_for(lambda view, x=0.001 * moves: view.state.positions[1][0] == x, WAIT)
        assert not math.isnan(session.view.cost), "the cost of a place just before"
    assert moves > 2 * reference_cost.used and 0.01 < session.view.costs.duration < WAIT
    while session.view.costs.missing(session.view.history):
        assert time.monotonic() < end + WAIT
        time.sleep(0.01)
    assert session.view.cost == session.view.costs.of(session.view.state)
