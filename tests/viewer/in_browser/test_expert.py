"""Expert in a real browser: steps, dragging, maps, plan, files, a solver that fails."""

import csv
import io
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from browsing import (
    WAIT,
    begin_anew,
    choose,
    hover,
    middle,
    on_screen,
    pick,
    press,
    slider,
    stands,
    tab,
    unfold,
)
from PIL import Image
from replays import contents

from fdcal.acoustics.measure import cached_measurement
from fdcal.cost.expansion import ORDER_OFFSET
from fdcal.cost.maps import cost_maps, map_positions, refined
from fdcal.graphics.picture import compose
from fdcal.session import session_file
from fdcal.solvers import descent
from fdcal.viewer import session_view
from fdcal.viewer.tabs import view as exports


@pytest.fixture
def page(opened):
    """The page with the solver at its start, and the map of the modes in use."""
    begin_anew(opened)
    opened.evaluate("document.activeElement.blur()")
    opened.keyboard.press("u")
    return opened


DRAWN = "name => window.__viserMutable?.nodeRefFromName?.[name] != null"
GONE = "name => window.__viserMutable?.nodeRefFromName?.[name] == null"


def pick_known(page, scene):
    """Click at microphone 5, which is known and stands at its true place, with the tab Map open."""
    pick(page, scene, cached_measurement(scene).positions[5], "microphone 5, ")


def test_a_microphone_is_picked_by_a_click(page, scene):
    tab(page, "Map")
    pick_known(page, scene)
    assert not page.get_by_label("Follow solver").is_checked()


def test_the_diamond_marks_the_lowest_cost(page, scene):
    tab(page, "Map")
    pick_known(page, scene)
    choose(page, "Modes shown", "Custom")
    page.locator("//label[.='Mode numbers']/following::input[1]").first.fill("2-4, 6")
    page.keyboard.press("Enter")
    page.get_by_text("microphone 5, sum of 4 modes").wait_for()
    problem = cached_measurement(scene).problem("unit")
    state = descent.init(problem, scene.solver, 0)  # what the page shows
    fine = refined(scene.search)
    cost = cost_maps(problem, descent, state, 5, (2, 3, 4, 6), ORDER_OFFSET, fine).sum(axis=0)
    lowest = map_positions(np.array([np.unravel_index(cost.argmin(), cost.shape)]), fine)[0]
    stands(page, "/lowest", lowest.tolist(), 1e-4)


def test_dragging_with_shift_keeps_the_map_of_the_selected_one(page, scene):
    truth = cached_measurement(scene).positions
    target = truth[7] + [0.1, -0.06]  # a known microphone stands at its true place; it moves once it is released
    tab(page, "View")
    page.get_by_text("Release known", exact=True).click()
    tab(page, "Map")
    pick_known(page, scene)
    page.get_by_text("cost at the estimate").first.wait_for()
    before = page.get_by_text("cost at the estimate").first.inner_text()
    start, end = on_screen(page, scene, np.column_stack([[truth[7], target], [0.0, 0.0]]))
    hover(page, start)
    page.keyboard.down("Shift")
    page.mouse.down()
    for share in np.linspace(0.1, 1, 8):
        page.mouse.move(*(start + share * (end - start)))
    page.wait_for_function("text => !document.body.innerText.includes(text)", arg=before)
    page.mouse.up()
    page.keyboard.up("Shift")
    page.get_by_text("microphone 5, ").first.wait_for()
    pick(page, scene, target, "microphone 7, ")  # it is there now
    stands(page, "/microphones/ball", target.tolist(), 0.005)


def test_a_microphone_that_is_let_go_rolls_into_its_minimum_and_the_page_says_where(page, scene):
    def ball():  # where it stands now: after a reset it may still be drawn at its place before
        return np.array([*middle(page, "/microphones/ball"), 0.0])

    hover(page, lambda: on_screen(page, scene, [ball()])[0])
    away = on_screen(page, scene, [ball() + [-0.05, 0.04, 0.0]])[0]
    page.mouse.down()
    page.mouse.move(*away, steps=6)
    page.get_by_text(re.compile(r"^-[\d.]+ dB$")).first.wait_for()
    page.mouse.up()
    page.get_by_text(re.compile(r"^(home|trapped|at the edge of the map), [\d.]+ [cm]m off$")).first.wait_for()
    page.get_by_text(re.compile(r"^[01] of 1 home$")).wait_for()
    page.get_by_role("button", name="Continue from here").press("Enter")  # a notice of the browser may lie above it
    page.get_by_text("Converged").first.wait_for()


