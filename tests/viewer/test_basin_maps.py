"""The basins of attraction on the page follow microphone and modes, and have a legend of areas in place of a scale."""

import dataclasses

import numpy as np
import pytest
from doubles import set_by_client

from fdcal.cost.basins import basins_of
from fdcal.cost.maps import cost_maps, minima_of, power_shares, refined
from fdcal.cost.scale import Minima
from fdcal.graphics.annotations import legend_of
from fdcal.graphics.basin_map import EDGE, OTHERS, PLACE, TABLE, basin_floor, descent_text, table_numbers
from fdcal.graphics.heatmap import marks_of
from fdcal.graphics.landscape import draw_landscape
from fdcal.model.settings import Search
from fdcal.session.sources import OpenRequest
from fdcal.viewer.gui.binding import BASINS, FLOOR
from fdcal.viewer.tabs import view as exports
from fdcal.viewer.tabs.map import EQ7
from fdcal.viewer.tabs.view import map_request

NO_MARKS = Minima(np.zeros((0, 2)), np.zeros((0, 2)), 0, None)
SEARCH = Search(origin=(0.0, 0.0), size=(1.2, 0.9), step=0.01, radius=1.0)


@pytest.fixture
def opened(page_of, scene):
    """The page of `tiny` with basins of attraction, and a function that ticks it until something happens."""
    page, turn_until = page_of
    page.open(OpenRequest(scene))
    turn_until(lambda: page.viewer is not None)
    tab = page.viewer.tabs.map
    set_by_client(tab.quantity, EQ7)
    set_by_client(tab.kind, BASINS)
    return page.viewer, turn_until


def shown(viewer, turn_until, n, modes):
    """The fine map of basins on the page once it is of this microphone and these modes."""

    def ready():
        drawn = viewer.snapshot.picture.floor
        alike = viewer.snapshot.microphone == n and map_request(viewer.snapshot).modes == modes
        there = alike and drawn is not None and drawn.areas and f"microphone {n}," in tab.caption.content
        return there and drawn.lowest + drawn.minima == fine

    tab, fine = viewer.tabs.map, expected(viewer, n, modes)[1]
    turn_until(ready)
    return viewer.snapshot.picture.floor


def expected(viewer, n, modes):
    """Basins and minima of the cost of the page on its fine lattice."""
    run, state = viewer.run, viewer.binding.session.view.state
    search, offset = refined(run.problem.search), viewer.binding.choices.order_offset
    maps = [cost_maps(run.problem, run.solver, state, n, (mode,), offset, search)[0] for mode in modes]
    share = power_shares(run.problem, state, modes)
    cost = sum(a * one for a, one in zip(share, maps, strict=True))
    lowest, others = marks_of(minima_of(cost, search))
    return basins_of(cost), lowest + others, search


@pytest.mark.parametrize("n, modes", [(9, (3, 4)), (12, (20,))])
def test_the_basins_are_those_of_the_microphone_and_the_modes(opened, n, modes):
    viewer, turn_until = opened
    tab = viewer.tabs.map
    tab.choose_microphone(n)
    tab.choose_modes(modes)
    floor = shown(viewer, turn_until, n, modes)
    basins, _, search = expected(viewer, n, modes)
    truth = viewer.run.measurement.positions[n]
    wanted = basin_floor(basins, search, NO_MARKS, truth)
    np.testing.assert_array_equal(floor.rgb, wanted.rgb)
    assert floor.areas == wanted.areas and floor.bar is None
    assert descent_text(basins, search, truth) in tab.caption.content
    texts = [entry.text for entry in legend_of(viewer.snapshot.picture)]
    assert texts[: len(wanted.areas)] == [area.text for area in wanted.areas]


def test_the_controls_of_a_scale_are_hidden_and_the_map_comes_back(opened):
    viewer, turn_until = opened
    tab = viewer.tabs.map
    assert not tab.scale.visible and tab.order.visible and tab.minima.visible
    set_by_client(tab.kind, FLOOR)
    turn_until(lambda: (floor := viewer.snapshot.picture.floor) is not None and floor.bar is not None)
    assert not viewer.snapshot.picture.areas and tab.scale.visible


