"""Files that the page saves show what is on the screen, and the cost of a microphone in space."""

import csv
import dataclasses
import io
import re
import threading
import time
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from browsing import WAIT
from doubles import State, set_by_client, view_of, wait_until
from PIL import Image
from replays import contents

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.graphics.picture import compose
from fdcal.model import libraries
from fdcal.model.scene import load_scene
from fdcal.model.validation import InputError
from fdcal.session.sources import OpenRequest
from fdcal.viewer import prepare
from fdcal.viewer.cost_maps import CostMapWorker
from fdcal.viewer.state import Binding, Choices, PageState, initial_choices
from fdcal.viewer.tabs import view as exports
from fdcal.viewer.tabs.map import LABELS, MapTab, caption
from fdcal.viewer.tabs.view import caption as caption_of


def test_a_file_describes_the_picture_drawn(viewer, monkeypatch):
    asked, session = [], viewer.run.session
    monkeypatch.setattr(viewer.tabs.export.worker, "request", lambda *arguments: asked.append(arguments))
    viewer.tick(0.0)
    session.view = view_of([State(viewer.run.measurement.positions + 0.02, step=9)])
    viewer.tabs.export.save(SimpleNamespace(add_notification=lambda *_, **__: None))
    ((_, kind, moment),) = asked
    assert "step 0" in caption_of(moment) and exports.file_name(moment, kind) == "fdcal-tiny-step-0.png"


@pytest.mark.parametrize("name", ["../../etc/passwd", 'a"b\r\n.exe', "<script>", "", "ü" * 300])
def test_the_name_of_a_saved_file_is_valid(viewer, name):
    run = dataclasses.replace(viewer.run, scene=dataclasses.replace(viewer.run.scene, name=name))
    found = exports.file_name(dataclasses.replace(viewer.snapshot, run=run), exports.KINDS[exports.PICTURE])
    assert re.fullmatch(r"fdcal-[A-Za-z0-9_-]{1,60}-step-0\.png", found)


@pytest.fixture
def saving(viewer):
    """The tab that makes files, and a client that keeps its notifications and files."""
    made, notifications, got = viewer.tabs.export, [], []
    client = SimpleNamespace(
        add_notification=lambda *words, **_: notifications.append(words),
        send_file_download=lambda name, *_, **__: got.append(name),
    )
    return made, client, notifications, got


def test_every_page_gets_its_file(viewer, saving, monkeypatch):
    made, client, notifications, got = saving
    gate, count = threading.Event(), exports.MAX_WAITING + 9
    monkeypatch.setitem(exports.KINDS, "gated", exports.Kind(".x", "", lambda _: gate.wait(WAIT) and b"x"))
    for number in range(count):
        run = dataclasses.replace(viewer.run, scene=dataclasses.replace(viewer.run.scene, name=f"{number}"))
        viewer.binding.state = dataclasses.replace(viewer.snapshot, run=run)
        made.save(client, "gated")
    gate.set()
    assert made.worker.wait_for(lambda _: not made.worker.busy, WAIT)
    assert len(got) >= exports.MAX_WAITING and got == [f"fdcal-{number}-step-0.x" for number in range(len(got))]
    assert [title for title, *_ in notifications] == (count - len(got)) * ["Too many files are waiting"]


def test_a_file_that_cannot_be_made_is_reported_on_its_page(viewer, saving, monkeypatch):
    made, client, notifications, _ = saving

    def fail(_):
        raise OSError("disk full")

    monkeypatch.setitem(exports.KINDS, "broken", exports.Kind(".x", "", fail))
    made.save(client, "broken")
    assert made.worker.wait_for(lambda _: not made.worker.busy, WAIT)
    ((title, body, *_),) = notifications
    assert title == "The file could not be made" and "disk full" in body


MICROPHONE, MODES = 9, (7, 9, 20)


@pytest.fixture(scope="module")
def snapshot(scene, kernels):
    """The page on `tiny` with the map of a few modes, the array a little off the truth."""
    run, choices = prepared(scene, scene.solver), Choices(microphone=MICROPHONE, modes=MODES, order_offset=0)
    return PageState(run.session.view, microphone=MICROPHONE, run=run, choices=choices)


def prepared(scene, settings):
    """A run of solver joint on a scene, which shows the array a little off the truth."""
    measurement, solver = cached_measurement(scene), solvers.load("joint")
    problem = measurement.problem()
    state = solver.init(problem, settings, 0)
    away = 0.01 * np.random.default_rng(4).normal(size=measurement.positions.shape)
    view = view_of([dataclasses.replace(state, positions=measurement.positions + away)])
    session = SimpleNamespace(view=view, yield_to_ui=lambda: None)
    return prepare.PreparedRun(scene, measurement, problem, solver, session, OpenRequest(scene))


@pytest.fixture(scope="module")
def drawn(snapshot, threads):
    """The map as the page shows it once nothing changes."""
    return first(CostMapWorker(snapshot.run, threads), snapshot, True)


def test_the_caption_counts_the_modes_in_use_that_the_map_leaves_out(snapshot, drawn):
    state = drawn.request.state
    request = dataclasses.replace(drawn.request, order_offset=0, custom_modes=False, modes=(1, 2, 3))
    said = caption(snapshot.run, dataclasses.replace(drawn, request=request))
    assert f"3 of the {state.last - state.first + 1} frequencies that the solver uses" in said


