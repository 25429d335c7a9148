"""Lessons in a real browser: chosen, answered and left with buttons, and with keys."""

import pytest
from browsing import choose, opened_page, press, serving_here, slider, tab, unfold

from fdcal.model.scene_file import load_scene
from fdcal.session.lesson import load_lesson
from fdcal.session.scene_edits import edited

LESSON = "3_too_many_too_soon"


@pytest.fixture(scope="module")
def page(kernels, browser):
    """The page of `tiny`, solved by descent."""
    slow = edited(load_scene("tiny"), {"solver.name": "descent"})
    with serving_here(slow, lessons=(load_lesson(LESSON),)) as address:
        page = opened_page(browser, address)
        yield page
        page.close()


def test_a_lesson_is_taken_with_clicks_and_keys_and_left(page):
    lesson = load_lesson(LESSON)
    press(page, "Step")
    page.get_by_text("step 1, sweep 0").wait_for()
    tab(page, "Map")
    handle = slider(page, "Microphone")
    handle.focus()
    handle.press("Home")
    unfold(page, "Scale and quantity")
    choose(page, "Scale", "Linear")
    page.get_by_text("microphone 0, ").first.wait_for()
    press(page, "Lessons")
    press(page, lesson.title)
    page.get_by_text(lesson.steps[0].question).wait_for()
    page.get_by_text("step 0, sweep 0").wait_for()
    press(page, lesson.steps[0].choices[0])  # a wrong answer, in its own words
    page.get_by_text(f"The answer is: {lesson.steps[0].choices[1]}.").wait_for()
    page.keyboard.press("j")  # nothing on the page takes it as a letter
    page.get_by_text(f"{lesson.title}, step 2 of 3").wait_for()
    page.keyboard.press("Shift+J")
    page.get_by_text(f"{lesson.title}, step 1 of 3").wait_for()
    page.get_by_text(lesson.steps[0].question).wait_for()
    end = page.get_by_role("button", name="End lesson", exact=True).element_handle()
    press(page, "Restore settings")
    end.click()  # the answers above it go and come meanwhile, and it is still what it was
    page.locator("[data-region=caption]").wait_for(state="hidden")
    page.get_by_text("step 1, sweep 0").wait_for()
    tab(page, "Map")
    page.get_by_text("microphone 0, ").first.wait_for()
    number = page.get_by_text("Scale", exact=True).get_attribute("for")
    assert page.locator(f"[id='{number}']").input_value() == "Linear"
