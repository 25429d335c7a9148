"""The verdict under the status: the words of `fdcal calibrate`, as soon as the solver has finished."""

import dataclasses
import time
from types import SimpleNamespace

import numpy as np
import pytest
from browsing import WAIT
from doubles import State, view_of

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.assessment.calibration import ChannelFault, Channels, Evidence
from fdcal.session.calibration_run import Assessment, healthy_microphones, solve
from fdcal.session.history import History
from fdcal.session.request import OpenRequest
from fdcal.session.sources import scene_input
from fdcal.viewer.background import prepare
from fdcal.viewer.background.verdict import IDLE_TIME, VerdictWorker
from fdcal.viewer.gui.html import CONTROLS, DOUBTFUL, GOOD, verdict_html


@pytest.fixture
def worker(scene, threads):
    measurement, solver = cached_measurement(scene), solvers.load(scene.solver.name)
    problem = measurement.problem()
    session = SimpleNamespace(view=None)
    made = VerdictWorker(prepare.PreparedRun(scene, measurement, problem, solver, session, OpenRequest(scene)), threads)
    return made, solver, problem


def test_it_is_what_calibrate_prints_and_waits_for_the_end(scene, worker):
    made, solver, problem = worker
    inputs = scene_input(scene)
    state = solver.init(problem, inputs.settings, scene.seed)
    assert made.of(state, False, 0.0) is None and made.of(state, False, 1e3) is None
    while not state.finished:
        state = solver.step(problem, state)
    assert made.of(state, True, 2e3) is None, "it runs"
    end, found, now = time.monotonic() + WAIT, None, 3e3
    while found is None and time.monotonic() < end:
        found, now = made.of(state, False, now), now + IDLE_TIME
        time.sleep(0.02)
    printed = solve(inputs, wording=CONTROLS)
    assert (found.verdict, found.verdict_text) == (printed.verdict, printed.verdict_text)
    assert found.evidence.leave_one_out_db == pytest.approx(printed.evidence.leave_one_out_db)
    assert made.of(dataclasses.replace(state, step=99), False, now) is None, "of another state"


def found(verdict, text, **changes):
    covariance = np.array([0.0, 3e-4, 3e-4])[:, None, None] ** 2 / 2 * np.eye(2)
    numbers = dict(covariance=covariance, search_spread=np.zeros(3), evidence=Evidence(1.0))
    return Assessment(np.zeros((3, 2)), None, verdict, text, **numbers | changes)


def test_the_line_is_coloured_by_the_code():
    assert verdict_html(None) == ""
    good = verdict_html(found("good", "the positions & more"))
    assert GOOD in good and "<b>good</b>: the positions &amp; more" in good
    bad = verdict_html(found("model_mismatch", "no", evidence=Evidence(1.0, leave_one_out_db=-12.34)))
    assert "<b>model mismatch</b>" in bad, "words, not a code"
    assert DOUBTFUL in bad and GOOD not in bad and "leave-one-out error -12.3 dB" in bad


def test_odd_channels_do_not_count_in_the_mean_error_once_they_are_named():
    faults = (ChannelFault("b", "dead"), ChannelFault("c", "misplaced", 0.1, "m"))
    judged = found("good", "", channels=Channels(*np.zeros((5, 4)), faults))
    assert healthy_microphones(np.array([1, 2, 3]), "abcd", judged).tolist() == [2, 3]
    assert healthy_microphones(np.array([1]), "abcd", judged).tolist() == [1], "where no other is left"
    assert healthy_microphones(np.array([1, 2]), "abcd", None).tolist() == [1, 2]


def test_odd_channels_stay_out_of_the_errors_when_the_user_rewinds_and_count_again_after_a_reset(work, threads):
    worker, states = VerdictWorker(work, threads), [State(work.measurement.positions, step) for step in range(2)]
    names, lineage = work.measurement.names, object()
    judged = found("good", "", channels=Channels(*np.zeros((5, 10)), (ChannelFault(names[5], "dead"),)))
    view = dataclasses.replace(view_of(states), history=History(states, 2, lineage))
    assert worker.sought(view, None).tolist() == [3, 4, 5, 6, 7, 8, 9]
    assert worker.sought(view, judged).tolist() == [3, 4, 6, 7, 8, 9]
    assert worker.sought(view, None).tolist() == [3, 4, 6, 7, 8, 9], "another state of the same run"
    again = dataclasses.replace(view, history=History(states, 1, object()))
    assert worker.sought(again, None).tolist() == [3, 4, 5, 6, 7, 8, 9]


def test_long_words_leave_the_controls_where_they_are_and_a_click_shows_all_of_them(browser):
    long = found("model_mismatch", "the residual of 10 of 63 microphones is large: " + "one cause, or another; " * 20)
    page = browser.new_page(viewport={"width": 340, "height": 720})
    heights = []
    for shown in (None, found("good", "short"), long):
        page.set_content(f"<div id='box'>{verdict_html(shown, pending=True)}</div>")
        heights.append(page.locator("#box").bounding_box()["height"])
    page.locator("summary").click()
    heights.append(page.locator("#box").bounding_box()["height"])
    assert long.verdict_text in page.locator("summary").inner_text() + " "
    page.close()
    assert heights[0] == heights[1] == heights[2] < heights[3] - 100, heights


def test_the_names_of_two_odd_channels_are_seen_without_a_click(browser):
    odd = "nothing speaks against the positions of the other microphones; one sigma 0.45 mm; odd: microphone 20: "
    odd += "inverted; microphone 45: dead"
    faults = (ChannelFault("20", "inverted"), ChannelFault("45", "dead"))
    page = browser.new_page(viewport={"width": 340, "height": 720})
    hidden = []
    for channels in (None, Channels(*np.zeros((5, 50)), faults)):
        line = verdict_html(found("good", odd, channels=channels))
        page.set_content(f"<body style='margin: 0; font: 14px DejaVu Sans, sans-serif'>{line}</body>")  # as viser's
        words = page.locator("summary div").first
        hidden.append(words.evaluate("words => words.scrollHeight > words.clientHeight + 2"))
    page.close()
    assert hidden == [True, False]
