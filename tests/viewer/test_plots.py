"""Curves and spectrum."""

from types import SimpleNamespace

import numpy as np
import pytest
from doubles import State, view_of
from viser import uplot

from fdcal.acoustics.dictionary import array_f_max
from fdcal.session.session import StateCosts
from fdcal.viewer import html
from fdcal.viewer.state import Binding, PageState
from fdcal.viewer.tabs import curves as plots
from fdcal.viewer.tabs import map
from fdcal.viewer.tabs.curves import CurvesTab


def curves_of(server, measurement, sought):
    """The curves of the errors of the microphones sought."""
    run = SimpleNamespace(sought=sought)
    return CurvesTab(SimpleNamespace(gui=server.gui, measurement=measurement, run=run))


@pytest.fixture
def curves(server, measurement, monkeypatch):
    """The curves of a run in which all ten microphones are sought; new axes are sent at once."""
    monkeypatch.setattr(plots, "APART", 0.0)
    return curves_of(server, measurement, np.arange(10))


def test_plots_hold_finite_numbers_only(curves, measurement):
    """uPlot searches for axis ticks endlessly if the data contain NaN."""
    worse = measurement.positions + 0.1
    states = [State(worse), State(measurement.positions, 1), State(worse, 2, last=4)]
    curves.show(PageState(view_of(states, costs=costs_of(states, [np.nan, -160.0, 2.0])), 0.0))
    for plot in (curves.error, curves.cost):
        assert all(np.isfinite(column).all() for column in plot.data)
        assert len({len(column) for column in plot.data}) == 1 and (np.diff(plot.data[0]) >= 0).all()
        steps = plot.handle.axes[0]["incrs"]
        assert steps[0] == 1 and all(step == round(step) for step in steps), "whole sweeps"


