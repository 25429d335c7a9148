"""Fixtures of several test files, and the rule whether a browser or GL test may be skipped."""

import functools
import gc
import hashlib
import io
import json
import os
import pickle
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

# Set before NumPy is imported, because several test processes use the same cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest
from browsing import ARGUMENTS
from PIL import Image
from running import exit_code
from xdist.scheduler import LoadFileScheduling

from benchmarks.pages import browser_path
from fdcal.acoustics.measure import cached_measurement
from fdcal.model import libraries
from fdcal.model.scene import folder_of, load_scene
from fdcal.recordings import frequencies, importer
from fdcal.session import calibration_run
from fdcal.solvers import starts, warmup_calls

gc.set_threshold(10_000)  # collecting after every 700 new objects would take a tenth of the time of all tests

# Signals are ignored in the background of a shell and under nohup; all processes would inherit this.
for number, handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, handler)

ROOT = Path(__file__).parent.parent
BROWSER = re.compile(r"def \w+\([^)]*\bbrowser\b")  # matches a test or a fixture that takes the browser
PAINTER = re.compile(r"def \w+\([^)]*\b(painted|one_painter)\b")


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory) -> Path:
    """A disk cache for this run only, so that no test reads what an older version computed.

    All workers use it, so that each scene is simulated once. Commands that tests run use it, too, and run the code of
    this checkout. If Python cannot write bytecode beside the source, their bytecode is stored here: there are hundreds
    of commands, and each would compile all that it imports.
    """
    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "cache"
    folder.mkdir(exist_ok=True)
    os.environ["FDCAL_CACHE"] = str(folder)
    if os.environ.pop("PYTHONDONTWRITEBYTECODE", ""):
        os.environ["PYTHONPYCACHEPREFIX"] = str(folder / "bytecode")
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return folder


APART = libraries.call


@pytest.fixture(scope="session", autouse=True)
def readers_here():
    """Read files in this process instead of a separate one for each, because few files of the tests are damaged."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(libraries, "call", called_here)
        yield


def called_here(function, *arguments, **limits):
    """Replace `libraries.call` by a call in this process, which also passes copies."""
    function, arguments = pickle.loads(pickle.dumps((function, arguments)))
    return function(*arguments)


@pytest.fixture
def apart(monkeypatch) -> None:
    """Read files that may crash a library in a separate process, as for a user."""
    monkeypatch.setattr(libraries, "call", APART)


@pytest.fixture(scope="module", autouse=True)
def few_random_starts(request):
    """Limit the search for starts to two random ones, except in tests of this search.

    If a channel or a given position is wrong, few starts agree, and the search would try dozens.
    """
    with pytest.MonkeyPatch.context() as patch:
        if request.path.name != "test_starts.py":
            patch.setattr(starts, "RANDOM_STARTS", 2)
        yield


@pytest.fixture(scope="session")
def scene():
    return load_scene("tiny")


@pytest.fixture(scope="session")
def tiny(cache, scene):
    """The measurement of `tiny`."""
    return cached_measurement(scene)


@pytest.fixture(scope="session")
def kernels() -> None:
    """Compile what a page needs, so that no test that waits for a session also waits for a compiler."""
    for _, compile_piece in warmup_calls("joint"):
        compile_piece()


@pytest.fixture(scope="module")
def remembered_runs(cache):
    """Make a run of the same problem with the same settings and seed only once, and assess it each time.

    This is for tests of options and results, not of the run itself. All workers use the same results.
    """
    run, folder = calibration_run.last_state, cache / "runs"
    folder.mkdir(exist_ok=True)

    def last_state(inputs, progress, problem, clock):
        if inputs.time_limit is not None or clock is not time.process_time:
            return run(inputs, progress, problem, clock)
        # Checks the measurement; the run begins when the iterator is read.
        calibration_run.states_of(inputs, progress, problem)
        key = hashlib.sha256(pickle.dumps((problem, inputs.settings, inputs.seed, starts.RANDOM_STARTS))).hexdigest()
        if not (folder / key).exists():
            found = run(inputs, progress, problem, clock)
            if found[1]:  # the run was stopped early
                return found
            own = folder / f"{key}-{os.getpid()}"
            own.write_bytes(pickle.dumps(found[0]))
            own.replace(folder / key)
        return pickle.loads((folder / key).read_bytes()), ""

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibration_run, "last_state", last_state)
        yield


@pytest.fixture
def quick_import(monkeypatch):
    """Limit recordings to 100 rows without short windows, so that a calibration takes a fraction of its time."""
    monkeypatch.setattr(frequencies, "ROWS", replace(frequencies.ROWS, min_of_array=40, max_of_array=100))
    monkeypatch.setattr(importer, "short_windows", lambda *_: None)


@pytest.fixture
def refused(tmp_path, monkeypatch, capsys):
    """Function that runs a command that must fail, and gives its one error line; in this process, which saves time."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments, code: int = 2) -> str:
        before = sorted(tmp_path.iterdir())
        ended, (out, errors) = exit_code(*arguments), capsys.readouterr()
        assert (ended, out) == (code, ""), errors
        *notes, line = errors.splitlines()
        assert not notes or "--host" in arguments, "one line, and a note on who else can reach the page"
        assert line.startswith("error: ") and not re.search("<[a-z_]+>", line), "each argument has its option's name"
        assert sorted(tmp_path.iterdir()) == before, "no output, no temporary file"
        return line

    return run


