"""Each command, run on `tiny` as a user would, and the reaction to each kind of bad input."""

import json
import re
import runpy
import socket
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from running import done, exit_code

from fdcal.commands import cli
from fdcal.cost.eq7 import ReferenceCost
from fdcal.graphics.heatmap import to_rgb
from fdcal.graphics.marks import ESTIMATE
from fdcal.model.measurement import load_measurement
from fdcal.model.problem import ChannelCorrection
from fdcal.model.scene import folder_of, load_scene

pytestmark = pytest.mark.usefixtures("remembered_runs")

PNG = b"\x89PNG"


def test_the_files_hold_all_of_the_measurement_and_of_the_result(made, tmp_path, capsys):
    measurement, scene = load_measurement(made / "tiny.npz"), load_scene("tiny")
    assert measurement.count == 16 and measurement.positions.shape == (16, 2)
    assert len(measurement.frequencies) >= scene.solver.modes and measurement.search == scene.search
    assert measurement.known.tolist() == list(scene.gauge.known)
    result = json.loads((made / "result.json").read_text())
    assert np.shape(result["positions"]) == (16, 2)
    assert (result["solver"], result["seed"], len(result["frequencies"])) == ("robust", 1, 12)
    assert 0 <= result["mean_error_m"] <= result["max_error_m"]
    corrected = np.array(result["positions"])[measurement.known] - measurement.known_positions
    assert 0 < np.abs(corrected).max() < 1e-3, "given positions are uncertain, and here they are right"
    options = ("--modes", 12, "--seed", 1, "--time-limit", 60)  # a run with a time limit is not reused
    assert exit_code("calibrate", "tiny", *options, "-o", tmp_path / "again.json") == 0
    printed = capsys.readouterr()
    assert "13 of 16 microphones" in printed.out and printed.err == ""
    assert json.loads((tmp_path / "again.json").read_text())["positions"] == result["positions"]


@pytest.fixture
def calibrated(made, tmp_path, monkeypatch, capsys):
    """Function that calibrates tiny's file, or another, with options, in this process: summary and result."""
    monkeypatch.chdir(tmp_path)

    def run(*options, path=made / "tiny.npz") -> tuple[str, dict]:
        assert exit_code("calibrate", path, "--modes", "14", "-o", "r.json", "--force", *map(str, options)) in (0, 4)
        return capsys.readouterr().out, json.loads((tmp_path / "r.json").read_text())

    return run


def test_the_printed_cost_is_that_of_the_page(calibrated, made):
    """It is Eq. 7 over all modes in decibels, whatever the solver minimises."""
    cost = ReferenceCost(load_measurement(made / "tiny.npz").problem())
    out, result = calibrated()
    shown = float(re.search(r"^cost +(-[\d.]+) dB", out, re.MULTILINE)[1])
    gains = 10 ** (np.array(result["channel_gain_db"]) / 20) * np.exp(1j * np.radians(result["channel_phase_deg"]))
    channels = ChannelCorrection(gains, 10 ** (np.array(result["channel_noise_db"]) / 10))
    assert shown == pytest.approx(cost(np.array(result["positions"]), channels), abs=0.2)


@pytest.mark.parametrize(("known", "aligned"), [("minimal", False), ("none", True)])
def test_without_given_positions_the_array_is_found_within_two_millimetres(calibrated, known, aligned):
    out, result = calibrated("--solver", "joint", "--known", known)
    assert result["aligned"] is aligned and "16 of 16 microphones" in out
    assert ("moved as a whole onto the true positions" in out) is aligned
    assert result["mean_error_m"] < 2e-3


def test_noise_is_estimated_where_none_is_reported_and_where_the_pressures_contradict_what_is_stated(
    calibrated, altered
):
    estimated, stated = (calibrated("--noise", snr)[1] for snr in ("auto", "3"))
    assert calibrated("--noise", "reported", path=altered(noise_power=None))[1]["positions"] == estimated["positions"]
    assert np.abs(np.subtract(stated["positions"], estimated["positions"])).max() < 2e-5
    assert stated["uncertainty_m"] == pytest.approx(estimated["uncertainty_m"], rel=0.05)


def test_a_solver_that_searches_a_domain_gets_one_around_an_estimate(calibrated, altered):
    bare = altered(**dict.fromkeys(("search_origin", "search_size", "search_step", "radius")))
    _, result = calibrated("--solver", "joint", "--start", "random", path=bare)
    assert result["solver"] == "joint" and np.isfinite(result["positions"]).all()


