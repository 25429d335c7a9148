"""Helpers for benchmarks of the page: a server in a separate process, and pages in a real browser without a screen."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from fdcal.model.scene import folder_of

WAIT = 180e3  # ms, bound of every wait
# The first is Chromium without windows and menus, which takes an eighth less processor time.
BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
ARGUMENTS = (
    "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip


# Draws with WebGL, and ends when the picture is on the screen.
DRAWN = """new Promise(resolve => {
    const gl = document.querySelector("canvas").getContext("webgl2");
    gl.clearColor(1, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    requestAnimationFrame(() => requestAnimationFrame(resolve));
})"""


class Served:
    """`fdcal view` of a scene with a changed solver; a context manager. `stopped_in`: time that Ctrl-C took, s."""

    def __init__(
        self, scene: str, solver: dict[str, str], watched: bool = False, cold: bool = False, own_cache: bool = False
    ):
        """`watched`: keep a `log` (see `benchmarks.watched`); `cold`: begin with empty caches; `own_cache`: begin with
        an empty folder for measurements and the error log only."""
        self._folder = Path(tempfile.mkdtemp())
        self._scene = _changed(scene, solver, self._folder) if solver else scene
        self._errors, self.stopped_in, self._watched = self._folder / "errors", 0.0, watched
        # it runs in the folder, where it writes what is recorded, but imports its modules from the checkout
        path = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
        self._environment = {**os.environ, "PYTHONUNBUFFERED": "1", "PYTHONPATH": path}
        self._log = self._folder / "log"
        self._error_log = self._folder / "FDCAL_CACHE" / "view.log"
        if own_cache:
            self._environment["FDCAL_CACHE"] = str(self._error_log.parent)
        if cold:
            self._environment |= {name: str(self._folder / name) for name in ("FDCAL_CACHE", "NUMBA_CACHE_DIR")}

    def __enter__(self) -> Served:
        command = self._command()
        with self._errors.open("w") as errors:
            self._process = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=errors, text=True, env=self._environment, cwd=self._folder
            )
        self.url = self._process.stdout.readline().strip()
        if not self.url.startswith("http"):
            raise RuntimeError(f"fdcal view {self._scene} printed {self.url!r} in place of its address")
        return self

    def _command(self) -> list[str]:
        program = ["benchmarks.watched", str(self._log)] if self._watched else ["fdcal"]
        scene = [str(self._scene)] if self._scene else []  # without one the opening plays
        return [sys.executable, "-m", *program, "view", *scene, "--port", "0", "--no-browser"]

    def __exit__(self, *_) -> None:
        start = time.perf_counter()
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(20)
        except subprocess.TimeoutExpired:
            self._process.kill()
        self.stopped_in = time.perf_counter() - start
        shutil.rmtree(self._folder, ignore_errors=True)

    def log(self) -> list[tuple[float, str, object]]:
        """Return the log of a watched server: time, s, event and value."""
        return [tuple(json.loads(line)) for line in self._log.read_text().splitlines()]

    def drag(self) -> None:
        """Make a watched server drag a microphone by itself."""
        self._process.send_signal(signal.SIGUSR1)

    def memory(self) -> int:
        """Return the resident memory of the server, bytes."""
        pages = Path(f"/proc/{self._process.pid}/statm").read_text().split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE")

    def handles(self) -> int:
        """Return the number of files that the server has open."""
        return len(os.listdir(f"/proc/{self._process.pid}/fd"))

    def processor(self) -> float:
        """Return the processor time that the server has used so far, s."""
        fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def threads(self) -> set[int]:
        """Return the numbers of the server's threads."""
        return {int(task.name) for task in Path(f"/proc/{self._process.pid}/task").iterdir()}

    def complaints(self) -> list[str]:
        """Return the lines that report errors, on the server's standard error and in its log."""
        lines = self._errors.read_text(encoding="utf-8", errors="replace").splitlines()
        if self._error_log.exists():
            logged = self._error_log.read_text(encoding="utf-8", errors="replace").splitlines()
            lines += [line for line in logged if " ERROR " in line or re.match(r"[\w.]+(Error|Exception)\b", line)]
        return [line for line in lines if any(word in line for word in ("rror", "Traceback", "xception", "details in"))]


class ServedEmpty(Served):
    """An empty page of viser (`benchmarks.empty_page`), in place of `fdcal view`."""

    def __init__(self):
        super().__init__("", {})

    def _command(self) -> list[str]:
        return [sys.executable, "-m", "benchmarks.empty_page"]


def _changed(scene: str, solver: dict[str, str], folder: Path) -> Path:
    """Write a copy of a scene with a changed solver, and return its path."""
    text = (folder_of("scenes") / f"{scene}.toml").read_text(encoding="utf-8")
    for key, value in solver.items():
        lines = [f'{key} = "{value}"' if line.startswith(f"{key} = ") else line for line in text.splitlines()]
        text = "\n".join(lines) + "\n"
    path = folder / f"{scene}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def browser_path() -> str | None:
    """Return the path of the first browser of `BROWSERS` that this machine has, or None."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


def launch(playwright):
    """Return a browser without a screen that draws by software; SystemExit if this machine has none."""
    path = browser_path()
    if path is None:
        raise SystemExit("no Chromium: apt-get install -y --no-install-recommends chromium-headless-shell")
    return playwright.chromium.launch(executable_path=path, headless=True, args=list(ARGUMENTS))


@contextlib.contextmanager
def chromium() -> Iterator:
    """Yield a browser that has already shown a page, because the start of a browser is not part of our times."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = launch(playwright)
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.set_content("<canvas></canvas><p>Another page</p>")
        page.evaluate(DRAWN)
        page.close()
        yield browser
        browser.close()


def open_page(browser, url: str):
    """Open one more page and wait for its picture."""
    page = browser.new_page(viewport={"width": 1280, "height": 720})
    page.set_default_timeout(WAIT)
    page.goto(f"{url}/?fixedDpr=1#layout=expert")
    wait_for_node(page, "/microphones/true")
    return page


def wait_for_node(page, name: str) -> None:
    """Wait until the page's scene has a node."""
    drawn = "name => window.__viserMutable?.nodeRefFromName?.[name] != null"
    page.wait_for_function(drawn, arg=name, timeout=WAIT)


def slider(page, label: str):
    """Return the handle of a slider, by its label."""
    number = page.get_by_text(label, exact=True).get_attribute("for")
    return page.locator(f"[id='{number}']").get_by_role("slider")
