"""How quickly the page answers while the solver runs, seen by the server itself and by a real browser.

On the server, times begin when a slider's message comes in and end when the main loop has published its effect to all
pages (`benchmarks.watched`). A microphone is dragged twice: by the mouse of the browser, as fast as it sends events,
and on the server, 60 times a second. Frames are counted in the browser. The first picture is timed from the command to
the page's first microphones, in a browser that is already running. FDCAL_WARM_ONLY leaves the cold start out.
"""

import math
import os
import re
import statistics
import time
from dataclasses import replace

import numpy as np

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.graphics.camera import camera_for, project
from fdcal.graphics.picture import compose
from fdcal.model.scene import load_scene
from fdcal.viewer import scene3d as cameras

from .empty_page import SLIDER
from .pages import WAIT, Served, ServedEmpty, chromium, open_page, slider, wait_for_node
from .report import Figure
from .watched import DRAG

SCENE, SECONDS, MOVES, REST = "array1_circle", 8.0, 8, 0.6
SLIDERS = ("Last freq.", "Microphone")
MODES, POINTS = 9, 121  # numbers of modes, and of points along an edge, of the map during a drag

FRAMES = """seconds => new Promise(resolve => {
    const start = performance.now();
    let frames = 0;
    const tick = now => {
        frames += 1;
        if (now - start < 1000 * seconds) return requestAnimationFrame(tick);
        resolve(frames / seconds);
    };
    requestAnimationFrame(tick);
})"""


# The times, ms, at which the browser has painted the first map of the film, and at which viser has the relief.
PAINTED = """
window.painted = {map: 0, relief: 0};
new PerformanceObserver(list => {
    for (const {name, startTime} of list.getEntries())
        if (name == "first-contentful-paint" && document.getElementById("fdcal-film")) painted.map ||= startTime;
}).observe({type: "paint", buffered: true});
const look = () => {
    if (window.__viserMutable?.nodeRefFromName?.["/relief"]?.children.length) painted.relief = performance.now();
    else requestAnimationFrame(look);
};
look();
"""


# The times, ms, at which messages of the server have come, before viser reads them, and of the last key pressed.
ARRIVED = """
window.arrived = [];
window.pressed = 0;
addEventListener("keydown", () => { pressed = performance.now(); }, true);
window.Worker = class extends Worker {
    constructor(...options) {
        super(...options);
        this.addEventListener("message", ({data}) => {
            for (const {type, name} of data?.messages ?? []) arrived.push({type, name, at: performance.now()});
        });
    }
};
"""
MODES_TO_MAP = """async count => {
    const input = document.querySelector("[data-do=modes]"), start = performance.now();
    arrived.length = 0;
    input.value = count;
    input.dispatchEvent(new Event("input", {bubbles: true}));
    while (!arrived.some(one => one.name == "/floor")) await new Promise(resolve => setTimeout(resolve, 2));
    return arrived.find(one => one.name == "/floor").at - start;
}"""


def run() -> list[Figure]:
    figures = [Figure("load of the machine, mean of the last minute, before", os.getloadavg()[0], "")]
    with chromium() as browser:
        figures += [] if os.environ.get("FDCAL_WARM_ONLY") else [*_opening(browser, cold=True), *_cold(browser)]
        figures += _opening(browser)
        first = [*_first_picture(browser), *_round_trips(browser)]
        with Served(SCENE, {"name": "descent"}, watched=True) as served:
            page = open_page(browser, served.url)
            frames = _while_it_runs(page)
            dragging = _drags(page, served)
            log = served.log()
    return [
        *figures,
        *first,
        *_answers(log),
        *_published(log),
        Figure("the browser's own frames while it runs, software WebGL", frames, "1/s"),
        *_dragged(log),
        Figure("the browser's own frames in its drag", dragging, "1/s"),
        Figure("Ctrl-C to the end, one page open", served.stopped_in, "s", "below 2", served.stopped_in < 2),
        Figure("load of the machine, mean of the last minute, after", os.getloadavg()[0], ""),
    ]


def _cold(browser) -> list[Figure]:
    """Time the first picture and the first progress on the page, with nothing cached and nothing compiled."""
    start = time.perf_counter()
    with Served(SCENE, {}, cold=True) as served:
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.goto(f"{served.url}/#layout=expert")  # the layout that shows the progress of the first session
        page.get_by_text(re.compile(r"Simulating the room|Compiling")).first.wait_for()
        shown = time.perf_counter() - start
        open_page(browser, served.url).close()
        first = time.perf_counter() - start
        page.close()
    return [
        Figure(f"first picture of {SCENE}, cold caches", first, "s", "below 60", first < 60),
        Figure("the page shows its progress after", shown, "s", "shown", shown < first),
    ]


