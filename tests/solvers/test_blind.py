"""An array of which no microphone is known: errors are those after the best motion of the whole, and it is said so.

The estimate here is the truth turned, mirrored and moved, one microphone displaced by 30 mm. As it stands, errors would
be metres.
"""

import csv
import dataclasses
import io

import numpy as np
import pytest

from fdcal.assessment.result_file import position_table
from fdcal.assessment.words import error_line
from fdcal.model.gauge import align
from fdcal.model.measurement import Measurement
from fdcal.viewer.tabs import microphones

RNG = np.random.default_rng(2)
TRUTH = RNG.uniform(0, 1, (12, 2))
PRESSURES = RNG.normal(size=(3, 12)) + 1j * RNG.normal(size=(3, 12))


@pytest.fixture
def blind():
    return Measurement([100.0, 140.0, 180.0], PRESSURES, 343.0, positions=TRUTH)


@pytest.fixture
def estimate():
    displaced = TRUTH.copy()
    displaced[4] += [0.018, 0.024]
    turn = np.array([[0.6, 0.8], [0.8, -0.6]])  # mirrored, too
    return displaced @ turn + [3.0, -2.0]


def best(estimate):
    return np.linalg.norm(align(estimate, TRUTH) - TRUTH, axis=1)


def test_errors_do_not_count_where_the_whole_stands(blind, estimate):
    errors = blind.errors(estimate)
    np.testing.assert_allclose(errors, best(estimate), atol=1e-12)
    assert errors.argmax() == 4 and 0.02 < errors.max() < 0.03
    known = dataclasses.replace(blind, known=[0, 1, 2], known_positions=None)
    assert known.errors(estimate).min() > 1, "known microphones say where it stands"
    assert dataclasses.replace(blind, positions=None).errors(estimate) is None


def test_the_page_and_files_say_so(blind, estimate):
    largest = f"{1e3 * best(estimate).max():.3g}"
    text = error_line(blind.errors(estimate), blind.blind)
    assert text.startswith("error: mean") and f"largest {largest} mm, after alignment" in text
    assert f"<td>{largest}</td>" in microphones.position_table(blind, estimate, None, 0)
    known = dataclasses.replace(blind, known=[0, 1, 2], known_positions=None)
    assert "align" not in error_line(known.errors(estimate), known.blind)
    rows = list(csv.DictReader(io.StringIO(position_table(blind, estimate))))
    columns = np.array([[float(row[key]) for key in ("error_once_aligned_m", "x_m", "y_m")] for row in rows])
    np.testing.assert_allclose(columns[:, 0], best(estimate), atol=1e-12)
    np.testing.assert_allclose(columns[:, 1:], estimate, rtol=1e-8)
