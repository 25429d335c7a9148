"""Which messages of a browser are passed on, at what rate, and what the log keeps of the others."""

import logging

import pytest
from clients import CAMERA, HOSTILE_CAMERAS

from fdcal.viewer.server import client_values, connections
from fdcal.viewer.server import process as error_log


@pytest.mark.parametrize("change", HOSTILE_CAMERAS, ids=str)
def test_an_impossible_camera_is_refused(change):
    assert not client_values.is_acceptable({**CAMERA, **change})


@pytest.mark.parametrize("change", [{}, {"fov": 0.06, "far": 4e4}, {"image_width": 0}, {"position": [1.5, -2, 900.0]}])
def test_a_possible_camera_is_passed_on(change):
    assert client_values.is_acceptable({**CAMERA, **change})


@pytest.mark.parametrize("name", sorted(CAMERA.keys() - {"type"}))
def test_a_camera_is_complete(name):
    assert not client_values.is_acceptable({key: value for key, value in CAMERA.items() if key != name})


@pytest.mark.parametrize(
    "value", [1e400, float("nan"), 2**53 + 1, -(2**63), "x" * 201, [0] * 99, [[[[[[0]]]]]], {1: 2}, b"raw"], ids=repr
)
def test_a_value_that_is_not_plain_is_refused(value):
    message = {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": 1}}
    assert client_values.is_acceptable(message)
    assert not client_values.is_acceptable({**message, "updates": {"value": value}})
    assert not client_values.is_acceptable({**message, "uuid": value})


@pytest.mark.parametrize("kind", ["GuiUpdateMessage", "GuiButtonHoldMessage", "CommandTriggerMessage"])
@pytest.mark.parametrize("name", [{"value": 1}, [0, 0], 1.5, None], ids=repr)
def test_a_control_is_named_by_a_text(kind, name):
    assert not client_values.is_acceptable({"type": kind, "uuid": name, "updates": {"value": 1}})


@pytest.mark.parametrize("name", [{"value": 1}, [0, 0], 1.5, None], ids=repr)
def test_a_node_is_named_by_a_text(name):
    assert not client_values.is_acceptable({"type": "SceneNodeClickMessage", "name": name, "instance_index": 1})


@pytest.mark.parametrize("value", [{"value": 1}, True, "abc", [], [0, 0], [0, 0, [0]], [1e308] * 3, 0.5], ids=repr)
def test_a_pointer_points_somewhere(value):
    drag = {
        "type": "SceneNodeDragMessage",
        "start_position": [0, 0, 0],
        "end_position": [1.5, 0, 0],
        "instance_index": 4,
    }
    click = {"type": "SceneNodeClickMessage", "ray_origin": [0, 0, 5], "ray_direction": [0, 0, -1.0]}
    for message in (drag, click, {**click, "ray_origin": None}, {**drag, "instance_index": None}):
        assert client_values.is_acceptable(message)
        for key in message.keys() - {"type"}:
            assert not client_values.is_acceptable({**message, key: value})


@pytest.mark.parametrize(
    "kind", ["FileTransferStartUpload", "ShareUrlRequest", "NoSuchMessage", "RunJavascriptMessage"]
)
def test_a_kind_that_the_page_does_not_send_is_refused(kind):
    assert not client_values.is_acceptable({"type": kind})


@pytest.mark.parametrize("raw", ["text", b"", b"\xc1", b"\x01", b"\x80", b"\x81\xa4type\x01"])
def test_what_is_no_message_is_an_error(raw):
    with pytest.raises(ValueError):
        client_values.decoded_message(raw)


def test_a_client_waits_once_its_budget_is_spent():
    now = [0.0]
    budget = connections.Budget(rate=10.0, burst=5.0, clock=lambda: now[0])
    assert [budget.spend(1.0) for _ in range(5)] == [0.0] * 5
    assert budget.spend(1.0) == pytest.approx(0.1) and budget.spend(2.0) == pytest.approx(0.3)
    now[0] = 100.0
    assert [budget.spend(1.0) for _ in range(6)] == [0.0] * 5 + [pytest.approx(0.1)], "a long rest saves up no more"


def test_the_log_counts_what_strangers_do():
    """A million refused connections are seven short lines."""
    kept, log = connections.StrangerFilter(), logging.getLogger("fdcal.test")
    lines = []
    for _ in range(1500):
        try:
            raise ValueError("line one\nline two \x1b[31m" + "x" * 999)
        except ValueError as error:
            record = log.makeRecord(
                log.name, logging.WARNING, "", 0, "refused %s", ("it",), (type(error), error, error.__traceback__)
            )
        if kept.filter(record):
            lines.append(logging.Formatter().format(record))
    assert len(lines) == 4 and all(len(line) < 300 and line.isprintable() for line in lines)
    assert "1000 times" in lines[-1]


def test_a_strangers_text_is_cut_and_escaped():
    assert error_log.printable("a\nb\x1b[0m\u202e") == r"a\nb\x1b[0m\u202e"
    assert error_log.printable("x" * 500, 10) == "x" * 10 + "..."


def test_the_log_on_the_disk_is_bounded(tmp_path, monkeypatch):
    monkeypatch.setenv("FDCAL_CACHE", str(tmp_path))
    monkeypatch.setattr(error_log, "MAX_LOG_BYTES", 10_000)
    monkeypatch.setattr(error_log, "MAX_RECORD", 1000)
    with error_log.error_log():
        for n in range(50):
            logging.getLogger("fdcal.test").warning(f"{n} " + "xxx\n" * 5000)
    files = list(tmp_path.iterdir())
    assert len(files) == 2 and all(0 < file.stat().st_size <= 10_000 for file in files)
    assert "49 xxx" in (tmp_path / error_log.LOG_NAME).read_text(encoding="utf-8")
