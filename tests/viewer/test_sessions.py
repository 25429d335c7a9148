"""From a request to a session on the page, from one session to the next, and what remains of the old one."""

import collections
import dataclasses
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from browsing import WAIT, serving_here
from doubles import finish, wait_until

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.model.validation import InputError, frozen_array
from fdcal.session import session_file
from fdcal.session.scene_edits import edited
from fdcal.session.sources import OpenRequest
from fdcal.solvers import descent
from fdcal.viewer import page as page_module
from fdcal.viewer import prepare as preparing
from fdcal.viewer.prepare import SessionSwitcher
from fdcal.viewer.scene3d import SceneNodes
from fdcal.viewer.tabs import view as exports


def test_the_page_shows_the_progress_of_the_simulation(page_of, scene, monkeypatch, progress_texts):
    """The simulation continues only when the page shows its progress."""
    page, turn_until = page_of

    def slow(scene, progress):
        progress(0.4)
        bar = page.panels.overlay._regions["bar"]
        for _ in range(600):
            if "40 %" in page.panels.line.content and page.panels.bar.value == 40 and "40 %" in bar.content:
                assert "A &lt; B" in bar.content and "button" not in bar.content, "there is no session yet"
                raise InputError("scene.key = 1 is wrong; mend it")
            time.sleep(0.02)

    monkeypatch.setattr(preparing, "cached_measurement", slow)
    page.open(OpenRequest(edited(scene, {"title": "A < B"})))
    with pytest.raises(InputError, match="mend it"):
        turn_until(lambda: False)
    assert any("40 %" in text for text in progress_texts)


def test_the_room_is_shown_while_the_solver_is_prepared(page_of, scene, monkeypatch):
    """It is shown after the simulation; an array without given positions has no known microphones."""
    page, turn_until = page_of
    gate, sound = threading.Event(), cached_measurement(scene)
    monkeypatch.setattr(preparing, "cached_measurement", lambda scene, progress: sound)
    monkeypatch.setattr(solvers, "warmup_calls", lambda _: [("", gate.wait)])
    monkeypatch.setattr(preparing, "COMPILE_TIME", 0.0)
    page.open(OpenRequest(edited(scene, {"solver.known": "none"})))
    assert page.nodes.cameras.picture is None
    placed = []
    monkeypatch.setattr(page.nodes.cameras, "request_all", placed.append)
    turn_until(lambda: page.nodes.cameras.picture is not None)
    assert placed == ["top"], "pages that came before there was anything to see"
    turn_until(lambda: "Compiling" in page.panels.line.content)
    assert page.viewer is None and "microphones/true" in page.nodes.parts
    assert not any("known" in name or "estimate" in name for name in page.nodes.parts)
    gate.set()
    turn_until(lambda: page.viewer is not None)
    assert "microphones/estimate" in page.nodes.parts


def test_a_start_with_all_microphones_at_one_position_is_shown(page_of, scene):
    page, turn_until = page_of
    measurement, settings = cached_measurement(scene), dataclasses.replace(scene.solver, modes=6)
    state = solvers.load(settings.name).init(measurement.problem(), settings, 0)
    together = frozen_array(np.tile(state.positions[0], (measurement.count, 1)), float)
    page.open(OpenRequest(scene, states=(dataclasses.replace(state, positions=together),)))
    turn_until(lambda: page.viewer is not None)
    for _ in range(3):
        page.tick(time.perf_counter())
    assert np.ptp(page.viewer.binding.session.view.state.positions, axis=0).max() == 0
    assert page.viewer.fault == ""
    assert "all estimates coincide" in page.viewer.tabs.spectrum.text.content


def test_a_part_of_the_page_that_fails_is_logged_once_and_the_page_goes_on(tiny_page, monkeypatch, caplog):
    page, turn_until = tiny_page

    def failing(*_):
        raise ZeroDivisionError("of this test")

    for part, name in ((page.lessons, "show"), (page.address, "show"), (page.explore, "show")):
        monkeypatch.setattr(part, name, failing)
    page.viewer.binding.session.step()
    turn_until(lambda: "step 1," in page.viewer.tabs.run_bar.status.content)
    said = [record.getMessage() for record in caplog.records if "could not be updated" in record.getMessage()]
    assert said == [f"the {part} could not be updated" for part in ("lessons", "address", "canvas")]


