"""Takes on the page: rows that share frequencies, a list that selects a take, the places of the source in the scene."""

import dataclasses

import numpy as np
import pytest
from doubles import INVALID_VALUES, Recorder, Solver, State, set_by_client

from fdcal.graphics.picture import static_picture
from fdcal.model.measurement import Measurement
from fdcal.model.scene_file import load_scene
from fdcal.model.validation import InputError
from fdcal.session.sources import OpenRequest
from fdcal.viewer.background import prepare
from fdcal.viewer.background.cost_maps import count_label, map_modes, modes_label, row_label
from fdcal.viewer.gui import html
from fdcal.viewer.gui.binding import Binding, Tick
from fdcal.viewer.tabs import map, spectrum
from fdcal.viewer.tabs.spectrum import HIDDEN, SpectrumPlot


@pytest.fixture
def takes(measurement):
    """Two takes of equal frequencies, each with a spectrum of its own: rows 1, 3, 5, ... are take 0."""
    f = np.linspace(90, 310, 111)
    spectra = [np.stack([f, 1 + peak * np.exp(-(((f - 200) / 20) ** 2))]) for peak in (9.0, 99.0)]
    each = [dataclasses.replace(measurement, spectrum=spectrum) for spectrum in spectra]
    each[1] = dataclasses.replace(each[1], pressures=1j * each[1].pressures[::-1])
    return Measurement.from_takes(each)


@pytest.fixture
def work_of_takes(scene, takes):
    session = Recorder(State(takes.positions, last=6))
    request = OpenRequest(scene, choices={"objective": True})
    return prepare.PreparedRun(scene, takes, takes.problem("unit"), Solver(takes), session, request)


@pytest.fixture
def tabs(server, work_of_takes):
    binding = Binding(server.gui, work_of_takes, 12)
    map_ = map.MapTab(binding)
    yield binding, map_, spectrum.SpectrumPanel(binding)
    server.gui.reset()


def test_rows_are_named_by_their_take_where_there_are_several(takes, measurement):
    assert row_label(takes, 4) == "row 4, take 1, 140.0 Hz" and row_label(measurement, 2) == "mode 2, 140.0 Hz"
    assert count_label(takes, (1, 3)) == "2 rows of take 0" and count_label(takes, (1, 2)) == "2 rows of 2 takes"
    assert modes_label(takes, (4,)) == "row 4, take 1" and modes_label(measurement, (1, 2)) == "modes 1 to 2"
    assert html.modes_text(takes, 1, 12) == "rows 1–12 of 2 takes, 100–300 Hz"
    assert "row 12, take 1, <b>300.0 Hz" in spectrum.caption(takes, (1, 12), 400, None)


def test_a_take_selects_the_rows_of_the_map(work_of_takes):
    state = work_of_takes.session.view.state
    assert map_modes(work_of_takes, state, None, None) == (1, 2, 3, 4, 5, 6)
    assert map_modes(work_of_takes, state, None, None, 1) == (2, 4, 6)
    assert map_modes(work_of_takes, state, (1, 4, 5), None, 0) == (1, 5)
    assert map_modes(work_of_takes, state, (1, 5), None, 1) == (2,), "none is of the take: its lowest row"


def test_the_list_of_takes_changes_rows_and_spectrum(tabs):
    binding, map_, shown = tabs
    assert map_.take.options == ("All takes", "Take 0", "Take 1")
    view = binding.session.view
    shown.show(Tick(view, 0.0))
    every = len(shown.spectrum.handle.data[0])
    set_by_client(map_.take, "Take 1")
    assert binding.choices.take == 1
    shown.show(Tick(view, 1.0))
    assert "take 1" in shown.text.content and len(shown.spectrum.handle.data[0]) < every
    set_by_client(map_.take, "All takes")
    assert binding.choices.take is None


@pytest.mark.parametrize("value", INVALID_VALUES)
def test_no_value_of_a_client_harms_the_list(tabs, value):
    binding, map_, _ = tabs
    set_by_client(map_.take, value)
    assert binding.choices.take is None and map_.take.value == "All takes"


def test_one_take_has_no_list_and_the_words_of_before(controls):
    panel, _ = controls
    assert panel.map.take is None and panel.map.which.label == "Modes shown"


def test_the_spectrum_is_that_of_the_take(server, takes, measurement):
    plot = SpectrumPlot(server.gui, takes, 12)
    one, other, both = (plot.columns((1, 2), 150.0, take) for take in (0, 1, None))
    for number, columns in enumerate((one, other)):
        alone = dataclasses.replace(takes.of_take(number), takes=None)
        expected = SpectrumPlot(server.gui, alone, 6).columns((1,), 150.0)
        for column, same in zip(columns, expected, strict=True):
            np.testing.assert_allclose(column, same)
    assert np.count_nonzero(both[2] > HIDDEN) + np.count_nonzero(both[3] > HIDDEN) == 12
    assert not np.array_equal(one[1], other[1])


def test_a_saved_session_keeps_its_take(server, work_of_takes):
    saved = dataclasses.replace(Binding(server.gui, work_of_takes, 12).choices, take=1).to_save()
    again = dataclasses.replace(work_of_takes, opening=OpenRequest(work_of_takes.scene, choices=saved))
    assert Binding(server.gui, again, 12).choices.take == 1
    wrong = dataclasses.replace(work_of_takes, opening=OpenRequest(work_of_takes.scene, choices={"take": 2}))
    with pytest.raises(InputError, match=r"choices.take = 2 .* take \(0 to 1\)"):
        Binding(server.gui, wrong, 12)


@pytest.mark.parametrize("dark", [False, True])
def test_every_place_of_the_source_is_drawn_and_that_of_the_take_is_larger(takes, dark):
    scene = load_scene("two_places")
    measurement = dataclasses.replace(takes, search=None)
    pictures = {take: static_picture(scene, measurement, dark, take=take) for take in (None, 0, 1)}

    def size(picture, number):
        (star,) = [mesh for mesh in picture.meshes if mesh.name == f"source/{number}"]
        return np.ptp(star.vertices, axis=0).max()

    def text(picture, number):
        return next(label.text for label in picture.labels if label.name == f"source/{number}/name")

    for number, place in enumerate(scene.source.places):
        (star,) = [mesh for mesh in pictures[None].meshes if mesh.name == f"source/{number}"]
        np.testing.assert_allclose(star.vertices[:, :2].mean(axis=0), place[:2], atol=1e-3)
        assert text(pictures[None], number) == f"source, take {number}"
    assert size(pictures[None], 0) == pytest.approx(size(pictures[None], 1))
    assert size(pictures[1], 1) > 1.5 * size(pictures[1], 0)
    assert text(pictures[1], 0) == "take 0" and text(pictures[1], 1) == "source, take 1"
    stars = [mesh.name for mesh in static_picture(load_scene("tiny"), measurement).meshes if "source" in mesh.name]
    assert stars == ["source_halo", "source"], "as it was for one place"
