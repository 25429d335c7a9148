"""The sweep of modes and the cut: maps and counts are those of the page, and the plot of a cut is Eq. 7 along it."""

import time
from types import SimpleNamespace

import numpy as np
import pytest
from doubles import finish, set_by_client
from hypothesis import given
from hypothesis import strategies as st

from fdcal.cost.basins import local_minima
from fdcal.cost.eq7 import ReferenceCost
from fdcal.cost.maps import cost_maps, refined
from fdcal.viewer.drop import LineHandles
from fdcal.viewer.tabs import sweep as sweeping
from fdcal.viewer.tabs.cut import MAX_MODES, POINTS, SPAN, cut_series, foot, line_across
from fdcal.viewer.tabs.sweep import DOWN, Playback


def played(playback, stops, ready, times):
    """What a playback shows, and when; `ready` maps a time to the number of maps computed."""
    found = [(now, playback.advance(stops, ready(now), now)) for now in times]
    return [(now, stop) for now, stop in found if stop is not None]


@pytest.mark.parametrize(("summed", "then"), [(0, 1), (3, 4), (5, 1)])
def test_play_goes_on_after_the_present_sum_and_from_the_beginning_after_the_last(summed, then):
    playback = Playback(rate=1.0)
    playback.continue_from(summed, range(1, 6))
    assert playback.advance(range(1, 6), 5, 0.0) == then


def test_nothing_is_computed_before_someone_asks_and_the_slider_shows_how_many_modes_the_map_has(opened):
    """The first map is the one that a browser waits for; a sweep takes the processor for seconds."""
    viewer, turn_until = opened
    turn_until(lambda: map_on_page(viewer) is not None)
    viewer.run.session.step()
    turn_until(lambda: viewer.snapshot.view.index == 1)
    sweep, state = viewer.tabs.sweep, viewer.binding.session.view.state
    assert sweep.worker.worker.latest is None and not sweep.worker.worker.busy and not sweep._plot.visible
    assert viewer.binding.choices.modes is None and state.first == 1 and state.last < viewer.binding.modes
    turn_until(lambda: sweep.summed.value == state.last)  # where nobody has chosen any, they are the solver's
    set_by_client(sweep.play, True)
    turn_until(lambda: viewer.binding.choices.modes == (1,))  # and Play begins with the first one
    assert sweep.play.label == "Pause"
    set_by_client(sweep.play, True)
    turn_until(lambda: sweep.play.label == "Play")


def test_another_state_stops_the_sweep_and_makes_its_counts_invalid(opened, monkeypatch):
    viewer, turn_until = opened
    sweep, slow = viewer.tabs.sweep, sweeping.cost_map
    set_by_client(sweep.summed, 3)
    turn_until(lambda: "sum of 3 modes" in sweep.text.content and sweep._plot.visible)
    monkeypatch.setattr(sweeping, "cost_map", lambda *args: (time.sleep(0.2), slow(*args))[1])
    set_by_client(sweep.order, DOWN)
    set_by_client(sweep.highest, 19)
    turn_until(lambda: 2 <= computed(sweep) < 19)
    made = sweep.worker.sweep(sweep._wanted)
    viewer.run.session.step()
    turn_until(lambda: sweep._wanted is None and not sweep.worker.worker.busy)
    assert len(made.frames) < 19
    turn_until(lambda: "Play adds" in sweep.text.content and not sweep._plot.visible)


def map_on_page(viewer):
    """The map that the page shows now."""
    return viewer.snapshot.picture.floor


def computed(sweep):
    """How many maps of the sweep that the page wants there are."""
    made = sweep.worker.sweep(sweep._wanted)
    return 0 if made is None else len(made.frames)


