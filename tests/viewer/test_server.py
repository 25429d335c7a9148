"""The server: who may connect, what it answers, which values it accepts, and how images are sent."""

import asyncio
import dataclasses
import gzip
import inspect
import io
import re
import socket
import threading
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import viser
import websockets.asyncio.server
from browsing import WAIT
from doubles import INVALID_VALUES, set_by_client
from PIL import Image
from viser import _messages, _scene_api

from fdcal.model.validation import InputError
from fdcal.viewer import app
from fdcal.viewer.server import client_values, hardening
from fdcal.viewer.server.hardening import SafeMessageBuffer, encoded, titled


@pytest.mark.parametrize("atomic", [False, True])
def test_a_message_that_is_pushed_just_before_a_browser_is_waited_for_reaches_it(atomic):
    """asyncio.Event loses one that another thread sets while `wait` has looked at it and does not yet wait."""

    async def first_window():
        loop = asyncio.get_running_loop()
        buffer = SafeMessageBuffer(loop, persistent_messages=True)
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
            other = threading.Thread(target=push)
            other.start()
            other.join()
            return waits()

        event._get_loop = pushed_in_between
        windows = buffer.window_generator(0)
        async with asyncio.timeout(5):
            return await anext(windows)

    with ThreadPoolExecutor(1) as own:  # where a browser was, its driver occupies this thread's event loop
        assert len(own.submit(asyncio.run, first_window()).result(WAIT)) == 1


def test_the_address_can_be_typed_into_a_browser():
    hosts = {"127.0.0.1": "127.0.0.1", "0.0.0.0": "127.0.0.1", "::1": "[::1]", "localhost": "localhost"}
    for host, expected in hosts.items():
        assert app.address(host, 81) == f"http://{expected}:81"
    for host in ("127.0.0.1", "localhost", "::1"):
        assert hardening.is_loopback(host)
    for host in ("0.0.0.0", "", "192.168.1.2", "example.org"):
        assert not hardening.is_loopback(host), "other machines reach it"


def test_a_host_name_that_does_not_resolve_is_tolerated(monkeypatch):
    def unknown(*_):
        raise hardening.socket.gaierror(-2, "Name or service not known")

    monkeypatch.setattr(hardening.socket, "getaddrinfo", unknown)
    assert any(origin.fullmatch("http://127.0.0.1:81") for origin in hardening.allowed_origins("0.0.0.0"))


def test_an_update_is_one_plain_value():
    for updates in ({}, None, [], {"uuid": "x"}, {"value": 1, "update_cb": []}, {"value": "x" * 201}):
        assert not client_values.is_plain(updates)
    for value in (3, 0.5, True, "short"):
        assert client_values.is_plain({"value": value})


@pytest.mark.parametrize("value", INVALID_VALUES, ids=lambda value: repr(value)[:12])
def test_no_control_of_any_tab_takes_an_invalid_value(controls, value):
    assert 1 <= client_values.bounded(value, 1, 9, 5) <= 9 and client_values.bounded(7.0, 1, 9, 5) == 7
    panel, session = controls
    before = panel.binding.choices
    tabs = [*vars(panel).values(), panel.map.slice]
    handles = [one for tab in tabs if hasattr(tab, "__dict__") for one in vars(tab).values() if hasattr(one, "_impl")]
    settable = [one for one in handles if isinstance(one, viser.GuiInputHandle) and one is not panel.map.text]
    assert len(settable) > 30
    for handle in settable:
        if not (isinstance(handle.value, str) and not hasattr(handle, "options")):
            held = handle.value
            set_by_client(handle, value)
            assert client_values.fits(handle, handle.value), handle.label
            handle._impl.value = held
    panel.scene.press()
    assert panel.binding.choices == dataclasses.replace(before, seed=panel.binding.choices.seed) and before.seed >= 0
    assert [name for name, *_ in session.commands if name != "pace"] == []
    assert all(opening.scene is panel.binding.run.scene for opening in session.opened)


