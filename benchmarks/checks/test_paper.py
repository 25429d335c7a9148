"""The paper's figures and table: each command on `tiny`, that the figures show the runs, and that the runs are kept."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import paper
from benchmarks.paper import drawing, study, table
from benchmarks.paper.__main__ import main
from fdcal.model.scene import load_scene
from fdcal.model.validation import InputError
from fdcal.session.sources import scene_input


def silent(done: float, note: str = "") -> None:
    """No progress."""


@pytest.fixture(scope="module")
def array() -> study.Array:
    return paper.array_of(scene_input(load_scene("tiny")), 1, True)


@pytest.fixture(scope="module")
def run(array) -> study.Trail:
    (only,) = study.descents(array, 1, silent)
    return only


def ended(*arguments) -> int:
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    return end.value.code or 0


@pytest.fixture(scope="module")
def folder(tmp_path_factory, run) -> Path:
    """All that the command writes of `tiny`."""
    out = tmp_path_factory.mktemp("paper") / "figures"
    assert ended("--scene", "tiny", "--quick", "--seeds", 1, "-o", out) == 0
    return out


def test_all_figures_and_the_table_are_written(folder):
    names = {f"fig{n}.{suffix}" for n in range(1, 6) for suffix in ("png", "svg")} | {"table.md", "table.csv"}
    assert {file.name for file in folder.iterdir()} == names
    for n in range(1, 6):
        assert (folder / f"fig{n}.png").read_bytes().startswith(b"\x89PNG")
        assert b"<svg" in (folder / f"fig{n}.svg").read_bytes()


def test_a_figure_alone_is_the_same_again(folder, tmp_path, capsys):
    options = ("--scene", "tiny", "--quick", "--seeds", 1, "-o", tmp_path)
    assert ended("--figure", 3, *options) == 0
    assert sorted(file.name for file in tmp_path.iterdir()) == ["fig3.png", "fig3.svg"]
    assert (tmp_path / "fig3.svg").read_bytes() == (folder / "fig3.svg").read_bytes()
    assert capsys.readouterr().out.split() == [str(tmp_path / f"fig3.{suffix}") for suffix in ("png", "svg")]


def test_the_table_holds_the_results_of_the_runs(folder, array, run):
    rows = {row["solver"]: row for row in csv.DictReader((folder / "table.csv").open())}
    assert list(rows) == ["descent", "joint"], "the paper does not contain tiny"
    assert float(rows["descent"]["mean_error_m"]) == pytest.approx(study.mean_error(array, run.positions[-1]))
    assert (rows["descent"]["exact"], rows["descent"]["modes_needed"]) == ("0", ""), "its grid of 2 cm limits it"
    needed = int(rows["joint"]["modes_needed"])
    frequency = array.problem.frequencies[needed - 1]
    assert (rows["joint"]["exact"], float(rows["joint"]["highest_hz"])) == ("1", pytest.approx(frequency))
    text = (folder / "table.md").read_text()
    assert "| tiny | paper | descent | joint |" in text
    assert f"not reached with {array.modes}" in text


@pytest.mark.parametrize("name", paper.ARRAYS)
def test_what_the_paper_prints_stands_beside_ours(name, array):
    printed = paper.study.PRINTED[name]
    ours = study.Outcome("descent", None, 57, 274.3, 0, 3, 3, 0.046, 329.5, 157.3)
    text = table.markdown([replace(array, name=name)], [(ours,)])
    assert f"| frequencies needed for exact positions | {printed.modes} | not reached with 57 |" in text
    assert f"| highest frequency | {printed.highest:.0f} Hz | 274 Hz |" in text
    assert "| 330 |" in text and "| 160 s |" in text, "no half sweeps, no exponents"
    assert "| exact, of 3 seeds | not stated; one run shown | 0; 3 within 5 cm |" in text
    rows = list(csv.DictReader(table.comma_separated([replace(array, name=name)], [(ours,)]).splitlines()))
    assert [(row["solver"], row["modes_needed"]) for row in rows] == [("paper", str(printed.modes)), ("descent", "")]


def test_fewer_modes_are_the_beginning_of_the_same_run(array, run):
    few = study.shortened(array.inputs.settings, "descent", 8)
    short = study.trail(array.problem, few, 0, lambda done: None)
    assert np.array_equal(short.positions, run.positions[: run.end_of(8) + 1])
    assert short.modes[-1] == 8


def test_a_run_is_made_once(array, run):
    calls = []
    (again,) = study.descents(array, 1, lambda done, note: calls.append(done))
    assert np.array_equal(again.positions, run.positions)
    assert not calls, "nothing is computed"


def test_fig_2_and_3_show_the_run(array, run):
    (panel,) = drawing.draw_states([array], [run]).axes
    marks = {line.get_label(): line.get_xydata() for line in panel.lines}
    sweep = drawing.iteration_of(array, run)
    assert 0 < sweep < run.sweeps
    assert np.array_equal(marks["estimated"], run.positions[sweep])
    assert np.array_equal(marks["true"], array.measurement.positions)
    (panel,) = drawing.draw_iterations([array], [run]).axes
    errors = np.linalg.norm(run.positions - array.measurement.positions, axis=2).mean(axis=1)
    assert np.allclose(panel.lines[0].get_ydata(), errors)
    dashes = panel.collections[0].get_segments()
    assert len(dashes) == array.modes - run.modes[0], "one for every mode that is added"


def test_fig_4_and_5_show_the_run(array, run):
    (panel,) = drawing.draw_modes([array], [run], [([4, 16], [0.02, 0.001])]).axes
    lines = {line.get_label(): line.get_xydata() for line in panel.lines}
    assert lines["descent"][:, 0].tolist() == list(range(int(run.modes[0]), array.modes + 1))
    assert lines["descent"][-1, 1] == pytest.approx(study.mean_error(array, run.positions[-1]))
    assert lines["joint"].tolist() == [[4, 0.02], [16, 0.001]]
    (panel,) = drawing.draw_distances(array, run).axes
    lines = {line.get_label(): line.get_xydata() for line in panel.lines}
    assert len(lines["unknown"]) == len(array.problem.free)
    assert np.allclose(lines["known"][:, 1], 0)
    assert 0 in lines["known"][:, 0], "the reference itself"


def test_impossible_options_are_refused(folder, tmp_path, capsys):
    file = tmp_path / "file"
    file.touch()
    for arguments, code, words in (
        (("--scene", "tiny", "-o", folder), 2, "--force"),
        (("-o", file), 2, "is a file; name a folder"),
        (("-o", tmp_path / "no" / "folder"), 3, "does not exist"),
        (("--scene", "tiny", "--seeds", 0, "-o", tmp_path / "a"), 2, "--seeds 0"),
        (("--figure", 6, "-o", tmp_path / "a"), 2, "6 is not in the range"),
    ):
        assert ended(*arguments) == code, arguments
        errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
        assert len(errors) == 1
        assert words in errors[0]
    assert not (tmp_path / "a").exists()


def test_an_array_that_descent_cannot_search_is_refused(array):
    unbounded = replace(array.inputs, measurement=replace(array.measurement, search=None))
    with pytest.raises(InputError, match="tiny has no search domain"):
        paper.array_of(unbounded, 1, True)
