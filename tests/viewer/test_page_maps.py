"""The map on the floor belongs to what is looked at, and basins of attraction have areas in place of a scale."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from browsing import WAIT
from doubles import State, set_by_client, view_of

from fdcal.cost.basins import basins_of
from fdcal.cost.maps import cost_maps, eq7_maps, minima_of, power_shares, refined
from fdcal.cost.scale import Minima
from fdcal.graphics.annotations import legend_of
from fdcal.graphics.heatmap import (
    EDGE,
    OTHERS,
    PLACE,
    TABLE,
    basin_floor,
    cost_floor,
    descent_text,
    marks_of,
    table_numbers,
)
from fdcal.graphics.picture import static_picture, with_floor
from fdcal.graphics.primitives import DIVERGING_COLOUR_MAP
from fdcal.model.settings import Search
from fdcal.session.session import History
from fdcal.viewer.cost_maps import map_modes
from fdcal.viewer.gui.binding import BASINS, FLOOR, NOTHING, SHAPE, Binding
from fdcal.viewer.session_view import Viewer
from fdcal.viewer.tabs import map
from fdcal.viewer.tabs.map import EQ7


def mapped(viewer):
    """Let one map be made; the microphone whose map is shown then, None without a map."""
    viewer.run.solver.gate.release()
    assert viewer.maps.worker.wait_for(lambda _: not viewer.maps.worker.busy, WAIT)
    viewer.tick(1e9)
    return shown(viewer)


def shown(viewer):
    floor, search = viewer.snapshot.picture.floor, viewer.run.measurement.search
    return None if floor is None else round((floor.lowest[0][0] - search.origin[0]) / search.step)


@pytest.mark.parametrize(("range_db", "words"), [(0.1, "all but level"), (3.0, "Where the map is dark")])
def test_the_hint_says_that_a_map_that_is_all_but_level_decides_nothing(range_db, words, work):
    search = work.problem.search
    cost = 10 ** (np.linspace(-14 - range_db, -14, np.prod(search.shape)).reshape(search.shape[::-1]) / 10)
    floor = cost_floor(cost, search, True, "cost, Eq. 7 (dB), mode 1", decibels=True)
    picture = with_floor(static_picture(work.known_scene, work.measurement), floor)
    assert words in Viewer._hint(SimpleNamespace(run=work), picture)


def legend(viewer):
    return viewer._folders.overlay._regions["legend"].content


def test_a_map_stands_under_its_own_microphone_only_and_the_legend_says_that_it_is_computed(viewer):
    viewer.tick(0.0)
    assert shown(viewer) is None and "Computing the map of microphone 3" in legend(viewer)
    assert mapped(viewer) == 3 and "Computing" not in legend(viewer)
    before = viewer.picture.floor
    viewer.binding.choose_style(opacity=0.4)
    viewer.tick(1.0)
    assert viewer.picture.floor.opacity == 0.4 and viewer.picture.floor.rgb is before.rgb
    assert not viewer.maps.busy, "opacity takes no new map"
    set_by_client(viewer.tabs.map.microphone, 7)
    viewer.tick(0.0)
    assert shown(viewer) is None, "the map of microphone 3 stands under microphone 7"
    assert not any("map" in solid.name for solid in viewer.snapshot.picture.meshes), "its diamond, too"
    assert mapped(viewer) == 7
    viewer.tabs.map.choose_modes([2])
    viewer.tick(0.0)
    assert shown(viewer) is None and mapped(viewer) == 7


def test_maps_stand_side_by_side_and_are_drawn_anew_as_the_look_changes(viewer):
    side = viewer.tabs.maps.worker
    viewer.tick(0.0)
    assert side.latest is None
    images = []
    for now in (1e9, 3e9):
        mapped(viewer)
        viewer.tick(now)
        assert side.wait_for(lambda _: not side.busy, WAIT)
        viewer.tick(now + 1e9)
        images.append(viewer.tabs.maps.image.image)
        set_by_client(viewer.tabs.view.dark, True)
        viewer.tick(now + 2e9)
        assert viewer.picture.floor is not None, "the map stays meanwhile: the gate lets no other pass"
    assert images[0].ndim == 3 and images[1] is not images[0] and images[1].shape == images[0].shape


def step_to(viewer, *states, **changes):
    """Let the session show the last of some states of its run."""
    session = viewer.run.session
    history = History(list(states), len(states), session.view.history.lineage)
    changes = {"index": len(states) - 1, "count": len(states), "history": history, **changes}
    session.view = dataclasses.replace(session.view, state=states[-1], **changes)


def test_a_running_solver_draws_the_costs_it_has_in_another_scale(viewer):
    """The gate, which every map of costs has to pass, stays shut."""
    viewer.tick(0.0)
    assert mapped(viewer) == 3
    step_to(viewer, viewer.view.state, State(viewer.run.measurement.positions + 0.01, 1), running=True)
    set_by_client(viewer.tabs.map.scale, "Linear")
    ready = viewer.maps.worker.latest.ended
    viewer.tick(ready)
    assert viewer.maps.worker.wait_for(lambda latest: not latest.request[0].style.log, WAIT)
    viewer.tick(ready)
    assert shown(viewer) == 3 and not viewer.picture.floor.bar.log


def test_a_drag_delays_the_solver_and_speeds_up_the_page(server, work):
    rung = []
    tab = map.MapTab(Binding(server.gui, work, 6, wake=lambda: rung.append(True)))
    set_by_client(tab.relief, 50)
    assert work.session.ways == 1 and rung
    set_by_client(tab.relief, 60, client=False)
    assert work.session.ways == 1, "the user has not moved it"
    server.gui.reset()


def test_in_a_drag_the_last_map_stays_until_the_next(viewer):
    viewer.tick(0.0)
    assert mapped(viewer) == 3
    session, positions = viewer.run.session, np.array(viewer.run.measurement.positions)
    ready = viewer.maps.worker.latest.ended
    positions[7] += 0.03
    session.view = view_of([State(positions)])
    viewer.tick(ready + 0.1)
    assert shown(viewer) == 3, "one other microphone has moved"
    viewer.tick(ready + 1.5)
    assert shown(viewer) is None, "but not for long"
    session.view = view_of([State(positions + 0.01)])
    viewer.tick(ready + 0.1)
    assert shown(viewer) is None, "all have moved"


def test_while_running_the_map_of_an_older_state_stays_but_not_over_a_reset(viewer):
    viewer.tick(0.0)
    assert mapped(viewer) == 3
    positions, state = viewer.run.measurement.positions, viewer.view.state
    step_to(viewer, state, running=True)
    viewer.tick(0.0)
    assert shown(viewer) == 3, "the very same state"
    step_to(viewer, state, State(positions + 0.01, 1))
    viewer.tick(0.0)
    assert shown(viewer) == 3, "an older state of the same run"
    viewer.run.session.view = view_of([State(positions + 0.02)])
    viewer.tick(0.0)
    assert shown(viewer) is None, "the map of the run before the reset"


def test_the_legend_names_what_is_drawn(opened):
    viewer, turn_until = opened
    turn_until(lambda: "dB" in legend(viewer))
    viewer.run.session.step()
    turn_until(lambda: viewer.snapshot.view.index == 1)
    assert "trail" not in legend(viewer)
    set_by_client(viewer.tabs.view.trails, True)
    turn_until(lambda: "trail" in legend(viewer))
    viewer.tabs.map.choose_modes(range(1, 6))
    viewer.tabs.map.show_as(SHAPE)  # the field of the last mode takes the place of the map
    turn_until(lambda: (floor := viewer.snapshot.picture.floor) is not None and "pressure of mode 5" in floor.bar.label)
    assert viewer.snapshot.picture.floor.bar.colour_map == DIVERGING_COLOUR_MAP
    turn_until(lambda: "highest in the map: mode 5" in viewer.tabs.spectrum.text.content)
    set_by_client(viewer.tabs.map.kind, NOTHING)
    turn_until(lambda: "dB" not in legend(viewer))


def test_a_sweep_shows_the_basins_of_each_sum_and_the_controls_of_a_scale_are_hidden(basins_shown):
    viewer, turn_until = basins_shown
    sweep, tab = viewer.tabs.sweep, viewer.tabs.map
    assert not tab.scale.visible and tab.order.visible and tab.minima.visible
    set_by_client(sweep.highest, 5)
    set_by_client(sweep.summed, 3)
    turn_until(lambda: (made := sweep.worker.sweep(sweep._wanted)) is not None and len(made.frames) == 5)
    turn_until(lambda: "sum of 3 modes" in tab.caption.content and viewer.snapshot.picture.areas)
    n = viewer.binding.choices.microphone
    basins, _, search = expected(viewer, n, (1, 2, 3))
    wanted = basin_floor(basins, search, NO_MARKS, viewer.run.measurement.positions[n])
    assert np.mean(viewer.snapshot.picture.floor.rgb == wanted.rgb) > 0.999, "the same to rounding"
    set_by_client(tab.kind, FLOOR)
    turn_until(lambda: (floor := viewer.snapshot.picture.floor) is not None and floor.bar is not None)
    assert not viewer.snapshot.picture.areas and tab.scale.visible


def test_an_exception_on_the_page_is_shown_and_the_page_continues(viewer, monkeypatch, caplog):
    monkeypatch.setattr(viewer.nodes, "show", lambda picture: 1 / 0)
    for now in (1.0, 1.1, 1.2):
        viewer.guarded_tick(now)
    assert len(caplog.records) == 1 and "ZeroDivisionError" in viewer.tabs.run_bar.status.content
    monkeypatch.undo()
    for now in (2.0, 20.0, 20.1):
        viewer.guarded_tick(now)
    assert "ZeroDivisionError" not in viewer.tabs.run_bar.status.content


def test_a_map_of_the_modes_in_use_has_those_that_the_microphones_can_carry(work):
    every, state = len(work.problem.frequencies), State(work.measurement.positions, last=6)
    high = dataclasses.replace(
        work, problem=dataclasses.replace(work.problem, wavenumbers=5.0 * np.arange(1, every + 1) + 0j)
    )
    modes = map_modes(high, state, None, 2)
    assert 0 < len(modes) < every and modes == tuple(range(1, len(modes) + 1))
    assert eq7_maps(high.problem, state.positions, 4, modes, 2).shape[0] == len(modes)
    assert map_modes(high, state, None, None) == tuple(range(1, 7)), "the solver's own cost has no such limit"
    assert map_modes(high, state, (6,), 2) == (6,), "what the user has chosen is not replaced"


NO_MARKS = Minima(np.zeros((0, 2)), np.zeros((0, 2)), 0, None)
SEARCH = Search(origin=(0.0, 0.0), size=(1.2, 0.9), step=0.01, radius=1.0)


@pytest.fixture
def basins_shown(opened):
    """The page of `tiny` with basins of attraction, and a function that ticks it until something happens."""
    tab = opened[0].tabs.map
    set_by_client(tab.quantity, EQ7)
    set_by_client(tab.kind, BASINS)
    return opened


def shown_basins(viewer, turn_until, n, modes):
    """The fine map of basins on the page once it is of this microphone and these modes."""

    def ready():
        drawn = viewer.snapshot.picture.floor
        alike = viewer.snapshot.microphone == n and viewer.snapshot.map_request.modes == modes
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
def test_the_basins_are_those_of_the_microphone_and_the_modes(basins_shown, n, modes):
    viewer, turn_until = basins_shown
    tab = viewer.tabs.map
    tab.choose_microphone(n)
    tab.choose_modes(modes)
    floor = shown_basins(viewer, turn_until, n, modes)
    basins, _, search = expected(viewer, n, modes)
    truth = viewer.run.measurement.positions[n]
    wanted = basin_floor(basins, search, NO_MARKS, truth)
    np.testing.assert_array_equal(floor.rgb, wanted.rgb)
    assert floor.areas == wanted.areas and floor.bar is None
    assert descent_text(basins, search, truth) in tab.caption.content
    texts = [entry.text for entry in legend_of(viewer.snapshot.picture)]
    assert texts[: len(wanted.areas)] == [area.text for area in wanted.areas]


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
    near = descent_text(basins, SEARCH, (0.3, 0.45))
    assert near == "descent from the true position ends within 10 mm; its basin holds 50 % of the map"
    far = descent_text(basins, SEARCH, (0.3, 0.15), "estimate")
    assert far == "descent from the estimate ends 300 mm away; its basin holds 50 % of the map"
    assert "leaves the map" in descent_text(basins, SEARCH, (2.0, 2.0))


def test_many_basins_share_a_grey_and_the_edge_has_its_own():
    x, y = np.meshgrid(np.linspace(0, 1.2, 121), np.linspace(0, 0.9, 91))
    basins = basins_of(np.cos(27 * x) * np.cos(25 * y) + 0.1 * x)
    floor = basin_floor(basins, SEARCH, NO_MARKS, (0.3, 0.3))
    colours = [area.colour for area in floor.areas]
    assert OTHERS in colours and EDGE in colours and len(colours) == len(set(colours))
    percent = [float(area.text.split()[-2]) for area in floor.areas]
    assert sum(percent) == pytest.approx(100, abs=3) and percent[1:6] == sorted(percent[1:6], reverse=True)
    np.testing.assert_array_equal(TABLE[table_numbers(floor.rgb)], floor.rgb)
