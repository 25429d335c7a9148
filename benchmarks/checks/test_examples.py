"""Every script in examples/ runs and finds what it says, and so does the notebook."""

import ast
import json
import re
import runpy
import sys
from pathlib import Path

import pytest

import fdcal

EXAMPLES = Path(__file__).parents[2] / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
NOTEBOOK = EXAMPLES / "first_calibration.ipynb"
SLOW = ("01", "04")  # these take another scene than the paper's, which take ten seconds to simulate


def printed(script: Path, tmp_path, monkeypatch, capsys) -> str:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(script), *["tiny"][: script.name.startswith(SLOW)]])
    runpy.run_path(str(script), run_name="__main__")
    return capsys.readouterr().out


# What each script must print, the most that a number in it may be, and the files that it writes.
EXPECTED = {
    "01_paper_array": (r"mean error ([\d.]+) mm", 5.0, {"array.png", "array.json"}),
    "02_recording_from_wav": (r"largest error ([\d.]+) mm", 10.0, {"recording.wav", "microphones.xml"}),
    "03_blind_in_space": (r"mean error ([\d.]+) mm after the best rigid motion: True", 6.0, {"ball.csv", "ball.png"}),
    "04_landscape_of_one_microphone": (r"frequency all: minimum ([\d.]+) m", 0.05, {"landscape.png"}),
    "05_check_channel_order": (r"channels (3) and 12 are swapped", 3.0, {"geometry.xml"}),
    "06_scene_of_your_own": (r"12 frequencies: good +mean error +([\d.]+) mm", 5.0, set()),
    "07_measured_array": (
        r"4 takes, \d+ frequencies; verdict \w+\nRMS distance to the nominal positions ([\d.]+) mm",
        6.0,
        {"array.xml", "measured-array.png"},
    ),
    "08_beamforming_map": (r"after: differs from the map of the true array by ([\d.]+) %", 10.0, {"beamforming.png"}),
    "09_gains_of_capsules": (r"gain: spread 1\.\d dB, found to ([\d.]+) dB RMS", 0.5, {"gains.csv", "calib.xml"}),
    "10_which_of_two_layouts": (r"rectangle .* least error ([\d.]+) mm, up to \d+ Hz\nball", 5.0, set()),
}


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_an_example_runs_and_finds_what_it_says(script, tmp_path, monkeypatch, capsys):
    pattern, most, written = EXPECTED[script.stem]
    for name in written:
        (tmp_path / name).write_text("of an earlier run")
    text = printed(script, tmp_path, monkeypatch, capsys)
    match = re.search(pattern, text)
    assert match is not None, text
    assert float(match.group(1)) <= most
    assert {path.name for path in tmp_path.iterdir()} == written
    assert all(path.read_bytes() != b"of an earlier run" for path in tmp_path.iterdir()), "it can be run again"


def cells(kind: str) -> list[str]:
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert (notebook["nbformat"], len({cell["id"] for cell in notebook["cells"]})) == (4, len(notebook["cells"]))
    return ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == kind]


def shown(source: str, namespace: dict) -> object:
    """Run a cell, and return what a notebook shows below it: the value of its last line, if that is an expression."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), namespace)
    return None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), namespace)


def test_the_cells_of_the_notebook_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    namespace: dict = {}
    outputs = [shown(source, namespace) for source in cells("code")]
    assert isinstance(outputs[1], fdcal.Calibration)
    assert "<b>good</b>" in outputs[1]._repr_html_()
    assert "<iframe srcdoc=" in outputs[2]._repr_html_()
    assert len(outputs[3]) == 3
    assert outputs[4].shape == (4, 2)


def test_the_notebook_holds_no_output():
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert all(not cell.get("outputs") for cell in notebook["cells"])
