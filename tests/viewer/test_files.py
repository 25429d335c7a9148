"""Files that the page saves: they show what is on the screen, and each page gets its own."""

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
from doubles import State, view_of
from matplotlib.colors import to_rgb
from PIL import Image
from replays import contents

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.cost.maps import map_positions, minima_of
from fdcal.graphics.landscape import draw_landscape
from fdcal.graphics.marks import ESTIMATE, LOWEST
from fdcal.graphics.picture import compose
from fdcal.model.validation import InputError
from fdcal.session.sources import OpenRequest
from fdcal.viewer import prepare
from fdcal.viewer.cost_maps import IDLE_TIME, CostMapWorker
from fdcal.viewer.gui.binding import Choices
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
    """What makes files, and a client that notes what it is told and sent."""
    made, told, got = exports.Exports(threads), [], []
    client = SimpleNamespace(
        add_notification=lambda *words, **_: told.append(words),
        send_file_download=lambda name, *_, **__: got.append(name),
    )
    return made, client, told, got


def test_every_page_gets_its_file(viewer, saving, monkeypatch):
    made, client, told, got = saving
    gate, count = threading.Event(), exports.MAX_WAITING + 9
    monkeypatch.setitem(exports.KINDS, "gated", exports.Kind(".x", "", lambda _: gate.wait(WAIT) and b"x"))
    for number in range(count):
        run = dataclasses.replace(viewer.run, scene=dataclasses.replace(viewer.run.scene, name=f"{number}"))
        made.ask(client, "gated", dataclasses.replace(viewer.snapshot, run=run))
    gate.set()
    assert made.worker.wait_for(lambda _: not made.worker.busy, WAIT)
    assert len(got) >= exports.MAX_WAITING and got == [f"fdcal-{number}-step-0.x" for number in range(len(got))]
    assert [title for title, *_ in told] == (count - len(got)) * ["Too many files are waiting"]


def test_a_file_that_cannot_be_made_is_reported_on_its_page(viewer, saving, monkeypatch):
    made, client, told, _ = saving
    errors = [InputError("no map"), OSError("disk"), ZeroDivisionError("oh")]

    def fail(_):
        raise errors[len(told)]

    monkeypatch.setitem(exports.KINDS, "broken", exports.Kind(".x", "", fail))
    for error in errors:
        made.ask(client, "broken", viewer.snapshot)
        assert made.worker.wait_for(lambda _: not made.worker.busy, WAIT)
        title, body = told[-1][:2]
        assert title == "The file could not be made" and str(error) in body
    assert len(told) == len(errors)


MICROPHONE, MODES = 9, (7, 9, 20)


@pytest.fixture(scope="module")
def snapshot(scene, kernels):
    """The page on `tiny` with the map of a few modes, the array a little off the truth."""
    measurement, solver = cached_measurement(scene), solvers.load("joint")
    problem = measurement.problem()
    state = solver.init(problem, scene.solver, 0)
    away = 0.01 * np.random.default_rng(4).normal(size=measurement.positions.shape)
    view = view_of([dataclasses.replace(state, positions=measurement.positions + away)])
    run = prepare.PreparedRun(scene, measurement, problem, solver, SimpleNamespace(view=view), OpenRequest(scene))
    choices = Choices(MICROPHONE, modes=MODES, order_offset=0)
    return exports.ViewSnapshot(run, None, view, choices, MICROPHONE, None)


@pytest.fixture(scope="module")
def drawn(snapshot, threads):
    """The map as the page shows it once nothing changes."""
    worker, wanted, began = CostMapWorker(snapshot.run, threads), snapshot.map_request, time.monotonic()
    while time.monotonic() - began < WAIT:
        found, error = worker.newest(wanted, False, time.monotonic())
        assert not error
        if found is not None and found.fine:
            return found
        time.sleep(IDLE_TIME / 10)
    pytest.fail("there is no fine map")


def test_the_fine_map_is_begun_only_after_the_one_on_the_lattice_of_the_solver(snapshot, monkeypatch, threads):
    """However long that one takes: it is the first that a browser shows."""
    begun, gate = [], threading.Event()
    coarse, fine = CostMapWorker._compute, CostMapWorker._compute_fine
    monkeypatch.setattr(CostMapWorker, "_compute", lambda *args: (gate.wait(WAIT), coarse(*args))[1])
    monkeypatch.setattr(CostMapWorker, "_compute_fine", lambda *args: (begun.append(True), fine(*args))[1])
    worker, wanted = CostMapWorker(snapshot.run, threads), snapshot.map_request
    for now in (0.0, 2 * IDLE_TIME, 9 * IDLE_TIME):
        worker.newest(wanted, False, now)
    assert not worker._fine_worker.busy and not begun
    gate.set()
    assert worker.worker.wait_for(lambda latest: latest is not None, WAIT)
    worker.newest(wanted, False, 9 * IDLE_TIME)
    assert worker._fine_worker.wait_for(lambda latest: latest is not None, WAIT) and begun


