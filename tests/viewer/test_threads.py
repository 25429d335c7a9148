"""Openings that are cancelled or superseded, and sessions that are replaced, leave no thread behind."""

import collections
import threading
import time

import pytest
from browsing import WAIT

from fdcal.session.request import OpenRequest
from fdcal.viewer.background import prepare as preparing
from fdcal.viewer.background import prepare as warmup
from fdcal.viewer.session_switch import SessionSwitcher


def names():
    return collections.Counter(t.name for t in threading.enumerate() if t.name.startswith("fdcal"))


def until(happened):
    for _ in range(round(WAIT / 0.02)):
        if happened():
            return
        time.sleep(0.02)
    pytest.fail("it does not happen")


def test_scene_switches_leave_no_thread(page_of, scene):
    page, turn_until = page_of
    page.open(OpenRequest(scene))
    turn_until(lambda: page.viewer is not None)
    start = names()
    for n in range(8):
        old = page.viewer
        page.open(OpenRequest(scene, start_seed=90 + n))  # superseded
        if n % 2:
            turn_until(lambda: page.switcher.progress is not None)
        page.open(OpenRequest(scene, start_seed=n))
        if n % 3 == 2:
            turn_until(lambda: page.switcher.progress is not None)
            page.switcher.cancel()
            turn_until(lambda: page.switcher.idle)
        else:
            turn_until(lambda old=old: page.viewer is not old)
    turn_until(lambda: names() == start)


@pytest.mark.parametrize("stop", ["cancel", "close"])
def test_a_compilation_is_waited_for(scene, monkeypatch, stop):
    """It cannot be interrupted: a cancelled opening ends its thread after it, and closing waits for that."""
    begun, go_on, before = threading.Event(), threading.Event(), names()["fdcal-warmup"]
    monkeypatch.setattr(warmup, "warmup_calls", lambda _: [("", lambda: begun.set() or go_on.wait(WAIT))])
    switcher = SessionSwitcher()
    switcher.open(OpenRequest(scene))
    switcher.poll()
    assert begun.wait(WAIT) and switcher.compiling
    if stop == "cancel":
        switcher.cancel()
        switcher.poll()
        go_on.set()

        def ended():
            switcher.poll()  # as the main loop of the page does
            return names()["fdcal-warmup"] <= before

        until(ended)
        switcher.close()
    else:
        threading.Timer(1.5, go_on.set).start()
        switcher.close(timeout=WAIT)
        assert names()["fdcal-warmup"] <= before


def test_a_refused_opening_leaves_no_thread(scene, monkeypatch):
    before = names()["fdcal-warmup"]

    def failing(*_):
        raise OSError("the disk is full")

    monkeypatch.setattr(preparing, "cached_measurement", failing)
    with pytest.raises(OSError):
        preparing.prepare_run(OpenRequest(scene), preparing.PreparationProgress())
    until(lambda: names()["fdcal-warmup"] <= before)