def test_the_bound_of_a_plan_follows_a_dragged_microphone_and_the_controls(page, scene):
    def summary():
        return page.locator("li", has_text="least error").inner_text()

    truth = cached_measurement(scene).positions
    tab(page, "Plan")
    page.wait_for_function(GONE, arg="/ellipses")
    page.get_by_label("Show the plan").click()
    page.wait_for_function(DRAWN, arg="/ellipses")
    page.wait_for_function(GONE, arg="/microphones/estimate")
    page.get_by_text("step 0, sweep 0").wait_for()

    before, target = summary(), truth[5] + [-0.06, 0.05]
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


def test_an_end_of_a_cut_is_dragged_and_the_plot_follows(page, scene):
    tab(page, "Map")
    pick_known(page, scene)
    unfold(page, "Cut")
    press(page, "x")
    text = page.get_by_text(re.compile(r"lowest [\d.]+ m from A")).first
    text.wait_for()
    before, search = text.inner_text(), scene.search
    low, height = search.origin[0], float(cached_measurement(scene).positions[5, 1])
    high = low + search.step * (search.shape[0] - 1)
    stands(page, "/cut", [(low + high) / 2, height], 2e-3)
    up = 0.15 if height < search.origin[1] + search.size[1] / 2 else -0.15
    here, there = on_screen(page, scene, np.array([[low, height, 0.0], [low, height + up, 0.0]]))
    hover(page, here)
    page.mouse.down()
    page.mouse.move(*there, steps=8)
    page.mouse.up()
    stands(page, "/cut", [(low + high) / 2, height + up / 2], 5e-3)
    page.wait_for_function("text => !document.body.innerText.includes(text)", arg=before)
    press(page, "None")
    unfold(page, "Cut")


def test_run_becomes_pause(page):
    page.faults.clear()
    page.get_by_text("step 0, sweep 0").wait_for()
    page.evaluate(
        """() => {
            window.seen = [];
            window.widths = new Set();
            const measure = () => {
                if (!window.widths) return;
                for (const plot of document.querySelectorAll(".uplot"))
                    if (plot.checkVisibility()) window.widths.add(plot.offsetWidth);
                requestAnimationFrame(measure);
            };
            measure();
            const look = () => {
                const texts = [...document.querySelectorAll("button")].map(button => button.innerText.trim());
                const now = ["Run", "Pause"].filter(text => texts.includes(text) && window.seen.at(-1) != text);
                window.seen.push(...now);
            };
            look();
            new MutationObserver(look).observe(document.body, {subtree: true, childList: true, characterData: true});
        }"""
    )
    press(page, "Run")
    page.get_by_text(re.compile(r"onverged")).first.wait_for()  # tiny is done in seconds
    page.get_by_role("button", name="Run", exact=True, disabled=True).wait_for()  # a finished run has nothing to run
    page.get_by_role("button", name="Step", exact=True).wait_for(state="detached")
    assert page.evaluate("window.seen") == ["Run", "Pause", "Run"]
    assert page.evaluate("Math.min(...window.widths)") > 200, "the curves keep their width while they are drawn"
    page.evaluate("window.widths = null")  # ends `measure`, which would go on in the tests after this one
    assert page.faults == []
    press(page, "Reset")
    page.get_by_text("step 0, sweep 0").wait_for()


def test_a_button_that_is_pressed_as_the_verdict_comes_stays_below_the_pointer(page, monkeypatch):
    monkeypatch.setattr(session_view, "VERDICT_DELAY", 1.5)  # s, in which the mouse is pressed
    press(page, "Run")
    page.get_by_text("Assessing the result").wait_for()
    button = page.get_by_role("button", name="Reset", exact=True)
    page.get_by_role("button", name="Step", exact=True).wait_for(state="detached")
    button.hover()
    page.mouse.down()
    page.locator(".fdcal-verdict").wait_for()
    page.mouse.up()
    page.get_by_text("step 0, sweep 0").wait_for()


def test_the_solver_continues_from_a_rewound_state(page):
    press(page, "Sweep")
    page.get_by_text("step 13, sweep 1").wait_for()
    handle = slider(page, "State")
    handle.focus()
    handle.press("Home")
    page.get_by_text("step 0, sweep 0").wait_for()
    handle.press("ArrowRight")
    page.get_by_text("step 1, sweep 0").wait_for()
    press(page, "Step")
    page.get_by_text("step 2, sweep 0").wait_for()


def test_a_slider_sets_the_modes_in_use(page):
    unfold(page, "Settings")
    handle = slider(page, "Last mode")
    handle.focus()
    handle.press("ArrowRight")
    page.get_by_text(re.compile(r"^modes 1 to 4, ")).wait_for()
    unfold(page, "Settings")


