"""The opening, the sweep of modes and the cut through the map in a real browser."""

import re
import threading

import numpy as np
import pytest
from browsing import COARSE, EXACT, WAIT, hover, on_screen, press, serving_here, slider, stands, tab

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.model.scene_file import load_scene
from fdcal.viewer import page as page_module
from fdcal.viewer.tabs import sweep as sweep_tab
from fdcal.viewer.tabs.sweep import Playback

NOTE = re.compile(r"microphone \d+, (mode (\d+) alone|sum of (\d+) modes, \d+ to \d+): (no|\d+) local minim")
RECORD = """() => {
    window.notes = [];
    const note = /microphone \\d+, (mode \\d+ alone|sum of \\d+ modes, \\d+ to \\d+): (no|\\d+) local minim\\w+/;
    new MutationObserver(() => {
        const now = document.body?.innerText.match(note)?.[0] ?? "";
        if (window.notes.at(-1) != now) window.notes.push(now);
    }).observe(document, {subtree: true, childList: true, characterData: true, attributes: true});
}"""  # all that the line of the opening says, in order


@pytest.fixture(scope="module")
def scene():
    return load_scene("tiny")


@pytest.fixture
def query():
    return COARSE


@pytest.fixture
def page(browser, kernels, scene, capsys, query):
    """The page of `tiny`, fresh for each test: its opening plays once."""
    with serving_here(scene, opening=True) as url:
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.set_default_timeout(WAIT * 1e3)
        page.add_init_script(f"({RECORD})()")
        page.goto(f"{url}/{query}")
        yield page
        page.close()
    assert "Traceback" not in capsys.readouterr().err


@pytest.fixture
def lasting_opening(monkeypatch):
    """The opening stays at its first map until this event is set: no machine is too slow to see it."""
    may_go_on, advance = threading.Event(), Playback.advance

    def held(self, stops, ready, now):
        waits = self.opening and self.next == 1 and not may_go_on.is_set()
        return None if waits else advance(self, stops, ready, now)

    monkeypatch.setattr(page_module, "OPENING_DELAY", 0.5)
    monkeypatch.setattr(sweep_tab, "OPENING_RATE", 6.0)
    monkeypatch.setattr(sweep_tab, "LAST_TIME", 0.5)
    monkeypatch.setattr(Playback, "advance", held)
    return may_go_on


def test_the_page_opens_with_a_map_of_several_minima_to_which_modes_are_added(lasting_opening, page):
    page.get_by_text(NOTE).first.wait_for()
    lasting_opening.set()
    page.wait_for_function("window.notes.filter(Boolean).length > 0 && window.notes.at(-1) == ''")
    notes = [note for note in page.evaluate("window.notes") if note]
    first = NOTE.search(notes[0])
    assert first[2] and int(first[4]) > 1, "one mode, several minima"
    summed = [int(NOTE.search(note)[3]) for note in notes[1:]]
    assert len(summed) > 3 and summed == sorted(set(summed)), "modes are added"
    tab(page, "Map")
    page.get_by_label("Modes shown", exact=True).wait_for(state="attached")
    page.get_by_text(re.compile("sum of 20 modes")).first.wait_for()  # those of the solver again


def test_the_opening_ends_with_the_first_click_and_the_speed_is_at_hand(lasting_opening, page):
    page.get_by_text(NOTE).first.wait_for()
    slider(page, "Steps per second").wait_for()
    press(page, "Run")
    page.get_by_text(NOTE).first.wait_for(state="hidden")
    slider(page, "Steps per second").press("End")
    page.get_by_text("Converged").wait_for()


@pytest.mark.parametrize("query", [EXACT])
def test_the_opening_ends_when_the_user_moves_the_camera(lasting_opening, page, scene):
    page.get_by_text(NOTE).first.wait_for()
    (x, y), _ = on_screen(page, scene, np.array([[*scene.search.origin, 0.0], [*scene.search.origin, 1.0]]))
    page.mouse.move(x - 30, y + 30)  # beside the map, where there is no microphone
    page.mouse.wheel(0, 200)
    page.get_by_text(NOTE).first.wait_for(state="hidden")


def test_play_pause_and_the_slider_of_the_sweep(lasting_opening, page):
    page.get_by_text(NOTE).first.wait_for()
    tab(page, "Sweep")
    page.get_by_text("Order and speed", exact=True).click()
    slider(page, "Modes per second").press("Home")  # so slowly that no machine sees the end before Pause
    press(page, "Play")
    page.get_by_text(re.compile("sum of [2-9] modes")).first.wait_for()
    press(page, "Pause")
    page.get_by_role("button", name="Play", exact=True).wait_for()
    handle = slider(page, "Modes summed")
    handle.focus()
    handle.press("Home")
    page.get_by_text(re.compile(r"mode \d+ alone")).first.wait_for()
    handle.press("ArrowRight")
    page.get_by_text(re.compile(r"sum of 2 modes")).first.wait_for()
    page.locator(".uplot", has_text="Local minima of the sum").first.wait_for()


@pytest.mark.parametrize("query", [EXACT])
def test_an_end_of_the_cut_is_dragged_and_the_plot_follows(page, scene):
    page.get_by_text("step 0, sweep 0").wait_for()
    tab(page, "Sweep")
    press(page, "x")
    text = page.get_by_text(re.compile(r"lowest [\d.]+ m from A")).first
    text.wait_for()
    before = text.inner_text()
    problem, solver = cached_measurement(scene).problem("unit"), solvers.load(scene.solver.name)
    start = solver.init(problem, solvers.with_mode_count(problem, scene.solver), scene.seed).positions
    search, height = scene.search, float(start[problem.free[0], 1])
    low, high = search.origin[0], search.origin[0] + search.step * (search.shape[0] - 1)
    stands(page, "/cut", [(low + high) / 2, height], 2e-3)
    target = [low, height + 0.15]
    here, there = on_screen(page, scene, np.array([[low, height, 0.0], [*target, 0.0]]))
    hover(page, here)
    page.mouse.down()
    page.mouse.move(*there, steps=8)
    page.mouse.up()
    stands(page, "/cut", [(low + high) / 2, height + 0.075], 5e-3)
    page.wait_for_function("text => !document.body.innerText.includes(text)", arg=before)
