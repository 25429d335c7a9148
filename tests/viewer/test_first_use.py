"""What puzzled somebody who used the page for the first time."""

import dataclasses
import time

import numpy as np
import pytest
from doubles import State, set_by_client, view_of

from fdcal.model.scene_file import load_scene
from fdcal.model.texts import length_text
from fdcal.session.request import OpenRequest, edited
from fdcal.viewer.background.comparison import ComparisonSetup, RunSummary, status_word
from fdcal.viewer.background.cost_map import modes_label
from fdcal.viewer.tabs.comparison import remark_on_start, table
from fdcal.viewer.tabs.microphones import ErrorByDistance


@pytest.mark.parametrize("value", [350.0, 0.0])
def test_an_impossible_radius_is_refused_with_its_limits(controls, value):
    panel, session = controls
    set_by_client(panel.scene.radius, value)
    assert f"{value:g} m is not possible; use 0.05 to 3 m" in panel.scene.message.content
    assert panel.scene.radius.value == value, "no other number takes its place"
    set_by_client(panel.scene.apply, True)
    assert session.opened == []
    set_by_client(panel.scene.radius, 0.2)
    assert panel.scene.message.content == ""


def test_an_error_of_a_changed_scene_names_controls_of_the_page(controls):
    panel, session = controls
    set_by_client(panel.scene.radius, 2.5)  # larger than the room
    set_by_client(panel.scene.apply, True)
    message = panel.scene.message.content
    assert "outside the room" in message and "Array radius (m)" in message and "array." not in message
    assert session.opened == []


def test_the_legend_of_a_map_names_its_modes(measurement):
    assert modes_label(measurement, (38,)) == "mode 38" and modes_label(measurement, (1, 2, 3)) == "modes 1 to 3"
    assert modes_label(measurement, (2, 5, 9)) == "3 modes from 2 to 9"


def test_the_errors_now_are_seen_beside_their_mean_over_the_run(server, measurement):
    chart = ErrorByDistance(server.gui, measurement)
    states = [State(measurement.positions + 0.2), State(measurement.positions + 1e-5, 1)]
    chart.show(view_of(states), now=10.0)
    _, mean, here = chart.plot.data
    low, high = chart.plot.handle.scales["y"]["range"]
    assert chart.plot.handle.scales["y"]["distr"] == 3, "logarithmic"
    assert low <= here.min() < mean.max() <= high and here.max() < 1e-3 * mean.min()
    server.gui.reset()


def test_a_race_says_what_a_random_start_means_to_solvers_that_find_their_own():
    remark = remark_on_start(ComparisonSetup(("descent", "joint", "robust"), "random", 0))
    assert "joint and robust" in remark and "metres off" in remark and "descent" not in remark
    assert remark_on_start(ComparisonSetup(("descent", "joint"), "affine", 0)) == ""
    assert remark_on_start(ComparisonSetup(("descent",), "random", 0)) == ""


def test_a_race_says_that_it_prepares_and_gives_large_errors_in_metres():
    state = State(np.zeros((3, 2)))
    assert status_word(state, running=True) == "preparing the first step"
    assert status_word(dataclasses.replace(state, step=1), running=True) == "running"
    none = np.zeros(0)
    far = RunSummary("joint", state.positions, "running", 3, 0.5, 1160.0, 5980.0, none, none, np.array([-75.5]))
    html = table((far,))
    assert "error 1.16 m, largest 5.98 m" in html and "e+" not in html
    assert "dB" not in html, "the cost of an earlier state is not that of the positions"
    assert "-80.0 dB" in table((dataclasses.replace(far, cost=-80.0),))


@pytest.mark.parametrize(
    ("length", "text"), [(0.0042, "4.2 mm"), (0.535, "535 mm"), (0.99951, "1 m"), (1.234, "1.23 m")]
)
def test_lengths_from_a_metre_on_are_in_metres(length, text):
    assert length_text(length) == text


def test_no_old_status_stands_beside_the_progress_of_the_next_session(page_of):
    page, turn_until = page_of
    page.open(OpenRequest(load_scene("tiny")))
    turn_until(lambda: page.viewer is not None)
    first = page.viewer.tabs.run_bar
    assert first.status.visible
    page.open(OpenRequest(edited(load_scene("tiny"), {"seed": 3})))
    turn_until(lambda: page.switcher.progress is not None)
    assert page.status_bar.line.visible and not first.status.visible and not first.verdict.visible
    page.switcher.cancel()
    turn_until(lambda: page.switcher.progress is None)
    page.tick(0.0)
    assert first.status.visible


def test_the_map_stays_when_the_page_gets_dark_however_long_the_next_one_takes(viewer, work):
    """A race or another program may keep the processor busy."""
    work.solver.gate.release()
    for now in range(500):
        viewer.tick(float(now))
        if viewer.picture.floor is not None:
            break
        time.sleep(0.02)
    assert viewer.picture.floor is not None
    viewer.tabs.view.darken(True)
    for now in range(1000, 1005):
        viewer.tick(float(now))
        assert viewer.picture.floor is not None, "the gate lets no other map pass"
