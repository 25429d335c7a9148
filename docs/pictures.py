"""Make the pictures of the documentation: `python docs/pictures.py [NAME ...]`.

Without names it makes all except those of studies. Commands of fdcal draw them; those of the page are taken in a real
browser (playwright and Chromium, as for the tests). Pictures are committed, because making them takes
minutes. Look at the pictures before you commit them.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parent.parent
PICTURES = ROOT / "docs" / "pictures"
COLOURS = 256  # of a picture that is larger than LARGEST with all its colours
LARGEST = 195_000  # bytes
PAGE_SIZE = {"width": 1280, "height": 720}  # pixels

# The commands that make each picture, run in a temporary folder; the last one writes picture.png.
COMMANDS = {
    "landscape": ["landscape fig1_square --microphone 16 --mode-numbers 20,40,57 -o picture.png"],
    "descent-stalls": [
        "calibrate array1_circle --solver descent -o result.json",
        "snapshot array1_circle --result result.json --microphone 8 --view top -o picture.png",
    ],
    "all-at-once": [
        "calibrate array1_circle --solver joint -o result.json",
        "snapshot array1_circle --result result.json --microphone 8 --view top -o picture.png",
    ],
    "ball": [
        "calibrate ball3d -o result.json",
        "snapshot ball3d --result result.json --view close -o picture.png",
    ],
}
# pictures that a script of examples/ writes
EXAMPLES = {"beamforming": "08_beamforming_map.py", "measured-array": "07_measured_array.py"}
# Figures of the reports of studies. A study of 2,000 calibrations takes up to hours. It is run once, continues after an
# interruption, and its results stay in RESULTS.
STUDIES = {"study-sixteen-success": ("sixteen", "success")}
RESULTS = ROOT / "build" / "studies"  # ignored by git
BROWSED = {"page-start": False, "page": True}  # pictures of the page, and whether the run has ended


def commanded(lines: list[str], folder: Path) -> None:
    """Run commands of fdcal in a folder; a verdict that is not good is no failure here."""
    for line in lines:
        print("fdcal", line, flush=True)
        run = subprocess.run([sys.executable, "-m", "fdcal", *line.split()], cwd=folder, check=False)
        if run.returncode not in (0, 4):
            raise SystemExit(f"fdcal {line} ended with {run.returncode}")


def browsed(ended: bool, folder: Path) -> None:
    """Take a picture of the page of array 1, before or after a run."""
    sys.path.insert(0, str(ROOT))
    from playwright.sync_api import sync_playwright

    from benchmarks.pages import Served, launch

    with Served("array1_circle", {}) as served, sync_playwright() as playwright:
        browser = launch(playwright)
        page = browser.new_page(viewport=PAGE_SIZE, color_scheme="light")
        page.goto(served.url)
        play = page.locator("#fdcal [data-do=play]")
        play.wait_for(timeout=180e3)
        page.wait_for_timeout(20e3)  # software rendering: the room appears a little after the controls
        page.get_by_role("button", name="Hide this line").click()  # which says that there is no graphics card
        if ended:
            page.get_by_role("button", name="All together").click()
            page.get_by_text("Move all microphones").wait_for()
            play.click()
            page.get_by_text("Converged").filter(visible=True).first.wait_for(timeout=180e3)
            page.wait_for_timeout(10e3)
        page.screenshot(path=str(folder / "picture.png"))
        browser.close()


def studied(study: str, figure: str) -> Path:
    """Run the calibrations that a study still lacks, write its report, and return one of its figures."""
    folder = RESULTS / study
    resumed = ["--resume"] if folder.is_dir() else []
    run = ["study", str(ROOT / "studies" / f"{study}.toml"), "-o", str(folder), *resumed]
    for arguments in (run, ["study", "--report", str(folder)]):
        subprocess.run([sys.executable, "-m", "fdcal", *arguments], cwd=ROOT, check=True)
    return folder / "report" / f"{figure}.png"


def keep(path: Path, target: Path) -> None:
    """Write a picture to the documentation, with fewer colours where it is large."""
    picture = Image.open(path).convert("RGB")
    picture.save(target, optimize=True)
    if target.stat().st_size > LARGEST:
        even = picture.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=4)  # keeps colours of small parts
        picture.quantize(palette=even, dither=Image.Dither.FLOYDSTEINBERG).save(target, optimize=True)
    print(f"{target.relative_to(ROOT)}: {target.stat().st_size / 1000:.0f} kB", flush=True)


def make(name: str) -> None:
    """Make one picture."""
    if name in STUDIES:
        return keep(studied(*STUDIES[name]), PICTURES / f"{name}.png")
    with tempfile.TemporaryDirectory() as folder:
        if name in COMMANDS:
            commanded(COMMANDS[name], Path(folder))
        elif name in EXAMPLES:
            subprocess.run([sys.executable, str(ROOT / "examples" / EXAMPLES[name])], cwd=folder, check=True)
            (Path(folder) / f"{name}.png").rename(Path(folder) / "picture.png")
        else:
            browsed(BROWSED[name], Path(folder))
        keep(Path(folder) / "picture.png", PICTURES / f"{name}.png")


if __name__ == "__main__":
    every = [*COMMANDS, *EXAMPLES, *BROWSED]
    for wanted in sys.argv[1:] or every:
        if wanted not in (*every, *STUDIES):
            raise SystemExit(f"no picture is called {wanted}: give any of {', '.join((*every, *STUDIES))}")
        make(wanted)
