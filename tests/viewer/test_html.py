"""Status, tables and remarks."""

import dataclasses
import logging
import re
from types import SimpleNamespace

import numpy as np
from doubles import State, assessment, view_of

from fdcal.assessment.calibration import GivenPosition
from fdcal.assessment.uncertainty import confidence_factor
from fdcal.assessment.words import cost_words
from fdcal.graphics.picture import frame, static_picture
from fdcal.graphics.primitives import format_number
from fdcal.viewer.gui import html as words
from fdcal.viewer.gui.binding import Tick
from fdcal.viewer.server import process
from fdcal.viewer.session_view import uncertainty_of
from fdcal.viewer.tabs import microphones, spectrum


def test_the_table_is_that_of_the_state_also_where_the_memory_of_an_older_one_is_used_again(controls, measurement):
    panel, _ = controls
    panel.microphones.error_by_distance.plot = None  # it keeps the states; an array without known microphones has none
    for turn in range(50):
        here = measurement.positions + 0.001 * turn
        panel.microphones.show(Tick(view_of([State(here)]), float(turn)))
        assert ", ".join(f"{x:.3f}" for x in here[9]) in panel.microphones.table.content, turn


def test_microphones_are_listed_by_descending_error(measurement):
    offsets = 0.001 * np.array([0, 0, 0, 5, 9, 1, 7, 3, 2, 4])
    html = microphones.table(measurement, measurement.positions + offsets[:, None] * [1, 0], None, 6)
    numbers = [int(number) for number in re.findall(r"<tr[^>]*><td>(\d+)(?: known)?</td>", html)]
    assert numbers == [4, 6, 3, 9, 7, 8, 5, 0, 1, 2]
    assert "error<br>(mm)" in html and html.count("known") == 3
    assert "700" in html.split("<td>6</td>")[0].rpartition("<tr")[2], "the one that is chosen"


def test_no_minus_stands_before_a_zero_and_no_digit_that_means_nothing_beside_an_error_of_zero(measurement):
    places = np.array(measurement.positions)
    places[:, 1] = -1e-5
    exact = dataclasses.replace(measurement, positions=places)
    sigma = np.full(len(places), 4.11e-6)
    html = microphones.table(exact, places, sigma, 6)
    row = html.split("<td>6</td>")[1].partition("</tr>")[0]
    assert "-0.000" not in html and ", 0.000</td>" in row
    assert row.endswith("<td>0</td><td>&lt; 0.01</td>")
    assert "<td>0.0411</td>" in microphones.table(exact, places, 10 * sigma, 6)
    theme, name = static_picture(None, exact).theme, "frame/range"
    (height,) = [part.text for part in frame((0, 0, 1, 1), (-1e-5, 0.5), 0.01, theme) if part.name == name]
    assert height == "z 0.00 to 0.50 m" and format_number(-0.0, 3) == "0"
    given = GivenPosition("7", (-1e-6, 0.2), (0.1, -1e-6), 0.001, False)
    found = SimpleNamespace(channels=SimpleNamespace(given=(given,)))
    assert "-0.0000" not in microphones.given_table(found)


def test_modes_beyond_f_max_give_a_warning(measurement):
    assert "beyond" not in spectrum.caption(measurement, (1, 2), 500, 3)
    html = spectrum.caption(measurement, (1, 6), 299, 3)
    assert "beyond" in html and "300.0 Hz" in html and "299 Hz" in html and "7 functions for 10" in html


def test_uncertainty_is_drawn_where_the_verdict_has_one():
    axes = np.diag([4e-6, 1e-6])
    for covariance in (np.tile(axes, (3, 1, 1)), np.full((3, 2, 2), np.inf)):
        drawn = uncertainty_of(assessment("good", "", covariance=covariance))
        if np.isfinite(covariance).all():
            half = confidence_factor(0.95, 2) * np.array([1e-3, 2e-3])
            assert np.allclose(np.linalg.norm(drawn.axes, axis=2), half)
        else:
            assert drawn is None


def test_the_status_shows_units_and_the_state_of_the_solver(measurement):
    state = State(measurement.positions + np.array([0.003, 0.004]), step=7, sweep=1, moved=4)
    html = words.status(view_of([state]), measurement)
    for text in ("Paused", "step 7, sweep 1", "modes 1 to 3, 100.0 to 180.0 Hz", "5 mm", "Eq. 7"):
        assert text in html
    assert cost_words(-41.237).startswith("-41.2 dB") and "unknown" in cost_words(float("nan"))
    assert "Running" in words.status(view_of([state], running=True), measurement)
    assert "unknown" in words.status(view_of([state]), dataclasses.replace(measurement, positions=None))
    evil = "<script>alert(1)</script>"
    for html in (
        words.status(view_of([state], error=evil), measurement),
        words.waiting(evil, evil),
        words.remark(evil),
    ):
        assert "<script" not in html and "&lt;script" in html


def test_the_status_names_the_path_of_the_log(measurement, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("FDCAL_CACHE", str(tmp_path / "<b>"))
    with process.error_log():
        try:
            raise ValueError("the matrix is singular")
        except ValueError:
            logging.getLogger("fdcal.viewer.anything").exception("the solver stopped")
        html = words.status(view_of([State(measurement.positions)], error="it broke"), measurement)
        assert "&lt;b&gt;/view.log" in html and "<b>/" not in html and "it broke" in html
    assert "ValueError: the matrix is singular" in (tmp_path / "<b>" / "view.log").read_text(encoding="utf-8")
    line = capsys.readouterr().err
    assert "the solver stopped" in line and "view.log" in line and "Traceback" not in line
    assert process.log_location() == "the terminal's log" and not logging.getLogger("fdcal").handlers
