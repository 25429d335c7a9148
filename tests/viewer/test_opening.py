"""The opening: its film equals what the scene gives, each browser plays it until a touch, also on a phone."""

import json
import re

import numpy as np
import pytest
from browsing import COARSE, choose, serving_here, slowed_down, tab, trigger, until

from fdcal.cost.maps import cost_maps, map_positions
from fdcal.viewer import cost_maps as map_worker
from fdcal.viewer import opening, panels
from fdcal.viewer.explore import INVITATION
from fdcal.viewer.prepare import Preparation
from fdcal.viewer.state import initial_choices

EXPLORE = COARSE.partition("#")[0]


def test_the_words_say_how_many_places_fit_and_three_quarters_of_the_time_have_several():
    """`python -m benchmarks documents` compares the film with a new computation of its scene."""
    film = json.loads(re.search(r'json">(.*?)</script>', opening.film_html())[1])
    counts = [len(one["lowest"]) + len(one["others"]) for one in film["minima"]]
    assert counts[0] >= 5 and counts == sorted(counts, reverse=True) and counts[-1] == 1
    for words, count in zip(film["words"], counts, strict=True):
        assert f": {count} place" in words
    several = film["starts"][sum(count > 1 for count in counts)] / (film["starts"][-1] + film["roll"])
    assert 0.7 < several < 0.85
    # The ball ends at the minimum that was found.
    np.testing.assert_allclose(film["path"][-1], film["minima"][-1]["lowest"][0])
    assert opening.MEASUREMENT.stat().st_size < 200_000 and opening.FILM.stat().st_size < 65_000


def test_the_method_minimises_the_maps_of_the_film_in_its_order(kernels):
    prepared = Preparation(opening.opening_request())
    prepared.execute()
    run, n = prepared.run, opening.MICROPHONE
    view, choices = run.session.view, initial_choices(run, len(run.measurement.frequencies), None)
    request = choices.map_request(run, view, n)
    assert request.modes == (view.state.first,) == (view.state.last,) == (opening.MODE,)
    own, film = (
        cost_maps(run.problem, run.solver, view.state, n, request.modes, order, run.problem.search)[0]
        for order in (request.order_offset, 2)
    )
    np.testing.assert_allclose(10 * np.log10(own / film), 0, atol=0.1)
    state = run.solver.step(run.problem, view.state)
    place = map_positions([np.unravel_index(own.argmin(), own.shape)], run.problem.search)[0]
    np.testing.assert_allclose(state.positions[n], place)
    state = run.solver.step(run.problem, state)  # this step moves no microphone
    assert (state.first, state.last, state.stage) == (opening.MODE - 1, opening.MODE, 1)
    run.session.close()


FILM_NODE = "#fdcal-film"
FILM = "document.getElementById('fdcal-film')"
WORDS = f"{FILM}.querySelector('h1').innerText"
LEFT = f"() => !{FILM} && window.__viserMutable.nodeRefFromName['/relief']?.children.length > 0"
LEVELS = """time => {  // share of the canvas that the relief covers, and the mean of its colours
    fdcalFilm.draw(5.1);  // what is drawn again may be read
    fdcalFilm.draw(time);
    const canvas = document.querySelectorAll('#fdcal-film canvas')[1], gl = canvas.getContext('webgl2');
    const pixels = new Uint8Array(4 * canvas.width * canvas.height);
    gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    let count = 0, sum = 0;
    for (let i = 0; i < pixels.length; i += 4) if (pixels[i + 3]) { count++; sum += pixels[i + 1]; }
    return [4 * count / pixels.length, sum / count];
}"""


@pytest.fixture
def url(kernels, monkeypatch):
    """Address of a server of the opening that no browser has used yet."""
    monkeypatch.setattr(map_worker, "IDLE_TIME", np.inf)  # make no fine maps
    with serving_here() as address:
        yield address


PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
REACH = 24  # pixels: a finger takes a microphone within this distance
# Return where the disc of a microphone is on the screen, in pixels.
DISC = """number => {
    const mutable = window.__viserMutable, canvas = document.querySelector("canvas[data-engine]");
    const {left, top, width, height} = canvas.getBoundingClientRect();
    for (const [name, node] of Object.entries(mutable.nodeRefFromName)) {
        let discs = null;
        if (/^\\/picking\\/\\d+$/.test(name)) node?.traverse(part => { if (part.isInstancedMesh2) discs = part; });
        if (!discs) continue;
        const at = mutable.camera.position.clone().copy(discs.getPositionAt(number)).applyMatrix4(discs.matrixWorld);
        const {x, y} = at.project(mutable.camera);
        return [left + (1 + x) / 2 * width, top + (1 - y) / 2 * height];
    }
}"""
# Return whether a visible text of the scene is below the legend.
COVERED = """() => {
    const legend = document.querySelector("#fdcal [data-region=legend]").getBoundingClientRect();
    const texts = [...document.querySelectorAll("#fdcal-labels span")].filter(text => !text.style.visibility);
    return texts.filter(text => text.getBoundingClientRect().bottom > legend.top).map(text => text.innerText);
}"""
EMPTY_BOXES = """() => [...document.querySelectorAll(".mantine-Paper-root > .mantine-Paper-root")]
    .filter(name => /none/.test(name.nextElementSibling.style.display))
    .filter(name => getComputedStyle(name.parentElement).borderLeftColor != "rgba(0, 0, 0, 0)")
    .map(name => name.innerText)"""


def test_a_phone_says_how_to_read_the_map_and_a_finger_beside_a_microphone_drags_it(browser, url):
    context = browser.new_context(**PHONE)
    page = context.new_page()
    slowed_down(page)
    page.goto(f"{url}/?fixedDpr=0.25#layout=explore", wait_until="domcontentloaded")
    assert page.evaluate(f"!{FILM}"), "a link leads to what it names"
    legend = page.locator("#fdcal [data-region=legend]")
    legend.get_by_text("low and dark").wait_for()
    legend.get_by_text("this microphone").first.wait_for()
    slider, summed = page.locator("[data-do=modes]"), page.locator("[data-do=modes] + output")
    summed.get_by_text("no. 92, 376 Hz").wait_for()
    assert page.locator("[data-do=microphone]").is_visible()
    slider.press("ArrowRight")
    summed.get_by_text("91 to 92").wait_for()  # modes are listed in the order of the film
    slider.press("ArrowLeft")
    page.wait_for_function("/modes=92(&|$)/.test(location.hash)")
    invitation = page.get_by_text(INVITATION)
    assert not invitation.is_visible(), "there was no film"

    def invited():  # the film ends with the invitation; a late answer to the slider would remove it
        page.evaluate("document.documentElement.setAttribute('data-invited', '')")
        assert invitation.is_visible()

    until(page, invited)
    page.wait_for_function("() => window.__viserMutable.nodeRefFromName['/relief']?.children.length > 0")
    stands = f"const at = ({DISC})({opening.MICROPHONE}), there = String(at), same = there == window.there;"
    page.wait_for_function(f"() => {{ {stands} window.there = there; return at && same; }}", polling=300)
    x, y = (at + 0.5 * REACH for at in page.evaluate(DISC, opening.MICROPHONE))
    finger = context.new_cdp_session(page)
    other = {"x": 330, "y": 320, "id": 1}
    for number in range(8):
        kind = "touchMove" if number else "touchStart"
        at = {"x": x + 4 * number, "y": y + 9 * number, "id": 0}
        if number == 5:
            finger.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [at, other]})
        fingers = [at] if number < 5 else [at, other]
        finger.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers})
        page.wait_for_timeout(100)
    # The disc stays 17 by 12 pixels from the finger. The tolerance allows for its height on the relief, which depends
    # on the moves; a slow browser omits some of them.
    disc = f"const [x, y] = ({DISC})({opening.MICROPHONE})"
    below = f"place => {{ {disc}; return Math.hypot(x - place.x, y - place.y) < 12; }}"
    page.wait_for_function(below, arg={axis: at[axis] - 0.5 * REACH for axis in "xy"})
    page.locator("[data-region=words]").get_by_text(re.compile(r"^Misfit -[\d.]+ dB$")).wait_for()
    finger.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    page.get_by_text(re.compile(r"^[01] of 1 drop reached the true position$")).wait_for()
    invitation.wait_for(state="hidden")
    page.get_by_role("button", name="Restart").tap()
    page.get_by_text(re.compile(r"^[01] of 1 drop reached the true position$")).wait_for(state="detached")
    page.get_by_role("button", name="Expert", exact=True).click()
    page.get_by_text("In use", exact=True).wait_for()
    page.wait_for_function(f"() => ({COVERED})().length == 0")
    page.wait_for_function(f"() => ({EMPTY_BOXES})().length == 0")  # a folded section is one line with its name
    width = PHONE["viewport"]["width"]
    widths = page.locator(".mantine-ScrollArea-viewport").evaluate_all("areas => areas.map(area => area.scrollWidth)")
    assert max(widths) == width and legend.bounding_box()["width"] <= width, "nothing is wider than the screen"
    for name in (*panels.RIGHT, *panels.LEFT):
        tab(page, name)
        page.get_by_role("tab", name=name, exact=True, selected=True).wait_for()
    context.close()


