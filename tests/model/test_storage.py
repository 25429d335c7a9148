"""Broken files are refused at once; written files are complete or absent; the cache."""

import dataclasses
import io
import logging
import os
import resource
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
import soundfile
from recorded import FS, responses
from running import exit_code, refuses

from fdcal.acoustics import fdtd
from fdcal.acoustics.measure import cached_measurement, cached_recordings
from fdcal.assessment.result_file import load_result
from fdcal.model import storage
from fdcal.model.measurement import load_measurement
from fdcal.model.scene import folder_of, load_scene
from fdcal.model.storage import load_archive, parse_text, write_atomically
from fdcal.model.validation import LIMITS, InputError, StorageError, shown
from fdcal.recordings import formats
from fdcal.recordings.formats.positions import read_places, read_positions
from fdcal.session import session_file

DEEP = 100_000


def refusal(call, *arguments) -> str:
    """Return the one line of an error that comes within 0.5 s of processor time, and takes less than 200 MB."""
    began, memory = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError) as caught:
        call(*arguments)
    assert time.process_time() - began < 0.5
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory < 200_000
    line = str(caught.value)
    assert "\n" not in line and len(line) < 1000
    return line


@pytest.mark.parametrize(("kind", "content", "words"), [
    *(("TOML", b"a" + text, "TOML") for text in (b" = " + b"[" * DEEP, b" = " + b"{a=" * DEEP, b".a" * DEEP)),
    *(("JSON", text * DEEP, "JSON: it is nested too deeply") for text in (b"[", b'{"a":')),
])  # fmt: skip
def test_what_is_deeply_nested_is_refused(kind, content, words):
    assert f"f is not valid {words}" in refusal(parse_text, content, kind, "f")


@pytest.mark.parametrize("number", [b"9" * 5000, b"0x" + b"f" * 5000, b"-" + b"9" * 5000])
def test_a_number_of_5000_digits_is_refused(number, tmp_path):
    tiny = (folder_of("scenes") / "tiny.toml").read_bytes()
    (tmp_path / "scene.toml").write_bytes(b"seed = " + number + b"\n" + tiny.replace(b"\nseed", b"\n# seed"))
    refusal(load_scene, tmp_path / "scene.toml")
    (tmp_path / "scene.toml").write_bytes(tiny.replace(b"walls = ", b"walls = " + number + b" # "))
    refusal(load_scene, tmp_path / "scene.toml")
    (tmp_path / "result.json").write_bytes(b'{"positions": ' + number + b"}")
    refusal(load_result, tmp_path / "result.json")
    assert shown(16**10_000) == shown([16**10_000]) == "a number of very many digits"
    assert len(shown("x" * 10_000)) == 60


@pytest.mark.parametrize(("name", "read"), [
    ("zero.toml", load_scene), ("zero.json", load_result), ("zero.csv", read_places), ("zero.xml", read_positions),
    ("zero.npz", load_measurement), ("zero.wav", formats.read), ("zero.h5", formats.read),
    ("zero.sofa", formats.read), ("zero.mat", formats.read), ("zero.zip", session_file.read),
])  # fmt: skip
def test_neither_a_device_without_end_nor_a_pipe_nor_a_loop_of_links_is_read(name, read, tmp_path):
    path = tmp_path / name
    for make in (lambda: path.symlink_to("/dev/zero"), lambda: os.mkfifo(path)):
        make()
        assert "not a regular file" in refusal(read, path)
        path.unlink()
    path.symlink_to(path)
    refuses("", read, path)


