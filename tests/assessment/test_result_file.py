"""A result survives the round trip through its JSON file; a malformed file is refused with the name of the key."""

from __future__ import annotations

import json
import math
import os

import numpy as np
import pytest

from fdcal.assessment.result_file import load_result, save_result
from fdcal.model.validation import InputError, StorageError

RESULT = {
    "positions": np.array([[0.1, 0.2], [1 / 3, 4.0]]),
    "solver": "descent",
    "seed": 3,
    "frequencies": np.array([28.6, 34.3]),
    "cost": 1.25e-7,
    "sweeps": 41,
    "elapsed_s": 2.5,
    "converged": True,
    "mean_error_m": None,
    "max_error_m": 0.02,
}


def test_a_result_survives_the_round_trip(tmp_path):
    path = tmp_path / "r.json"
    save_result(RESULT, path)
    back = load_result(path)
    assert back.keys() == RESULT.keys()
    for key, value in RESULT.items():
        np.testing.assert_array_equal(back[key], value)
    assert back["positions"].dtype == float
    with pytest.raises(InputError, match="use force to overwrite it"):
        save_result(RESULT, path)
    save_result(back, path, force=True)


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
    table = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in RESULT.items()}
    path = tmp_path / "r.json"
    path.write_text(json.dumps(table | {key: value}))
    with pytest.raises(InputError, match=f'r.json: "{key}"'):
        load_result(path)
    with pytest.raises(InputError, match=f'"{key}"'):
        save_result(table | {key: value}, tmp_path / "s.json")
    del table[key]
    path.write_text(json.dumps(table))
    with pytest.raises(InputError, match=f'has no "{key}"'):
        load_result(path)
    assert os.listdir(tmp_path) == ["r.json"]


ASSESSMENT = {
    "names": ["a", "b"],
    "excluded": ["c"],
    "uncertainty_m": [0.0, 0.001],
    "residual_to_noise": 1.02,
    "verdict": "good",
    "verdict_text": "nothing speaks against these positions",
    "sound_speed": 343.0,
}


def test_a_result_with_a_verdict_survives_the_round_trip_and_older_files_are_read(tmp_path):
    save_result(RESULT | ASSESSMENT, tmp_path / "new.json")
    back = load_result(tmp_path / "new.json")
    for key, value in ASSESSMENT.items():
        np.testing.assert_array_equal(back[key], value)
    save_result(RESULT, tmp_path / "old.json")
    assert not set(ASSESSMENT) & set(load_result(tmp_path / "old.json"))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("uncertainty_m", [0.1]),
        ("uncertainty_m", [0.1, math.nan]),
        ("residual_to_noise", None),
        ("verdict", 4),
        ("sound_speed", math.inf),
        ("names", "a,b"),
        ("excluded", [3]),
    ],
)
def test_a_malformed_verdict_names_the_key(tmp_path, key, value):
    path = tmp_path / "r.json"
    table = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in (RESULT | ASSESSMENT | {key: value}).items()}
    path.write_text(json.dumps(table))
    with pytest.raises(InputError, match=f'r.json: "{key}"'):
        load_result(path)


def test_a_file_that_is_no_result(tmp_path):
    path = tmp_path / "r.json"
    with pytest.raises(StorageError, match="cannot read"):
        load_result(path)
    for text in ("{", "[1]", "\udcff"):
        path.write_bytes(text.encode(errors="surrogateescape"))
        with pytest.raises(InputError, match=r"r\.json"):
            load_result(path)
