"""The yardstick fdcal_bench: cases, scores and its table."""

import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import fdcal_bench
from fdcal_bench import scores
from fdcal_bench.__main__ import main
from fdcal_bench.cases import FAMILIES, MEASURED, NAMES, measured_array
from fdcal_bench.methods import REFERENCE_METHODS

FOLDER = Path(fdcal_bench.__file__).parent


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


def test_the_command_prints_a_method_of_ones_own_beside_the_reference(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "mine.py").write_text("def lost(recordings, rate, **known):\n    return None\n")
    main(["mine:lost", "--only", "laboratory"])
    head, _, row, last = capsys.readouterr().out.splitlines()[-4:]
    assert head.startswith("| case | mine:lost | ") and "fdcal" in head
    assert row.startswith(f"| {MEASURED} |  | ") and last.startswith("| all: seconds |")
    with pytest.raises(SystemExit, match="no function"):
        main(["mine:other"])


def test_the_reference_has_every_method_on_every_case():
    found = {(one.case, one.method) for one in scores.read_reference()}
    assert found == {(case, method) for case in NAMES for method in ("bound", "tape measure", *REFERENCE_METHODS)}


def test_every_module_is_part_of_the_wheel():
    listed = tomllib.loads((FOLDER / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert set(listed["only-include"]) == {*(path.name for path in FOLDER.glob("*.py")), scores.REFERENCE.name}