@pytest.fixture
def calibrate_file(tmp_path, monkeypatch, capsys):
    """Function that calibrates m.npz with options: exit code, output, error line, and result, None if none is written.

    Codes 2 and 3 write one line and no result, 0 and 4 all of the result.
    """
    monkeypatch.chdir(tmp_path)

    def run(*options):
        result = tmp_path / "r.json"
        result.unlink(missing_ok=True)
        ended = exit_code("calibrate", "m.npz", "-o", "r.json", *options)
        out, errors = capsys.readouterr()
        lines = [line for line in errors.splitlines() if line.startswith("error: ")]
        assert (len(lines), result.exists()) == (ended in (2, 3), ended in (0, 4))
        return ended, out, "".join(lines), json.loads(result.read_text()) if result.exists() else None

    return run


@pytest.fixture
def edited(tmp_path):
    """Function that writes `tiny` with some keys changed: edited({"room.cell": "0.5", "title": None}) -> path.

    Values are TOML text; None takes the key out. A key or table that `tiny` lacks is added.
    """

    def write(changes: dict[str, str | None], name: str = "edited") -> Path:
        path = tmp_path / f"{name}.toml"
        text = (folder_of("scenes") / "tiny.toml").read_text(encoding="utf-8")
        path.write_text(_edit(text, changes), encoding="utf-8")
        return path

    return write


def _edit(text: str, changes: dict[str, str | None]) -> str:
    head, *parts = re.split(r"(?m)^\[(\w+)\]", text)
    tables = {"": head, **dict(zip(parts[::2], parts[1::2], strict=True))}
    for path, value in changes.items():
        table, _, key = path.rpartition(".")
        lines = [line for line in tables.get(table, "").splitlines() if line.partition("=")[0].strip() != key]
        tables[table] = "\n".join([*lines, *([] if value is None else [f"{key} = {value}"]), ""])
    return "".join(f"[{name}]\n{lines}" if name else lines for name, lines in tables.items())


def pytest_collection_finish() -> None:
    """Exclude the objects that exist now from garbage collection."""
    gc.collect()
    gc.freeze()


@functools.cache
def shared_by(path: Path) -> str:
    """Return what the tests of a file have in common with those of other files; "" for nothing."""
    text = path.read_text(encoding="utf-8")
    if path.parent.name == "in_browser":
        return "page"
    return "browser" if BROWSER.search(text) else "painter" if PAINTER.search(text) else ""


def has_browser(path: Path) -> bool:
    return shared_by(path) in ("page", "browser")