SERVE = websockets.asyncio.server.serve


@pytest.fixture
def opened(monkeypatch):
    """The ports at which servers listened meanwhile."""
    ports, listen = [], socket.socket.listen

    def noted(self, *arguments):
        listen(self, *arguments)
        ports.append(self.getsockname()[1])

    monkeypatch.setattr(socket.socket, "listen", noted)
    return ports


def test_a_server_that_opens_refuses_a_foreign_page(server):
    hardening.require_foreign_origin_refused("127.0.0.1", server.get_port())


@pytest.mark.parametrize(
    ("host", "origin", "status"),
    [
        ("localhost:{port}", "http://localhost:{port}", 101),
        ("127.0.0.1:{port}", "http://127.0.0.1:{port}", 101),
        ("LocalHost:9000", "http://localhost:9000", 101),  # a forwarded port
        ("localhost:{port}", "http://localhost:8888", 403),  # another program of this machine serves that page
        ("localhost:{port}", "http://localhost", 403),
        ("127.0.0.1:{port}", "http://localhost:{port}", 403),
        ("localhost:{port}", "null", 403),
        ("127.0.0.1:{port}", "http://127.0.0.1.evil.example", 403),
        ("localhost:{port}", "https://localhost.evil:80", 403),
        ("evil.example:{port}", "http://evil.example:{port}", 403),  # a name that was made to lead to this machine
        ("localhost:{port}", None, 403),
    ],
)
def test_only_the_page_itself_may_connect(server, host, origin, status):
    port = server.get_port()
    lines = ["GET / HTTP/1.1", f"Host: {host}", "Upgrade: websocket", "Connection: Upgrade",
             "Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
             f"Sec-WebSocket-Protocol: viser-v{viser.__version__}"]  # fmt: skip
    lines += [] if origin is None else [f"Origin: {origin}"]
    with socket.create_connection(("127.0.0.1", port), WAIT) as client:
        client.sendall("\r\n".join([*lines, "", ""]).format(port=port).encode())
        assert client.recv(12, socket.MSG_WAITALL) == f"HTTP/1.1 {status}".encode()


def serve_ignoring_origins(patch):
    """A server that takes the restrictions and keeps to none."""

    def careless(*arguments, origins=None, max_size=None, create_connection=None, logger=None, **options):
        return SERVE(*arguments, **options)

    patch.setattr(websockets.asyncio.server, "serve", careless)


def serve_without(option, patch):
    def older(*arguments, **options):
        return SERVE(*arguments, **options)

    parameters = [p for p in inspect.signature(SERVE).parameters.values() if p.name != option]
    older.__signature__ = inspect.Signature(parameters)
    patch.setattr(websockets.asyncio.server, "serve", older)


@pytest.mark.parametrize(
    ("change", "listens"),  # whether it listens for a moment
    [
        (serve_ignoring_origins, True),
        *((partial(serve_without, name), False) for name in ("origins", "max_size", "create_connection", "logger")),
        (lambda patch: patch.delattr(websockets.asyncio.server, "serve"), False),
        (lambda patch: patch.delattr(hardening._infra, "AsyncMessageBuffer"), False),
    ],
)
def test_libraries_that_cannot_be_restricted_are_not_served(monkeypatch, opened, change, listens):
    change(monkeypatch)
    with pytest.raises(InputError, match=r"viser .* and websockets .* cannot be restricted"):
        hardening.open_server("127.0.0.1", 0)
    for port in opened:
        with pytest.raises(OSError):
            socket.create_connection(("127.0.0.1", port), 5).close()
    assert listens is None or bool(opened) == listens


def fetched(server, **headers):
    request = urllib.request.Request(f"http://127.0.0.1:{server.get_port()}/", headers=headers)
    with urllib.request.urlopen(request, timeout=30) as answer:
        body = answer.read()
        assert answer.headers["Content-Security-Policy"] == "frame-ancestors 'self'", "no other site may frame it"
        assert int(answer.headers["Content-Length"]) == len(body)
        return gzip.decompress(body) if answer.headers["Content-Encoding"] == "gzip" else body


