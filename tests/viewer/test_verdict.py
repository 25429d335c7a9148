"""The verdict on the page: when it comes, its words, its tables and the channels that do not count."""

import dataclasses
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from browsing import WAIT
from doubles import State, assessment, view_of
from solving import run_from

import fdcal
from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.assessment.calibration import ChannelFault, Channels, Evidence
from fdcal.graphics.overlays import with_faulty_channels
from fdcal.graphics.picture import static_picture
from fdcal.model.settings import SolverSettings
from fdcal.session.calibration_run import assess_state, healthy_microphones, solve
from fdcal.session.process import one_blas_thread
from fdcal.session.session import History
from fdcal.session.sources import CalibrationInput, OpenRequest, scene_input
from fdcal.viewer import prepare
from fdcal.viewer.explore import Explore
from fdcal.viewer.gui.html import CONTROLS, DOUBTFUL, FAULTY, GOOD, status, verdict_html
from fdcal.viewer.session_view import VERDICT_DELAY, VerdictWorker, uncertainty_of
from fdcal.viewer.tabs.microphones import channel_table, given_table


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
    *_, state = run_from(solver, problem, state)
    assert made.of(state, True, 2e3) is None, "it runs"
    end, found, now = time.monotonic() + WAIT, None, 3e3
    while found is None and time.monotonic() < end:
        found, now = made.of(state, False, now), now + VERDICT_DELAY
        time.sleep(0.02)
    printed = solve(inputs, wording=CONTROLS)
    assert (found.verdict, found.verdict_text) == (printed.verdict, printed.verdict_text)
    assert found.evidence.leave_one_out_db == pytest.approx(printed.evidence.leave_one_out_db)
    assert made.of(dataclasses.replace(state, step=99), False, now) is None, "of another state"


def test_the_line_is_coloured_by_the_code():
    assert verdict_html(None) == ""
    good = verdict_html(assessment("good", "the positions & more"))
    assert GOOD in good and "<b>good</b>: the positions &amp; more" in good
    bad = verdict_html(assessment("model_mismatch", "no", evidence=Evidence(1.0, leave_one_out_db=-12.34)))
    assert "<b>model mismatch</b>" in bad, "words, not a code"
    assert DOUBTFUL in bad and GOOD not in bad and "leave-one-out error -12.3 dB" in bad
    dead = assessment("good", "faulty: b dead", channels=Channels(*np.zeros((5, 3)), (ChannelFault("b", "dead"),)))
    assert FAULTY in verdict_html(dead) and GOOD not in verdict_html(dead), "not all is good"


def test_odd_channels_do_not_count_in_the_mean_error_once_they_are_named():
    faults = (ChannelFault("b", "dead"), ChannelFault("c", "misplaced", 0.1, "m"))
    judged = assessment("good", "", channels=Channels(*np.zeros((5, 4)), faults))
    assert healthy_microphones(np.array([1, 2, 3]), "abcd", judged).tolist() == [2, 3]
    assert healthy_microphones(np.array([1]), "abcd", judged).tolist() == [1], "where no other is left"
    assert healthy_microphones(np.array([1, 2]), "abcd", None).tolist() == [1, 2]


def test_odd_channels_stay_out_of_the_errors_when_the_user_rewinds_and_count_again_after_a_reset(work, threads):
    worker, states = VerdictWorker(work, threads), [State(work.measurement.positions, step) for step in range(2)]
    names, lineage = work.measurement.names, object()
    judged = assessment("good", "", channels=Channels(*np.zeros((5, 10)), (ChannelFault(names[5], "dead"),)))
    view = dataclasses.replace(view_of(states), history=History(states, 2, lineage))
    assert worker.sought(view, None).tolist() == [3, 4, 5, 6, 7, 8, 9]
    assert worker.sought(view, judged).tolist() == [3, 4, 6, 7, 8, 9]
    assert worker.sought(view, None).tolist() == [3, 4, 6, 7, 8, 9], "another state of the same run"
    again = dataclasses.replace(view, history=History(states, 1, object()))
    assert worker.sought(again, None).tolist() == [3, 4, 5, 6, 7, 8, 9]


