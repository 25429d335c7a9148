"""A smoke test of fdcal as it is installed: a calibration, a picture, a page that answers. `python -m benchmarks.smoke`

`.ci/run` calls it with the lowest versions that pyproject.toml allows, and with each Python that it names, where the
test suite runs with the newest versions and one Python. It needs nothing that fdcal does not.
"""

from __future__ import annotations

import platform
import signal
import subprocess
import sys
import tempfile
from importlib import metadata
from pathlib import Path
from urllib.request import urlopen

from .protocol import ProtocolPage

TIMEOUT = 300.0  # s, of one command; the first one compiles
SCENE, PNG = "tiny", b"\x89PNG\r\n\x1a\n"
SHOWN = ("numpy", "numba", "viser", "pyvista", "pillow")


def fdcal(*arguments: str) -> None:
    """Run a command; end this program where it fails or warns."""
    command = [sys.executable, "-m", "fdcal", *arguments]
    run = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT)
    if run.returncode or "Warning" in run.stderr:
        sys.exit(f"fdcal {' '.join(arguments)} ended with {run.returncode}:\n{run.stdout}{run.stderr}")


def check_page() -> None:
    """Serve the page, read its HTML and its scene, and end it as Ctrl-C does."""
    command = [sys.executable, "-m", "fdcal", "view", SCENE, "--port", "0", "--no-browser"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        address = server.stdout.readline().strip()
        if not address.startswith("http"):
            sys.exit(f"fdcal view printed {address!r}: {server.stderr.read()}")
        with urlopen(address, timeout=TIMEOUT) as answer:
            assert answer.status == 200 and b"<html" in answer.read()
        with ProtocolPage(address) as page:
            page.wait_for(lambda: "Run" in page.controls and "/microphones/true" in page.nodes, TIMEOUT)
        server.send_signal(signal.SIGINT)
        _, errors = server.communicate(timeout=TIMEOUT)
    finally:
        server.kill()
    assert server.returncode == 0 and "Traceback" not in errors, errors


def main(folder: Path) -> None:
    result, table, picture = (str(folder / name) for name in ("result.json", "table.csv", "picture.png"))
    fdcal("calibrate", SCENE, "-o", result)
    fdcal("export", result, "-o", table)
    fdcal("snapshot", SCENE, "--result", result, "--size", "320x240", "-o", picture)
    assert Path(picture).read_bytes().startswith(PNG)
    check_page()
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in SHOWN)
    print(f"smoke test passed: Python {platform.python_version()}, {versions}")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        main(Path(folder))
