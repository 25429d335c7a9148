"""A calibration survives the round trip through its JSON file; a malformed file names the key that is wrong."""

from __future__ import annotations

import json
import math
import os
from dataclasses import fields, replace

import numpy as np
import pytest

from fdcal import Calibration
from fdcal.assessment.calibration import ChannelFault, Channels, Evidence, GivenPosition, KnownRoom
from fdcal.assessment.result_file import load_result, save_result
from fdcal.model.validation import InputError, StorageError

# The keys that the first version wrote.
OLDEST = {
    "positions": [[0.1, 0.2], [1 / 3, 4.0]],
    "solver": "descent",
    "seed": 3,
    "frequencies": [28.6, 34.3],
    "cost": 1.25e-7,
    "sweeps": 41,
    "elapsed_s": 2.5,
    "converged": True,
    "mean_error_m": None,
    "max_error_m": 0.02,
}
NEWER = {
    "names": ["a", "b"],
    "excluded": ["c"],
    "known": ["a"],
    "uncertainty_m": [0.0, 0.001],
    "residual_to_noise": 1.02,
    "verdict": "good",
    "verdict_text": "nothing speaks against these positions",
    "sound_speed": 343.0,
    "left_out_db": -37.5,
    "left_out_microphones_db": [-37.0, -38.0],
    "left_out_frequencies_db": [-36.0, -39.0],
}
POSITIONS = np.array([[0.1, 0.2], [1 / 3, 4.0]])
FULL = Calibration(
    POSITIONS, ("a", "b"), "room", 3, np.array([28.6, 34.3]), 1.25e-7, 41, 2.5, True, ("a",), ("c",), False,
    0.01, 0.02, np.array([0.0, 0.02]), 343.0, "good", "nothing speaks against these positions",
    np.array([0.0, 0.001]), np.array([np.zeros((2, 2)), [[1e-6, 1e-7], [1e-7, 2e-6]]]),
    Evidence(1.02, -37.5, np.array([-37.0, -38.0]), np.array([-36.0, -39.0])),
    KnownRoom((6.0, 5.0), np.array([1.0, 2.0]), 0.01 + 0.02j, (("(x, y)", POSITIONS), ("(6 - x, y)", POSITIONS + 1))),
    Channels(
        np.array([0.0, 3.2]), np.array([0.1, 0.2]), np.array([0.0, -178.0]), np.array([0.5, 0.6]),
        np.array([0.0, 31.0]),
        (ChannelFault("a", "exchanged", 0.4, "m", "b"), ChannelFault("b", "inverted")),
        (GivenPosition("a", (0.1, 0.24), (0.1, 0.2), 0.003, True),),
    ),
)  # fmt: skip


def flat(value) -> list:
    """The numbers and texts of a calibration or a part of it, in order."""
    if hasattr(value, "__dataclass_fields__"):
        return [x for f in fields(value) for x in flat(getattr(value, f.name))]
    if isinstance(value, np.ndarray):
        return [value.shape, *value.ravel().tolist()]
    return [x for part in value for x in flat(part)] if isinstance(value, tuple) else [value]


def test_a_calibration_survives_the_round_trip(tmp_path):
    path = tmp_path / "r.json"
    save_result(FULL, path)
    back = load_result(path)
    assert flat(back) == flat(FULL)
    assert back.positions.dtype == float and not back.positions.flags.writeable
    with pytest.raises(InputError, match="exists"):
        save_result(FULL, path)
    save_result(back, path, force=True)
    assert flat(load_result(path)) == flat(FULL)


def test_the_keys_of_the_file_stay_what_they_were():
    table = json.loads(FULL.to_json())
    assert set(OLDEST) | set(NEWER) <= set(table)
    assert {key: table[key] for key in NEWER} == NEWER
    assert table["symmetries"][1] == {"map": "(6 - x, y)", "positions": (POSITIONS + 1).tolist()}
    assert (table["room"], table["source"], table["admittance"]) == ([6.0, 5.0], [1.0, 2.0], [0.01, 0.02])


