"""The public Python API: each name is there, is loaded when it is first used, and is documented."""

from __future__ import annotations

import subprocess
import sys

import pytest

import fdcal


def test_the_table_and_all_list_the_same_names():
    assert sorted(fdcal.__all__) == sorted(fdcal.PUBLIC)
    assert set(fdcal.PUBLIC) <= set(dir(fdcal))


@pytest.mark.parametrize("name", fdcal.__all__)
def test_a_public_name_is_there_and_documented(name):
    value = getattr(fdcal, name)
    assert value.__name__ == name
    assert value.__doc__


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="has no attribute 'nosuch'"):
        fdcal.nosuch  # noqa: B018


def test_importing_the_package_loads_no_module_of_it_nor_numpy():
    code = "import sys, fdcal; print(*[m for m in sys.modules if m.startswith('fdcal.') or m == 'numpy'])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert run.stdout.split() == []
