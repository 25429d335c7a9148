"""`fdcal plan` and `fdcal study`: formats, words, and input that is refused in one line."""

import json
import sys

import pytest
from running import exit_code

from fdcal.session import plan
from fdcal.session.study import load_study
from fdcal.session.study.rows import run_task
from fdcal.session.study.run import Results

LAYOUT = "rectangle 4x4 0.5x0.5"


def test_a_plan_is_written_in_each_format(tmp_path, capsys, monkeypatch):
    made, make = [], plan.make_plan  # one plan, in three formats

    def make_once(request, **others):
        made.extend([] if made else [make(request, **others)])
        return made[0]

    monkeypatch.setattr(plan, "make_plan", make_once)
    for suffix, first in ((".html", b"<!doctype html>"), (".json", b"{"), (".png", b"\x89PNG")):
        path = tmp_path / f"plan{suffix}"
        assert exit_code("plan", LAYOUT, "--known", "0,3,12", "-o", path) == 0
        printed = capsys.readouterr().out
        assert path.read_bytes().startswith(first)
    assert json.loads((tmp_path / "plan.json").read_text())["known"] == ["0", "3", "12"]
    assert "Cramer-Rao" in printed
    assert "places of the source" in printed


@pytest.mark.parametrize(
    "arguments",
    [
        ("nothing",),
        ("circle 3 0.2",),
        (LAYOUT, "--known", "99"),
        (LAYOUT, "--frequencies", "300:20"),
        (LAYOUT, "--frequencies", "all"),
        (LAYOUT, "--frequencies", "5000:6000"),
        (LAYOUT, "--known-sigma", "5mm"),
        ("circle 8 0.2", "--known", "0,1,2,3,4,5,6,7"),
        (LAYOUT, "--rt60", "-1"),
        (LAYOUT, "--snr", "inf"),
        (LAYOUT, "--room", "lshape"),
        (LAYOUT, "--room", "0.4x4x3"),
        (LAYOUT, "--gain-sigma", "1"),
        (LAYOUT, "--kind", "impulse"),
        (LAYOUT, "--kind", "speech"),
        (LAYOUT, "-o", "plan.txt"),
    ],
)
def test_bad_input_is_refused_in_one_line(refused, arguments):
    assert refused("plan", *arguments)


# `fdcal study`: what is refused says so in one line, before anything that it would need.


def refusal(capsys, *arguments: str) -> str:
    assert exit_code("study", *arguments) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    return line


def test_a_report_of_no_folder_is_refused_whether_or_not_dask_is_installed(capsys, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    assert "nothing is no folder" in refusal(capsys, "--report", str(tmp_path / "nothing"))


def test_a_file_that_is_no_study_is_named_once(capsys, tmp_path):
    (tmp_path / "bad2.toml").write_text("= 3")
    line = refusal(capsys, str(tmp_path / "bad2.toml"), "--dry-run")
    assert line.count("bad2.toml") == 1 and "is not valid TOML" in line


def test_what_to_install_is_named_for_a_checkout_too(capsys, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    line = refusal(capsys, "--report", str(tmp_path))
    assert "pip install -e '.[study]' in a checkout" in line


def test_a_page_of_a_study_of_axes_is_refused_before_anything_is_written(tmp_path, monkeypatch, capsys):
    """Its statistics hold for independent draws only."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text('scene = "tiny"\ndraws = 1\n[axes]\nsnr_db = [20, 40]\n')
    study, results = load_study("mine.toml"), Results("found", load_study("mine.toml"), False)
    results.append([run_task(study, number) for number in range(2)])
    line = refusal(capsys, "--report", "found", "--page", "page.md")
    assert line.endswith("a page is of a study of settings; use --report without --page")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["found", "mine.toml"]
