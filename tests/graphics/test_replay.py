"""The replay: its numbers are those of the run, it is one file that loads nothing else, and it plays in a browser."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from replays import Reader, contents

import fdcal
from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.commands.cli import main
from fdcal.cost.reference_cost import ReferenceCost
from fdcal.graphics.replay import MAX_BYTES, replay_html
from fdcal.model.gauge import position_errors
from fdcal.model.measurement import Measurement
from fdcal.model.measurement_file import save_measurement
from fdcal.model.scene_file import load_scene, scene_folder

EVIL = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"


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
    reference_cost = ReferenceCost(measurement.problem())
    text = replay_html(scene, measurement, states, "Tiny", reference_cost)
    data, arrays, positions = contents(text)
    expected = np.array([state.positions for state in states])
    assert np.abs(positions - expected).max() < 1e-8
    np.testing.assert_allclose(arrays["truth"] + data["origin"], measurement.positions, atol=1e-12)
    free = measurement.problem().free
    errors = np.array([position_errors(places, measurement.positions)[free] for places in expected])
    np.testing.assert_allclose(arrays["mean"], errors.mean(axis=1), rtol=1e-12)
    assert np.array_equal(arrays["largest"], errors.max(axis=1))
    assert np.array_equal(arrays["cost"], [reference_cost(state.positions) for state in states])
    for name in ("step", "sweep", "stage", "moved", "first", "last"):
        assert np.array_equal(arrays[name], [getattr(state, name) for state in states])
    np.testing.assert_allclose(data["given"], measurement.known_positions, atol=1e-6)
    assert data["known"] == measurement.known.tolist() and data["names"] == list(measurement.names)
    assert np.array_equal(data["outline"], scene.room.vertices) and Reader(text).texts["title"] == "Tiny"


def test_the_page_asks_for_nothing(run):
    text = replay_html(*run, "Tiny", problem=run[1].problem())
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
    assert page.texts["title"] == EVIL and contents(text)[0]["names"][0] == EVIL
    assert EVIL not in text


def test_without_truth_and_room(run):
    _, measurement, states = run
    blind = dataclasses.replace(measurement, positions=None)
    data, arrays, _ = contents(replay_html(None, blind, states, "Blind"))
    assert not {"truth", "mean", "largest"} & set(arrays) and data["outline"] is data["maps"] is None


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
    data, arrays, _ = contents(text)
    steps = arrays["step"]
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
        main(["replay", "tiny", "--solver", "joint", "--microphone", "9", "-o", str(path)])
    assert not left.value.code, capsys.readouterr().err
    data, arrays, _ = contents(path.read_text(encoding="utf-8"))
    said = capsys.readouterr().out
    assert f"{data['count']} states of joint" in said and data["count"] > 5 and data["microphone"] == 9
    assert f"{path.stat().st_size / 1e6:.2g} MB" in said and path.stat().st_size < 100_000
    assert arrays["mean"][-1] < 2e-3


def test_the_replay_of_a_solver_that_is_given_nothing_has_the_errors_of_calibrate(tmp_path):
    """The scene has known microphones, and its solver gets none: errors are those after alignment."""
    text, path = (scene_folder() / "tiny.toml").read_text(encoding="utf-8"), tmp_path / "given_none.toml"
    path.write_text(text.replace('name = "robust"', 'name = "joint"\nknown = "none"'), encoding="utf-8")
    scene = load_scene(path)
    with pytest.raises(SystemExit) as left:
        main(["replay", str(path), "-o", str(tmp_path / "run.html")])
    assert not left.value.code
    data, arrays, _ = contents((tmp_path / "run.html").read_text(encoding="utf-8"))
    found = fdcal.calibrate(cached_measurement(scene), settings=scene.solver)
    assert data["aligned"] and data["known"] == []
    assert arrays["mean"][-1] == pytest.approx(found.mean_error, rel=1e-3) and found.mean_error < 2e-3


@pytest.mark.parametrize("known", [True, False])
def test_a_measurement_without_search_domain_has_maps_too(known, run, tmp_path):
    """Round the estimate; that of a blind array is moved onto the true positions with it."""
    measurement = dataclasses.replace(run[1], search=None)
    if not known:
        measurement = dataclasses.replace(measurement, known=(), known_positions=None)
    save_measurement(measurement, tmp_path / "hall.npz")
    with pytest.raises(SystemExit) as left:
        main(["replay", str(tmp_path / "hall.npz"), "-o", str(tmp_path / "hall.html")])
    assert not left.value.code
    data, arrays, positions = contents((tmp_path / "hall.html").read_text(encoding="utf-8"))
    assert data["maps"]["modes"] and np.isfinite(arrays["cost"]).all()
    low = np.array(data["maps"]["origin"])
    high = low + data["maps"]["step"] * np.array(data["maps"]["shape"])
    assert ((low < positions[-1]) & (positions[-1] < high)).all()
