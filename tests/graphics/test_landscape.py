"""Fig. 1: its values, and that the figure shows them.

Maps as colours, as a relief, and side by side show the given values at the right places.
"""

import csv
import io
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from fdcal.assessment.result_file import position_table
from fdcal.cost.maps import interpolate, landscape_panels, mode_shape, refined
from fdcal.graphics import heatmap
from fdcal.graphics.figures import draw_landscape, figure_bytes
from fdcal.graphics.heatmap import RELIEF_HEIGHT, WAVE_POINTS, cost_floor, relief_grid, wave_floor
from fdcal.graphics.marks import drape
from fdcal.graphics.primitives import DIVERGING_COLOUR_MAP
from fdcal.model.gauge import position_errors
from fdcal.model.measurement import Measurement
from fdcal.model.settings import Search


@pytest.fixture(scope="module")
def measured(tiny):
    return tiny, tiny.problem()


def test_figure_says_what_it_shows_in_the_colours_of_the_map_and_with_few_round_numbers(measured):
    measurement, problem = measured
    panels = landscape_panels(problem, measurement.positions, 9, [1, 5, 9], 2)
    figure = draw_landscape(panels, measurement.positions[9], estimate=measurement.positions[9] + 0.03)
    maps = [axes for axes in figure.axes if axes.images]
    bars = [axes for axes in figure.axes if axes not in maps]
    titles = [f"frequency {m}, {problem.frequencies[m - 1]:.1f} Hz" for m in (1, 5, 9)]
    assert [axes.get_title() for axes in maps] == [*titles, "sum of the 3 frequencies"]
    assert [axes.get_ylabel() for axes in bars] == ["cost (dB re the highest of each map)"]
    assert (maps[-1].get_xlabel(), maps[0].get_ylabel()) == ("x (m)", "y (m)")
    for axes, found in zip(maps, panels.minima, strict=True):
        marks = {line.get_label(): line.get_xydata()[0] for line in axes.lines}
        assert np.allclose(marks["lowest point"], found, atol=problem.search.step), "found on a finer lattice"
        assert np.allclose(marks["estimate"], measurement.positions[9] + 0.03)
        assert np.allclose(marks["true"], measurement.positions[9])
        left, right, low, high = axes.images[0].get_extent()
        assert np.allclose([left, low], np.array(problem.search.origin) - 0.01), "pixels are centred on candidates"
        assert np.allclose([right, high], np.array(problem.search.origin) + 0.49)
    for axes, costs in zip(maps, panels.maps, strict=True):
        shown = np.maximum(costs / costs.max(), 1e-4)
        np.testing.assert_allclose(axes.get_images()[0].get_array(), 10 * np.log10(shown), rtol=1e-9)
    (bar,) = (axes.get_images()[0].colorbar for axes in maps if axes.get_images()[0].colorbar)
    low, high = bar.vmin, bar.vmax
    inside = [number for number in bar.get_ticks() if low <= number <= high]
    assert 2 <= len(inside) <= 7 and "dB" in bar.ax.get_ylabel()
    steps = np.diff(inside)
    assert np.allclose(steps, steps[0]) and f"{steps[0]:.0e}"[0] in "125"


SEARCH = Search(origin=(0.0, 0.0), size=(1.0, 1.0), step=0.05, radius=1.0)


def bowl(x, y, least=0.1):
    axis = SEARCH.step * np.arange(21)
    return least + (axis[None, :] - x) ** 2 + (axis[:, None] - y) ** 2


