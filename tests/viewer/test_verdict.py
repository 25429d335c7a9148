"""The texts of the panels: status, tables, remarks, and when the verdict appears and which channels it omits."""

import re
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from browsing import WAIT
from doubles import State, assessment, set_by_client, view_of
from solving import run_from

import fdcal
from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.assessment.calibration import ChannelFault, Channels, Evidence
from fdcal.assessment.words import cost_words, state_error_words
from fdcal.graphics.lesson_panels import channel_table, lesson_panel
from fdcal.session.calibration_run import solve
from fdcal.session.scene_edits import edited
from fdcal.session.sources import OpenRequest, scene_input
from fdcal.session.worker import Delivery
from fdcal.viewer import html as words
from fdcal.viewer import panels, prepare
from fdcal.viewer.explore import Explore
from fdcal.viewer.html import CONTROLS, DOUBTFUL, FAULTY, GOOD, status, verdict_html
from fdcal.viewer.session_view import VERDICT_DELAY, VerdictWorker, ellipses_of
from fdcal.viewer.tabs import microphones
from fdcal.viewer.tabs.microphones import given_table


@pytest.fixture(scope="module")
def scene():
    return edited(fdcal.load_scene("tiny"), {"solver.modes": 12})


@pytest.fixture
def worker(scene, threads):
    measurement, solver = cached_measurement(scene), solvers.load(scene.solver.name)
    problem, session = measurement.problem(), SimpleNamespace(view=None)
    made = VerdictWorker(prepare.PreparedRun(scene, measurement, problem, solver, session, OpenRequest(scene)), threads)
    return made, solver, problem


def test_the_verdict_is_what_calibrate_prints_and_appears_at_the_end(scene, worker):
    made, solver, problem = worker
    inputs = scene_input(scene)
    state = solver.init(problem, inputs.settings, scene.seed)
    assert made.of(view_of([state]), 0.0)[:2] == made.of(view_of([state]), 1e3)[:2] == (None, False)
    *_, state = run_from(solver, problem, state)
    assert made.of(view_of([state], running=True), 2e3)[:2] == (None, False), "it runs"
    end, found, now = time.monotonic() + WAIT, None, 3e3
    while found is None and time.monotonic() < end:
        (found, _, _), now = made.of(view_of([state]), now), now + VERDICT_DELAY
        time.sleep(0.02)
    printed = solve(inputs, wording=CONTROLS)
    assert (found.verdict, found.verdict_text) == (printed.verdict, printed.verdict_text)
    assert found.evidence.leave_one_out_db == pytest.approx(printed.evidence.leave_one_out_db)
    np.testing.assert_allclose(found.channels.gain_db, printed.channels.gain_db)
    assert ellipses_of(found).shape == (16, 2, 2) and ellipses_of(None) is None
    assert made.of(view_of([replace(state, step=99)]), now)[:2] == (None, True), "of another state"


def test_the_line_is_coloured_by_the_code():
    assert verdict_html(None) == ""
    good = verdict_html(assessment("good", "the positions & more"))
    assert GOOD in good and "<b>good</b>: the positions &amp; more" in good
    bad = verdict_html(assessment("model_mismatch", "no", evidence=Evidence(1.0, leave_one_out_db=-12.34)))
    assert "<b>model mismatch</b>" in bad, "words, not a code"
    assert DOUBTFUL in bad and GOOD not in bad and "leave-one-out error -12.3 dB" in bad
    dead = assessment("good", "faulty: b dead", channels=Channels(*np.zeros((5, 3)), (ChannelFault("b", "dead"),)))
    assert FAULTY in verdict_html(dead) and GOOD not in verdict_html(dead), "not all is good"


def test_faulty_channels_stay_out_of_the_errors_when_the_user_rewinds_and_count_again_after_a_reset(work, threads):
    worker, states = VerdictWorker(work, threads), [State(work.measurement.positions, step) for step in range(2)]
    names = work.measurement.names
    judged = assessment("good", "", channels=Channels(*np.zeros((5, 10)), (ChannelFault(names[5], "dead"),)))
    view = replace(view_of(states), lineage=object())
    sought = lambda view: worker.of(view, 0.0)[2].tolist()  # noqa: E731
    assert sought(view) == [3, 4, 5, 6, 7, 8, 9]
    worker._worker.latest = Delivery((states[1],), judged)
    assert sought(view) == [3, 4, 6, 7, 8, 9]
    assert sought(replace(view, state=states[0])) == [3, 4, 6, 7, 8, 9], "another state of the same run"
    assert sought(replace(view, state=states[0], lineage=object())) == [3, 4, 5, 6, 7, 8, 9]


@pytest.mark.parametrize("verdict", [None, "good", "model_mismatch"])
def test_no_layout_contradicts_the_verdict_on_a_run(verdict, work):
    measurement, sought = work.measurement, work.sought
    view = view_of([State(measurement.positions, finished=True, converged=False)])
    found = None if verdict is None else assessment(verdict, "")
    viewer = SimpleNamespace(view=view, found=found, run=work, snapshot=SimpleNamespace(counted=sought))
    word = "Stopped before it converged" if verdict == "model_mismatch" else "Ended"
    assert Explore._status(viewer) == f"{word}, 0 mm off on average"
    expert = status(view, measurement, found=found)
    assert f">{word}</div>" in expert and ("The remaining step is small" in expert) == (verdict == "good")


