"""Broken files, the same in every run: each reader refuses them in one line, or reads what is in order.

`python -m benchmarks fuzz` tries 10,000 each.
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.fuzzing import examine
from benchmarks.fuzzing.mutations import broken
from benchmarks.fuzzing.readers import READERS, Reader

CASES = 200


@pytest.mark.parametrize("name", READERS)
def test_broken_files_are_refused_in_one_line(name):
    found = (examine.faults_apart if READERS[name].apart else examine.faults)(name, 0, CASES)
    assert not found, "\n".join(found[:3])


def test_the_same_case_breaks_a_file_the_same_way():
    one, other = (broken(b"key = 1.5\n" * 20, np.random.default_rng(7)) for _ in range(2))
    assert one == other


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