@pytest.mark.parametrize("verdict", [None, "good", "model_mismatch"])
def test_no_face_says_of_a_run_what_the_verdict_on_it_contradicts(verdict, work):
    measurement, sought = work.measurement, work.sought
    view = view_of([State(measurement.positions, finished=True, converged=False)])
    found = None if verdict is None else assessment(verdict, "")
    viewer = SimpleNamespace(view=view, found=found, run=work, snapshot=SimpleNamespace(counted=sought))
    word = "Stopped before it converged" if verdict == "model_mismatch" else "Ended"
    assert Explore._status(viewer) == f"{word}, 0 mm off on average"
    expert = status(view, measurement, found=found)
    assert f">{word}</div>" in expert and ("The step left is small" in expert) == (verdict == "good")


INVERTED = 9


@pytest.fixture(scope="module")
def shown():
    """Measurement of `tiny` with an inverted channel, its calibration, and what the page computes of its last state."""
    measurement = fdcal.load("tiny")
    p = np.array(measurement.pressures)
    p[:, INVERTED] *= -1
    measurement = replace(measurement, pressures=p)
    result = fdcal.calibrate(measurement, solver="robust", modes=12)
    problem = measurement.problem("unit", "all")
    *_, state = solvers.run(problem, SolverSettings(name="robust", modes=12), 0)
    return measurement, result, shown_of(measurement, problem, state)


def shown_of(measurement, problem, state):
    """What the page shows of the state at the end of a run."""
    inputs = CalibrationInput("tiny", fdcal.load_scene("tiny"), measurement, state.settings, state.seed)
    with one_blas_thread():
        return uncertainty_of(assess_state(inputs, problem, state, CONTROLS))


def test_ellipses_verdict_and_gains_are_those_of_the_calibration(shown):
    _, result, found = shown
    assert found.verdict == result.verdict and np.allclose(found.sigma, result.uncertainty)
    assert np.allclose(found.channels.gain_db, result.channels.gain_db)
    assert [fault.kind for fault in found.channels.faults] == ["inverted"]
    assert found.axes.shape == (16, 2, 2)
    assert uncertainty_of(None) is None


def test_the_table_has_the_odd_channels_first_and_marks_them(shown):
    measurement, _, found = shown
    html = channel_table(measurement, found)
    first, fault = html.split("<tr")[2:4]
    assert "&#9888; 9" in first and html.count("&#9888;") == 1
    assert "inverted" in fault and "white-space: normal" in fault, "a long text does not widen the table"
    assert html.count("<tr") == 18 and f"Verdict: {found.verdict}".replace("_", " ") in html
    assert channel_table(measurement, None) == ""
    evil = replace(measurement, names=("<script>", *measurement.names[1:]))
    tiny = np.full(measurement.count, -1e-4)
    small = replace(found, channels=replace(found.channels, gain_db=tiny, phase_deg=tiny, noise_db=tiny))
    html = channel_table(evil, small)
    assert "<script>" not in html and "-0.0" not in html


def test_given_positions_stand_beside_those_found_the_most_corrected_first(shown):
    measurement, result, found = shown
    assert found.channels.given == result.channels.given and len(result.channels.given) == len(measurement.known)
    wrong = replace(found.channels.given[1], given=(9.25, 9.5), wrong=True)
    channels = replace(found.channels, given=(found.channels.given[0], wrong, found.channels.given[2]))
    html = given_table(replace(found, channels=channels))
    assert f"&#9888; {wrong.name}" in html.split("<tr")[2] and "9.2500,<br>9.5000" in html and html.count("<tr") == 4
    head = html.split("</tr>")[0]
    assert head.index("difference") < head.index("given"), "in a narrow panel the difference is seen first"
    assert given_table(None) == "" and given_table(replace(found, channels=replace(channels, given=()))) == ""
    assert "<script>" not in given_table(
        replace(found, channels=replace(channels, given=(replace(wrong, name="<script>"),)))
    )


def test_odd_microphones_have_a_mark_of_their_own_at_their_place():
    measurement = fdcal.load("tiny")
    picture = static_picture(None, measurement)
    marked = with_faulty_channels(picture, measurement.positions, [INVERTED])
    (mark,) = [mesh for mesh in marked.meshes if mesh.name == "microphones/faulty"]
    assert np.allclose(
        mark.vertices[:, :2].mean(axis=0), measurement.positions[INVERTED], atol=picture.marker_radius / 4
    )
    assert with_faulty_channels(picture, measurement.positions, []) is picture
