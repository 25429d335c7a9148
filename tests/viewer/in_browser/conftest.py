"""One server and one page for all of these tests, because opening another page takes longer than a test."""

import contextlib
from types import SimpleNamespace

import numpy as np
import pytest
from browsing import opened_page, restart_solver, serving_here, tab, until

from fdcal.model.scene import load_scene
from fdcal.session.lesson import load_lesson
from fdcal.session.scene_edits import edited
from fdcal.viewer import cost_maps, panels


@pytest.fixture(scope="package")
def served(kernels):
    """Address of a server of `tiny` with visible steps of descent, and functions that stop and start it."""
    quick = {"solver.name": "descent", "solver.modes": 6}  # a run takes a quarter of the steps that 20 modes need
    scene, lessons = edited(load_scene("tiny"), quick), [load_lesson("3_too_many_too_soon")]
    with contextlib.ExitStack() as stack, pytest.MonkeyPatch.context() as patch:
        patch.setattr(cost_maps, "IDLE_TIME", np.inf)  # make no fine maps
        patch.setattr(panels, "DOUBLING_TIME", 0.02)  # s: no user watches this run, so that it may be fast
        url = stack.enter_context(serving_here(scene, lessons=lessons))

        def start():
            stack.enter_context(serving_here(scene, lessons=lessons, port=int(url.rpartition(":")[2])))

        yield SimpleNamespace(url=url, stop=stack.close, start=start)


@pytest.fixture(scope="package")
def shared(served, browser):
    """The page of all tests, on a desktop."""
    context = browser.new_context(viewport={"width": 1280, "height": 720})
    yield opened_page(context, served.url)
    context.close()


@pytest.fixture
def opened(shared):
    """The page in its initial state in Expert, whatever another test has changed."""
    shared.set_viewport_size({"width": 1280, "height": 720})
    shared.emulate_media(color_scheme="light")
    shared.keyboard.press("Escape")
    shared.evaluate("document.activeElement.blur(); delete document.documentElement.dataset.sheet")
    for name in ("End lecture mode", "End lesson"):
        if (button := shared.get_by_role("button", name=name, exact=True)).is_visible():
            button.click()
            button.wait_for(state="hidden")

    def as_wanted():  # a late answer to an earlier action may have changed the value: request it again
        shared.evaluate("location.hash = 'scene=tiny&microphone=9&modes=solver&map=flat&layout=expert'")
        shared.wait_for_timeout(100)
        assert shared.get_by_role("button", name="Restart", exact=True).is_visible()
        assert shared.evaluate("/scene=tiny&.*microphone=9.*map=flat.*layout=expert/.test(location.hash)")

    until(shared, as_wanted)
    restart_solver(shared)
    tab(shared, "Curves")
    return shared