class FewBrowsers(LoadFileScheduling):
    """Run the tests of a file on one worker; all files that use the same page or process run on one worker, too."""

    def _split_scope(self, nodeid: str) -> str:
        file = super()._split_scope(nodeid)
        return shared_by(self.config.rootpath / file) or file


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Return one more than the number of cores, because the worker with the browser waits a third of its time."""
    return (os.cpu_count() or 1) + 1


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Distribute the files to the workers."""
    return FewBrowsers(config, log)


@pytest.hookimpl(tryfirst=True)  # runs before -m selects
def pytest_collection_modifyitems(items) -> None:
    """Mark slow tests, and begin with browser tests and the longest files, so that all workers end together.

    The browser tests of a folder, which may share a page, stay together, in the order of their names.

    Slow tests are those in a browser and those in slow.txt, which .ci/slow.py writes from the durations of a run.
    """
    lines = (ROOT / "tests" / "slow.txt").read_text(encoding="utf-8").splitlines()
    slow = {name: float(seconds) for name, seconds in map(str.split, lines)}
    files = Counter()
    for item in items:
        if item.originalname in slow or has_browser(item.path):
            item.add_marker("slow")
    for path, name in dict.fromkeys((item.path, item.originalname) for item in items):
        files[path] += slow.get(name, 0.0)
    last = "~"  # sorts after the path of any file
    items.sort(key=lambda item: (str(item.path) if has_browser(item.path) else last, -files[item.path]))


def _missing(reason: str) -> None:
    """Skip the test; with CI in the environment fail instead, because there every test must run."""
    if os.environ.get("CI"):
        pytest.fail(reason)
    pytest.skip(reason)


@pytest.fixture(scope="session")
def require_browser() -> str:
    """Path of Chromium."""
    path = browser_path()
    if path:
        return path
    _missing("no Chromium: apt-get install -y --no-install-recommends chromium")


@pytest.fixture(scope="session")
def browser(require_browser):
    """One Chromium for all browser tests of a worker; every module opens and closes its own pages."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=require_browser, headless=True, args=ARGUMENTS)
        yield chromium
        chromium.close()


PAINT = """
import os, pickle, sys
out = os.fdopen(os.dup(1), "wb")
os.dup2(2, 1)  # a library may print to standard output, which carries the image
os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = "vtkEGLRenderWindow"
import pyvista
pyvista.Plotter(off_screen=True, window_size=(32, 32)).screenshot(return_img=True)
pickle.dump(True, out)  # drawing works: a later failure is not due to a missing library
out.flush()
from fdcal.graphics.snapshot import drawn_png
while True:
    try:
        arguments = pickle.load(sys.stdin.buffer)
    except EOFError:
        break
    pickle.dump(drawn_png(*arguments), out)
    out.flush()
"""


@pytest.fixture(scope="session")
def painted(cache):
    """Function (picture, size, view) -> image (H, W, 3) int as of `render_png`, from one process for all, with VTK.

    Without a library that draws without a screen VTK ends this process.
    """
    process = subprocess.Popen([sys.executable, "-c", PAINT], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdin and process.stdout
    try:
        pickle.load(process.stdout)
    except EOFError:
        _missing("no off-screen GL: apt-get install -y libegl1 libgl1-mesa-dri")

    def paint(picture, size, view):
        pickle.dump((picture, tuple(size), view), process.stdin)
        process.stdin.flush()
        return np.asarray(Image.open(io.BytesIO(pickle.load(process.stdout)))).astype(int)

    yield paint
    process.stdin.close()
    process.wait(timeout=60)


@pytest.fixture
def one_painter(painted, monkeypatch):
    """Draw the snapshots of this process in the process of `painted` instead of a new one for each."""

    def render_png(picture, size, view):
        png = io.BytesIO()
        Image.fromarray(painted(picture, size, view).astype(np.uint8)).save(png, format="png")
        return png.getvalue()

    monkeypatch.setattr("fdcal.graphics.snapshot.render_png", render_png)
