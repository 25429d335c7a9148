"""Curves and spectrum."""

import dataclasses

import numpy as np
import pytest
from doubles import State, set_by_client, view_of

from fdcal.acoustics.fourier_bessel import array_f_max
from fdcal.acoustics.measurement_cache import cached_measurement
from fdcal.viewer.gui.binding import Binding
from fdcal.viewer.tabs import map, modes, spectrum_plot
from fdcal.viewer.tabs.curves import CurvesTab


def test_plots_hold_finite_numbers_only(server, measurement):
    """uPlot never stops looking for axis ticks if it meets a NaN."""
    curves = CurvesTab(server.gui, measurement)
    worse = measurement.positions + 0.1
    states = [
        State(worse, cost=float("nan")),
        State(measurement.positions, 1, cost=0.0),
        State(worse, 2, last=4, cost=2.0),
    ]
    curves.show(view_of(states), now=0.0)
    for plot in (curves.error, curves.cost):
        assert all(np.isfinite(column).all() for column in plot.data)
        assert len({len(column) for column in plot.data}) == 1 and (np.diff(plot.data[0]) >= 0).all()
        *_, marks, stage = plot.data
        assert np.count_nonzero(marks == 1.0) == 1 and (marks[marks != 1.0] < 0).all(), "one stroke as the mode came in"
        assert (stage == 1).all()


def test_stages_are_marked_and_a_negative_log_likelihood_is_drawn_linearly(server, measurement):
    curves, place = CurvesTab(server.gui, measurement), measurement.positions
    states = [State(place, i, i, stage=i // 2, last=6, cost=cost) for i, cost in enumerate((9.0, 3.0, -2.0, -5.0))]
    curves.show(view_of(states[:2]), now=0.0)
    np.testing.assert_allclose(curves.cost.data[1], 10 * np.log10([9, 3]))
    assert "dB" in curves.cost.title
    curves.show(view_of(states), now=1.0)
    x, cost, marks, stage = curves.cost.data
    assert cost.min() == -5 and cost.max() == 9 and "dB" not in curves.cost.title
    assert x[marks == 1.0].tolist() == [2.0], "the one stage that began"
    assert stage[x < 2].tolist() == [1, 1] and stage[x > 2].tolist() == [2]


def test_many_stages_do_not_hide_the_curves(server, measurement):
    curves = CurvesTab(server.gui, measurement)
    curves.show(view_of([State(measurement.positions, i, i, stage=i, last=6) for i in range(57)]), now=0.0)
    x, _, marks, stage = curves.cost.data
    seen = marks > 0
    assert x[seen].tolist() == list(range(1, 57)) and marks.max() < 0.1, "a tick at the bottom for each"
    assert stage.max() == 57 and curves.cost.handle.scales["stage"]["range"] == (0.0, 1.0)


def test_errors_are_drawn_over_whole_decades(server, measurement):
    curves = CurvesTab(server.gui, measurement)
    for now, shift, wanted in ((0.0, 0.2, (100, 1000)), (1.0, 0.0002, (0.1, 1000))):
        curves.show(view_of([State(measurement.positions + 0.2), State(measurement.positions + shift, 1)]), now=now)
        handle = curves.error.handle
        assert handle.scales["y"]["range"] == pytest.approx(wanted)
        numbers = handle.axes[1]["values"]
        assert (numbers[0], numbers[-1]) == (f"{wanted[0]:g}", "1,000")
        assert len(numbers) == len(handle.axes[1]["splits"]) == 1 + round(np.log10(wanted[1] / wanted[0]))


def test_plots_follow_a_rewound_history(server, measurement):
    curves = CurvesTab(server.gui, measurement)
    states = [State(measurement.positions + 0.1 / (i + 1), i) for i in range(6)]
    curves.show(view_of(states), now=0.0)
    another = [*states[:3], State(measurement.positions + 0.5, 3)]
    curves.show(view_of(another), now=1.0)
    assert len(curves.error.data[0]) == 4
    assert curves.error.data[1][-1] == pytest.approx(1e3 * 0.5 * np.sqrt(2))


def test_the_spectrum_is_drawn_with_its_picked_peaks(scene, measurement):
    measured = cached_measurement(scene)
    seen, levels = spectrum_plot.spectrum_levels(measured, 12)
    assert seen.shape[1] <= spectrum_plot.MAX_POINTS and seen[1].max() == 0.0
    at, power = measured.spectrum
    for mode, f in enumerate(measured.frequencies):
        near = np.abs(at - f) < scene.measurement.resolution / 2
        assert abs(at[near][power[near].argmax()] - f) <= np.diff(at).max(), f"mode {mode + 1} is no peak"
    assert len(levels) == 12 and (levels >= np.interp(measured.frequencies[:12], *seen) - 1e-9).all()
    nothing, own = spectrum_plot.spectrum_levels(measurement, 6)
    assert nothing is None and own.max() == pytest.approx(0.0)


@pytest.mark.parametrize("has_spectrum", [True, False])
def test_sliders_choose_the_modes_of_the_map(server, scene, measurement, has_spectrum, work):
    if has_spectrum:
        kept = measurement.frequencies
        spectrum = np.stack([np.linspace(50, 350, 2000), 1 + np.cos(np.linspace(50, 350, 2000)) ** 2])
        work = dataclasses.replace(work, measurement=dataclasses.replace(measurement, spectrum=spectrum))
        assert kept[0] > 50
    binding = Binding(server.gui, work, 6)
    map_ = map.MapTab(binding)
    tab = modes.ModesTab(binding, map_)
    set_by_client(tab.high, 4)
    assert binding.choices.modes == (1, 2, 3, 4)
    set_by_client(tab.low, 3)
    assert binding.choices.modes == (3, 4)
    set_by_client(tab.high, 2)
    assert binding.choices.modes == (2,)
    tab.show(work.session.view, 0.0)
    data = tab.spectrum.handle.data
    assert len({len(column) for column in data}) == 1 and all(np.isfinite(column).all() for column in data)
    x, curve, outside, inside, limit = data
    low, high = tab.spectrum.handle.scales["y"]["range"]
    assert (np.diff(x) >= 0).all()
    np.testing.assert_allclose(x[inside > low], [measurement.frequencies[1]])
    np.testing.assert_allclose(x[outside > low], measurement.frequencies[[0, 2, 3, 4, 5]])
    dotted = (inside > low) | (outside > low)
    np.testing.assert_allclose(np.maximum(inside, outside)[dotted], curve[dotted])  # on the curve, and in sight
    assert (curve[dotted] < high).all()
    f_max = round(array_f_max(work.session.view.state.positions, work.problem.sound_speed, work.problem.dimension))
    assert np.array_equal(x[limit > low], [f_max] if x[0] < f_max < x[-1] else [])
    inner = tab.spectrum.columns((1,), 200.0)
    assert np.array_equal(inner[0][inner[-1] > low], [200.0]) and len({len(column) for column in inner}) == 1
    set_by_client(tab.same, True)
    assert binding.choices.modes is None
    server.gui.reset()
