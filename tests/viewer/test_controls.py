"""Controls and keys without a browser: their commands, which of them are shown, and the parameters of a scene."""

import dataclasses
import typing
from types import SimpleNamespace

import pytest
from doubles import State, finish, set_by_client, view_of
from viser import _messages

from fdcal import solvers
from fdcal.assessment.words import state_word
from fdcal.model.scene import load_scene, placeholder_scene
from fdcal.model.validation import InputError
from fdcal.session.scene_edits import edited, parameters_of
from fdcal.session.sources import OpenRequest, scene_request
from fdcal.viewer import html
from fdcal.viewer.cost_maps import MapStyle, map_label
from fdcal.viewer.explore import NEEDED, NEW_RUN
from fdcal.viewer.panels import KEYS, Panels, Tabs, add_keys, help_html
from fdcal.viewer.state import Binding, PageState
from fdcal.viewer.tabs import map
from fdcal.viewer.tabs import scene as scenetab
from fdcal.viewer.tabs.map import EQ7, LABELS


def test_controls_without_effect_are_hidden(controls):
    panel, _ = controls
    map_, export = panel.map, panel.export
    map_.choose_modes([1, 2])
    handles = (map_.text, map_.scale)
    assert all(handle.visible for handle in handles)
    set_by_client(map_.kind, LABELS["none"])
    assert not any(handle.visible for handle in handles)
    assert export.size.visible and export.view.visible
    set_by_client(export.kind, "Replay (HTML)")
    assert not export.size.visible and not export.view.visible, "only a picture has a size and a view"
    assert panel.binding.choices.export_kind == "Replay (HTML)" and "without a server" in export.description.content


def test_without_a_search_domain_there_is_no_map_and_no_control_of_one(server, work):
    unbounded = dataclasses.replace(work, problem=dataclasses.replace(work.problem, search=None))
    map_ = map.MapTab(Binding(server.gui, unbounded, 6))
    assert not any(handle.visible for handle in (map_.kind, map_.text, map_.scale))
    map_.show(PageState(work.session.view, microphone=3))
    assert "search domain" in map_.caption.content
    server.gui.reset()


def test_values_set_by_the_program_are_no_commands_and_the_mode_sliders_never_cross(controls):
    panel, session = controls
    set_by_client(panel.solver.last, 5, client=False)
    panel.show(PageState(view_of([State(session.view.state.positions, last=6)]), microphone=4))
    assert panel.solver.last.value == 6 and panel.map.microphone.value == 4
    assert session.commands == [] and panel.binding.choices.microphone == 3
    panel.solver.show(PageState(session.view))
    for slider, value in ((panel.solver.first, 5), (panel.solver.first, 1), (panel.solver.last, 2)):
        set_by_client(slider, value)
    assert session.commands == [("use_modes", 5, 5, True), ("use_modes", 1, 3, True), ("use_modes", 1, 2, True)]
    refused = InputError("2 modes are too few", "use at least 3 modes (<modes>)")
    panel.solver.show(PageState(dataclasses.replace(session.view, refused=refused)))
    assert "2 modes are too few; use at least 3" in panel.solver.refusal.content and panel.solver.last.value == 3
    panel.solver.show(PageState(session.view))
    assert panel.solver.refusal.content == "", "the slider has gone back"


def test_choosing_a_microphone_stops_following_the_solver_until_following_is_switched_on(controls):
    panel, session = controls
    assert panel.binding.choices.follow
    set_by_client(panel.map.microphone, 7)
    assert panel.binding.choices.microphone == 7 and not panel.binding.choices.follow and not panel.map.follow.value
    set_by_client(panel.map.follow, True)
    panel.show(PageState(session.view, microphone=5))
    assert panel.map.microphone.value == 5


def test_mode_numbers_that_cannot_be_read_change_nothing_but_the_error(controls):
    panel, _ = controls
    set_by_client(panel.map.text, "3, 1")
    assert panel.binding.choices.modes == (1, 3)
    set_by_client(panel.map.text, "1-99")
    assert panel.binding.choices.modes == (1, 3) and "1 to 6" in panel.binding.choices.modes_error


