"""The opening: its film is what the scene computes to, it ends with any touch, and the map stays on the canvas."""

import base64
import io
import re
import time

import numpy as np
import pytest
from browsing import COARSE, WAIT, serving_here
from PIL import Image

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.cost.maps import interpolate, map_minima, partial_sums
from fdcal.cost.reference_cost import ORDER_OFFSET
from fdcal.model.measurement_file import load_measurement
from fdcal.model.scene_file import load_scene
from fdcal.viewer import app, opening
from fdcal.viewer.gui.overlay import CanvasWords, Overlay
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


def test_the_picture_in_the_page_is_the_first_of_the_film():
    """Light and dark, with its words; `python docs/opening.py --still` writes it."""
    html, projector = app.STILL.read_text(), opening.Projector(opening.opening_request().measurement)
    assert re.search('data-words="(.*?)"', html)[1] == projector.film.at(0.0).words
    dark, light = (
        np.asarray(Image.open(io.BytesIO(base64.b64decode(data))), float) for data in re.findall('base64,(.*?)"', html)
    )
    for shipped, is_dark in ((light, False), (dark, True)):
        drawn = opening.still(projector, is_dark).astype(float)
        assert shipped.shape[:2] == drawn.shape[:2]
        solid = shipped[..., 3] > 0
        assert 0.4 < solid.mean() < 0.8, "the relief and its rulers alone"
        off = np.abs(shipped[..., :3] - drawn).max(axis=-1)[solid]
        assert np.mean(off > 40) < 0.03 and off.mean() < 7, "what the computation is drawn as"
    assert app.STILL.stat().st_size < 62_000


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
    assert "One frequency" in shown(), "it starts again for a browser that is alone"
    nodes.cameras._at_rest.add(3)
    plays.tick(words, 200.0)
    plays.tick(words, 200.0 + plays._projector.film.length)
    assert opening.FOUND in overlay._regions["words"].content and "Now you" in overlay._regions["words"].content
    overlay.receive(None, "stamp dismiss")  # by any key, or by its button
    plays.tick(words, 300.0)
    words.show("trapped", "0 of 1 home", {"Continue": lambda: pytest.fail("Escape presses no button of these")})
    overlay.receive(None, "stamp dismiss")
    assert not plays.playing and opening.FOUND not in overlay._regions["words"].content
    nodes.show(plays._projector.picture(plays._projector.film.at(0.0)))
    server.scene.reset()
    server.gui.reset()


STILL, STILL_TAG = "(document.getElementById('fdcal-still') != null)", 'id="fdcal-still"'
SHOWN = "() => document.querySelector('[data-region=words]').innerText"
RELIEF = "() => (window.__viserMutable?.nodeRefFromName?.['/relief']?.children.length ?? 0) > 0"


def test_the_page_opens_with_the_film_and_shows_the_session_when_it_is_skipped(browser, kernels, capsys):
    with serving_here() as url:
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.set_default_timeout(WAIT * 1e3)
        page.goto(f"{url}/{COARSE.partition('#')[0]}", wait_until="domcontentloaded")
        assert page.evaluate(f"[{STILL}, ({SHOWN})()]") == [True, "One frequency: 8 places fit"], "before any message"
        page.wait_for_function(f"() => {STILL} || ({RELIEF})()")
        page.wait_for_function(f"() => !{STILL} && ({RELIEF})()")
        assert STILL_TAG not in page.request.get(url).text(), "the film has begun: it stands at another picture"
        page.evaluate("location.hash = 'face=expert'")
        paused = page.get_by_text("Paused", exact=True)
        assert not paused.count() or not paused.first.is_visible()
        page.keyboard.press("Escape")
        paused.first.wait_for()
        page.wait_for_function(f"() => ({SHOWN})() == '' && ({RELIEF})()")
        angle = "window.__viserMutable.cameraControl.polarAngle"
        page.evaluate("location.hash = 'face=explore'")
        page.get_by_role("button", name="3-D", exact=True).wait_for()
        while page.evaluate(angle) < 1.4:  # a face that has just changed may place the camera once more
            page.mouse.move(30, 200)
            page.mouse.down()
            page.mouse.move(30, -1200, steps=4)
            page.mouse.up()
            page.wait_for_timeout(500)
        assert page.evaluate(angle) < np.pi / 2, "above the floor"
        page.get_by_role("button", name="3-D", exact=True).click()
        page.wait_for_function(f"{angle} < 1")
        page.close()
    assert "Traceback" not in capsys.readouterr().err
