"""The server: who may connect, what it answers, which values it accepts, and that hostile clients disturb nobody."""

import asyncio
import contextlib
import gzip
import io
import itertools
import logging
import os
import re
import secrets
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import viser
from browsing import WAIT
from doubles import HOSTILE_CAMERAS, INVALID_VALUES, finish, is_served, join, wait_until
from PIL import Image
from viser import _messages, _scene_api
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed

from benchmarks.protocol import CAMERA, connect, send
from fdcal.viewer import app
from fdcal.viewer.server import client_values, hardening
from fdcal.viewer.server import process as error_log
from fdcal.viewer.server.hardening import SafeMessageBuffer, allowed_origins, encoded, own_page_only


def test_a_message_that_is_pushed_just_as_the_sender_begins_to_wait_reaches_the_browser():
    """asyncio.Event loses a `set` from another thread that comes between the check in `wait` and its waiting."""

    async def first_window(atomic):
        buffer = SafeMessageBuffer(asyncio.get_running_loop(), persistent_messages=True)
        event = buffer.message_event
        waits = event._get_loop

        def push():
            if atomic:
                buffer.atomic_start()
            buffer.push(_messages.RunJavascriptMessage("1"))
            if atomic:
                buffer.atomic_end()

        def pushed_in_between():
            del event._get_loop
            with ThreadPoolExecutor(1) as other:
                other.submit(push)
            return waits()

        event._get_loop = pushed_in_between
        async with asyncio.timeout(5):
            return await anext(buffer.window_generator(0))

    with ThreadPoolExecutor(1) as own:  # Playwright's driver runs an event loop in the thread of the test
        for atomic in (False, True):
            assert len(own.submit(asyncio.run, first_window(atomic)).result(WAIT)) == 1


def test_the_address_can_be_typed_into_a_browser():
    hosts = {"127.0.0.1": "127.0.0.1", "0.0.0.0": "127.0.0.1", "::1": "[::1]", "localhost": "localhost"}
    for host, expected in hosts.items():
        assert app.address(host, 81) == f"http://{expected}:81"
    assert all(map(hardening.is_loopback, ("127.0.0.1", "localhost", "::1")))
    assert not any(map(hardening.is_loopback, ("0.0.0.0", "", "192.168.1.2", "example.org"))), "others reach these"


def test_a_host_name_that_does_not_resolve_is_tolerated(monkeypatch):
    def unknown(*_):
        raise hardening.socket.gaierror(-2, "Name or service not known")

    monkeypatch.setattr(hardening.socket, "getaddrinfo", unknown)
    assert any(origin.fullmatch("http://127.0.0.1:81") for origin in hardening.allowed_origins("0.0.0.0"))


@pytest.mark.parametrize(
    ("host", "origin", "status"),
    [
        ("localhost:{port}", "http://localhost:{port}", 101),
        ("127.0.0.1:{port}", "http://127.0.0.1:{port}", 101),
        ("LocalHost:9000", "http://localhost:9000", 101),  # the port is forwarded
        ("localhost:{port}", "http://localhost:8888", 403),  # another program of this machine serves the page
        ("localhost:{port}", "http://localhost", 403),
        ("127.0.0.1:{port}", "http://localhost:{port}", 403),
        ("localhost:{port}", "null", 403),
        ("127.0.0.1:{port}", "http://127.0.0.1.evil.example", 403),
        ("localhost:{port}", "https://localhost.evil:80", 403),
        ("evil.example:{port}", "http://evil.example:{port}", 403),  # a foreign name that resolves to this machine
        ("localhost:{port}", None, 403),
    ],
)
def test_only_the_page_itself_may_connect(server, host, origin, status):
    lines = ["GET / HTTP/1.1", f"Host: {host}", "Upgrade: websocket", "Connection: Upgrade",
             "Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
             f"Sec-WebSocket-Protocol: viser-v{viser.__version__}"]  # fmt: skip
    lines += [] if origin is None else [f"Origin: {origin}"]
    with socket.create_connection(("127.0.0.1", server.get_port()), WAIT) as client:
        client.sendall("\r\n".join([*lines, "", ""]).format(port=server.get_port()).encode())
        assert client.recv(12, socket.MSG_WAITALL) == f"HTTP/1.1 {status}".encode()


def fetched(server, **headers):
    request = urllib.request.Request(f"http://127.0.0.1:{server.get_port()}/", headers=headers)
    with urllib.request.urlopen(request, timeout=30) as answer:
        body = answer.read()
        assert answer.headers["Content-Security-Policy"] == "frame-ancestors 'self'", "no other site may frame it"
        assert int(answer.headers["Content-Length"]) == len(body)
        return gzip.decompress(body) if answer.headers["Content-Encoding"] == "gzip" else body


