"""A page that shows one scene after the other keeps neither the memory nor the threads of the old ones."""

import gc
import time
import weakref

import numpy as np
from browsing import WAIT

from benchmarks.bench_switches import MAX_GROWTH, soak
from fdcal.session.sources import OpenRequest
from fdcal.viewer import page as page_module


def test_a_session_that_was_replaced_is_released(page_of, scene, server, monkeypatch):
    """Without waiting for Python's own collector, and with no message left about controls that were removed."""
    monkeypatch.setattr(page_module, "RELEASE_DELAY", 0.1)
    page, turn_until = page_of
    page.open(OpenRequest(scene))
    turn_until(lambda: page.viewer is not None)
    messages, sizes = server._websock_server._broadcast_buffer.message_from_id, []
    gc.disable()
    try:
        for n in range(3):
            old, viewer = weakref.ref(page.viewer), page.viewer
            page.open(OpenRequest(scene, start_seed=n))
            turn_until(lambda viewer=viewer: page.viewer is not viewer)
            del viewer
            turn_until(lambda old=old: old() is None)
            sizes.append(len(messages))
    finally:
        gc.enable()
    assert np.ptp(sizes[1:]) < 20, sizes


def test_a_session_is_released_though_a_release_was_due_as_it_was_replaced(page_of, scene, monkeypatch):
    """Each session has a release of its own after its end: one that is due at once finds it still in use."""
    monkeypatch.setattr(page_module, "RELEASE_DELAY", 0.1)
    page, turn_until = page_of
    page.open(OpenRequest(scene))
    turn_until(lambda: page.viewer is not None)  # from now on a release is due
    old, used = weakref.ref(page.viewer), page.viewer
    gc.disable()
    try:
        page.open(OpenRequest(scene, start_seed=1))
        page.tick(0.0)  # prepares it
        turn_until_ready(page)
        time.sleep(0.1)
        page.tick(time.perf_counter())  # both at once
        assert page.viewer is not used
        del used
        turn_until(lambda: old() is None)
    finally:
        gc.enable()


def turn_until_ready(page):
    """Wait until the session in preparation can be shown, and do not show it."""
    current, end = page.switcher._current, time.perf_counter() + WAIT
    while not current.done:
        assert time.perf_counter() < end
        time.sleep(0.01)


def test_the_memory_of_a_server_does_not_grow_by_scene_switches():
    seen = soak(8, ["tiny"], settle_time=3.0)
    assert seen.end - seen.start <= MAX_GROWTH and seen.threads_left <= 0 and not seen.errors
