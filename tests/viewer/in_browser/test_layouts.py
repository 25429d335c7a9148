"""The layouts Explore and Expert in a real browser: scenes, Play, a lesson, sizes, contrast, the legend, a phone."""

import re

import numpy as np
import pytest
from browsing import on_screen, press, until
from doubles import assessment

from fdcal.assessment.calibration import Evidence
from fdcal.model.scene import load_scene
from fdcal.session.lesson import load_lesson
from fdcal.viewer import panels
from fdcal.viewer.explore import LECTURE
from fdcal.viewer.html import verdict_html
from fdcal.viewer.panels import LEFT, LEFT_WIDTH, RIGHT
from fdcal.viewer.server.hardening import STYLE

DESKTOP, LARGE, PHONE = (1280, 720), (1440, 900), (390, 844)
# Return where a caption and its buttons begin, and the left and right ends of each answer, in pixels.
ANSWERS = """() => {
    const [caption, steps, ...answers] = ["", " .steps", " .choices button"].flatMap(part =>
        [...document.querySelectorAll(`#fdcal [data-region=caption]${part}`)].map(e => e.getBoundingClientRect()));
    return [caption.top, steps.top, ...answers.map(one => [one.top, one.bottom])];
}"""
LESSON = "3_too_many_too_soon"
CONTRAST = 4.5  # minimum contrast of a text with its background (WCAG 2.2, 1.4.3)

# Return the lowest contrast of all visible texts, and that text.
LOWEST_CONTRAST = """() => {
    const parse = text => { const c = text.match(/[\\d.]+/g).map(Number); return c.length > 3 ? c : [...c, 1]; };
    const over = (top, below) => [0, 1, 2].map(i => top[i] * top[3] + below[i] * (1 - top[3])).concat(1);
    const linear = v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
    const light = ([r, g, b]) => 0.2126 * linear(r / 255)
        + 0.7152 * linear(g / 255) + 0.0722 * linear(b / 255);
    const paper = parse(getComputedStyle(document.body).backgroundColor);
    let lowest = [99, ""];
    const seen = {opacityProperty: true, visibilityProperty: true};
    const of = "label, td, button, button *, p, [role=tab], [role=tab] *";
    for (const node of document.querySelectorAll(`#fdcal *, #root :is(${of})`)) {
        const text = [...node.childNodes].filter(n => n.nodeType == 3).map(n => n.data).join("").trim();
        if (!text || !node.checkVisibility(seen) || node.closest(":disabled, .uplot, [data-disabled]")) continue;
        let back = null, faded = 1, layers = [];
        for (let one = node; one; one = one.parentElement) {
            layers.push(parse(getComputedStyle(one).backgroundColor));
            faded *= Number(getComputedStyle(one).opacity);
        }
        back = layers.reverse().reduce((below, top) => over(top, below), over(paper, [255, 255, 255, 1]));
        const ink = parse(getComputedStyle(node).color);
        const [a, b] = [light(over([...ink.slice(0, 3), ink[3] * faded], back)), light(back)].sort((x, y) => y - x);
        const contrast = (a + 0.05) / (b + 0.05);
        if (contrast < lowest[0]) lowest = [contrast, text];
    }
    return lowest;
}"""

SIZES = """() => [...document.querySelectorAll("#root *, #fdcal *, #fdcal-labels *")].filter(node =>
    node.checkVisibility({visibilityProperty: true}) && !node.closest("[data-region=words], .mantine-Notification-root")
    && [...node.childNodes].some(n => n.nodeType == 3 && n.data.trim())).map(node => getComputedStyle(node).fontSize)"""


# Return how many texts of the bar are cut.
CUT = """[...document.querySelectorAll("[data-region=bar] :is(b, small, button, label, output)")].filter(node =>
    node.checkVisibility({visibilityProperty: true}) && node.scrollWidth > node.clientWidth).length"""


# Return the names of controls that contain a word wider than the available space.
CUT_NAMES = """() => [...document.querySelectorAll("#root label")].filter(label => label.offsetWidth).filter(label => {
    const pen = document.createElement("canvas").getContext("2d"), room = label.parentElement.clientWidth;
    pen.font = getComputedStyle(label).font;
    return label.innerText.split(/\\s/).some(word => pen.measureText(word).width > room);
}).map(label => label.innerText)"""