INVERTED = 9


@pytest.fixture(scope="module")
def shown(remembered_runs):
    """Measurement of `tiny` with an inverted channel, and its calibration."""
    measurement = fdcal.load("tiny")
    p = np.array(measurement.pressures)
    p[:, INVERTED] *= -1
    measurement = replace(measurement, pressures=p)
    return measurement, fdcal.calibrate(measurement, solver="robust", modes=12)


def test_the_table_has_the_faulty_channels_first_and_marks_them(shown):
    measurement, found = shown
    html = channel_table(measurement.names, found.channels, 100)
    first, fault = html.split("<tr")[2:4]
    assert "&#9888; 9" in first and html.count("&#9888;") == 1
    assert "inverted" in fault and "white-space: normal" in fault, "a long text does not widen the table"
    assert html.count("<tr") == 18
    evil = replace(measurement, names=("<script>", *measurement.names[1:]))
    tiny = np.full(measurement.count, -1e-4)
    small = replace(found, channels=replace(found.channels, gain_db=tiny, phase_deg=tiny, noise_db=tiny))
    html = channel_table(evil.names, small.channels, 100)
    assert "<script>" not in html and "-0.0" not in html


def test_given_positions_stand_beside_those_found_the_most_corrected_first(shown):
    measurement, found = shown
    assert len(found.channels.given) == len(measurement.known)
    wrong = replace(found.channels.given[1], given=(9.25, 9.5), wrong=True)
    channels = replace(found.channels, given=(found.channels.given[0], wrong, found.channels.given[2]))
    html = given_table(channels)
    assert f"&#9888; {wrong.name}" in html.split("<tr")[2] and "9.2500,<br>9.5000" in html and html.count("<tr") == 4
    head = html.split("</tr>")[0]
    assert head.index("difference") < head.index("given"), "in a narrow panel the difference is seen first"
    assert given_table(None) == "" and given_table(replace(channels, given=())) == ""
    assert "<script>" not in given_table(replace(channels, given=(replace(wrong, name="<script>"),)))


def test_microphones_are_listed_by_descending_error(measurement):
    positions = measurement.positions + (0.001 * np.array([0, 0, 0, 5, 9, 1, 7, 3, 2, 4]))[:, None] * [1, 0]
    html = microphones.position_table(measurement, positions, None, 6, slice(None))
    numbers = [int(number) for number in re.findall(r"<tr[^>]*><td>(\d+)(?: known)?</td>", html)]
    assert numbers == [4, 6, 3, 9, 7, 8, 5, 0, 1, 2]
    assert "error<br>(mm)" in html and html.count("known") == 3 and "&sigma;" not in html
    assert "700" in html.split("<td>6</td>")[0].rpartition("<tr")[2], "the one that is chosen"


def test_the_status_shows_units_and_the_state_of_the_solver(measurement):
    state = State(measurement.positions + np.array([0.003, 0.004]), step=7, sweep=1, moved=4)
    html = words.status(view_of([state]), measurement)
    for text in ("Paused", "step 7, sweep 1", "3 frequencies, 100 to 180 Hz", "5 mm", "Eq. 7"):
        assert text in html
    assert cost_words(-41.237).startswith("-41.2 dB") and "unknown" in cost_words(np.nan)
    assert state_error_words(measurement, np.array([8e-6])) == "less than 0.01 mm off"
    assert "Running" in words.status(view_of([state], running=True), measurement)
    assert "Error" not in words.status(view_of([state]), replace(measurement, positions=None))
    evil = "<script>alert(1)</script>"
    for html in (words.status(view_of([state], error=evil), measurement), words.remark(evil)):
        assert "<script" not in html and "&lt;script" in html


def test_ellipses_come_with_the_verdict_and_the_legend_says_how_large_they_are(page_of, scene, monkeypatch):
    monkeypatch.setattr(panels, "DOUBLING_TIME", 0.1)  # s: no user watches this run, so that it may be fast
    page, turn_until = page_of
    page.open(OpenRequest(edited(scene, {"solver.name": "joint"}), play=True))
    turn_until(lambda: page.viewer is not None and page.viewer.found is not None)
    legend, view = page.panels.overlay._regions["legend"], page.viewer.tabs.view
    sigma = re.search(r"one sigma [\d.]+ mm", page.viewer.tabs.run_bar.verdict.content)[0]
    set_by_client(view.ellipses, True)
    turn_until(lambda: re.search(rf"drawn \d+ times larger; {sigma}", legend.content))
    set_by_client(view.ellipses, False)
    turn_until(lambda: "error ellipse" not in legend.content)


def test_the_errors_over_the_distance_of_a_single_microphone_are_not_drawn(measurement):
    # One microphone is unknown, as in the opening.
    one_sought = replace(measurement, known=np.arange(9), known_positions=measurement.positions[:9])
    for measured, means in ((one_sought, 0), (measurement, 2)):
        assert lesson_panel("distance", measured, [State(measured.positions)], None).count("half ") == means
