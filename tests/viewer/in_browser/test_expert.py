"""Expert in a real browser: clicks in the scene, and a run to its end."""

import pytest
from browsing import begin_anew, hover, on_screen, run_to_the_end, tab

from fdcal.acoustics.measure import cached_measurement
from fdcal.viewer import session_view


@pytest.fixture
def page(opened):
    """The page with the solver at its start, and the map of the modes in use."""
    begin_anew(opened)
    opened.evaluate("document.activeElement.blur()")
    opened.keyboard.press("u")
    return opened


def test_a_run_ends_without_a_fault_and_what_is_pressed_then_stays_below_the_pointer(page, monkeypatch):
    """The controls keep their places as the verdict comes."""
    monkeypatch.setattr(session_view, "VERDICT_DELAY", 1.5)  # s, in which the mouse is pressed
    page.faults.clear()
    page.get_by_text("step 0, sweep 0").wait_for()
    run_to_the_end(page)
    page.get_by_text("Assessing the result").wait_for()
    page.get_by_role("button", name="Step", exact=True).wait_for(state="detached")
    button = page.get_by_role("button", name="Restart", exact=True)
    button.hover()
    page.mouse.down()
    page.locator(".fdcal-verdict").wait_for()
    page.mouse.up()
    page.get_by_text("step 0, sweep 0").wait_for()
    assert page.faults == []


def test_a_microphone_is_picked_by_a_click(page, scene):
    tab(page, "Map")
    (pixel,) = on_screen(page, scene, [[*cached_measurement(scene).positions[5], 0.0]])  # known: it is at its place
    hover(page, pixel)
    page.mouse.click(*pixel)
    page.get_by_text("microphone 5, ").first.wait_for()
    page.wait_for_function("box => !box.checked", arg=page.get_by_label("Follow the run").element_handle())
