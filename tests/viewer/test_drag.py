"""Microphones that are selected, dragged and released, and the frame in which the page draws them."""

import itertools
import math
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from browsing import WAIT
from doubles import Recorder, State, finish, view_of, wait_until

from fdcal.cost.basins import OUTSIDE, DescentPath, basins_of
from fdcal.cost.maps import cost_maps, map_positions, refined
from fdcal.graphics.picture import static_picture
from fdcal.model.gauge import position_errors
from fdcal.model.scene import load_scene
from fdcal.model.settings import Search
from fdcal.model.validation import InputError, modes_text, parse_modes
from fdcal.session.sources import OpenRequest
from fdcal.session.worker import Delivery
from fdcal.viewer import drop as drop_module
from fdcal.viewer.drop import PATIENCE, ROLL_TIME, Descent, Drop, MicrophonePicker
from fdcal.viewer.html import Overlay
from fdcal.viewer.prepare import DisplayFrame
from fdcal.viewer.session_view import SessionPicture
from fdcal.viewer.state import Binding, Choices, PageState

SEARCH = Search(origin=(1.0, 2.0), size=(0.4, 0.4), step=0.1, radius=1.0)
HERE = (1.2, 2.2, 0.0)  # the middle of the search domain


@pytest.fixture
def picker():
    """A picker, the moves that it reported, and a function that sends it a drag as viser does."""
    placed, selected, direct, callbacks, shape = [], [], [], {}, {}
    binding = SimpleNamespace(
        measurement=SimpleNamespace(count=5, search=SEARCH),
        run=SimpleNamespace(problem=SimpleNamespace(known=np.array([4]))),
    )  # fmt: skip
    disc = SimpleNamespace(
        on_click=lambda call: callbacks.update(click=call),
        on_drag=lambda _, modifier="drag": lambda call: callbacks.update({modifier: call}),
    )

    def add(name, vertices, *_, **__):
        shape.update(vertices=vertices)
        return disc

    server = SimpleNamespace(scene=SimpleNamespace(add_batched_meshes_simple=add))
    picture = SimpleNamespace(marker_radius=0.01, z_range=(0.0, 1.0), focus=(0.95, 1.95, 1.45, 2.45))
    move, place = lambda *moved: placed.append(moved), lambda *moved: direct.append(moved)
    binding.tabs = SimpleNamespace(map=SimpleNamespace(pick=selected.append))
    made = MicrophonePicker(server, binding, picture, SimpleNamespace(move=move, place=place))
    return SimpleNamespace(
        made=made, binding=binding, handles=disc, shape=shape, placed=placed, selected=selected, direct=direct, **{
            name: lambda event, call=call: finish(call(event)) for name, call in callbacks.items()
        }
    )  # fmt: skip


def test_the_position_is_where_the_line_of_sight_meets_the_floor_inside_the_search_domain(picker):
    picker.drag(event("start", 2, (1.25, 2.1, 2.5), eye=(1.2, 2.0, 5.0)))
    microphone, place, gesture, released = picker.placed[0]
    assert microphone == 2 and gesture is not None and not released
    np.testing.assert_allclose(place[:2], [1.3, 2.2])
    picker.drag(event("start", 0, (50.0, -50.0, 0.0)))
    np.testing.assert_allclose(picker.placed[1][1][:2], [1.4, 2.0])
    for phase in ("start", "end"):  # with Shift, the microphone goes to the pointer
        picker.shift(event(phase, 2, (1.25, 2.1, 2.5), eye=(1.2, 2.0, 5.0)))
    assert len(picker.placed) == 2
    for index, place, *_ in picker.direct:
        assert index == 2 and place[:2] == pytest.approx([1.3, 2.2])
    assert len(picker.direct) == 2


def event(phase, index, point, eye=(1.2, 2.2, 5.0), page=3):
    camera = SimpleNamespace(position=np.array(eye))
    client = SimpleNamespace(camera=camera)
    return SimpleNamespace(phase=phase, instance_index=index, end_position=point, client_id=page, client=client)


def test_a_drag_is_one_gesture_and_the_next_or_that_of_another_page_is_another(picker):
    picker.drag(event("update", 1, HERE))
    assert not picker.placed, "there was no start"
    for phase in ("start", "update", "end", "start", "end"):
        picker.drag(event(phase, 1, HERE))
    gestures = [gesture for _, _, gesture, _ in picker.placed]
    assert [released for *_, released in picker.placed] == [False, False, True, False, True]
    assert gestures[0] == gestures[1] == gestures[2] != gestures[3] == gestures[4]
    for phase, page in (("start", 1), ("start", 2), ("update", 1)):
        picker.drag(event(phase, 1, HERE, page=page))
    first, other, again = (gesture for _, _, gesture, _ in picker.placed[5:])
    assert first == again != other