def test_heights_rise_with_colours_and_microphones_stand_on_them():
    floor = cost_floor(bowl(0.3, 0.8), SEARCH, relief=True)
    assert floor.heights.min() == 0 and floor.heights[16, 6] == 0
    order = np.argsort(bowl(0.3, 0.8).ravel())
    assert (np.diff(floor.heights.ravel()[order]) >= 0).all() and floor.heights.max() > 0.2
    assert drape([[0.3, 0.8]], floor)[0, 2] == 0
    assert drape([[1.0, 0.0]], floor)[0, 2] == pytest.approx(floor.heights[0, 20])
    grid = relief_grid(floor, floor.heights)
    for axis, places in enumerate((grid[0, :, 0], grid[:, 0, 1])):
        ends = floor.origin[axis], floor.origin[axis] + floor.size[axis]
        assert (places[0], places[-1]) == pytest.approx(ends), "to the edges of the map"
    np.testing.assert_array_equal(grid[1:-1, 1:-1, 2], floor.heights)
    assert floor.heights.max() == pytest.approx(RELIEF_HEIGHT * 1.05)
    flat = cost_floor(bowl(0.3, 0.8), SEARCH)
    assert flat.heights is None and drape([[0.3, 0.8]], flat).shape == (1, 2)


def test_a_slope_is_shaded_by_its_angle_to_the_light():
    ramp, rise = np.tile(np.linspace(1, 2, 21), (21, 1)), RELIEF_HEIGHT * 1.05
    for cost, normal in ((ramp, [-rise, 0, 1]), (ramp[:, ::-1], [rise, 0, 1]), (ramp.T, [0, -rise, 1])):
        lit, flat = (cost_floor(cost, SEARCH, relief=relief).rgb for relief in (True, False))
        brightness = normal @ heatmap.TOWARDS_LIGHT / np.linalg.norm(normal) / heatmap.TOWARDS_LIGHT[2]  # level: 1
        dark, white = np.interp(brightness, [0, 1], [heatmap.DARKEST, 1]), heatmap.BRIGHTEST * max(brightness - 1, 0)
        np.testing.assert_allclose(lit, (1 - white) * dark * flat + 255 * white, atol=2)


def test_a_cost_of_both_signs_has_a_linear_scale():
    floor = cost_floor(-bowl(0.3, 0.8), SEARCH, log=True)
    assert floor.bar.low < floor.bar.high < 0 and "(dB)" not in floor.bar.label
    assert np.isfinite([share for share, _ in floor.bar.ticks]).all()


def test_a_standing_wave_is_white_where_it_is_zero_and_its_line_joins_places_of_the_measured_pressure(measured):
    measurement, problem = measured
    truth, n, lattice = measurement.positions, 8, refined(problem.search, WAVE_POINTS)
    floor = wave_floor(problem, truth, n, [(12, "mode 12, x"), (15, "mode 15, x")], 2)
    field, level = mode_shape(problem, truth, 15, 2, None, n, lattice)
    warm = floor.rgb[..., 0].astype(int) - floor.rgb[..., 2]
    assert floor.rgb[np.abs(field) < 0.01].min() > 235 and floor.bar.colour_map == DIVERGING_COLOUR_MAP
    assert warm[field > 0.5].min() > 40 and warm[field < -0.5].max() < -40
    assert interpolate(field, lattice, truth[n]) == pytest.approx(level, abs=0.02), "as the others predict"
    line = floor.curves[1].segments.reshape(-1, 2)[::20]
    assert [interpolate(field, lattice, point) for point in line] == pytest.approx([level] * len(line), abs=0.01)
    assert np.linalg.norm(floor.lowest - truth[n], axis=1).min() < 0.01 and floor.show_minima, "the lines cross there"
    plain = wave_floor(problem, truth, n, [(15, "mode 15, x")], 2, marked=False)
    assert not plain.curves and not plain.show_minima