def test_a_run_that_is_watched_begins_slowly_and_speeds_up_unless_a_speed_is_chosen(controls):
    panel, session = controls

    def pace(now, running=True):
        panel.run_bar.show(PageState(dataclasses.replace(session.view, running=running), now))
        return [command[1] for command in session.commands if command[0] == "pace"][-1]

    panel.run_bar.refresh()
    assert [pace(now) for now in (10.0, 11.2, 13.6)] == pytest.approx([5, 10, 40])
    set_by_client(panel.run_bar.speed, 12)
    assert pace(30.0) == 12 and panel.run_bar.speed.value == 12
    panel.binding.choose(rate=None)
    pace(31.0, running=False)
    session.step_time = 0.02
    panel.run_bar.refresh()
    assert [pace(now) for now in (40.0, 41.2)] == pytest.approx([25, 50]), "slow steps begin at a higher speed"


CAMERA_KEYS = (*"WASDQE", "arrowup", "arrowdown", "arrowleft", "arrowright")  # viser uses these keys


def test_no_key_moves_the_camera_and_help_lists_each_and_every_mark():
    keys, html = {name.rpartition("+")[2] for name in KEYS}, help_html()
    assert not keys & set(CAMERA_KEYS) and keys <= set(typing.get_args(_messages.HotkeyKey))
    for name, (label, _) in KEYS.items():
        assert f"<th>{name}</th>" in html and label in html
    for word in ("true", "estimate", "known", "lowest point", "other minimum", "(mm)", "(Hz)", "fdcal"):
        assert word in html


def test_a_key_does_what_its_button_does(tiny_page):
    """It sends the command of the button, and shows the next or the previous value of a list or a slider."""
    page, _ = tiny_page
    binding, overlay, client, pressed = page.viewer.binding, page.panels.overlay, object(), {}

    def add_command(label, hotkey, modifier):
        name = f"{modifier.capitalize()}+{hotkey}" if modifier else hotkey
        return SimpleNamespace(on_trigger=lambda act: pressed.__setitem__(name, act))

    add_keys(SimpleNamespace(add_command=add_command), overlay)
    press = lambda key: finish(pressed[key](SimpleNamespace(client=client)))  # noqa: E731
    commands = {command.partition("=")[0] for _, command in KEYS.values()}
    assert pressed.keys() == KEYS.keys() and commands <= {*binding.commands, *overlay.acts}
    tabs, last = page.viewer.tabs, binding.measurement.count - 1
    tabs.map.pick(last - 1)
    for key, shown in (("M", last), ("M", last), ("Shift+M", last - 1)):
        press(key)
        assert binding.choices.microphone == tabs.map.microphone.value == shown
    for key, modes in (("I", 19), ("I", 18), ("O", 19), ("U", None)):
        press(key)
        assert binding.choices.modes == (modes and tuple(range(1, modes + 1)))
    for kind in (*tabs.map.kinds[1:], tabs.map.kinds[0]):
        press("V")
        assert binding.choices.kind == kind
    for key, name in (("L", "log"), ("Y", "trails"), ("K", "dark")):
        before = getattr(binding.choices, name)
        press(key)
        assert getattr(binding.choices, name) is not before
    page.viewer = None  # the page has no session yet
    for key in KEYS:
        press(key)


def test_apply_opens_the_scene_with_the_chosen_parameters(controls, scene):
    panel, session = controls
    tab = panel.scene
    set_by_client(tab.apply, True)
    for control, value in (
        (tab.noise, True), (tab.snr, 25), (tab.walls, "absorbing"), (tab.absorption, 10.0), (tab.known, 5),
        (tab.apply, True),
    ):  # fmt: skip
        set_by_client(control, value)
        assert control.visible
    same, changed = (opening.scene for opening in session.opened)
    assert same is scene, "a value that the user has not changed stays exactly as it was"
    parameters = parameters_of(changed)
    assert (parameters.snr_db, parameters.walls, parameters.known) == (25, "absorbing", 5)
    assert parameters.absorption == pytest.approx(0.1) and changed.room.size == scene.room.size


def controls_of_scene(server, work, name):
    """The tab Scene of a scene, and the requests that it opens."""
    opened = []
    binding = Binding(server.gui, dataclasses.replace(work, scene=load_scene(name)), 6, opened.append)
    try:
        return Tabs(Panels(server.gui), binding, lambda *_: None).scene, opened
    finally:
        binding.threads.close(0.0)


