"""Files are whole or not there; the cache is checked, bounded and never in the way; results survive the round trip."""

from __future__ import annotations

import dataclasses
import json
import logging
import math
import os

import numpy as np
import pytest

from fdcal.acoustics import fdtd
from fdcal.acoustics.measurement_cache import cached_measurement, cached_recordings
from fdcal.assessment.result_file import load_result, save_result
from fdcal.model import storage
from fdcal.model.scene import load_scene
from fdcal.model.storage import write_atomically
from fdcal.model.validation import InputError, StorageError

RESULT = {
    "positions": np.array([[0.1, 0.2], [1 / 3, 4.0]]),
    "solver": "descent",
    "seed": 3,
    "frequencies": np.array([28.6, 34.3]),
    "cost": 1.25e-7,
    "sweeps": 41,
    "elapsed_s": 2.5,
    "converged": True,
    "mean_error_m": None,
    "max_error_m": 0.02,
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A cache of this test's own."""
    monkeypatch.setenv("FDCAL_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def runs(monkeypatch):
    """Counts the simulations."""
    seen, simulate = [], fdtd.simulate
    monkeypatch.setattr(fdtd, "simulate", lambda *given: seen.append(given) or simulate(*given))
    return seen


@pytest.fixture(scope="module")
def tiny():
    return load_scene("tiny")


def test_a_file_is_written_and_not_overwritten_without_force(tmp_path):
    path = tmp_path / "a.txt"
    write_atomically(path, lambda file: file.write_text("one"))
    with pytest.raises(InputError, match=r"a\.txt exists; use --force to overwrite it"):
        write_atomically(path, lambda file: file.write_text("two"))
    assert path.read_text() == "one"
    write_atomically(path, lambda file: file.write_text("two"), force=True)
    assert path.read_text() == "two"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_a_file_that_appears_while_writing_is_not_overwritten(tmp_path):
    def slow(file):
        (tmp_path / "a.txt").write_text("theirs")
        file.write_text("mine")

    with pytest.raises(InputError, match="exists"):
        write_atomically(tmp_path / "a.txt", slow)
    assert (tmp_path / "a.txt").read_text() == "theirs"
    assert os.listdir(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("fault", [KeyboardInterrupt, ValueError])
def test_what_is_broken_off_leaves_nothing(tmp_path, fault):
    def broken(file):
        file.write_text("half of it")
        raise fault

    with pytest.raises(fault):
        write_atomically(tmp_path / "a.txt", broken)
    assert os.listdir(tmp_path) == []


def test_a_missing_folder_is_a_storage_error_of_one_line(tmp_path):
    with pytest.raises(StorageError, match=r"cannot write .*a\.txt: No such file or directory") as error:
        write_atomically(tmp_path / "none" / "a.txt", lambda file: file.write_text("one"))
    assert "\n" not in str(error.value)


def test_new_files_have_usual_permissions(tmp_path):
    (tmp_path / "usual").touch()
    write_atomically(tmp_path / "a.txt", lambda file: file.write_text("one"))
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "usual").stat().st_mode


def test_recordings_are_simulated_once(tiny, folder, runs):
    first = cached_recordings(tiny)
    np.testing.assert_array_equal(cached_recordings(tiny), first)
    assert len(runs) == 1
    cached_recordings(dataclasses.replace(tiny, solver=dataclasses.replace(tiny.solver, modes=5)))
    assert len(runs) == 1
    cached_recordings(dataclasses.replace(tiny, source=dataclasses.replace(tiny.source, low=30.0)))
    assert len(runs) == 2


def test_measurement_is_made_once(tiny, folder, runs):
    first, second = cached_measurement(tiny), cached_measurement(tiny)
    assert len(runs) == 1
    for field in dataclasses.fields(first):
        np.testing.assert_array_equal(getattr(first, field.name), getattr(second, field.name), err_msg=field.name)
    noisy = dataclasses.replace(tiny, measurement=dataclasses.replace(tiny.measurement, snr_db=20.0))
    assert not np.array_equal(cached_measurement(noisy).pressures, first.pressures)
    assert len(runs) == 1


@pytest.mark.parametrize("damage", [lambda b: b[:-40], lambda b: b"", lambda b: b[:500] + b"x" + b[501:]])
def test_a_damaged_file_is_made_anew(tiny, folder, runs, damage, caplog):
    first = cached_recordings(tiny)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    with caplog.at_level(logging.WARNING):
        np.testing.assert_array_equal(cached_recordings(tiny), first)
    assert len(runs) == 2
    assert len(caplog.records) == 1 and "damaged" in caplog.text
    assert file.read_bytes() == whole


def test_a_file_that_is_whole_but_holds_something_else_is_made_anew(tiny, folder, caplog):
    first = cached_measurement(tiny)
    (file,) = folder.glob("*.npz")
    file.write_bytes(b"something else" + storage._checksum(b"something else"))
    with caplog.at_level(logging.WARNING):
        np.testing.assert_array_equal(cached_measurement(tiny).pressures, first.pressures)
    assert "cannot be read" in caplog.text


def test_a_cache_that_cannot_be_written_stops_nothing(tiny, tmp_path, monkeypatch, caplog):
    (tmp_path / "file").touch()
    monkeypatch.setenv("FDCAL_CACHE", str(tmp_path / "file"))
    with caplog.at_level(logging.WARNING):
        assert cached_recordings(tiny).shape[0] == 16
    assert len(caplog.records) == 1 and "nothing is kept" in caplog.text


def test_ctrl_c_leaves_nothing(tiny, folder):
    def interrupt(done):
        if done > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cached_measurement(tiny, interrupt)
    assert not folder.exists() or not list(folder.iterdir())


def test_the_oldest_files_are_dropped(tiny, folder, monkeypatch):
    folder.mkdir()
    for age, name in enumerate("abcd"):
        file = folder / f"{name * 64}.npy"
        file.write_bytes(bytes(1000))
        os.utime(file, (1e9 - age, 1e9 - age))
    (folder / "notes.npy").write_bytes(bytes(5000))  # no file of the cache
    (folder / ".fdcal-0123.npy").touch()
    os.utime(folder / ".fdcal-0123.npy", (1e9, 1e9))
    monkeypatch.setattr(storage, "CACHE_BYTES", 2500)
    storage._bound(folder)
    assert sorted(f.name[0] for f in folder.iterdir()) == ["a", "b", "n"]


def test_a_result_survives_the_round_trip(tmp_path):
    path = tmp_path / "r.json"
    save_result(RESULT, path)
    back = load_result(path)
    assert back.keys() == RESULT.keys()
    for key, value in RESULT.items():
        np.testing.assert_array_equal(back[key], value)
    assert back["positions"].dtype == float
    with pytest.raises(InputError, match="--force"):
        save_result(RESULT, path)
    save_result(back, path, force=True)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("positions", [1.0, 2.0]),
        ("positions", [[1.0, 2.0], [3.0]]),
        ("positions", [[1.0], [2.0]]),
        ("positions", [["a", "b"]]),
        ("positions", [[math.nan, 1.0]]),
        ("frequencies", []),
        ("solver", 3),
        ("seed", True),
        ("sweeps", 1.5),
        ("cost", math.inf),
        ("cost", 10**400),
        ("mean_error_m", -(10**400)),
        ("converged", "yes"),
        ("cost", None),
    ],
)
def test_a_malformed_result_names_the_key(tmp_path, key, value):
    table = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in RESULT.items()}
    path = tmp_path / "r.json"
    path.write_text(json.dumps(table | {key: value}))
    with pytest.raises(InputError, match=f'r.json: "{key}"'):
        load_result(path)
    with pytest.raises(InputError, match=f'"{key}"'):
        save_result(table | {key: value}, tmp_path / "s.json")
    del table[key]
    path.write_text(json.dumps(table))
    with pytest.raises(InputError, match=f'has no "{key}"'):
        load_result(path)
    assert os.listdir(tmp_path) == ["r.json"]


