"""The page in a real browser: address, keys, a lesson, a server that comes back."""

import logging
import re

import pytest
from browsing import COARSE, begin_anew, opened_page, press, slider, tab, until

from fdcal.viewer.server import hardening


@pytest.fixture(scope="module")
def page(opened):
    return opened


@pytest.fixture(autouse=True)
def no_fault(caplog, request):
    """Nothing that a client does is a fault of the server; what is said of strangers is of the connections."""
    yield
    if "served" in request.fixturenames:
        faults = [record for record in caplog.records if record.levelno >= logging.ERROR]
        assert [record.getMessage() for record in faults if record.name != hardening.log.name] == []


def alive(page):
    """The page does what a button says."""
    begin_anew(page)
    press(page, "Step")
    page.get_by_text(re.compile("^step 1, ")).wait_for()


def map_again(page):
    """Show the map of the solver's modes, and wait until the address says so."""
    page.keyboard.press("v")
    page.keyboard.press("u")
    page.wait_for_function("/modes=solver.*map=flat/.test(location.hash)")


def test_every_page_shows_one_session_and_its_address_whoever_sets_it(page, served, browser):
    other = opened_page(browser, served.url, f"{COARSE}&microphone=5&modes=2-4&map=none")
    for one in (page, other):
        one.wait_for_function("location.hash.includes('scene=tiny&microphone=5&modes=2-4&map=none')")
    other.get_by_text("step 0, sweep 0").wait_for()
    press(page, "Step")
    other.get_by_text("step 1, sweep 0").wait_for()
    press(other, "Sweep")
    page.get_by_text("step 13, sweep 1").wait_for()  # 16 microphones, 3 of them known

    page.goto("about:blank")  # away, while another browser goes on
    other.evaluate("location.hash = 'microphone=3&map=none&face=expert'")
    other.wait_for_function("location.hash.includes('microphone=3')")
    page.go_back()
    page.wait_for_function("location.hash.includes('microphone=3')")
    page.get_by_text("step 13, sweep 1").wait_for()
    other.wait_for_timeout(500)
    assert "microphone=3" in other.evaluate("location.hash"), "who comes back leaves the session as it is"
    other.evaluate("location.hash = 'microphone=8&map=none&scene=t%69ny'")
    page.wait_for_function("location.hash.includes('microphone=8')")
    other.close()
    map_again(page)


def test_the_page_comes_back_with_the_server_as_it_was(served, page):
    alive(page)
    page.evaluate("location.hash = 'microphone=8&map=none&face=expert'")
    page.wait_for_function("location.hash.includes('microphone=8')")
    served.stop()
    page.get_by_text("The connection is lost").wait_for()
    page.wait_for_timeout(3000)  # in which viser alone would make Chromium delay its attempts
    served.start()
    page.get_by_text("The connection was lost and is back").wait_for()
    page.wait_for_function("location.hash.includes('microphone=8')")
    tab(page, "Map")

    def of_microphone_8():
        assert slider(page, "Microphone").get_attribute("aria-valuenow") == "8"

    until(page, of_microphone_8)
    alive(page)


def test_the_page_follows_the_theme_the_arrows_and_keys_unless_a_text_is_typed(page):
    page.emulate_media(color_scheme="dark")
    page.locator("html[data-mantine-color-scheme=dark]").wait_for()
    page.evaluate("location.hash = 'microphone=7&map=none&face=expert'")
    page.wait_for_function("location.hash.includes('microphone=7')")
    tab(page, "Map")
    handle = slider(page, "Microphone")
    handle.focus()
    place = "window.__viserMutable.camera.position.toArray().join()"
    before = page.evaluate(place)
    handle.press("ArrowRight", delay=300)
    page.wait_for_function("location.hash.includes('microphone=8')")
    assert page.evaluate(place) == before, "the arrows move the slider alone"
    page.evaluate("document.activeElement.blur()")
    begin_anew(page)
    map_again(page)
    page.keyboard.press("o")
    page.locator("//label[.='Mode numbers']/following::input[1]").first.click()
    page.keyboard.type("n")
    page.keyboard.press("Escape")
    page.get_by_text("step 0, sweep 0").wait_for()
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("u")
    page.keyboard.press("n")
    page.get_by_text(re.compile("^step 1, ")).wait_for()
