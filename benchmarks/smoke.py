"""A smoke test of fdcal as it is installed: a calibration, a picture, a page that answers. `python -m benchmarks.smoke`

`.ci/run` calls it with the lowest versions that pyproject.toml allows on the oldest Python, and with the newest
versions on the newest one; the test suite runs with the newest versions and one Python. It needs nothing that fdcal
does not; `--core` tests an installation without extras. It runs outside of the checkout, so that it tests the installed
package.
"""

import platform
import signal
import subprocess
import sys
import tempfile
from importlib import metadata
from pathlib import Path
from urllib.request import urlopen

TIMEOUT = 300.0  # s, of one command; the first one compiles
SCENE, PNG = "tiny", b"\x89PNG\r\n\x1a\n"
SHOWN = ("numpy", "numba", "viser", "pyvista", "pillow")


def fdcal(*arguments: str) -> None:
    """Run a command; end this program if it fails or warns."""
    command = [sys.executable, "-m", "fdcal", *arguments]
    run = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT)
    if run.returncode or "Warning" in run.stderr:
        sys.exit(f"fdcal {' '.join(arguments)} ended with {run.returncode}:\n{run.stdout}{run.stderr}")


def check_page() -> None:
    """Serve the page, read its HTML and its scene, and end it as Ctrl-C does."""
    from .protocol import ProtocolPage  # here, because it needs the extra "page"

    command = [sys.executable, "-m", "fdcal", "view", SCENE, "--port", "0", "--no-browser"]
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # in the background of a shell; the server would inherit it
        signal.signal(signal.SIGINT, signal.default_int_handler)
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        address = server.stdout.readline().strip()
        if not address.startswith("http"):
            sys.exit(f"fdcal view printed {address!r}: {server.stderr.read()}")
        with urlopen(address, timeout=TIMEOUT) as answer:
            assert answer.status == 200 and b"<html" in answer.read()
        with ProtocolPage(address) as page:
            page.wait_for(lambda: "Play" in page.controls and "/microphones/true" in page.nodes, TIMEOUT)
        server.send_signal(signal.SIGINT)
        _, errors = server.communicate(timeout=TIMEOUT)
    finally:
        server.kill()
    assert server.returncode == 0 and "Traceback" not in errors, errors


def check_core(folder: Path) -> None:
    """Check that the lessons are there, and that a calibration and its export work."""
    from fdcal.session.lesson import lesson_names

    assert lesson_names()
    result, table = (str(folder / name) for name in ("result.json", "table.csv"))
    fdcal("--version")
    fdcal("calibrate", SCENE, "-o", result)
    fdcal("export", result, "-o", table)


def check_what_is_missing() -> None:
    """Check that commands of missing extras and packages end with one line that says what to install."""
    for missing, arguments in (
        ("fdcal[page]", ("view", SCENE)),
        ("fdcal[pictures]", ("snapshot", SCENE, "-o", "none.png")),
        ("pip install ./fdcal_bench", ("study", "study.toml")),
    ):
        run = subprocess.run(
            [sys.executable, "-m", "fdcal", *arguments], capture_output=True, text=True, timeout=TIMEOUT
        )
        assert run.returncode == 2 and run.stderr.count("\n") == 1 and missing in run.stderr, run.stderr


def main(folder: Path, core: bool) -> None:
    check_core(folder)
    if core:
        check_what_is_missing()
    else:
        picture = folder / "picture.png"
        fdcal("snapshot", SCENE, "--result", str(folder / "result.json"), "--size", "320x240", "-o", str(picture))
        assert picture.read_bytes().startswith(PNG)
        check_page()
    names = sorted(set(SHOWN) & {one.metadata["Name"] for one in metadata.distributions()})
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in names)
    print(f"smoke test passed: Python {platform.python_version()}, {versions}")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        main(Path(temporary), core="--core" in sys.argv[1:])