def bomb(path: Path, key: str, megabytes: int = 480) -> Path:
    """Write an archive of a few MB of which one member decompresses to hundreds of megabytes of zeros."""
    header = io.BytesIO()
    shape = (megabytes * 2**20 // 16, 1)
    np.lib.format.write_array_header_1_0(header, {"descr": "<c16", "fortran_order": False, "shape": shape})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open(f"{key}.npy", "w", force_zip64=True) as member:
            member.write(header.getvalue())
            for _ in range(megabytes // 8):
                member.write(bytes(8 * 2**20))
    return path


@pytest.mark.parametrize(("key", "read"), [("pressures", load_measurement), ("recordings", formats.read)])
def test_what_would_fill_the_memory_is_refused_before_it_is_decompressed(key, read, tmp_path):
    path = bomb(tmp_path / "bomb.npz", key)
    assert path.stat().st_size < 10 * 2**20
    line = refusal(read, path)
    assert "when decompressed" in line and "does not compress" in line


def test_arrays_that_are_not_compressed_may_be_larger_than_that(tmp_path, monkeypatch):
    monkeypatch.setattr("fdcal.model.storage.LIMITS", type(LIMITS)(unfolded=1000))
    np.savez(tmp_path / "plain.npz", a=np.ones(1000))
    np.savez_compressed(tmp_path / "packed.npz", a=np.ones(1000))
    with open(tmp_path / "plain.npz", "rb") as file:
        assert load_archive(file, lambda key: True)["a"].sum() == 1000
    with open(tmp_path / "packed.npz", "rb") as file, pytest.raises(InputError):
        load_archive(file, lambda key: True)


@pytest.mark.parametrize(("key", "read"), [
    *((key, load_measurement) for key in ("pressures", "names", "sound_speed")), ("recordings", formats.read),
])  # fmt: skip
def test_a_member_that_is_no_array_is_refused(key, read, tmp_path):
    with zipfile.ZipFile(tmp_path / "odd.npz", "w") as archive:
        for other in ("frequencies", "pressures", "sound_speed", "dimension") if read is load_measurement else ():
            file = io.BytesIO()
            np.save(file, np.ones((3, 8), complex))
            archive.writestr(f"{other}.npy", b"text" if other == key else file.getvalue())
        archive.writestr(f"{key}.npy", b"text")
    assert f'"{key}"' in refusal(read, tmp_path / "odd.npz")


def test_a_sound_file_whose_name_is_not_utf8_is_imported_and_written_under_such_a_name(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    samples = np.pad(responses(8), ((0, 0), (0, 1600)))
    soundfile.write(tmp_path / "plain.wav", (samples / np.abs(samples).max()).T, int(FS), subtype="FLOAT")
    name = os.fsencode(tmp_path) + b"/M\xfcnchen.wav"
    os.rename(tmp_path / "plain.wav", name)
    assert formats.read(os.fsdecode(name)).count == 8
    target = os.fsdecode(b"Z\xfcrich.npz")
    assert exit_code("import", os.fsdecode(name), "-o", target, "--array-radius", 0.5) == 0
    assert capsys.readouterr().err == ""
    assert load_measurement(tmp_path / target).count == 8


# Files are complete or absent; the cache is checked, bounded, and never stops a run.


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


def test_a_file_is_written_whole_or_not_at_all_and_not_overwritten_without_force(tmp_path):
    path = tmp_path / "a.txt"

    def broken(file, fault):
        file.write_text("half of it")
        raise fault

    def slow(file):
        path.write_text("theirs")
        file.write_text("mine")

    for fault in (KeyboardInterrupt, ValueError):
        with pytest.raises(fault):
            write_atomically(path, lambda file, fault=fault: broken(file, fault))
        assert os.listdir(tmp_path) == []
    refuses("exists", write_atomically, path, slow)
    assert path.read_text() == "theirs" and os.listdir(tmp_path) == ["a.txt"], "one that appeared meanwhile"
    usual = path.stat().st_mode
    path.unlink()
    with pytest.raises(StorageError, match=r"cannot write .*a\.txt: No such file or directory"):
        write_atomically(tmp_path / "none" / "a.txt", lambda file: file.write_text("one"))
    write_atomically(path, lambda file: file.write_text("one"))
    assert path.stat().st_mode == usual
    with pytest.raises(InputError, match=r"a\.txt exists; use force to overwrite it"):
        write_atomically(path, lambda file: file.write_text("two"))
    assert path.read_text() == "one"
    write_atomically(path, lambda file: file.write_text("two"), force=True)
    assert path.read_text() == "two" and os.listdir(tmp_path) == ["a.txt"]


def test_recordings_and_measurement_are_made_once(scene, folder, runs):
    recordings = cached_recordings(scene)
    np.testing.assert_array_equal(cached_recordings(scene), recordings)
    cached_recordings(dataclasses.replace(scene, solver=dataclasses.replace(scene.solver, modes=5)))
    first, second = cached_measurement(scene), cached_measurement(scene)
    assert len(runs) == 1
    names = {field.name for field in dataclasses.fields(first)} - {"origin"}
    for name in names:
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), err_msg=name)
    noisy = dataclasses.replace(scene, measurement=dataclasses.replace(scene.measurement, snr_db=20.0))
    assert not np.array_equal(cached_measurement(noisy).pressures, first.pressures)
    assert len(runs) == 1
    cached_recordings(dataclasses.replace(scene, source=dataclasses.replace(scene.source, low=30.0)))
    assert len(runs) == 2


@pytest.mark.parametrize("damage", [lambda b: b[:-40], lambda b: b"", lambda b: b[:500] + b"x" + b[501:]])
def test_a_damaged_file_is_replaced(scene, folder, runs, damage, caplog):
    first = cached_recordings(scene)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    with caplog.at_level(logging.WARNING):
        np.testing.assert_array_equal(cached_recordings(scene), first)
    assert len(runs) == 2
    assert len(caplog.records) == 1 and "damaged" in caplog.text
    assert file.read_bytes() == whole


def test_a_complete_file_with_another_content_is_made_again(scene, folder, caplog):
    first = cached_measurement(scene)
    (file,) = folder.glob("*.npz")
    file.unlink()
    storage.load_or_make(file.name, lambda: b"something else", lambda stream: stream, lambda stream, b: stream.write(b))
    with caplog.at_level(logging.WARNING):
        np.testing.assert_array_equal(cached_measurement(scene).pressures, first.pressures)
    assert "cannot be read" in caplog.text


def test_a_cache_that_cannot_be_written_stops_nothing(scene, tmp_path, monkeypatch, caplog):
    (tmp_path / "file").touch()
    monkeypatch.setenv("FDCAL_CACHE", str(tmp_path / "file"))
    with caplog.at_level(logging.WARNING):
        assert cached_recordings(scene).shape[0] == 16
    assert len(caplog.records) == 1 and "nothing is stored" in caplog.text


def test_the_least_recently_used_files_are_deleted(folder, monkeypatch):
    folder.mkdir()
    for age, name in enumerate("abcd"):
        file = folder / f"{name * 64}.npy"
        file.write_bytes(bytes(1000))
        os.utime(file, (1e9 - age, 1e9 - age))
    (folder / "notes.npy").write_bytes(bytes(5000))  # the cache did not write this file
    (folder / ".fdcal-0123.npy").touch()
    os.utime(folder / ".fdcal-0123.npy", (1e9, 1e9))
    monkeypatch.setattr(storage, "CACHE_BYTES", 3500)
    storage.load_or_make(
        f"{'f' * 64}.npy", lambda: bytes(900), lambda stream: stream, lambda stream, b: stream.write(b)
    )
    assert sorted(f.name[0] for f in folder.iterdir()) == ["a", "b", "f", "n"]
