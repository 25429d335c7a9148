"""Calibrations from the session: given distances, modes left open, and scenes that are measurements."""

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from running import refuses

import fdcal
from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.model.measurement import load_measurement, save_measurement
from fdcal.model.scene import load_scene
from fdcal.session import session_file
from fdcal.session.plan import read_layout
from fdcal.session.scene_edits import edited
from fdcal.session.sources import OpenRequest


@pytest.mark.parametrize(("solver", "distance"), [("joint", 300.0), ("robust", None)])
def test_a_distance_or_given_positions_that_imply_an_impossible_sound_speed_are_doubted(solver, distance):
    measurement, options = fdcal.load("tiny"), {"solver": solver, "modes": 14}
    x = measurement.positions
    if distance is None:
        given = {n: 0.85 * x[n] for n in (0, 5, 7)}
        found = fdcal.calibrate(measurement, known=given, sound_speed_sigma=0.05, **options)
    else:  # known microphones would contradict the distance
        blind = replace(measurement, known=(), known_positions=None)
        length = (0, 15, distance * float(np.linalg.norm(x[0] - x[15])))
        found = fdcal.calibrate(blind, known="none", distance=length, **options)
    assert found.verdict == "sound_speed"
    doubted = "the distance" if distance else "the position of a microphone"
    assert f"{doubted} or the sound speed is wrong" in found.verdict_text


# A scene may name a measurement; it is opened by its name like any other scene, and nothing is simulated.


ROOT = Path(__file__).parents[2]
NAME = "frl_array"


@pytest.fixture(scope="module")
def measurement():
    return fdcal.load(NAME)


def test_the_measurement_of_frl_array_is_the_import_of_the_example_recordings(measurement):
    """If the import has changed, write scenes/frl_array.npz again as scenes/LICENSE.md describes."""
    folder = ROOT / "examples" / NAME
    made = fdcal.load(sorted(folder.glob("*.flac")), positions=folder / "nominal.csv", temperature=20.0)
    assert measurement.take_count == 4 and measurement.blind and measurement.nominal and not made.nominal
    for key in ("frequencies", "pressures", "takes", "positions", "arrivals", "noise_power"):
        np.testing.assert_allclose(getattr(measurement, key), getattr(made, key), rtol=1e-6, err_msg=key)


def test_a_scene_that_is_a_measurement_is_not_simulated():
    refuses(r'fdcal.load\("frl_array"\)', fdcal.simulate, NAME)
    layout = read_layout(NAME)
    assert layout.scene is None and len(layout.positions) == 7, "a plan takes its array, not its room"


def test_a_session_has_the_measurement_and_no_path(measurement, tmp_path):
    scene, joint = load_scene(NAME), solvers.load("joint")
    scene = edited(scene, {"solver.name": "joint", "solver.modes": 20})
    state = joint.init(measurement.problem(scene.solver.weights), scene.solver, 0)
    path = tmp_path / "session.zip"
    path.write_bytes(session_file.write(OpenRequest(scene, measurement=measurement, states=(state,))))
    with zipfile.ZipFile(path) as archive:
        text = archive.read(session_file.TABLE).decode()
    assert str(Path(scene.file).parent) not in text
    again = session_file.read(path)
    assert again.scene.title == scene.title and again.scene.remark == scene.remark and again.scene.file == ""
    assert again.measurement.nominal and again.measurement.take_count == 4
    refuses("is a measurement, which cannot be simulated", cached_measurement, again.scene)


def test_nominal_positions_survive_saving_and_are_replaced_by_a_list(measurement, tmp_path):
    path = tmp_path / "one.npz"
    save_measurement(measurement, path)
    assert load_measurement(path).nominal and replace(measurement, names=None).nominal
    assert fdcal.Measurement.from_takes([measurement.of_take(0), measurement.of_take(1)]).nominal
    assert not fdcal.load(path, positions=ROOT / "examples" / NAME / "nominal.csv").nominal
    refuses("nominal = 1 must be true or false", replace, measurement, nominal=1)