def test_the_file_for_paraview_has_the_map_of_the_screen(snapshot, drawn, tmp_path):
    import pyvista

    path = tmp_path / "map.vti"
    path.write_bytes(exports.KINDS["Map (VTI for ParaView)"].make(snapshot))
    grid = pyvista.read(path)
    assert grid.dimensions[:2] == drawn.floor.rgb.shape[1::-1], "as fine as the screen"
    total = grid["sum"].reshape(drawn.panels.total.shape)
    np.testing.assert_allclose(total, drawn.panels.total, rtol=1e-6)
    assert np.allclose(grid.points[grid["sum"].argmin()][:2], drawn.floor.lowest[0])
    marked = minima_of(total.astype(float), drawn.panels.search)
    assert np.allclose(marked.lowest, drawn.floor.lowest) and np.allclose(marked.others, drawn.minima.others)
    assert path.stat().st_size < 30e6


def test_the_figure_has_the_marks_of_the_page(snapshot, drawn, monkeypatch):
    figures = []
    monkeypatch.setattr(exports, "call", lambda _, __, *drawn: figures.append(draw_landscape(*drawn)) or b"")
    exports.KINDS["Maps as in Fig. 1 (PNG)"].make(snapshot)
    panels = [axes for axes in figures[0].axes if axes.images]
    assert len(panels) == len(MODES) + 1
    for axes, cost in zip(panels, [*drawn.panels.maps, drawn.panels.total], strict=True):
        lines = {line.get_label(): line for line in axes.lines}
        lowest = map_positions(np.array([np.unravel_index(cost.argmin(), cost.shape)]), drawn.panels.search)[0]
        for label, place in (
            ("lowest cost", lowest),
            ("true", snapshot.run.measurement.positions[MICROPHONE]),
            ("estimate", snapshot.view.state.positions[MICROPHONE]),
        ):
            assert np.allclose(lines[label].get_xydata()[0], place)
        assert lines["estimate"].get_marker() == "x", "a red cross is an estimate"
        for label, colour in (("estimate", ESTIMATE), ("lowest cost", LOWEST)):
            assert np.allclose(to_rgb(lines[label].get_color()), np.array(colour) / 255)
        assert axes.images[0].get_array().shape == cost.shape, "as fine as the screen"
    assert np.allclose(lowest, drawn.floor.lowest[0])


def test_every_file_shows_the_state_of_the_page(snapshot, drawn, tmp_path, one_painter):
    import pyvista

    state, measurement = snapshot.view.state, snapshot.run.measurement
    picture = compose(snapshot.run.scene, measurement, state.positions, MICROPHONE)
    shown = dataclasses.replace(snapshot, drawn=drawn, picture=picture)
    wanted = (".png", "-maps.svg", "-microphones.csv", "-microphones.vtp", "-replay.html")
    made = {kind.ending: kind.make(shown) for kind in exports.KINDS.values() if kind.ending in wanted}
    image = Image.open(io.BytesIO(made[".png"]))
    assert image.size == shown.choices.export_size and len(image.convert("RGB").getcolors(10**6)) > 100
    assert ElementTree.fromstring(made["-maps.svg"]).tag.endswith("svg")
    rows = list(csv.DictReader(io.StringIO(made["-microphones.csv"].decode())))
    assert np.array_equal([[float(row["x_m"]), float(row["y_m"])] for row in rows], state.positions)
    (tmp_path / "cloud.vtp").write_bytes(made["-microphones.vtp"])
    cloud = pyvista.read(tmp_path / "cloud.vtp")
    assert np.array_equal(cloud.points[cloud["kind"] == 0][:, :2], state.positions)
    assert np.array_equal(cloud.points[cloud["kind"] == 1][:, :2], measurement.positions)
    data, arrays, places = contents(made["-replay.html"].decode())
    assert np.abs(places - [one.positions for one in snapshot.view.history]).max() < 1e-8
    assert data["maps"]["modes"] and "pressures" in arrays, "the replay of the page maps the cost, too"


def test_a_file_takes_the_maps_that_are_on_the_screen_and_computes_others(snapshot, drawn):
    shown = dataclasses.replace(snapshot, drawn=drawn)
    found = shown.fine_panels(8)
    assert found.modes == MODES and found.total is drawn.panels.total and shown.fine_panels(2).modes == (7, 20)
    for changes in (
        {"microphone": MICROPHONE + 1},
        {"choices": dataclasses.replace(shown.choices, modes=(7,))},
        {"drawn": dataclasses.replace(drawn, fine=False)},
        {"drawn": None},
    ):
        assert dataclasses.replace(shown, **changes).fine_panels(8) is None