def test_the_spectrum_and_the_snapshot_follow_the_modes_of_the_map(page):
    tab(page, "Map")
    choose(page, "Modes shown", "Custom")
    handle = slider(page, "Up to mode")
    handle.focus()
    handle.press("ArrowRight")
    handle.press("ArrowRight")
    page.get_by_text("sum of 5 modes").first.wait_for()
    unfold(page, "Spectrum")
    page.get_by_text("highest in the map: mode 5").first.wait_for()
    unfold(page, "Spectrum")
    choose(page, "Show", "Mode shape (last mode)")
    page.get_by_text("pressure of mode 5").first.wait_for()
    choose(page, "Show", "Flat map")


def test_the_relief_takes_the_place_of_the_flat_map(page, scene):
    x0, y0, x1, y1 = compose(scene, cached_measurement(scene)).focus
    tab(page, "Map")
    choose(page, "Show", "Relief")
    stands(page, "/relief", [(x0 + x1) / 2, (y0 + y1) / 2], scene.search.step)
    choose(page, "Show", "Flat map")
    stands(page, "/floor", [(x0 + x1) / 2, (y0 + y1) / 2], scene.search.step)


def saved(page, label):
    """Name and content of a file that the page saves."""
    choose(page, "File", label)
    with page.expect_download(timeout=3 * WAIT * 1e3) as download:  # drawn by a program of its own
        press(page, "Save")
    return download.value.suggested_filename, Path(download.value.path()).read_bytes()


def test_every_file_is_saved_and_can_be_read(page, tmp_path, require_gl):
    import pyvista

    press(page, "Sweep")
    page.get_by_text("step 13, sweep 1").wait_for()
    tab(page, "View")
    files = {}
    for label in exports.KINDS:
        name, files[label] = saved(page, label)
        assert name.startswith("fdcal-tiny-step-13") and name.endswith(exports.KINDS[label].ending)
        (tmp_path / name).write_bytes(files[label])
    picture, png, svg, _, table, _, replay, _ = files.values()
    image = Image.open(io.BytesIO(picture))
    assert image.size == (1280, 800)
    assert len(np.unique(np.asarray(image.convert("RGB")).reshape(-1, 3), axis=0)) > 100
    assert Image.open(io.BytesIO(png)).size > (800, 600) and ElementTree.fromstring(svg).tag.endswith("svg")
    session = session_file.read(tmp_path / "fdcal-tiny-step-13-session.zip")
    state, measurement = session.states[session.index], session.measurement
    assert (state.step, len(session.states)) == (13, 14)
    rows = list(csv.DictReader(io.StringIO(table.decode())))
    assert np.array_equal([[float(row["x_m"]), float(row["y_m"])] for row in rows], state.positions)
    cloud = pyvista.read(tmp_path / "fdcal-tiny-step-13-microphones.vtp")
    assert np.array_equal(cloud.points[cloud["kind"] == 0][:, :2], state.positions)
    assert np.array_equal(cloud.points[cloud["kind"] == 1][:, :2], measurement.positions)
    grid = pyvista.read(tmp_path / "fdcal-tiny-step-13-map.vti")
    assert grid.dimensions == (500, 500, 1) and np.isfinite(grid["sum"]).all()
    data, arrays, places = contents(replay.decode())
    assert np.abs(places - [one.positions for one in session.states]).max() < 1e-8
    assert data["maps"]["modes"] and "pressures" in arrays, "the replay of the page maps the cost, too"


def test_modes_are_added_up_paused_and_set_by_a_slider(page):
    tab(page, "Map")
    unfold(page, "Order and speed")
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
    unfold(page, "Order and speed")


def test_an_exception_of_the_solver_is_shown_with_the_path_of_the_log_and_the_page_works_on(page, monkeypatch):
    step = descent.step

    def failing(problem, state):
        if state.step == 4:
            raise ZeroDivisionError("the floor <b>opens</b>")
        return step(problem, state)

    monkeypatch.setattr(descent, "step", failing)
    press(page, "Run")
    page.get_by_text("Stopped by an error", exact=True).wait_for()
    shown = page.get_by_text("ZeroDivisionError: the floor <b>opens</b>; details in").inner_text()
    text = Path(shown.rpartition("details in ")[2].strip()).read_text(encoding="utf-8")
    assert "Traceback" in text and "the solver stopped at state 4" in text and "failing" in text
    page.get_by_text("step 4, sweep 0").wait_for()
    page.get_by_role("button", name="Run", exact=True).wait_for()  # it is paused
    press(page, "Reset")
    page.get_by_text("step 0, sweep 0").wait_for()
    page.get_by_text("ZeroDivisionError").wait_for(state="detached")
    press(page, "Step")
    page.get_by_text("step 1, sweep 0").wait_for()
    page.get_by_text("Paused").first.wait_for()