def test_landscape_finds_the_true_place_and_draws_and_writes_it(made, tmp_path):
    out = done("landscape", made / "tiny.npz", "--microphone", 9, "-o", "fig.png", folder=tmp_path)
    assert (tmp_path / "fig.png").read_bytes().startswith(PNG)
    x, y = load_measurement(made / "tiny.npz").positions[9]
    assert f"at ({x:.4g}, {y:.4g}) m" in out
    done("landscape", "tiny", "--microphone", 9, "--mode-numbers", "20", "-o", "fig.svg", folder=tmp_path)
    assert "frequency 20" in (tmp_path / "fig.svg").read_text()


def test_a_snapshot_shows_the_map_and_the_result(made, tmp_path, one_painter, refused):
    options = ("--size", "320x200", "--microphone", 9, "--result", made / "result.json")
    done("snapshot", "tiny", *options, "-o", "map.png", folder=tmp_path)
    assert "--force" in refused("snapshot", "tiny", "-o", "map.png")
    picture = np.asarray(Image.open(tmp_path / "map.png"), int)
    dark, bright = to_rgb(np.array([0.0, 1.0])).astype(int)
    for colour in (dark, bright, ESTIMATE):
        assert (np.abs(picture[..., :3] - colour).max(axis=-1) < 8).sum() > 5, colour


def test_a_snapshot_of_an_array_in_space_shows_the_cost(tmp_path, one_painter):
    scene, size = tmp_path / "ball.toml", ["--size", "400x300"]
    scene.write_text((folder_of("scenes") / "ball3d.toml").read_text().replace("[solver]", "[solver]\nmodes = 6"))
    pictures = []
    for options in ([], ["--microphone", 10]):
        done("snapshot", scene, *options, *size, "-o", "ball.png", "--force", folder=tmp_path)
        pictures.append(np.asarray(Image.open(tmp_path / "ball.png"), int))
    assert np.mean(np.abs(pictures[0] - pictures[1]).max(axis=-1) > 20) > 0.02, "isosurfaces and a map"


def test_a_damaged_scene_is_named_and_the_others_are_listed(tmp_path, monkeypatch, capsys):
    (tmp_path / "bad.toml").write_text("sed = 3\n")
    assert exit_code("calibrate", tmp_path / "bad.toml") == 2
    assert f"{tmp_path / 'bad.toml'}: sed is not a key" in capsys.readouterr().err
    monkeypatch.setattr(cli, "scene_names", lambda: [str(tmp_path / "bad.toml"), "tiny"])
    assert exit_code("scenes") == 2
    out, errors = capsys.readouterr()
    assert out.startswith("tiny ") and "bad.toml: sed" in errors


def test_app_py_opens_the_page(monkeypatch, capsys):
    """It takes the options of `fdcal view`, which tests/viewer tests."""
    monkeypatch.setattr(sys, "argv", ["app.py", "nowhere", "--no-browser"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(Path(__file__).parents[2] / "app.py"), run_name="__main__")
    assert ended.value.code == 2 and '"nowhere" is unknown' in capsys.readouterr().err


def test_a_plan_is_printed(capsys):
    assert exit_code("plan", "circle 8 0.2", "--known", "0,3,6") == 0
    printed = capsys.readouterr().out
    assert "Cramer-Rao" in printed and "number of source positions" in printed


def test_port_in_use_exits_2(refused):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        line = refused("view", "tiny", "--port", port, "--no-browser")
        assert "gone.npz" in refused("view", "gone.npz", "--port", port, "--no-browser", code=3), "the file comes first"
    assert f"port = {port} is in use" in line and "--port 0" in line


@pytest.mark.parametrize("arguments", [
    ["simulate", "tiny", "-o", "out.npz"], ["calibrate", "tiny", "--modes", "12", "-o", "out.json"],
    ["landscape", "tiny", "--microphone", "1", "-o", "out.png"],
])  # fmt: skip
def test_existing_output_stays_without_force(arguments, tmp_path, refused):
    path = tmp_path / arguments[-1]
    path.write_text("precious")
    assert "--force" in refused(*arguments)
    assert path.read_text() == "precious"
    if arguments[0] == "simulate":
        done(*arguments, "--force", folder=tmp_path)
        assert path.read_bytes() != b"precious" and list(tmp_path.iterdir()) == [path], "no temporary file stays"
