"""What the plot commands write beside a picture."""

from __future__ import annotations

import pytest

import fdcal
from fdcal.commands.plotting import error_title
from fdcal.model.texts import format_mm

pytestmark = pytest.mark.usefixtures("remembered_runs")


def test_the_title_of_a_snapshot_has_the_errors_that_calibrate_prints():
    measurement = fdcal.load("tiny")
    found = fdcal.calibrate(measurement, modes=12)
    assert found.mean_error > found.errors.mean(), "the known microphones do not count"
    words = f"mean error {format_mm(found.mean_error)}, largest {format_mm(found.max_error)}"
    assert error_title(measurement, found) == words


def test_the_title_of_a_blind_result_says_that_it_was_aligned():
    measurement = fdcal.load("tiny")
    found = fdcal.calibrate(measurement, modes=12, known="none", solver="joint")
    words = f"mean error {format_mm(found.mean_error)}, largest {format_mm(found.max_error)}, after alignment"
    assert error_title(measurement, found) == words
