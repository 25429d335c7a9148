"""A few broken files from `benchmarks fuzz` of each kind that no C library reads."""

import pytest

from benchmarks.fuzzing.examine import faults
from benchmarks.fuzzing.readers import READERS


@pytest.mark.parametrize("name", [name for name, reader in READERS.items() if not reader.apart])
def test_broken_files_are_refused_in_one_line(name):
    assert not (found := faults(name, 0, 12)), "\n".join(found[:3])
