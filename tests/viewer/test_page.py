"""The page in a real browser: keys, a lesson, and clients that send malformed or hostile messages."""

import contextlib
import http.server
import logging
import re
import threading
from types import SimpleNamespace

import msgspec
import pytest
import viser
from browsing import begin_anew, opened_page, press, serving_here
from websockets.exceptions import ConnectionClosed

from benchmarks.protocol import CAMERA, connect, send
from fdcal.model.scene_file import load_scene
from fdcal.session.lesson import load_lesson
from fdcal.viewer.server import hardening

WAIT = 60.0  # s, bound of every wait


LESSON = "3_too_many_too_soon"


@pytest.fixture(scope="module")
def served(kernels):
    """Address of a server, and a function that replaces it by another one at the same address."""
    scene, lessons = load_scene("tiny"), (load_lesson(LESSON),)
    with contextlib.ExitStack() as stack:
        url = stack.enter_context(serving_here(scene, lessons=lessons))

        def restart():
            stack.close()
            stack.enter_context(serving_here(scene, lessons=lessons, port=int(url.rpartition(":")[2])))

        yield SimpleNamespace(url=url, restart=restart)


@pytest.fixture(scope="module")
def page(served, browser):
    page = opened_page(browser, served.url)
    page.get_by_text("step 0, sweep 0").wait_for()
    yield page
    page.close()


@pytest.fixture(autouse=True)
def no_fault(caplog, request):
    """Nothing that a client does is a fault of the server; what is said of strangers is of the connections."""
    yield
    if "served" in request.fixturenames:
        faults = [record for record in caplog.records if record.levelno >= logging.ERROR]
        assert [record.getMessage() for record in faults if record.name != hardening.log.name] == []


def alive(page):
    """The page does what a button says."""
    begin_anew(page)
    press(page, "Step")
    page.get_by_text(re.compile("^step 1, ")).wait_for()


def test_keys_do_what_buttons_do(page):
    begin_anew(page)
    page.keyboard.press("n")
    page.get_by_text(re.compile("^step 1, ")).wait_for()
    page.keyboard.press("b")
    page.get_by_text("step 0, sweep 0").wait_for()
    page.get_by_role("tab", name="Map", exact=True).click()
    page.keyboard.press("m")
    page.get_by_text(re.compile("^microphone 2,")).first.wait_for()
    page.keyboard.press("Shift+M")
    page.get_by_text(re.compile("^microphone 1,")).first.wait_for()
    page.get_by_role("tab", name="Help", exact=True).click()
    page.get_by_text("Previous state").wait_for()


def test_a_key_does_nothing_while_a_text_is_typed(page):
    begin_anew(page)
    page.get_by_role("tab", name="Map", exact=True).click()
    page.keyboard.press("o")
    field = page.locator("//label[.='Mode numbers']/following::input[1]").first
    field.click()
    page.keyboard.type("n")
    page.keyboard.press("Escape")
    page.get_by_text("step 0, sweep 0").wait_for()
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("u")


def test_a_lesson_runs_from_its_start_to_the_answer(page):
    lesson = load_lesson(LESSON)
    press(page, "Lessons")
    press(page, lesson.title)
    page.get_by_text(f"{lesson.title}, step 1 of 3").wait_for()
    page.get_by_text("modes 1 to 20, 102.1 to 591.8 Hz").wait_for()
    page.locator(".fdcal-legend").get_by_text("modes 1 to 20").wait_for()
    press(page, lesson.steps[0].choices[1])
    page.get_by_text("Right.", exact=True).wait_for()
    page.get_by_text("After 7 sweeps").wait_for()
    page.get_by_text("sweep 7").wait_for()
    page.get_by_text("Converged", exact=True).wait_for()
    press(page, "Next step")
    page.get_by_text(f"{lesson.title}, step 2 of 3").wait_for()
    page.get_by_text("step 0, sweep 0").wait_for()
    press(page, "End lesson")
    page.locator("[data-region=caption]").wait_for(state="hidden")


# -- hostile and malformed clients -----------------------------------------------------------------------------------


def join(served):
    """A client other than a browser."""
    return connect(served.url)


def test_malformed_messages_do_not_disturb_other_clients(served, page):
    for raw in (b"", b"\xc1", b"junk" * 99, "text", msgspec.msgpack.encode({"type": "NoSuchMessage"}), b"x" * 500_000):
        with join(served) as client, contextlib.suppress(ConnectionClosed):
            client.send(raw)
    with join(served) as client:
        send(client, **CAMERA)
        for change in (
            {"image_width": "wide"}, {"image_height": float("nan")}, {"image_width": 10**18}, {"image_width": -5},
            {"position": ["a", "b", "c"]}, {"position": []}, {"position": None}, {"look_at": [1e308] * 3},
        ):  # fmt: skip
            send(client, **{**CAMERA, **change})
        send(client, type="GuiUpdateMessage", uuid="nobody", updates={"value": 1})
        send(client, type="CommandTriggerMessage", uuid="nobody")
        send(client, type="SceneNodeClickMessage", name="/picking/0", instance_index=10**9)
        alive(page)
        page.wait_for_timeout(1200)  # one look at all canvases
        alive(page)


def test_a_client_that_disconnects_does_not_disturb_others(served, page):
    client = join(served)
    send(client, **CAMERA)
    client.socket.close()
    alive(page)


def test_fifty_clients_do_not_disturb_the_page(served, page):
    with contextlib.ExitStack() as stack:
        clients = [stack.enter_context(join(served)) for _ in range(50)]
        for client in clients:
            send(client, **CAMERA)
        alive(page)
        assert all(client.recv(timeout=WAIT) for client in clients), "each has been sent the page"


@pytest.fixture
def elsewhere():
    """Address of an empty page of another site, which leads to this machine."""

    class Empty(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Empty) as site:
        threading.Thread(target=site.serve_forever, daemon=True).start()
        yield f"http://evil.example:{site.server_port}/"
        site.shutdown()


KNOCK = """([url, protocol]) => new Promise(resolve => {
    const socket = new WebSocket(url, [protocol]);
    socket.onopen = () => resolve("open");
    socket.onerror = () => resolve("refused");
})"""


def test_a_page_of_another_site_is_refused_by_a_real_browser(served, browser, elsewhere):
    door = [served.url.replace("http", "ws"), f"viser-v{viser.__version__}"]
    for address, answer in ((served.url, "open"), (elsewhere, "refused")):
        visitor = browser.new_page()
        visitor.goto(address)
        assert visitor.evaluate(KNOCK, door) == answer, address
        visitor.close()


def test_a_page_reconnects_to_a_restarted_server(served, page):
    alive(page)
    served.restart()
    page.get_by_text("step 0, sweep 0").wait_for()
    alive(page)
