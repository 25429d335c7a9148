"""Maps belong to the state on the screen: those on the floor, and those of a sweep of modes."""

import dataclasses
import time

import numpy as np
from browsing import WAIT
from doubles import State, set_by_client, view_of

from fdcal.cost.basins import basins_of
from fdcal.cost.maps import cost_maps, eq7_maps, refined
from fdcal.graphics.primitives import DIVERGING_COLOUR_MAP
from fdcal.viewer.cost_maps import map_modes
from fdcal.viewer.session_view import RUN_INTERVAL
from fdcal.viewer.tabs import map as sweeping
from fdcal.viewer.tabs.map import LABELS


def mapped(viewer):
    """Compute one map; return the microphone whose map is shown then, None without a map."""
    viewer.run.solver.gate.release()
    assert viewer.maps.worker.wait_for(lambda _: not viewer.maps.worker.busy, WAIT)
    viewer.tick(1e9)
    return shown(viewer)


def shown(viewer):
    """Return the microphone whose map is shown, from the diamond on the map."""
    picture, search = viewer.snapshot.picture, viewer.run.measurement.search
    marked = [solid.vertices[:, 0].mean() for solid in picture.meshes if solid.name == "lowest"]
    assert bool(marked) == (picture.floor is not None and viewer.binding.choices.minima)
    return round((marked[0] - search.origin[0]) / search.step) if marked else None


def legend(viewer):
    return viewer._page.panels.overlay._regions["legend"].content


def test_a_map_stands_under_its_own_microphone_only_and_the_legend_says_that_it_is_computed(viewer):
    viewer.tick(0.0)
    assert shown(viewer) is None and "Computing the map of microphone 3" in legend(viewer)
    assert mapped(viewer) == 3 and "Computing" not in legend(viewer)
    set_by_client(viewer.tabs.map.microphone, 7)
    viewer.tick(0.0)
    assert shown(viewer) is None, "the map of microphone 3 stands under microphone 7"
    assert mapped(viewer) == 7
    viewer.tabs.map.choose_modes([2])
    viewer.tick(0.0)
    assert shown(viewer) is None and mapped(viewer) == 7
    viewer.binding.choose(minima=False)
    viewer.tick(0.0)
    assert mapped(viewer) is None and viewer.snapshot.picture.floor is not None, "a lesson may hide the diamond"


def step_to(viewer, *states, **changes):
    """Let the session show the last of some states of its run."""
    session, changes = viewer.run.session, {"index": len(states) - 1, "history": states, **changes}
    session.view = dataclasses.replace(session.view, state=states[-1], **changes)


def test_a_running_solver_draws_the_costs_it_has_in_another_scale(viewer):
    """The gate, through which all new costs must pass, stays closed."""
    viewer.tick(0.0)
    assert mapped(viewer) == 3
    step_to(viewer, viewer.view.state, State(viewer.run.measurement.positions + 0.01, 1), running=True)
    set_by_client(viewer.tabs.map.scale, "Linear")
    ready = viewer.maps.worker.latest.ended
    viewer.tick(ready)
    assert viewer.maps.worker.wait_for(lambda latest: not latest.request[0].style.log, WAIT)
    viewer.tick(ready)
    assert shown(viewer) == 3 and "(dB)" not in viewer.snapshot.picture.floor.bar.label


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
    viewer.run.session.view = view_of([State(positions + 0.02)], running=True)
    viewer.tick(0.0)
    assert shown(viewer) is None, "the map of the run before the reset"


def test_while_running_a_step_may_wait_and_what_a_user_has_changed_is_shown_at_once(viewer):
    session, state, positions = viewer.run.session, viewer.view.state, viewer.run.measurement.positions
    step_to(viewer, state, running=True)
    viewer.tick(1.0)
    step_to(viewer, state, State(positions + 0.01, 1))
    viewer.tick(1.0 + 0.3 * RUN_INTERVAL)
    assert viewer.view.state is state
    session.view = view_of([state, State(positions + 0.02, 1)], running=True)
    viewer.tick(1.0 + 0.6 * RUN_INTERVAL)
    assert viewer.view is session.view


def test_the_legend_names_what_is_drawn(opened):
    viewer, turn_until = opened
    turn_until(lambda: "misfit (dB re the highest), frequencies" in legend(viewer))
    drawn = viewer.snapshot.drawn
    assert drawn.floor.bar.low < drawn.floor.bar.high <= 0.0
    assert drawn.text_of(drawn.base + drawn.highest) == "0.0 dB", "numbers in the caption are those of the scale"
    viewer.run.session.step()
    turn_until(lambda: viewer.snapshot.view.index == 1)
    assert "trail" not in legend(viewer)
    set_by_client(viewer.tabs.view.trails, True)
    turn_until(lambda: "trail" in legend(viewer))
    viewer.tabs.map.choose_modes(range(1, 6))
    viewer.tabs.map.show_as("shape")  # the field of the last mode replaces the map
    turn_until(lambda: (floor := viewer.snapshot.picture.floor) is not None and "of frequency 5" in floor.bar.label)
    assert viewer.snapshot.picture.floor.bar.colour_map == DIVERGING_COLOUR_MAP
    turn_until(lambda: "highest in the map: frequency 5" in viewer.tabs.spectrum.text.content)
    set_by_client(viewer.tabs.map.kind, LABELS["none"])
    turn_until(lambda: "pressure" not in legend(viewer))


