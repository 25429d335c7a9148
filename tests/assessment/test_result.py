"""A calibration: its file, its errors against the truth, its frames, and its exports."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
from dataclasses import fields, replace
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from running import refuses
from scipy.spatial.distance import pdist

from fdcal import Calibration
from fdcal.assessment.calibration import ChannelFault, Channels, Evidence, GivenPosition, placed_in_frame
from fdcal.assessment.result_file import load_result, position_table, save_result
from fdcal.assessment.words import error_line
from fdcal.graphics.picture import VISIBLE, ellipse_scale
from fdcal.model.gauge import FRAMES, align, in_frame
from fdcal.model.measurement import Measurement
from fdcal.model.validation import InputError
from fdcal.viewer.tabs import microphones

POSITIONS = np.array([[0.1, 0.2], [1 / 3, 4.0]])
FULL = Calibration(
    POSITIONS, ("a", "b"), "robust", 3, np.array([28.6, 34.3]), 1.25e-7, 41, 2.5, True, ("a",), ("c",), False,
    0.01, 0.02, np.array([0.0, 0.02]), 343.0, "good", "no check contradicts the positions found",
    np.array([0.0, 0.001]), np.array([np.zeros((2, 2)), [[1e-6, 1e-7], [1e-7, 2e-6]]]),
    Evidence(1.02, -37.5, np.array([-37.0, -38.0]), np.array([-36.0, -39.0])),
    Channels(
        np.array([0.0, 3.2]), np.array([0.1, 0.2]), np.array([0.0, -178.0]), np.array([0.5, 0.6]),
        np.array([0.0, 31.0]),
        (ChannelFault("a", "swapped", 0.4, "m", "b"), ChannelFault("b", "inverted")),
        (GivenPosition("a", (0.1, 0.24), (0.1, 0.2), 0.003, True),),
    ),
)  # fmt: skip


WHOLE = json.loads(FULL.to_json())
# The keys that every result has, and further ones.
LEAST = {
    key: WHOLE[key]
    for key in "fdcal_result positions solver seed frequencies cost sweeps elapsed_s converged max_error_m".split()
} | {"mean_error_m": None}
MORE = {
    key: WHOLE[key]
    for key in (
        "names excluded known uncertainty_m residual_to_noise verdict verdict_text sound_speed leave_one_out_db"
        " leave_one_out_microphones_db leave_one_out_frequencies_db"
    ).split()
}


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
    refuses("exists", save_result, FULL, path)
    save_result(back, path, force=True)
    assert flat(load_result(path)) == flat(FULL)


GIVEN = {"name": "a", "given_m": [0.1, 0.2], "found_m": [0.1, 0.2], "difference_m": 0.0, "sigma_m": 0.1, "wrong": False}


def test_a_result_may_lack_what_its_solver_does_not_find():
    old = Calibration.from_json(json.dumps(LEAST))
    assert np.array_equal(old.positions, POSITIONS)
    assert (old.mean_error, old.max_error, old.elapsed) == (None, 0.02, 2.5)
    assert old.names == ("0", "1") and old.known is None and old.excluded == ()
    assert (old.verdict, old.uncertainty, old.sound_speed, old.evidence) == ("", None, None, None)
    newer = Calibration.from_json(json.dumps(LEAST | MORE))
    assert (newer.names, newer.known, newer.excluded) == (("a", "b"), ("a",), ("c",))
    assert newer.verdict == "good" and newer.sound_speed == 343.0
    assert newer.evidence is not None and newer.evidence.leave_one_out_db == -37.5
    (row,) = Calibration.from_json(json.dumps(TABLES["full"] | {"given_positions": [GIVEN]})).channels.given
    assert (row.name, row.given, row.sigma, row.wrong) == ("a", (0.1, 0.2), 0.1, False)


DETAIL = {"name": "b", "kind": "dead", "value": None, "unit": "", "partner": None}
MALFORMED = {  # refused values of a key, in a file with the required keys only, with more keys, and with all keys
    "first": {
        "positions": [[1.0, 2.0], [[1.0, 2.0], [3.0]], [[1.0], [2.0]], [["a", "b"]], [[math.nan, 1.0]]],
        "frequencies": [[]], "solver": [3], "seed": [True], "sweeps": [1.5], "cost": [math.inf, 10**400, None],
        "mean_error_m": [-(10**400)], "converged": ["yes"],
    },
    "newer": {
        "uncertainty_m": [[0.1], [0.1, math.nan], [0.1, True]], "known": [None, "a"], "residual_to_noise": [None],
        "verdict": [4], "sound_speed": [math.inf], "names": ["a,b", ["a"], ["a", "a"]], "excluded": [[3]],
        "aligned": [1], "covariance_m2": [[[[1.0]], [[2.0]]]],
    },
    "full": {
        "given_positions": [
            "a", [3], [{"name": "a"}], [GIVEN | {"name": "nobody"}], [GIVEN | {"wrong": 1}], [GIVEN | {"sigma_m": "1"}],
            [GIVEN | {"given_m": [0.1]}], [GIVEN | {"found_m": [0.1, None]}], [GIVEN | {"difference_m": math.inf}],
            [GIVEN | {"more": 1}], [GIVEN | {"given_m": [0.1, 10**400]}],
        ],
        "channel_gain_db": [[0.0]], "channel_noise_db": [[0.0, math.inf]], "channel_phase_sigma_deg": [None],
        "odd_channels": [[3]], "leave_one_out_frequencies_db": [[0.0] * 99],
        "faulty_channel_details": [
            "b", [{"name": "b"}], [DETAIL | {"name": "z"}], [DETAIL | {"value": "2"}], [DETAIL | {"unit": ["dB"]}],
        ],
    },
}  # fmt: skip
TABLES = {"first": LEAST, "newer": LEAST | MORE, "full": WHOLE}
UNWRITTEN = {  # values of a field with which no file is written, in addition to those of its key above
    "solver": [3], "seed": [True], "sweeps": [1.5], "cost": [math.inf, 10**400, None], "converged": ["yes"],
    "positions": [np.array([1.0, 2.0]), np.array([[1.0], [2.0]]), np.array([[math.nan, 1], [0, 0]])],
    "frequencies": [np.array([])], "mean_error": [-(10**400)], "names": [("a",)], "uncertainty": [np.array([0.1])],
    "covariance": [np.zeros((2, 3, 3))],
}  # fmt: skip
KEYS = {"mean_error": "mean_error_m", "uncertainty": "uncertainty_m", "covariance": "covariance_m2"}


def test_a_key_that_is_malformed_or_missing_is_named_and_is_not_written(tmp_path):
    for file, table in TABLES.items():
        for key, values in MALFORMED[file].items():
            for value in values:
                refuses(f'"{key}"', Calibration.from_json, json.dumps(table | {key: value}))
            if file == "first" or key.startswith("channel"):
                with pytest.raises(InputError, match=f'"{key}" is missing'):
                    Calibration.from_json(json.dumps({k: v for k, v in table.items() if k != key}))
    for field, values in UNWRITTEN.items():
        for value in values:
            with pytest.raises(InputError, match=f'"{KEYS.get(field, field)}"'):
                save_result(replace(FULL, **{field: value}), tmp_path / "s.json")
    assert os.listdir(tmp_path) == []


def test_a_file_that_is_not_a_result_is_refused(tmp_path):
    path = tmp_path / "r.json"
    refuses("cannot read", load_result, path)
    for version in (None, 0, 2, "1", [1]):
        with pytest.raises(InputError, match="of this version of fdcal") as refused:
            Calibration.from_json(json.dumps(LEAST | {"fdcal_result": version}))
        assert refused.value.key == "fdcal_result" and "\n" not in str(refused.value)
    for text in ("{", "[1]", json.dumps(LEAST | {"seed": True}), "\udcff"):
        path.write_bytes(text.encode(errors="surrogateescape"))
        refuses(r"r\.json", load_result, path)


# A calibration: its errors against the truth, its frames, and what it can be turned into.


NAMES = ("a", "b", "<script>alert(1)</script>", "d & e")
FOUR_POSITIONS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.1], [0.0, 1.2, 0.2], [1.0, 1.0, 0.7]])


def result(D: int = 3, **changes) -> Calibration:
    covariance = np.array([0, 1e-6, 4e-6, 1e-6])[:, None, None] * np.eye(D)
    values = {"known": ("a",), "verdict": "good", "verdict_text": "1 < 2"}
    values |= {"covariance": covariance, "uncertainty": np.sqrt(np.trace(covariance, axis1=1, axis2=2))}
    return Calibration(FOUR_POSITIONS[:, :D], NAMES, "joint", 0, [50.0, 70.0], 0.1, 3, 1.5, True, **values | changes)


def test_positions_are_given_in_the_axes_of_the_true_positions():
    truth = np.random.default_rng(0).uniform(size=(9, 2))
    measurement = Measurement(np.array([50.0]), np.exp(1j * np.arange(9.0))[None], 343.0, positions=truth)
    plain, turned = replace(result(2), names=tuple("abcdefghi")), truth[:, ::-1] + [3.0, -1.0]
    assert np.array_equal(replace(plain, positions=turned).positions_for(measurement), turned)
    aligned = replace(plain, positions=turned, aligned=True)
    assert np.allclose(aligned.positions_for(measurement), truth)
    assert aligned.compared_with(measurement).max_error == pytest.approx(0, abs=1e-12)
    refuses(r"shape \(4, 2\)", plain.positions_for, measurement)
    refuses("leaves out microphone c", lambda: replace(result(2), excluded=("c",)).positions_for(measurement))


def test_errors_are_of_the_microphones_sought_whose_channels_are_healthy():
    truth = np.random.default_rng(1).uniform(size=(9, 2))
    measurement = Measurement(np.array([50.0]), np.exp(1j * np.arange(9.0))[None], 343.0, positions=truth)
    found = truth + 1e-3 * np.arange(9.0)[:, None] * [1.0, 0.0]
    found[4] += 5.0  # a dead channel
    plain = replace(result(2, uncertainty=None, covariance=None), names=tuple("abcdefghi"), positions=found)
    faults = (ChannelFault("e", "dead"), ChannelFault("h", "misplaced", 0.007, "m"))
    channels, of_all = Channels(*np.zeros((5, 9)), faults), plain.compared_with(measurement)
    assert of_all.mean_error == pytest.approx(np.mean(of_all.errors)) and of_all.max_error > 5
    assert replace(plain, channels=channels).healthy.tolist() == [0, 1, 2, 3, 5, 6, 7, 8]
    some = replace(plain, channels=channels).compared_with(measurement, (7, 8))
    assert some.mean_error == pytest.approx(1e-3 * (1 + 2 + 3 + 5 + 6) / 6) and some.max_error == pytest.approx(6e-3)
    assert some.rms_error == pytest.approx(1e-3 * np.sqrt((1 + 4 + 9 + 25 + 36) / 6))
    assert replace(plain, channels=channels).counted(range(9)).tolist() == [0, 1, 2, 3, 5, 6, 7, 8]
    turned = replace(plain, positions=found[:, ::-1] + [3.0, -1.0], channels=channels, aligned=True)
    assert turned.compared_with(measurement, (7, 8)).max_error < 8e-3, "the alignment omits them, too"
    read = Calibration.from_json(some.to_json())
    assert (read.mean_error, read.rms_error) == (some.mean_error, some.rms_error)


def test_errors_of_an_unconstrained_array_are_those_after_alignment_on_the_page_and_in_the_file():
    """The estimate is the rotated, mirrored and moved truth, one microphone 30 mm off; unaligned, it is metres off."""
    rng = np.random.default_rng(2)
    truth, pressures = rng.uniform(0, 1, (12, 2)), rng.normal(size=(3, 12)) + 1j * rng.normal(size=(3, 12))
    blind = Measurement([100.0, 140.0, 180.0], pressures, 343.0, positions=truth)
    known = replace(blind, known=[0, 1, 2], known_positions=None)
    displaced = truth + np.where(np.arange(12)[:, None] == 4, [0.018, 0.024], 0.0)
    estimate = displaced @ np.array([[0.6, 0.8], [0.8, -0.6]]) + [3.0, -2.0]
    best, errors = np.linalg.norm(align(estimate, truth) - truth, axis=1), blind.errors(estimate)
    np.testing.assert_allclose(errors, best, atol=1e-12)
    assert errors.argmax() == 4 and 0.02 < errors.max() < 0.03
    assert known.errors(estimate).min() > 1, "known microphones say where it stands"
    assert replace(blind, positions=None).errors(estimate) is None
    largest, text = f"{1e3 * best.max():.3g}", error_line(errors, blind.blind)
    assert text.startswith("error: mean") and f"largest {largest} mm, after alignment" in text
    assert "align" not in error_line(known.errors(estimate), known.blind)
    assert f"<td>{largest}</td>" in microphones.position_table(blind, estimate, None, 0, slice(None))
    rows = list(csv.DictReader(io.StringIO(position_table(blind, estimate))))
    columns = np.array([[float(row[key]) for key in ("error_once_aligned_m", "x_m", "y_m")] for row in rows])
    np.testing.assert_allclose(columns, np.column_stack([best, estimate]), rtol=1e-8, atol=1e-12)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 200), st.sampled_from([2, 3]), st.sampled_from(FRAMES))
def test_a_frame_keeps_distances_and_depends_on_nothing_but_them(seed, dimension, frame):
    positions = scattered(seed, dimension)
    placed = in_frame(positions, frame)
    assert np.allclose(pdist(placed), pdist(positions))
    if frame != "known":
        assert np.allclose(in_frame(positions @ turn(seed + 7, dimension) + 3.0, frame), placed, atol=1e-6)
    if frame == "minimal":
        for axis in range(dimension):
            assert np.allclose(placed[axis, axis:], 0) and placed[axis + 1, axis] > 0
        plane = np.column_stack([scattered(seed, 2), np.zeros(20)]) @ turn(3, 3)
        assert np.allclose(in_frame(plane, "minimal")[:, 2], 0, atol=1e-9)
        line = np.outer(np.arange(4.0), [1, 2, 2])
        assert np.allclose(in_frame(line, "minimal"), np.outer(3 * np.arange(4.0), [1, 0, 0]))


def scattered(seed: int, dimension: int, count: int = 20) -> np.ndarray:
    """Positions none of which is close to another, somewhere and turned."""
    rng, axes = np.random.default_rng(seed), np.meshgrid(*[np.arange(5)] * dimension)
    cells = np.stack([a.ravel() for a in axes], axis=1)[rng.permutation(5**dimension)[:count]]
    places = 0.2 * cells + rng.uniform(-0.05, 0.05, (count, dimension))
    return places @ turn(seed, dimension) + rng.normal(size=dimension)


def turn(seed: int, dimension: int) -> np.ndarray:
    return np.linalg.qr(np.random.default_rng(seed + 1).normal(size=(dimension, dimension)))[0]


def test_a_result_is_placed_in_its_frame():
    names = tuple("abcdefghijklmnopqrst")
    result = Calibration(scattered(0, 2), names, "joint", 0, np.array([50.0]), 0.1, 3, 1.5, True, known=("a",))
    assert np.array_equal(placed_in_frame(result, None).positions[:, :2], result.positions)
    assert placed_in_frame(replace(result, known=()), None).frame == "axes"
    with pytest.raises(InputError, match="no microphone was known; use frame minimal or axes"):
        placed_in_frame(replace(result, known=()), "known")
    assert placed_in_frame(replace(result, known=None), None).frame == "known"


def test_an_export_keeps_what_exists_and_refuses_other_suffixes_and_frames(tmp_path):
    result().export(tmp_path / "p.csv")
    for name, frame, words in (
        ("p.csv", None, "exists"), ("p.doc", None, "not a file of"), ("p", None, "not a file of"),
        ("q.csv", "upside down", "frame"),
    ):  # fmt: skip
        refuses(words, result().export, tmp_path / name, frame=frame)


def test_the_table_of_pandas_has_positions_channels_and_given_positions():
    table = result(errors=[0.1, 0.2, 0.3, 0.4]).to_dataframe()
    assert table.columns.tolist() == ["x", "y", "z", "known", "uncertainty", "error"]
    assert table.index.tolist() == list(NAMES) and table["known"].tolist() == [True, False, False, False]
    np.testing.assert_array_equal(table[["x", "y", "z"]].to_numpy(), FOUR_POSITIONS)
    numbers, place = np.arange(20.0).reshape(5, -1), tuple((FOUR_POSITIONS[1] + [0.0, 0.03, 0.04]).tolist())
    given = (GivenPosition(NAMES[1], place, tuple((FOUR_POSITIONS[1] - [0.0, 0.03, 0.04]).tolist()), 0.002, True),)
    table = result(channels=Channels(*numbers, (ChannelFault(NAMES[2], "dead"),), given)).to_dataframe()
    columns = ["gain_db", "gain_sigma_db", "phase_deg", "phase_sigma_deg", "noise_db"]
    np.testing.assert_array_equal(table[columns].to_numpy().T, numbers)
    assert table["fault"].tolist() == ["", "", "dead", ""]
    assert table.loc[NAMES[1], ["given_x", "given_y", "given_z"]].tolist() == list(place)
    assert table.loc[NAMES[1], "given_difference"] == pytest.approx(0.1)
    assert table["given_difference"].isna().tolist() == [True, False, True, True]


def test_without_pandas_the_remedy_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    refuses(r"fdcal\[pandas\]", lambda: result().to_dataframe())


@pytest.mark.parametrize(("D", "panels", "factors"), [(2, 1, iter([2.0])), (3, 2, iter([2.0, 5.0]))])
def test_the_figure_shows_every_microphone_once(D, panels, factors, monkeypatch):
    monkeypatch.setattr("fdcal.graphics.figures.ellipse_scale", lambda *_: next(factors))
    blocks, nominal = np.array(4 * [np.diag([1e-8, 1e-8, 1e-4][:D])]), FOUR_POSITIONS[:, :D] + 0.01
    figure = result(D, covariance=blocks).plot(nominal, "nominal")
    ellipses = [line.get_label() for panel in figure.axes for line in panel.lines if "95 %" in line.get_label()]
    assert len(ellipses) == panels and len(set(ellipses)) == 1, "all panels have the factor that the legend states"
    shown = [line.get_data() for line in figure.axes[0].lines if line.get_label() in ("nominal", "estimate", "known")]
    np.testing.assert_array_equal(np.hstack(shown).T, [*nominal[:, :2], *FOUR_POSITIONS[[1, 2, 3, 0], :2]])
    refuses("shape", lambda: result(D).plot(FOUR_POSITIONS[:, : 5 - D]))


def test_true_positions_are_aligned_with_an_unconstrained_array():
    turned = FOUR_POSITIONS @ np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) + [3.0, -1.0, 2.0]
    for panel, view in zip(result(known=None).plot(turned).axes, ([0, 1], [0, 2]), strict=True):
        (marks,) = (line for line in panel.lines if line.get_label() == "true")
        np.testing.assert_allclose(np.column_stack(marks.get_data()), FOUR_POSITIONS[:, view], atol=1e-12)


def test_the_html_of_a_notebook_escapes_names():
    """It is well-formed, except for tags without an end."""
    text = result()._repr_html_()
    page = ElementTree.fromstring(f"<div>{re.sub('<(img|br)([^>]*)/?>', r'<x/>', text)}</div>")
    assert len(list(page.iter("td"))) == 4 * 6 and not list(page.iter("script")) and "<b>good</b>: 1 &lt; 2" in text
    bare = replace(result(2), covariance=None, uncertainty=None, verdict="", known=None)
    assert "data:image/png;base64," in bare._repr_html_()


@pytest.mark.parametrize("half_axis", [2e-6, 3e-4, 7e-3, 0.03, 0.5])
def test_the_enlargement_is_a_round_number_and_makes_ellipses_visible(half_axis):
    factor = ellipse_scale(half_axis * np.eye(2)[None], 1.0)
    assert factor >= 1 and factor * half_axis >= VISIBLE * 0.999
    assert factor == 1 or factor * half_axis < 2.5 * VISIBLE
    assert f"{factor:.0e}"[0] in "125"
