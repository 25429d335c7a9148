"""The sweep of modes and the cut through the map in a real browser."""

import re

import numpy as np
import pytest
from browsing import COARSE, EXACT, WAIT, hover, on_screen, press, serving_here, slider, stands, tab, unfold

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.model.scene_file import load_scene


@pytest.fixture(scope="module")
def scene():
    return load_scene("tiny")


@pytest.fixture
def query():
    return COARSE


@pytest.fixture
def page(browser, kernels, scene, capsys, query):
    """The page of `tiny`, fresh for each test."""
    with serving_here(scene) as url:
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.set_default_timeout(WAIT * 1e3)
        page.goto(f"{url}/{query}")
        yield page
        page.close()
    assert "Traceback" not in capsys.readouterr().err


def test_play_pause_and_the_slider_of_the_sweep(page):
    tab(page, "Map")
    page.get_by_text("Order and speed", exact=True).click()
    slider(page, "Modes per second").press("Home")  # so slowly that no machine sees the end before Pause
    press(page, "Play")
    page.get_by_text(re.compile("sum of [2-9] modes")).first.wait_for()
    press(page, "Pause")
    page.get_by_role("button", name="Play", exact=True).wait_for()
    handle = slider(page, "Modes summed")
    handle.focus()
    handle.press("Home")
    page.get_by_text(re.compile(r"mode \d+ alone")).first.wait_for()
    handle.press("ArrowRight")
    page.get_by_text(re.compile(r"sum of 2 modes")).first.wait_for()
    page.locator(".uplot", has_text="Local minima of the sum").first.wait_for()


@pytest.mark.parametrize("query", [EXACT])
def test_an_end_of_the_cut_is_dragged_and_the_plot_follows(page, scene):
    page.get_by_text("step 0, sweep 0").wait_for()
    tab(page, "Map")
    unfold(page, "Cut")
    press(page, "x")
    text = page.get_by_text(re.compile(r"lowest [\d.]+ m from A")).first
    text.wait_for()
    before = text.inner_text()
    problem, solver = cached_measurement(scene).problem("unit"), solvers.load(scene.solver.name)
    start = solver.init(problem, solvers.with_mode_count(problem, scene.solver), scene.seed).positions
    search, height = scene.search, float(start[problem.free[0], 1])
    low, high = search.origin[0], search.origin[0] + search.step * (search.shape[0] - 1)
    stands(page, "/cut", [(low + high) / 2, height], 2e-3)
    target = [low, height + 0.15]
    here, there = on_screen(page, scene, np.array([[low, height, 0.0], [*target, 0.0]]))
    hover(page, here)
    page.mouse.down()
    page.mouse.move(*there, steps=8)
    page.mouse.up()
    stands(page, "/cut", [(low + high) / 2, height + 0.075], 5e-3)
    page.wait_for_function("text => !document.body.innerText.includes(text)", arg=before)
