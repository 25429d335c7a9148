"""The faces Explore and Expert in a real browser: scenes, Play, lessons on the canvas, sizes, contrast."""

import re

import pytest
from browsing import press, until

from fdcal.session.lesson import load_lesson
from fdcal.viewer.explore import LECTURE

DESKTOP, PHONE = (1280, 720), (390, 844)
# Where a caption begins and where its buttons do, and from where to where each answer reaches, pixels.
ANSWERS = """() => {
    const [caption, steps, ...answers] = ["", " .steps", " .choices button"].flatMap(part =>
        [...document.querySelectorAll(`#fdcal [data-region=caption]${part}`)].map(e => e.getBoundingClientRect()));
    return [caption.top, steps.top, ...answers.map(one => [one.top, one.bottom])];
}"""
LESSON = "3_too_many_too_soon"
CONTRAST = 4.5  # at least, of a text and what is behind it (WCAG 2.2, 1.4.3)

# The lowest contrast of all texts that are seen, and that text.
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


# How many texts of the bar are cut.
CUT = """[...document.querySelectorAll("[data-region=bar] :is(b, small, button, label, output)")].filter(node =>
    node.checkVisibility({visibilityProperty: true}) && node.scrollWidth > node.clientWidth).length"""


@pytest.fixture(scope="module")
def page(opened):
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
    """No text of the bar is cut in a window of any size."""
    for size in ((1440, 900), PHONE, DESKTOP):
        sized(page, size)
        page.wait_for_function(f"!{CUT}")


def answers_in_sight(page, step):
    def all_of_them():
        top, bottom, *answers = page.evaluate(ANSWERS)
        assert len(answers) == len(step.choices) and all(top < a < b <= bottom for a, b in answers)

    until(page, all_of_them)


def test_everything_in_explore_works(page):
    page.get_by_role("tab", name="Map").wait_for(state="hidden")
    fills_the_window(page)
    readable(page)
    page.locator("[data-do=modes]").press("Home")
    page.wait_for_function("location.hash.includes('modes=1&')")
    alone = page.locator("[data-do=alone]")
    page.locator("[data-do=alone][aria-pressed=false]").wait_for()
    alone.click()
    page.locator("[data-do=alone][aria-pressed=true]").wait_for()
    page.locator("[data-do=modes]").press("PageUp")
    page.wait_for_function("/modes=([2-9]|\\d\\d)&/.test(location.hash)")  # another one alone
    mode = page.locator("[data-do=modes] + output").inner_text()
    alone.click()
    page.locator("[data-do=modes] + output", has_text=f"1 to {mode}").wait_for()
    page.wait_for_function(f"location.hash.includes('modes=1-{mode}&')")
    page.locator("[data-do=microphone]").press("End")
    page.wait_for_function("location.hash.includes('microphone=15&')")
    press(page, "3-D")
    page.wait_for_function("location.hash.includes('map=relief') && location.hash.includes('view=')")
    press(page, "Top")
    page.wait_for_function("!/relief|view=/.test(location.hash)")
    page.locator("[data-do=play]").click()
    page.wait_for_function("!/modes=[\\d]/.test(location.hash)")  # the map is that of the modes in use
    page.locator("[data-do=play]", has_text="Play again").wait_for()
    page.get_by_text(re.compile("Converged, .* off on average")).wait_for()
    uncut(page)
    page.wait_for_function("document.querySelector('.run path').getAttribute('d').length > 20")  # cost along the run
    page.locator("[data-do=onestep]:disabled").wait_for()
    page.locator("[data-do=state]").press("Home")
    page.get_by_text(re.compile("Paused, .* off on average")).wait_for()
    page.locator("[data-do=onestep]").click()
    page.locator("[data-do=state][max='1']").wait_for()
    press(page, "Start again")
    page.locator("[data-do=restart]").wait_for(state="detached")
    page.locator("[data-do=state]:disabled").wait_for()


