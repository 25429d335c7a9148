"""The sweep of modes: its maps are those of the page, its counts are theirs."""

import time

import numpy as np
import pytest
from doubles import set_by_client

from fdcal.cost.basins import local_minima
from fdcal.cost.maps import cost_maps, refined
from fdcal.session.sources import OpenRequest
from fdcal.viewer.tabs.sweep import DOWN, Playback, SweepWorker


def played(playback, stops, ready, times):
    """What a playback shows, and when; `ready` maps a time to the number of maps computed."""
    found = [(now, playback.advance(stops, ready(now), now)) for now in times]
    return [(now, stop) for now, stop in found if stop is not None]


def test_a_playback_shows_every_map_at_its_rate():
    playback, times = Playback(rate=4.0), np.arange(0, 3, 0.05)
    shown = played(playback, (1, 2, 3, 4, 5), lambda now: 5, times)
    assert [stop for _, stop in shown] == [1, 2, 3, 4, 5]
    assert np.diff([now for now, _ in shown]) == pytest.approx(0.25, abs=0.051)
    assert playback.ended((1, 2, 3, 4, 5), 3.0) and not Playback(4.0).ended((1,), 3.0)


def test_a_playback_waits_for_maps_and_leaves_none_out():
    times = np.arange(0, 10, 0.05)
    shown = played(Playback(rate=10.0), range(1, 9), lambda now: int(now), times)
    assert [stop for _, stop in shown] == list(range(1, 9))
    assert all(now >= stop for now, stop in shown)


@pytest.mark.parametrize(("summed", "then"), [(0, 1), (3, 4), (4, 5), (5, 1)])
def test_play_goes_on_after_the_present_sum_and_from_the_beginning_after_the_last(summed, then):
    playback = Playback(rate=1.0)
    playback.continue_from(summed, range(1, 6))
    assert playback.advance(range(1, 6), 5, 0.0) == then


@pytest.fixture
def opened(page_of, scene):
    """The page of `tiny`, whose maps are ready, and a function that ticks it until something happens."""
    page, turn_until = page_of
    page.open(OpenRequest(scene))
    turn_until(lambda: page.viewer is not None)
    return page.viewer, turn_until


def map_on_page(viewer):
    """The map that the page shows now."""
    return viewer.snapshot.picture.floor


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
    turn_until(lambda: (made := sweep.worker.sweep(sweep._wanted)) is not None and len(made.frames) == 9)
    turn_until(lambda: map_on_page(viewer) is not None and "sum of 4 modes" in tab.caption.content)
    swept, caption = map_on_page(viewer), tab.caption.content
    sweep.worker._sweep = None  # so the page computes the map itself
    turn_until(lambda: map_on_page(viewer) is not None and map_on_page(viewer) is not swept
               and map_on_page(viewer).rgb.shape == swept.rgb.shape)  # fmt: skip
    np.testing.assert_array_equal(map_on_page(viewer).rgb, swept.rgb)
    assert map_on_page(viewer).minima == swept.minima and tab.caption.content == caption


def test_a_highest_mode_below_all_that_can_be_summed_leaves_the_lowest(opened, monkeypatch):
    """As of a take whose rows begin above it."""
    viewer, turn_until = opened
    sweep = viewer.tabs.sweep
    monkeypatch.setattr(sweep, "_usable", lambda: (3, 4, 5))
    set_by_client(sweep.highest, 2)
    turn_until(lambda: (made := sweep.worker.sweep(sweep._wanted)) is not None and len(made.frames) == 1)
    assert sweep.worker.sweep(sweep._wanted).modes == (3,) == viewer.binding.choices.modes
    set_by_client(sweep.order, DOWN)
    assert viewer.binding.choices.modes == (3,)


def test_no_sweep_is_computed_before_someone_asks(opened):
    """The first map is the one that a browser waits for; a sweep takes the processor for seconds."""
    viewer, turn_until = opened
    turn_until(lambda: map_on_page(viewer) is not None)
    viewer.run.session.step()
    turn_until(lambda: viewer.snapshot.view.index == 1)
    sweep = viewer.tabs.sweep
    assert sweep.worker.worker.latest is None and not sweep.worker.worker.busy and not sweep._plot.visible


def test_the_slider_shows_how_many_modes_the_map_has(opened):
    """Also where nobody has chosen any: then they are the solver's."""
    viewer, turn_until = opened
    sweep, state = viewer.tabs.sweep, viewer.binding.session.view.state
    assert viewer.binding.choices.modes is None and state.first == 1 and state.last < viewer.binding.modes
    turn_until(lambda: sweep.summed.value == state.last)
    set_by_client(sweep.play, True)
    turn_until(lambda: viewer.binding.choices.modes == (1,))  # and Play begins with the first one
    set_by_client(sweep.play, True)


def test_another_state_makes_the_counts_invalid(opened):
    viewer, turn_until = opened
    sweep = viewer.tabs.sweep
    set_by_client(sweep.summed, 3)
    turn_until(lambda: "sum of 3 modes" in sweep.text.content)
    viewer.run.session.step()
    turn_until(lambda: "Play adds" in sweep.text.content and not sweep._plot.visible)
    set_by_client(sweep.summed, 3)
    turn_until(lambda: "sum of 3 modes" in sweep.text.content and sweep._plot.visible)


def test_a_sweep_of_another_state_stops(opened, monkeypatch):
    viewer, turn_until = opened
    sweep, slow = viewer.tabs.sweep, SweepWorker._frame
    monkeypatch.setattr(SweepWorker, "_frame", lambda *args: (time.sleep(0.2), slow(*args))[1])
    set_by_client(sweep.highest, 19)
    turn_until(lambda: (made := sweep.worker.sweep(sweep._wanted)) is not None and len(made.frames) >= 2)
    made = sweep.worker.sweep(sweep._wanted)
    viewer.run.session.step()
    turn_until(lambda: sweep._wanted is None and not sweep.worker.worker.busy)
    assert len(made.frames) < 19
