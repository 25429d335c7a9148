"""The map on the floor belongs to what is looked at."""

import dataclasses

import numpy as np
from browsing import WAIT
from doubles import State, set_by_client, view_of

from fdcal.cost.maps import eq7_maps
from fdcal.session.session import History
from fdcal.viewer.background import cost_maps
from fdcal.viewer.gui.binding import Binding
from fdcal.viewer.tabs import map


def mapped(viewer):
    """Let one map be made; the microphone whose map is shown then, None without a map."""
    viewer.run.solver.gate.release()
    assert viewer.maps.worker.wait_for(lambda _: not viewer.maps.worker.busy, WAIT)
    viewer.tick(1e9)
    return shown(viewer)


def shown(viewer):
    floor, search = viewer.snapshot.picture.floor, viewer.run.measurement.search
    return None if floor is None else round((floor.lowest[0][0] - search.origin[0]) / search.step)


def test_a_map_stands_under_its_own_microphone_only(viewer):
    viewer.tick(0.0)
    assert shown(viewer) is None and mapped(viewer) == 3
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

    def drawn():
        return side.wait_for(lambda _: not side.busy, WAIT)

    viewer.tick(0.0)
    assert side.latest is None and mapped(viewer) == 3 and drawn()
    viewer.tick(2e9)
    first = viewer.tabs.maps.image
    assert first.visible and first.image.ndim == 3
    light = first.image
    set_by_client(viewer.tabs.view.dark, True)
    viewer.tick(3e9)
    mapped(viewer)
    viewer.tick(4e9)
    assert drawn()
    viewer.tick(5e9)
    assert viewer.tabs.maps.image.image is not light and viewer.tabs.maps.image.image.shape == light.shape


def test_opacity_takes_no_new_map(viewer):
    """It is on the screen with the next turn, while a solver runs or not."""
    viewer.tick(0.0)
    assert mapped(viewer) == 3
    before = viewer.picture.floor
    viewer.binding.choose_style(opacity=0.4)
    viewer.tick(1.0)
    assert viewer.picture.floor.opacity == 0.4 and viewer.picture.floor.rgb is before.rgb
    assert not viewer.maps.busy


def test_a_running_solver_draws_the_costs_it_has_in_another_scale(viewer):
    """The gate, which every map of costs has to pass, stays shut."""
    viewer.tick(0.0)
    assert mapped(viewer) == 3
    session, positions = viewer.run.session, viewer.run.measurement.positions
    states = [session.view.state, State(positions + 0.01, 1)]
    history = History(states, 2, session.view.history.lineage)
    session.view = dataclasses.replace(session.view, state=states[1], index=1, count=2, history=history, running=True)
    set_by_client(viewer.tabs.map.scale, "Linear")
    ready = viewer.maps.worker.latest.ended
    viewer.tick(ready)
    assert viewer.maps.worker.wait_for(lambda latest: not latest.request[0].style.log, WAIT)
    viewer.tick(ready)
    assert shown(viewer) == 3 and not viewer.picture.floor.bar.log


def test_a_drag_delays_the_solver_and_speeds_up_the_page(server, work):
    rung = []
    binding = Binding(server.gui, work, 6, wake=lambda: rung.append(True))
    tab = map.MapTab(binding)
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
    session, positions = viewer.run.session, viewer.run.measurement.positions
    states = [session.view.state]
    session.view = dataclasses.replace(session.view, history=History(states, 1), running=True)
    viewer.tick(0.0)
    assert shown(viewer) == 3, "the very same state"
    states[0] = dataclasses.replace(states[0])
    session.view = dataclasses.replace(session.view, state=states[0], history=History(states, 1))
    viewer.tick(1e9)
    mapped(viewer)
    states.append(State(positions + 0.01, 1))
    session.view = dataclasses.replace(session.view, state=states[1], index=1, count=2, history=History(states, 2))
    viewer.tick(0.0)
    assert shown(viewer) == 3, "an older state of the same run"
    session.view = view_of([State(positions + 0.02)])
    viewer.tick(0.0)
    assert shown(viewer) is None, "the map of the run before the reset"


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
    modes = cost_maps.map_modes(high, state, None, 2)
    assert 0 < len(modes) < every and modes == tuple(range(1, len(modes) + 1))
    assert eq7_maps(high.problem, state.positions, 4, modes, 2).shape[0] == len(modes)
    assert cost_maps.map_modes(high, state, None, None) == tuple(range(1, 7)), "the solver's own cost has no such limit"
    assert cost_maps.map_modes(high, state, (6,), 2) == (6,), "what the user has chosen is not replaced"
