"""The examples in the docstrings run, and print what they show."""

import doctest
import importlib
from pathlib import Path

import pytest

import fdcal

ROOT = Path(fdcal.__file__).parent
WITH_EXAMPLES = [path for path in sorted(ROOT.rglob("*.py")) if ">>> " in path.read_text(encoding="utf-8")]


def name_of(path: Path) -> str:
    parts = path.relative_to(ROOT.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@pytest.mark.parametrize("path", WITH_EXAMPLES, ids=name_of)
def test_the_examples_of_a_module_run(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = doctest.testmod(importlib.import_module(name_of(path)), verbose=False)
    assert result.attempted > 0
    assert result.failed == 0
    assert not list(tmp_path.iterdir())  # an example leaves no file behind