def test_every_file_shows_the_state_of_the_page(snapshot, drawn, one_painter, monkeypatch):
    monkeypatch.setattr(exports, "call", libraries.call)  # the double starts no process
    state, measurement = snapshot.view.state, snapshot.run.measurement
    picture = compose(snapshot.run.scene, measurement, state.positions, MICROPHONE)
    shown = dataclasses.replace(snapshot, drawn=drawn, picture=picture)
    wanted = (".png", "-maps.svg", "-microphones.csv", "-replay.html")
    made = {kind.ending: kind.make(shown) for kind in exports.KINDS.values() if kind.ending in wanted}
    image = Image.open(io.BytesIO(made[".png"]))
    assert image.size == shown.choices.export_size and len(image.convert("RGB").getcolors(10**6)) > 100
    assert ElementTree.fromstring(made["-maps.svg"]).tag.endswith("svg")
    rows = list(csv.DictReader(io.StringIO(made["-microphones.csv"].decode())))
    assert np.array_equal([[float(row["x_m"]), float(row["y_m"])] for row in rows], np.round(state.positions, 9))
    data, arrays, places = contents(made["-replay.html"].decode())
    assert np.abs(places - [one.positions for one in snapshot.view.history]).max() < 1e-8
    assert data["maps"]["modes"] and "pressures" in arrays, "the replay of the page maps the cost, too"


@pytest.fixture(scope="module")
def run():
    scene = load_scene("ball3d")
    return prepared(scene, dataclasses.replace(scene.solver, modes=30))


@pytest.fixture
def space(run):
    choices = Choices(microphone=MICROPHONE, modes=(1, 5, 30), kind="volume", in_space=True)
    return PageState(run.session.view, microphone=MICROPHONE, run=run, choices=choices)


@pytest.fixture(scope="module")
def worker(run, threads):
    return CostMapWorker(run, threads)


def first(worker, state, fine, **changes):
    """Return the first map, or the first fine map, of what a page shows after some changes."""
    wanted = dataclasses.replace(state.choices.map_request(state.run, state.view, state.microphone), **changes)

    def newest():
        found, error = worker.newest(wanted, False, time.monotonic())
        assert not error
        return found if found is not None and found.request == wanted and (found.fine or not fine) else None

    return wait_until(newest)


def test_a_coarse_volume_comes_first_and_a_fine_one_refines_it(run, threads, space):
    worker = CostMapWorker(run, threads)  # a new worker: one that has the fine volume shows no coarse one
    coarse, fine = (first(worker, space, fine) for fine in (False, True))
    assert fine.floor.rgb.shape > coarse.floor.rgb.shape
    assert len(fine.volume.surface.faces) > 2 * len(coarse.volume.surface.faces)
    assert fine.cost_here == pytest.approx(coarse.cost_here, rel=0.05)
    assert fine.lowest <= fine.cost_here and coarse.lowest <= coarse.cost_here
    place = fine.volume.minima.lowest[0]
    assert np.linalg.norm(place - space.run.measurement.positions[MICROPHONE]) < 0.05
    assert np.linalg.norm(np.subtract(coarse.volume.minima.lowest[0], place)) < 0.05
    assert fine.volume.text in caption(space.run, fine) and "dB" in fine.volume.text


def test_the_floor_below_the_isosurfaces_is_the_layer_of_the_estimate(worker, space):
    drawn, others = first(worker, space, True), ({}, {"microphone": 11}, {"modes": (2, 6)})
    assert f"layer z = {drawn.request.state.positions[MICROPHONE][2]:.2f} m" in drawn.floor.bar.label
    costs = {first(worker, space, False, **change).lowest for change in others}
    assert len(costs) == 3, "another microphone or other modes make another volume"
    out = np.array(space.view.state.positions)
    out[MICROPHONE, 2] = 9.0
    state = dataclasses.replace(space.view.state, positions=out)
    request = space.choices.map_request(space.run, dataclasses.replace(space.view, state=state), MICROPHONE)
    assert request.state.positions[MICROPHONE][2] == pytest.approx(1.8), "the highest number of the ruler"


def test_the_tab_offers_isosurfaces_of_an_array_in_space_and_none_of_one_in_a_plane(server, run, work, controls):
    assert "volume" not in controls[0].map.kinds
    binding = Binding(server.gui, run, 20)
    tab = MapTab(binding)
    assert "volume" in tab.kinds
    set_by_client(tab.kind, LABELS["volume"])
    assert binding.choices.kind == "volume" and not tab.quantity.visible
    choices = Choices(microphone=3, kind="volume", in_space=True)
    saved = OpenRequest(run.scene, choices=choices.to_save())
    assert (saved := initial_choices(dataclasses.replace(run, opening=saved), 20, Choices())).volume and saved.themed
    assert not initial_choices(work, 5, choices).volume, "another array gets none that it cannot have"
    wrong = OpenRequest(run.scene, choices={"order_offset": "w"})
    with pytest.raises(InputError, match="order_offset"):
        initial_choices(dataclasses.replace(run, opening=wrong), 20, None)


def test_a_map_of_a_likelihood_says_where_the_estimate_is_the_lowest(snapshot, threads):
    """The lattice is coarser than the minimum: an interpolated cost at the end of a run is many nats too high."""
    solver, problem, scene = solvers.load("robust"), snapshot.run.problem, snapshot.run.scene
    *_, end = solvers.run(problem, dataclasses.replace(scene.solver, name="robust"), 0)
    modes = tuple(range(1, len(problem.frequencies[end.modes]) + 1))
    for away, said in ((0.0, "the estimate is at the lowest point of the map"), (0.3, "re the highest of the map")):
        positions = np.array(end.positions)
        positions[MICROPHONE] += away
        view = view_of([dataclasses.replace(end, positions=positions)])
        run = dataclasses.replace(snapshot.run, solver=solver, session=SimpleNamespace(view=view))
        page = PageState(view, microphone=MICROPHONE, run=run, choices=Choices(microphone=MICROPHONE, modes=modes))
        assert said in caption(run, first(CostMapWorker(run, threads), page, False))