def test_play_adds_modes_up_to_all_and_counts_the_minima_of_the_maps_shown(opened, monkeypatch):
    viewer, turn_until = opened
    sweep, binding, seen = viewer.tabs.sweep, viewer.binding, []
    set_by_client(sweep.highest, 6)
    set_by_client(sweep.rate, 20)
    set_by_client(sweep.summed, 1)
    choose = binding.choose
    monkeypatch.setattr(binding, "choose", lambda **changes: (seen.append(changes.get("modes")), choose(**changes)))
    set_by_client(sweep.play, True)
    turn_until(lambda: not sweep.playing)
    shown = list(dict.fromkeys(modes for modes in seen if modes))
    assert shown == [tuple(range(1, m + 1)) for m in range(2, 7)]
    made = sweep.worker.sweep(sweep._wanted)
    run, search = viewer.run, refined(viewer.run.problem.search)
    for m, count in zip(made.stops, made.counts, strict=True):
        modes, state = range(1, m + 1), binding.session.view.state
        n, offset = binding.choices.microphone, binding.choices.order_offset
        maps = cost_maps(run.problem, run.solver, state, n, modes, offset, search)
        assert count == len(local_minima(maps.sum(axis=0))), m
    turn_until(lambda: "sum of 6 modes, 1 to 6" in sweep.text.content)
    assert len(sweep._plot.data[0]) == 6


def test_a_map_of_the_sweep_is_the_fine_map_of_the_page(opened):
    viewer, turn_until = opened
    sweep, tab = viewer.tabs.sweep, viewer.tabs.map
    set_by_client(sweep.order, DOWN)
    set_by_client(sweep.highest, 9)
    set_by_client(sweep.summed, 4)
    assert viewer.binding.choices.modes == (6, 7, 8, 9)
    turn_until(lambda: computed(sweep) == 9)
    turn_until(lambda: map_on_page(viewer) is not None and "sum of 4 modes" in tab.caption.content)
    swept, caption = map_on_page(viewer), tab.caption.content
    sweep.worker._sweep = None  # so the page computes the map itself
    turn_until(lambda: map_on_page(viewer) is not None and map_on_page(viewer) is not swept
               and map_on_page(viewer).rgb.shape == swept.rgb.shape)  # fmt: skip
    np.testing.assert_array_equal(map_on_page(viewer).rgb, swept.rgb)
    assert map_on_page(viewer).minima == swept.minima and tab.caption.content == caption


LOW, HIGH = np.array([1.0, 2.0]), np.array([1.4, 2.6])


@given(st.tuples(st.floats(0, 1), st.floats(0, 1)), st.floats(0, 6.28))
def test_a_line_across_goes_through_its_point_from_edge_to_edge(share, angle):
    place, along = LOW + (HIGH - LOW) * share, np.array([np.cos(angle), np.sin(angle)])
    ends = np.array(line_across(place, along, LOW, HIGH))
    assert (ends >= LOW).all() and (ends <= HIGH).all()
    off = (ends - place) @ [-along[1], along[0]]
    assert np.abs(off).max() < 1e-9
    on_edge = np.isclose(ends, LOW, atol=1e-9) | np.isclose(ends, HIGH, atol=1e-9)
    assert on_edge.any(axis=1).all()


def test_the_foot_of_a_position_is_where_it_projects_and_none_far_from_the_line():
    ends = np.array([[0.0, 0.0], [2.0, 0.0]])
    assert foot([0.5, 0.02], ends) == pytest.approx(0.5)
    assert foot([0.5, 0.3], ends) is None and foot([-0.1, 0.0], ends) is None and foot([2.1, 0.0], ends) is None
    assert foot([0.5, 0.0], np.zeros((2, 2))) is None


@pytest.fixture
def handles():
    """Handles on a line, the choices they change, and a function that passes them a drag."""
    callbacks, removed = {}, []
    choices = SimpleNamespace(cut=None)
    binding = SimpleNamespace(choices=choices, choose=lambda cut: setattr(choices, "cut", cut))

    def add(name, vertices, faces, turned, places, **_):
        return SimpleNamespace(
            on_drag=lambda _: lambda call: callbacks.update(drag=call), remove=lambda: removed.append(name),
            batched_positions=places,
        )  # fmt: skip

    server = SimpleNamespace(scene=SimpleNamespace(add_batched_meshes_simple=add))
    picture = SimpleNamespace(marker_radius=0.01, z_range=(0.0, 0.0), focus=(*LOW, *HIGH))
    made = LineHandles(server, binding, picture)

    def drag(index, point, eye=(1.2, 2.2, 5.0)):
        client = SimpleNamespace(camera=SimpleNamespace(position=np.array(eye)))
        finish(callbacks["drag"](SimpleNamespace(instance_index=index, end_position=point, client=client)))

    return SimpleNamespace(made=made, choices=choices, drag=drag, removed=removed)


LINE = ((1.1, 2.1), (1.3, 2.5))


def shown(handles, line):
    handles.choices.cut = line
    handles.made.show(line, None)


