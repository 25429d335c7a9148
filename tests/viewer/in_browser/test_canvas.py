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
def desktop(opened):
    legend_of(opened).get_by_text("dB").wait_for()
    return opened


@pytest.fixture
def page(desktop):
    """The page on a desktop; the solver stands at its start."""
    if not desktop.get_by_text("step 0, sweep 0").first.is_visible():
        begin_anew(desktop)
    return desktop


@pytest.fixture(scope="module")
def phone(desktop):
    resized(desktop, PHONE)
    desktop.get_by_text(re.compile("fdcal · tiny")).wait_for()
    legend_of(desktop).get_by_text("dB").wait_for()
    return desktop


def resized(page, size):
    """Give the window a size, pixels."""
    page.set_viewport_size(dict(zip(("width", "height"), size, strict=True)))
    page.wait_for_function(f"innerWidth == {size[0]}")


def legend_of(page):
    return page.locator(".fdcal-legend")


@pytest.mark.parametrize("size", [LARGE, DESKTOP])
def test_the_legend_stands_on_the_canvas_below_the_map(page, size):
    scene = load_scene("tiny")
    resized(page, size)
    page.locator("canvas").first.wait_for()

    def it_stands_there():
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
        assert "px" in numbers.first.evaluate("element => getComputedStyle(element).textShadow"), "outlined"

    until(page, it_stands_there)


@pytest.mark.parametrize("size", [LARGE, DESKTOP])
def test_the_tabs_of_a_panel_stand_in_one_row(page, size):
    resized(page, size)

    def in_one_row():
        for names in (RIGHT, LEFT):
            boxes = [page.get_by_role("tab", name=name, exact=True).bounding_box() for name in names]
            assert len({box["y"] for box in boxes}) == 1
            ends = [box["x"] + box["width"] for box in boxes]
            assert all(end <= box["x"] + 0.5 for end, box in zip(ends, boxes[1:], strict=False))
            assert ends[-1] <= size[0] if names is RIGHT else ends[-1] <= LEFT_WIDTH

    until(page, in_one_row)


def canvas_width(page):
    return page.locator("canvas").first.bounding_box()["width"]


def wait_for_width(page, wanted):
    def wide():
        assert wanted(width := canvas_width(page)), width

    until(page, wide)


def letters(page):
    """Height of an entry of the legend on the screen, pixels."""
    return legend_of(page).get_by_text("estimate").bounding_box()["height"]


def test_lecture_mode_folds_the_panels_and_enlarges_the_type_and_back(page):
    width, small = canvas_width(page), letters(page)
    tab(page, "View")
    page.get_by_role("checkbox", name="Lecture mode").click()
    wait_for_width(page, lambda now: now == DESKTOP[0])
    end = page.get_by_role("button", name="End lecture mode")
    end.wait_for()

    def larger_and_in_the_window():
        assert letters(page) > 1.25 * small
        for part in (legend_of(page), end):
            box = part.bounding_box()
            assert box["x"] >= 0 and box["x"] + box["width"] <= DESKTOP[0] and box["y"] + box["height"] <= DESKTOP[1]

    until(page, larger_and_in_the_window)
    page.keyboard.press("h")
    wait_for_width(page, lambda now: abs(now - width) < 2)
    end.wait_for(state="hidden")

    def as_before():
        assert letters(page) == pytest.approx(small, abs=0.5)
        assert not page.get_by_role("checkbox", name="Lecture mode").is_checked()

    until(page, as_before)


@pytest.mark.parametrize("folded", [False, True], ids=["open", "folded"])
def test_on_a_phone_the_legend_stands_above_the_scene(phone, folded):
    bar, run = phone.get_by_text(re.compile("fdcal · tiny")), phone.get_by_role("button", name="Run", exact=True)
    if folded:
        bar.click()
        run.wait_for(state="hidden")
    legend_of(phone).get_by_text("estimate").wait_for()

    def above_the_scene():
        box = legend_of(phone).bounding_box()
        assert box["x"] >= 0 and box["y"] >= 0 and box["width"] <= PHONE[0] and box["height"] < 0.2 * PHONE[1]

    until(phone, above_the_scene)
    if folded:
        bar.click()
        run.wait_for()


def test_on_a_phone_the_sheet_stays_as_wide_as_the_screen(phone):
    begin_anew(phone)
    phone.get_by_text("Cost (Eq. 7", exact=False).last.wait_for()  # a plot, which fills the width
    press(phone, "Step")
    phone.get_by_text(re.compile("^step 1, ")).wait_for()
    phone.wait_for_timeout(300)  # a sheet that grows does so within a few frames
    widths = "areas => areas.map(area => area.scrollWidth)"
    assert max(phone.locator(".mantine-ScrollArea-viewport").evaluate_all(widths)) == PHONE[0]


def test_on_a_phone_every_tab_can_be_opened(phone):
    for name in (*RIGHT, *LEFT):
        phone.get_by_role("tab", name=name, exact=True).click()
        phone.get_by_role("tab", name=name, exact=True, selected=True).wait_for()
    sheet = phone.get_by_role("tab", name="Scene", exact=True).locator("xpath=ancestor::*[@role='tablist']")
    box = sheet.bounding_box()
    assert box["width"] > 0.9 * PHONE[0], "the sheet uses the whole width"


SIZES = f"<style>{STYLE.read_text(encoding='utf-8')}</style>"  # of type


@pytest.fixture(scope="module")
def narrow(browser):
    """An empty page as narrow as a panel."""
    page = browser.new_page(viewport={"width": 340, "height": 720})
    yield page
    page.close()


def test_long_words_leave_the_controls_where_they_are_and_a_click_shows_all_of_them(narrow):
    words = "the residual of 10 of 63 microphones is large: " + "one cause, or another; " * 20
    faulty = Channels(*np.zeros((5, 50)), (ChannelFault("20", "inverted"),))
    shown = [
        None,
        assessment("good", "short"),
        assessment("model_mismatch", words, evidence=Evidence(1.0, leave_one_out_db=-9.0)),
    ]
    shown += [assessment("model_mismatch", words, evidence=Evidence(1.0, leave_one_out_db=-9.0), channels=faulty)]
    heights = []
    for one in shown:
        narrow.set_content(f"{SIZES}<div id='box'>{verdict_html(one, pending=True)}</div>")
        heights.append(narrow.locator("#box").bounding_box()["height"])
    narrow.locator("summary").click()
    assert words.strip() in narrow.locator("summary").inner_text() and narrow.get_by_text("-9.0 dB").is_visible()
    opened = narrow.locator("#box").bounding_box()["height"]
    assert np.ptp(heights) < 1 and opened > heights[0] + 100, heights


def test_the_names_of_two_odd_channels_are_seen_without_a_click(narrow):
    odd = "nothing speaks against the positions of the other microphones; one sigma 0.45 mm; faulty: microphone 20: "
    odd += "inverted; microphone 45: dead"
    faults = (ChannelFault("20", "inverted"), ChannelFault("45", "dead"))
    hidden = []
    for channels in (None, Channels(*np.zeros((5, 50)), faults)):
        line = verdict_html(assessment("good", odd, channels=channels))
        narrow.set_content(
            f"{SIZES}<body style='margin: 0; font: 14px DejaVu Sans, sans-serif'>{line}</body>"
        )  # as viser's
        words = narrow.locator("summary div").first
        hidden.append(words.evaluate("words => words.scrollHeight > words.clientHeight + 2"))
    assert hidden == [True, False]
