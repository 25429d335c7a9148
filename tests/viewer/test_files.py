"""Files that the page saves."""

import dataclasses
import re
import threading
from types import SimpleNamespace

import pytest
from browsing import WAIT
from doubles import State, view_of

from fdcal.model.validation import InputError
from fdcal.viewer.tabs import view as exports


def test_a_file_describes_the_picture_drawn(viewer, monkeypatch):
    asked, session = [], viewer.run.session
    monkeypatch.setattr(viewer.exports.worker, "request", lambda *arguments: asked.append(arguments))
    viewer.tick(0.0)
    session.view = view_of([State(viewer.run.measurement.positions + 0.02, step=9)])
    client = SimpleNamespace(add_notification=lambda *_, **__: None)
    viewer.export(client, exports.PICTURE)
    ((_, kind, moment),) = asked
    assert "step 0" in moment.caption and exports.file_name(moment, kind) == "fdcal-tiny-step-0.png"


@pytest.mark.parametrize("name", ["../../etc/passwd", 'a"b\r\n.exe', "<script>", "", "ü" * 300])
def test_the_name_of_a_file_is_a_name(viewer, name):
    run = dataclasses.replace(viewer.run, scene=dataclasses.replace(viewer.run.scene, name=name))
    found = exports.file_name(dataclasses.replace(viewer.snapshot, run=run), exports.KINDS[exports.PICTURE])
    assert re.fullmatch(r"fdcal-[A-Za-z0-9_-]{1,60}-step-0\.png", found)


@pytest.fixture
def saving(threads):
    return exports.Exports(threads)


def test_every_page_gets_its_file(viewer, saving, monkeypatch):
    gate, got, notified = threading.Event(), [], []
    monkeypatch.setitem(exports.KINDS, "gated", exports.Kind(".x", "", lambda _: gate.wait(WAIT) and b"x"))
    for page in range(exports.MAX_WAITING + 9):
        client = SimpleNamespace(
            add_notification=lambda title, *_, **__: notified.append(title),
            send_file_download=lambda *_, page=page, **__: got.append(page),
        )
        saving.ask(client, "gated", viewer.snapshot)
    gate.set()
    assert saving.worker.wait_for(lambda _: not saving.worker.busy, WAIT)
    assert len(got) >= exports.MAX_WAITING and got == list(range(len(got)))
    assert len(got) + notified.count("Too many files are waiting") == exports.MAX_WAITING + 9


@pytest.mark.parametrize("error", [InputError("no map"), OSError("disk"), ZeroDivisionError("oh")])
def test_a_file_that_cannot_be_made_is_reported_on_its_page(viewer, saving, monkeypatch, error):
    notified = []

    def fail(_):
        raise error

    monkeypatch.setitem(exports.KINDS, "broken", exports.Kind(".x", "", fail))
    client = SimpleNamespace(add_notification=lambda title, body, **_: notified.append((title, body)))
    saving.ask(client, "broken", viewer.snapshot)
    assert saving.worker.wait_for(lambda latest: latest is not None, WAIT)
    assert notified[-1][0] == "The file could not be made" and str(error) in notified[-1][1]
