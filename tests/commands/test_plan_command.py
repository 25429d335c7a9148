"""`fdcal plan`: formats, words, and input that is refused in one line."""

import json

import pytest
from running import exit_code

from fdcal.session import plan

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
        (LAYOUT, "--known", "99"),
        (LAYOUT, "--frequencies", "all"),
        (LAYOUT, "--room", "lshape"),
        (LAYOUT, "--gain-sigma", "1"),
        (LAYOUT, "--kind", "speech"),
        (LAYOUT, "-o", "plan.txt"),
    ],
)
def test_bad_input_is_refused_in_one_line(refused, arguments):
    assert refused("plan", *arguments)
