"""`fdcal plan`: formats, words, and input that is refused in one line."""

import json

import pytest

from fdcal.commands.cli import main

LAYOUT = "rectangle 4x4 0.5x0.5"


def test_a_plan_is_written_in_each_format(tmp_path, capsys):
    for suffix, first in ((".html", b"<!doctype html>"), (".json", b"{"), (".png", b"\x89PNG")):
        path = tmp_path / f"plan{suffix}"
        with pytest.raises(SystemExit) as ended:
            main(["plan", LAYOUT, "--known", "0,3,12", "-o", str(path)])
        assert ended.value.code == 0
        printed = capsys.readouterr().out
        assert path.read_bytes().startswith(first)
    assert json.loads((tmp_path / "plan.json").read_text())["known"] == ["0", "3", "12"]
    assert "Cramer-Rao" in printed
    assert "by tape" in printed


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
        (LAYOUT, "-o", "plan.txt"),
    ],
)
def test_bad_input_is_refused_in_one_line(refused, arguments):
    assert refused("plan", *arguments)


def test_without_trials_the_first_line_says_that_it_is_a_bound_only(capsys):
    for options, said in (([], True), (["--trials", "1", "--solver", "joint"], False)):
        with pytest.raises(SystemExit):
            main(["plan", LAYOUT, "--frequencies", "50:400", *options])
        assert capsys.readouterr().out.startswith("a bound only") == said
