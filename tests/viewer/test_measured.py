"""The page of a measurement without a scene, and of several takes."""

import signal
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from fdcal.assessment.result_file import position_table
from fdcal.assessment.words import count_label, modes_label, row_label
from fdcal.commands.options import open_request_of
from fdcal.graphics.picture import static_picture, with_estimate
from fdcal.graphics.snapshot import legend_of
from fdcal.model.measurement import Measurement, save_measurement
from fdcal.model.scene import load_scene, placeholder_scene
from fdcal.model.settings import ALL_MODES, SolverSettings
from fdcal.session.calibration_run import with_estimated_domain
from fdcal.viewer import html
from fdcal.viewer.cost_maps import map_modes
from fdcal.viewer.prepare import DisplayFrame, Preparation
from fdcal.viewer.state import Binding
from fdcal.viewer.tabs import map as map_tab


@contextmanager
def prepared(opening):
    """Return what the page shows for a request."""
    preparation = Preparation(opening)
    preparation.execute()
    work = preparation.run
    assert work is not None, preparation.error
    yield work
    work.session.close(2.0)


@pytest.fixture(scope="module")
def array():
    """The page of the measured array that comes with fdcal."""
    with prepared(open_request_of("frl_array")) as work:
        yield work


def test_the_measured_array_has_maps_at_once(array, server):
    """Seven microphones cannot carry any mode with the usual order."""
    assert array.known_scene is None and array.measurement.take_count == 4
    places = DisplayFrame(array).positions(array.session.view.state.positions)  # the drawn positions
    low = np.array(array.measurement.search.origin)
    assert ((low < places) & (places < low + array.measurement.search.size)).all(), "the map is where the array is"
    binding = Binding(server.gui, array, len(array.measurement.frequencies))
    tab = map_tab.MapTab(binding)
    try:
        assert binding.choices.order_offset == array.reference_cost.order_offset == tab.order.value == 0
        rows = map_modes(array, array.session.view.state, None, binding.choices.map_order)
        assert len(rows) > 50 and {int(array.measurement.takes[row - 1]) for row in rows} == {0, 1, 2, 3}
    finally:
        server.gui.reset()


def test_what_is_nominal_is_not_called_true_nor_its_distance_an_error(array):
    view, measurement = array.session.view, array.measurement
    text = html.status(view, measurement)
    assert "Deviation" in text and "from nominal, after alignment" in text and "Error" not in text
    plane = replace(measurement, positions=None, known_positions=None, array_dimension=2, search=None)
    assert "sought in one plane" in html.status(view, plane)
    assert "800 frequencies of 4 takes, 82 to 1224 Hz" in text and "modes" not in text
    picture = with_estimate(static_picture(None, measurement), measurement, view.state.positions)
    assert {"nominal", "deviation"} <= {entry.text for entry in legend_of(picture)}
    assert "nominal_x_m" in position_table(measurement, view.state.positions).splitlines()[0]


def test_the_placeholder_scene_of_a_plane_array_in_space_has_its_dimensions(tiny):
    scene = placeholder_scene(replace(tiny, dimension=3, search=None), "hall", SolverSettings(modes=2, first_modes=1))
    assert (scene.room.dimension, scene.array.dimension) == (3, 2)
    assert scene.gauge.indices(16) == tuple(tiny.known.tolist())


def test_a_measurement_without_search_domain_gets_one_round_the_estimate(tiny, tmp_path):
    """Then map, cost and descent work, in the axes of the solver."""
    path = tmp_path / "hall.npz"
    save_measurement(replace(tiny, positions=None, search=None), path)
    opening = open_request_of(str(path))
    opening = replace(opening, scene=replace(opening.scene, solver=SolverSettings(name="descent", modes=20)))
    with prepared(opening) as work:
        picture = with_estimate(static_picture(work.known_scene, work.measurement), work.measurement, tiny.positions)
        assert not [solid for solid in picture.meshes if solid.name == "microphones/true"]
        search = work.measurement.search
        assert search is work.problem.search and search is not None and work.reference_cost is not None
        assert ((search.origin < tiny.positions) & (tiny.positions < np.add(search.origin, search.size))).all()
        assert np.isfinite(work.solver.landscape(work.problem, work.session.view.state, 1, slice(0, 3))).all()
        saved = replace(work.opening, states=(work.session.view.state,))
        assert saved.measurement.search == search, "a session that is saved keeps the domain"


def test_without_an_estimate_there_is_no_domain_and_the_page_says_what_to_do():
    pressures = np.random.default_rng(0).normal(size=(1, 24)).view(complex)
    few = Measurement([100.0], pressures, 343.0, known=[0, 1, 2], known_positions=[[0, 0], [1, 0], [0, 1]])
    assert with_estimated_domain(few, SolverSettings(name="joint", modes=1, first_modes=1), 0) is few
    assert all(key in map_tab.NO_SEARCH for key in ("search_origin", "search_size", "search_step", "radius"))


