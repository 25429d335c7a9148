"""Broken files, as of `benchmarks fuzz`, a few of each."""

import pytest

from benchmarks.fuzzing import examine
from benchmarks.fuzzing.readers import READERS


@pytest.mark.parametrize("name", READERS)
def test_broken_files_are_refused_in_one_line(name):
    found = (examine.faults_apart if READERS[name].apart else examine.faults)(name, 0, READERS[name].cases)
    assert not found, "\n".join(found[:3])
