"""A measured room imported: an array rendered at the positions given, with what is modelled said plainly."""

import shutil

import numpy as np
import pytest
from recorded import write_places
from running import exit_code
from scipy.io import loadmat, savemat

from fdcal.acoustics.plane_waves import plane_wave_pressures
from fdcal.model.measurement import load_measurement
from fdcal.model.room import MEASURED_AND_MODELLED, response_path
from fdcal.model.sdm_response import load_sdm_response
from fdcal.model.validation import InputError
from fdcal.recordings.importer import import_recording, import_summary
from fdcal.recordings.recording import ImportOptions

PLACES = np.random.default_rng(0).uniform(-0.3, 0.3, (24, 3))
ROOM = str(response_path("listening_lab"))


@pytest.fixture
def layout(tmp_path):
    return str(write_places(tmp_path / "layout.csv", PLACES, [f"m{n}" for n in range(len(PLACES))]))


def test_the_pressures_are_those_of_the_plane_waves(layout):
    measurement, report = import_recording(ROOM, ImportOptions(array=layout, sound_speed=340.0, known="m0,m3,m7,m9"))
    assert measurement.names[:2] == ("m0", "m1") and np.array_equal(measurement.positions, PLACES)
    assert np.array_equal(measurement.known_positions, PLACES[[0, 3, 7, 9]])
    f, k = measurement.frequencies, measurement.wavenumbers
    assert np.allclose(k, 2 * np.pi * f / 340.0), "the sound is complete: no window"
    expected = plane_wave_pressures(load_sdm_response(ROOM), PLACES, f, 340.0)
    found = measurement.pressures
    common = np.sum(found.conj() * expected, axis=1) / np.sum(np.abs(found) ** 2, axis=1)  # of the time of beginning
    assert np.allclose(common[:, None] * found, expected, atol=1e-6 * np.abs(expected).max())
    assert f"modelled     {MEASURED_AND_MODELLED}" in import_summary(measurement, report)


def test_frequencies_are_evenly_spaced_and_independent(layout):
    few, _ = import_recording(ROOM, ImportOptions(array=layout, most=10))
    many, report = import_recording(ROOM, ImportOptions(array=layout, most=500, frequencies="20:700"))
    assert len(few.frequencies) == 10 and np.ptp(np.diff(few.frequencies)) < 1e-9
    assert np.diff(many.frequencies).min() == pytest.approx(1 / report.recording.duration)
    with pytest.raises(InputError, match=r"20:12000.*HI <= 8000 Hz"):
        import_recording(ROOM, ImportOptions(array=layout, frequencies="20:12000"))


def test_positions_are_needed_and_belong_to_a_measured_room_alone(layout, tmp_path, capsys):
    assert exit_code("import", ROOM, "--array", layout, "-o", tmp_path / "lab.npz") == 0
    assert "between the microphones is modelled" in capsys.readouterr().out
    assert load_measurement(tmp_path / "lab.npz").count == 24
    for command in (["import", ROOM, "-o", str(tmp_path / "other.npz")], ["calibrate", ROOM]):
        assert exit_code(*command) == 2
        assert "--array FILE.csv" in capsys.readouterr().err
    other = tmp_path / "recording.npz"
    np.savez(other, recordings=np.ones((3, 400)), sample_rate=8000.0)
    with pytest.raises(InputError, match="leave out array"):
        import_recording(other, ImportOptions(array=layout))
    flat = tmp_path / "flat.csv"
    flat.write_text("name,x,y\na,0,0\nb,1,0\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"flat\.csv has two coordinates"):
        import_recording(ROOM, ImportOptions(array=str(flat)))


def test_a_response_that_wraps_round_or_is_missing_is_refused(layout, tmp_path, capsys):
    table = {key: value for key, value in loadmat(ROOM).items() if key[0] != "_"}
    path, output = tmp_path / "wrapped.mat", str(tmp_path / "lab.npz")
    savemat(path, table | {key: np.roll(table[key], -100) for key in ("p", "azi_rad", "ele_rad")})
    assert exit_code("import", str(path), "--array", layout, "-o", output) == 2
    assert "wraps round" in capsys.readouterr().err
    assert exit_code("import", str(tmp_path / "none.mat"), "--array", layout, "-o", output) == 3
    shutil.copy(layout, tmp_path / "layout.mat")
    assert exit_code("import", str(tmp_path / "layout.mat"), "--array", layout, "-o", output) == 2


@pytest.fixture
def response_file(tmp_path):
    path = tmp_path / "response.mat"
    rng = np.random.default_rng(0)
    angles = {"azi_rad": rng.uniform(-3, 3, 200), "ele_rad": rng.uniform(-1.5, 1.5, 200)}
    savemat(path, {"p": rng.normal(size=200) * np.exp(-np.arange(200) / 20), **angles, "fs": 48000.0})
    return path


@pytest.mark.parametrize("kind", (20, 255))
def test_an_element_of_an_unknown_type_is_refused(response_file, kind):
    """SciPy's compiled reader takes the type as an index and ends its process on some of these."""
    data = bytearray(response_file.read_bytes())
    tag = data.index(b"azi_rad") + 8  # of the values
    assert data[tag] == 9, "double"
    data[tag] = kind
    response_file.write_bytes(data)
    with pytest.raises(InputError, match=r"response\.mat"):
        load_sdm_response(response_file)


@pytest.mark.parametrize("length", (131, -1))
def test_a_file_that_is_cut_off_is_refused(response_file, length):
    response_file.write_bytes(response_file.read_bytes()[:length])
    with pytest.raises(InputError):
        load_sdm_response(response_file)


def test_variables_of_any_kind_may_stand_beside_a_response(response_file):
    table = {key: value for key, value in loadmat(response_file).items() if key[0] != "_"}
    expected = load_sdm_response(response_file).amplitudes
    others = {"text": "a room", "list": np.array([1, "b"], dtype=object), "parts": {"a": 1.0}, "z": np.array([1j])}
    for options in ({"do_compression": True}, {"oned_as": "column"}):
        savemat(response_file, {**others, **table}, **options)
        assert np.array_equal(load_sdm_response(response_file).amplitudes, expected)
    for wrong in ("text", np.array([1.0 + 1j])):
        savemat(response_file, {"p": wrong})
        with pytest.raises(InputError, match='"p" is no array of real numbers'):
            load_sdm_response(response_file)