@pytest.fixture
def takes(measurement):
    """Two takes of equal frequencies, each with a spectrum of its own: rows 1, 3, 5, ... are take 0."""
    f = np.linspace(90, 310, 111)
    spectra = [np.stack([f, 1 + peak * np.exp(-(((f - 200) / 20) ** 2))]) for peak in (9.0, 99.0)]
    each = [replace(measurement, spectrum=spectrum) for spectrum in spectra]
    each[1] = replace(each[1], pressures=1j * each[1].pressures[::-1])
    return Measurement.from_takes(each)


def test_every_place_of_the_source_is_drawn_with_its_take(takes):
    scene, measurement = load_scene("two_places"), replace(takes, search=None)
    picture = static_picture(scene, measurement)
    for number, place in enumerate(scene.source.places):
        (mesh,) = [mesh for mesh in picture.meshes if mesh.name == f"source/{number}"]
        np.testing.assert_allclose(mesh.vertices[:, :2].mean(axis=0), place[:2], atol=1e-3)
        text = next(label.text for label in picture.labels if label.name == f"source/{number}/name")
        assert text == f"source, take {number}"
    stars = [mesh.name for mesh in static_picture(load_scene("tiny"), measurement).meshes if "source" in mesh.name]
    assert stars == ["source_halo", "source"], "as it was for one place"


def test_a_measurement_is_shown_without_walls_and_all_of_its_modes_are_used(tiny, tmp_path):
    path = tmp_path / "hall.npz"
    save_measurement(tiny, path)
    with prepared(open_request_of(str(path))) as work:
        assert work.scene.title == "hall, as measured"
        assert np.array_equal(work.measurement.pressures, tiny.pressures)
        state = work.session.view.state
        assert state.settings.modes == len(tiny.frequencies)
        assert work.scene.solver.modes == ALL_MODES, "so that another solver, or another scene, finds its own number"
        still = static_picture(work.known_scene, work.measurement)
        assert not [part.name for part in (*still.meshes, *still.lines) if part.name.startswith(("room", "source"))]
        picture = with_estimate(still, work.measurement, state.positions, 0, None)
        assert {"microphones/estimate", "microphones/true"} <= {solid.name for solid in picture.meshes}


def test_the_domain_of_a_blind_array_lies_round_its_true_positions(tiny):
    blind = replace(tiny, search=None, known=(), known_positions=None)
    search = with_estimated_domain(blind, SolverSettings(name="joint", known="none", modes=12), 0).search
    assert ((search.origin < tiny.positions) & (tiny.positions < np.add(search.origin, search.size))).all()


def test_an_interrupt_during_the_estimate_of_the_domain_is_not_taken_for_the_end_of_the_estimate(tiny):
    bare, settings, calls = replace(tiny, search=None), SolverSettings(name="descent", modes=12), iter("ab")
    with pytest.raises(KeyboardInterrupt):
        with_estimated_domain(bare, settings, 0, lambda *_: next(calls, "") or signal.raise_signal(signal.SIGINT))


def test_errors_after_alignment_are_those_of_the_microphones_that_align(array):
    """The microphones with healthy channels determine the alignment, as in `fdcal calibrate`."""
    measurement, healthy = array.measurement, np.array([1, 2, 3, 4, 5])
    positions = np.array(measurement.positions)
    positions[0] += 0.05
    assert measurement.errors(positions, healthy)[healthy] == pytest.approx(0, abs=1e-9)
    assert measurement.errors(positions)[healthy].min() > 1e-3
    left_out = html.status(array.session.view, measurement, sought=healthy, left_out=["M00"])
    assert ">Deviation*<" in left_out and "Deviation without microphone M00: faulty channel" in left_out


def test_rows_are_named_by_their_take_where_there_are_several(takes, measurement):
    assert row_label(takes, 4) == "frequency 4, take 1, 140.0 Hz"
    assert row_label(measurement, 2) == "frequency 2, 140.0 Hz" and modes_label(measurement, (2,)) == "frequency 2"
    assert modes_label(takes, (4,)) == "frequency 4, take 1" and count_label(takes, (1, 3)) == "2 frequencies of take 0"
    assert count_label(takes, (1, 2)) == "2 frequencies of 2 takes"
    assert modes_label(measurement, (1, 2)) == "frequencies no. 1 to 2"
    assert modes_label(measurement, (2, 5, 9)) == "3 frequencies between no. 2 and no. 9"