def test_a_measured_array_or_room_has_less_to_edit_and_says_what_is_measured(server, work):
    array, opened = controls_of_scene(server, work, "frl_array")
    edited = ("microphones", "radius", "walls", "absorption", "noise", "snr", "speed", "known", "seed", "apply")
    assert not any(hasattr(array, name) for name in edited)
    for words in ("nominal positions", "CC BY 4.0", "cannot be edited"):
        assert words in array.message.content
    set_by_client(array.name, "tiny")
    set_by_client(array.name, "frl_array")  # the list shows this array
    assert [opening.scene.name for opening in opened] == ["tiny"] and array.name.value == "frl_array"
    room, opened = controls_of_scene(server, work, "listening_lab")
    assert not room.walls.visible and not room.absorption.visible and room.microphones.visible
    assert "response is measured" in room.message.content and "is modelled" in room.message.content
    set_by_client(room.snr, 30)
    set_by_client(room.walls, "rigid")  # a client can set a hidden control
    set_by_client(room.apply, True)
    (changed,) = opened
    assert changed.scene.room == load_scene("listening_lab").room and changed.scene.measurement.snr_db == 30
    server.gui.reset()


def test_an_impossible_scene_is_refused_in_one_line_that_names_controls_of_the_page(controls):
    panel, session = controls
    for radius in (350.0, 0.0):
        set_by_client(panel.scene.radius, radius)
        assert f"{radius:g} m is not possible; use 0.05 to 3 m" in panel.scene.message.content
        assert panel.scene.radius.value == radius, "no other number takes its place"
        set_by_client(panel.scene.apply, True)
    set_by_client(panel.scene.radius, 2.5)  # this radius is larger than the room
    assert panel.scene.message.content == ""
    set_by_client(panel.scene.apply, True)
    message = panel.scene.message.content
    assert session.opened == [] and "outside the room" in message
    assert "Array radius (m)" in message and "array." not in message
    set_by_client(panel.scene.name, "array2_random")
    assert [opening.scene.array for opening in session.opened] == [load_scene("array2_random").array]


def test_restart_opens_another_solver_and_resets_the_same_one(controls):
    panel, session = controls
    set_by_client(panel.run_bar.steps, "Restart")
    set_by_client(panel.solver.name, "descent")
    assert panel.solver.start.value == "random" and panel.solver.seed.visible
    set_by_client(panel.solver.seed, 5)
    set_by_client(panel.run_bar.steps, "Restart")
    assert session.commands == [("reset", 0)]
    at_once, opening = session.opened
    assert (at_once.scene.solver.name, at_once.seed) == ("descent", 0)
    assert (opening.scene.solver.name, opening.scene.solver.start, opening.seed) == ("descent", "random", 5)
    assert opening.measurement is panel.binding.measurement


def test_a_step_that_searches_the_map_uses_the_modes_that_are_shown(controls):
    panel, session = controls
    for method, modes, used in (("descent", (4, 5, 6), [("use_modes", 4, 6, True)]), ("descent", (1, 3), []),
                                ("joint", (4, 5, 6), [])):  # fmt: skip
        panel.binding.run.solver.TRAITS = solvers.load(method).TRAITS
        panel.map.choose_modes(modes)
        panel.binding.choose(objective=False)
        session.commands.clear()
        set_by_client(panel.run_bar.steps, "Step")
        assert session.commands == [*used, ("step", 1, "step")]
        assert panel.binding.choices.modes is None and panel.binding.choices.objective
    panel.binding.run.solver.TRAITS = solvers.load("descent").TRAITS
    set_by_client(panel.sweep.summed, 2)
    assert session.commands[-1] == ("pause",), "a run would minimise another map than the one that is shown"


def test_a_seed_without_effect_is_hidden(controls):
    solver = controls[0].solver
    assert not solver.seed.visible and not solver.start.visible, "robust has starts of its own"
    steps = [
        (solver.name, "joint", (False, True)),  # this solver begins at its affine start
        (solver.start, "random", (True, True)),
        (solver.name, "robust", (False, False)),
        (solver.name, "descent", (True, True)),
    ]
    for control, value, seen in steps:
        set_by_client(control, value)
        assert (solver.seed.visible, solver.start.visible) == seen, value


def test_a_measurement_has_no_simulation_settings(server, work):
    opened = []

    def tab_of(name):
        run = dataclasses.replace(work, scene=placeholder_scene(work.measurement, name, work.scene.solver))
        return scenetab.SceneTab(Binding(server.gui, run, 6, opened.append))

    tab = tab_of("hall")
    assert not hasattr(tab, "radius") and not hasattr(tab, "apply") and "a measurement" in tab.message.content
    set_by_client(tab.name, "hall")
    assert opened == []
    namesake = tab_of("tiny")
    assert namesake.name.value == "tiny (measured)"
    set_by_client(namesake.name, "tiny")
    assert [one.scene.array for one in opened] == [load_scene("tiny").array], "the scene of that name is there, too"
    server.gui.reset()