def sized(page, size):
    """Give the window a size, pixels."""
    page.set_viewport_size(dict(zip(("width", "height"), size, strict=True)))
    page.wait_for_function(f"innerWidth == {size[0]} && innerHeight == {size[1]}")


@pytest.fixture
def expert(opened):
    legend_of(opened).get_by_text("Eq. 7 (dB)").wait_for()
    return opened


def test_the_legend_stands_on_the_canvas_below_the_map_and_tabs_in_one_row(expert):
    scene = load_scene("tiny")

    def they_stand_there(size):
        canvas = expert.locator("canvas").first.bounding_box()
        x, y = scene.search.origin[:2]
        (left, bottom), (right, _) = on_screen(expert, scene, [(x, y, 0.0), (x + 0.1, y, 0.0)])
        box = legend_of(expert).bounding_box()
        assert canvas["x"] <= box["x"] and box["x"] + box["width"] <= canvas["x"] + canvas["width"]
        assert bottom + 60 < box["y"] and box["y"] + box["height"] <= size[1], "with room for one more row"
        numbers = expert.locator("#fdcal-labels .number:visible", has_text=re.compile(r"^[\d.]+$")).filter(visible=True)
        assert numbers.count() >= 6
        for number in numbers.all()[:3]:
            at = number.bounding_box()
            value = x + (at["x"] + at["width"] / 2 - left) / (right - left) * 0.1
            assert value == pytest.approx(float(number.inner_text()), abs=0.004), "each number is at its value"
        for names, edge in ((RIGHT, size[0]), (LEFT, LEFT_WIDTH)):
            boxes = [expert.get_by_role("tab", name=name, exact=True).bounding_box() for name in names]
            assert len({box["y"] for box in boxes}) == 1
            ends = [box["x"] + box["width"] for box in boxes]
            assert all(end <= box["x"] + 0.5 for end, box in zip(ends, boxes[1:], strict=False)) and ends[-1] <= edge

    for size in (LARGE, DESKTOP):
        sized(expert, size)
        until(expert, lambda size=size: they_stand_there(size))


def legend_of(expert):
    return expert.locator(".fdcal-legend")


TYPE = f"<style>{STYLE.read_text(encoding='utf-8')}</style>"  # the style sheet sets the type


def test_long_words_leave_the_controls_where_they_are_and_can_be_scrolled(browser):
    narrow = browser.new_page(viewport={"width": 340, "height": 720})  # the page is as narrow as a panel
    words = "the residual of 10 of 63 microphones is large: " + "one cause, or another; " * 20
    mismatch = assessment("model_mismatch", words, evidence=Evidence(1.0, leave_one_out_db=-9.0))
    heights, hidden = [], []
    for found in (None, assessment("good", "short"), mismatch):
        narrow.set_content(f"{TYPE}<div id='box'>{verdict_html(found, pending=True)}</div>")
        heights.append(narrow.locator("#box").bounding_box()["height"])
        hidden.append(narrow.locator(".fdcal-verdict").evaluate("box => box.scrollHeight > box.clientHeight"))
    assert np.ptp(heights) < 1 and hidden == [False, False, True]
    narrow.get_by_text("-9.0 dB").scroll_into_view_if_needed()
    assert narrow.locator(".fdcal-verdict").evaluate("box => box.scrollTop") > 100
    narrow.close()


@pytest.fixture
def page(opened):
    sized(opened, DESKTOP)
    press(opened, "Explore")
    opened.locator("[data-region=bar] .first").wait_for()
    fills_the_window(opened)
    return opened


def fills_the_window(page):
    page.wait_for_function("document.querySelector('canvas[data-engine]').clientWidth == innerWidth")


def readable(page):
    def four_sizes():
        assert set(page.evaluate(SIZES)) <= {"12px", "14px", "18px"}, "and the words on the canvas: four in all"

    until(page, four_sizes)
    for scheme in ("dark", "light"):
        page.emulate_media(color_scheme=scheme)
        page.locator(f"html[data-mantine-color-scheme={scheme}]").wait_for()
        page.wait_for_function(f"({LOWEST_CONTRAST})()[0] >= {CONTRAST}", timeout=15_000)