@pytest.mark.parametrize("encoding", ["gzip", "identity"])
def test_the_page_has_the_programs_name_before_it_has_loaded(server, encoding):
    for _ in range(2):  # the second call finds the kept page
        page = fetched(server, **{"Accept-Encoding": encoding})
        assert re.findall(rb"<title>(.*?)</title>", page) == [b"fdcal"]
        assert page.count(b"<script") >= 1 and page.rstrip().endswith(b"</html>")


def test_the_film_stands_before_the_program_of_viser():
    """A browser draws the film while it reads the rest, and the server is informed that the page was sent."""
    body = (Path(viser.__file__).parent / "client" / "build" / "index.html").read_bytes()
    film, sent = "<i>film</i>", threading.Event()
    response = SimpleNamespace(headers={"Content-Type": "text/html", "Content-Length": "1"}, body=body)
    request = SimpleNamespace(headers=Headers({"Host": "127.0.0.1"}), path="/")
    answer = own_page_only(lambda *_: response, allowed_origins("127.0.0.1"), film, sent.set)
    page = answer(SimpleNamespace(remote_address=("127.0.0.1", 1)), request).body
    assert sent.is_set() and page.index(film.encode()) < 80_000 < len(page) / 2
    (program,) = re.findall(rb"<script data-p=.*?</script>", body, re.DOTALL)
    assert page.count(program) == 1 and page.index(b"<body>") < page.index(film.encode()) < page.index(program)
    assert page.count(b"</body>") == 1 and page.rstrip().endswith(b"</html>")


def test_images_are_encoded_quickly_and_come_back_as_they_were(server):
    image = np.random.default_rng(0).integers(0, 256, (7, 11, 4), dtype=np.uint8)
    for picture in (image, image[..., :3]):
        for ordering, shown in (("rgb", picture), ("bgr", picture[:, :, [2, 1, 0, 3][: picture.shape[2]]])):
            np.testing.assert_array_equal(Image.open(io.BytesIO(encoded("png", picture, None, ordering))), shown)
    assert _scene_api.cv2_imencode_with_fallback is encoded
    handle = server.scene.add_image("/test_encoding", np.zeros((4, 4, 3), np.uint8), 1.0, 1.0, format="png")
    assert Image.open(io.BytesIO(handle._data)).size == (4, 4)
    handle.remove()


def test_messages_that_no_page_sends_are_not_handled(server):
    assert {kind.__name__ for kind in server._websock_server._incoming_handlers} == {
        "GuiUpdateMessage", "GuiButtonHoldMessage", "CommandTriggerMessage", "SceneNodeClickMessage",
        "SceneNodeDragMessage", "ScenePointerMessage",
    }  # fmt: skip


