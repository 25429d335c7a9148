"""README.md does what it says: its example runs, its lines are there, and it leads to the documentation."""

import re

import pytest

import fdcal
from benchmarks.documents import README, blocks, text_of

TEXT = text_of(README)


@pytest.mark.parametrize("scored", [True, False], ids=["scene", "own recording"])
def test_python_example_runs_with_and_without_true_positions(capsys, scored):
    (example,) = [block.code for block in blocks(TEXT) if block.language == "python"]
    code = example if scored else example.replace('load("tiny")', 'load("tiny")\nimport dataclasses\n'
        'measurement = dataclasses.replace(measurement, positions=None)')  # fmt: skip
    found: dict = {}
    exec(compile(code, "README.md", "exec"), found)
    modes, verdict = re.fullmatch(r"(\d+) frequencies, verdict (\w+): .+\n", capsys.readouterr().out).groups()
    assert (int(modes), verdict) == (36, "good")
    assert "takes all 36" in TEXT and "asks for 20 frequencies" in " ".join(TEXT.split())
    assert fdcal.load_scene("tiny").solver.modes == 20
    assert (found["found"].mean_error is not None) == scored


def test_its_two_lines_install_and_open_the_page_and_run_the_tests():
    lines = [block.code.strip() for block in blocks(TEXT) if block.language == "sh"]
    assert "python3 -m venv .venv && .venv/bin/pip install -e '.[all]' && .venv/bin/fdcal view" in lines
    assert ".venv/bin/pip install -e '.[test]' -e ./fdcal_bench && .venv/bin/pytest" in lines