def test_the_channels_have_keys_of_their_own_and_the_odd_ones_are_names():
    table = json.loads(FULL.to_json())
    assert table["channel_gain_db"] == [0.0, 3.2] and table["channel_gain_sigma_db"] == [0.1, 0.2]
    assert table["channel_phase_deg"] == [0.0, -178.0] and table["channel_phase_sigma_deg"] == [0.5, 0.6]
    assert table["channel_noise_db"] == [0.0, 31.0] and table["odd_channels"] == ["a", "b"]
    assert table["odd_channel_details"] == [
        {"name": "a", "kind": "exchanged", "value": 0.4, "unit": "m", "partner": "b"},
        {"name": "b", "kind": "inverted", "value": None, "unit": "", "partner": None},
    ]
    without = json.loads(replace(FULL, channels=None).to_json())
    assert not any("channel" in key or "given" in key for key in without)


def test_given_positions_stand_beside_those_found_with_difference_and_sigma():
    table = json.loads(FULL.to_json())
    (row,) = table["given_positions"]
    assert row["difference_m"] == pytest.approx(0.04) and row["found_m"] == table["positions"][0]
    assert row == {
        "name": "a", "given_m": [0.1, 0.24], "found_m": [0.1, 0.2], "difference_m": row["difference_m"],
        "sigma_m": 0.003, "wrong": True,
    }  # fmt: skip


GIVEN = {"name": "a", "given_m": [0.1, 0.2], "found_m": [0.1, 0.2], "difference_m": 0.0, "sigma_m": 0.1, "wrong": False}


@pytest.mark.parametrize(
    "rows",
    [
        "a", [3], [{"name": "a"}], [GIVEN | {"name": "nobody"}], [GIVEN | {"wrong": 1}], [GIVEN | {"sigma_m": "1"}],
        [GIVEN | {"given_m": [0.1]}], [GIVEN | {"found_m": [0.1, None]}], [GIVEN | {"difference_m": math.inf}],
        [GIVEN | {"more": 1}], [GIVEN | {"given_m": [0.1, 10**400]}],
    ],
)  # fmt: skip
def test_malformed_given_positions_are_refused(rows):
    table = json.loads(FULL.to_json()) | {"given_positions": rows}
    with pytest.raises(InputError, match="given_positions"):
        Calibration.from_json(json.dumps(table))
    (row,) = Calibration.from_json(json.dumps(table | {"given_positions": [GIVEN]})).channels.given
    assert (row.name, row.given, row.sigma, row.wrong) == ("a", (0.1, 0.2), 0.1, False)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("channel_gain_db", [0.0]),
        ("channel_noise_db", [0.0, math.inf]),
        ("channel_phase_sigma_deg", None),
        ("odd_channels", [3]),
        ("odd_channel_details", "b"),
        ("odd_channel_details", [{"name": "b"}]),
        ("odd_channel_details", [{"name": "z", "kind": "dead", "value": None, "unit": "", "partner": None}]),
        ("odd_channel_details", [{"name": "b", "kind": "dead", "value": "2", "unit": "dB", "partner": None}]),
        ("odd_channel_details", [{"name": "b", "kind": "gain", "value": 2.0, "unit": ["dB"], "partner": None}]),
    ],
)
def test_malformed_channels_are_named(key, value):
    table = json.loads(FULL.to_json()) | {key: value}
    with pytest.raises(InputError, match=f'"{key}"'):
        Calibration.from_json(json.dumps(table))
    if key not in ("odd_channels", "odd_channel_details"):
        del table[key]
        with pytest.raises(InputError, match=f'no "{key}"'):
            Calibration.from_json(json.dumps(table))


def test_a_fault_is_plain_english():
    assert ChannelFault("17", "inverted").text == "microphone 17: inverted"
    assert ChannelFault("a", "dead", 40.0, "dB").text == "microphone a: dead"
    assert ChannelFault("a", "gain", 3.21, "dB").text == "microphone a: gain +3.2 dB"
    assert ChannelFault("a", "misplaced", 0.0234, "m").text == "microphone a: 23.4 mm from the position given"
    assert ChannelFault("a", "exchanged", 0.4, "m", "b").text == "microphone a: exchanged with microphone b"


