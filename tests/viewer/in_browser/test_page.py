"""The page in a real browser: address, keys, a server that comes back, and another scene, of an array in space."""

import logging
import re

import pytest
from browsing import COARSE, choose, hover, on_screen, opened_page, press, restart_solver, slider, tab, until

from fdcal.acoustics.measure import cached_measurement
from fdcal.viewer.server import hardening


@pytest.fixture
def page(opened):
    return opened


@pytest.fixture(autouse=True)
def no_fault(caplog, request):
    """Check that the log has no fault of the server; messages about refused connections are allowed."""
    yield
    if "served" in request.fixturenames:
        faults = [record for record in caplog.records if record.levelno >= logging.ERROR]
        assert [record.getMessage() for record in faults if record.name != hardening.log.name] == []


def alive(page):
    """Check that the page reacts to a button."""
    restart_solver(page)
    press(page, "Step")
    page.get_by_text(re.compile("^step 1, ")).wait_for()


def map_again(page):
    """Show the map of the solver's modes, and wait until the address says so."""
    page.keyboard.press("v")
    page.keyboard.press("u")
    page.wait_for_function("/modes=solver.*map=flat/.test(location.hash)")


def of_microphone(page, number):
    assert slider(page, "Microphone").get_attribute("aria-valuenow") == str(number)


def test_every_page_shows_one_session_and_its_address_whoever_sets_it(page, served):
    other = opened_page(page.context, served.url, f"{COARSE}&microphone=5&modes=2-4&map=none")
    for one in (page, other):
        one.wait_for_function("/scene=tiny&.*microphone=5&modes=2-4&map=none/.test(location.hash)")
    other.get_by_text("step 0, sweep 0").wait_for()
    press(page, "Step")
    other.get_by_text("step 1, sweep 0").wait_for()
    press(other, "Sweep")
    page.get_by_text("step 13, sweep 1").wait_for()  # 3 of the 16 microphones are known

    page.goto("about:blank")  # this page leaves while another browser continues
    other.evaluate("location.hash = 'microphone=3&map=none&layout=expert'")
    other.wait_for_function("location.hash.includes('microphone=3')")
    page.go_back()
    page.wait_for_function("location.hash.includes('microphone=3')")
    page.get_by_text("step 13, sweep 1").wait_for()
    other.wait_for_timeout(500)
    assert "microphone=3" in other.evaluate("location.hash"), "a browser that returns changes nothing"
    other.evaluate("location.hash = 'microphone=8&map=none&scene=t%69ny'")
    page.wait_for_function("location.hash.includes('microphone=8')")
    other.close()
    map_again(page)


def test_the_page_comes_back_with_the_server_as_it_was(served, page):
    alive(page)
    page.evaluate("location.hash = 'microphone=8&map=none&layout=expert'")
    page.wait_for_function("location.hash.includes('microphone=8')")
    served.stop()
    page.get_by_text("The connection is lost").wait_for()
    page.wait_for_timeout(3000)  # with viser alone, Chromium would delay its attempts to reconnect
    served.start()
    page.get_by_text("The connection was lost and is restored").wait_for()
    page.wait_for_function("location.hash.includes('microphone=8')")
    tab(page, "Map")

    until(page, lambda: of_microphone(page, 8))
    # A page that comes back with the address of another scene does not open it.
    other = "sessionStorage.setItem('fdcal back', '1'); history.replaceState(null, '', '#scene=ball3d&layout=expert')"
    page.evaluate(f"{other}; location.reload()")
    page.get_by_text("The connection was lost and is restored").wait_for()
    alive(page)
    page.wait_for_function("location.hash")  # the page writes it after the messages of the server
    assert "scene=tiny" in page.evaluate("location.hash")


def test_the_page_follows_the_theme_the_arrows_and_keys_unless_a_text_is_typed(page):
    page.emulate_media(color_scheme="dark")
    page.locator("html[data-mantine-color-scheme=dark]").wait_for()
    page.evaluate("location.hash = 'microphone=7&map=none&layout=expert'")
    page.wait_for_function("location.hash.includes('microphone=7')")
    tab(page, "Map")
    handle = slider(page, "Microphone")
    until(page, lambda: of_microphone(page, 7))  # the control changes after the address
    handle.focus()
    place = "window.__viserMutable.camera.position.toArray().join()"
    before = page.evaluate(place)
    handle.press("ArrowRight", delay=300)
    page.wait_for_function("location.hash.includes('microphone=8')")
    assert page.evaluate(place) == before, "the arrows move the slider alone"
    page.evaluate("document.activeElement.blur()")
    restart_solver(page)
    map_again(page)
    page.keyboard.press("o")
    page.locator("//label[.='Frequency numbers']/following::input[1]").first.click()
    page.keyboard.type("n")
    page.keyboard.press("Escape")
    page.get_by_text("step 0, sweep 0").wait_for()
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("u")
    page.keyboard.press("n")
    page.get_by_text(re.compile("^step 1, ")).wait_for()


def test_a_microphone_is_picked_by_a_click(page, scene):
    tab(page, "Map")
    # A known microphone is at its true position.
    (pixel,) = on_screen(page, scene, [[*cached_measurement(scene).positions[5], 0.0]])
    hover(page, pixel)
    page.mouse.click(*pixel)
    page.get_by_text("microphone 5, ").first.wait_for()
    page.wait_for_function("box => !box.checked", arg=page.get_by_label("Follow the run").element_handle())


TICKS = "window.__viserMutable?.nodeRefFromName?.['/frame_ticks']?.visible"
DRAWN = "name => window.__viserMutable?.nodeRefFromName?.[name] != null"
# Return how many meshes the scene shows below a name; the frame of the name stays when they are removed.
SHOWN = """name => {
    let count = 0;
    window.__viserMutable.nodeRefFromName[name]?.traverseVisible(part => { count += Boolean(part.isMesh); });
    return count;
}"""


@pytest.fixture
def ball(page):
    """The page with `ball3d`, in the tab Map; its test must be the last, because `tiny` is no longer shown."""
    press(page, "Explore")
    page.wait_for_function("!location.hash.includes('layout=')")  # a change of layout closes the list of scenes
    page.get_by_role("button", name="Choose a scene").click()
    page.locator("[data-do='scene=ball3d']").click()
    page.get_by_role("button", name="Choose a scene").get_by_text("ball").wait_for()
    page.wait_for_function("location.hash.includes('scene=ball3d')")
    press(page, "Expert")
    page.get_by_text("fdcal · ball3d").wait_for()
    page.evaluate("location.hash = 'microphone=9&modes=1-3&map=flat&layout=expert'")  # this volume is computed at once
    page.wait_for_function("/microphone=9&modes=1-3/.test(location.hash)")
    tab(page, "Map")
    return page


def test_isosurfaces_over_a_map_and_a_relief_stand_in_the_scene_and_follow_the_controls(ball):
    # The heights have no ticks in the plan view, where they would coincide.
    ball.wait_for_function(f"{TICKS} === false")
    choose(ball, "Show", "Isosurfaces (3-D)")
    ball.wait_for_function(f"name => ({SHOWN})(name) == 1", arg="/isosurfaces")
    tab(ball, "View")
    ball.get_by_role("button", name="3-D", exact=True).locator("visible=true").click()
    ball.wait_for_function(f"{TICKS} === true")
    tab(ball, "Map")
    choose(ball, "Show", "Relief")
    ball.wait_for_function(DRAWN, arg="/relief")
    ball.wait_for_function(f"name => ({SHOWN})(name) == 0", arg="/isosurfaces")
