"""A room of three dimensions that would be computed for days is refused at once, as one of two is."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest

from fdcal.acoustics.measure import measure
from fdcal.model.scene_file import load_scene, scene_folder
from fdcal.model.validation import InputError
from fdcal.session.sources import check_scene


@pytest.fixture
def ball():
    return load_scene("ball3d")


@pytest.mark.parametrize("call", [measure, check_scene])
def test_a_duration_of_days_is_refused_at_once(call, ball):
    scene = replace(ball, source=replace(ball.source, duration=1e6))
    began = time.process_time()
    with pytest.raises(InputError, match=r"source\.duration = 1e\+06 s .* use at most [\d.]+ s"):
        call(scene)
    assert time.process_time() - began < 0.1


def test_the_longest_duration_that_is_named_is_accepted(ball):
    with pytest.raises(InputError) as caught:
        check_scene(replace(ball, source=replace(ball.source, duration=1e6)))
    most = float(str(caught.value).split("use at most ")[1].split(" s")[0])
    check_scene(replace(ball, source=replace(ball.source, duration=0.99 * most)))


def test_ten_thousand_microphones_are_refused_at_once(tmp_path):
    text = (scene_folder() / "ball3d.toml").read_text(encoding="utf-8")
    lines = [f"count = {10_000}" if line.startswith("count") else line for line in text.splitlines()]
    path = tmp_path / "many.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    began = time.process_time()
    with pytest.raises(InputError, match="array has 10000 microphones; use at most 2000"):
        load_scene(path)
    assert time.process_time() - began < 0.1
