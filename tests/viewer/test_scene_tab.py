"""The parameters of the tab Scene become a scene, or a line that says why not."""

import dataclasses

import pytest
from doubles import set_by_client

from fdcal.model.scene_file import load_scene, placeholder_scene
from fdcal.session.scene_edits import parameters_of
from fdcal.viewer.gui.binding import Binding
from fdcal.viewer.tabs import scene as scenetab


def test_apply_opens_the_scene_with_the_chosen_parameters(controls, scene):
    panel, session = controls
    tab = panel.scene
    set_by_client(tab.apply, True)
    set_by_client(tab.noise, True)
    set_by_client(tab.snr, 25)
    set_by_client(tab.walls, "absorbing")
    set_by_client(tab.absorption, 10.0)
    set_by_client(tab.known, 5)
    assert tab.snr.visible and tab.absorption.visible
    set_by_client(tab.apply, True)
    same, changed = (opening.scene for opening in session.opened)
    assert same is scene, "a value that the user has not changed stays exactly as it was"
    parameters = parameters_of(changed)
    assert (parameters.snr_db, parameters.walls, parameters.known) == (25, "absorbing", 5)
    assert parameters.absorption == pytest.approx(0.1) and changed.room.size == scene.room.size


def test_an_impossible_scene_is_refused_in_one_line(controls):
    panel, session = controls
    set_by_client(panel.scene.radius, 2.5)
    set_by_client(panel.scene.apply, True)
    assert session.opened == [] and "outside the room" in panel.scene.message.content
    set_by_client(panel.scene.name, "array1_circle")
    assert panel.scene.microphones.value == 65 and panel.scene.message.content == ""
    set_by_client(panel.scene.apply, True)
    assert [opening.scene for opening in session.opened] == [load_scene("array1_circle")]


def test_restart_opens_another_solver_and_resets_the_same_one(controls):
    panel, session = controls
    set_by_client(panel.run_bar.steps, "Reset")
    set_by_client(panel.solver.name, "descent")
    assert panel.solver.start.value == "random" and panel.solver.seed.visible
    set_by_client(panel.solver.seed, 5)
    set_by_client(panel.run_bar.steps, "Reset")
    assert session.commands == [("reset", 0)]
    (opening,) = session.opened
    assert (opening.scene.solver.name, opening.scene.solver.start, opening.seed) == ("descent", "random", 5)
    assert opening.measurement is panel.binding.measurement


def test_a_seed_without_effect_is_hidden(controls):
    panel, _ = controls
    assert not panel.solver.seed.visible and not panel.solver.start.visible, "robust has starts of its own"
    set_by_client(panel.solver.name, "joint")
    assert not panel.solver.seed.visible and panel.solver.start.visible, "joint from its affine start"
    set_by_client(panel.solver.start, "random")
    assert panel.solver.seed.visible
    set_by_client(panel.solver.name, "room")
    assert not panel.solver.seed.visible and not panel.solver.start.visible, "it has a start of its own"
    set_by_client(panel.solver.name, "descent")
    assert panel.solver.seed.visible and panel.solver.start.visible


def test_a_measured_array_is_among_the_scenes_and_opens_without_anything_to_edit(controls):
    panel, session = controls
    tab = panel.scene
    set_by_client(tab.name, "frl_array")
    edited = (
        tab.microphones,
        tab.radius,
        tab.walls,
        tab.absorption,
        tab.noise,
        tab.snr,
        tab.speed,
        tab.known,
        tab.seed,
    )
    assert not any(handle.visible for handle in edited)
    assert tab.title.visible and "7 microphones in a laboratory" in tab.title.content
    for words in ("nominal positions", "CC BY 4.0", "cannot be edited"):
        assert words in tab.message.content
    assert tab.apply.visible and tab.apply.label == "Open"
    set_by_client(tab.apply, True)
    (opening,) = session.opened
    assert opening.scene == load_scene("frl_array") and opening.measurement is None
    set_by_client(tab.name, "tiny")
    assert tab.apply.label == "Apply" and tab.radius.visible and not tab.title.visible


def test_a_measurement_has_no_simulation_settings(server, work):
    measured = placeholder_scene(work.measurement, "hall", work.scene.solver)
    opened = []
    tab = scenetab.SceneTab(Binding(server.gui, dataclasses.replace(work, scene=measured), 6, opened.append))
    parameters = (tab.microphones, tab.radius, tab.walls, tab.noise, tab.speed, tab.known, tab.seed, tab.apply)
    assert not any(handle.visible for handle in parameters) and "a measurement" in tab.message.content
    set_by_client(tab.apply, True)
    assert opened == [], "a client can press a button that it does not see"
    set_by_client(tab.name, "tiny")
    assert all(handle.visible for handle in parameters) and "a measurement" not in tab.message.content
    set_by_client(tab.apply, True)
    assert [one.scene.name for one in opened] == ["tiny"]
    set_by_client(tab.name, "hall")
    assert not tab.apply.visible
    namesake = dataclasses.replace(work, scene=placeholder_scene(work.measurement, "tiny", work.scene.solver))
    tab = scenetab.SceneTab(Binding(server.gui, namesake, 6, opened.append))
    assert tab.name.value == "tiny (measured)" and not tab.apply.visible
    set_by_client(tab.name, "tiny")
    assert tab.apply.visible, "the scene of that name is there, too"
    server.gui.reset()


def test_a_measured_room_has_no_walls_to_set_and_says_what_is_modelled(controls):
    panel, session = controls
    tab = panel.scene
    set_by_client(tab.walls, "absorbing")
    set_by_client(tab.name, "listening_lab")
    assert not tab.walls.visible and not tab.absorption.visible and tab.microphones.visible
    assert "response is measured" in tab.message.content and "is modelled" in tab.message.content
    set_by_client(tab.snr, 30)
    set_by_client(tab.walls, "rigid")  # a client can set what is hidden
    set_by_client(tab.apply, True)
    (opening,) = session.opened
    assert opening.scene.room == load_scene("listening_lab").room and opening.scene.measurement.snr_db == 30
    set_by_client(tab.name, "tiny")
    assert tab.walls.visible and tab.message.content == ""