def test_an_error_of_the_solver_is_shown_as_text_and_the_page_works_on(page_of, scene, monkeypatch):
    page, turn_until = page_of
    step = descent.step

    def failing(problem, state):
        if state.step == 4:
            raise ZeroDivisionError("the floor <b>opens</b>")
        return step(problem, state)

    monkeypatch.setattr(descent, "step", failing)
    page.open(OpenRequest(edited(scene, {"solver.name": "descent"}), play=True))
    turn_until(lambda: page.viewer is not None)
    status = page.viewer.tabs.run_bar.status
    turn_until(lambda: "ZeroDivisionError: the floor &lt;b&gt;opens&lt;/b&gt;; details in" in status.content)
    assert "step 4, sweep 0" in status.content and page.viewer.tabs.run_bar.run.label == "Play"
    page.viewer.binding.session.reset()
    turn_until(lambda: "ZeroDivisionError" not in status.content)
    page.viewer.binding.session.step()
    turn_until(lambda: "step 1, sweep 0" in status.content)


def test_a_cached_measurement_is_shown_at_once(server, scene):
    nodes = SceneNodes(server)
    nodes.show_room(OpenRequest(edited(scene, {"seed": 987654})))
    assert nodes.cameras.picture is None, "it has to be simulated first"
    cached_measurement(scene)
    nodes.show_room(OpenRequest(scene))
    assert {"microphones/true", "microphones/known", "room/walls"} <= nodes.parts.keys()
    server.scene.reset()


def test_another_scene_replaces_the_first(tiny_page, scene):
    """The first runs until the second is ready; the style of the page and the tabs stay."""
    page, turn_until = tiny_page
    first, tabs = page.viewer.binding, dict(page.panels.tabs)
    first.choose(dark=True, log=False)
    first.choose(trails=True)
    wanted = {"microphone": 9, "follow": False, "modes": [2]}
    page.open(OpenRequest(edited(scene, {"solver.name": "descent"}), start_seed=5, choices=wanted))
    assert page.viewer.binding is first
    turn_until(lambda: page.viewer.binding is not first)
    choices, session = page.viewer.binding.choices, page.viewer.binding.session
    assert choices.dark and not choices.log and choices.trails
    assert choices.microphone == 9 and choices.modes == (2,) and session.view.state.seed == 5
    assert page.panels.tabs == tabs and page.viewer.tabs.map.microphone.value == 9
    assert first.session.close(0.0)
    session.step()
    turn_until(lambda: "step 1," in page.viewer.tabs.run_bar.status.content)


def test_a_page_has_nothing_to_do_while_nothing_changes(tiny_page):
    page, turn_until = tiny_page
    session = page.viewer.binding.session
    turn_until(lambda: not page.changed and not page.viewer.maps.worker.busy)
    assert not page.changed
    page.viewer.binding.choose(trails=True)
    assert page.changed and not page.changed, "once for one choice"
    session.step()
    wait_until(lambda: page.changed)
    turn_until(lambda: page.viewer.snapshot.view.index == 1 and not page.changed)
    session.view.costs.count += 1
    assert page.changed, "a cost that was left out while the solver ran"
    page.panels.overlay.receive(None, "stamp dismiss")
    page.tick(time.perf_counter())
    page.nodes.cameras.request(None)
    assert page.changed


def test_a_refused_request_is_explained_and_the_old_session_stays(tiny_page, scene):
    page, turn_until = tiny_page
    before = page.viewer.binding
    for changes, choices, words in (
        ({"solver.modes": 500}, {}, "modes"),
        ({"gauge.known": [0, 99]}, {}, "gauge.known"),
        ({}, {"microphone": 99}, "choices.microphone"),
        ({}, {"colour": 1}, "choices.colour"),
    ):
        page.open(OpenRequest(edited(scene, changes), choices=choices))
        turn_until(lambda: page.switcher.error)
        page.tick(0.0)
        assert page.viewer.binding is before and words in page.panels.line.content
        assert page.panels.button.label == "Close"
    before.session.step()
    turn_until(lambda: "step 1," in page.viewer.tabs.run_bar.status.content)
    page.switcher.cancel()
    page.tick(0.0)
    assert not page.panels.line.visible and not page.panels.button.visible


def endless(begun, ended):
    """A simulation that goes on until it is stopped."""

    def simulate(scene, progress):
        begun.set()
        try:
            while True:
                progress(0.1)
                time.sleep(0.01)
        finally:
            threading.Event().wait(0.3)
            ended.set()

    return simulate


