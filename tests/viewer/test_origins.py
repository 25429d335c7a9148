"""A page of another site is refused; where that can no longer be had, no page is served."""

import inspect
import socket
from types import SimpleNamespace

import pytest
import viser
import websockets.asyncio.server
from viser.infra import _infra

from fdcal.model.validation import InputError
from fdcal.viewer.server import hardening
from fdcal.viewer.server import hardening as message_buffer
from fdcal.viewer.server import hardening as origin_probe

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


def refused(opened):
    """Whether no server is opened, and none is left listening."""
    with pytest.raises(InputError, match=r"viser .* and websockets .* cannot be restricted"):
        hardening.open_server("127.0.0.1", 0)
    for port in opened:
        with pytest.raises(OSError):
            socket.create_connection(("127.0.0.1", port), 5).close()


def test_a_server_that_opens_refuses_a_foreign_page(server):
    origin_probe.require_foreign_origin_refused("127.0.0.1", server.get_port())


def test_viser_that_takes_serve_from_elsewhere_is_not_served(monkeypatch, opened):
    elsewhere = SimpleNamespace(asyncio=SimpleNamespace(server=SimpleNamespace(serve=SERVE)))
    elsewhere.exceptions, elsewhere.datastructures = _infra.websockets.exceptions, _infra.websockets.datastructures
    elsewhere.asyncio.server.ServerConnection = websockets.asyncio.server.ServerConnection
    monkeypatch.setattr(_infra, "websockets", elsewhere)
    refused(opened)
    assert opened, "it did listen, for a moment"


def test_websockets_that_ignores_the_origins_is_not_served(monkeypatch, opened):
    def careless(*arguments, origins=None, max_size=None, create_connection=None, logger=None, **options):
        return SERVE(*arguments, **options)

    monkeypatch.setattr(websockets.asyncio.server, "serve", careless)
    refused(opened)


@pytest.mark.parametrize("name", ["origins", "max_size", "create_connection", "logger"])
def test_websockets_without_an_option_is_not_served(monkeypatch, opened, name):
    def older(*arguments, **options):
        return SERVE(*arguments, **options)

    parameters = [p for p in inspect.signature(SERVE).parameters.values() if p.name != name]
    older.__signature__ = inspect.Signature(parameters)
    monkeypatch.setattr(websockets.asyncio.server, "serve", older)
    refused(opened)
    assert not opened


def test_websockets_without_serve_is_not_served(monkeypatch, opened):
    monkeypatch.delattr(websockets.asyncio.server, "serve")
    refused(opened)


@pytest.mark.parametrize("name", ["_websock_server", "gui"])
def test_viser_without_a_private_name_is_not_served(monkeypatch, opened, name):
    class Renamed(viser.ViserServer):
        def __getattribute__(self, asked):
            if asked == name and object.__getattribute__(self, "__dict__").get("complete"):
                raise AttributeError(f"no {name}")
            return super().__getattribute__(asked)

        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            self.complete = True

        def stop(self):
            self.complete = False
            super().stop()

    monkeypatch.setattr(viser, "ViserServer", Renamed)
    refused(opened)


def test_viser_without_its_message_buffer_is_not_served(monkeypatch, opened):
    monkeypatch.delattr(message_buffer._infra, "AsyncMessageBuffer")
    refused(opened)
    assert not opened
