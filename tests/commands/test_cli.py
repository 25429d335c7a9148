"""Each command, run as a user would, on `tiny`; and each kind of bad input, with what it gets."""

import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from running import FDCAL, done, exit_code

from fdcal.assessment.result_file import load_result
from fdcal.cost.eq7 import ReferenceCost
from fdcal.graphics.heatmap import PLACE
from fdcal.model.measurement import load_measurement
from fdcal.model.problem import ChannelCorrection
from fdcal.model.scene import load_scene, scene_folder

pytestmark = pytest.mark.usefixtures("remembered_runs")

PNG = b"\x89PNG"


def test_simulate_writes_all_of_the_measurement(made):
    measurement, scene = load_measurement(made / "tiny.npz"), load_scene("tiny")
    assert measurement.count == 16
    assert len(measurement.frequencies) >= scene.solver.modes
    assert measurement.known.tolist() == list(scene.gauge.known)
    assert measurement.search == scene.search
    assert measurement.positions.shape == (16, 2)


def test_calibrate_writes_the_result_and_prints_a_summary(made):
    result = json.loads((made / "result.json").read_text())
    keys = {"positions", "solver", "seed", "frequencies", "cost", "sweeps", "elapsed_s", "converged"}
    keys |= {"left_out_db", "left_out_microphones_db", "left_out_frequencies_db"}
    keys |= {"names", "excluded", "verdict", "verdict_text", "uncertainty_m", "residual_to_noise", "sound_speed"}
    assert keys | {"mean_error_m", "max_error_m"} <= set(result)
    assert np.shape(result["positions"]) == (16, 2)
    assert (result["solver"], result["seed"], len(result["frequencies"])) == ("robust", 1, 12)
    assert 0 <= result["mean_error_m"] <= result["max_error_m"]
    measurement = load_measurement(made / "tiny.npz")
    corrected = np.array(result["positions"])[measurement.known] - measurement.known_positions
    assert 0 < np.abs(corrected).max() < 1e-3, "given positions are uncertain, and here they are right"


def test_solver_joint_takes_given_positions_as_exact(calibrated, made):
    measurement, (_, result) = load_measurement(made / "tiny.npz"), calibrated("--solver", "joint")
    assert np.array_equal(np.array(result["positions"])[measurement.known], measurement.known_positions)


def test_calibrate_of_scene_and_of_its_file_agree(made, tmp_path, capsys):
    options = ("--modes", 12, "--seed", 1, "--time-limit", 60)  # a run with a limit of time is not a remembered one
    assert exit_code("calibrate", "tiny", *options, "-o", tmp_path / "again.json") == 0
    printed = capsys.readouterr()
    assert "13 of 16 microphones" in printed.out and "calibrating" in printed.err
    one, two = (json.loads(path.read_text()) for path in (made / "result.json", tmp_path / "again.json"))
    assert one["positions"] == two["positions"]


@pytest.fixture
def calibrated(made, tmp_path, monkeypatch, capsys):
    """Function that calibrates tiny's file, or another, with options, in this process: summary and result."""
    monkeypatch.chdir(tmp_path)

    def run(*options, path=made / "tiny.npz") -> tuple[str, dict]:
        assert exit_code("calibrate", path, "--modes", "20", "-o", "r.json", "--force", *map(str, options)) in (0, 4)
        return capsys.readouterr().out, json.loads((tmp_path / "r.json").read_text())

    return run


def test_the_cost_is_that_of_the_page(calibrated, made):
    """Eq. 7 over all modes in decibels, whatever the solver minimises."""
    measurement = load_measurement(made / "tiny.npz")
    cost = ReferenceCost(measurement.problem())
    for solver in ("joint", "robust"):
        out, result = calibrated("--solver", solver)
        shown = float(re.search(r"^cost +(-[\d.]+) dB", out, re.MULTILINE)[1])
        gains = 10 ** (np.array(result["channel_gain_db"]) / 20) * np.exp(1j * np.radians(result["channel_phase_deg"]))
        channels = ChannelCorrection(gains, 10 ** (np.array(result["channel_noise_db"]) / 10))
        assert shown == pytest.approx(cost(np.array(result["positions"]), channels), abs=0.2)


@pytest.mark.parametrize(
    ("options", "sought", "aligned"),
    [
        (["--known", "minimal"], 16, False),
        (["--known", "none"], 16, True),
        (["--noise", "60"], 13, False),
    ],
)
def test_calibrate_options_end_within_two_millimetres(calibrated, options, sought, aligned):
    out, result = calibrated("--solver", "joint", *options)
    assert result["aligned"] is aligned
    assert f"{sought} of 16 microphones" in out
    assert ("moved as a whole onto the truth" in out) is aligned
    assert result["mean_error_m"] < 2e-3


