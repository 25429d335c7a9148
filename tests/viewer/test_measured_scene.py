"""The page of a measurement that has no scene: of a file of fdcal, of a recording, with truth and without."""

from dataclasses import replace

import numpy as np
import pytest

from fdcal import solvers
from fdcal.assessment.result_file import position_table
from fdcal.commands.options import open_request_of
from fdcal.graphics.annotations import legend_of
from fdcal.graphics.picture import error_summary, static_picture, with_estimate
from fdcal.model.measurement import Measurement, save_measurement
from fdcal.model.scene_file import MeasuredScene, load_scene, placeholder_scene
from fdcal.model.settings import ALL_MODES, SolverSettings
from fdcal.session.calibration_run import with_estimated_domain
from fdcal.session.sources import scene_input
from fdcal.viewer.background.cost_maps import map_modes
from fdcal.viewer.background.prepare import PreparationProgress, prepare_run
from fdcal.viewer.gui import html
from fdcal.viewer.gui.binding import Binding
from fdcal.viewer.tabs import comparison as comparison_tab
from fdcal.viewer.tabs import map as map_tab


@pytest.fixture(scope="module")
def tiny() -> Measurement:
    return scene_input(load_scene("tiny")).measurement


@pytest.mark.parametrize("scored", [True, False])
def test_a_measurement_is_shown_without_walls(scored, tiny, tmp_path):
    path = tmp_path / "hall.npz"
    save_measurement(tiny if scored else replace(tiny, positions=None, search=None), path)
    work = prepare_run(open_request_of(str(path)), PreparationProgress())
    try:
        assert work.scene.title == "hall, as measured"
        assert np.array_equal(work.measurement.pressures, tiny.pressures)
        state = work.session.view.state
        still = static_picture(work.known_scene, work.measurement)
        assert not [part.name for part in (*still.meshes, *still.lines) if part.name.startswith(("room", "source"))]
        picture = with_estimate(still, work.measurement, state.positions, 0, None)
        assert any(solid.name == "microphones/estimate" for solid in picture.meshes)
        assert any(solid.name == "microphones/true" for solid in picture.meshes) == scored
    finally:
        work.session.close(2.0)


@pytest.fixture(scope="module")
def array():
    """The page of the measured array that comes with fdcal."""
    work = prepare_run(open_request_of("frl_array"), PreparationProgress())
    yield work
    work.session.close(2.0)


def test_the_measured_array_has_maps_at_once_and_a_list_of_takes(array, server):
    """Seven microphones carry no mode with the usual order."""
    assert array.known_scene is None and array.measurement.take_count == 4
    places = np.asarray(array.session.view.state.positions)
    low = np.array(array.measurement.search.origin)
    assert ((low < places) & (places < low + array.measurement.search.size)).all(), "the map is where the array is"
    binding = Binding(server.gui, array, len(array.measurement.frequencies))
    tab = map_tab.MapTab(binding)
    try:
        assert tab.take.options == ("All takes", "Take 0", "Take 1", "Take 2", "Take 3")
        assert binding.choices.order_offset == array.reference_cost.order_offset == tab.order.value == 0
        rows = map_modes(array, array.session.view.state, None, binding.choices.map_order, 1)
        assert len(rows) > 50 and {int(array.measurement.takes[row - 1]) for row in rows} == {1}
    finally:
        server.gui.reset()


def test_what_is_nominal_is_not_called_true_nor_its_distance_an_error(array):
    view, measurement = array.session.view, array.measurement
    text = html.status(view, measurement)
    assert "Deviation" in text and "from nominal, after alignment" in text and "Error" not in text
    assert "rows 1–1143 of 4 takes, 82–1224 Hz" in text and "all modes" not in text
    picture = with_estimate(static_picture(None, measurement), measurement, view.state.positions)
    assert {"nominal", "deviation"} <= {entry.text for entry in legend_of(picture)}
    assert "mean deviation" in error_summary(measurement, view.state.positions)
    assert "nominal_x_m" in position_table(measurement, view.state.positions).splitlines()[0]


