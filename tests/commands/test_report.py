"""The summary and the titles agree with the result file: one cost, errors and sigma of the same microphones."""

from dataclasses import replace

import numpy as np
import pytest

import fdcal
from fdcal.commands.report import comparison, comparison_text, error_title, summary
from fdcal.model.validation import length_text
from fdcal.session.calibration_run import solve
from fdcal.session.sources import load_input, with_settings

pytestmark = pytest.mark.usefixtures("remembered_runs")


@pytest.fixture(scope="module")
def inputs():
    return with_settings(load_input("tiny"), modes=12)


@pytest.fixture(scope="module")
def found(inputs):
    return solve(inputs)


def line_of(text: str, head: str) -> str:
    (line,) = [line for line in text.splitlines() if line.startswith(head)]
    return line


def test_the_cost_is_in_decibels_and_in_the_file_with_and_without_a_search_domain(inputs, found):
    bare = replace(inputs, measurement=replace(inputs.measurement, search=None))
    for one, result in ((inputs, found), (bare, other := solve(bare))):
        assert f"{result.cost_db:.1f} dB, the unexplained power" in line_of(summary(one, result), "cost")
        assert fdcal.Calibration.from_json(result.to_json()).cost_db == result.cost_db
    assert other.cost_db < -30
    assert "dB (at best minus the SNR; 0 dB: nothing is predicted);" in line_of(summary(inputs, found), "predict")


@pytest.mark.parametrize(("converged", "verdict", "words"), [
    (True, "good", "converged"), (False, "not_converged", "stopped before it converged"), (False, "good", "ended; the"),
])  # fmt: skip
def test_the_words_for_the_end_of_the_run_agree_with_the_verdict(inputs, found, converged, verdict, words):
    line = line_of(summary(inputs, replace(found, converged=converged, verdict=verdict)), "run")
    assert words in line and ("stopped" in line) == (verdict == "not_converged")


def test_error_and_sigma_are_of_the_same_microphones(inputs, found):
    sigma = length_text(float(np.sqrt(np.mean(found.uncertainty[np.setdiff1d(np.arange(16), inputs.given)] ** 2))), 2)
    assert line_of(summary(inputs, found), "error").endswith(f"over the 13 microphones sought; one sigma {sigma}")
    assert f"one sigma {sigma}" in found.verdict_text, "the verdict has the same number"
    unknown = replace(found, mean_error=None, max_error=None, errors=None)
    assert line_of(summary(inputs, unknown), "error").endswith(f"one sigma {sigma}")
    room = replace(inputs, measurement=replace(inputs.measurement, dimension=3), scene=None)
    room = replace(room, radius="0.5 m, <array_radius> sets it")
    assert "one plane; an import with --array-dimension 3 estimates" in line_of(summary(room, found), "array")
    assert line_of(summary(room, found), "radius") == "radius  0.5 m, --array-radius R sets it"


@pytest.mark.parametrize("away", [0.0, 0.1])
def test_distances_without_the_wrong_rows_are_explained_where_they_differ_from_the_errors(inputs, found, away):
    blind = replace(inputs.measurement, known=np.zeros(0, int), known_positions=None)
    places = found.positions + 1e-3 * np.random.default_rng(0).normal(size=found.positions.shape)
    places[3, 0] += away
    moved = replace(inputs, measurement=replace(blind, positions=places))
    result = replace(found, aligned=True, known=()).compared_with(moved.measurement)
    check = comparison(moved, result)
    assert check.fits and ("list, here wrong rows are" in comparison_text(moved, result, check, None)) == (away > 0)


def test_the_title_of_a_snapshot_has_the_errors_that_calibrate_prints(inputs, found):
    sought = [name not in found.known for name in found.names]
    assert found.mean_error == pytest.approx(found.errors[sought].mean()) != found.errors.mean()
    words = f"error: mean {length_text(found.mean_error)}, largest {length_text(found.max_error)}"
    assert error_title(inputs.measurement, found) == words
