"""The replay: its numbers are those of the run, it is one file that loads nothing else, and it plays in a browser."""

from __future__ import annotations

import base64
import dataclasses
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from fdcal import solvers
from fdcal.acoustics.measurement_cache import cached_measurement
from fdcal.commands.cli import main
from fdcal.cost.yardstick import Yardstick
from fdcal.graphics.replay import MAX_BYTES, replay_html
from fdcal.model.gauge import position_errors
from fdcal.model.measurement import Measurement
from fdcal.model.scene_file import load_scene

EVIL = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"


class Reader(HTMLParser):
    """Title, tags, attributes and the text of the data element of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.given, self.texts, self._open = [], [], {}, ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.given += attributes
        self._open = dict(attributes).get("id", tag) if tag in ("script", "title", "style") else ""

    def handle_endtag(self, tag):
        self._open = ""

    def handle_data(self, text):
        if self._open:
            self.texts[self._open] = self.texts.get(self._open, "") + text


def numbers(text, dtype):
    return np.frombuffer(base64.b64decode(text), dtype)


@pytest.fixture(scope="module")
def run():
    """Scene, measurement and the first states of descent on `tiny`."""
    scene = load_scene("tiny")
    measurement = cached_measurement(scene)
    problem, descent = measurement.problem(), solvers.load("descent")
    states = [descent.init(problem, dataclasses.replace(scene.solver, name="descent"), 0)]
    while len(states) < 60:
        states.append(descent.step(problem, states[-1]))
    return scene, measurement, states


def test_the_numbers_are_those_of_the_run(run):
    scene, measurement, states = run
    yardstick = Yardstick(measurement.problem())
    page = Reader(replay_html(scene, measurement, states, "Tiny", yardstick))
    data = json.loads(page.texts["data"])
    positions = numbers(data["positions"], "<f4").reshape(60, 16, 2) + np.array(data["origin"])
    expected = np.array([state.positions for state in states])
    assert np.abs(positions - expected).max() < 1e-6
    truth = numbers(data["truth"], "<f4").reshape(16, 2) + np.array(data["origin"])
    assert np.abs(truth - measurement.positions).max() < 1e-6
    free = measurement.problem().free
    errors = np.array([position_errors(places, measurement.positions)[free] for places in expected])
    np.testing.assert_allclose(numbers(data["mean"], "<f8"), errors.mean(axis=1), rtol=1e-12)
    assert np.array_equal(numbers(data["largest"], "<f8"), errors.max(axis=1))
    assert np.array_equal(numbers(data["cost"], "<f8"), [yardstick(state.positions) for state in states])
    for name in ("step", "sweep", "stage", "moved", "first", "last"):
        assert np.array_equal(numbers(data[name], "<i4"), [getattr(state, name) for state in states])
    assert data["known"] == measurement.known.tolist() and data["names"] == list(measurement.names)
    assert np.array_equal(data["outline"], scene.room.vertices) and page.texts["title"] == "Tiny"


def test_the_page_asks_for_nothing(run):
    text = replay_html(*run, "Tiny")
    page = Reader(text)
    assert not {"link", "img", "iframe", "object", "embed"} & set(page.tags)
    assert not {"src", "href", "action"} & {name for name, _ in page.given}
    policy = dict(page.given)["content"]
    assert "default-src 'none'" in policy and "http" not in policy
    assert not re.search(r"https?:|fetch\(|XMLHttpRequest|import\(|url\(", text)


def test_names_and_title_stay_texts(run):
    scene, measurement, states = run
    named = dataclasses.replace(measurement, names=(EVIL, *measurement.names[1:]))
    text = replay_html(scene, named, states, EVIL)
    page = Reader(text)
    assert page.tags.count("script") == 2 and "img" not in page.tags
    assert page.texts["title"] == EVIL and json.loads(page.texts["data"])["names"][0] == EVIL
    assert EVIL not in text


def test_without_truth_and_room(run):
    _, measurement, states = run
    blind = dataclasses.replace(measurement, positions=None)
    data = json.loads(Reader(replay_html(None, blind, states, "Blind")).texts["data"])
    assert data["truth"] is data["mean"] is data["outline"] is None


def test_no_replay_is_larger_than_an_email_attachment_may_be():
    """Of many microphones and states some are left out, the first and the last never."""
    count, rng = 600, np.random.default_rng(0)
    truth = rng.uniform(0, 3, (count, 3))
    pressures = rng.normal(size=(2, count)) + 1j * rng.normal(size=(2, count))
    measurement = Measurement([100.0, 150.0], pressures, 343.0, 3, positions=truth, known=[0, 1, 2, 3])
    fields = ("positions", "cost", "step", "sweep", "stage", "moved", "first", "last")
    State = dataclasses.make_dataclass("State", fields)
    states = [State(truth + rng.normal(size=truth.shape), 1.0, i, i, 0, -1, 1, 2) for i in range(3000)]
    text = replay_html(None, measurement, states, "Large")
    data = json.loads(Reader(text).texts["data"])
    steps = numbers(data["step"], "<i4")
    assert 0.8 * MAX_BYTES < len(text) < 5e6 and data["taken"] == 3000
    assert (steps[0], steps[-1]) == (0, 2999) and data["count"] == len(steps) > 400 and (np.diff(steps) > 0).all()


def test_it_plays_in_a_browser_without_a_network(run, browser, tmp_path):
    scene, measurement, states = run
    path = tmp_path / "replay.html"
    path.write_text(replay_html(scene, measurement, states, EVIL), encoding="utf-8")
    faults = []
    page = browser.new_context(offline=True, viewport={"width": 1280, "height": 720}).new_page()
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("console", lambda message: faults.append(message.text))
    page.on("dialog", lambda dialog: (faults.append(dialog.message), dialog.dismiss()))
    page.goto(path.as_uri())
    page.get_by_text("step 0, sweep 0, stage 1; modes 1 to ").wait_for()
    page.keyboard.press("End")
    last = states[-1]
    page.get_by_text(f"step {last.step}, sweep {last.sweep}, stage {last.stage + 1}; ").wait_for()
    mean = 1e3 * position_errors(last.positions, measurement.positions)[measurement.problem().free].mean()
    assert f"mean {mean:.3g} mm" in page.locator("#errors").inner_text()
    drawn = [page.locator("#view").screenshot() for _ in range(2)]
    page.get_by_role("button", name="3-D").click()
    drawn.append(page.locator("#view").screenshot())
    page.get_by_role("button", name="Dark").click()
    drawn.append(page.locator("#view").screenshot())
    assert drawn[0] == drawn[1] and len(set(drawn)) == 3, "turned, then dark"
    page.keyboard.press("Home")
    page.get_by_label("Speed").select_option("50")
    page.get_by_role("button", name="Play").click()
    page.get_by_role("button", name="Pause").wait_for()
    page.get_by_text(f"step {last.step}, sweep {last.sweep}, ").wait_for()
    page.get_by_role("button", name="Play").wait_for()
    page.context.close()
    assert not faults


def test_the_command_writes_a_run(tmp_path, capsys):
    path = tmp_path / "run.html"
    with pytest.raises(SystemExit) as left:
        main(["replay", "tiny", "-o", str(path)])
    assert not left.value.code, capsys.readouterr().err
    data = json.loads(Reader(path.read_text(encoding="utf-8")).texts["data"])
    assert f"{data['count']} states of joint" in capsys.readouterr().out and data["count"] > 5
    assert numbers(data["mean"], "<f8")[-1] < 2e-3
