"""The line of a cut: its ends are dragged, it stays inside the search domain, and its plot is Eq. 7 along it."""

from types import SimpleNamespace

import numpy as np
import pytest
from doubles import finish, set_by_client
from hypothesis import given
from hypothesis import strategies as st

from fdcal.cost.expansion import ReferenceCost
from fdcal.session.sources import OpenRequest
from fdcal.viewer.scene3d.picking import LineHandles
from fdcal.viewer.tabs.cut import MAX_MODES, POINTS, SPAN, cut_series, foot, line_across

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
    callbacks, removed, binding = {}, [], SimpleNamespace(choices=SimpleNamespace(cut=None))

    def choose(cut):
        binding.choices.cut = cut

    def add(name, *_, **__):
        return SimpleNamespace(
            on_drag=lambda _: lambda call: callbacks.update(drag=call), remove=lambda: removed.append(name)
        )

    binding.choose = choose
    server = SimpleNamespace(scene=SimpleNamespace(add_batched_meshes_simple=add))
    picture = SimpleNamespace(marker_radius=0.01, z_range=(0.0, 0.0), focus=(*LOW, *HIGH))
    made = LineHandles(server, binding, picture)

    def drag(index, point, eye=(1.2, 2.2, 5.0)):
        camera = SimpleNamespace(position=np.array(eye))
        client = SimpleNamespace(camera=camera)
        finish(callbacks["drag"](SimpleNamespace(instance_index=index, end_position=point, client=client)))

    return SimpleNamespace(made=made, choices=binding.choices, drag=drag, removed=removed)


def shown(handles, line):
    handles.choices.cut = line
    handles.made.show(line, None)


def test_a_drag_moves_one_end_and_leaves_the_other(handles):
    shown(handles, ((1.1, 2.1), (1.3, 2.5)))
    handles.drag(0, (1.2, 2.4, 0.0), eye=(1.2, 2.4, 5.0))
    (ax, ay), b = handles.choices.cut
    assert (ax, ay) == pytest.approx((1.2, 2.4)) and b == (1.3, 2.5)
    handles.drag(1, (9.0, -9.0, 0.0))
    assert handles.choices.cut[1] == pytest.approx((1.4, 2.0)), "it stays inside the search domain"


@pytest.mark.parametrize("index", [None, -1, 2, 10**9, 1.0, "0"])
def test_an_end_that_is_not_there_is_not_moved(handles, index):
    line = ((1.1, 2.1), (1.3, 2.5))
    shown(handles, line)
    handles.drag(index, (1.2, 2.4, 0.0))
    assert handles.choices.cut == line


@pytest.mark.parametrize("point", [(1.2, 2.4, 9.0), (np.nan, 0, 0), (1.2, 2.4), (np.inf, 0, 0)])
def test_a_pointer_that_meets_no_map_moves_nothing(handles, point):
    line = ((1.1, 2.1), (1.3, 2.5))
    shown(handles, line)
    handles.drag(0, point)
    assert handles.choices.cut == line


def test_without_a_line_there_are_no_handles_and_a_late_drag_moves_nothing(handles):
    shown(handles, ((1.1, 2.1), (1.3, 2.5)))
    shown(handles, None)
    handles.drag(0, (1.2, 2.4, 0.0))
    assert handles.choices.cut is None and len(handles.removed) == 1
    shown(handles, ((1.1, 2.1), (1.3, 2.5)))
    shown(handles, None)
    assert len(set(handles.removed)) == 2, "a new name each time"


@pytest.fixture
def opened(page_of, scene):
    page, turn_until = page_of
    page.open(OpenRequest(scene))
    turn_until(lambda: page.viewer is not None)
    return page.viewer, turn_until


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