def test_a_sweep_shows_the_basins_of_each_sum(opened):
    viewer, turn_until = opened
    sweep, tab = viewer.tabs.sweep, viewer.tabs.map
    set_by_client(sweep.highest, 5)
    set_by_client(sweep.summed, 3)
    turn_until(lambda: (made := sweep.worker.sweep(sweep._wanted)) is not None and len(made.frames) == 5)
    turn_until(lambda: "sum of 3 modes" in tab.caption.content and viewer.snapshot.picture.areas)
    n = viewer.binding.choices.microphone
    basins, _, search = expected(viewer, n, (1, 2, 3))
    floor = viewer.snapshot.picture.floor
    wanted = basin_floor(basins, search, NO_MARKS, viewer.run.measurement.positions[n])
    assert np.mean(floor.rgb == wanted.rgb) > 0.999, "the same to rounding"


def test_files_show_the_basins_of_the_page(opened, monkeypatch):
    viewer, turn_until = opened
    viewer.tabs.map.choose_modes((7, 20))
    turn_until(lambda: viewer.snapshot.picture.areas)
    snapshot = dataclasses.replace(viewer.snapshot, choices=viewer.binding.choices)
    figures = []
    monkeypatch.setattr(exports, "call", lambda _, __, *drawn: figures.append(draw_landscape(*drawn)) or b"")
    exports.KINDS["Maps as in Fig. 1 (PNG)"].make(snapshot)
    panels = [panel for panel in figures[0].axes if panel.images]
    assert len(panels) == 3 and "Basins of attraction" in figures[0].get_suptitle()
    basins, _, search = expected(viewer, viewer.snapshot.microphone, (7, 20))
    truth = viewer.run.measurement.positions[viewer.snapshot.microphone]
    areas = basin_floor(basins, search, NO_MARKS, truth).areas
    assert [text.get_text() for text in panels[-1].get_legend().get_texts()] == [area.text for area in areas]
    assert 'Name="basin of the sum"' in exports.KINDS["Map (VTI for ParaView)"].make(snapshot).decode()


def three_wells():
    """A cost with three minima, whose basins hold a half, a third and a sixth of the map between them."""
    x, y = np.meshgrid(np.linspace(0, 1.2, 121), np.linspace(0, 0.9, 91))
    edges, middles = np.array([0.0, 0.6, 1.0, 1.2]), np.array([0.3, 0.8, 1.1])
    well = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, 2)
    half = np.diff(edges)[well] / 2
    return ((x - middles[well]) / half) ** 2 + 0.1 * (y - 0.45) ** 2


def test_the_first_colour_is_that_of_the_true_position_and_shares_add_up():
    basins = basins_of(three_wells())
    for place, share in (((0.2, 0.1), 50), ((0.7, 0.1), 33), ((1.05, 0.8), 17)):
        floor = basin_floor(basins, SEARCH, NO_MARKS, place)
        first = floor.areas[0]
        assert (first.colour, first.text) == (PLACE, f"basin of the true position {share} %")
        assert [int(area.text.split()[-2]) for area in floor.areas] == pytest.approx(
            [share, *sorted({50, 33, 17} - {share}, reverse=True)], abs=1
        )
        finer = floor.rgb.shape[1] // 121
        row, column = (round(value / 0.01) * finer + finer // 2 for value in place[::-1])
        assert tuple(floor.rgb[row, column]) == PLACE
    assert basin_floor(basins, SEARCH, NO_MARKS).areas[0].colour != PLACE


def test_many_basins_share_a_grey_and_the_edge_has_its_own():
    x, y = np.meshgrid(np.linspace(0, 1.2, 121), np.linspace(0, 0.9, 91))
    basins = basins_of(np.cos(27 * x) * np.cos(25 * y) + 0.1 * x)
    floor = basin_floor(basins, SEARCH, NO_MARKS, (0.3, 0.3))
    colours = [area.colour for area in floor.areas]
    assert OTHERS in colours and EDGE in colours and len(colours) == len(set(colours))
    percent = [float(area.text.split()[-2]) for area in floor.areas]
    assert sum(percent) == pytest.approx(100, abs=3) and percent[1:6] == sorted(percent[1:6], reverse=True)
    np.testing.assert_array_equal(TABLE[table_numbers(floor.rgb)], floor.rgb)


def test_the_sentence_says_how_far_descent_ends_from_the_place():
    basins = basins_of(three_wells())
    near = descent_text(basins, SEARCH, (0.3, 0.45))
    assert near == "descent from the true position ends within 10 mm; its basin holds 50 % of the map"
    far = descent_text(basins, SEARCH, (0.3, 0.15), "estimate")
    assert far == "descent from the estimate ends 300 mm away; its basin holds 50 % of the map"
    assert "leaves the map" in descent_text(basins, SEARCH, (2.0, 2.0))
