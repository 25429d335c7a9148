"""Fixtures of the page without a browser: a server, a small measurement, and the parts of the page."""

import time
from types import SimpleNamespace

import numpy as np
import pytest
from browsing import WAIT
from doubles import Recorder, Solver, State, wait_until

from fdcal.model.measurement import Measurement
from fdcal.session.sources import OpenRequest
from fdcal.session.worker import Flag, Scheduler
from fdcal.viewer import cost_maps, prepare, session_view
from fdcal.viewer.page import Page
from fdcal.viewer.panels import Panels, Tabs
from fdcal.viewer.scene3d import SceneNodes
from fdcal.viewer.server import hardening
from fdcal.viewer.state import Binding


@pytest.fixture(scope="module")
def server():
    opened = hardening.open_server("127.0.0.1", 0)
    yield opened
    opened.stop()


@pytest.fixture(scope="module")
def measurement(scene):
    positions = np.random.default_rng(3).uniform([0.5, 0.35], [0.9, 0.75], (10, 2))
    places = {"positions": positions, "known": [0, 1, 2], "search": scene.search}
    pressures = np.exp(1j * np.outer(np.arange(1, 7), positions.sum(axis=1)))
    return Measurement(np.linspace(100, 300, 6), pressures, 343.0, **places)


@pytest.fixture(scope="module")
def threads():
    """Threads as a session has them, which end after the tests of a module."""
    made = Scheduler()
    yield made
    made.close(WAIT)


@pytest.fixture
def work(scene, measurement):
    """What a page shows, with a session that records its commands."""
    session, problem = Recorder(State(measurement.positions)), measurement.problem("unit")
    request = OpenRequest(scene, choices={"objective": True})  # the map shows the costs of the double
    return prepare.PreparedRun(scene, measurement, problem, Solver(measurement), session, request)


@pytest.fixture
def controls(server, work):
    opened = []
    work.session.opened = opened
    binding = Binding(server.gui, work, 6, opened.append)
    yield Tabs(Panels(server.gui), binding, lambda *_: None), work.session
    binding.threads.close(0.0)
    server.gui.reset()


@pytest.fixture
def viewer(server, work, monkeypatch):
    """A page without a browser, ticked by the test."""
    monkeypatch.setattr(cost_maps, "IDLE_TIME", np.inf)  # make no fine maps, which would also pass the gate
    page = SimpleNamespace(server=server, panels=Panels(server.gui), nodes=SceneNodes(server), wake=Flag(), open=None)
    made = session_view.Viewer(page, work)
    yield made
    work.solver.gate.release(99)
    made.binding.threads.close(1.0)
    server.gui.reset()
    server.scene.reset()


@pytest.fixture
def progress_texts():
    """What the page has reported of the progress of its first session."""
    return []


@pytest.fixture
def page_of(server, scene, kernels, progress_texts, monkeypatch):
    """A page without a browser or fine maps, and a function that ticks it until something happens."""
    monkeypatch.setattr(cost_maps, "IDLE_TIME", np.inf)
    made = Page(server, SceneNodes(server), on_progress=progress_texts.append)

    def turn_until(happened):
        return wait_until(happened, lambda: made.tick(time.perf_counter()))

    yield made, turn_until
    made.close()
    server.gui.reset()
    server.scene.reset()


@pytest.fixture
def tiny_page(page_of, scene):
    """The page with a session of `tiny`, and the function that ticks it until something happens."""
    page, turn_until = page_of
    page.open(OpenRequest(scene))
    turn_until(lambda: page.viewer is not None)
    return page, turn_until


@pytest.fixture
def opened(tiny_page):
    """What `tiny_page` shows, and the function that ticks it until something happens."""
    page, turn_until = tiny_page
    return page.viewer, turn_until
