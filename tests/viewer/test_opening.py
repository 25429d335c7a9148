"""The opening: its film is what the scene computes to, it ends with any touch, and the map stays on the canvas."""

import re
import time

import numpy as np
import pytest
from browsing import COARSE, WAIT, serving_here

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.cost.maps import interpolate, map_minima, partial_sums
from fdcal.cost.reference_cost import ORDER_OFFSET
from fdcal.model.measurement_file import load_measurement
from fdcal.model.scene_file import load_scene
from fdcal.viewer import opening
from fdcal.viewer.gui.overlay import Overlay
from fdcal.viewer.gui.words import CanvasWords
from fdcal.viewer.page import Page
from fdcal.viewer.scene3d.nodes import SceneNodes

TOLERANCE = 0.02  # dB, of the maps in the file, whose levels are 0.0025 dB apart


def test_the_files_hold_what_the_scene_computes_to():
    scene, film = load_scene(opening.SCENE), opening.film()
    measurement, shipped = cached_measurement(scene), load_measurement(opening.MEASUREMENT)
    for name in ("frequencies", "pressures", "wavenumbers", "positions", "known"):
        np.testing.assert_allclose(getattr(shipped, name), getattr(measurement, name), rtol=1e-9, err_msg=name)
    problem, solver = measurement.problem(), solvers.load(scene.solver.name)
    state = solver.init(problem, solvers.with_mode_count(problem, scene.solver), scene.seed)
    counts = film.summed.tolist()
    sums = partial_sums(problem, solver, state, opening.MICROPHONE, film.modes, ORDER_OFFSET, counts=counts)
    for one, decibels, minima in zip(sums, film.decibels, film.minima, strict=True):
        np.testing.assert_allclose(decibels, 10 * np.log10(one.cost), atol=TOLERANCE)
        there = opening.MICROPHONE, one.modes, ORDER_OFFSET, one.cost, problem.search
        computed = map_minima(problem, solver, state, *there)
        np.testing.assert_allclose(minima.lowest, computed.lowest, atol=1e-9)
        np.testing.assert_allclose(minima.others, computed.others, atol=1e-9)
    last = film.decibels[-1]
    heights = [interpolate(last, problem.search, place) for place in film.path]
    assert np.all(np.diff(heights) < TOLERANCE), "the microphone rolls downhill"
    np.testing.assert_allclose(film.path[-1], film.minima[-1].lowest[0])
    np.testing.assert_allclose(film.path[-1], measurement.positions[opening.MICROPHONE], atol=problem.search.step)
    assert sum(file.stat().st_size for file in (opening.MAPS, opening.MEASUREMENT)) < 600_000


def test_the_words_say_how_many_places_fit_and_three_quarters_of_the_time_have_several():
    film = opening.film()
    shown = [film.at(t) for t in np.arange(0, film.length + 1, 0.05)]
    numbers = [re.search(r"(\w+) frequenc\w+: (\d+) place", moment.words) for moment in shown]
    told = [(moment.index, int(match[2])) for moment, match in zip(shown, numbers, strict=True) if match]
    counts = [one.count for one in film.minima]
    assert all(places in counts[max(index - 1, 0) : index + 1] for index, places in told)
    assert [places for _, places in told] == sorted((places for _, places in told), reverse=True)
    assert counts[0] >= 5 and counts == sorted(counts, reverse=True) and counts[-1] == 1
    several = np.mean([places > 1 for _, places in told])
    assert 0.7 < several < 0.85
    assert shown[-1].words == opening.FOUND and shown[-1].share == 1
    np.testing.assert_allclose(shown[-1].place, film.path[-1])


@pytest.fixture
def opened(server, kernels):
    """A page that opens with the film, without a browser."""
    nodes = SceneNodes(server)
    made = Page(server, nodes, opening=opening.Opening(nodes))
    yield made
    made.close()
    server.gui.reset()
    server.scene.reset()


def test_no_session_is_shown_while_the_film_plays_and_the_map_stays_when_it_ends(opened):
    opened.open(opened._opening.request)
    drawn = []
    for _ in range(round(WAIT / 0.05)):
        opened.tick(time.perf_counter())
        drawn.append("relief" in opened.nodes.parts)
        if opened.switcher._current is not None and opened.switcher._current.done and len(drawn) > 20:
            opened.end_opening()
        if opened.viewer is not None and opened.viewer.snapshot.picture.floor.bar.label.endswith("mode 92"):
            break
        assert opened.viewer is None or not opened._opening.playing
        time.sleep(0.05)
    assert all(drawn), "never blank"
    assert opened.viewer.binding.choices.modes == (92,) and opened.viewer.binding.choices.style.relief


def test_the_film_waits_for_a_browser_and_ends_with_its_button(server):
    nodes, overlay = SceneNodes(server), Overlay(server.gui)
    words = CanvasWords(overlay)
    plays = opening.Opening(nodes)
    for now in (0.0, 60.0, 120.0):
        plays.tick(words, now)
    assert "One frequency" in overlay._regions["words"].content
    shown = lambda: overlay._regions["words"].content  # noqa: E731
    nodes.cameras._at_rest.add(1)
    for now in (180.0, 180.0 + plays._projector.film.length / 2):
        plays.tick(words, now)
    half = shown()
    assert "One frequency" not in half
    nodes.cameras._at_rest.add(2)
    plays.tick(words, 180.0 + plays._projector.film.length / 2)
    assert shown() == half, "a second browser joins it"
    nodes.cameras._at_rest.clear()
    plays.tick(words, 199.0)
    assert "One frequency" in shown(), "it begins anew for a browser that is alone"
    nodes.cameras._at_rest.add(3)
    plays.tick(words, 200.0)
    plays.tick(words, 200.0 + plays._projector.film.length)
    assert opening.FOUND in overlay._regions["words"].content and "Now you" in overlay._regions["words"].content
    words.press("Now you")
    plays.tick(words, 300.0)
    assert not plays.playing and opening.FOUND not in overlay._regions["words"].content
    nodes.show(plays._projector.picture(plays._projector.film.at(0.0)))
    server.scene.reset()
    server.gui.reset()


SHOWN = "() => document.querySelector('[data-region=words]').innerText"
RELIEF = "() => (window.__viserMutable?.nodeRefFromName?.['/relief']?.children.length ?? 0) > 0"


def test_the_page_opens_with_the_film_and_shows_the_session_when_it_is_skipped(browser, kernels, capsys):
    with serving_here() as url:
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.set_default_timeout(WAIT * 1e3)
        page.goto(f"{url}/{COARSE}")
        page.get_by_text("One frequency: 8 places fit").wait_for()
        page.wait_for_function(RELIEF)
        paused = page.get_by_text("Paused", exact=True)
        assert not paused.count() or not paused.first.is_visible()
        page.get_by_role("button", name="Skip").press("Enter")  # a notice of the browser may lie above it
        paused.first.wait_for()
        page.wait_for_function(f"() => ({SHOWN})() == '' && ({RELIEF})()")
        page.close()
    assert "Traceback" not in capsys.readouterr().err