def opened(browser, url, **options):
    page = browser.new_page(viewport={"width": 1024, "height": 576}, **options)
    slowed_down(page)
    page.goto(f"{url}/{EXPLORE}", wait_until="domcontentloaded")
    return page


def test_each_browser_plays_the_film_and_leaves_the_others_and_the_session_alone(browser, url, capsys):
    first = opened(browser, url)
    assert " fit" in first.evaluate(WORDS), "before any message of the server"
    first.wait_for_function(f"!{WORDS}.startsWith('One frequency')")  # the film continues without a click
    trigger(first.get_by_role("button", name="Skip"))
    first.locator("#fdcal [data-do=play]").wait_for()
    first.wait_for_function(LEFT)
    first.wait_for_function("location.hash.includes('modes=92') && location.hash.includes('relief')")
    first.get_by_text(INVITATION).wait_for()
    first.locator("[data-do=microphone]").press("Home")
    first.wait_for_function("location.hash.includes('microphone=0')")
    first.get_by_text(INVITATION).wait_for(state="hidden")  # a known microphone stays where it is

    second = opened(browser, url, color_scheme="dark", reduced_motion="reduce")
    assert second.evaluate(WORDS) == "The microphone is found", "nothing moves"
    shown = [second.evaluate(LEVELS, time) for time in (0.0, 3.0, 5.7, 11.0, 30.0)]
    assert all(0.1 < share < 0.5 for share, _ in shown), "never blank"
    assert shown[0] == shown[1] and len({colour for _, colour in shown}) == 4
    assert not second.locator(f"{FILM_NODE} p").is_visible(), "a picture: there is nothing to drag in it"
    second.wait_for_function("window.__viserMutable?.nodeRefFromName?.['/microphones/true'] != null")
    second.wait_for_timeout(1000)
    assert second.evaluate("location.hash") == "", "a page that is loaded again begins with the film"
    second.keyboard.press("Shift")
    assert second.evaluate(f"{FILM}.className") == "", "a key that types nothing is no touch"

    trigger(first.get_by_role("button", name="3-D", exact=True))
    angle = "window.__viserMutable.cameraControl.polarAngle"
    while first.evaluate(angle) < 1.4:  # the page may place the camera again after a change of layout
        first.mouse.move(30, 200)
        first.mouse.down()
        first.mouse.move(30, -1200, steps=4)
        first.mouse.up()
        first.wait_for_timeout(500)
    assert first.evaluate(angle) < np.pi / 2, "above the floor"
    trigger(first.get_by_role("button", name="3-D", exact=True))
    first.wait_for_function(f"{angle} < 1")
    trigger(first.get_by_role("button", name="Expert", exact=True))
    tab(first, "Map")
    choose(first, "Show", "No map")
    first.wait_for_function("location.hash.includes('map=none')")

    second.get_by_role("button", name="Your turn").press("t")  # any other key ends the film, too
    second.locator(FILM_NODE).wait_for(state="detached")  # the film cannot wait for a map, because there is none
    second.wait_for_function("location.hash.includes('microphone=0')")
    assert first.evaluate("document.documentElement.dataset.mantineColorScheme") == "light", "each user has a theme"
    second.close()
    first.close()
    assert "Traceback" not in capsys.readouterr().err
