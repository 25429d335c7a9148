"""Controls without a browser: their commands, and which of them are shown."""

import contextlib
import dataclasses
from types import SimpleNamespace

import pytest
from doubles import INVALID_VALUES, State, set_by_client, view_of

from fdcal.graphics.picture import static_picture
from fdcal.model.validation import InputError
from fdcal.viewer.background.cost_maps import CostMapRequest, MapStyle, map_modes
from fdcal.viewer.gui.binding import FLOOR, NOTHING, RELIEF, Binding, Tick, kind_of
from fdcal.viewer.tabs import map


def test_controls_without_effect_are_hidden(controls):
    panel, session = controls
    map_ = panel.map
    map_.choose_modes([1, 2])
    assert map_.which.visible and map_.upto.visible and map_.scale.visible
    set_by_client(map_.kind, NOTHING)
    assert not any(handle.visible for handle in (map_.which, map_.upto, map_.text, map_.scale))
    picture = static_picture(None, panel.binding.measurement)
    panel.view.show(Tick(session.view, picture=picture))
    assert not panel.view.ellipses_text.visible and not panel.view.scale.visible
    set_by_client(panel.view.ellipses, True)
    panel.view.show(Tick(session.view, picture=picture))
    assert panel.view.ellipses_text.visible and "appear when" in panel.view.ellipses_text.content, "they come later"
    assert panel.view.scale.visible
    session.view = dataclasses.replace(session.view, state=dataclasses.replace(session.view.state, finished=True))
    panel.view.show(Tick(session.view, picture=picture))
    assert not panel.view.ellipses_text.visible


def test_the_view_from_the_side_raises_a_flat_map_and_that_from_above_lays_it_down(controls):
    panel, _ = controls
    seen = []
    for view, chosen in (("close", None), ("top", None), ("top", RELIEF), ("close", NOTHING), ("3d", FLOOR)):
        if chosen is not None:
            panel.map.show_as(chosen)
        panel.look(None, view)
        seen.append(kind_of(panel.binding.choices))
        assert panel.map.kind.value == seen[-1]
    assert seen == [RELIEF, FLOOR, RELIEF, NOTHING, FLOOR], "what a user chooses stays"


def test_without_a_search_domain_there_is_no_map_and_no_control_of_one(server, work):
    unbounded = dataclasses.replace(work, problem=dataclasses.replace(work.problem, search=None))
    map_ = map.MapTab(Binding(server.gui, unbounded, 6))
    assert not any(handle.visible for handle in (map_.kind, map_.which, map_.upto, map_.scale))
    map_.show(Tick(work.session.view, microphone=3))
    assert "search domain" in map_.caption.content
    server.gui.reset()


def test_the_mode_sliders_never_cross(controls):
    panel, session = controls
    set_by_client(panel.solver.first, 5)
    set_by_client(panel.solver.first, 1)
    set_by_client(panel.solver.last, 2)
    assert session.commands == [("use_modes", 5, 5, True), ("use_modes", 1, 3, True), ("use_modes", 1, 2, True)]


def test_values_set_by_the_program_are_not_commands(controls):
    panel, session = controls
    set_by_client(panel.solver.last, 5, client=False)
    panel.show(Tick(view_of([State(session.view.state.positions, last=6)]), microphone=4))
    assert panel.solver.last.value == 6 and panel.map.microphone.value == 4
    assert session.commands == [] and panel.binding.choices.microphone == 3


def test_too_few_modes_are_refused_at_the_slider_which_goes_back(controls):
    panel, session = controls
    panel.solver.show(Tick(session.view))
    set_by_client(panel.solver.last, 2)
    refused = InputError("2 modes are too few", "use at least 3 modes (<modes>)")
    panel.solver.show(Tick(dataclasses.replace(session.view, refused=refused)))
    assert "2 modes are too few; use at least 3" in panel.solver.refusal.content and panel.solver.last.value == 3
    panel.solver.show(Tick(session.view))
    assert panel.solver.refusal.content == ""


@pytest.mark.parametrize("closed", [True, False])
def test_a_control_pressed_as_its_session_is_replaced_does_nothing(server, work, closed):
    binding = Binding(server.gui, work, 6)
    other = server.gui.add_slider("other", 0, 9, 1, 1)
    control = binding.on(server.gui.add_slider("one", 0, 9, 1, 1), lambda value: setattr(other, "max", value))
    other.remove()
    binding.closed = closed
    with contextlib.nullcontext() if closed else pytest.raises(RuntimeError, match="removed"):
        set_by_client(control, 5)
    server.gui.reset()


