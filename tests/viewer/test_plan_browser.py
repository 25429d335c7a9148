"""The tab Plan of `tiny` in a real browser: ellipses before a run, a dragged microphone, tabs in one row."""

import numpy as np
import pytest
from browsing import EXACT, hover, middle, on_screen, opened_page, serving_here, slider, stands, tab

from fdcal.acoustics.measure import cached_measurement
from fdcal.model.scene_file import load_scene
from fdcal.viewer.panels import LEFT, RIGHT

DRAWN = "name => window.__viserMutable?.nodeRefFromName?.[name] != null"

BOXES = """tabs => tabs.map(tab => {
    const box = tab.getBoundingClientRect();
    return [tab.innerText.trim(), box.y, box.width];
})"""


@pytest.fixture
def page(browser, kernels):
    """A page of 1280 x 720 pixels with the tab open."""
    with serving_here(load_scene("tiny")) as address:
        page = opened_page(browser, address, EXACT)
        tab(page, "Plan")
        yield page
        page.close()


def summary(page):
    return page.locator("li", has_text="least error").inner_text()


def test_the_bound_follows_a_dragged_microphone_and_the_controls(page):
    scene = load_scene("tiny")
    truth = cached_measurement(scene).positions
    assert not page.evaluate(DRAWN, "/ellipses")
    page.get_by_label("Show the plan").click()
    page.wait_for_function(DRAWN, arg="/ellipses")
    assert not page.evaluate(DRAWN, "/microphones/estimate")
    page.get_by_text("step 0, sweep 0").wait_for()
    boxes = page.get_by_role("tab").evaluate_all(BOXES)
    for panel in (LEFT, RIGHT):
        assert len({round(y) for name, y, width in boxes if name in panel and width}) == 1, "one row at 1280 pixels"

    before, target = summary(page), truth[5] + [-0.06, 0.05]
    stands(page, "/microphones/true", middle(page, "/microphones/true"), 1e-3)
    start, end = on_screen(page, scene, np.column_stack([[truth[5], target], [0.0, 0.0]]))
    hover(page, start)
    page.mouse.down()
    for share in np.linspace(0.1, 1, 8):
        page.mouse.move(*(start + share * (end - start)))
    page.wait_for_function("text => !document.body.innerText.includes(text)", arg=before)  # while it is dragged
    page.mouse.up()
    page.get_by_role("button", name="Original positions", exact=True).click()
    page.get_by_text(before).wait_for()

    handle = slider(page, "Planned SNR (dB)")
    handle.focus()
    handle.press("ArrowLeft")
    page.wait_for_function("text => !document.body.innerText.includes(text)", arg=before)
    page.get_by_label("Show the plan").click()
    page.wait_for_function(DRAWN, arg="/microphones/estimate")
