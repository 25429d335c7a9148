"""The cost of one microphone in space on the page: coarse at once, fine later, of what is looked at."""

import dataclasses
import re
import time
from types import SimpleNamespace

import numpy as np
import pytest
from browsing import WAIT
from doubles import set_by_client, view_of

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.graphics.overlays import with_volume
from fdcal.graphics.picture import compose
from fdcal.graphics.primitives import Floor
from fdcal.model.scene import load_scene
from fdcal.model.validation import InputError
from fdcal.session.sources import OpenRequest
from fdcal.viewer import prepare
from fdcal.viewer.cost_maps import IDLE_TIME, CostMapWorker, MapStyle
from fdcal.viewer.gui.binding import VOLUME, Binding, Choices, initial_choices, kind_of
from fdcal.viewer.scene3d.nodes import SceneNodes
from fdcal.viewer.tabs import view as exports
from fdcal.viewer.tabs.map import MapTab, caption
from fdcal.viewer.tabs.view import ViewSnapshot

MICROPHONE = 10


@pytest.fixture(scope="module")
def run():
    scene = load_scene("ball3d")
    measurement, solver = cached_measurement(scene), solvers.load("joint")
    problem = measurement.problem()
    state = solver.init(problem, dataclasses.replace(scene.solver, modes=30), 0)
    away = 0.01 * np.random.default_rng(4).normal(size=measurement.positions.shape)
    view = view_of([dataclasses.replace(state, positions=measurement.positions + away)])
    return prepare.PreparedRun(
        scene, measurement, problem, solver, SimpleNamespace(view=view, yield_to_ui=lambda: None), OpenRequest(scene)
    )


@pytest.fixture
def snapshot(run):
    style = MapStyle(volume=True)
    return ViewSnapshot(
        run, None, run.session.view, Choices(MICROPHONE, modes=(1, 5, 30), style=style), MICROPHONE, None
    )


@pytest.fixture(scope="module")
def worker(run, threads):
    return CostMapWorker(run, threads)


def first(worker, wanted, fine):
    """The first volume of a request, or the first fine one."""
    began = time.monotonic()
    while time.monotonic() - began < WAIT:
        found, error = worker.newest(wanted, False, time.monotonic())
        assert not error
        if found is not None and found.request == wanted and (found.fine or not fine):
            return found
        time.sleep(IDLE_TIME / 50)
    pytest.fail("there is no volume")


def styled(request, **changes):
    """The same request in another style."""
    return dataclasses.replace(request, style=dataclasses.replace(request.style, **changes))


def test_a_coarse_volume_comes_first_and_a_fine_one_refines_it(run, threads, snapshot):
    worker = CostMapWorker(run, threads)  # of its own: one that has the fine volume already shows no coarse one
    coarse = first(worker, snapshot.map_request, False)
    fine = first(worker, snapshot.map_request, True)
    assert coarse.floor is None and fine.floor is None
    assert len(fine.volume.surface.faces) > 2 * len(coarse.volume.surface.faces)
    assert fine.cost_here == pytest.approx(coarse.cost_here, rel=0.05)
    assert fine.lowest <= fine.cost_here and coarse.lowest <= coarse.cost_here
    place = fine.volume.minima.lowest[0]
    assert np.linalg.norm(place - snapshot.run.measurement.positions[MICROPHONE]) < 0.05
    assert np.linalg.norm(np.subtract(coarse.volume.minima.lowest[0], place)) < 0.05
    assert fine.volume.text in caption(fine, snapshot.run.measurement) and "dB" in fine.volume.text


def test_the_slice_goes_through_the_estimate_until_it_is_moved(worker, snapshot):
    wanted = snapshot.map_request
    place = wanted.state.positions[MICROPHONE]
    for changes, plate in (
        *(({"slice_axis": axis}, (number, place[number])) for number, axis in enumerate("xyz")),
        ({"slice_position": 1.0}, (2, 1.0)),
        ({"slice_position": 99.0}, (2, pytest.approx(1.81))),  # the edge of the domain
    ):
        drawn = first(worker, styled(wanted, **changes), False).volume.plate
        assert (drawn.axis, drawn.position) == plate
    for basins in (False, True):
        assert first(worker, styled(wanted, slice_axis="none", basins=basins), False).volume.plate is None
    costs = {
        first(worker, dataclasses.replace(wanted, **change), False).lowest
        for change in ({}, {"microphone": 11}, {"modes": (2, 6)})
    }
    assert len(costs) == 3, "another microphone or other modes make another volume"


def test_a_moved_slice_is_drawn_from_the_same_volume_and_the_last_one_stays_meanwhile(worker, snapshot):
    wanted = snapshot.map_request
    drawn = first(worker, wanted, True)
    moved = styled(wanted, slice_position=1.1)
    elsewhere = dataclasses.replace(moved, microphone=3)
    assert drawn.request.differs_by_a_drag(moved) and not drawn.request.differs_by_a_drag(elsewhere)
    quick = first(worker, moved, False)
    assert quick.volume.surface is drawn.volume.surface, "no new volume"
    again = first(worker, moved, True)
    assert again.volume.plate.rgb.shape > quick.volume.plate.rgb.shape or quick.fine, "a finer slice follows"
    assert again.volume.surface is drawn.volume.surface and again.volume.plate.position == 1.1