def test_a_file_without_known_microphones_is_calibrated_blind(calibrated, altered):
    for changes in ({}, {"positions": None}):
        out, result = calibrated("--solver", "joint", path=altered(known=None, known_positions=None, **changes))
        assert result["aligned"] is True and (result["mean_error_m"] or 0.0) < 2e-3
        unknown = {result["mean_error_m"] is None, result["max_error_m"] is None, "unknown" in out}
        assert unknown == {bool(changes)}


def test_the_minimal_gauge_takes_a_position_a_direction_and_a_side(calibrated, made):
    known = load_measurement(made / "tiny.npz").known
    truth = load_measurement(made / "tiny.npz").positions
    found = np.array(calibrated("--known", "minimal", "--solver", "joint")[1]["positions"])
    first, second, third = known
    assert np.array_equal(found[first], truth[first])
    along, there = (x[second] - x[first] for x in (found, truth))
    assert np.linalg.norm(along) * np.linalg.norm(there) == pytest.approx(along @ there, rel=1e-12)
    assert not np.array_equal(found[second], truth[second])
    sides = [along[0] * (x[third] - x[first])[1] - along[1] * (x[third] - x[first])[0] for x in (found, truth)]
    assert sides[0] * sides[1] > 0


def test_the_seed_determines_a_random_start_and_changes_nothing_else(calibrated):
    one, two = (calibrated("--seed", seed)[1]["positions"] for seed in (0, 1))
    assert one == two
    start = ("--solver", "joint", "--start")
    one, two = (calibrated("--seed", seed, *start, "affine")[1]["positions"] for seed in (0, 1))
    assert one == two
    one, two = (calibrated("--seed", seed, *start, "random")[1] for seed in (0, 1))
    assert one["sweeps"] != two["sweeps"], "another way, though perhaps to the same place"


@pytest.mark.parametrize(("solver", "apart", "rel"), [("joint", 2e-4, 0.2), ("robust", 2e-5, 0.05)])
def test_a_noise_that_the_pressures_contradict_is_not_believed(calibrated, solver, apart, rel):
    stated, estimated = (calibrated("--solver", solver, "--noise", snr)[1] for snr in ("3", "auto"))
    assert np.abs(np.subtract(stated["positions"], estimated["positions"])).max() < apart
    assert stated["uncertainty_m"] == pytest.approx(estimated["uncertainty_m"], rel=rel)


@pytest.mark.parametrize("solver", ["joint", "robust"])
def test_the_noise_is_estimated_where_none_is_reported(calibrated, altered, solver):
    reported = calibrated("--solver", solver, "--noise", "reported", path=altered(noise_power=None))[1]
    assert reported["positions"] == calibrated("--solver", solver, "--noise", "auto")[1]["positions"]


def test_a_blind_result_is_laid_onto_the_truth_before_it_is_drawn(calibrated, made):
    calibrated("--known", "none", "--solver", "joint")
    arguments = ("landscape", made / "tiny.npz", "--microphone", "9", "--mode-numbers", "2,3", "--result", "r.json")
    assert exit_code(*arguments, "-o", "f.png") == 0
    found = load_result("r.json").positions_for(load_measurement(made / "tiny.npz"))
    assert np.abs(found - load_measurement(made / "tiny.npz").positions).max() < 5e-3


def test_search_domain_from_the_command_line(altered, made, tmp_path, refused):
    bare = altered(**dict.fromkeys(("search_origin", "search_size", "search_step", "radius")))
    domain = ["--search", "0.46,0.3,0.48,0.48,0.02", "--radius", 0.32]
    done("calibrate", bare, "--modes", 12, "--seed", 1, *domain, "-o", "out.json", folder=tmp_path)
    one, two = (json.loads(path.read_text()) for path in (made / "result.json", tmp_path / "out.json"))
    assert one["positions"] == two["positions"]
    assert "--search" in refused("calibrate", bare, "--solver", "descent")
    assert "--search" in refused("calibrate", bare, "--solver", "joint", "--start", "random")
    assert "--radius" in refused("calibrate", bare, *domain[:2])


def test_landscape_finds_the_true_place(made, tmp_path):
    out = done("landscape", made / "tiny.npz", "--microphone", 9, "-o", "fig.png", folder=tmp_path)
    assert (tmp_path / "fig.png").read_bytes().startswith(PNG)
    x, y = load_measurement(made / "tiny.npz").positions[9]
    assert f"at ({x:.4g}, {y:.4g}) m" in out


def test_landscape_draws_and_writes_the_basins_of_attraction(tmp_path):
    done("landscape", "tiny", "--microphone", 9, "--mode-numbers", "20", "--basins", "-o", "fig.svg", folder=tmp_path)
    assert re.search(r"basin of the true position \d+ %", (tmp_path / "fig.svg").read_text())
    done("landscape", "tiny", "--microphone", 9, "--basins", "-o", "map.vti", folder=tmp_path)
    assert 'Name="basin of the sum"' in (tmp_path / "map.vti").read_text()


