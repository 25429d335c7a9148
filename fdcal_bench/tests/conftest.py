"""A cache for these tests, as `tests/conftest.py` has one for those of fdcal."""

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
    """Limit the search for starts to two random ones; the tests of fdcal test this search."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(starts, "RANDOM_STARTS", 2)
        yield
