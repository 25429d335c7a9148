"""Fig. 1: what is computed, and that what is drawn shows it."""

from __future__ import annotations

import numpy as np
import pytest

from fdcal.acoustics.dictionary import max_order
from fdcal.acoustics.measure import cached_measurement
from fdcal.cost.eq7 import cost
from fdcal.graphics.landscape import draw_landscape, landscape_panels
from fdcal.model.scene_file import load_scene
from fdcal.model.validation import InputError


@pytest.fixture(scope="module")
def measured():
    scene = load_scene("tiny")
    measurement = cached_measurement(scene)
    return measurement, measurement.problem()


def test_panels_are_the_cost_of_eq_7_and_their_sum(measured):
    measurement, problem = measured
    panels = landscape_panels(problem, measurement.positions, 9, [2, 5], 2)
    ny, nx = panels.maps.shape[1:]
    assert (nx, ny) == problem.search.shape
    assert np.allclose(panels.maps[2], panels.maps[0] + panels.maps[1])
    centre = problem.search.step * np.round((measurement.positions.mean(axis=0) - problem.search.origin) / 0.02)
    moved = measurement.positions.copy()
    moved[9] = problem.search.origin + problem.search.step * np.array([3, 17])
    modes = [1, 4]
    k = problem.wavenumbers[modes]
    expected = cost(moved, problem.pressures[modes], k, max_order(k, 0.32, 2), centre + problem.search.origin)
    assert np.allclose(panels.maps[:2, 17, 3], expected, rtol=1e-8)


def test_the_joint_minimum_is_the_true_position(measured):
    measurement, problem = measured
    for n in (1, 9, 15):
        panels = landscape_panels(problem, measurement.positions, n, range(1, 9), 2)
        assert np.allclose(panels.minima[-1], measurement.positions[n])


def test_a_mode_of_too_high_an_order_is_refused(measured):
    measurement, problem = measured
    with pytest.raises(InputError, match=r"2L \+ 1 = "):
        landscape_panels(problem, measurement.positions, 9, [3], 20)


def test_figure_says_what_it_shows(measured):
    measurement, problem = measured
    panels = landscape_panels(problem, measurement.positions, 9, [1, 5, 9], 2)
    figure = draw_landscape(panels, measurement.positions[9], estimate=measurement.positions[9] + 0.03)
    maps = [axes for axes in figure.axes if axes.images]
    bars = [axes for axes in figure.axes if axes not in maps]
    assert [axes.get_title() for axes in maps] == [
        *(f"mode {m}, {problem.frequencies[m - 1]:.1f} Hz" for m in (1, 5, 9)),
        "sum of the 3 modes",
    ]
    assert {axes.get_ylabel() for axes in bars} == {"cost (dimensionless)"}
    assert (maps[-1].get_xlabel(), maps[0].get_ylabel()) == ("x (m)", "y (m)")
    for axes, found in zip(maps, panels.minima, strict=True):
        marks = {line.get_label(): line.get_xydata()[0] for line in axes.lines}
        assert np.allclose(marks["lowest cost"], found)
        assert np.allclose(marks["estimate"], measurement.positions[9] + 0.03)
        assert np.allclose(marks["true"], measurement.positions[9])
        left, right, low, high = axes.images[0].get_extent()
        assert np.allclose([left, low], np.array(problem.search.origin) - 0.01), "pixels are centred on candidates"
        assert np.allclose([right, high], np.array(problem.search.origin) + 0.49)


def test_decibels_have_few_round_numbers_and_the_colours_of_the_map(measured):
    measurement, problem = measured
    panels = landscape_panels(problem, measurement.positions, 9, [1, 5, 9], 2)
    drawn = draw_landscape(panels, label="cost, Eq. 7 (dB)", decibels=True)
    maps = [axes for axes in drawn.axes if axes.get_images()]
    assert len(maps) == len(panels.maps)
    for axes, costs in zip(maps, panels.maps, strict=True):
        image = axes.get_images()[0]
        shown = np.maximum(costs, costs.max() * 1e-4)
        np.testing.assert_allclose(image.get_array(), 10 * np.log10(shown), rtol=1e-9)
        numbers = image.colorbar.get_ticks()
        low, high = image.get_clim()
        inside = [number for number in numbers if low <= number <= high]
        assert 2 <= len(inside) <= 6 and "dB" in image.colorbar.ax.get_ylabel()
        steps = np.diff(inside)
        assert np.allclose(steps, steps[0]) and f"{steps[0]:.0e}"[0] in "125"
