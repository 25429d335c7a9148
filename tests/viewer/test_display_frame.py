"""A blind array on the page: its true positions stand still, and what the user places is drawn where it was placed."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from doubles import Recorder, State, view_of

from fdcal.graphics.picture import static_picture
from fdcal.model.gauge import position_errors
from fdcal.viewer.background.cost_maps import MapStyle, place_of_basin
from fdcal.viewer.display_frame import DisplayFrame
from fdcal.viewer.gui.binding import Binding, Choices
from fdcal.viewer.session_view import SessionPicture
from fdcal.viewer.tabs import map as map_tab
from fdcal.viewer.tabs.cut import CutRequest, cost_along


@pytest.fixture
def blind(work):
    """A run of a blind array, whose states are turned, moved and mirrored, each in another way."""
    rng = np.random.default_rng(5)
    truth = np.asarray(work.measurement.positions)
    states = []
    for angle, side in ((0.4, 1), (2.0, -1), (-1.1, 1)):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) * [1, side]
        states.append(State(truth @ turn + rng.normal(0, 1, 2) + rng.normal(0, 0.03, truth.shape)))
    session = Recorder(states[0])
    session.view = view_of(states)
    measurement = replace(work.measurement, known=[], known_positions=None)
    return replace(work, measurement=measurement, problem=measurement.problem("unit"), session=session)


def places(picture, name):
    """The centres of the marks of a kind, metres."""
    marks = next(mesh for mesh in picture.meshes if mesh.name == name)
    return np.asarray(marks.vertices).reshape(10, -1, 3).mean(axis=1)[:, :2]


def test_the_true_positions_stand_still_over_a_run_and_while_a_microphone_is_dragged(blind):
    frame = DisplayFrame(blind)
    drawing, view = SessionPicture(blind, frame), blind.session.view
    circles = {mesh.name: mesh for mesh in static_picture(blind.known_scene, blind.measurement).meshes}
    for state in view.history:
        shown = frame.view(replace(view, state=state))
        picture = drawing.draw(shown, Choices(0, 2), 3)
        drawn = next(mesh for mesh in picture.meshes if mesh.name == "microphones/true")
        np.testing.assert_array_equal(drawn.vertices, circles["microphones/true"].vertices)
        off = position_errors(drawing.places, blind.measurement.positions)
        np.testing.assert_allclose(off, blind.measurement.errors(state.positions), atol=1e-12)
        assert frame.view(replace(view, state=state)).state is shown.state


@pytest.mark.parametrize("coordinates", [1, 2])
def test_a_microphone_is_drawn_where_it_was_placed(coordinates, server, blind):
    binding = Binding(server.gui, blind, 6)
    for place in ([0.6, 0.7], [0.85, 0.4]):
        wanted = np.array([*place[:coordinates], *binding.positions[4, coordinates:]])
        binding.place(4, place[:coordinates])
        (_, microphone, at, _), positions = blind.session.commands[-1], np.array(blind.session.view.state.positions)
        others = np.delete(positions, microphone, axis=0)
        positions[microphone] = at
        np.testing.assert_array_equal(np.delete(positions, microphone, axis=0), others)
        np.testing.assert_allclose(binding.frame.positions(positions)[4], wanted, atol=1e-9)


def test_ellipses_turn_with_the_array(blind):
    frame, rng = DisplayFrame(blind), np.random.default_rng(1)
    state = blind.session.view.state
    axes = rng.normal(0, 1, (10, 2, 2))
    ends = np.asarray(state.positions)[3] + 1e-6 * axes[3]  # the same motion carries the ends of the half axes
    turned = frame.axes(state.positions, axes)
    moved = frame.positions(state.positions)
    for end, axis in zip(ends, turned[3], strict=True):
        other = np.array(state.positions)
        distances = position_errors(other, np.tile(end, (10, 1)))
        np.testing.assert_allclose(
            position_errors(moved, np.tile(moved[3] + 1e-6 * axis, (10, 1))), distances, atol=1e-12
        )


def test_the_microphones_whose_errors_count_determine_the_motion(blind):
    frame, state = DisplayFrame(blind), blind.session.view.state
    first, healthy = frame.state(state), np.arange(1, 10)
    frame.move_by(healthy)
    second = frame.state(state)
    assert second is not first and frame.state(state) is second
    off = position_errors(second.positions, blind.measurement.positions)
    np.testing.assert_allclose(off, blind.measurement.errors(state.positions, healthy), atol=1e-12)


def test_small_maps_cut_and_basins_have_the_true_position_where_the_main_map_has_it(blind, monkeypatch):
    """Microphone 0 is dead: it is far off, and the others determine the motion."""
    frame, truth, n = DisplayFrame(blind), blind.measurement.positions, 3
    state, healthy = blind.session.view.state, np.arange(1, 10)
    frame.move_by(healthy)
    shown = frame.state(replace(state, positions=state.positions + np.eye(10, 1) * np.array([0.4, -0.3])))
    assert np.abs(blind.measurement.aligned_truth(shown.positions)[n] - truth[n]).max() > 0.01
    np.testing.assert_array_equal(frame.truth(shown.positions), truth)

    request = SimpleNamespace(microphone=n, modes=(1,), take=None, state=shown, style=MapStyle())
    np.testing.assert_array_equal(place_of_basin(blind, request)[0], truth[n])

    marks = []
    monkeypatch.setattr(map_tab, "mosaic", lambda *arguments, **_: marks.append(arguments[3]))
    panels = SimpleNamespace(modes=(1,), maps=[None], total=None, search=None)
    map_tab.panel_image(blind, SimpleNamespace(request=request, panels=panels, fine=True))
    assert marks[0].true == tuple(truth[n])

    ends = truth[n] - [0.1, 0.0], truth[n] + [0.1, 0.0]
    assert cost_along(blind, CutRequest(0, n, (1,), 0, ends, shown)).truth == pytest.approx(0.1)


def test_nothing_is_moved_where_microphones_are_known_or_the_truth_is_not(work, blind):
    for run in (work, replace(blind, measurement=replace(blind.measurement, positions=None))):
        frame, view = DisplayFrame(run), run.session.view
        assert frame.state(view.state) is view.state and frame.view(view) == view
        np.testing.assert_array_equal(frame.placed(view.state.positions, 2, [0.3, 0.4]), [0.3, 0.4])
