"""The tab Plan: controls become a request, a dragged microphone another bound, and the scene shows both."""

import dataclasses
import time

import numpy as np
import pytest
from browsing import WAIT
from doubles import set_by_client

from fdcal.acoustics.measure import cached_measurement
from fdcal.graphics.annotations import legend_of
from fdcal.graphics.overlays import with_bound
from fdcal.graphics.picture import static_picture
from fdcal.model.scene import load_scene, placeholder_scene
from fdcal.session.plan import make_plan, plan_lines
from fdcal.session.plan_request import PlanRequest, read_layout
from fdcal.viewer.gui.binding import Binding, PlanChoices, Tick
from fdcal.viewer.tabs.plan import PlanTab, planned_array


@pytest.fixture
def tab(viewer):
    return viewer.tabs.plan


def turned(viewer, happened):
    """Tick the page until something has happened."""
    for _ in range(round(WAIT / 0.01)):
        viewer.tick(time.perf_counter())
        if happened():
            return
        time.sleep(0.01)
    pytest.fail("it does not happen")


def part(viewer, name):
    return {one.name: one for one in (*viewer.picture.lines, *viewer.picture.meshes)}.get(name)


def test_the_plan_is_drawn_before_anything_is_measured(viewer, tab):
    assert part(viewer, "ellipses") is None
    set_by_client(tab.shown, True)
    turned(viewer, lambda: part(viewer, "ellipses") is not None)
    assert part(viewer, "microphones/estimate") is None, "no solver has run"
    assert "least error" in tab.summary.content and "the array interpolates up to" in tab.summary.content
    assert " mm" in tab.summary.content and "mirrored" not in tab.summary.content
    set_by_client(tab.known, 0)
    turned(viewer, lambda: "can be mirrored" in tab.summary.content)
    assert any("least error" in entry.text for entry in legend_of(viewer.picture))
    set_by_client(tab.shown, False)
    turned(viewer, lambda: part(viewer, "microphones/estimate") is not None)
    assert part(viewer, "ellipses") is None


def test_a_dragged_microphone_moves_in_the_plan_alone(viewer, tab):
    set_by_client(tab.shown, True)
    turned(viewer, lambda: part(viewer, "ellipses") is not None)
    before, place = tab.summary.content, viewer.run.measurement.positions[4] + [0.05, -0.04]
    viewer.binding.place(4, place, 0)
    turned(viewer, lambda: tab.summary.content != before)
    assert "place" not in {name for name, *_ in viewer.run.session.commands}, "the solver's estimate stays"
    np.testing.assert_allclose(viewer.binding.choices.plan.placed(viewer.run.measurement.positions)[4], place)
    assert not tab.reset.disabled
    set_by_client(tab.reset, True)
    turned(viewer, lambda: tab.summary.content == before)


def test_controls_change_the_bound_in_the_right_direction(viewer, tab):
    def sigma(**changes):
        plan = dataclasses.replace(viewer.binding.choices.plan, **changes)
        return np.linalg.norm(planned_array(viewer.run, plan).axes, axis=(1, 2)).max()

    set_by_client(tab.snr, 40)
    set_by_client(tab.known, 5)
    set_by_client(tab.gain, 1.0)
    plan = viewer.binding.choices.plan
    assert (plan.snr_db, len(plan.known), plan.gain_sigma_db) == (40.0, 5, 1.0)
    assert set(viewer.run.measurement.known) < set(plan.known)
    assert sigma(snr_db=20.0) > sigma()
    assert sigma(gain_sigma_db=0.0) < sigma()
    assert sigma(frequencies=6) > sigma(frequencies=20) > sigma()


def test_fewer_frequencies_are_the_lowest_ones(viewer, tab):
    set_by_client(tab.shown, True)
    turned(viewer, lambda: tab.frequencies.visible)
    most = tab.frequencies.max
    set_by_client(tab.frequencies, 8)
    turned(viewer, lambda: "frequencies: 8 independent" in tab.summary.content)
    set_by_client(tab.frequencies, most)
    turned(viewer, lambda: f"frequencies: {most} independent" in tab.summary.content)
    assert viewer.binding.choices.plan.frequencies is None, "all that the array can use, also after a drag"


def test_the_page_and_the_command_line_say_the_same(viewer):
    scene = load_scene("tiny")
    measurement = cached_measurement(scene)
    run = dataclasses.replace(viewer.run, measurement=measurement)
    known = tuple(measurement.known.tolist())
    found = planned_array(run, PlanChoices(snr_db=30.0, known=known))
    plan = make_plan(PlanRequest(read_layout("tiny"), room=tuple(scene.room.size), known=known))
    assert plan_lines(found.plan)[1:] == plan_lines(plan)[1:]


def test_what_cannot_be_planned_is_one_line(viewer, server, work):
    everyone = PlanChoices(moved=tuple((n, 0.6, 0.5) for n in range(10)))
    found = planned_array(viewer.run, everyone)
    assert found.error and "\n" not in found.error
    measured = placeholder_scene(work.measurement, "hall", work.scene.solver)
    tab = PlanTab(Binding(server.gui, dataclasses.replace(work, scene=measured), 6))
    tab.show(Tick(work.session.view))
    assert tab.planned is None
    assert not hasattr(tab, "shown"), "a measurement has nothing to plan"


def test_an_ellipsoid_is_drawn_by_its_three_principal_sections():
    scene = load_scene("ball3d")
    measurement = cached_measurement(scene)
    axes = np.tile(np.diag([0.01, 0.02, 0.03]), (measurement.count, 1, 1))
    picture = with_bound(static_picture(scene, measurement), measurement.positions, axes)
    ellipses = next(one for one in picture.lines if one.name == "ellipses")
    corners = ellipses.segments.reshape(-1, 3)
    assert (np.ptp(corners, axis=0) > np.ptp(measurement.positions, axis=0)).all(), "they reach out along all axes"
    sides = np.ptp(ellipses.segments, axis=1) > 1e-6
    flat = {tuple(sides[i : i + 36 * measurement.count].any(axis=0)) for i in range(0, len(sides), len(sides) // 3)}
    assert flat == {(False, True, True), (True, False, True), (True, True, False)}