@pytest.mark.parametrize("count", [1, 4])
def test_no_text_of_the_figure_covers_another(measured, count):
    measurement, problem = measured
    panels = landscape_panels(problem, measurement.positions, 6, tuple(range(1, count + 1)), 2)
    panels = replace(panels, search=replace(panels.search, origin=(2.01, 1.71), step=2 * panels.search.step))
    at_edge = np.array(panels.search.origin[:2]) + panels.search.step * (np.array(panels.maps.shape[:0:-1]) - 1)
    heading = "Cost of moving it\nin two lines"
    figure = draw_landscape(panels, measurement.positions[6], estimate=at_edge, heading=heading)
    figure_bytes(figure, "png")
    shown = [panel for panel in figure.axes if panel.get_visible()]
    texts = [figure._suptitle, *figure.legends, *(panel.title for panel in shown)]
    for axis in (axis for panel in shown for axis in (panel.xaxis, panel.yaxis)):
        low, high = axis.get_view_interval()
        ticks = [tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
        texts += [text for text in (*ticks, axis.label) if text.get_visible()]
    boxes = [text.get_window_extent() for text in texts if not hasattr(text, "get_text") or text.get_text()]
    for i, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[i + 1 :])
    mark = 8.5 / 72 * figure.dpi  # pixels, half the size of the largest mark
    for panel in shown[:-1]:
        top = panel.transData.transform(at_edge)[1] + mark
        assert panel.title.get_window_extent().y0 > top, "a mark at the edge of a map does not reach its title"


# Files for other programs can be read by the readers of these programs.


@pytest.fixture(scope="module")
def solid():
    """An array in space, with names that are no plain texts."""
    rng = np.random.default_rng(3)
    pressures = rng.normal(size=(2, 9)) + 1j * rng.normal(size=(2, 9))
    names = ('"a", b', "<i>", "ü&", "=1+1", *"efghi")
    places = {"positions": rng.normal(size=(9, 3)), "known": [1, 4, 5, 6]}
    return Measurement([100.0, 150.0], pressures, 343.0, 3, names=names, **places)


def test_the_table_of_microphones_is_complete(measured, solid):
    measurement, _ = measured
    blind = Measurement(measurement.frequencies, measurement.pressures, 343.0)
    rows = list(csv.DictReader(io.StringIO(position_table(blind, measurement.positions))))
    assert len(rows) == 16 and "z_m" not in rows[0]
    assert {row[key] for row in rows for key in ("true_x_m", "true_y_m", "error_m", "uncertainty_m")} == {""}
    estimate = solid.positions + [0.0, 0.003, 0.004]
    rows = list(csv.DictReader(io.StringIO(position_table(solid, estimate, np.full(9, 0.002)))))
    assert [row["name"] for row in rows] == list(solid.names)
    assert [row["known"] for row in rows] == ["yes" if n in (1, 4, 5, 6) else "no" for n in range(9)]
    for start, values in (("", estimate), ("true_", solid.positions)):
        np.testing.assert_allclose([[float(row[f"{start}{a}_m"]) for a in "xyz"] for row in rows], values, rtol=1e-8)
    errors = position_errors(estimate, solid.positions).tolist()
    assert [float(row["error_m"]) for row in rows] == pytest.approx(errors, rel=1e-8)
    assert ",2.47," in position_table(solid, np.full_like(estimate, 2.4699999999999998))
    assert {row["uncertainty_m"] for row in rows} == {"0.002"}


def test_figures_are_written_as_picture_and_drawing(measured):
    measurement, problem = measured
    panels = landscape_panels(problem, measurement.positions, 9, [1, 5], 2)
    figure = draw_landscape(panels, measurement.positions[9], heading="a $ and $ <b>")
    image = Image.open(io.BytesIO(figure_bytes(figure, "png")))
    assert image.format == "PNG" and len(np.unique(np.asarray(image.convert("RGB")).reshape(-1, 3), axis=0)) > 100
    drawing = ElementTree.fromstring(figure_bytes(figure, "svg"))
    texts = {"".join(node.itertext()) for node in drawing.iter("{http://www.w3.org/2000/svg}text")}
    assert {"a $ and $ <b>", f"frequency 5, {problem.frequencies[4]:.1f} Hz", "x (m)"} <= texts
    assert len(list(drawing.iter("{http://www.w3.org/2000/svg}image"))) >= 3