def uncut(page):
    """Check that no text of the bar is cut in a window of any size."""
    for size in (LARGE, PHONE, DESKTOP):
        sized(page, size)
        page.wait_for_function(f"!{CUT}")


def answers_in_sight(page, step):
    def all_of_them():
        top, bottom, *answers = page.evaluate(ANSWERS)
        assert len(answers) == len(step.choices) and all(top < a < b <= bottom for a, b in answers)

    until(page, all_of_them)


def test_everything_in_explore_works_and_expert_has_the_panels_and_can_be_left(page, monkeypatch):
    monkeypatch.setattr(panels, "DOUBLING_TIME", 0.2)  # s: a slow browser can see that the solver runs
    page.faults.clear()
    page.get_by_role("tab", name="Map").wait_for(state="hidden")
    fills_the_window(page)
    page.locator("[data-do=modes]").press("Home")
    page.wait_for_function("location.hash.includes('modes=1&')")
    alone = page.locator("[data-do=alone]")
    page.locator("[data-do=alone][aria-pressed=false]").wait_for()
    alone.click()
    page.locator("[data-do=alone][aria-pressed=true]").wait_for()
    page.locator("[data-do=modes]").press("PageUp")
    page.wait_for_function("/modes=([2-9]|\\d\\d)&/.test(location.hash)")  # the map shows another single mode
    mode = page.locator("[data-do=modes] + output").inner_text().partition(",")[0].removeprefix("no. ")
    alone.click()
    page.locator("[data-do=modes] + output", has_text=f"1 to {mode}").wait_for()
    page.wait_for_function(f"location.hash.includes('modes=1-{mode}&')")
    page.locator("[data-do=microphone]").press("End")
    page.wait_for_function("location.hash.includes('microphone=15&')")
    press(page, "3-D")
    page.wait_for_function("location.hash.includes('map=relief') && location.hash.includes('view=')")
    press(page, "Top")
    page.wait_for_function("!/relief|view=/.test(location.hash)")
    page.get_by_text("misfit (dB)").wait_for()
    step = page.locator("[data-do='step=Step']")
    said = re.fullmatch(r"Move microphone (\d+) to its lowest point", step.inner_text())
    step.click()  # the step moves the named microphone, draws the move and names the next one
    page.get_by_text("moves by").wait_for()
    # The map shows the cost that the solver minimises.
    page.wait_for_function("!/modes=[\\d]|microphone/.test(location.hash)")
    page.wait_for_function(f"!document.querySelector(\"[data-do='step=Step']\").innerText.includes('{said[1]} ')")
    page.locator("[data-do=play]").click()
    page.locator("[data-do=play]", has_text="Pause").wait_for()
    page.get_by_text(re.compile("Converged, .* off on average")).wait_for()
    uncut(page)
    # The plot shows the cost of the run.
    page.wait_for_function("document.querySelector('.run path').getAttribute('d').length > 20")
    page.locator("[data-do='step=Step']:disabled").wait_for()
    page.locator("[data-do=state]").press("Home")
    page.get_by_text(re.compile("Start of a new run, .* off on average")).wait_for()
    page.locator("[data-do='step=Step']").click()
    page.locator("[data-do=state][max='1'][value='1']").wait_for()
    press(page, "All together")
    page.locator("[data-do^='method='][aria-pressed=true]", has_text="All together").wait_for()
    page.get_by_text("Move all microphones by one step").wait_for()
    press(page, "One at a time (the paper)")
    page.get_by_text(re.compile("Move microphone .* to its lowest point")).wait_for()
    page.locator("[data-do='step=Restart']").wait_for(state="detached")
    page.locator("[data-do=state]:disabled").wait_for()
    press(page, "Share")
    with page.expect_download() as download:
        page.get_by_role("button", name=re.compile("^Replay")).click()
    assert download.value.path().stat().st_size < 300_000
    page.keyboard.press("Escape")
    press(page, "Expert")
    page.get_by_role("tab", name="Map").wait_for()
    page.wait_for_function("location.hash.includes('layout=expert')")
    page.wait_for_function("document.querySelector('canvas[data-engine]').clientWidth < innerWidth - 600")
    readable(page)
    page.get_by_role("tab", name="Scene", exact=True).click()
    page.wait_for_function(f"({CUT_NAMES})().length == 0")
    press(page, "Explore")
    page.get_by_role("tab", name="Map").wait_for(state="hidden")
    assert page.faults == []


