"""A comparison of solvers: one start for all, clocks that count only running time, and one rule for all costs."""

import dataclasses
import itertools
import re
import time

import numpy as np
import pytest

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.cost.expansion import ReferenceCost
from fdcal.model.scene_file import load_scene
from fdcal.session.comparison import Comparison, same_start
from fdcal.viewer.background import prepare
from fdcal.viewer.tabs import comparison as races

WAIT = 60.0  # s, bound of every wait
ALL = ("joint", "descent", "descent+joint")


@pytest.fixture(scope="module")
def scene():
    tiny = load_scene("tiny")
    return dataclasses.replace(tiny, solver=dataclasses.replace(tiny.solver, modes=12, max_sweeps=2))


@pytest.fixture(scope="module")
def measurement(scene):
    return cached_measurement(scene)


@pytest.fixture(scope="module")
def problem(measurement):
    return measurement.problem("unit")


def test_all_start_at_the_same_place(scene, problem):
    states = same_start(problem, dataclasses.replace(scene.solver, start="random"), ALL, 3)
    assert list(states) == list(ALL)
    for name in ALL[1:]:
        np.testing.assert_array_equal(states[name].positions, states["joint"].positions)
    near = same_start(problem, dataclasses.replace(scene.solver, start="affine"), ALL, 3)
    apart = np.abs(near["joint"].positions - near["descent"].positions)
    low, size = np.array(scene.search.origin), np.array(scene.search.size)
    inside = np.all((near["joint"].positions >= low) & (near["joint"].positions <= low + size), axis=1)
    assert inside.sum() > 5 and apart[inside].max() <= 0.5 * scene.search.step + 1e-9


def test_a_race_runs_pauses_and_goes_back_to_the_start(scene, problem):
    comparison = Comparison(problem, scene.solver, ("descent", "joint"), "random", 0)
    try:
        starts = [run.session.view.state.positions for run in comparison.runs]
        comparison.play()
        for run in comparison.runs:
            assert run.session.wait_for(lambda view: view.state.finished and not view.running, WAIT)
            state = run.session.view.state
            history = run.session.view.history
            seconds = [run.seconds(state) for state in history]
            assert seconds[0] == 0 and seconds == sorted(seconds) and run.seconds(state) > 0
        assert comparison.over and not comparison.running
        comparison.reset()
        for run, start in zip(comparison.runs, starts, strict=True):
            assert run.session.wait_for(lambda view: view.index == 0, WAIT)
            assert run.session.view.state.positions is start and run.seconds(run.session.view.state) == 0
    finally:
        assert comparison.close(WAIT)


@pytest.fixture
def owner(scene, measurement, problem):
    made = races.ComparisonWorker(
        prepare.PreparedRun(scene, measurement, problem, solvers.load("joint"), None, None, ReferenceCost(problem)),
        owned := prepare.Threads(),
    )
    clock = itertools.count()

    def turn_until(happened):
        for _ in range(round(WAIT / 0.01)):
            runners = made.update(float(next(clock)))
            if happened(runners):
                return runners
            time.sleep(0.01)
        pytest.fail("it does not happen")

    yield made, turn_until
    assert made.close(WAIT)
    owned.close(WAIT)


def test_the_end_of_a_race_shows_time_steps_error_and_cost_of_each_solver(owner):
    made, turn_until = owner
    assert made.button_label == "Start"
    made.toggle(races.ComparisonSetup(ALL, "random", 0))
    turn_until(lambda runners: len(runners) == 3 and made.finished)
    runners = turn_until(lambda runners: all(r.cost and r.times[-1] == r.seconds > 0 for r in runners))
    html = races.table(runners)
    for runner in runners:
        assert runner.name in html and f"{runner.step} steps" in html and f"{runner.mean_error:.3g} mm" in html
        assert runner.mean_errors[-1] == pytest.approx(runner.mean_error)
    assert len(re.findall(r"\d s; error [^;]*m; -\d+\.\d dB", html)) == 3 and len(re.findall(r", \d+ steps", html)) == 3
    assert len(set(re.findall(r"stroke-dasharray='([^']*)'", html))) == 3, "lines that differ without their colours"
    first = {tuple(map(tuple, np.round([r.mean_errors[0], r.costs[0]], 6)[:, None])) for r in runners}
    assert len(first) == 1, "one start"
    made.reset()
    runners = turn_until(lambda runners: all(r.step == 0 for r in runners))
    assert not made.finished and made.button_label == "Resume"
    made.stop()
    assert turn_until(lambda runners: not runners) == () and made.button_label == "Start"


def test_a_race_that_cannot_begin_gives_the_reason(owner):
    made, turn_until = owner
    made.run = dataclasses.replace(
        made.run,
        scene=dataclasses.replace(made.run.scene, solver=dataclasses.replace(made.run.scene.solver, modes=500)),
    )
    made.toggle(races.ComparisonSetup(("descent", "joint"), "random", 0))
    turn_until(lambda _: made.error)
    assert "modes" in made.error and made.button_label == "Start"


def test_curves_of_all_share_one_axis_and_hold_between_points(owner):
    made, _ = owner
    runner = races.RunSummary(
        "joint", None, "", 2, 0.5, 1.0, 1.0, np.array([0.0, 0.5]), np.array([4.0, 1.0]), np.array([-3.0, -9.0])
    )
    other = dataclasses.replace(runner, name="descent", times=np.array([0.0, 2.0]), costs=np.array([-3.0, -5.0]))
    axis, *curves = races.curve_columns((runner, other), made.run.measurement)[
        "Cost (Eq. 7, all modes; dB re the power)"
    ]
    np.testing.assert_array_equal(axis, [0.0, 0.5, 2.0])
    np.testing.assert_array_equal(curves[0], [-3, -9, -9])
    np.testing.assert_array_equal(curves[1], [-3, -3, -5])
