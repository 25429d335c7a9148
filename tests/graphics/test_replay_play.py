"""A replay works without Python: a dragged microphone rolls into its minimum, and descent takes steps."""

import math

import numpy as np
import pytest
from browsing import WAIT
from replays import descent_on_tiny, offline_page, wait_for

from fdcal.cost.eq7 import known_weights, reference_cost_of
from fdcal.cost.maps import mode_powers
from fdcal.graphics.replay import replay_html
from fdcal.solvers import descent

MICROPHONE = 8
ADDRESS = f"#step=0&microphone={MICROPHONE}&modes=1-3&view=top"


@pytest.fixture(scope="module")
def run():
    return descent_on_tiny(5)


@pytest.fixture(scope="module")
def path(run, tmp_path_factory):
    scene, measurement, problem, states = run
    path = tmp_path_factory.mktemp("play") / "play.html"
    text = replay_html(scene, measurement, states, "Play", reference_cost_of(problem), problem=problem)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def opened(browser, path):
    with offline_page(browser, path, ADDRESS, f"window.replay?.map?.n == {MICROPHONE}") as page:
        page.set_default_timeout(WAIT * 1e3)
        yield page


@pytest.fixture
def page(opened):
    """The page of all of these tests, with the recording as it was."""
    opened.evaluate(f"document.getElementById('back').click(); location.hash = 'step=1'; location.hash = '{ADDRESS}'")
    wait_for(opened, f"!replay.own && replay.map?.n == {MICROPHONE} && replay.map.indices.length == 3")
    return opened


def drag(page, across, up):
    """Press the mouse at the microphone and move it, pixels."""
    box, place = page.locator("#view").bounding_box(), page.evaluate("n => replay.drawn(n)", MICROPHONE)
    page.mouse.move(box["x"] + place[0], box["y"] + place[1])
    page.mouse.down()
    page.mouse.move(box["x"] + place[0] + across, box["y"] + place[1] - up, steps=4)


def place_and_distance(page, truth):
    """Where the microphone is now, and how far from its true position: metres, and as the page writes it."""
    place = np.array(page.evaluate(f"replay.own.places[{MICROPHONE}]"))[:2]
    away = np.linalg.norm(place - truth)
    return place, f"{1e3 * away:.0f} mm" if away < 0.0995 else f"{100 * away:.0f} cm"


@pytest.mark.parametrize("modes", [3, 20])
def test_a_step_in_the_browser_is_a_step_of_descent(page, run, modes):
    """This holds below and above the number of modes from which the order is larger."""
    _, measurement, problem, states = run
    state = descent.use_modes(problem, states[0], 1, modes, False)
    for _ in range(3):
        after = descent.step(problem, state)
        places = np.column_stack([state.positions, np.zeros(measurement.count)]).tolist()
        found = page.evaluate("([n, x, high]) => replay.descentStep(n, x, 1, high)", [after.moved, places, modes])
        np.testing.assert_allclose(found[:2], after.positions[after.moved], atol=1e-6)
        state = after
    power = "([n, x, weights]) => [{weights}, {}].map(terms => replay.landscapes.map(0, n, x.flat(), 0, terms).power)"
    # microphone 0 is known
    own, plain = page.evaluate(power, [0, places, known_weights(problem, state.settings.known_weight).tolist()])
    wanted = np.divide(*(mode_powers(problem, descent, state, [1], offset) for offset in (None, 0)))
    np.testing.assert_allclose(own / plain, wanted, rtol=1e-3, err_msg="the map in decibels has the same reference")


def test_a_released_microphone_rolls_downhill_into_a_minimum_that_is_named(page, run):
    truth = run[1].positions[MICROPHONE]
    drag(page, 30, 20)
    wait_for(page, "replay.own?.words.endsWith('dB')")
    path = np.array(page.evaluate("replay.own.path"))
    costs = page.evaluate("path => path.map(place => replay.level(replay.map, place))", path.tolist())
    assert np.all(np.diff(costs[:-1]) < 1e-9), "downhill all the way"
    page.mouse.up()
    wait_for(page, "replay.own.tries == 1")
    end, off = place_and_distance(page, truth)
    np.testing.assert_allclose(end, path[-1])
    minima = page.evaluate("[...replay.map.minima.lowest, ...replay.map.minima.others]")
    assert np.linalg.norm(np.array(minima) - end, axis=1).min() < 1e-9, "a minimum that the map marks"
    # whether it is in the minimum of the true position
    home = np.linalg.norm(end - page.evaluate("x => replay.downhill(replay.map, x).at(-1)", [*truth, 0.0])) < 0.01
    said = page.evaluate("replay.own.words"), page.locator("#tries").inner_text()
    reached = f"Reached the true position within {math.ceil(1e3 * np.linalg.norm(end - truth))} mm"
    assert said == (reached if home else f"Trapped, {off} off", f"{int(home)} of 1 drop reached the true position")


# Return a point of the map from which the path downhill ends at its edge.
TO_THE_EDGE = """() => {
    const {lattice, minima} = replay.map, marked = [...minima.lowest, ...minima.others];
    const apart = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);
    for (const x of lattice.places[0]) for (const y of lattice.places[1]) {
        const end = replay.downhill(replay.map, [x, y]).at(-1);
        if (!marked.some(place => apart(place, end) < 2.5 * lattice.step)) return [x, y];
    }
}"""


def test_a_microphone_that_stops_at_the_edge_of_the_map_is_in_no_minimum(page, run):
    drag(page, 10, 0)
    page.evaluate(f"([x, y]) => replay.own.places[{MICROPHONE}].splice(0, 2, x, y)", page.evaluate(TO_THE_EDGE))
    homes = page.evaluate("replay.own.reached")
    page.mouse.up()
    wait_for(page, "replay.own.words.endsWith('off')")
    _, off = place_and_distance(page, run[1].positions[MICROPHONE])
    assert page.evaluate("[replay.own.words, replay.own.reached]") == [f"At the edge of the map, {off} off", homes]


def test_a_sweep_moves_all_and_the_recorded_run_can_be_shown_again(page, run):
    _, measurement, problem, states = run
    page.get_by_role("button", name="Sweep").click()
    free = problem.free.tolist()
    places = np.array(page.evaluate("replay.own.places"))[:, :2]
    steps = (places[free] - problem.search.origin) / problem.search.step
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6, err_msg="on the lattice")
    np.testing.assert_allclose(places[problem.known], problem.known_positions, atol=1e-6)
    assert not np.allclose(places[free], states[0].positions[free])
    page.get_by_role("button", name="Back to the recorded run").click()
    shown = np.array([page.evaluate("n => replay.placeOf(0, n)", n) for n in range(measurement.count)])[:, :2]
    np.testing.assert_allclose(shown, states[0].positions, atol=1e-6)
    assert page.evaluate("replay.own") is None


def test_the_opening_counts_the_places_that_fit_and_ends_with_any_touch(page):
    address = page.url.partition("#")[0]
    page.goto("about:blank")  # otherwise the page could write an address before it is loaded again
    page.goto(f"{address}#step=0&microphone={MICROPHONE}&modes=17&view=top&opening=on")
    wait_for(page, "document.getElementById('words').innerText.startsWith('One frequency')")
    count = page.evaluate("replay.map.minima.count")
    said = page.locator("#words").inner_text()
    assert said == f"One frequency: {'1 place fits' if count == 1 else f'{count} places fit'}"
    page.keyboard.press("t")
    wait_for(page, "document.getElementById('words').innerText == ''")
    assert page.evaluate("replay.map.indices.length") == 1 and page.locator("#note").inner_text() == ""