def test_a_snapshot_of_basins_is_not_that_of_costs(made, tmp_path, one_painter, refused):
    for name, extra in (("cost", ["--result", made / "result.json"]), ("basins", ["--basins"])):
        shown = ["--size", "320x200", "--microphone", 9, *extra]
        done("snapshot", "tiny", *shown, "-o", f"{name}.png", folder=tmp_path)
    assert "--force" in refused("snapshot", "tiny", "-o", "cost.png")
    cost, basins = (np.asarray(Image.open(tmp_path / f"{name}.png"), int) for name in ("cost", "basins"))
    place = np.abs(basins[..., :3] - PLACE).max(axis=-1) < 8
    assert place.sum() > 500 > np.sum(np.abs(cost[..., :3] - PLACE).max(axis=-1) < 8), "the colour of the true basin"


def test_the_cost_of_an_array_in_space_is_drawn_and_written(tmp_path, one_painter):
    scene, size = tmp_path / "ball.toml", ["--size", "400x300", "--slice", "x=1.6"]
    scene.write_text((scene_folder() / "ball3d.toml").read_text().replace("[solver]", "[solver]\nmodes = 6"))
    done("snapshot", scene, "--microphone", 10, *size, "-o", "ball.png", folder=tmp_path)
    assert (tmp_path / "ball.png").read_bytes().startswith(PNG)
    printed = done("landscape", scene, "--microphone", 10, "-o", "ball.vti", folder=tmp_path)
    assert "least cost" in printed and 'Name="cost_dB"' in (tmp_path / "ball.vti").read_text()


def test_scenes_and_help(tmp_path):
    assert "tiny" in done("scenes", folder=tmp_path)
    assert "calibrate" in done(folder=tmp_path)
    assert "ORIGIN,SIZE,STEP" in done("calibrate", "--help", folder=tmp_path)


def test_app_py_prints_its_address_once_it_serves(tmp_path):
    """As `fdcal view` does, which tests/viewer runs."""
    command = [sys.executable, str(Path(__file__).parents[2] / "app.py"), "tiny", "--port", "0", "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as viewer:
        try:
            ready, _, _ = select.select([viewer.stdout], [], [], 60)
            assert ready, "no address within a minute"
            line = viewer.stdout.readline()
            assert line.startswith("http://127.0.0.1:"), line + viewer.stderr.read()
            with urllib.request.urlopen(line.strip(), timeout=10) as page:
                assert b"<html" in page.read().lower()
            viewer.send_signal(signal.SIGINT)
            viewer.wait(20)
        finally:
            viewer.kill()
        assert viewer.returncode in (0, 130)
        assert "Traceback" not in viewer.stderr.read()


def test_port_in_use_exits_2(refused):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        line = refused("view", "tiny", "--port", port, "--no-browser")
        assert "gone.npz" in refused("view", "gone.npz", "--port", port, "--no-browser", code=3), "the file comes first"
    assert f"--port {port} is in use" in line
    assert "--port 0" in line


@pytest.mark.parametrize(
    "arguments",
    [
        ["simulate", "tiny", "-o", "out.npz"],
        ["calibrate", "tiny", "--modes", "12", "-o", "out.json"],
        ["landscape", "tiny", "--microphone", "1", "-o", "out.png"],
    ],
)
def test_existing_output_stays_without_force(arguments, tmp_path, refused):
    path = tmp_path / arguments[-1]
    path.write_text("precious")
    assert "--force" in refused(*arguments)
    assert path.read_text() == "precious"
    done(*arguments, "--force", folder=tmp_path)
    assert path.read_bytes() != b"precious"
    assert list(tmp_path.iterdir()) == [path], "no temporary file stays"


def test_interrupt_leaves_nothing_half_written(edited, tmp_path):
    scene = edited({"source.duration": "600.0"})
    folder, cache = tmp_path / "out", tmp_path / "cache"
    folder.mkdir()
    command = [*FDCAL, "simulate", str(scene), "-o", "long.npz"]
    environment = {**os.environ, "FDCAL_CACHE": str(cache)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=folder, env=environment) as run:
        try:
            shown = b""
            while not re.search(rb"[1-9]\d* %", shown):  # the simulation is under way, everything compiled
                ready, _, _ = select.select([run.stderr], [], [], 60)
                assert ready, "no progress within a minute"
                shown += os.read(run.stderr.fileno(), 4096)
                assert run.poll() is None, shown
            run.send_signal(signal.SIGINT)
            _, errors = run.communicate(timeout=30)
        finally:
            run.kill()
    assert run.returncode == 130, errors
    assert b"Traceback" not in errors
    assert list(folder.iterdir()) == []
    assert [path for path in cache.rglob("*") if path.is_file()] == []