def test_errors_after_alignment_are_those_of_the_microphones_that_align(array):
    """As `fdcal calibrate` has it: by the microphones whose channels are sound."""
    measurement, healthy = array.measurement, np.array([1, 2, 3, 4, 5])
    positions = np.array(measurement.positions)
    positions[0] += 0.05
    assert measurement.errors(positions, healthy)[healthy] == pytest.approx(0, abs=1e-9)
    assert measurement.errors(positions)[healthy].min() > 1e-3
    assert "<b>0 mm</b>" in html.error_text(measurement, positions, healthy)
    left_out = html.status(array.session.view, measurement, sought=healthy, left_out=["M00"])
    assert ">Healthy<" in left_out and "without microphone M00" in left_out


def test_another_solver_keeps_the_measured_scene(tiny):
    scene = placeholder_scene(tiny, "hall", SolverSettings(modes=12))
    assert isinstance(replace(scene, solver=SolverSettings(name="descent", modes=12)), MeasuredScene)


@pytest.mark.parametrize(("dimension", "array_dimension"), [(2, 2), (3, 3), (3, 2)])
@pytest.mark.parametrize("known", [0, 5])
def test_every_kind_of_measurement_has_a_placeholder_scene(dimension, array_dimension, known):
    rng = np.random.default_rng(0)
    measurement = Measurement(
        frequencies=np.array([50.0, 80.0]),
        pressures=rng.standard_normal((2, 9)) + 1j * rng.standard_normal((2, 9)),
        sound_speed=343.0,
        dimension=dimension,
        array_dimension=array_dimension,
        known=tuple(range(known)),
        known_positions=rng.uniform(-3, 3, (known, array_dimension)),
    )
    scene = placeholder_scene(measurement, "hall", SolverSettings(modes=2, first_modes=1))
    assert scene.room.dimension == dimension
    assert scene.array.dimension == array_dimension
    assert scene.gauge.indices(9) == tuple(range(known))


def test_the_page_uses_all_modes_of_a_measurement(tiny, tmp_path):
    path = tmp_path / "hall.npz"
    save_measurement(tiny, path)
    work = prepare_run(open_request_of(str(path)), PreparationProgress())
    try:
        assert work.session.view.state.settings.modes == len(tiny.frequencies)
        assert work.scene.solver.modes == ALL_MODES, "so that another solver, or another scene, finds its own number"
    finally:
        work.session.close(2.0)


@pytest.mark.parametrize(("solver", "known"), [("joint", "all"), ("joint", "none"), ("descent", "all")])
def test_a_measurement_without_search_domain_gets_one_round_the_estimate(solver, known, tiny, tmp_path):
    """Map, cost and race work then, and descent runs, in the axes of the solver."""
    path = tmp_path / "hall.npz"
    save_measurement(replace(tiny, positions=None, search=None), path)
    opening = open_request_of(str(path))
    opening = replace(opening, scene=replace(opening.scene, solver=SolverSettings(name=solver, known=known, modes=20)))
    work = prepare_run(opening, PreparationProgress())
    try:
        search = work.measurement.search
        assert search is work.problem.search and search is not None and work.reference_cost is not None
        *_, state = solvers.run(work.problem, replace(opening.scene.solver, name="joint"), 0)
        low, high = np.array(search.origin), np.add(search.origin, search.size)
        assert ((low < state.positions) & (state.positions < high)).all()
        assert np.isfinite(work.solver.landscape(work.problem, work.session.view.state, 1, slice(0, 3))).all()
        saved = replace(work.opening, states=(work.session.view.state,))
        assert saved.measurement.search == search, "a session that is saved keeps the domain"
    finally:
        work.session.close(2.0)


def test_without_an_estimate_there_is_no_domain_and_the_page_says_what_to_do():
    rng = np.random.default_rng(0)
    pressures = rng.normal(size=(1, 12)) + 1j * rng.normal(size=(1, 12))
    few = Measurement([100.0], pressures, 343.0, known=[0, 1, 2], known_positions=[[0, 0], [1, 0], [0, 1]])
    found = with_estimated_domain(few, SolverSettings(name="joint", modes=1, first_modes=1), 0)
    assert found.search is None and found is few
    for text in (map_tab.NO_SEARCH, comparison_tab.NO_SEARCH):
        assert all(key in text for key in ("search_origin", "search_size", "search_step", "radius"))