def test_a_missing_microphone_or_a_pointer_beside_the_floor_moves_nothing(picker):
    nowhere = [(np.nan, 0, 0), (np.inf, 0, 0), (1.2, 2.2, 5.0), (1.2, 2.2, 9.0)]
    strangers = (None, -1, 5, 10**9, 1.5, "1")
    for index, point in [*((index, HERE) for index in strangers), *((1, point) for point in nowhere)]:
        for phase in ("start", "update"):
            picker.drag(event(phase, index, point))
        assert picker.placed == [], (index, point)
    for index in (*strangers, 2, 4):
        picker.click(SimpleNamespace(instance_index=index))
    assert picker.selected == [2, 4], "a click selects a known one, too"


def test_a_microphone_is_released_where_the_pointer_left_the_floor_or_the_page_closed(picker):
    picker.drag(event("start", 1, HERE))
    picker.drag(event("end", 1, (1.2, 2.2, 9.0)))
    (_, before, _, _), (_, place, _, released) = picker.placed
    assert released and place == pytest.approx(before)
    picker.placed.clear()
    picker.drag(event("start", 1, HERE))
    picker.made.forget(3)
    picker.drag(event("update", 1, HERE))
    assert [released for *_, released in picker.placed] == [False, True]


def test_modes_are_read_as_written_and_those_that_are_not_there_are_refused():
    for text, modes in {"1": (1,), "1-3, 5": (1, 2, 3, 5), " 5 ,1 - 2,": (1, 2, 5), "3," * 99 + "2-3": (2, 3)}.items():
        assert parse_modes(text, 9) == modes == parse_modes(modes_text(modes), 9)
    for text in ("", ",", "0", "10", "3-2", "1-99", "x", "1;2", "-1", "1--2", "1" * 300, "<b>"):
        with pytest.raises(InputError, match="1 to 9"):
            parse_modes(text, 9)


def test_a_known_microphone_stays(picker):
    picker.drag(event("start", 4, HERE))
    picker.drag(event("update", 4, HERE))
    assert not picker.placed


MODE = 18  # the map of this mode of `tiny` has several minima


@pytest.fixture
def opened(page_of, monkeypatch):
    """The page of `tiny` with the map of one mode, and a function that ticks it until something happens."""
    return opened_with(page_of, monkeypatch, load_scene("tiny"), modes=[MODE])


def opened_with(page_of, monkeypatch, scene, **choices):
    """The page of a scene with the map of microphone 9."""
    monkeypatch.setattr(drop_module, "ROLL_TIME", 0.3)
    monkeypatch.setattr(drop_module, "PATIENCE", WAIT)  # no path can be too late
    page, turn_until = page_of
    page.open(OpenRequest(scene, choices={"microphone": 9, "follow": False, "objective": False, **choices}))
    drawn = lambda: page.viewer is not None and page.viewer.snapshot.picture  # noqa: E731
    turn_until(lambda: (picture := drawn()) and (picture.floor is not None or picture.surfaces))
    return page, turn_until


def said(page):
    return page.panels.overlay._regions["words"].content


def labels(viewer):
    return [label.text for label in viewer.snapshot.picture.labels if label.name == "selected/name"]


def minima_of(viewer):
    """Return the local minima of the map of microphone 9, metres, and which of their basins has the true position."""
    run, state, choices = viewer.run, viewer.run.session.view.state, viewer.binding.choices
    search = refined(run.problem.search)
    cost = cost_maps(run.problem, run.solver, state, 9, (MODE,), choices.order_offset, search).sum(axis=0)
    basins = basins_of(cost)
    return map_positions(basins.minima, search), basins, search


