"""Broken files, as of `benchmarks fuzz`, a few of each."""

import pytest

from benchmarks.fuzzing import examine
from benchmarks.fuzzing.readers import READERS, Reader


@pytest.mark.parametrize("name", READERS)
def test_broken_files_are_refused_in_one_line(name):
    found = (examine.faults_apart if READERS[name].apart else examine.faults)(name, 0, READERS[name].cases)
    assert not found, "\n".join(found[:3])


@pytest.mark.parametrize(
    ("read", "words"),
    [
        (lambda path: 1 / 0, "ZeroDivisionError"),
        (lambda path: (path.parent / "left").touch(), "left behind"),
        (lambda path: examine.signal.pause(), "Hang"),
    ],
)
def test_a_reader_at_fault_is_found(read, words, tmp_path, monkeypatch):
    monkeypatch.setattr(examine, "WAIT", 1)
    path = tmp_path / "file"
    path.touch()
    assert words in examine.fault_of(Reader("", print, read), path)
