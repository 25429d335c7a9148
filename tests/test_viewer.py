"""The page: one real browser on `tiny`, and what may not come through from any client."""

import base64
import contextlib
import csv
import dataclasses
import io
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
import websockets
from PIL import Image
from viser import _messages
from websockets.sync.client import connect

from fdcal import landscapes, solvers
from fdcal.camera import camera_for, project
from fdcal.checks import InputError
from fdcal.export import sessionfile
from fdcal.history import History, SessionView
from fdcal.measured import stand_in
from fdcal.measurement import Measurement
from fdcal.opening import Opening, edited
from fdcal.picture import compose, with_estimate
from fdcal.primitives import Label
from fdcal.scenario import knobs_of
from fdcal.scene import load_scene, scene_folder
from fdcal.store import cached_measurement
from fdcal.verdict import highest_frequency
from fdcal.viewer import (
    app,
    cameras,
    exports,
    maps,
    maptab,
    modestab,
    plots,
    preparing,
    safety,
    scenetab,
    spreads,
    viewing,
    words,
)
from fdcal.viewer.controls import Controls
from fdcal.viewer.desk import NOTHING, Desk
from fdcal.viewer.firstlook import look_at_once
from fdcal.viewer.frame import Frame, Rooms
from fdcal.viewer.page import Page
from fdcal.viewer.stage import Stage

WAIT = 60.0  # s, bound of every wait
MAIN = threading.main_thread()
JUNK = [1e9, -1e9, float("nan"), float("inf"), "many", "", None, [1, 2], {"a": 1}, 10**400, b"\x00"]
ARGUMENTS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
]
ARGUMENTS += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]


def finish(coroutine):
    """Run a coroutine that waits for nothing; the browser's driver occupies this thread's event loop."""
    with pytest.raises(StopIteration):
        coroutine.send(None)


# -- one page, in a real browser -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def address(tmp_path_factory, kernels):
    """Where `fdcal view` serves `tiny`, solved by descent, which has steps to be seen; ends in good order on Ctrl-C."""
    slow = tmp_path_factory.mktemp("view") / "slow.toml"
    text = (scene_folder() / "tiny.toml").read_text(encoding="utf-8")
    slow.write_text(text.replace('name = "joint"', 'name = "descent"'), encoding="utf-8")
    command = [sys.executable, "-m", "fdcal", "view", str(slow), "--port", "0", "--no-browser"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ)
    try:
        url = server.stdout.readline().strip()
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+", url), url or server.stderr.read()
        yield url
        server.send_signal(signal.SIGINT)
        _, errors = server.communicate(timeout=WAIT)
        assert server.returncode == 0 and "Traceback" not in errors, errors
    finally:
        server.kill()


@pytest.fixture(scope="module")
def browser(require_browser):
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=require_browser, headless=True, args=ARGUMENTS)
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def open_page(address, browser):
    """Function that opens one more page and waits for its picture."""

    def open_one():
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.set_default_timeout(WAIT * 1e3)
        page.goto(f"{address}/?fixedDpr=1")
        drawn = "name => window.__viserMutable?.nodeRefFromName?.[name] != null"
        page.wait_for_function(drawn, arg="/microphones/true", timeout=WAIT * 1e3)
        return page

    return open_one


@pytest.fixture(scope="module")
def page(open_page):
    return open_page()


def press(page, name):
    page.get_by_role("button", name=name, exact=True).click()


def test_step_advances_the_state(page):
    page.get_by_text("step 0, sweep 0").wait_for()
    press(page, "Step")
    page.get_by_text("step 1, sweep 0").wait_for()
    press(page, "Sweep")
    page.get_by_text("step 13, sweep 1").wait_for()  # 16 microphones, 3 of them known


def test_a_second_page_shows_the_same_session(page, open_page):
    second = open_page()
    second.get_by_text("step 13, sweep 1").wait_for()
    press(second, "Step")
    page.get_by_text("step 14, sweep 1").wait_for()
    second.close()


