"""SceneParameters of a scene: their values, their effects, impossible ones; and scenes edited as tables."""

import dataclasses

import numpy as np
import pytest
from running import refuses

from fdcal.acoustics.measure import cached_recordings, measure
from fdcal.model.arrays import positions_of
from fdcal.model.gauge import fixes_gauge
from fdcal.model.scene import MeasuredScene, load_scene, scene_names
from fdcal.model.validation import InputError, build
from fdcal.session.scene_edits import edited, parameters_of, table_of, with_parameters
from fdcal.session.sources import OpenRequest

SIMULATED = [name for name in scene_names() if not isinstance(load_scene(name), MeasuredScene)]


@pytest.mark.parametrize("name", scene_names())
def test_a_scene_is_the_table_of_its_file(name):
    scene = load_scene(name)
    assert build(type(scene), table_of(scene)) == scene == edited(scene, {})


def test_edits_are_checked_like_a_file():
    scene = load_scene("tiny")
    changed = edited(scene, {"room.walls": "absorbing", "room.admittance": 0.1, "seed": 4, "search.step": 0.04})
    assert (changed.room.walls, changed.seed, changed.search.step) == ("absorbing", 4, 0.04)
    assert edited(scene, {"gauge.known": None, "gauge.free": [3, 4]}).gauge.free == (3, 4)
    for change in ({"room.wals": "rigid"}, {"room.walls": "soft"}, {"room": 3}, {"seed": -1}, {"seed.x": 1}):
        refuses("", edited, scene, change)
    measured = load_scene("frl_array")
    changed = edited(measured, {"solver.name": "joint", "seed": 3})
    assert (changed.solver.name, changed.seed, changed.file) == ("joint", 3, measured.file)
    for key in ("room.size", "array.count", "measurement.snr_db", "gauge.known", "file"):
        refuses(f"{key} of a measurement cannot be changed", edited, measured, {key: 1})


def test_the_index_of_a_session_is_clipped_to_its_states():
    scene = load_scene("tiny")
    assert OpenRequest(scene).seed == scene.seed and OpenRequest(scene, 7).seed == 7
    for wrong in ({"index": 0}, {"states": (1, 2), "index": 2}, {"start_seed": -1}):
        refuses("", OpenRequest, scene, **wrong)


@pytest.mark.parametrize("name", SIMULATED)
def test_a_smaller_array_stands_in_a_smaller_domain(name):
    scene = load_scene(name)
    parameters = parameters_of(scene)
    assert with_parameters(scene, parameters) is scene, "unchanged parameters change nothing"
    smaller = with_parameters(scene, dataclasses.replace(parameters, radius=0.8 * parameters.radius))
    size = [np.ptp(positions_of(one), axis=0).max() for one in (scene, smaller)]
    assert size[1] == pytest.approx(0.8 * size[0], abs=2 * (scene.room.cell or 0) + 1e-9)
    assert smaller.search.radius == pytest.approx(0.8 * scene.search.radius)
    assert "radius" in smaller.title and parameters_of(smaller).radius == pytest.approx(0.8 * parameters.radius)
    if scene.room.dimension == 2:  # every cell centre inside the domain remains a candidate
        steps = (positions_of(smaller) - smaller.search.origin) / smaller.search.step
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


@pytest.mark.parametrize(
    ("name", "count"), [("array1_circle", 40), ("array2_random", 50), ("tiny", 20), ("ball3d", 30)]
)
def test_a_scene_gets_the_requested_number_of_microphones_and_known_ones_that_fix_the_gauge(name, count):
    scene = load_scene(name)
    changed = with_parameters(scene, dataclasses.replace(parameters_of(scene), microphones=count, known=5))
    positions, known = positions_of(changed), changed.gauge.indices(count)
    assert len(positions) == count and len(known) == 5 and fixes_gauge(positions[list(known)])
    square = load_scene("fig1_square")
    changed = with_parameters(square, dataclasses.replace(parameters_of(square), microphones=30, known=3))
    assert changed.array.shape == (5, 5) and parameters_of(changed).microphones == 25, "the nearest number of rows"


def test_a_wrong_sound_speed_scales_the_wavenumbers_and_no_pressure():
    scene = load_scene("tiny")
    wrong = with_parameters(scene, dataclasses.replace(parameters_of(scene), sound_speed_error=0.02))
    other, right = (measure(one, cached_recordings(scene)) for one in (wrong, scene))
    np.testing.assert_allclose(other.wavenumbers * 1.02, right.wavenumbers)
    assert other.sound_speed == pytest.approx(1.02 * right.sound_speed)
    np.testing.assert_array_equal(other.pressures, right.pressures)


def test_absorption_is_what_the_walls_do_not_reflect():
    scene = load_scene("tiny")
    changed = with_parameters(scene, dataclasses.replace(parameters_of(scene), walls="absorbing", absorption=0.36))
    beta = changed.room.admittance
    assert 1 - ((1 - beta) / (1 + beta)) ** 2 == pytest.approx(0.36)
    assert parameters_of(changed).absorption == pytest.approx(0.36)
    assert changed.title == "tiny, changed: absorbing walls, absorption 36 %"
    rigid = with_parameters(changed, dataclasses.replace(parameters_of(changed), walls="rigid"))
    assert (rigid.room.admittance, rigid.title) == (0, "tiny, changed: rigid walls"), "the last change counts"
    measured = load_scene("listening_lab")
    parameters = parameters_of(measured)
    assert (parameters.walls, parameters.absorption, parameters.known) == ("unknown", 0.0, 0)
    changed = with_parameters(measured, dataclasses.replace(parameters, microphones=40, radius=0.3, known=4))
    assert changed.room == measured.room and positions_of(changed).shape == (40, 3)
    with pytest.raises(InputError, match=r"room\.walls = 'rigid'.*unknown"):
        with_parameters(measured, dataclasses.replace(parameters, walls="rigid"))


@pytest.mark.parametrize(
    "change",
    [{"known": 2}, {"known": 16}, {"radius": 3.0}, {"radius": 0.0}, {"walls": "soft"}]
    + [{"walls": "absorbing", "absorption": 0.0}, {"sound_speed_error": 0.9}, {"seed": -1}],
)
def test_impossible_parameters_are_refused(change):
    scene = load_scene("tiny")
    refuses("", lambda: with_parameters(scene, dataclasses.replace(parameters_of(scene), **change)))