def test_a_lesson_is_a_caption_in_both_layouts_and_on_a_phone_and_what_was_before_comes_back(page):
    lesson = load_lesson(LESSON)
    step, caption = lesson.steps[0], page.locator("[data-region=caption]")
    page.locator("[data-do='step=Step']").click()
    page.locator("[data-do=state][max='1']").wait_for()
    page.locator("[data-do=microphone]").press("Home")
    page.wait_for_function("location.hash.includes('microphone=0')")
    press(page, "Lessons")
    page.locator(f"[data-do='lesson={LESSON}']").click()
    caption.get_by_text(step.question).wait_for()
    readable(page)
    letters = lambda: legend_of(page).get_by_text("estimate").bounding_box()["height"]  # noqa: E731
    small = letters()
    press(page, "Lessons")
    press(page, LECTURE)
    page.get_by_role("button", name="End lecture mode").wait_for()
    assert letters() > 1.25 * small
    caption.get_by_text(step.question).wait_for()
    fills_the_window(page)
    for size in (DESKTOP, (1280, 600)):
        sized(page, size)
        answers_in_sight(page, step)
    page.get_by_role("button", name="Choose a scene").click()
    page.locator(".scenes button").first.wait_for()
    page.locator("[data-local=upload]").wait_for(state="hidden")
    page.keyboard.press("Escape")
    uncut(page)
    page.keyboard.press("h")  # the key also ends the lecture mode
    page.get_by_role("button", name="End lecture mode").wait_for(state="hidden")
    sized(page, PHONE)
    fills_the_window(page)

    def the_map_has_half_of_the_screen():
        boxes = [page.locator(f"[data-region={name}]").bounding_box() for name in ("caption", "bar")]
        assert min(box["y"] for box in boxes) >= PHONE[1] / 2

    until(page, the_map_has_half_of_the_screen)
    answers_in_sight(page, step)
    page.evaluate("document.querySelector('[data-region=caption] .text').scrollTop = 999")
    press(page, step.choices[0])
    caption.get_by_text("Not quite.").wait_for()
    page.wait_for_function("[...document.querySelectorAll('[data-region=caption], .text')].every(e => !e.scrollTop)")
    page.keyboard.press("j")  # no text field of the page takes the letter
    page.get_by_text(f"{lesson.title}, step 2 of 3").wait_for()
    page.keyboard.press("Shift+J")
    page.get_by_text(f"{lesson.title}, step 1 of 3").wait_for()
    sized(page, DESKTOP)
    press(page, step.choices[step.answer - 1])
    caption.get_by_text("Right.", exact=True).wait_for()
    press(page, "Next step")
    page.get_by_text(f"{lesson.title}, step 2 of 3").wait_for()
    end = page.get_by_role("button", name="End lesson", exact=True).element_handle()
    press(page, "Restore settings")
    end.click()  # the page replaces the answers above the button, but not the button
    caption.wait_for(state="hidden")
    page.locator("[data-do=state][max='1']").wait_for()
    page.wait_for_function("location.hash.includes('microphone=0')")
    press(page, "Lessons")
    page.locator(f"[data-do='lesson={LESSON}']", has_text="step 2 of 3").wait_for()
    page.keyboard.press("Escape")


def test_a_file_of_ones_own_is_sent_from_below_the_scenes_on_a_phone_too(page, tmp_path):
    (tmp_path / "broken.wav").write_bytes(b"RIFF" + bytes(3_000_000))
    sized(page, PHONE)
    page.get_by_role("button", name="Choose a scene").click()
    form = page.locator("#fdcal form")
    form.get_by_label("Recordings").set_input_files(tmp_path / "broken.wav")
    form.get_by_label("Temperature").fill("22")
    form.get_by_role("button", name="Open").click()
    form.get_by_text("broken.wav is not a sound file").wait_for()
    assert form.get_by_label("Temperature").input_value() == "22", "what is filled in stays"
    page.keyboard.press("Escape")
    sized(page, DESKTOP)
    fills_the_window(page)
