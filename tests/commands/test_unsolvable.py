"""Measurements that cannot be solved, through the command line: one line, the right exit code, and the remedy."""

import numpy as np
import pytest
from fields import jittered_grid, measured
from running import exit_code

from fdcal.model.measurement import save_measurement

pytestmark = pytest.mark.usefixtures("remembered_runs")

TRUTH, KNOWN = jittered_grid(), [0, 4, 22]


@pytest.fixture
def calibrate(calibrate_file):
    """Function that changes the keys of a measurement and calibrates it: exit code, output, error line, result."""

    def run(change=dict, *options, source=(5.47, 4.53), places=TRUTH, known=tuple(KNOWN)):
        save_measurement(measured(places, list(known), highest=190, snr_db=40, source=source), "m.npz")
        with np.load("m.npz") as archive:
            table = dict(archive)
        table |= change(table)
        np.savez("m.npz", **{key: value for key, value in table.items() if value is not None})
        return calibrate_file("--solver", "joint", *options)

    return run


def column(n, values):
    """Change of a measurement: channel `n` replaced by what `values` makes of it."""

    def change(table):
        p = table["pressures"].copy()
        p[:, n] = values(p)
        return {"pressures": p}

    return change


def test_a_faulty_channel_is_named_in_the_whole_result_and_may_be_left_out(calibrate, capsys):
    code, out, _, result = calibrate()
    assert code == 0 and result["verdict"] == "good" and "verdict good" in out
    assert len(result["uncertainty_m"]) == len(result["names"]) == 25
    assert result["uncertainty_m"][4] == 0 < result["uncertainty_m"][5] < 0.02
    assert 0.7 < result["residual_to_noise"] < 1.5
    assert result["sound_speed"] == 343.0 and result["excluded"] == []
    odd = column(17, lambda p: 0.4 * p[:, 17])
    code, out, _, result = calibrate(odd)
    assert code == 0 and result["odd_channels"] == ["17"] and len(result["positions"]) == 25
    code, _, _, result = calibrate(odd, "--exclude", "17")
    assert code == 0 and result["excluded"] == ["17"] and "17" not in result["names"]
    assert len(result["positions"]) == len(result["names"]) == len(result["uncertainty_m"]) == 24
    assert exit_code("landscape", "m.npz", "--microphone", "3", "--result", "r.json", "-o", "f.png") == 2
    assert "leaves out microphone 17" in capsys.readouterr().err, "this result lacks a microphone"
    assert calibrate(column(9, lambda p: np.nan), "--exclude", "9")[0] == 0


def few_modes(count):
    keys = "frequencies", "pressures", "wavenumbers", "noise_power"
    return lambda table: {key: table[key][:count] for key in keys}


def given_at(places):
    return lambda table: {"known_positions": np.array(places)}


LINE = np.column_stack([np.linspace(2.0, 3.2, 16), np.full(16, 2.3)])
TWO = {"known": [0, 4]}
MINIMAL, DESCENT = ["--known", "minimal"], ["--solver", "descent"]


@pytest.mark.parametrize(("change", "options", "given", "words"), [
    (column(9, lambda p: np.nan), [], {}, ['microphone "9"', "finite", "--exclude 9"]),
    (column(9, lambda p: 0.0), [], {}, ['microphone "9"', "zero", "--exclude 9"]),
    (column(9, lambda p: 0.3 - 0.1j), [], {}, ['microphone "9"', "constant pressure", "--exclude 9"]),
    (column(9, lambda p: 2j * p[:, 3]), [], {}, ['"3" and "9"', "recorded the same", "--exclude 9"]),
    (few_modes(1), [], {}, ["44 unknown coordinates", "at least 2 are needed"]),
    (few_modes(5), [], {}, ["use at least 6"]),
    (dict, [], {"places": TRUTH[KNOWN], "known": [0, 1]}, ["3 microphones are too few"]),
    (dict, [], {"places": TRUTH[[0, 4, 22, 12, 8]], "known": [0, 1, 2]}, ["too few"]),
    (given_at(TRUTH[[0, 0, 22]]), [], {}, ['"0" and "4"', "known_positions"]),
    (given_at([[2.1, 2.0], [2.6, 2.0], [3.1, 2.0]]), [], {}, ["span the array"]),
    (dict, [], TWO, ["name at least 3 known microphones that span the array, or none"]),
    (dict, DESCENT, TWO, ["known = [0, 4]", "three"]),
    (dict, MINIMAL, TWO, ["known = [0, 4] does not fix position", "name three known microphones"]),
    (dict, [], {"places": LINE, "known": []}, ["on a line"]),
])  # fmt: skip
def test_what_does_not_determine_the_positions_is_refused_and_a_dead_channel_named(
    calibrate, change, options, given, words
):
    code, _, line, _ = calibrate(change, *options, **given)
    assert code == 2 and [word for word in words if word not in line] == []


def test_the_sound_speed_is_estimated(calibrate):
    def slower(table):
        return {"sound_speed": np.array(343 * 0.97), "wavenumbers": table["wavenumbers"] / 0.97}

    code, _, _, result = calibrate(slower, "--sound-speed-sigma", "5%")
    assert code == 0 and result["sound_speed"] == pytest.approx(343, rel=0.005)
    assert result["mean_error_m"] < 0.006
    distance = f"0,24,{np.linalg.norm(TRUTH[0] - TRUTH[24])}"
    code, _, _, result = calibrate(slower, "--distance", distance, known=[])
    assert code == 0 and result["sound_speed"] == pytest.approx(343, rel=0.01)