def test_an_exception_on_the_page_is_shown_and_the_page_continues(viewer, monkeypatch, caplog):
    monkeypatch.setattr(viewer._page.nodes, "show", lambda picture: 1 / 0)
    for now in (1.0, 1.1, 1.2):
        viewer.guarded_tick(now)
    assert len(caplog.records) == 1 and "ZeroDivisionError" in viewer.tabs.run_bar.status.content
    monkeypatch.undo()
    for now in (2.0, 20.0, 20.1):
        viewer.guarded_tick(now)
    assert "ZeroDivisionError" not in viewer.tabs.run_bar.status.content


def test_a_map_of_the_modes_in_use_has_those_that_the_microphones_can_carry(work):
    every, state = len(work.problem.frequencies), State(work.measurement.positions, last=6)
    problem = dataclasses.replace(work.problem, wavenumbers=5.0 * np.arange(1, every + 1) + 0j)
    high = dataclasses.replace(work, problem=problem)
    modes = map_modes(high, state, None, 2)
    assert 0 < len(modes) < every and modes == tuple(range(1, len(modes) + 1))
    assert eq7_maps(high.problem, state.positions, 4, modes, 2).shape[0] == len(modes)
    assert map_modes(high, state, None, None) == tuple(range(1, 7)), "the solver's own cost has no such limit"
    assert map_modes(high, state, (6,), 2) == (6,), "what the user has chosen is not replaced"


def test_nothing_is_computed_before_someone_asks_and_the_slider_shows_how_many_modes_the_map_has(opened):
    """A browser waits for the first map, and a sweep would use the processor for seconds."""
    viewer, turn_until = opened
    turn_until(lambda: viewer.snapshot.picture.floor is not None)
    viewer.run.session.step()
    turn_until(lambda: viewer.snapshot.view.index == 1)
    sweep, state = viewer.tabs.sweep, viewer.binding.session.view.state
    assert sweep.worker.latest is None and not sweep.worker.busy and not sweep._plot.folder.visible
    assert viewer.binding.choices.modes is None and state.first == 1 and state.last < viewer.binding.modes
    # The page shows the solver's modes until the user chooses others.
    turn_until(lambda: sweep.summed.value == state.last)
    set_by_client(sweep.play, True)
    turn_until(lambda: viewer.binding.choices.modes == (1,))  # Play begins with the first mode
    turn_until(lambda: sweep.play.label == "Stop")
    set_by_client(sweep.play, True)
    turn_until(lambda: sweep.play.label == "Add frequencies one by one" and len(viewer.binding.choices.modes) < 9)


def test_another_state_stops_the_sweep_and_makes_its_counts_invalid(opened, monkeypatch):
    viewer, turn_until = opened
    sweep, quick = viewer.tabs.sweep, sweeping.cost_map
    monkeypatch.setattr(sweeping, "cost_map", lambda *args: (time.sleep(0.2), quick(*args))[1])
    for _ in range(2):  # the first press plays, the second one pauses; the maps are made
        set_by_client(sweep.play, True)
    set_by_client(sweep.summed, 3)
    turn_until(lambda: "sum of 3 frequencies" in viewer.tabs.map.caption.content and sweep._plot.folder.visible)
    turn_until(lambda: np.flatnonzero(sweep._plot.data[2] > 0).tolist() == [2])  # the point of this sum
    set_by_client(sweep.order, "Highest first")
    set_by_client(sweep.highest, 19)
    turn_until(lambda: sweep.made is not None and 2 <= len(sweep.made.frames) < 19)
    made = sweep.made
    viewer.run.session.step()
    turn_until(lambda: sweep._wanted is None and not sweep.worker.busy)
    assert len(made.frames) < 19
    turn_until(lambda: "fits all frequencies" in sweep.text.content and not sweep._plot.folder.visible)


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
    assert list(dict.fromkeys(modes for modes in seen if modes)) == [tuple(range(1, m + 1)) for m in range(2, 7)]
    made = sweep.made
    for kind in ("flat", "relief"):  # the maps of the sweep are flat
        style = dataclasses.replace(made.request.style, kind=kind)
        found, _ = sweep.map_for(dataclasses.replace(made.request, modes=(1, 2, 3), style=style), None, "")
        assert (found is None) == (kind == "relief")
    run, search = viewer.run, refined(viewer.run.problem.search)
    for m, count in enumerate([frame.minima.count for frame in made.frames], start=1):
        modes, state = range(1, m + 1), binding.session.view.state
        n, offset = viewer.snapshot.microphone, binding.choices.map_order
        maps = cost_maps(run.problem, run.solver, state, n, modes, offset, search)
        assert count == len(basins_of(maps.sum(axis=0)).minima), m
    turn_until(lambda: "sum of 6 frequencies" in viewer.tabs.map.caption.content)
    assert len(sweep._plot.data[0]) == 6
