"""Files are complete or absent; the cache is checked, bounded, and never stops a run."""

from __future__ import annotations

import dataclasses
import logging
import os

import numpy as np
import pytest

from fdcal.acoustics import fdtd
from fdcal.acoustics.measure import cached_measurement, cached_recordings
from fdcal.model import storage
from fdcal.model.scene_file import load_scene
from fdcal.model.storage import write_atomically
from fdcal.model.validation import InputError, StorageError


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A separate cache for this test."""
    monkeypatch.setenv("FDCAL_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def runs(monkeypatch):
    """Count the simulations."""
    seen, simulate = [], fdtd.simulate
    monkeypatch.setattr(fdtd, "simulate", lambda *given: seen.append(given) or simulate(*given))
    return seen


@pytest.fixture(scope="module")
def tiny():
    return load_scene("tiny")


def test_a_file_is_written_and_not_overwritten_without_force(tmp_path):
    path = tmp_path / "a.txt"
    write_atomically(path, lambda file: file.write_text("one"))
    with pytest.raises(InputError, match=r"a\.txt exists; use force to overwrite it"):
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
def test_an_interrupted_write_leaves_no_file(tmp_path, fault):
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
def test_a_damaged_file_is_replaced(tiny, folder, runs, damage, caplog):
    first = cached_recordings(tiny)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    with caplog.at_level(logging.WARNING):
        np.testing.assert_array_equal(cached_recordings(tiny), first)
    assert len(runs) == 2
    assert len(caplog.records) == 1 and "damaged" in caplog.text
    assert file.read_bytes() == whole


def test_a_complete_file_with_another_content_is_made_again(tiny, folder, caplog):
    first = cached_measurement(tiny)
    (file,) = folder.glob("*.npz")
    file.unlink()
    storage.load_or_make(file.name, lambda: b"something else", lambda stream: stream, lambda stream, b: stream.write(b))
    with caplog.at_level(logging.WARNING):
        np.testing.assert_array_equal(cached_measurement(tiny).pressures, first.pressures)
    assert "cannot be read" in caplog.text


def test_a_cache_that_cannot_be_written_stops_nothing(tiny, tmp_path, monkeypatch, caplog):
    (tmp_path / "file").touch()
    monkeypatch.setenv("FDCAL_CACHE", str(tmp_path / "file"))
    with caplog.at_level(logging.WARNING):
        assert cached_recordings(tiny).shape[0] == 16
    assert len(caplog.records) == 1 and "nothing is stored" in caplog.text


def test_ctrl_c_leaves_no_file(tiny, folder):
    def interrupt(done):
        if done > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cached_measurement(tiny, interrupt)
    assert not folder.exists() or not list(folder.iterdir())


def test_the_least_recently_used_files_are_deleted(tiny, folder, monkeypatch):
    folder.mkdir()
    for age, name in enumerate("abcd"):
        file = folder / f"{name * 64}.npy"
        file.write_bytes(bytes(1000))
        os.utime(file, (1e9 - age, 1e9 - age))
    (folder / "notes.npy").write_bytes(bytes(5000))  # no file of the cache
    (folder / ".fdcal-0123.npy").touch()
    os.utime(folder / ".fdcal-0123.npy", (1e9, 1e9))
    monkeypatch.setattr(storage, "CACHE_BYTES", 3500)
    storage.load_or_make(
        f"{'f' * 64}.npy", lambda: bytes(900), lambda stream: stream, lambda stream, b: stream.write(b)
    )
    assert sorted(f.name[0] for f in folder.iterdir()) == ["a", "b", "f", "n"]