def test_a_microphone_shows_cost_and_path_and_rolls_into_a_minimum_which_is_named(opened):
    page, turn_until = opened
    viewer, session = page.viewer, page.viewer.run.session
    before, truth = session.view, viewer.run.measurement.positions[9]
    for tries, at_home in enumerate([False, True], start=1):
        minima, basins, search = minima_of(viewer)
        number = next(n for n in range(len(minima)) if (n == basins.at(search, truth)) == at_home)
        start = minima[number] + [0.004, -0.003]
        turn_until(lambda: viewer.snapshot.view.count == tries)  # noqa: B023
        viewer.drop.move(9, start + [0.02, 0.02], tries, False)
        viewer.drop.move(9, start, tries, False)
        turn_until(lambda: any("dB" in text for text in labels(viewer)))
        names = {part.name for part in (*viewer.snapshot.picture.lines, *viewer.snapshot.picture.meshes)}
        assert "ball/path" in names and "dB" in said(page)
        assert session.view.count == tries, "nothing of the session changes while it is dragged"
        viewer.drop.move(9, start, tries, True)
        turn_until(lambda: session.view.count == tries + 1 and viewer.drop._drag is None)  # noqa: B023
        end = session.view.state.positions[9]
        np.testing.assert_allclose(end, minima[number], atol=1e-9)
        off = np.linalg.norm(end - truth)
        text = f"{1e3 * off:.0f} mm" if off < 0.0995 else f"{1e2 * off:.0f} cm"
        within = f"Reached the true position within {math.ceil(1e3 * off)} mm"
        text = within if at_home else f"Trapped, {text} off"
        assert text in said(page) and f"{tries - 1} of {tries} drop" in said(page)
        assert "Continue from here" in said(page)
        turn_until(lambda: not any(part.name == "ball/path" for part in viewer.snapshot.picture.lines))
    session.seek(0)
    turn_until(lambda: viewer.snapshot.view.index == 0)
    np.testing.assert_array_equal(session.view.state.positions, before.state.positions)
    turn_until(lambda: "Continue from here" not in said(page) and "position within" not in said(page))
    page.panels.overlay.receive(None, "stamp continue")
    turn_until(lambda: session.view.running)
    session.pause()
    session.reset()
    turn_until(lambda: session.view.count == 1 and "drop" not in said(page))


def test_at_the_edge_of_the_map_there_is_no_minimum_to_be_trapped_in(opened):
    page, turn_until = opened
    viewer = page.viewer
    _, basins, search = minima_of(viewer)
    index = np.argwhere(basins.labels == OUTSIDE)[0][::-1]
    viewer.drop.move(9, search.origin + search.step * index, 1, True)
    turn_until(lambda: viewer.drop.tries == 1)
    off = 1e2 * np.linalg.norm(viewer.drop.worker.latest.result.path.points[-1] - viewer.run.measurement.positions[9])
    assert f"At the edge of the map, {off:.0f} cm off" in said(page) and viewer.drop.reached == 0 and off > 10


def test_with_shift_or_without_a_map_a_microphone_stays_where_the_pointer_puts_it(opened):
    page, turn_until = opened
    viewer, session = page.viewer, page.viewer.run.session
    viewer.drop.move(9, (0.6, 0.5), 1, True)
    viewer.drop.place(9, (0.7, 0.6), 2, True)
    turn_until(lambda: np.allclose(session.view.state.positions[9], (0.7, 0.6)))
    viewer.tick(1e6)
    assert viewer.drop._drag is None and viewer.drop.tries == 0, "it does not roll"
    viewer.binding.choose(kind="none")
    turn_until(lambda: viewer.snapshot.picture.floor is None)
    viewer.drop.move(9, (0.72, 0.61), 3, False)
    turn_until(lambda: np.allclose(session.view.state.positions[9], (0.72, 0.61)))


def test_in_space_it_falls_along_its_path_to_a_lower_cost(page_of, monkeypatch):
    page, turn_until = opened_with(page_of, monkeypatch, load_scene("ball3d"), modes=[9], kind="volume")
    viewer, session = page.viewer, page.viewer.run.session
    start = session.view.state.positions[9] + [0.1, -0.1, 0.0]
    viewer.drop.move(9, start[:2], 1, False)  # the pointer does not change the height
    turn_until(lambda: any("dB" in text for text in labels(viewer)))
    costs = []
    viewer.drop.move(9, start[:2], 1, True)
    begun, ticks = time.perf_counter(), itertools.count()  # ten ticks cover the path on a machine of any speed
    rolls = lambda: page.tick(begun + 0.03 * next(ticks))  # noqa: E731
    wait_until(lambda: session.view.count == 2 or costs.append(said(page)), rolls)
    path = viewer.drop.worker.latest.result.path
    assert len(set(costs)) > 2, "the cost follows the ball"
    np.testing.assert_allclose(path.points[0], start, atol=1e-9)
    np.testing.assert_allclose(session.view.state.positions[9], path.points[-1])
    assert np.all(np.diff(path.costs) < 0) and path.points[-1][2] != start[2]