def test_what_was_opened_from_a_file_stays_among_the_scenes(page_of, scene, measurement):
    page, turn_until = page_of
    overlay, own = page.panels.overlay, placeholder_scene(measurement, "tiny", scene.solver, 0)
    for request in (OpenRequest(own, measurement=measurement, fewer_modes=True), OpenRequest(scene)):
        page.open(request)
        turn_until(lambda request=request: page.viewer and page.viewer.run.scene.name == request.scene.name)
    sheet = overlay._regions["sheet"]
    turn_until(lambda: "data-do='opened' aria-pressed='false'" in sheet.content)
    assert sheet.content.count("data-do='opened'") == 1 and "scene=tiny" in sheet.content
    assert "recording" not in sheet.content and page.own_files is None, "only a page of this machine offers it"
    overlay.receive(None, "stamp opened")
    turn_until(lambda: page.viewer.run.measurement is measurement)
    turn_until(lambda: "data-do='opened' aria-pressed='true'" in sheet.content)


def test_scenes_of_the_paper_open_with_descent_at_a_random_start_and_others_with_their_own_solver():
    for name, method in (("array1_circle", "descent"), ("fig1_square", "descent"), ("array2_faults", "robust"),
                         ("two_places", "robust"), ("ball3d", "robust"), ("frl_array", "robust")):  # fmt: skip
        solver = scene_request(load_scene(name)).scene.solver
        assert solver.name == method and (name != "array1_circle" or solver.start == "random"), name
    chosen = edited(load_scene("tiny"), {"solver.name": "joint"})
    assert scene_request(chosen).scene is chosen
    square = edited(load_scene("fig1_square"), {"solver.name": "robust"})  # its known microphones are those not free
    assert scene_request(square).scene.solver.name == "descent"


def test_the_map_is_of_what_the_method_minimises_and_another_quantity_is_labelled(opened):
    viewer, turn_until = opened
    label = lambda: viewer.snapshot.picture.bar and viewer.snapshot.picture.bar.label  # noqa: E731
    turn_until(lambda: label() and "log-likelihood" in label())
    set_by_client(viewer.tabs.map.quantity, EQ7)
    turn_until(lambda: label() and label().startswith("Eq. 7, for comparison (dB)"))
    linear = dataclasses.replace(viewer.wanted, order_offset=None, style=MapStyle(log=False))
    descent = dataclasses.replace(viewer.run, solver=solvers.load("descent"))
    assert map_label(descent, linear) == "cost, Eq. 7 (relative to the power)"
    picture = viewer.snapshot.picture
    bar = dataclasses.replace(picture.bar, low=picture.bar.high - 0.9)  # dB
    level = dataclasses.replace(picture, floor=dataclasses.replace(picture.floor, bar=bar))
    assert "almost level" in viewer._hint(level) and "Where the map is dark" in viewer._hint(picture)
    set_by_client(viewer.tabs.run_bar.run, True)
    turn_until(lambda: label() and "log-likelihood" in label())


def test_the_bar_says_that_a_method_restarts_and_why_a_method_is_not_possible(tiny_page):
    page, turn_until = tiny_page
    bar, run = page.panels.overlay._regions["bar"], page.viewer.run
    turn_until(lambda: bar.content.count(f"title='{NEW_RUN}'") == 1)
    page.viewer.tabs.solver.name.options = ("robust",)
    turn_until(lambda: "One at a time<i> (not for this array)</i>" in bar.content)
    blind = dataclasses.replace(run.problem, known=[], known_positions=run.problem.known_positions[:0])
    page.viewer.run = dataclasses.replace(run, problem=blind)
    turn_until(lambda: f"One at a time<i> ({NEEDED})</i>" in bar.content)


def test_a_run_that_tries_another_start_says_so_and_shows_the_best_error(controls):
    class Restarted(State):
        best_positions = controls[0].binding.run.measurement.positions

    state = Restarted(Restarted.best_positions + 0.1)
    said = html.status(view_of([state], running=True), controls[0].binding.measurement)
    assert state_word(state, True) == "Trying another start; the best so far is kept"
    assert "mean 0 mm" in said and "Trying another start" in said and "the best start so far is kept" in said


def test_one_button_runs_and_pauses_and_a_slider_rewinds(controls):
    panel, session = controls
    set_by_client(panel.run_bar.run, True)
    session.view = dataclasses.replace(session.view, running=True)
    panel.show(PageState(session.view, microphone=3))
    assert panel.run_bar.run.label == "Pause"
    set_by_client(panel.run_bar.run, True)
    set_by_client(panel.run_bar.time, 1)
    assert session.commands == [("play",), ("pause",), ("seek", 1)]