def test_one_button_runs_and_pauses(controls):
    panel, session = controls
    set_by_client(panel.run_bar.run, True)
    session.view = dataclasses.replace(session.view, running=True)
    panel.show(Tick(session.view, microphone=3))
    assert panel.run_bar.run.label == "Pause"
    set_by_client(panel.run_bar.run, True)
    assert session.commands == [("play",), ("pause",)]


def test_choosing_a_microphone_stops_following_the_solver(controls):
    panel, _ = controls
    assert panel.binding.choices.follow
    set_by_client(panel.map.microphone, 7)
    assert panel.binding.choices.microphone == 7 and not panel.binding.choices.follow and not panel.map.follow.value


def test_callbacks_do_not_change_what_the_main_loop_has_sent(controls):
    panel, session = controls
    panel.show(Tick(session.view, microphone=3))
    before = dict(panel.binding.sent)
    set_by_client(panel.map.microphone, 7)
    set_by_client(panel.map.follow, True)
    assert panel.binding.sent == before and panel.binding.choices.microphone == 7
    panel.show(Tick(session.view, microphone=5))
    assert panel.map.microphone.value == 5


def test_only_a_picture_has_a_size_and_a_view(controls):
    panel, _ = controls
    assert panel.export.size.visible and panel.export.view.visible
    set_by_client(panel.export.kind, "Replay (HTML)")
    assert (
        panel.binding.choices.export_kind == "Replay (HTML)" and "without a server" in panel.export.description.content
    )
    assert not panel.export.size.visible and not panel.export.view.visible
    for value in INVALID_VALUES:
        set_by_client(panel.export.kind, value)
        assert panel.binding.choices.export_kind == "Replay (HTML)"


def test_mode_numbers_that_cannot_be_read_change_nothing_but_the_error(controls):
    panel, _ = controls
    set_by_client(panel.map.text, "3, 1")
    assert panel.binding.choices.modes == (1, 3)
    set_by_client(panel.map.text, "1-99")
    assert panel.binding.choices.modes == (1, 3) and "1 to 6" in panel.binding.choices.modes_error


def test_a_run_that_is_watched_begins_slowly_and_speeds_up_unless_a_speed_is_chosen(controls):
    panel, session = controls
    panel.run_bar.apply_rate()
    session.view = dataclasses.replace(session.view, running=True)
    for now in (10.0, 10.1, 13.0, 20.0):
        panel.run_bar.show(Tick(session.view, now))
    rates = [rate for name, rate in session.commands if name == "pace"]
    assert rates[0] == 5 and rates == sorted(rates) and len(rates) == 3 and rates[-1] > 500
    set_by_client(panel.run_bar.speed, 12)
    panel.run_bar.show(Tick(session.view, 30.0))
    assert session.commands[-1] == ("pace", 12) and panel.run_bar.speed.value == 12
    session.view = dataclasses.replace(session.view, running=False)
    panel.binding.choose(rate=None)
    panel.run_bar.show(Tick(session.view, 31.0))
    panel.run_bar.apply_rate()
    assert session.commands[-1] == ("pace", 5), "the next run begins slowly again"


def test_a_map_of_fewer_modes_than_the_solver_uses_says_so(work):
    state = State(work.measurement.positions, last=6)
    modes, offset = next(
        (modes, offset) for offset in range(8) if len(modes := map_modes(work, state, None, offset)) < state.last
    )
    drawn = SimpleNamespace(request=CostMapRequest(0, 0, modes, offset, False, MapStyle(), False, state, None))
    assert f"{len(modes)} of the 6 modes that the solver uses" in map.orders_text(work, drawn)
    drawn.request = dataclasses.replace(drawn.request, modes=(1, 2), custom_modes=True)
    assert "that the solver uses" not in map.orders_text(work, drawn)


@pytest.mark.parametrize(("seconds", "first"), [(0.001, 5.0), (0.02, 25.0)])
def test_a_run_is_followed_from_its_beginning_and_one_of_slow_steps_is_not_held_back(controls, seconds, first):
    panel, session = controls
    session.step_time = seconds
    panel.run_bar.apply_rate()
    paces = []
    for now in (10.0, 11.2, 13.6):
        panel.run_bar.show(Tick(dataclasses.replace(session.view, running=True), now))
        paces.append([command[1] for command in session.commands if command[0] == "pace"][-1])
    assert paces == pytest.approx([first, 2 * first, 8 * first])
    panel.run_bar.limit_rate(7)
    panel.run_bar.show(Tick(dataclasses.replace(session.view, running=True), 20.0))
    assert session.commands[-1] == ("pace", 7), "a speed that somebody has chosen stays"