def test_run_becomes_pause(page):
    page.evaluate(
        """() => {
            window.seen = [];
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
    page.get_by_text(re.compile(r"Finished")).first.wait_for()  # tiny is done in seconds
    page.get_by_role("button", name="Run", exact=True).wait_for()
    assert page.get_by_role("button", name="Run", exact=True).is_disabled(), "a finished run has nothing to run"
    assert not page.get_by_role("button", name="Step", exact=True).count()
    assert page.evaluate("window.seen") == ["Run", "Pause", "Run"]
    press(page, "Reset")
    page.get_by_text("step 0, sweep 0").wait_for()


def test_rewinding_and_going_on_from_there(page):
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
    press(page, "Reset")
    page.get_by_text("step 0, sweep 0").wait_for()


def test_a_slider_sets_the_modes_in_use(page):
    handle = slider(page, "Last mode")
    handle.focus()
    handle.press("ArrowRight")
    page.get_by_text(re.compile(r"^modes 1 to 4, ")).wait_for()


# How to find things in the page of `tiny`: the camera of `Stage.place`, and viser's own scene.


def slider(page, label):
    number = page.get_by_text(label, exact=True).get_attribute("for")
    return page.locator(f"[id='{number}']").get_by_role("slider")


def choose(page, label, option):
    number = page.get_by_text(label, exact=True).get_attribute("for")
    page.locator(f"[id='{number}']").click()
    page.get_by_role("option", name=option, exact=True).click()


def tab(page, name):
    page.get_by_role("tab", name=name, exact=True).click()


STANDS = """([x, y, z]) => {
    const at = window.__viserMutable.camera.position;  // the browser's own axes: y up
    return Math.hypot(at.z + x, at.x + y, at.y - z) < 1e-3 * z;
}"""


def on_screen(page, scene, points):
    """Pixels of the page at which points (P, 3), metres, appear from the top, once the camera stands there."""
    picture = compose(scene, cached_measurement(scene))
    for _ in range(int(WAIT / 0.1)):
        box = page.locator("canvas").first.bounding_box()
        size = (round(box["width"]), round(box["height"]))
        camera = camera_for(picture, size, "top", cameras.MARGINS, fov=cameras.FLAT)
        if page.evaluate(STANDS, [float(x) for x in camera.position]):
            return project(camera, size, points) + [box["x"], box["y"]]
        page.wait_for_timeout(100)
    there = page.evaluate("window.__viserMutable.camera.position.toArray()")
    pytest.fail(f"the camera stands at {there}, and not at {camera.position} as a canvas of {size} needs it")


def hover(page, pixel):
    """Bring the pointer over a microphone; the page shows that it has noticed by another pointer."""
    over = "[...document.querySelectorAll('canvas')].some(e => e.style.cursor == 'pointer')"
    for _ in range(int(WAIT)):
        page.mouse.move(pixel[0] + 40, pixel[1] + 40)  # a pointer that has not moved is not looked at again
        page.mouse.move(*pixel, steps=4)
        for _ in range(10):
            if page.evaluate(over):
                return
            page.wait_for_timeout(100)
    pytest.fail(f"no microphone is found at {pixel}")


MIDDLE = """name => {
    const box = [1e9, 1e9, -1e9, -1e9];
    window.__viserMutable.nodeRefFromName[name].traverse(node => {
        const places = node.geometry?.attributes?.position;
        node.updateWorldMatrix(true, false);
        for (let i = 0; places && i < places.count; i++) {
            const at = node.localToWorld(node.position.clone().fromBufferAttribute(places, i));
            const [x, y] = [-at.z, -at.x];  // the browser's own axes: y up
            box[0] = Math.min(box[0], x); box[1] = Math.min(box[1], y);
            box[2] = Math.max(box[2], x); box[3] = Math.max(box[3], y);
        }
    });
    return [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2];
}"""


def middle(page, name):
    """Middle, in x and y, of all that viser draws under a name."""
    return page.evaluate(MIDDLE, name)


def stands(page, name, place, slack):
    """Wait until the middle of what is drawn under a name stands at a place."""
    at = f"const at = ({MIDDLE})('{name}'); return Math.hypot(at[0] - p[0], at[1] - p[1]) < {slack}"
    page.wait_for_function(
        f"p => {{ if (!window.__viserMutable.nodeRefFromName['{name}']) return false; {at} }}", arg=place
    )


def pick(page, scene, place, text):
    """Click at a place; the page says `text`."""
    pixel = on_screen(page, scene, [[*place, 0.0]])[0]
    hover(page, pixel)
    page.mouse.click(*pixel)
    page.get_by_text(text).first.wait_for()


def test_a_microphone_is_picked_by_a_click(page, scene):
    tab(page, "Map")
    known = cached_measurement(scene).positions[5]
    pick(page, scene, known, "microphone 5, ")
    assert not page.get_by_label("Follow solver").is_checked()


def test_the_diamond_stands_where_the_map_is_lowest(page, scene):
    choose(page, "Modes shown", "Chosen here")
    page.locator("//label[.='Mode numbers']/following::input[1]").first.fill("2-4, 6")
    page.keyboard.press("Enter")
    page.get_by_text("microphone 5, sum of 4 modes").wait_for()
    problem, descent = cached_measurement(scene).problem("unit"), solvers.load("descent")
    state = descent.use_modes(problem, descent.init(problem, scene.solver, 0), 1, 4, True)  # what the page shows
    fine = landscapes.finer(scene.search)
    cost = sum(landscapes.fine_mode(problem, None, state, 5, mode, fine) for mode in (2, 3, 4, 6))
    lowest = landscapes.places(np.array([np.unravel_index(cost.argmin(), cost.shape)]), fine)[0]
    stands(page, "/lowest", lowest.tolist(), 1e-4)


def test_a_microphone_is_dragged_and_the_map_stays_that_of_the_one_looked_at(page, scene):
    truth = cached_measurement(scene).positions
    target = truth[7] + [0.1, -0.06]
    page.get_by_text("cost at the cross").first.wait_for()
    before = page.get_by_text("cost at the cross").first.inner_text()
    start, end = on_screen(page, scene, np.column_stack([[truth[7], target], [0.0, 0.0]]))
    hover(page, start)
    page.mouse.down()
    for share in np.linspace(0.1, 1, 8):
        page.mouse.move(*(start + share * (end - start)))
    page.wait_for_function("text => !document.body.innerText.includes(text)", arg=before)
    page.mouse.up()
    page.get_by_text("microphone 5, ").first.wait_for()
    pick(page, scene, target, "microphone 7, ")  # it is there now
    np.testing.assert_allclose(middle(page, "/looked_at/estimate"), target, atol=0.004)


def test_a_mode_is_switched_on_and_off(page):
    tab(page, "Modes")
    press(page, "●6")
    page.get_by_text("sum of 3 modes").first.wait_for()
    press(page, "○5")
    page.get_by_text("sum of 4 modes").first.wait_for()
    page.get_by_text("highest in the map: mode 5").first.wait_for()
    tab(page, "Map")
    choose(page, "Show", "Shape of the last mode")
    page.get_by_text("pressure of mode 5").first.wait_for()
    choose(page, "Show", "Flat map")


def test_a_relief_stands_where_the_flat_map_lay(page, scene):
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


def test_every_file_is_saved_and_read_by_others(page, tmp_path, require_gl):
    import pyvista

    press(page, "Reset")
    page.get_by_text("step 0, sweep 0").wait_for()
    press(page, "Sweep")
    page.get_by_text("step 13, sweep 1").wait_for()
    tab(page, "Export")
    files = {}
    for label in exports.KINDS:
        name, files[label] = saved(page, label)
        assert name.startswith("fdcal-slow-step-13") and name.endswith(exports.KINDS[label].ending)
        (tmp_path / name).write_bytes(files[label])
    picture, png, svg, _, table, _, replay, _ = files.values()
    image = Image.open(io.BytesIO(picture))
    assert image.size == (1280, 800)
    assert len(np.unique(np.asarray(image.convert("RGB")).reshape(-1, 3), axis=0)) > 100
    assert Image.open(io.BytesIO(png)).size > (800, 600) and ElementTree.fromstring(svg).tag.endswith("svg")
    session = sessionfile.read(tmp_path / "fdcal-slow-step-13-session.zip")
    state, measurement = session.states[session.index], session.measurement
    assert (state.step, len(session.states)) == (13, 14)
    rows = list(csv.DictReader(io.StringIO(table.decode())))
    assert np.array_equal([[float(row["x_m"]), float(row["y_m"])] for row in rows], state.positions)
    cloud = pyvista.read(tmp_path / "fdcal-slow-step-13-microphones.vtp")
    assert np.array_equal(cloud.points[cloud["kind"] == 0][:, :2], state.positions)
    assert np.array_equal(cloud.points[cloud["kind"] == 1][:, :2], measurement.positions)
    grid = pyvista.read(tmp_path / "fdcal-slow-step-13-map.vti")
    assert grid.dimensions == (*measurement.search.shape, 1) and np.isfinite(grid["sum"]).all()
    data = json.loads(re.search(rb'id="data">(.*?)</script>', replay).group(1))
    places = np.frombuffer(base64.b64decode(data["positions"]), "<f4").reshape(14, 16, 2) + np.array(data["origin"])
    assert np.abs(places - [one.positions for one in session.states]).max() < 1e-6


# -- who may connect -------------------------------------------------------------------------------------------------


def shake_hands(address, origin):
    protocol = f"viser-v{__import__('viser').__version__}"
    with connect(address.replace("http", "ws"), origin=origin, subprotocols=[protocol], open_timeout=WAIT):
        return True


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "http://127.0.0.1.evil.example", "https://localhost.evil:80", "null"]
)
def test_a_foreign_origin_is_refused(address, origin):
    with pytest.raises(websockets.exceptions.InvalidStatus) as caught:
        shake_hands(address, origin)
    assert caught.value.response.status_code == 403


def test_its_own_origin_and_a_program_are_let_in(address):
    assert shake_hands(address, address) and shake_hands(address, None)


@pytest.fixture(scope="module")
def server():
    opened = safety.open_server("127.0.0.1", 0)
    yield opened
    opened.stop()


class Startled:
    """An event whose waiters change just as a foreign thread sets it."""

    def __init__(self, event):
        self._event, self.woken = event, threading.Event()

    def set(self):
        if threading.current_thread() is MAIN:
            raise RuntimeError("deque mutated during iteration")
        self._event.set()
        self.woken.set()

    def __getattr__(self, name):
        return getattr(self._event, name)


def test_a_loop_that_is_startled_is_woken_all_the_same(server):
    buffer = server._websock_server._broadcast_buffer
    buffer.message_event = startled = Startled(buffer.message_event)
    text = server.gui.add_html("one")
    text.content = "two"
    assert startled.woken.wait(WAIT) and text.content == "two"
    server.gui.reset()
    buffer.message_event = startled._event


def test_the_share_tunnel_is_out_of_reach(server):
    assert _messages.ShareUrlRequest not in server._websock_server._incoming_handlers


@pytest.mark.parametrize("port", [-1, 65536, 80000])
def test_a_port_out_of_range_is_refused(port):
    with pytest.raises(InputError, match="port"):
        safety.open_server("127.0.0.1", port)


def test_a_port_in_use_is_refused(server):
    with pytest.raises(InputError, match="port"):
        safety.open_server("127.0.0.1", server.get_port())


@pytest.mark.parametrize("host", ["no.such.host.invalid", "999.1.1.1", "\x00", "a" * 300])
def test_a_bad_host_is_refused(host):
    with pytest.raises(InputError, match="host"):
        safety.open_server(host, 0)


@pytest.mark.parametrize(
    ("host", "expected"),
    [("127.0.0.1", "127.0.0.1"), ("0.0.0.0", "127.0.0.1"), ("::1", "[::1]"), ("localhost", "localhost")],
)
def test_the_address_can_be_typed_into_a_browser(host, expected):
    assert app.address(host, 81) == f"http://{expected}:81"


def test_a_host_name_that_does_not_resolve_is_no_hindrance(monkeypatch):
    def unknown(*_):
        raise safety.socket.gaierror(-2, "Name or service not known")

    monkeypatch.setattr(safety.socket, "getaddrinfo", unknown)
    assert any(origin and origin.fullmatch("http://127.0.0.1:81") for origin in safety.allowed_origins("0.0.0.0"))


# -- what a client may say -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", JUNK, ids=lambda value: repr(value)[:12])
def test_junk_becomes_a_bounded_number(value):
    assert 1 <= safety.bounded(value, 1, 9, 5) <= 9


def test_good_values_pass():
    assert safety.bounded(7, 1, 9, 5) == 7 and safety.bounded(7.0, 1, 9, 5) == 7
    assert safety.one_of("b", ("a", "b"), "a") == "b" and safety.one_of("c", ("a", "b"), "a") == "a"
    for value in (3, 0.5, True, "short"):
        assert safety.is_plain({"value": value})


@pytest.mark.parametrize("updates", [{}, None, [], {"uuid": "x"}, {"value": 1, "update_cb": []}, {"value": "x" * 201}])
def test_updates_other_than_a_plain_value_are_dropped(updates):
    assert not safety.is_plain(updates)


@pytest.mark.parametrize("junk", [value for value in JUNK if not isinstance(value, (float, int))] + [float("nan")])
def test_a_control_keeps_its_value_when_junk_arrives(server, junk):
    slider = server.gui.add_slider("Junk", 1, 9, 1, 5)
    message = _messages.GuiUpdateMessage(slider._impl.uuid, {"value": junk})
    finish(server._websock_server._handle_incoming_message(0, message))
    assert slider.value == 5
    message = _messages.GuiUpdateMessage(slider._impl.uuid, {"label": "gone"})
    finish(server._websock_server._handle_incoming_message(0, message))
    assert slider.label == "Junk"
    slider.remove()


# -- parts of the page, without a browser ----------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class State:
    positions: np.ndarray
    step: int = 0
    sweep: int = 0
    stage: int = 0
    moved: int = -1
    first: int = 1
    last: int = 3
    automatic: bool = True
    cost: float = 1.0
    finished: bool = False
    converged: bool = False
    seed: int = 0


class Recorder:
    """A session that notes its commands."""

    def __init__(self, state):
        self.commands = []
        self.view, self.ways = view_of([state]), 0

    def give_way(self):
        self.ways += 1

    def __getattr__(self, name):
        return lambda *arguments: self.commands.append((name, *arguments))


def view_of(states, **changes) -> SessionView:
    view = SessionView(states[-1], len(states) - 1, len(states), False, "", History(states, len(states)))
    return dataclasses.replace(view, **changes)


@pytest.fixture(scope="module")
def scene():
    return load_scene("tiny")


@pytest.fixture(scope="module")
def measurement(scene):
    positions = np.random.default_rng(3).uniform([0.5, 0.35], [0.9, 0.75], (10, 2))
    return Measurement(
        frequencies=np.linspace(100, 300, 6),
        pressures=np.exp(1j * np.outer(np.arange(1, 7), positions.sum(axis=1))),
        sound_speed=343.0,
        positions=positions,
        known=np.array([0, 1, 2]),
        known_positions=positions[:3],
        search=scene.search,
    )


@pytest.fixture
def work(scene, measurement):
    """What a page shows, its session one that notes its commands."""
    session, problem = Recorder(State(measurement.positions)), measurement.problem("unit")
    return preparing.Work(scene, measurement, problem, Solver(measurement), session, Opening(scene))


@pytest.fixture
def controls(server, work):
    rooms, opened = Rooms(Frame(server.gui)), []
    work.session.opened = opened
    desk = Desk(server.gui, work, 6, opened.append)
    yield Controls(rooms, desk, lambda *_: None, lambda *_: None), work.session
    server.gui.reset()


def say(handle, value, client=True):
    """What viser does when a page has set a control to `value`."""
    handle._impl.value = value
    event = SimpleNamespace(client=object() if client else None, target=SimpleNamespace(value=value))
    for callback in handle._impl.update_cb:
        finish(callback(event))


@pytest.mark.parametrize("value", JUNK, ids=lambda value: repr(value)[:12])
def test_every_control_survives_junk(controls, value):
    panel, session = controls
    solve, map_ = panel.solve, panel.map
    handles = [solve.first, solve.last, solve.automatic, solve.speed, solve.seed, map_.microphone, map_.follow]
    tab = panel.scene
    handles += [tab.name, tab.microphones, tab.radius, tab.walls, tab.absorption, tab.noise, tab.snr, tab.speed]
    handles += [tab.known, tab.seed, solve.name, solve.start]
    handles += [map_.which, map_.upto, map_.text, map_.kind, map_.scale, map_.opacity, panel.dark]
    for handle in handles:
        before = handle.value
        with contextlib.suppress(TypeError, ValueError, OverflowError):  # viser holds values of the control's type only
            value_held = type(before)(value)
            say(handle, value_held)
            tab.press()
        handle._impl.value = before
    for name, *arguments in session.commands:
        if name == "pace":
            assert 0 <= arguments[0] <= 60
            continue
        first, last, automatic = arguments
        assert name == "use_modes" and 1 <= first <= last <= 6 and isinstance(automatic, bool)
    for opening in session.opened:
        knobs = knobs_of(opening.scene)
        assert 4 <= knobs.microphones <= 150 and 0.05 <= knobs.radius <= 3 and 3 <= knobs.known < knobs.microphones
        assert abs(knobs.sound_speed_error) <= 0.05 and knobs.snr_db >= -10 and 0 <= knobs.seed < 2**31
    choices = panel.choices
    assert 0 <= choices.microphone < 10 and 0.1 <= choices.look.opacity <= 1 and choices.seed >= 0
    assert choices.modes is None or set(choices.modes) <= set(range(1, 7))


def test_apply_opens_the_scenario_that_the_handles_say(controls, scene):
    panel, session = controls
    tab = panel.scene
    say(tab.apply, True)
    say(tab.noise, True)
    say(tab.snr, 25)
    say(tab.walls, "absorbing")
    say(tab.absorption, 10.0)
    say(tab.known, 5)
    assert tab.snr.visible and tab.absorption.visible
    say(tab.apply, True)
    same, changed = (opening.scene for opening in session.opened)
    assert same is scene, "what no hand has touched stays exactly as it was"
    knobs = knobs_of(changed)
    assert (knobs.snr_db, knobs.walls, knobs.known) == (25, "absorbing", 5)
    assert knobs.absorption == pytest.approx(0.1) and changed.room.size == scene.room.size


def test_a_scenario_that_cannot_be_tells_its_line_and_opens_nothing(controls):
    panel, session = controls
    say(panel.scene.radius, 2.5)
    say(panel.scene.apply, True)
    assert session.opened == [] and "outside the room" in panel.scene.told.content
    say(panel.scene.name, "array1_circle")
    assert panel.scene.microphones.value == 65 and panel.scene.told.content == ""
    say(panel.scene.apply, True)
    assert [opening.scene for opening in session.opened] == [load_scene("array1_circle")]


def test_another_solver_starts_anew_and_the_same_one_is_reset(controls):
    panel, session = controls
    say(panel.bar.steps, "Reset")
    say(panel.solve.name, "descent")
    assert panel.solve.start.value == "random" and panel.solve.seed.visible
    say(panel.solve.seed, 5)
    say(panel.solve.anew, True)
    assert session.commands == [("reset", 0)]
    (opening,) = session.opened
    assert (opening.scene.solver.name, opening.scene.solver.start, opening.seed) == ("descent", "random", 5)
    assert opening.measurement is panel.desk.measurement


def test_a_seed_that_draws_nothing_is_not_shown(controls):
    panel, _ = controls
    assert not panel.solve.seed.visible, "joint from its affine start"
    say(panel.solve.start, "random")
    assert panel.solve.seed.visible
    say(panel.solve.name, "room")
    assert not panel.solve.seed.visible and not panel.solve.start.visible, "it has a start of its own"
    say(panel.solve.name, "descent")
    assert panel.solve.seed.visible and panel.solve.start.visible


def test_what_was_measured_offers_no_room_to_simulate(server, work):
    measured = stand_in(work.measurement, "hall", work.scene.solver)
    opened = []
    tab = scenetab.SceneTab(Desk(server.gui, dataclasses.replace(work, scene=measured), 6, opened.append))
    knobs = (tab.microphones, tab.radius, tab.walls, tab.noise, tab.speed, tab.known, tab.seed, tab.apply)
    assert not any(handle.visible for handle in knobs) and "measured" in tab.told.content
    say(tab.apply, True)
    assert opened == [], "a client can press a button that it does not see"
    say(tab.name, "tiny")
    assert all(handle.visible for handle in knobs) and "measured" not in tab.told.content
    say(tab.apply, True)
    assert [one.scene.name for one in opened] == ["tiny"]
    say(tab.name, "hall")
    assert not tab.apply.visible
    namesake = dataclasses.replace(work, scene=stand_in(work.measurement, "tiny", work.scene.solver))
    tab = scenetab.SceneTab(Desk(server.gui, namesake, 6, opened.append))
    assert tab.name.value == "tiny (measured)" and not tab.apply.visible
    say(tab.name, "tiny")
    assert tab.apply.visible, "the scene of that name is there, too"
    server.gui.reset()


def test_controls_that_mean_nothing_are_not_shown(controls):
    panel, session = controls
    map_ = panel.map
    map_.choose_modes([1, 2])
    assert map_.which.visible and map_.upto.visible and map_.scale.visible
    say(map_.kind, NOTHING)
    assert not any(handle.visible for handle in (map_.which, map_.upto, map_.text, map_.scale, map_.opacity))
    panel.show(session.view, 3, None, "")
    assert not panel.waits.visible
    say(panel.ellipses, True)
    panel.show(session.view, 3, None, "")
    assert panel.waits.visible, "they come later"
    session.view = dataclasses.replace(session.view, state=dataclasses.replace(session.view.state, finished=True))
    panel.show(session.view, 3, None, "")
    assert not panel.waits.visible


def test_a_mode_that_is_chosen_brings_the_map_back(server, work):
    desk = Desk(server.gui, work, 6)
    map_ = maptab.MapTab(desk)
    tab = modestab.ModesTab(desk, work.problem, map_)
    for act in (lambda: say(tab.high, 4), lambda: tab.press("○5")):
        say(map_.kind, NOTHING)
        assert not desk.choices.shown
        act()
        assert desk.choices.shown and map_.kind.value != NOTHING
    server.gui.reset()


def test_without_bounds_there_is_no_map_and_no_control_of_one(server, work):
    unbounded = dataclasses.replace(work, problem=dataclasses.replace(work.problem, search=None))
    map_ = maptab.MapTab(Desk(server.gui, unbounded, 6))
    assert not any(handle.visible for handle in (map_.kind, map_.which, map_.upto, map_.scale, map_.opacity))
    map_.show(3, None, "")
    assert "search domain" in map_.bar.content
    server.gui.reset()


def test_the_mode_sliders_never_cross(controls):
    panel, session = controls
    say(panel.solve.first, 5)
    say(panel.solve.first, 1)
    say(panel.solve.last, 2)
    assert session.commands == [("use_modes", 5, 5, True), ("use_modes", 1, 3, True), ("use_modes", 1, 2, True)]


def test_what_the_program_sets_is_no_command(controls):
    panel, session = controls
    say(panel.solve.last, 5, client=False)
    panel.show(view_of([State(session.view.state.positions, last=6)]), 4, None, "")
    assert panel.solve.last.value == 6 and panel.map.microphone.value == 4
    assert session.commands == [] and panel.choices.microphone == 3


def test_one_button_runs_and_pauses(controls):
    panel, session = controls
    say(panel.bar.run, True)
    session.view = dataclasses.replace(session.view, running=True)
    panel.show(session.view, 3, None, "")
    assert panel.bar.run.label == "Pause"
    say(panel.bar.run, True)
    assert session.commands == [("play",), ("pause",)]


def test_a_microphone_chosen_by_hand_is_stayed_with(controls):
    panel, _ = controls
    assert panel.choices.follow
    say(panel.map.microphone, 7)
    assert panel.choices.microphone == 7 and not panel.choices.follow and not panel.map.follow.value


def test_callbacks_leave_what_the_main_loop_has_sent_alone(controls):
    panel, session = controls
    panel.show(session.view, 3, None, "")
    before = dict(panel.desk.shown)
    say(panel.map.microphone, 7)
    say(panel.map.follow, True)
    assert panel.desk.shown == before and panel.choices.microphone == 7
    panel.show(session.view, 5, None, "")
    assert panel.map.microphone.value == 5


class Solver:
    """A solver whose maps wait for a gate, and tell in their lowest place for which microphone they are."""

    def __init__(self, measurement):
        self.gate, self.shape = threading.Semaphore(0), measurement.search.shape[::-1]

    def landscape(self, problem, state, n, modes, search=None):
        assert self.gate.acquire(timeout=WAIT)
        cost = np.ones((modes.stop - modes.start, *self.shape))
        cost[0, 0, n] = 0.5
        return cost


@pytest.fixture
def viewer(server, work, monkeypatch):
    """A page without a browser, ticked by the test."""
    monkeypatch.setattr(viewing, "usable_modes", lambda *_: 6)
    monkeypatch.setattr(maps, "STILL", np.inf)  # no fine maps, which would go through the gate, too
    made = viewing.Viewer(server, work, Rooms(Frame(server.gui)), Stage(server))
    yield made
    work.solver.gate.release(99)
    made.close()
    server.gui.reset()
    server.scene.reset()


def mapped(viewer):
    """Let one map be made; the microphone whose map is shown then, None without a map."""
    viewer._work.solver.gate.release()
    assert viewer._maps._worker.wait_for(lambda _: not viewer._maps._worker.busy, WAIT)
    viewer.tick(1e9)
    return shown(viewer)


def shown(viewer):
    floor, search = viewer._drawn.picture.floor, viewer._work.measurement.search
    return None if floor is None else round((floor.minimum[0] - search.origin[0]) / search.step)


def test_a_map_stands_under_its_own_microphone_only(viewer):
    viewer.tick(0.0)
    assert shown(viewer) is None and mapped(viewer) == 3
    say(viewer._controls.map.microphone, 7)
    viewer.tick(0.0)
    assert shown(viewer) is None, "the map of microphone 3 stands under microphone 7"
    assert not any("map" in solid.name for solid in viewer._drawn.picture.solids), "its diamond, too"
    assert mapped(viewer) == 7
    viewer._controls.map.choose_modes([2])
    viewer.tick(0.0)
    assert shown(viewer) is None and mapped(viewer) == 7


def test_maps_stand_side_by_side_and_are_drawn_anew_as_the_look_changes(viewer):
    side = viewer._side.side_by_side

    def drawn():
        return side._worker.wait_for(lambda _: not side._worker.busy, WAIT)

    viewer.tick(0.0)
    assert side.of(None, 0.0) is None and mapped(viewer) == 3 and drawn()
    viewer.tick(2e9)
    first = viewer._side.image
    assert first.visible and first.image.ndim == 3
    light = first.image
    say(viewer._controls.dark, True)
    viewer.tick(3e9)
    mapped(viewer)
    viewer.tick(4e9)
    assert drawn()
    viewer.tick(5e9)
    assert viewer._side.image.image is not light and viewer._side.image.image.shape == light.shape


def test_opacity_takes_no_new_map(viewer):
    """It is on the screen with the next turn, while a solver runs or not."""
    viewer.tick(0.0)
    assert mapped(viewer) == 3
    before = viewer.picture.floor
    say(viewer._controls.map.opacity, 40)
    viewer.tick(1.0)
    assert viewer.picture.floor.opacity == 0.4 and viewer.picture.floor.rgb is before.rgb
    assert not viewer._maps.busy


def test_a_running_solver_draws_the_costs_it_has_in_another_scale(viewer):
    """The gate, which every map of costs has to pass, stays shut."""
    viewer.tick(0.0)
    assert mapped(viewer) == 3
    session, positions = viewer._work.session, viewer._work.measurement.positions
    states = [session.view.state, State(positions + 0.01, 1)]
    history = History(states, 2, session.view.history.lineage)
    session.view = dataclasses.replace(session.view, state=states[1], index=1, count=2, history=history, running=True)
    say(viewer._controls.map.scale, "Linear")
    ready = viewer._maps._worker.latest.ended
    viewer.tick(ready)
    assert viewer._maps._worker.wait_for(lambda latest: not latest.request[0].look.log, WAIT)
    viewer.tick(ready)
    assert shown(viewer) == 3 and not viewer.picture.floor.bar.log


def test_a_hand_has_the_solver_wait_and_the_page_hurry(server, work):
    rung = []
    desk = Desk(server.gui, work, 6, hasten=lambda: rung.append(True))
    tab = maptab.MapTab(desk)
    say(tab.opacity, 50)
    assert work.session.ways == 1 and rung
    say(tab.opacity, 60, client=False)
    assert work.session.ways == 1, "no hand has moved it"
    server.gui.reset()


def test_in_a_drag_the_last_map_stays_until_the_next(viewer):
    viewer.tick(0.0)
    assert mapped(viewer) == 3
    session, positions = viewer._work.session, np.array(viewer._work.measurement.positions)
    ready = viewer._maps._worker.latest.ended
    positions[7] += 0.03
    session.view = view_of([State(positions)])
    viewer.tick(ready + 0.1)
    assert shown(viewer) == 3, "one other microphone has moved"
    viewer.tick(ready + 1.5)
    assert shown(viewer) is None, "but not for long"
    session.view = view_of([State(positions + 0.01)])
    viewer.tick(ready + 0.1)
    assert shown(viewer) is None, "all have moved"


def test_while_running_the_map_of_an_older_state_stays_but_not_over_a_reset(viewer):
    viewer.tick(0.0)
    assert mapped(viewer) == 3
    session, positions = viewer._work.session, viewer._work.measurement.positions
    states = [session.view.state]
    session.view = dataclasses.replace(session.view, history=History(states, 1), running=True)
    viewer.tick(0.0)
    assert shown(viewer) == 3, "the very same state"
    viewer._turn += 1
    viewer.tick(1e9)
    mapped(viewer)
    states.append(State(positions + 0.01, 1))
    session.view = dataclasses.replace(session.view, state=states[1], index=1, count=2, history=History(states, 2))
    viewer.tick(0.0)
    assert shown(viewer) == 3, "an older state of the same run"
    session.view = view_of([State(positions + 0.02)])
    viewer.tick(0.0)
    assert shown(viewer) is None, "the map of the run before the reset"


def test_a_file_tells_of_the_picture_drawn(viewer, monkeypatch):
    asked, session = [], viewer._work.session
    monkeypatch.setattr(viewer._exports.worker, "request", lambda *arguments: asked.append(arguments))
    viewer.tick(0.0)
    session.view = view_of([State(viewer._work.measurement.positions + 0.02, step=9)])
    client = SimpleNamespace(add_notification=lambda *_, **__: None)
    viewer._export(client, exports.PICTURE)
    ((_, kind, moment),) = asked
    assert "step 0" in moment.caption and exports.file_name(moment, kind) == "fdcal-tiny-step-0.png"


@pytest.mark.parametrize("name", ["../../etc/passwd", 'a"b\r\n.exe', "<script>", "", "ü" * 300])
def test_the_name_of_a_file_is_a_name(viewer, name):
    work = dataclasses.replace(viewer._work, scene=dataclasses.replace(viewer._work.scene, name=name))
    found = exports.file_name(dataclasses.replace(viewer._drawn, work=work), exports.KINDS[exports.PICTURE])
    assert re.fullmatch(r"fdcal-[A-Za-z0-9_-]{1,60}-step-0\.png", found)


def test_every_page_gets_its_file(viewer, monkeypatch):
    gate, got, told = threading.Event(), [], []
    monkeypatch.setitem(exports.KINDS, "gated", exports.Kind(".x", "", lambda _: gate.wait(WAIT) and b"x"))
    for page in range(exports.MOST + 9):
        client = SimpleNamespace(
            add_notification=lambda title, *_, **__: told.append(title),
            send_file_download=lambda *_, page=page, **__: got.append(page),
        )
        viewer._export(client, "gated")
    gate.set()
    worker = viewer._exports.worker
    assert worker.wait_for(lambda _: not worker._busy and not worker._waiting, WAIT)
    assert len(got) >= exports.MOST and got == list(range(len(got)))
    assert len(got) + told.count("Too many files are waiting") == exports.MOST + 9


@pytest.mark.parametrize("error", [InputError("no map"), OSError("disk"), ZeroDivisionError("oh")])
def test_a_file_that_cannot_be_made_is_told_on_its_page(viewer, monkeypatch, error):
    told = []

    def fail(_):
        raise error

    monkeypatch.setitem(exports.KINDS, "broken", exports.Kind(".x", "", fail))
    client = SimpleNamespace(add_notification=lambda title, body, **_: told.append((title, body)))
    viewer._export(client, "broken")
    assert viewer._exports.worker.wait_for(lambda latest: latest is not None, WAIT)
    assert told[-1][0] == "Nothing is saved" and str(error) in told[-1][1]


def test_only_a_picture_has_a_size(controls):
    panel, _ = controls
    assert panel.export.size.visible and panel.export.seen.visible
    say(panel.export.kind, "Replay (HTML)")
    assert panel.choices.export_kind == "Replay (HTML)" and "without a server" in panel.export.told.content
    assert not panel.export.size.visible and not panel.export.seen.visible
    for value in JUNK:
        panel.export.choose(value)
        assert panel.choices.export_kind == exports.PICTURE


def test_a_fault_of_the_page_is_told_and_it_goes_on(viewer, monkeypatch, caplog):
    monkeypatch.setattr(viewer._stage, "show", lambda picture: 1 / 0)
    for now in (1.0, 1.1, 1.2):
        viewer.guarded_tick(now)
    assert len(caplog.records) == 1 and "ZeroDivisionError" in viewer._controls.bar.status.content
    monkeypatch.undo()
    for now in (2.0, 20.0, 20.1):
        viewer.guarded_tick(now)
    assert "ZeroDivisionError" not in viewer._controls.bar.status.content


def test_only_what_has_changed_is_sent(server, scene, measurement, monkeypatch):
    stage, sent = Stage(server), []
    monkeypatch.setattr(stage, "_send", lambda name, *_: sent.append(name) or SimpleNamespace(remove=lambda: None))
    still = compose(scene, measurement)
    stage.show(with_estimate(still, measurement, measurement.positions))
    assert "room/walls" in sent and "microphones/estimate" in sent
    sent.clear()
    stage.show(with_estimate(still, measurement, measurement.positions.copy()))
    assert sent == []
    stage.show(with_estimate(still, measurement, measurement.positions + 0.01))
    assert {name.removesuffix("_halo") for name in sent} == {
        "microphones/estimate",
        "microphones/error",
        "microphones/known",
    }


def placing(server, scene, measurement) -> cameras.Cameras:
    made = cameras.Cameras(server)
    made.picture = compose(scene, measurement)
    return made


def test_a_page_that_has_the_place_but_not_the_direction_is_told_again(server, scene, measurement):
    """It tells of its camera between two of our orders, and what it tells is then taken for what it has."""
    placed = placing(server, scene, measurement)
    camera = SimpleNamespace(image_width=900, image_height=700)
    client = SimpleNamespace(client_id=1, camera=camera, atomic=contextlib.nullcontext)
    placed.place(client, "top")
    old_opening = camera.fov
    placed.place(client, "3d")
    ordered = SimpleNamespace(**vars(camera))
    camera.look_at = (ordered.position[0], ordered.position[1], 0.0)  # as from the top
    placed.keep_placed(client)
    assert camera.look_at == ordered.look_at
    camera.fov = old_opening
    placed.keep_placed(client)
    assert camera.fov == ordered.fov
    camera.look_at, camera.position = (1.0, 1.0, 0.0), (2.0, 2.0, 5.0)
    placed.keep_placed(client)
    assert camera.look_at == (1.0, 1.0, 0.0), "a hand has shifted it"


def test_the_camera_follows_the_canvas_until_a_hand_moves_it(server, scene, measurement):
    placed = placing(server, scene, measurement)
    camera = SimpleNamespace(image_width=900, image_height=700)
    client = SimpleNamespace(client_id=1, camera=camera, atomic=contextlib.nullcontext)
    placed.place(client, "top")
    near = camera.position
    camera.image_width = 450
    placed.keep_placed(client)
    assert camera.position[2] > 1.5 * near[2], "half the width needs twice the distance"
    moved = (camera.position[0] + 1.0, *camera.position[1:])
    camera.position, camera.image_width = moved, 900
    placed.keep_placed(client)
    assert camera.position == moved
    camera.position = near
    placed.keep_placed(client)
    assert camera.position == pytest.approx(near), "right for this size"
    camera.position = server.initial_camera.position
    placed.keep_placed(client)
    assert camera.position == pytest.approx(near), "the page learnt late where it was to begin"


def test_on_a_telephone_the_panel_covers_nothing(server, scene, measurement):
    placed = placing(server, scene, measurement)
    picture = placed.picture
    camera = SimpleNamespace(image_width=390, image_height=844)
    placed.place(SimpleNamespace(client_id=1, camera=camera, atomic=contextlib.nullcontext), "top")
    distance = camera.position[2]
    height = 2 * distance * np.tan(camera.fov / 2)  # metres, of all that is seen
    lowest = 844 * (0.5 - (picture.focus[1] - camera.look_at[1]) / height)
    highest = 844 * (0.5 - (picture.focus[3] - camera.look_at[1]) / height)
    assert 0 < highest < lowest < 0.4 * 844


def test_a_page_is_made_to_tell_the_size_of_its_canvas(server, scene, measurement):
    """What it tells while panels move may be the size before; later it tells nothing of its own accord."""

    class Browser:
        told, canvas, image_height = 900, 600, 700

        def __init__(self):
            self.client_id, self.camera, self.atomic, self._fov = 1, self, contextlib.nullcontext, 1.0

        @property
        def image_width(self):
            return self.told

        @property
        def fov(self):
            return self._fov

        @fov.setter
        def fov(self, value):
            self.told, self._fov = self.canvas if abs(value / self._fov - 1) < 1e-3 else self.told, value

    placed, client = placing(server, scene, measurement), Browser()
    placed.ask(client, "top")
    placed.answer([])
    assert not hasattr(client, "position"), "a page that has closed meanwhile is left alone"
    placed.ask(client, "top")
    placed.answer([client])
    near, opening = client.position, client.fov
    for _ in range(9):
        placed.keep_all_placed([client])
    assert client.told == client.canvas and client.position[2] > 1.2 * near[2]
    assert client.fov == pytest.approx(opening, rel=2e-4)


def test_plots_hold_finite_numbers_only(server, measurement):
    """uPlot looks for axis ticks for ever when it meets a NaN."""
    curves = plots.Curves(server.gui, measurement)
    worse = measurement.positions + 0.1
    states = [
        State(worse, cost=float("nan")),
        State(measurement.positions, 1, cost=0.0),
        State(worse, 2, last=4, cost=2.0),
    ]
    curves.show(view_of(states), now=0.0)
    for plot in (curves._error, curves._cost):
        assert all(np.isfinite(column).all() for column in plot.data)
        assert len({len(column) for column in plot.data}) == 1 and (np.diff(plot.data[0]) >= 0).all()
        *_, marks, stage = plot.data
        assert np.count_nonzero(marks == 1.0) == 1 and (marks[marks != 1.0] < 0).all(), "one stroke as the mode came in"
        assert (stage == 1).all()


def test_stages_are_marked_and_a_likelihood_below_zero_is_drawn_as_it_is(server, measurement):
    curves, place = plots.Curves(server.gui, measurement), measurement.positions
    states = [State(place, i, i, stage=i // 2, last=6, cost=cost) for i, cost in enumerate((9.0, 3.0, -2.0, -5.0))]
    curves.show(view_of(states[:2]), now=0.0)
    np.testing.assert_allclose(curves._cost.data[1], 10 * np.log10([9, 3]))
    assert "dB" in curves._cost.title
    curves.show(view_of(states), now=1.0)
    x, cost, marks, stage = curves._cost.data
    assert cost.min() == -5 and cost.max() == 9 and "dB" not in curves._cost.title
    assert x[marks == 1.0].tolist() == [2.0], "the one stage that began"
    assert stage[x < 2].tolist() == [1, 1] and stage[x > 2].tolist() == [2]


def test_many_stages_do_not_hide_the_curves(server, measurement):
    curves = plots.Curves(server.gui, measurement)
    curves.show(view_of([State(measurement.positions, i, i, stage=i, last=6) for i in range(57)]), now=0.0)
    x, _, marks, stage = curves._cost.data
    seen = marks > 0
    assert x[seen].tolist() == list(range(1, 57)) and marks.max() < 0.1, "a tick at the bottom for each"
    assert stage.max() == 57 and curves._cost.handle.scales["mark"]["range"] == (0.0, 1.0)


def test_errors_are_drawn_over_whole_decades(server, measurement):
    curves = plots.Curves(server.gui, measurement)
    for shift, wanted in ((0.2, (100, 1000)), (0.0002, (0.1, 1000))):
        curves.show(view_of([State(measurement.positions + 0.2), State(measurement.positions + shift, 1)]), now=shift)
        curves._sent = -1e9
        handle = curves._error.handle
        assert handle.scales["y"]["range"] == pytest.approx(wanted)
        numbers = handle.axes[1]["values"]
        assert (numbers[0], numbers[-1]) == (f"{wanted[0]:g}", "1,000")
        assert len(numbers) == len(handle.axes[1]["splits"]) == 1 + round(np.log10(wanted[1] / wanted[0]))


def test_plots_follow_a_rewound_history(server, measurement):
    curves = plots.Curves(server.gui, measurement)
    states = [State(measurement.positions + 0.1 / (i + 1), i) for i in range(6)]
    curves.show(view_of(states), now=0.0)
    another = [*states[:3], State(measurement.positions + 0.5, 3)]
    curves.show(view_of(another), now=1.0)
    assert len(curves._error.data[0]) == 4
    assert curves._error.data[1][-1] == pytest.approx(1e3 * 0.5 * np.sqrt(2))


def test_the_last_mode_of_the_map_stays(controls):
    panel, _ = controls
    panel.map.choose_modes([3])
    panel.map.toggle_mode(3)
    assert panel.choices.modes == (3,)
    panel.map.toggle_mode(1)
    assert panel.choices.modes == (1, 3) and panel.map.text.value == "1, 3"
    panel.map.choose_modes(None)
    panel.map.toggle_mode(2)
    assert panel.choices.modes == (1, 3), "those in use, 1 to 3, without the second"
    say(panel.map.text, "1-99")
    assert panel.choices.modes == (1, 3) and "1 to 6" in panel.choices.complaint


def test_the_spectrum_is_drawn_with_its_picked_peaks(scene, measurement):
    heard = cached_measurement(scene)
    seen, levels = modestab.levels(heard, 12)
    assert seen.shape[1] <= modestab.MOST_POINTS and seen[1].max() == 0.0
    at, power = heard.spectrum
    for mode, f in enumerate(heard.frequencies):
        near = np.abs(at - f) < scene.measurement.resolution / 2
        assert abs(at[near][power[near].argmax()] - f) <= np.diff(at).max(), f"mode {mode + 1} is no peak"
    assert len(levels) == 12 and (levels >= np.interp(heard.frequencies[:12], *seen) - 1e-9).all()
    nothing, own = modestab.levels(measurement, 6)
    assert nothing is None and own.max() == pytest.approx(0.0)


@pytest.mark.parametrize("heard", [True, False])
def test_modes_slide_into_the_map_and_out_of_it(server, scene, measurement, heard, work):
    if heard:
        kept = measurement.frequencies
        spectrum = np.stack([np.linspace(50, 350, 2000), 1 + np.cos(np.linspace(50, 350, 2000)) ** 2])
        work = dataclasses.replace(work, measurement=dataclasses.replace(measurement, spectrum=spectrum))
        assert kept[0] > 50
    desk = Desk(server.gui, work, 6)
    map_ = maptab.MapTab(desk)
    tab = modestab.ModesTab(desk, work.problem, map_)
    say(tab.high, 4)
    assert desk.choices.modes == (1, 2, 3, 4)
    say(tab.low, 3)
    assert desk.choices.modes == (3, 4)
    say(tab.high, 2)
    assert desk.choices.modes == (2,)
    tab.show(work.session.view, 0.0)
    data = tab.plot.data
    assert len({len(column) for column in data}) == 1 and all(np.isfinite(column).all() for column in data)
    x, curve, outside, inside, limit = data
    low, high = tab.plot.scales["y"]["range"]
    assert (np.diff(x) >= 0).all()
    np.testing.assert_allclose(x[inside > low], [measurement.frequencies[1]])
    np.testing.assert_allclose(x[outside > low], measurement.frequencies[[0, 2, 3, 4, 5]])
    dotted = (inside > low) | (outside > low)
    np.testing.assert_allclose(np.maximum(inside, outside)[dotted], curve[dotted])  # on the curve, and in sight
    assert (curve[dotted] < high).all()
    f_max = round(highest_frequency(work.problem, work.session.view.state.positions))
    assert np.array_equal(x[limit > low], [f_max] if x[0] < f_max < x[-1] else [])
    inner = tab._data((1,), 200.0)
    assert np.array_equal(inner[0][inner[-1] > low], [200.0]) and len({len(column) for column in inner}) == 1
    say(tab.own, True)
    assert desk.choices.modes is None
    server.gui.reset()


def test_microphones_are_listed_worst_first(measurement):
    offsets = 0.001 * np.array([0, 0, 0, 5, 9, 1, 7, 3, 2, 4])
    html = words.table(measurement, measurement.positions + offsets[:, None] * [1, 0], None, 6)
    numbers = [int(number) for number in re.findall(r"<tr[^>]*><td>(\d+)(?: known)?</td>", html)]
    assert numbers == [4, 6, 3, 9, 7, 8, 5, 0, 1, 2]
    assert (
        "<td>9</td>" in html
        and "error<br>(mm)" in html
        and html.count("known") == 3
        and "700" in html.split("<td>6</td>")[0].rpartition("<tr")[2]
    )


def test_modes_beyond_f_max_are_warned_of(measurement):
    assert "beyond" not in words.modes_lines(measurement, (1, 2), 500, 3)
    html = words.modes_lines(measurement, (1, 6), 299, 3)
    assert "beyond" in html and "300.0 Hz" in html and "299 Hz" in html and "7 functions for 10" in html


def test_uncertainty_is_told_of_finished_states_only(measurement, monkeypatch):
    made, asked = spreads.Spreads(SimpleNamespace()), []
    assert made.close(WAIT)
    monkeypatch.setattr(made._worker, "request", asked.append)
    going, done = State(measurement.positions), State(measurement.positions, finished=True)
    for state in (going, done):
        assert made.of(state, False, 0.0) is None and made.of(state, False, 9.0) is None
    assert len(asked) == 1 and asked[0] is done


def test_words_are_escaped(measurement):
    evil = "<script>alert(1)</script>"
    state = State(measurement.positions)
    for html in (
        words.status(view_of([state], error=evil), measurement),
        words.waiting(evil, evil),
        words.colour_bar(None, evil),
    ):
        assert "<script" not in html and "&lt;script" in html


def test_status_tells_units_and_doings(measurement):
    state = State(measurement.positions + np.array([0.003, 0.004]), step=7, sweep=1, moved=4)
    html = words.status(view_of([state]), measurement)
    for text in ("Paused", "step 7, sweep 1, stage 1", "modes 1 to 3, 100.0 to 180.0 Hz", "5 mm", "dimensionless"):
        assert text in html
    assert "(pressure squared)" in words.status(view_of([state]), measurement, "raw")
    assert "Running" in words.status(view_of([state], running=True), measurement)
    assert "unknown" in words.status(view_of([state]), dataclasses.replace(measurement, positions=None))


# -- before there is a session ---------------------------------------------------------------------------------------


@pytest.fixture
def page_of(server, scene, kernels):
    """A page without a browser, turned by the test; and what it takes to be ready."""
    made = Page(server, Stage(server))

    def turn_until(happened):
        for _ in range(round(WAIT / 0.02)):
            made.turn(time.perf_counter())
            if happened():
                return
            time.sleep(0.02)
        pytest.fail("it does not happen")

    yield made, turn_until
    made.close()
    server.gui.reset()
    server.scene.reset()


def test_the_page_tells_how_far_the_simulation_is(page_of, scene, monkeypatch, capsys):
    """The simulation goes on only once the page has been told."""
    page, turn_until = page_of

    def slow(scene, progress):
        progress(0.4)
        for _ in range(600):
            if "40 %" in page.notice.line.content and page.notice.bar.value == 40:
                raise InputError("scene.key = 1 is wrong; mend it")
            time.sleep(0.02)

    monkeypatch.setattr(preparing, "cached_measurement", slow)
    page.open(Opening(scene))
    with pytest.raises(InputError, match="mend it"):
        turn_until(lambda: False)
    assert "40 %" in capsys.readouterr().err


def test_the_room_is_there_while_the_solver_is_being_prepared(page_of, scene, monkeypatch):
    """As soon as the simulation is over; of an array of which nothing is told, no microphone is drawn as known."""
    page, turn_until = page_of
    prepare, sound = threading.Event(), cached_measurement(scene)
    monkeypatch.setattr(preparing, "cached_measurement", lambda scene, progress: sound)
    monkeypatch.setattr(preparing.Rehearsal, "wait_for_first", lambda *_: prepare.wait(WAIT))
    page.open(Opening(edited(scene, {"solver.known": "none"})))
    assert page.stage.bare
    turn_until(lambda: not page.stage.bare)
    assert page.viewer is None and "microphones/true" in page.stage._nodes
    assert not any("known" in name or "estimate" in name for name in page.stage._nodes)
    prepare.set()
    turn_until(lambda: page.viewer is not None)
    assert "microphones/estimate" in page.stage._nodes


def test_what_the_cache_holds_is_shown_at_once(server, scene):
    stage = Stage(server)
    look_at_once(stage, Opening(edited(scene, {"seed": 987654})))
    assert stage.bare, "it has to be simulated first"
    cached_measurement(scene)
    look_at_once(stage, Opening(scene))
    assert {"microphones/true", "microphones/known", "room/walls"} <= stage._nodes.keys()
    server.scene.reset()


def test_another_scene_takes_the_place_of_the_first(page_of, scene):
    """The first goes on until the second is ready; what the page looks like is kept, tabs stay."""
    page, turn_until = page_of
    page.open(Opening(scene))
    turn_until(lambda: page.viewer is not None)
    first, tabs = page.desk, dict(page.frame._tabs)
    first.look(dark=True, log=False)
    first.choose(trails=True)
    page.open(Opening(edited(scene, {"solver.name": "descent"}), start_seed=5, choices={"microphone": 9, "modes": [2]}))
    assert page.desk is first
    turn_until(lambda: page.desk is not first)
    choices, session = page.desk.choices, page.desk.session
    assert choices.look.dark and not choices.look.log and choices.trails
    assert choices.microphone == 9 and choices.modes == (2,) and session.view.state.seed == 5
    assert page.frame._tabs == tabs and page.viewer._controls.map.microphone.value == 9
    assert not first.session._thread.is_alive() and session._thread.is_alive()
    session.step()
    turn_until(lambda: "step 1," in page.viewer._controls.bar.status.content)


@pytest.mark.parametrize(
    ("changes", "choices", "told"),
    [
        ({"solver.modes": 500}, {}, "modes"),
        ({"gauge.known": [0, 99]}, {}, "gauge.known"),
        ({}, {"microphone": 99}, "choices.microphone"),
        ({}, {"colour": 1}, "choices.colour"),
    ],
)
def test_what_cannot_be_opened_is_told_and_the_old_one_stays(page_of, scene, changes, choices, told):
    page, turn_until = page_of
    page.open(Opening(scene))
    turn_until(lambda: page.viewer is not None)
    before = page.desk
    page.open(Opening(edited(scene, changes), choices=choices))
    turn_until(lambda: page.switch.refusal)
    page.turn(0.0)
    assert page.desk is before and told in page.notice.line.content and page.notice.button.label == "Close"
    before.session.step()
    turn_until(lambda: "step 1," in page.viewer._controls.bar.status.content)
    page.switch.cancel()
    page.turn(0.0)
    assert not page.notice.line.visible and not page.notice.button.visible


def test_cancel_keeps_the_old_session(page_of, scene, monkeypatch):
    page, turn_until = page_of
    page.open(Opening(scene))
    turn_until(lambda: page.viewer is not None)
    before, ended = page.desk, threading.Event()

    def endless(scene, progress):
        try:
            while True:
                progress(0.1)
                time.sleep(0.01)
        finally:
            ended.set()

    monkeypatch.setattr(preparing, "cached_measurement", endless)
    page.open(Opening(scene))
    turn_until(lambda: "10 %" in page.notice.line.content)
    assert page.notice.button.label == "Cancel" and page.notice.button.visible
    event = SimpleNamespace(client=object(), target=page.notice.button)
    for callback in page.notice.button._impl.update_cb:
        finish(callback(event))
    turn_until(lambda: page.switch.progress is None)
    assert ended.wait(WAIT) and page.desk is before and not page.notice.line.visible


def test_a_session_goes_on_from_states_given(page_of, scene):
    page, turn_until = page_of
    problem, joint = cached_measurement(scene).problem("unit"), solvers.load("joint")
    states = [joint.init(problem, scene.solver, 0)]
    for _ in range(3):
        states.append(joint.step(problem, states[-1]))
    page.open(Opening(scene, states=tuple(states), index=2))
    turn_until(lambda: page.viewer is not None)
    view = page.desk.session.view
    assert (view.count, view.index) == (4, 2) and list(view.history) == states
    page.desk.session.step()
    assert page.desk.session.wait_for(lambda view: view.count == 4 and view.index == 3, WAIT)


def test_a_session_saved_is_opened_where_it_was_left(page_of, scene, tmp_path):
    page, turn_until = page_of
    page.open(Opening(edited(scene, {"solver.name": "descent"}), start_seed=3))
    turn_until(lambda: page.viewer is not None)
    first = page.desk
    first.session.sweep()
    assert first.session.wait_for(lambda view: view.count == 14 and not view.running, WAIT)
    first.session.seek(5)
    assert first.session.wait_for(lambda view: view.index == 5, WAIT)
    first.choose(microphone=9, follow=False, modes=(2, 4), trails=True)
    first.look(dark=True, log=False, opacity=0.4)
    turn_until(lambda: page.viewer._drawn.view.index == 5)
    moment = dataclasses.replace(page.viewer._drawn, choices=first.choices)
    path = tmp_path / "left.zip"
    path.write_bytes(exports.KINDS["Session (ZIP)"].make(moment))
    page.open(sessionfile.read(path))
    turn_until(lambda: page.desk is not first)
    again, view = page.desk, page.desk.session.view
    assert exports.choices_told(again.choices) == exports.choices_told(first.choices)
    assert (view.index, view.count, again.choices.seed) == (5, 14, 3)
    panel = page.viewer._controls
    assert panel.dark.value and panel.map.microphone.value == 9 and panel.trails.value
    again.session.step()
    assert again.session.wait_for(lambda view: view.index == 6, WAIT)
    made, before = again.session.view.state, moment.view.history[6]
    assert np.array_equal(made.positions, before.positions) and made.cost == before.cost, "the same next state"


@pytest.mark.parametrize("change", [{"solver.name": '"magic"'}, {"solver.modes": "500"}])
def test_a_bad_scene_gets_one_line(edited, change):
    command = [sys.executable, "-m", "fdcal", "view", str(edited(change)), "--port", "0", "--no-browser"]
    run = subprocess.run(command, capture_output=True, timeout=WAIT, env=os.environ)
    assert run.returncode == 2, run.stderr
    line = run.stderr.split(b"\r")[-1]  # progress is written over
    assert line.startswith(b"error: ") and run.stderr.count(b"\n") == 1, run.stderr


def test_an_interrupted_simulation_stops(page_of, scene, monkeypatch):
    page, turn_until = page_of
    begun, ended = [], []

    def endless(scene, progress):
        begun.append(True)
        try:
            while True:
                progress(0.1)
                time.sleep(0.01)
        finally:
            threading.Event().wait(0.3)
            ended.append(True)

    monkeypatch.setattr(preparing, "cached_measurement", endless)
    page.open(Opening(scene))
    turn_until(lambda: begun)
    page.close()
    assert ended, "the simulation's thread must have ended, or it may write half a file"
    progress = preparing.Progress()
    progress.stop = True
    with pytest.raises(preparing.Stopped):
        progress(0.5)


def test_a_ruler_s_numbers_have_the_size_that_the_scene_asks_for(server, scene, measurement):
    stage = Stage(server)
    small = compose(scene, measurement)
    for picture in (small, dataclasses.replace(small, marker=4 * small.marker)):
        stage.show(picture)
        heights = {node.font_scene_height for part, node in stage._nodes.values() if isinstance(part, Label)}
        assert len(heights) == 1 and heights.pop() == pytest.approx(1.5 * picture.marker)
    server.scene.reset()