def test_a_lesson_is_a_caption_in_both_faces_and_on_a_phone_and_what_was_before_comes_back(page):
    lesson = load_lesson(LESSON)
    step, caption = lesson.steps[0], page.locator("[data-region=caption]")
    page.locator("[data-do=onestep]").click()
    page.locator("[data-do=state][max='1']").wait_for()
    page.locator("[data-do=microphone]").press("Home")
    page.wait_for_function("location.hash.includes('microphone=0')")
    press(page, "Lessons")
    page.locator(f"[data-do='lesson={LESSON}']").click()
    caption.get_by_text(step.question).wait_for()
    readable(page)
    press(page, "Lessons")
    press(page, LECTURE)
    page.get_by_role("button", name="End lecture mode").wait_for()
    caption.get_by_text(step.question).wait_for()
    fills_the_window(page)
    for size in (DESKTOP, (1280, 600)):
        sized(page, size)
        answers_in_sight(page, step)
    page.get_by_role("button", name="Choose a scene").click()
    page.locator(".scenes button").first.wait_for()
    page.locator("[data-local='tab:Open']").wait_for(state="hidden")  # there are no panels that it could lead to
    page.keyboard.press("Escape")
    uncut(page)
    press(page, "End lecture mode")
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
    page.keyboard.press("j")  # nothing on the page takes it as a letter
    page.get_by_text(f"{lesson.title}, step 2 of 3").wait_for()
    page.keyboard.press("Shift+J")
    page.get_by_text(f"{lesson.title}, step 1 of 3").wait_for()
    sized(page, DESKTOP)
    press(page, step.choices[1])
    caption.get_by_text("Right.", exact=True).wait_for()
    end = page.get_by_role("button", name="End lesson", exact=True).element_handle()
    press(page, "Restore settings")
    end.click()  # the answers above it go and come meanwhile, and it is still what it was
    caption.wait_for(state="hidden")
    page.locator("[data-do=state][max='1']").wait_for()
    page.wait_for_function("location.hash.includes('microphone=0')")
    press(page, "Lessons")
    page.locator(f"[data-do='lesson={LESSON}']", has_text="step 1 of 3").wait_for()
    page.keyboard.press("Escape")


# Whether a button of a panel lies within the window, and nothing covers it.
BUTTON_SEEN = """name => {
    const button = [...document.querySelectorAll("#root button")].find(one => one.innerText.trim() == name);
    const {left, top, width, height} = button?.getBoundingClientRect() ?? {};
    return button?.contains(document.elementFromPoint(left + width / 2, top + height / 2));
}"""
# Names of controls, in which a word is wider than its room.
CUT_NAMES = """() => [...document.querySelectorAll("#root label")].filter(label => label.offsetWidth).filter(label => {
    const pen = document.createElement("canvas").getContext("2d"), room = label.parentElement.clientWidth;
    pen.font = getComputedStyle(label).font;
    return label.innerText.split(/\\s/).some(word => pen.measureText(word).width > room);
}).map(label => label.innerText)"""


def test_ones_own_recording_is_the_last_of_the_scenes_on_a_phone_too(page):
    for size in (DESKTOP, PHONE):
        sized(page, size)
        page.get_by_role("button", name="Choose a scene").click()
        page.locator(".scenes button").last.get_by_text("Your own recording").click()
        page.get_by_role("tab", name="Open", selected=True).wait_for()
        page.wait_for_function(BUTTON_SEEN, arg="Open file")
        press(page, "Explore")
    sized(page, DESKTOP)
    fills_the_window(page)


def test_expert_has_the_panels_and_can_be_left(page):
    page.evaluate("delete document.documentElement.dataset.sheet")
    press(page, "Expert")
    page.get_by_role("tab", name="Map").wait_for()
    page.wait_for_function("location.hash.includes('face=expert')")
    page.wait_for_function("document.querySelector('canvas[data-engine]').clientWidth < innerWidth - 600")
    readable(page)
    page.get_by_role("tab", name="Scene", exact=True).click()
    page.wait_for_function(f"({CUT_NAMES})().length == 0")
    press(page, "Explore")
    page.get_by_role("tab", name="Map").wait_for(state="hidden")


def sized(page, size):
    """Give the window a size, pixels."""
    page.set_viewport_size(dict(zip(("width", "height"), size, strict=True)))
    page.wait_for_function(f"innerWidth == {size[0]} && innerHeight == {size[1]}")
