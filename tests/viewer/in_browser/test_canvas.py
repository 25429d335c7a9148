"""The legend and the colour bar on the canvas, in a real browser, on a desktop and on a phone."""

import re

import numpy as np
import pytest
from browsing import begin_anew, on_screen, press, tab, until
from doubles import assessment

from fdcal.assessment.calibration import ChannelFault, Channels, Evidence
from fdcal.model.scene import load_scene
from fdcal.viewer.gui.html import verdict_html
from fdcal.viewer.panels import LEFT, LEFT_WIDTH, RIGHT
from fdcal.viewer.server.hardening import STYLE

DESKTOP, LARGE, PHONE = (1280, 720), (1440, 900), (390, 844)


@pytest.fixture(scope="module")
def page(opened):
    legend_of(opened).get_by_text("dB").wait_for()
    return opened


def boxes_of(page, names):
    """Where tabs stand."""
    return [page.get_by_role("tab", name=name, exact=True).bounding_box() for name in names]


@pytest.mark.parametrize("size", [LARGE, DESKTOP])
def test_the_legend_stands_on_the_canvas_below_the_map_and_tabs_in_one_row(page, size):
    scene = load_scene("tiny")
    resized(page, size)
    page.locator("canvas").first.wait_for()

    def they_stand_there():
        canvas = page.locator("canvas").first.bounding_box()
        x, y = scene.search.origin[:2]
        (left, bottom), (right, _) = on_screen(page, scene, [(x, y, 0.0), (x + 0.1, y, 0.0)])
        box = legend_of(page).bounding_box()
        assert canvas["x"] <= box["x"] and box["x"] + box["width"] <= canvas["x"] + canvas["width"]
        assert bottom + 30 < box["y"] and box["y"] + box["height"] <= size[1], "below the numbers of the ruler"
        numbers = page.locator("#fdcal-labels .number:visible", has_text=re.compile(r"^[\d.]+$")).filter(visible=True)
        assert numbers.count() >= 6
        for number in numbers.all()[:3]:
            at = number.bounding_box()
            value = x + (at["x"] + at["width"] / 2 - left) / (right - left) * 0.1
            assert value == pytest.approx(float(number.inner_text()), abs=0.004), "each number is where its place is"
        for names, edge in ((RIGHT, size[0]), (LEFT, LEFT_WIDTH)):
            boxes = boxes_of(page, names)
            assert len({box["y"] for box in boxes}) == 1
            ends = [box["x"] + box["width"] for box in boxes]
            assert all(end <= box["x"] + 0.5 for end, box in zip(ends, boxes[1:], strict=False)) and ends[-1] <= edge

    until(page, they_stand_there)


def resized(page, size):
    """Give the window a size, pixels."""
    page.set_viewport_size(dict(zip(("width", "height"), size, strict=True)))
    page.wait_for_function(f"innerWidth == {size[0]}")


def legend_of(page):
    return page.locator(".fdcal-legend")


def test_lecture_mode_folds_the_panels_and_enlarges_the_type_and_back(page):
    def wide(wanted):
        def it_is():
            assert wanted(page.locator("canvas").first.bounding_box()["width"])

        until(page, it_is)

    def letters():
        return legend_of(page).get_by_text("estimate").bounding_box()["height"]

    def larger_and_in_the_window():
        assert letters() > 1.25 * small
        for part in (legend_of(page), end):
            box = part.bounding_box()
            assert box["x"] >= 0 and box["x"] + box["width"] <= DESKTOP[0] and box["y"] + box["height"] <= DESKTOP[1]

    def as_before():
        assert letters() == pytest.approx(small, abs=0.5)
        assert not page.get_by_role("checkbox", name="Lecture mode").is_checked()

    small, end = letters(), page.get_by_role("button", name="End lecture mode")
    tab(page, "View")
    page.get_by_role("checkbox", name="Lecture mode").click()
    wide(lambda width: width == DESKTOP[0])
    until(page, larger_and_in_the_window)
    page.keyboard.press("h")
    wide(lambda width: width < DESKTOP[0] - 300)
    end.wait_for(state="hidden")
    until(page, as_before)


