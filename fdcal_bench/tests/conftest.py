"""The cache of a run of these tests, which `tests/conftest.py` has for those of fdcal."""

import os
from pathlib import Path

import pytest

from fdcal.solvers import starts


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory) -> Path:
    """A disk cache of this run's own, which all workers share."""
    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "cache"
    folder.mkdir(exist_ok=True)
    os.environ["FDCAL_CACHE"] = str(folder)
    root = str(Path(__file__).parents[2])
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
    return folder


@pytest.fixture(scope="session", autouse=True)
def few_random_starts():
    """The search for starts tries two random ones at most: its own tests are those of fdcal."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(starts, "RANDOM_STARTS", 2)
        yield