@pytest.mark.parametrize("encoding", ["gzip", "identity"])
def test_the_page_has_the_programs_name_before_it_has_loaded(server, encoding):
    for _ in range(2):  # the second time it is kept
        page = fetched(server, **{"Accept-Encoding": encoding})
        assert re.findall(rb"<title>(.*?)</title>", page) == [b"fdcal"]
        assert page.count(b"<script") >= 1 and page.rstrip().endswith(b"</html>")


def test_the_film_stands_before_the_program_of_viser():
    """A browser draws it while it reads the rest, and the server knows then that the page was sent."""
    body = (Path(viser.__file__).parent / "client" / "build" / "index.html").read_bytes()
    film, sent = "<i>film</i>", threading.Event()
    response = SimpleNamespace(headers={"Content-Type": "text/html", "Content-Length": "1"}, body=body)
    page = titled(lambda *_: response, film, sent.set)(None, None).body
    assert sent.is_set() and page.index(film.encode()) < 80_000 < len(page) / 2
    (program,) = re.findall(rb"<script data-p=.*?</script>", body, re.DOTALL)
    assert page.count(program) == 1 and page.index(b"<body>") < page.index(film.encode()) < page.index(program)
    assert page.count(b"</body>") == 1 and page.rstrip().endswith(b"</html>")


def test_any_other_answer_keeps_its_content():
    assert titled(lambda *_: None)(None, None) is None
    for kind, body in (("image/png", b"<title>Viser</title>"), ("text/html", b"<title>Other</title>")):
        response = SimpleNamespace(headers={"Content-Type": kind, "Content-Length": "20"}, body=body)
        before = dict(response.headers)
        assert titled(lambda *_: response)(None, None) is response  # noqa: B023
        assert ({**response.headers, **before}, response.body) == (response.headers, body)


def test_images_are_encoded_quickly_and_come_back_as_they_were(server):
    image = np.random.default_rng(0).integers(0, 256, (7, 11, 4), dtype=np.uint8)
    for picture in (image, image[..., :3]):
        for ordering, shown in (("rgb", picture), ("bgr", picture[:, :, [2, 1, 0, 3][: picture.shape[2]]])):
            np.testing.assert_array_equal(Image.open(io.BytesIO(encoded("png", picture, None, ordering))), shown)
    y, x = np.mgrid[:80, :90]
    image = np.stack([2 * x, 3 * y, x + y], axis=-1).astype(np.uint8)
    fine, coarse = (encoded("jpeg", image, quality, "rgb") for quality in (92, 20))
    assert Image.open(io.BytesIO(fine)).format == "JPEG" and len(coarse) < len(fine), "JPEG has the quality asked for"
    assert np.abs(np.asarray(Image.open(io.BytesIO(fine)), int) - image).mean() < 3
    assert _scene_api.cv2_imencode_with_fallback is encoded
    handle = server.scene.add_image("/test_encoding", np.zeros((4, 4, 3), np.uint8), 1.0, 1.0, format="png")
    assert Image.open(io.BytesIO(handle._data)).size == (4, 4)
    handle.remove()


def test_messages_that_no_page_sends_are_not_handled(server):
    assert {kind.__name__ for kind in server._websock_server._incoming_handlers} == {
        "GuiUpdateMessage", "GuiButtonHoldMessage", "CommandTriggerMessage", "SceneNodeClickMessage",
        "SceneNodeDragMessage", "ScenePointerMessage",
    }  # fmt: skip


def test_an_address_that_cannot_be_served_is_refused(server):
    for port in (-1, 65536, 80000, server.get_port()):
        with pytest.raises(InputError, match="port"):
            hardening.open_server("127.0.0.1", port)
    for host in ("no.such.host.invalid", "999.1.1.1", "\x00", "a" * 300):
        with pytest.raises(InputError, match="host"):
            hardening.open_server(host, 0)