def test_on_a_phone_the_legend_stands_above_the_scene_and_every_tab_of_the_sheet_can_be_opened(page):
    resized(page, PHONE)
    bar, run = page.get_by_text(re.compile("fdcal · tiny")), page.get_by_role("button", name="Run", exact=True)
    bar.wait_for()

    def above_the_scene():
        box = legend_of(page).bounding_box()
        assert box["x"] >= 0 and box["y"] >= 0 and box["width"] <= PHONE[0] and box["height"] < 0.2 * PHONE[1]

    for folded in (False, True):
        if folded:
            bar.click()
            run.wait_for(state="hidden")
        legend_of(page).get_by_text("estimate").wait_for()
        until(page, above_the_scene)
    bar.click()
    run.wait_for()
    begin_anew(page)
    page.get_by_text("Cost (Eq. 7", exact=False).last.wait_for()  # a plot, which fills the width
    press(page, "Step")
    page.get_by_text(re.compile("^step 1, ")).wait_for()
    page.wait_for_timeout(300)  # a sheet that grows does so within a few frames
    widths = "areas => areas.map(area => area.scrollWidth)"
    assert max(page.locator(".mantine-ScrollArea-viewport").evaluate_all(widths)) == PHONE[0]
    for name in (*RIGHT, *LEFT):
        tab(page, name)
        page.get_by_role("tab", name=name, exact=True, selected=True).wait_for()
    sheet = page.get_by_role("tab", name="Scene", exact=True).locator("xpath=ancestor::*[@role='tablist']")
    assert sheet.bounding_box()["width"] > 0.9 * PHONE[0], "the sheet uses the whole width"


SIZES = f"<style>{STYLE.read_text(encoding='utf-8')}</style>"  # of type


def test_long_words_leave_the_controls_where_they_are_and_a_click_shows_all_of_them(browser):
    narrow = browser.new_page(viewport={"width": 340, "height": 720})  # as narrow as a panel
    words = "the residual of 10 of 63 microphones is large: " + "one cause, or another; " * 20
    odd = "nothing speaks against the positions of the other microphones; one sigma 0.45 mm; faulty: microphone 20: "
    faults = (ChannelFault("20", "inverted"), ChannelFault("45", "dead"))
    one, two = (Channels(*np.zeros((5, 50)), faults[:count]) for count in (1, 2))
    mismatch = {"evidence": Evidence(1.0, leave_one_out_db=-9.0)}
    shown = [None, assessment("good", "short"), assessment("model_mismatch", words, **mismatch)]
    heights = []
    for found in (*shown, assessment("model_mismatch", words, channels=one, **mismatch)):
        narrow.set_content(f"{SIZES}<div id='box'>{verdict_html(found, pending=True)}</div>")
        heights.append(narrow.locator("#box").bounding_box()["height"])
    narrow.locator("summary").click()
    assert words.strip() in narrow.locator("summary").inner_text() and narrow.get_by_text("-9.0 dB").is_visible()
    opened = narrow.locator("#box").bounding_box()["height"]
    assert np.ptp(heights) < 1 and opened > heights[0] + 100, heights
    hidden = []
    for channels in (None, two):
        line = verdict_html(assessment("good", f"{odd}inverted; microphone 45: dead", channels=channels))
        narrow.set_content(
            f"{SIZES}<body style='margin: 0; font: 14px DejaVu Sans, sans-serif'>{line}</body>"
        )  # as viser's
        text = narrow.locator("summary div").first
        hidden.append(text.evaluate("words => words.scrollHeight > words.clientHeight + 2"))
    assert hidden == [True, False], "the names of two odd channels are seen without a click"
    narrow.close()