def test_the_words_of_a_drop_and_their_button_stay_when_the_session_answers_late(server, work):
    """The session answers after PATIENCE; only a move by the solver or the user removes the words."""
    binding, overlay = Binding(server.gui, work, 6), Overlay(server.gui)
    binding.choose(microphone=9, follow=False)
    drop, before = Drop(binding, overlay), binding.session.view
    request = SimpleNamespace(style=SimpleNamespace(kind="flat"), microphone=9)
    cost_map = SimpleNamespace(request=request, text_of=lambda cost: f"{cost} dB")
    drop.tick(before, cost_map, 0.0)
    end = np.array(before.state.positions)
    end[9] = 0.6, 0.5
    drop.move(9, end[9] + 0.01, 1, True)
    descent = Descent(DescentPath(np.array([end[9] + 0.01, end[9]]), np.array([2.0, 1.0]), 0), cost_map, True, 0.0025)
    drop.worker = SimpleNamespace(latest=Delivery((drop._drag, cost_map), descent), request=lambda *_: None)
    at_rest = 1.0 + ROLL_TIME
    for now in (1.0, at_rest, at_rest + 1.01 * PATIENCE):
        assert drop._drag is not None
        drop.tick(before, cost_map, now)
    assert drop._drag is None and binding.session.commands[-1][:2] == ("place", 9)
    late = view_of([before.state, State(end)])
    for now in (at_rest + 2 * PATIENCE, at_rest + 3 * PATIENCE):
        drop.tick(late, cost_map, now)
        words = overlay._regions["words"].content
        assert "Reached the true position within 3 mm" in words and "Continue from here" in words
    drop.tick(replace(late, running=True), cost_map, at_rest + 4 * PATIENCE)
    assert "Continue from here" not in overlay._regions["words"].content
    binding.threads.close(0.0)
    server.gui.reset()


@pytest.fixture
def blind(work):
    """A run of a blind array whose states are rotated, moved and mirrored, each differently."""
    rng, truth, states = np.random.default_rng(5), np.asarray(work.measurement.positions), []
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
        picture = drawing.draw(PageState(shown, microphone=3, choices=Choices(0, 2)))
        drawn = next(mesh for mesh in picture.meshes if mesh.name == "microphones/true")
        np.testing.assert_array_equal(drawn.vertices, circles["microphones/true"].vertices)
        off = position_errors(drawing.places, blind.measurement.positions)
        np.testing.assert_allclose(off, blind.measurement.errors(state.positions), atol=1e-12)
        assert frame.view(replace(view, state=state)).state is shown.state


@pytest.mark.parametrize("coordinates", [1, 2])
def test_a_microphone_is_drawn_where_it_was_placed(coordinates, server, blind):
    binding = Binding(server.gui, blind, 6)
    for place in ([0.6, 0.7], [0.85, 0.4]):
        wanted = binding.frame.positions(binding.session.view.state.positions)[4].copy()
        wanted[:coordinates] = place[:coordinates]
        binding.place(4, place[:coordinates])
        (_, microphone, at, _), positions = blind.session.commands[-1], np.array(blind.session.view.state.positions)
        others = np.delete(positions, microphone, axis=0)
        positions[microphone] = at
        np.testing.assert_array_equal(np.delete(positions, microphone, axis=0), others)
        np.testing.assert_allclose(binding.frame.positions(positions)[4], wanted, atol=1e-9)


def test_ellipses_turn_with_the_array(blind):
    frame, state = DisplayFrame(blind), blind.session.view.state
    axes = np.random.default_rng(1).normal(0, 1, (10, 2, 2))
    ends = np.asarray(state.positions)[:, None] + 1e-6 * axes  # the rigid motion also carries the ends of the half axes
    moved, turned = frame.positions(state.positions), frame.axes(state.positions, axes)
    for n, end in ((3, 0), (7, 1)):
        before = position_errors(np.array(state.positions), np.tile(ends[n, end], (10, 1)))
        after = position_errors(moved, np.tile(moved[n] + 1e-6 * turned[n, end], (10, 1)))
        np.testing.assert_allclose(after, before, atol=1e-12)


def test_the_true_positions_stay_where_the_map_has_them(blind):
    """Microphone 0 is dead: it is far off, and the others determine the motion."""
    frame, truth = DisplayFrame(blind), blind.measurement.positions
    state, healthy = blind.session.view.state, np.arange(1, 10)
    drawn = lambda state: frame.view(replace(blind.session.view, state=state)).state  # noqa: E731
    first, frame.by = drawn(state), healthy
    off = position_errors(drawn(state).positions, truth)
    assert drawn(state) is not first
    np.testing.assert_allclose(off, blind.measurement.errors(state.positions, healthy), atol=1e-12)


def test_nothing_is_moved_if_microphones_are_known_or_true_positions_are_unknown(work, blind):
    for run in (work, replace(blind, measurement=replace(blind.measurement, positions=None))):
        frame, view = DisplayFrame(run), run.session.view
        assert frame.view(view) is view
        np.testing.assert_array_equal(frame.placed(view.state.positions, 2, [0.3, 0.4]), [0.3, 0.4])
