"""What the page shows of a run that finds the gains of the channels equals what the command line prints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fdcal
from fdcal import solvers
from fdcal.graphics.overlays import with_odd_channels
from fdcal.graphics.picture import static_picture
from fdcal.model.settings import SolverSettings
from fdcal.session.blas_threads import one_blas_thread
from fdcal.session.calibration_run import assess_state
from fdcal.session.sources import CalibrationInput
from fdcal.viewer.background.verdict import uncertainty_of
from fdcal.viewer.gui.html import CONTROLS
from fdcal.viewer.tabs.microphones import channel_table, given_table

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


def test_the_table_has_the_odd_channels_first_and_marks_them(shown):
    measurement, _, found = shown
    html = channel_table(measurement, found)
    first, fault = html.split("<tr")[2:4]
    assert "&#9888; 9" in first and html.count("&#9888;") == 1
    assert "inverted" in fault and "white-space: normal" in fault, "a long text does not widen the table"
    assert html.count("<tr") == 18 and f"Verdict: {found.verdict}".replace("_", " ") in html
    assert channel_table(measurement, None) == ""
    evil = replace(measurement, names=("<script>", *measurement.names[1:]))
    assert "<script>" not in channel_table(evil, found)


def test_a_small_negative_number_is_not_written_as_minus_zero(shown):
    measurement, _, found = shown
    tiny = np.full(measurement.count, -1e-4)
    channels = replace(found.channels, gain_db=tiny, phase_deg=tiny, noise_db=tiny)
    assert "-0.0" not in channel_table(measurement, replace(found, channels=channels))


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
    marked = with_odd_channels(picture, measurement.positions, [INVERTED])
    (mark,) = [mesh for mesh in marked.meshes if mesh.name == "microphones/odd"]
    assert np.allclose(
        mark.vertices[:, :2].mean(axis=0), measurement.positions[INVERTED], atol=picture.marker_radius / 4
    )
    assert with_odd_channels(picture, measurement.positions, []) is picture


def test_the_uncertainty_on_the_page_is_that_of_the_calibration():
    measurement = fdcal.load("tiny")
    result = fdcal.calibrate(measurement, solver="joint", modes=12)
    problem = measurement.problem("unit", "all")
    *_, state = solvers.run(problem, SolverSettings(name="joint", modes=12), 0)
    found = shown_of(measurement, problem, state)
    assert np.allclose(found.sigma, result.uncertainty, rtol=1e-6, atol=0)
