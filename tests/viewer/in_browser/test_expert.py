"""Expert in a real browser: clicks and drags in the scene, a run to its end, a saved file."""

import re

import numpy as np
import pytest
from browsing import begin_anew, hover, middle, on_screen, run_to_the_end, tab

from fdcal.acoustics.measure import cached_measurement
from fdcal.viewer import session_view


@pytest.fixture
def page(opened):
    """The page with the solver at its start, and the map of the modes in use."""
    begin_anew(opened)
    opened.evaluate("document.activeElement.blur()")
    opened.keyboard.press("u")
    return opened


def test_a_microphone_that_is_let_go_rolls_into_its_minimum_and_the_page_says_where(page, scene):
    def ball():  # where it stands now: after a reset it may still be drawn at its place before
        return np.array([*middle(page, "/microphones/ball"), 0.0])

    hover(page, lambda: on_screen(page, scene, [ball()])[0])
    away = on_screen(page, scene, [ball() + [-0.05, 0.04, 0.0]])[0]
    page.mouse.down()
    page.mouse.move(*away, steps=6)
    page.get_by_text(re.compile(r"^-[\d.]+ dB$")).first.wait_for()
    page.mouse.up()
    page.get_by_text(
        re.compile(r"^(Reached the true position within|Trapped,|At the edge of the map,) [\d.]+ [cm]m")
    ).first.wait_for()
    page.get_by_text(re.compile(r"^[01] of 1 drop reached the true position$")).wait_for()
    page.get_by_role("button", name="Continue from here").press("Enter")  # a notice of the browser may lie above it
    page.get_by_text(re.compile(r"^step ([2-9]|\d\d+), ")).first.wait_for()


def test_a_run_ends_without_a_fault_and_what_is_pressed_then_stays_below_the_pointer(page, monkeypatch):
    """The curves keep their width meanwhile, and the controls their places as the verdict comes."""
    monkeypatch.setattr(session_view, "VERDICT_DELAY", 1.5)  # s, in which the mouse is pressed
    page.faults.clear()
    page.get_by_text("step 0, sweep 0").wait_for()
    page.evaluate(
        """() => {
            window.widths = new Set();
            const measure = () => {
                if (!window.widths) return;
                for (const plot of document.querySelectorAll(".uplot"))
                    if (plot.checkVisibility()) window.widths.add(plot.offsetWidth);
                requestAnimationFrame(measure);
            };
            measure();
        }"""
    )
    run_to_the_end(page)
    page.get_by_text("Assessing the result").wait_for()
    page.get_by_role("button", name="Step", exact=True).wait_for(state="detached")
    button = page.get_by_role("button", name="Restart", exact=True)
    button.hover()
    page.mouse.down()
    page.locator(".fdcal-verdict").wait_for()
    page.mouse.up()
    page.get_by_text("step 0, sweep 0").wait_for()
    assert page.evaluate("Math.min(...window.widths)") > 200
    page.evaluate("window.widths = null")  # ends `measure`, which would go on in the tests after this one
    assert page.faults == []


def test_a_microphone_is_picked_by_a_click(page, scene):
    tab(page, "Map")
    (pixel,) = on_screen(page, scene, [[*cached_measurement(scene).positions[5], 0.0]])  # known: it is at its place
    hover(page, pixel)
    page.mouse.click(*pixel)
    page.get_by_text("microphone 5, ").first.wait_for()
    page.wait_for_function("box => !box.checked", arg=page.get_by_label("Follow the run").element_handle())