def test_basins_in_space_are_a_slice_without_isosurfaces_that_follows_its_slider(worker, snapshot):
    wanted = snapshot.map_request
    basins = styled(wanted, basins=True)
    drawn = first(worker, basins, True)
    assert drawn.volume.bar is None and not len(drawn.volume.surface.faces) and drawn.volume.minima
    assert drawn.volume.areas[0].text.startswith("basin of the true position") and "ends within" in drawn.note
    moved = first(worker, styled(basins, slice_position=0.9), False)
    assert moved.volume.areas == drawn.volume.areas and moved.volume.plate.position == pytest.approx(0.9, abs=0.02)
    assert not np.array_equal(moved.volume.plate.rgb, drawn.volume.plate.rgb)
    picture = with_volume(compose(snapshot.run.scene, snapshot.run.measurement), drawn.volume)
    assert picture.bar is None and picture.areas == drawn.volume.areas
    same = dataclasses.replace(drawn.volume.plate, position=0.0)
    middle = same.rgb[same.rgb.shape[0] // 2, same.rgb.shape[1] // 2]
    assert any(tuple(middle) == area.colour for area in drawn.volume.areas)


def test_the_vti_file_has_the_volume(snapshot, tmp_path):
    import pyvista

    path = tmp_path / "volume.vti"
    path.write_bytes(exports.KINDS["Map (VTI for ParaView)"].make(snapshot))
    grid = pyvista.read(path)
    assert min(grid.dimensions) > 40
    lowest = grid.points[np.argmin(grid["cost_dB"])]
    assert np.linalg.norm(lowest - snapshot.run.measurement.positions[MICROPHONE]) < 0.05
    place = grid.find_closest_point(snapshot.view.state.positions[MICROPHONE])
    np.testing.assert_allclose(10 ** (grid["cost_dB"][place] / 10), grid["cost"][place], rtol=1e-5)


def test_the_tab_offers_isosurfaces_of_an_array_in_space_and_none_of_one_in_a_plane(server, run, work, controls):
    assert VOLUME not in controls[0].map.kinds
    binding = Binding(server.gui, run, 20)
    tab = MapTab(binding)
    assert VOLUME in tab.kinds and not tab.slice.axis.visible
    set_by_client(tab.kind, VOLUME)
    assert kind_of(binding.choices) == VOLUME and tab.slice.position.visible and not tab.quantity.visible
    set_by_client(tab.slice.axis, "x")
    assert (tab.slice.position.min, tab.slice.position.max) == (1.4, 2.4)
    set_by_client(tab.slice.position, 2.0)
    assert binding.choices.style.slice_position == 2.0
    set_by_client(tab.slice.axis, "None")
    assert not tab.slice.position.visible and binding.choices.style.slice_position is None
    choices = Choices(3, style=MapStyle(volume=True, slice_axis="y", slice_position=1.5))
    kept = initial_choices(
        dataclasses.replace(run, opening=OpenRequest(run.scene, choices=choices.to_save())), 20, None
    )
    assert kept.style.volume and (kept.style.slice_axis, kept.style.slice_position) == ("y", 1.5), "as it was saved"
    assert not initial_choices(work, 5, choices).style.volume, "another array gets none that it cannot have"
    assert initial_choices(run, 20, choices).style.slice_position is None
    wrong = OpenRequest(run.scene, choices={"slice_axis": "w"})
    with pytest.raises(InputError, match="slice_axis"):
        initial_choices(dataclasses.replace(run, opening=wrong), 20, None)


def test_surfaces_stay_until_every_page_has_drawn_those_that_replace_them(server, worker, snapshot, monkeypatch):
    """A page takes a moment to read a surface, and showed none meanwhile; a slice is moved without a new node."""
    there, slices, add_image = [], [], server.scene.add_image

    def adding(name, *_, **__):
        there.append(name)
        return SimpleNamespace(remove=lambda: there.remove(name))

    def adding_image(*arguments, **named):
        slices.append(add_image(*arguments, **named))
        return slices[-1]

    monkeypatch.setattr(server.scene, "add_mesh_trimesh", adding)
    monkeypatch.setattr(server.scene, "add_image", adding_image)
    run, nodes, wanted = snapshot.run, SceneNodes(server), snapshot.map_request
    picture = compose(run.scene, run.measurement, snapshot.view.state.positions, MICROPHONE)
    for change in ({"modes": (1, 2, 3)}, {"modes": (1, 2, 3, 4), "style": styled(wanted, slice_position=1.2).style}):
        nodes.show(with_volume(picture, first(worker, dataclasses.replace(wanted, **change), True).volume))
    assert {"isosurfaces", "slice", "lowest"} <= set(nodes.parts)
    assert len(slices) == 1 and slices[0].position[2] == pytest.approx(1.2)
    assert len(set(there)) == 2 and all(re.fullmatch(r"/isosurfaces/\d+", name) for name in there)
    newest = there[-1]
    for now, count in ((0.0, 2), (2.9, 2), (3.1, 1)):
        nodes.settle(now)
        assert len(there) == count and newest in there
    volume = with_volume(picture, first(worker, wanted, True).volume)
    nodes.show(volume)
    assert len(there) == 2
    heights = np.zeros((4, 4), np.float32)
    relief = Floor(np.zeros((4, 4, 3), np.uint8), (0.0, 0.0), (1.0, 1.0), None, (), heights=heights)
    nodes.show(dataclasses.replace(picture, floor=relief))
    assert [name[:8] for name in there] == ["/relief/"], "no surface of before comes back"
    nodes.show(volume)
    assert [name[:13] for name in there] == ["/isosurfaces/"]
    nodes.show(picture)
    assert not there and not {"isosurfaces", "slice"} & set(nodes.parts)
