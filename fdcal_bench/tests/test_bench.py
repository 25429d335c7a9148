"""The benchmark fdcal_bench: cases, scores and its table."""

import dataclasses
import runpy
import sys
import types
from pathlib import Path

import click
import numpy as np
import pytest

import fdcal_bench
from fdcal_bench import scores
from fdcal_bench.__main__ import DRAWS
from fdcal_bench.__main__ import run as run_command
from fdcal_bench.cases import FAMILIES, MEASURED, NAMES, measured_array
from fdcal_bench.methods import REFERENCE_METHODS, tape_error

FOLDER = Path(fdcal_bench.__file__).parent


def main(arguments):
    run_command(arguments, standalone_mode=False)


def turned(truth, error=0.0):
    """The true array, turned, mirrored and moved, with an error of each coordinate."""
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    return (truth + error * np.random.default_rng(2).standard_normal(truth.shape)) @ turn * [1, 1, -1] + [3, 2, 1]


def test_the_axes_of_a_method_do_not_count_and_its_errors_do():
    case = measured_array()
    exact = fdcal_bench.score(case, lambda recordings, rate, **_: (turned(case.truth), None), "exact")
    assert exact.error_mm < 1e-9 and np.isnan(exact.claim_mm)
    rough = fdcal_bench.score(case, lambda *_, **__: (turned(case.truth, 1e-3), np.full(7, 2e-3)), "rough")
    assert 0.5 < rough.error_mm < 2.5 and rough.claim_mm == pytest.approx(2)


def test_a_method_gets_recordings_rate_and_what_is_known_and_must_return_all_positions():
    case = measured_array()

    def method(recordings, rate, *, kind, speed, sources):
        assert [one.shape for one in recordings] == [(7, 7200)] * 4
        assert (rate, kind, sources) == (8000, "impulse", None) and 330 < speed < 350
        recordings[0][:] = 0  # its own copy
        return case.truth[:6], None

    with pytest.raises(ValueError, match=r"\(6, 3\)"):
        fdcal_bench.score(case, method, "short")
    assert np.any(case.recordings[0])


def test_a_simulated_case_is_the_same_each_time():
    first, again = (FAMILIES[-1].draw(0) for _ in range(2))
    assert np.array_equal(first.truth, again.truth) and first.truth.shape == (8, 3)
    for one, other in zip(first.recordings, again.recordings, strict=True):
        assert np.array_equal(one, other)
    assert np.linalg.norm(first.sources - first.truth.mean(axis=0), axis=1).min() > 1


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_error_of_a_tape_measure_is_the_mean_of_many_draws(dimension):
    rng, N = np.random.default_rng(3), 9
    truth = rng.uniform(-0.4, 0.4, (N, dimension))
    drawn = [scores.error_mm(truth + 0.005 * rng.standard_normal(truth.shape), truth) for _ in range(4000)]
    case = dataclasses.replace(measured_array(), truth=truth)
    assert tape_error(case) == pytest.approx(np.sqrt(np.mean(np.square(drawn))), rel=0.02)


def test_the_table_has_medians_and_failures_of_equal_draws():
    case = measured_array()
    size = scores.scored(case, "", 0.0).size_mm
    errors = {"a": [1.0, 2.0, 0.4 * size, 0.6 * size, 2.5], "b": [np.nan, 3.0, 1.0, np.nan, np.nan], "c": [np.nan] * 5}
    rows = [scores.scored(dataclasses.replace(case, draw=n), name, error, 4.0, 2.0)
            for name, column in errors.items() for n, error in enumerate(column)]  # fmt: skip
    assert [sum(row.failed for row in rows if row.method == name) for name in errors] == [1, 3, 5]
    head, _, row, last = scores.table(rows).splitlines()
    assert head == "| case | draws | a | b | c |"
    assert row == f"| {MEASURED} | 5 | 2.5 (claims 4.0), 1 failed | inf (claims 4.0), 3 failed |  |"
    assert last == "| all: seconds | | 2 | 2 | 2 |"


def test_the_command_prints_a_users_method_beside_the_reference_on_the_same_draws(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "mine.py").write_text(
        "def lost(recordings, rate, **known):\n    return None, None\n"
        "def point(recordings, rate, **known):\n    return [[0.0] * 3] * len(recordings[0]), None\n"
    )
    main(["mine:lost", "--only", "laboratory"])
    head, _, row, last = capsys.readouterr().out.splitlines()[-4:]
    assert head.startswith("| case | draws | mine:lost | ") and "fdcal" in head
    assert row.startswith(f"| {MEASURED} | 1 |  | ") and last.startswith("| all: seconds | | ")
    name = FAMILIES[-1].name
    main(["mine:point", "--only", name, "--draws", "2"])
    row = capsys.readouterr().out.splitlines()[-2]
    assert row.startswith(f"| {name} | 2 | ") and ", 2 failed |" in row
    fdcal = [one.error_mm for one in scores.read_reference() if (one.case, one.method) == (name, "fdcal")]
    assert f"| {np.median(fdcal[:2]):.1f} (claims" in row and f"| {np.median(fdcal):.1f} (claims" not in row
    main(["--only", name])
    assert f"| {name} | {DRAWS} | " in (shown := capsys.readouterr().out) and f"| {np.median(fdcal):.1f} (cl" in shown
    for wrong in ("mine:other", ":other", "./mine:lost"):
        with pytest.raises(SystemExit, match="no function"):
            main([wrong])
    for wrong in (["--draws", str(DRAWS + 1)], ["--only", "nowhere"]):
        with pytest.raises(click.BadParameter):
            main(["mine:lost", *wrong])


def test_the_reference_has_every_method_on_every_draw_of_every_case():
    found = {(one.case, one.draw, one.method) for one in scores.read_reference()}
    methods = ("bound", "tape measure", *REFERENCE_METHODS)
    draws = [(case, draw) for case in NAMES for draw in range(1 if case == MEASURED else DRAWS)]
    assert found == {(*one, method) for one in draws for method in methods}


def test_the_measured_array_is_part_of_both_distributions(tmp_path, monkeypatch):
    """A source distribution takes it from the examples of the checkout, a wheel from the source distribution."""
    interface = types.SimpleNamespace(BuildHookInterface=object)
    monkeypatch.setitem(sys.modules, "hatchling.builders.hooks.plugin.interface", interface)
    hook = runpy.run_path(str(FOLDER / "hatch_build.py"))["MeasuredArray"]()
    (tmp_path / "frl_array").mkdir()
    for root, data in ((FOLDER, FOLDER.parent / "examples" / "frl_array"), (tmp_path, tmp_path / "frl_array")):
        hook.root, included = str(root), {"force_include": {}}
        hook.initialize("standard", included)
        assert included["force_include"] == {str(data): "frl_array"} and data.is_dir()