def test_a_file_of_an_older_version_is_read():
    old = Calibration.from_json(json.dumps(OLDEST))
    assert np.array_equal(old.positions, POSITIONS)
    assert (old.mean_error, old.max_error, old.elapsed) == (None, 0.02, 2.5)
    assert old.names == ("0", "1") and old.known is None and old.excluded == ()
    assert (old.verdict, old.uncertainty, old.sound_speed, old.evidence, old.room) == ("", None, None, None, None)
    newer = Calibration.from_json(json.dumps(OLDEST | NEWER))
    assert (newer.names, newer.known, newer.excluded) == (("a", "b"), ("a",), ("c",))
    assert newer.verdict == "good" and newer.sound_speed == 343.0
    assert newer.evidence is not None and newer.evidence.leave_one_out_db == -37.5


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("positions", [1.0, 2.0]),
        ("positions", [[1.0, 2.0], [3.0]]),
        ("positions", [[1.0], [2.0]]),
        ("positions", [["a", "b"]]),
        ("positions", [[math.nan, 1.0]]),
        ("frequencies", []),
        ("solver", 3),
        ("seed", True),
        ("sweeps", 1.5),
        ("cost", math.inf),
        ("cost", 10**400),
        ("mean_error_m", -(10**400)),
        ("converged", "yes"),
        ("cost", None),
    ],
)
def test_a_malformed_result_names_the_key(tmp_path, key, value):
    path = tmp_path / "r.json"
    path.write_text(json.dumps(OLDEST | {key: value}))
    with pytest.raises(InputError, match=f'r.json: "{key}"'):
        load_result(path)
    path.write_text(json.dumps({k: v for k, v in OLDEST.items() if k != key}))
    with pytest.raises(InputError, match=f'has no "{key}"'):
        load_result(path)


@pytest.mark.parametrize(
    ("key", "changes"),
    [
        ("positions", {"positions": np.array([1.0, 2.0])}),
        ("positions", {"positions": np.array([[1.0], [2.0]])}),
        ("positions", {"positions": np.array([[math.nan, 1.0], [0.0, 0.0]])}),
        ("frequencies", {"frequencies": np.array([])}),
        ("solver", {"solver": 3}),
        ("seed", {"seed": True}),
        ("sweeps", {"sweeps": 1.5}),
        ("cost", {"cost": math.inf}),
        ("cost", {"cost": 10**400}),
        ("mean_error_m", {"mean_error": -(10**400)}),
        ("converged", {"converged": "yes"}),
        ("cost", {"cost": None}),
        ("names", {"names": ("a",)}),
        ("uncertainty_m", {"uncertainty": np.array([0.1])}),
        ("covariance_m2", {"covariance": np.zeros((2, 3, 3))}),
    ],
)
def test_a_malformed_calibration_is_not_written(tmp_path, key, changes):
    with pytest.raises(InputError, match=f'"{key}"'):
        save_result(replace(FULL, **changes), tmp_path / "s.json")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("uncertainty_m", [0.1]),
        ("uncertainty_m", [0.1, math.nan]),
        ("uncertainty_m", [0.1, True]),
        ("known", None),
        ("residual_to_noise", None),
        ("verdict", 4),
        ("sound_speed", math.inf),
        ("names", "a,b"),
        ("names", ["a"]),
        ("excluded", [3]),
        ("known", "a"),
        ("aligned", 1),
        ("covariance_m2", [[[1.0]], [[2.0]]]),
        ("symmetries", [{"map": "(x, y)", "positions": [[1.0, 2.0], [3.0, 4.0]]}]),
    ],
)
def test_a_malformed_optional_key_is_named(tmp_path, key, value):
    path = tmp_path / "r.json"
    path.write_text(json.dumps(OLDEST | NEWER | {key: value}))
    with pytest.raises(InputError, match=f'r.json: "{key}"'):
        load_result(path)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("room", [6.0]),
        ("source", [1.0, 2.0, 3.0]),
        ("admittance", [0.1]),
        ("symmetries", "none"),
        ("symmetries", [{"map": "(x, y)"}]),
        ("symmetries", [{"map": "(x, y)", "positions": [[1.0, 2.0]]}]),
    ],
)
def test_a_malformed_known_room_is_named(key, value):
    table = json.loads(FULL.to_json()) | {key: value}
    with pytest.raises(InputError, match=f'"{key}"'):
        Calibration.from_json(json.dumps(table))


def test_a_file_that_is_no_result(tmp_path):
    path = tmp_path / "r.json"
    with pytest.raises(StorageError, match="cannot read"):
        load_result(path)
    for text in ("{", "[1]", "\udcff"):
        path.write_bytes(text.encode(errors="surrogateescape"))
        with pytest.raises(InputError, match=r"r\.json"):
            load_result(path)