def _opening(browser, cold: bool = False) -> list[Figure]:
    """Time `fdcal view` without a scene, by the browser's clock: from the navigation to the first map, which is part of
    the page's HTML, and to the relief that viser draws."""
    with Served("", {}, cold=cold) as served:
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.set_default_timeout(WAIT)
        page.add_init_script(PAINTED)
        page.goto(served.url)
        page.wait_for_function("() => Object.values(window.painted).every(time => time > 0)")
        seen = page.evaluate("window.painted")
        page.close()
    caches = "cold caches" if cold else "warm caches"
    return [
        Figure(
            f"the opening, {caches}: navigation to its first map", 1e-3 * seen["map"], "s", "below 1", seen["map"] < 1e3
        ),
        Figure("the same until viser has drawn the relief", 1e-3 * seen["relief"], "s"),
    ]


def _round_trips(browser) -> list[Figure]:
    """Time from a slider in the browser to the message with its effect: for the modes of a map in Explore while the
    solver rests, and for an empty page of viser whose slider's value comes back as a text."""
    with ServedEmpty() as served:
        page = browser.new_page()
        page.add_init_script(ARRIVED)
        page.goto(served.url)
        wait_for_node(page, "/microphones/true")
        handle, echoed = slider(page, SLIDER), []
        handle.focus()
        for _ in range(MOVES):
            page.wait_for_timeout(1e3 * REST)
            page.evaluate("arrived.length = 0")
            handle.press("ArrowRight")
            page.wait_for_function("() => arrived.some(one => one.type == 'GuiUpdateMessage')")
            echoed.append(page.evaluate("arrived.find(one => one.type == 'GuiUpdateMessage').at - pressed"))
        page.close()
    with Served(SCENE, {}) as served:
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.set_default_timeout(WAIT)
        page.add_init_script(ARRIVED)
        page.goto(served.url)
        wait_for_node(page, "/floor")
        page.locator("[data-do=modes]").wait_for()
        mapped = []
        for count in range(10, 10 + MOVES):
            page.wait_for_timeout(3e3)  # until the fine map of the previous modes has come
            mapped.append(page.evaluate(MODES_TO_MAP, count))
        page.close()
    own, whole = statistics.median(echoed), statistics.median(mapped)
    title = f'"Frequencies" of Explore to the map in the browser, solver at rest, median of {MOVES}'
    return [
        Figure(title, whole, "ms", "below 60", whole < 60),
        Figure("of this viser's own round trip, a slider to a text", own, "ms"),
    ]


def _first_picture(browser) -> list[Figure]:
    """Time the room with its microphones, and the button that starts the solver, with warm caches.

    The time of an empty page of viser, opened before and after, is that of Chromium and viser; the rest is our own.
    """
    before = _empty(browser)
    start = time.perf_counter()
    with Served(SCENE, {}) as served:
        page = open_page(browser, served.url)
        first, taken = time.perf_counter() - start, served.processor()
        page.get_by_role("button", name="Play", exact=True).wait_for()
        ready = time.perf_counter() - start
        wait_for_node(page, "/floor")
        mapped = time.perf_counter() - start
        page.close()
    empty = (before + _empty(browser)) / 2
    own = first - empty
    return [
        Figure(f"first picture of {SCENE}, warm cache", first, "s", "below 5", first < 5),
        Figure("of this an empty page of viser in Chromium, mean of two", empty, "s"),
        Figure("of this our own part", own, "s", "below 1.5", own < 1.5),
        Figure("processor time of the server until then", taken, "s"),
        Figure("the same until it can be run", ready, "s"),
        Figure("the same until it has its first map", mapped, "s"),
    ]


def _empty(browser) -> float:
    """Return how long an empty page of viser takes to its first picture, from the command, s."""
    start = time.perf_counter()
    with ServedEmpty() as served:
        page = open_page(browser, served.url)
        first = time.perf_counter() - start
        page.close()
    return first


def _while_it_runs(page) -> float:
    """Let the solver run, and move sliders; return the frames per second of the browser before they are moved."""
    page.get_by_role("button", name="Play", exact=True).click()
    page.get_by_text("Running", exact=True).first.wait_for()
    frames = page.evaluate(FRAMES, SECONDS)
    page.get_by_text("Settings", exact=True).click()
    for label in SLIDERS:
        handle = slider(page, label)
        handle.focus()
        for move in range(MOVES):
            handle.press("ArrowLeft" if move % 4 == 3 else "ArrowRight")
            page.wait_for_timeout(1e3 * REST)
    return frames