def test_cancel_keeps_the_old_session(tiny_page, scene, monkeypatch):
    page, turn_until = tiny_page
    before, ended, bar = page.viewer.binding, threading.Event(), page.panels.overlay._regions["bar"]
    shown = page.viewer.tabs.run_bar
    turn_until(lambda: shown.status.visible and "preparing" not in bar.content)
    monkeypatch.setattr(preparing, "cached_measurement", endless(threading.Event(), ended))
    page.open(OpenRequest(scene))
    turn_until(lambda: "10 %" in page.panels.line.content and "class='preparing'" in bar.content)
    assert page.panels.button.label == "Cancel" and page.panels.button.visible
    assert not shown.status.visible and not shown.verdict.visible, "no old status stands beside the progress"
    event = SimpleNamespace(client=object(), target=page.panels.button)
    for callback in page.panels.button._impl.update_cb:
        finish(callback(event))
    turn_until(lambda: page.switcher.current is None)
    assert ended.wait(WAIT) and page.viewer.binding is before and not page.panels.line.visible
    page.tick(0.0)
    assert shown.status.visible


def test_a_saved_session_is_restored(tiny_page, tmp_path):
    """States and choices are those of the file; test_session_file.py tests the file itself."""
    page, turn_until = tiny_page
    first = page.viewer.binding
    first.session.step(2)
    assert first.session.wait_for(lambda view: view.count == 3 and not view.running, WAIT)
    first.session.seek(1)
    first.choose(microphone=9, follow=False, modes=(2, 4), trails=True, dark=True, log=False)
    turn_until(lambda: page.viewer.snapshot.view.index == 1)
    moment = dataclasses.replace(page.viewer.snapshot, choices=first.choices)
    (tmp_path / "left.zip").write_bytes(exports.KINDS["Session (ZIP)"].make(moment))
    page.open(session_file.read(tmp_path / "left.zip"))
    turn_until(lambda: page.viewer.binding is not first)
    again, panel = page.viewer.binding, page.viewer.tabs
    assert again.choices.to_save() == first.choices.to_save()
    assert (again.session.view.index, again.session.view.count) == (1, 3)
    assert panel.view.dark.value and panel.map.microphone.value == 9 and panel.view.trails.value


def test_an_interrupted_simulation_stops(page_of, scene, monkeypatch):
    page, turn_until = page_of
    begun, ended = threading.Event(), threading.Event()
    monkeypatch.setattr(preparing, "cached_measurement", endless(begun, ended))
    page.open(OpenRequest(scene))
    turn_until(begun.is_set)
    page.close()
    assert ended.is_set(), "the simulation's thread must have ended, or it may write half a file"


def test_the_end_of_a_page_whose_solver_runs_leaves_no_thread(scene, kernels):
    before = names()
    with serving_here(edited(scene, {"solver.name": "descent"}), play=True):
        wait_until(lambda: names()["fdcal-maps"] > before["fdcal-maps"])
    wait_until(lambda: names() <= before)


def names():
    return collections.Counter(t.name for t in threading.enumerate() if t.name.startswith("fdcal"))


def test_a_compilation_is_waited_for(scene, monkeypatch):
    """It cannot be interrupted: the thread of a cancelled request ends after it, and closing waits for that."""
    begun, go_on, before = threading.Event(), threading.Event(), names()["fdcal-prepare"]
    monkeypatch.setattr(solvers, "warmup_calls", lambda _: [("", lambda: begun.set() or go_on.wait(WAIT))])
    switcher = SessionSwitcher()
    switcher.open(OpenRequest(scene))
    switcher.poll()
    assert begun.wait(WAIT) and switcher.compiling
    switcher.cancel()
    switcher.poll()
    go_on.set()
    switcher.close(timeout=0.0)
    assert names()["fdcal-prepare"] <= before


def test_a_preference_that_changes_while_a_session_is_built_is_followed(tiny_page, scene, monkeypatch):
    (page, turn_until), made, browser = tiny_page, page_module.Viewer, object()
    before = page.viewer
    page._prefer(browser, True)
    turn_until(lambda: before.binding.choices.dark)
    monkeypatch.setattr(page_module, "Viewer", lambda *given: (made(*given), page._prefer(browser, False))[0])
    page.open(OpenRequest(scene, 7))
    turn_until(lambda: page.viewer is not before and not page.viewer.binding.choices.dark)