def test_the_cost_is_the_reference_cost_interpolated_where_it_was_left_out(curves, measurement):
    place = measurement.positions
    states = [State(place.copy(), i, i, stage=i // 2, last=6, cost=1e5, restart=i // 3) for i in range(4)]
    costs = costs_of(states, [-1.0, -3.0, np.nan, -9.0])
    curves.show(PageState(view_of(states[:2], costs=costs), 0.0))
    np.testing.assert_allclose(curves.cost.data[1], [-1, -3])
    assert "dB" in curves.cost.title and "Eq. 7" in curves.cost.title
    curves.show(PageState(view_of(states, costs=costs), 1.0))
    assert curves.cost.data[1].tolist() == [-1, -3, -6, -9]
    costs.compute(states[2])
    curves.show(PageState(view_of(states, costs=costs), 2.0))
    assert -4.0 in curves.cost.data[1], "computed when the solver rested"


def costs_of(states, values):
    """Return the costs of states as a session publishes them: NaN for a state that was skipped during the run."""
    computed = [(state, value) for state, value in zip(states, values, strict=True) if not np.isnan(value)]
    numbers = iter([*(value for _, value in computed), -4.0])
    costs = StateCosts(lambda positions: next(numbers))
    for state, _ in computed:
        costs.compute(state)
    return costs


def test_errors_are_those_of_the_microphones_sought_and_follow_a_rewound_history(server, measurement):
    curves, away = curves_of(server, measurement, np.array([4, 5])), np.zeros((10, 2))
    away[4], away[5], away[9] = [0.001, 0.0], [0.003, 0.0], [0.5, 0.0]
    states = [State(measurement.positions + away / (i + 1), i) for i in range(6)]
    curves.show(PageState(view_of(states), 0.0))
    assert [column[0] for column in curves.error.data[1:3]] == pytest.approx([2.0, 3.0])
    text = html.status(view_of(states[:1]), measurement, sought=np.array([4, 5]))
    assert "<b>mean 2 mm</b>, <span style='white-space: nowrap'>largest 3 mm</span>" in text
    curves.show(PageState(view_of([*states[:3], State(measurement.positions + 3 * away, 3)]), 1.0))
    assert curves.error.data[1] == pytest.approx([2, 1, 2 / 3, 6])
    curves.show(PageState(view_of(states[:1]), 2.0, sought=np.array([4])))
    assert curves.error.data[1] == pytest.approx([1.0]), "and then without the channels at fault"


def test_the_spectrum_shows_the_modes_of_the_map(server, measurement, work):
    binding = Binding(server.gui, work, 6)
    map_, tab = map.MapTab(binding), map.SpectrumTab(binding)
    map_.choose_modes([2])
    tab.show(PageState(work.session.view))
    assert "140.0 Hz" in tab.text.content and "3 functions for 10" in tab.text.content
    data = tab.plot.data
    assert len({len(column) for column in data}) == 1 and all(np.isfinite(column).all() for column in data)
    x, curve, outside, inside, limit = data
    low, high = tab.plot.handle.scales["y"]["range"]
    assert (np.diff(x) >= 0).all()
    np.testing.assert_allclose(x[inside > low], [measurement.frequencies[1]])
    np.testing.assert_allclose(x[outside > low], measurement.frequencies[[0, 2, 3, 4, 5]])
    dotted = (inside > low) | (outside > low)
    # The visible points are on the curve.
    np.testing.assert_allclose(np.maximum(inside, outside)[dotted], curve[dotted])
    assert (curve[dotted] < high).all()
    f_max = round(array_f_max(work.session.view.state.positions, work.problem.sound_speed, work.problem.dimension))
    assert np.array_equal(x[limit > low], [f_max] if x[0] < f_max < x[-1] else [])
    inner = tab.columns((1,), 200.0)
    assert np.array_equal(inner[0][inner[-1] > low], [200.0]) and len({len(column) for column in inner}) == 1
    assert "beyond" not in tab.text.content
    map_.choose_modes([1, 6])
    tab.show(PageState(view_of([State(10 * work.measurement.positions)])))
    assert "beyond" in tab.text.content and "300.0 Hz" in tab.text.content
    server.gui.reset()


def test_new_axes_are_not_sent_together_with_data_of_another_extent(server, monkeypatch):
    """Otherwise the page builds a new chart with the old visible part, and draws the curve in a corner."""
    clock = [0.0]
    monkeypatch.setattr(plots.time, "perf_counter", lambda: clock[0])
    plot = plots.Plot(server.gui, "errors", (uplot.Series(label="x"), uplot.Series(label="y")), "x")
    for count, top, elapsed, seen in (
        (1, 9.0, 1.0, (1, 9.0)),
        (2, 7.0, 0.0, (2, 9.0)),  # the data come first
        (3, 6.0, 0.0, (2, 9.0)),  # a solver runs: nothing is sent yet
        (4, 6.0, plots.APART, (2, 6.0)),  # the newest axes are sent alone
        (4, 6.0, 0.0, (2, 6.0)),
        (4, 6.0, plots.APART, (4, 6.0)),  # the data that have arrived meanwhile follow
        (4, 5.0, 0.0, (4, 5.0)),  # the data have the same extent: the axes are sent at once
        (5, 5.0, 0.0, (5, 5.0)),  # the axes are the same: the data are sent at once
    ):
        clock[0] += elapsed
        plot.show((np.arange(count, dtype=float), np.full(count, 2.0)), (0.0, top))
        assert (len(plot.data[0]), plot.handle.scales["y"]["range"][1]) == seen


def test_errors_are_drawn_over_whole_decades(curves, measurement):
    states = [State(measurement.positions + shift, i) for i, shift in enumerate((0.2, 2e-5))]
    curves.show(PageState(view_of(states), 0.0))
    handle = curves.error.handle
    assert handle.scales["y"]["range"] == pytest.approx((0.01, 1000))
    numbers = handle.axes[1]["values"]
    assert (numbers[0], numbers[-1], len(numbers)) == ("0.01", "1,000", 6)