def test_a_drag_moves_one_end_and_leaves_the_other(handles):
    shown(handles, LINE)
    handles.drag(0, (1.2, 2.4, 0.0), eye=(1.2, 2.4, 5.0))
    (ax, ay), b = handles.choices.cut
    assert (ax, ay) == pytest.approx((1.2, 2.4)) and b == (1.3, 2.5)
    handles.made.show(handles.choices.cut, None)
    np.testing.assert_allclose(handles.made._handles.batched_positions[:2, :2], handles.choices.cut)
    handles.drag(1, (9.0, -9.0, 0.0))
    assert handles.choices.cut[1] == pytest.approx((1.4, 2.0)), "it stays inside the search domain"


def test_no_end_that_is_not_there_and_no_pointer_beside_the_map_moves_anything(handles):
    shown(handles, LINE)
    for index, point in [
        *((index, (1.2, 2.4, 0.0)) for index in (None, -1, 2, 10**9, 1.0, "0")),
        *((0, point) for point in ((1.2, 2.4, 9.0), (np.nan, 0, 0), (1.2, 2.4), (np.inf, 0, 0))),
    ]:
        handles.drag(index, point)
        assert handles.choices.cut == LINE, (index, point)
    shown(handles, None)
    handles.drag(0, (1.2, 2.4, 0.0))
    assert handles.choices.cut is None and len(handles.removed) == 1, "without a line there are no handles"
    shown(handles, LINE)
    shown(handles, None)
    assert len(set(handles.removed)) == 2, "a new name each time"


def test_the_plot_of_a_cut_through_the_estimate_has_the_cost_of_the_status_line(opened):
    viewer, turn_until = opened
    cut, binding = viewer.tabs.cut, viewer.binding
    reference_cost = ReferenceCost(viewer.run.problem)
    viewer.tabs.map.choose_modes(range(1, reference_cost.count + 1))
    set_by_client(cut.lines, "x")
    turn_until(lambda: cut._shown is not None and cut._shown.request.modes == binding.choices.modes)
    columns, made = cut._plot.data, cut._shown
    assert len(columns) == len(cut_series(viewer.run.measurement)) and all(len(column) == POINTS for column in columns)
    assert all(np.isfinite(column).all() for column in columns)
    here = np.asarray(binding.session.view.state.positions)[binding.choices.microphone]
    assert made.estimate == pytest.approx(here[0] - binding.choices.cut[0][0])
    at = np.interp(made.estimate, made.distance, made.total)
    assert at == pytest.approx(reference_cost(binding.session.view.state.positions), abs=0.3), "between two points"
    assert len(made.modes) == MAX_MODES and np.ptp(np.clip(columns[MAX_MODES + 1], -SPAN, None)) > 3
    assert "cut" in {part.name for part in viewer.picture.meshes}
    set_by_client(cut.lines, "None")
    turn_until(lambda: "cut" not in {part.name for part in viewer.picture.meshes})
    assert binding.choices.cut is None


def test_the_line_to_the_lowest_cost_goes_through_estimate_and_minimum(opened):
    viewer, turn_until = opened
    turn_until(lambda: viewer.picture.floor is not None)
    floor, binding = viewer.picture.floor, viewer.binding
    set_by_client(viewer.tabs.cut.lines, "Lowest")
    ends = np.array(binding.choices.cut)
    here = np.asarray(binding.session.view.state.positions)[binding.choices.microphone]
    direction = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    across = np.array([-direction[1], direction[0]])
    assert abs((here - ends[0]) @ across) < 1e-6 and abs((floor.lowest[0] - ends[0]) @ across) < 1e-6


def test_a_playback_shows_every_map_at_its_rate_and_waits_for_maps():
    stops, times = tuple(range(1, 9)), np.arange(0, 10, 0.05)
    shown = played(Playback(rate=4.0), stops, lambda now: 8, times)
    assert [stop for _, stop in shown] == list(stops)
    assert np.diff([now for now, _ in shown]) == pytest.approx(0.25, abs=0.051)
    playback = Playback(rate=10.0)
    shown = played(playback, stops, lambda now: int(now), times)
    assert [stop for _, stop in shown] == list(stops), "it leaves none out"
    assert all(now >= stop for now, stop in shown)
    assert playback.ended(stops, 10.0) and not Playback(4.0).ended((1,), 3.0)