UPDATE = {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": 1}}
POINTED = {"name": "a", "instance_index": 4, "modifier": None, "owner": ""}
CLICK = {
    "type": "SceneNodeClickMessage", **POINTED, "ray_origin": [0, 0, 5], "ray_direction": [0, 0, -1.0],
    "screen_pos": [0.5, 0.5],
}  # fmt: skip
DRAG = {
    "type": "SceneNodeDragMessage", **POINTED, "start_position": [0, 0, 0], "end_position": [1.5, 0, 0],
    "phase": "update", "start_screen_pos": [0.1, 0.2], "end_screen_pos": [0.3, 0.4], "button": "left",
}  # fmt: skip
PART = {
    "type": "FileTransferPart", "source_component_uuid": "", "transfer_uuid": "", "part_index": 0, "content": b"raw",
}  # fmt: skip
NOT_PLAIN = (1e400, float("nan"), 2**53 + 1, -(2**63), "x" * 201, [0] * 99, [[[[[[0]]]]]], {1: 2}, b"raw")
NO_NAME = ({"value": 1}, [0, 0], 1.5, None)
NO_POINT = ({"value": 1}, True, "abc", [], [0, 0], [0, 0, [0]], [1e308] * 3, 0.5)


@pytest.mark.parametrize(
    ("message", "changes"),
    [
        (CAMERA, HOSTILE_CAMERAS),
        (UPDATE, [{"updates": {"value": value}} for value in NOT_PLAIN]),
        (UPDATE, [{"uuid": value} for value in (*NOT_PLAIN, *NO_NAME)]),
        (UPDATE, [{"type": "CommandTriggerMessage", "uuid": name} for name in NO_NAME]),
        (CLICK, [{"name": name} for name in NO_NAME]),
        (CLICK, [{key: value} for key in ("ray_origin", "ray_direction") for value in NO_POINT]),
        (DRAG, [{key: value} for key in ("start_position", "end_position", "instance_index") for value in NO_POINT]),
        (UPDATE, [{"type": kind} for kind in ("GuiFormSubmitMessage", "ShareUrlRequest", "RunJavascriptMessage")]),
        (PART, [{"content": value} for value in ("text", None, [1])]),
        (PART, [{key: value} for key in ("transfer_uuid", "name") for value in NO_NAME]),
    ],
    ids=["camera", "value", "control", "command", "node", "click", "drag", "kind", "part", "transfer"],
)
def test_a_message_that_the_page_does_not_send_is_refused(message, changes):
    assert client_values.is_acceptable(message)
    for change in changes:
        assert not client_values.is_acceptable({**message, **change}), change


def test_a_message_that_the_page_sends_is_passed_on():
    for change in ({"fov": 0.06, "far": 4e4}, {"image_width": 0}, {"position": [1.5, -2, 900.0]}):
        assert client_values.is_acceptable({**CAMERA, **change})
    for name in CAMERA.keys() - {"type"}:
        assert not client_values.is_acceptable({key: value for key, value in CAMERA.items() if key != name}), name
    ray = {key: CLICK[key] for key in ("modifier", "ray_direction")}
    assert client_values.is_acceptable({
        "type": "ScenePointerMessage", "event_type": "click", "ray_origin": None, "screen_pos": [[0.5, 0.5]], **ray,
    })  # fmt: skip
    assert client_values.is_acceptable({**DRAG, "instance_index": None})


def test_input_that_is_not_a_message_is_an_error():
    for raw in ("text", b"", b"\xc1", b"\x01", b"\x80", b"\x81\xa4type\x01"):
        with pytest.raises(ValueError):
            client_values.decoded_message(raw)


@pytest.fixture
def dark(tiny_page):
    """A page, a function that ticks it, and one that makes a client set a value and waits for the effect."""
    page, turn_until = tiny_page

    def set_dark(client):
        control = page.viewer.tabs.view.dark
        value = not control.value
        send(client, type="GuiUpdateMessage", uuid=control._impl.uuid, updates={"value": value})
        turn_until(lambda: control.value == value)

    return page, turn_until, set_dark


def test_clients_that_begin_wrongly_or_vanish_and_fifty_more_disturb_nobody(dark, server):
    _, _, set_dark = dark
    junk = (b"", b"\xc1", b"junk" * 99, "text", msgspec.msgpack.encode({"type": "NoSuchMessage"}), b"x" * 500_000)
    with contextlib.ExitStack() as stack:
        clients = [stack.enter_context(join(server)) for _ in range(50)]
        for client, change in zip(clients, [*HOSTILE_CAMERAS[::7], *[{}] * 50], strict=False):
            send(client, **{**CAMERA, **change})
        for raw in junk:
            with contextlib.suppress(ConnectionClosed):
                stack.enter_context(join(server)).send(raw)
        vanishing = stack.enter_context(join(server))
        send(vanishing, **CAMERA)
        vanishing.socket.close()
        set_dark(clients[-1])
        assert is_served(server)
        assert all(client.recv(timeout=WAIT) for client in clients), "each has been sent the page"


def test_a_strangers_text_is_cut_and_escaped_and_the_log_on_the_disk_is_bounded(tmp_path, monkeypatch, capsys):
    assert error_log.printable("a\nb\x1b[0m\u202e") == r"a\nb\x1b[0m\u202e"
    assert error_log.printable("x" * 500, 10) == "x" * 10 + "..."
    monkeypatch.setenv("FDCAL_CACHE", str(tmp_path))
    monkeypatch.setattr(error_log, "MAX_LOG_BYTES", 10_000)
    monkeypatch.setattr(error_log, "MAX_RECORD", 1000)
    with error_log.error_log():
        for n in range(50):
            logging.getLogger("fdcal.test").warning(f"{n} " + "xxx\n" * 5000)
    files = list(tmp_path.iterdir())
    assert len(files) == 2 and all(0 < file.stat().st_size <= 10_000 for file in files)
    assert "49 xxx" in (tmp_path / error_log.LOG_NAME).read_text(encoding="utf-8")
    monkeypatch.setenv("FDCAL_CACHE", str(files[0]))  # no folder, so that the terminal gets the details
    with error_log.error_log():
        logging.getLogger("fdcal.test").error("failed", exc_info=ValueError("the reason"))
    assert "ValueError: the reason" in capsys.readouterr().err


def test_a_value_outside_its_control_is_dropped_before_viser_stores_it(server):
    slider = server.gui.add_slider("Bounded", 1, 9, 1, 5)
    number = server.gui.add_number("Unbounded", 5.0)
    choice = server.gui.add_dropdown("Choice", ("a", "b"), initial_value="a")
    cases = [*((slider, value, 5) for value in (10, 0, True, *INVALID_VALUES)), (slider, 9, 9), (number, 1e17, 5.0)]
    cases += [(number, -3, -3.0), (choice, "c", "a"), (choice, 1, "a"), (choice, "b", "b")]
    for control, value, expected in cases:
        finish_message(server, control, {"value": value})
        assert control.value == expected
    finish_message(server, slider, {"label": "gone"})
    assert slider.label == "Bounded"
    server.gui.reset()


def finish_message(server, control, updates):
    """Do what the server does when a page has sent updates of a control."""
    message = _messages.GuiUpdateMessage(control._impl.uuid, updates)
    finish(server._websock_server._handle_incoming_message(0, message))


# -- too large or too many -------------------------------------------------------------------------------------------


def test_a_client_that_sends_too_much_is_disconnected(server, monkeypatch, caplog):
    monkeypatch.setattr(hardening, "FLOOD_TIME", 0.5)
    raw = msgspec.msgpack.encode({"type": "CommandTriggerMessage", "uuid": "nobody"})
    with join(server) as client, pytest.raises(ConnectionClosed) as caught:
        for _ in range(10**6):
            client.send(raw)
    assert caught.value.rcvd is caught.value.sent is None, "at once, and not because its pings wait for an answer"
    assert "a client that sends too much was disconnected" in caplog.messages


def test_a_client_that_sends_as_much_as_it_may_is_never_delayed(monkeypatch):
    async def received(*_):
        return msgspec.msgpack.encode({"type": "CommandTriggerMessage", "uuid": "nobody"})

    clock = itertools.count(step=client_values.COSTS["CommandTriggerMessage"] / hardening.RATE)
    delays = []
    monkeypatch.setattr(hardening, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    monkeypatch.setattr(hardening, "asyncio", SimpleNamespace(sleep=lambda delay: delays.append(delay) or received()))
    monkeypatch.setattr(hardening.ServerConnection, "recv", received)
    connection = object.__new__(hardening.GuardedConnection)
    for _ in range(int(hardening.BURST)):
        with pytest.raises(StopIteration):
            connection.recv().send(None)
        assert not delays


HANDSHAKE = (
    "GET / HTTP/1.1\r\nHost: localhost\r\nOrigin: http://localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
    "Sec-WebSocket-Protocol: viser-v{}\r\n\r\n"
)


@contextlib.contextmanager
def deaf(server):
    """A client that has connected and reads nothing more."""
    with socket.socket() as client:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        client.settimeout(WAIT)
        client.connect(("127.0.0.1", server.get_port()))
        client.sendall(HANDSHAKE.format(hardening.viser.__version__).encode())
        assert b"101" in client.recv(16)
        yield client


def test_a_client_that_reads_nothing_is_disconnected(server, monkeypatch):
    monkeypatch.setattr(hardening, "STALL_TIME", 0.2)
    text, connected = server.gui.add_html(""), server._websock_server._client_state_from_id
    before = set(connected)
    with deaf(server):
        wait_until(lambda: connected.keys() - before)
        for _ in range(round(WAIT / 0.05)):
            text.content = secrets.token_hex(500_000)  # random text can hardly be compressed
            if not connected.keys() - before:
                break
            time.sleep(0.05)
        assert not connected.keys() - before
    server.gui.reset()


# -- the server's output ---------------------------------------------------------------------------------------------


def test_nothing_is_printed_on_the_event_loop_and_ctrl_c_ends_the_program(tmp_path):
    """Nobody reads the output, and messages about strangers alone would fill a pipe after 16 connections."""
    environment = {**os.environ, "FDCAL_CACHE": str(tmp_path)}
    command = [sys.executable, "-m", "fdcal", "view", "tiny", "--port", "0", "--no-browser"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, env=environment, **pipes) as served:
        try:
            url = served.stdout.readline().strip()
            port = int(url.rpartition(":")[2])
            socket.create_connection(("127.0.0.1", port), WAIT).close()  # no page is connected yet
            for _ in range(18):
                with contextlib.suppress(ConnectionClosed), connect(url, "x" * 4000) as client:
                    client.recv(timeout=WAIT)
                with connect(url) as client, contextlib.suppress(ConnectionClosed):
                    client.send(b"\xc1" * 4000)
                    client.send(msgspec.msgpack.encode({**CAMERA, "wxyz": ["\n" * 4000]}))
                    for _ in range(3):
                        client.recv(timeout=WAIT)
            assert is_served(SimpleNamespace(get_port=lambda: port))
            served.send_signal(signal.SIGINT)
            output, errors = served.communicate(timeout=WAIT)
        finally:
            served.kill()
    assert served.returncode == 0 and "Traceback" not in errors and "viser" not in output + errors, errors
    log = (tmp_path / "view.log").read_text(encoding="utf-8")
    assert "another version" in log and "Traceback" not in log and len(log) < 5000
