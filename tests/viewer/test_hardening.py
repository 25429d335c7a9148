"""What is accepted from a client, and at which addresses the server listens."""

import contextlib
import threading

import pytest
from browsing import WAIT
from doubles import INVALID_VALUES, finish, set_by_client
from viser import _messages

from fdcal.model.validation import InputError
from fdcal.session.scene_edits import parameters_of
from fdcal.viewer import app
from fdcal.viewer.server import client_values, hardening

MAIN = threading.main_thread()


class RaisingEvent:
    """An event that raises when the main thread sets it."""

    def __init__(self, event):
        self._event, self.woken = event, threading.Event()

    def set(self):
        if threading.current_thread() is MAIN:
            raise RuntimeError("deque mutated during iteration")
        self._event.set()
        self.woken.set()

    def __getattr__(self, name):
        return getattr(self._event, name)


def test_the_event_loop_is_woken_though_push_raises(server):
    buffer = server._websock_server._broadcast_buffer
    buffer.message_event = startled = RaisingEvent(buffer.message_event)
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
        hardening.open_server("127.0.0.1", port)


def test_a_port_in_use_is_refused(server):
    with pytest.raises(InputError, match="port"):
        hardening.open_server("127.0.0.1", server.get_port())


@pytest.mark.parametrize("host", ["no.such.host.invalid", "999.1.1.1", "\x00", "a" * 300])
def test_a_bad_host_is_refused(host):
    with pytest.raises(InputError, match="host"):
        hardening.open_server(host, 0)


@pytest.mark.parametrize(
    ("host", "expected"),
    [("127.0.0.1", "127.0.0.1"), ("0.0.0.0", "127.0.0.1"), ("::1", "[::1]"), ("localhost", "localhost")],
)
def test_the_address_can_be_typed_into_a_browser(host, expected):
    assert app.address(host, 81) == f"http://{expected}:81"


def test_a_host_name_that_does_not_resolve_is_tolerated(monkeypatch):
    def unknown(*_):
        raise hardening.socket.gaierror(-2, "Name or service not known")

    monkeypatch.setattr(hardening.socket, "getaddrinfo", unknown)
    assert any(origin and origin.fullmatch("http://127.0.0.1:81") for origin in hardening.allowed_origins("0.0.0.0"))


@pytest.mark.parametrize("value", INVALID_VALUES, ids=lambda value: repr(value)[:12])
def test_any_value_becomes_a_bounded_number(value):
    assert 1 <= client_values.bounded(value, 1, 9, 5) <= 9


def test_valid_values_pass():
    assert client_values.bounded(7, 1, 9, 5) == 7 and client_values.bounded(7.0, 1, 9, 5) == 7
    for value in (3, 0.5, True, "short"):
        assert client_values.is_plain({"value": value})


@pytest.mark.parametrize("updates", [{}, None, [], {"uuid": "x"}, {"value": 1, "update_cb": []}, {"value": "x" * 201}])
def test_updates_other_than_a_plain_value_are_dropped(updates):
    assert not client_values.is_plain(updates)


@pytest.mark.parametrize(
    "junk", [value for value in INVALID_VALUES if not isinstance(value, (float, int))] + [float("nan")]
)
def test_a_control_keeps_its_value_when_an_invalid_one_arrives(server, junk):
    slider = server.gui.add_slider("Junk", 1, 9, 1, 5)
    message = _messages.GuiUpdateMessage(slider._impl.uuid, {"value": junk})
    finish(server._websock_server._handle_incoming_message(0, message))
    assert slider.value == 5
    message = _messages.GuiUpdateMessage(slider._impl.uuid, {"label": "gone"})
    finish(server._websock_server._handle_incoming_message(0, message))
    assert slider.label == "Junk"
    slider.remove()


@pytest.mark.parametrize("value", INVALID_VALUES, ids=lambda value: repr(value)[:12])
def test_every_control_tolerates_invalid_values(controls, value):
    panel, session = controls
    solve, map_ = panel.solver, panel.map
    handles = [solve.first, solve.last, solve.automatic, panel.run_bar.speed, solve.seed, map_.microphone, map_.follow]
    tab = panel.scene
    handles += [tab.name, tab.microphones, tab.radius, tab.walls, tab.absorption, tab.noise, tab.snr, tab.speed]
    handles += [tab.known, tab.seed, solve.name, solve.start]
    handles += [map_.which, map_.upto, map_.text, map_.kind, map_.scale, map_.opacity, panel.view.dark]
    for handle in handles:
        before = handle.value
        with contextlib.suppress(TypeError, ValueError, OverflowError):  # viser holds values of the control's type only
            value_held = type(before)(value)
            set_by_client(handle, value_held)
            tab.press()
        handle._impl.value = before
    for name, *arguments in session.commands:
        if name == "pace":
            assert 0 <= arguments[0] <= 60
            continue
        first, last, automatic = arguments
        assert name == "use_modes" and 1 <= first <= last <= 6 and isinstance(automatic, bool)
    for opening in session.opened:
        parameters = parameters_of(opening.scene)
        assert (
            4 <= parameters.microphones <= 150
            and 0.05 <= parameters.radius <= 3
            and 3 <= parameters.known < parameters.microphones
        )
        assert abs(parameters.sound_speed_error) <= 0.05 and parameters.snr_db >= -10 and 0 <= parameters.seed < 2**31
    choices = panel.binding.choices
    assert 0 <= choices.microphone < 10 and 0.1 <= choices.style.opacity <= 1 and choices.seed >= 0
    assert choices.modes is None or set(choices.modes) <= set(range(1, 7))
