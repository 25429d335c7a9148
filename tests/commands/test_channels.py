"""Solver robust through the command line: faulty channels are named, the others stay right, gains become a table."""

import csv
import json

import numpy as np
import pytest
from running import done

pytestmark = pytest.mark.usefixtures("remembered_runs")

COUNT, INVERTED, DEAD = 16, 9, 3
HEALTHY = np.setdiff1d(np.arange(COUNT), [INVERTED, DEAD])


@pytest.fixture(scope="module")
def spoiled(made, tmp_path_factory):
    """Folder with tiny's measurement, in which one channel is inverted and one dead, its result, and the output."""
    folder = tmp_path_factory.mktemp("spoiled")
    with np.load(made / "tiny.npz") as archive:
        table = dict(archive)
    p, rng = table["pressures"], np.random.default_rng(1)
    p[:, INVERTED] *= -1
    p[:, DEAD] = 1e-3 * np.abs(p).mean() * (rng.normal(size=len(p)) + 1j * rng.normal(size=len(p)))
    np.savez(folder / "spoiled.npz", **table)
    return folder, done("calibrate", "spoiled.npz", "--modes", 16, "-o", "result.json", folder=folder)


def test_faulty_channels_are_named_and_the_verdict_of_the_others_is_good(spoiled):
    folder, printed = spoiled
    result = json.loads((folder / "result.json").read_text())
    assert result["verdict"] == "good" and result["odd_channels"] == [str(DEAD), str(INVERTED)]
    assert [one["kind"] for one in result["faulty_channel_details"]] == ["dead", "inverted"]
    assert np.max(np.array(result["errors_m"])[HEALTHY]) < 0.003
    assert np.max(np.array(result["leave_one_out_microphones_db"])[HEALTHY]) < -20
    assert "faulty: microphone 3: dead; microphone 9: inverted" in printed
    assert "over the 11 microphones sought without a faulty channel" in printed and "channels no differences" in printed


def test_the_gains_become_a_table(made, spoiled, refused):
    folder, _ = spoiled
    done("export", "result.json", "--table", "gains", "-o", "gains.csv", "--force", folder=folder)
    rows = list(csv.DictReader((folder / "gains.csv").open()))
    result = json.loads((folder / "result.json").read_text())
    assert list(rows[0]) == ["name", "gain_db", "gain_sigma_db", "phase_deg", "phase_sigma_deg", "noise_db", "fault"]
    assert [float(row["gain_db"]) for row in rows] == pytest.approx(result["channel_gain_db"], rel=1e-8)
    assert {row["name"]: row["fault"] for row in rows if row["fault"]} == {"3": "dead", "9": "inverted"}
    assert abs(float(rows[INVERTED]["phase_deg"])) > 170
    assert "16 microphones, frame: " in done("export", "result.json", "-o", "positions.csv", "--force", folder=folder)
    assert "gain_db" not in (folder / "positions.csv").read_text()
    path = folder / "result.json"
    assert ".csv" in refused("export", path, "--table", "gains", "-o", "gains.json")
    assert "--frame" in refused("export", path, "--table", "gains", "--frame", "axes", "-o", "gains.csv")
    done("calibrate", made / "tiny.npz", "--modes", 12, "--solver", "joint", "-o", "joint.json", folder=folder)
    assert "--solver robust" in refused("export", folder / "joint.json", "--table", "gains", "-o", "gains.csv")


def test_a_wrong_given_position_is_corrected_in_summary_and_file(made, tmp_path):
    with np.load(made / "tiny.npz") as archive:
        table = dict(archive)
    known = np.array([0, 3, 5, 7, 10, 13])
    table["known"], table["known_positions"] = known, table["positions"][known]
    table["known_positions"][4] += [0.05, -0.03]
    np.savez(tmp_path / "wrong.npz", **table)
    printed = done("calibrate", "wrong.npz", "--modes", 24, "-o", "result.json", folder=tmp_path)
    result = json.loads((tmp_path / "result.json").read_text())
    rows = {row["name"]: row for row in result["given_positions"]}
    assert list(rows) == [str(n) for n in known] and [name for name, row in rows.items() if row["wrong"]] == ["10"]
    assert rows["10"]["given_m"] == table["known_positions"][4].tolist()
    assert rows["10"]["found_m"] == result["positions"][10] and abs(rows["10"]["difference_m"] - 0.0583) < 0.003
    assert np.linalg.norm(np.array(rows["10"]["found_m"]) - table["positions"][10]) < 0.003
    assert result["verdict"] == "good" and "of 6 given positions corrected by more than 1 mm" in printed
    (line,) = [line for line in printed.splitlines() if line.endswith("wrong")]
    assert line.split()[0] == "10" and float(line.split()[5]) == pytest.approx(58, abs=3)


def test_the_options_reach_the_solver(made, tmp_path):
    table = [json.loads((made / "result.json").read_text())]
    for options in (["--gains", "fixed", "--known-sigma", "5mm"], ["--gain-sigma", "1dB,5deg"]):
        arguments = ("--solver", "robust", "--modes", 12, *options, "-o", "r.json", "--force")
        done("calibrate", made / "tiny.npz", *arguments, folder=tmp_path)
        table.append(json.loads((tmp_path / "r.json").read_text()))
    free, fixed, stated = table
    assert set(fixed["channel_gain_sigma_db"]) == {0.0} and set(fixed["channel_gain_db"]) == {0.0}
    assert 0 < np.median(stated["channel_gain_sigma_db"]) != np.median(free["channel_gain_sigma_db"])