def _drags(page, served: Served) -> float:
    """Drag a microphone with the mouse, then on the server; return the frames per second of the browser in its drag."""
    pause = page.get_by_role("button", name="Pause", exact=True)
    if pause.count():  # a run whose modes the user chose may have ended
        pause.click()
    page.get_by_role("button", name="Restart", exact=True).click()
    page.get_by_role("tab", name="Map", exact=True).click()
    page.locator("//label[.='Frequency numbers']/following::input[1]").first.fill(f"1-{MODES}")
    page.keyboard.press("Enter")
    page.get_by_text(f"sum of {MODES} frequencies").first.wait_for()
    page.wait_for_timeout(3e3)
    frames = _mouse(page)
    page.wait_for_timeout(1e3)
    served.drag()
    page.wait_for_timeout(1e3 * (DRAG + 1))
    return frames


def _mouse(page) -> float:
    """Lead the free microphone with the highest number, at its start, in a circle with the mouse.

    With Shift it moves in the session, which changes the map of another; without, it is shown above its own map.
    """
    scene = load_scene(SCENE)
    measurement = cached_measurement(scene)
    problem, descent = measurement.problem(scene.solver.weights), solvers.load("descent")
    place = descent.init(problem, replace(scene.solver, name="descent"), scene.seed).positions[problem.free[-1]]
    box = page.locator("canvas").first.bounding_box()
    size = (round(box["width"]), round(box["height"]))
    picture = compose(scene, measurement)
    camera = camera_for(picture, size, "top", cameras.EXPERT_MARGINS, fov=cameras.TOP_FOV)
    x, y = project(camera, size, np.append(place, 0.0)[None])[0] + [box["x"], box["y"]]
    page.mouse.move(x + 30, y + 30)
    page.mouse.move(x, y, steps=5)
    page.wait_for_timeout(1500)
    page.evaluate(f"window.counted = ({FRAMES})({DRAG})")
    page.keyboard.down("Shift")
    page.mouse.down()
    start = time.perf_counter()
    while (t := time.perf_counter() - start) < DRAG:
        page.mouse.move(x + 40 * math.sin(3 * t), y + 40 * (math.cos(3 * t) - 1))
    page.mouse.up()
    page.keyboard.up("Shift")
    return page.evaluate("window.counted")


def _answers(log) -> list[Figure]:
    """Return for each slider the times from its message to its effect."""
    figures = []
    for label in SLIDERS:
        times, received = [], None
        for at, what, value in log:
            if value == label and what == "received":
                received = at
            elif value == label and what == "shown" and received is not None:
                times.append(1e3 * (at - received))
                received = None
        name = f'"{label}" to its effect published, solver running'
        median, worst = (statistics.median(times), max(times)) if times else (math.nan, math.nan)
        figures += [
            Figure(f"{name}, median of {len(times)}", median, "ms", "below 100", median < 100),
            Figure(f"{name}, worst", worst, "ms"),
        ]
    return figures


def _published(log) -> list[Figure]:
    """Return the turns of the main loop per second while the solver runs, and those in the worst second."""
    turns = np.array([at for at, what, _ in log if what == "turn"])
    gaps = np.diff(turns)
    counts = np.bincount((turns - turns[0]).astype(int))[:-1]
    rate = 1 / np.median(gaps)
    return [
        Figure("the publisher's turns while the solver runs", rate, "1/s", "20 or more", rate >= 20),
        Figure("the same in its worst second", counts[counts > 0].min(), "1/s"),
    ]


def _dragged(log) -> list[Figure]:
    """Return the rate of maps published in each drag, and of moves that the browser sent: fewer than 20 per second,
    because it draws by software, and viser's page waits 50 ms between two moves."""
    maps = [at for at, what, value in log if what == "map" and value == [MODES, POINTS]]
    moves = [at for at, what, _ in log if what == "moved"]
    begun = next(at for at, what, _ in log if what == "drag")
    ended = next(at for at, what, _ in log if what == "dropped")
    first, last = (moves[0], moves[-1]) if moves else (0.0, 0.0)
    title = f"maps of {MODES} modes at {POINTS} x {POINTS} published"
    served = _rate([at for at in maps if begun < at < ended])
    shown, sent = _rate([at for at in maps if first < at < last + 0.2]), _rate(moves)
    return [
        Figure(f"a drag on the server: {title}", served, "1/s", "20 or more", served >= 20),
        Figure("a drag by the browser's mouse: moves that it sent", sent, "1/s"),
        Figure(f"the same: {title}", shown, "1/s", "9 of 10 moves", shown >= 0.9 * sent > 0),
    ]


def _rate(times: list[float]) -> float:
    """Return the number of events per second."""
    return (len(times) - 1) / (times[-1] - times[0]) if len(times) > 2 else 0.0