TRUST = {
    "names": ["a", "b"],
    "excluded": ["c"],
    "uncertainty_m": [0.0, 0.001],
    "residual_to_noise": 1.02,
    "verdict": "good",
    "verdict_text": "nothing speaks against these positions",
    "sound_speed": 343.0,
}


def test_a_result_with_a_verdict_survives_the_round_trip_and_older_files_are_read(tmp_path):
    save_result(RESULT | TRUST, tmp_path / "new.json")
    back = load_result(tmp_path / "new.json")
    for key, value in TRUST.items():
        np.testing.assert_array_equal(back[key], value)
    save_result(RESULT, tmp_path / "old.json")
    assert not set(TRUST) & set(load_result(tmp_path / "old.json"))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("uncertainty_m", [0.1]),
        ("uncertainty_m", [0.1, math.nan]),
        ("residual_to_noise", None),
        ("verdict", 4),
        ("sound_speed", math.inf),
        ("names", "a,b"),
        ("excluded", [3]),
    ],
)
def test_a_malformed_verdict_names_the_key(tmp_path, key, value):
    path = tmp_path / "r.json"
    table = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in (RESULT | TRUST | {key: value}).items()}
    path.write_text(json.dumps(table))
    with pytest.raises(InputError, match=f'r.json: "{key}"'):
        load_result(path)


def test_a_file_that_is_no_result(tmp_path):
    path = tmp_path / "r.json"
    with pytest.raises(StorageError, match="cannot read"):
        load_result(path)
    for text in ("{", "[1]", "\udcff"):
        path.write_bytes(text.encode(errors="surrogateescape"))
        with pytest.raises(InputError, match=r"r\.json"):
            load_result(path)
