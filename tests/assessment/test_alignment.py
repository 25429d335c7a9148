"""Frames leave every distance as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import pdist

from fdcal.assessment.calibration import FRAMES, Calibration, in_frame, placed_in_frame
from fdcal.model.validation import InputError


def array(seed: int, dimension: int, count: int = 20) -> np.ndarray:
    """Positions none of which is close to another, somewhere and turned."""
    rng = np.random.default_rng(seed)
    axes = np.meshgrid(*[np.arange(5)] * dimension)
    cells = np.stack([a.ravel() for a in axes], axis=1)[rng.permutation(5**dimension)[:count]]
    return (0.2 * cells + rng.uniform(-0.05, 0.05, (count, dimension))) @ turn(seed, dimension) + rng.normal(
        size=dimension
    )


def turn(seed: int, dimension: int) -> np.ndarray:
    return np.linalg.qr(np.random.default_rng(seed + 1).normal(size=(dimension, dimension)))[0]


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 200), st.sampled_from([2, 3]), st.sampled_from(FRAMES))
def test_a_frame_keeps_every_distance(seed, dimension, frame):
    positions = array(seed, dimension)
    assert np.allclose(pdist(in_frame(positions, frame)), pdist(positions))


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 200), st.sampled_from([2, 3]), st.sampled_from(["minimal", "axes"]))
def test_a_frame_of_the_array_does_not_depend_on_where_it_was(seed, dimension, frame):
    positions = array(seed, dimension)
    moved = positions @ turn(seed + 7, dimension) + 3.0
    assert np.allclose(in_frame(moved, frame), in_frame(positions, frame), atol=1e-6)


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 50))
def test_the_minimal_frame_is_as_documented(seed):
    placed = in_frame(array(seed, 3), "minimal")
    assert np.allclose(placed[0], 0)
    assert np.allclose(placed[1, 1:], 0)
    assert np.allclose(placed[2, 2], 0)
    assert placed[1, 0] > 0
    assert placed[2, 1] > 0
    assert placed[3, 2] > 0


def test_a_line_or_plane_of_microphones_has_a_minimal_frame():
    line = np.outer(np.arange(4.0), [1, 2, 2])
    assert np.allclose(in_frame(line, "minimal"), np.outer(3 * np.arange(4.0), [1, 0, 0]))
    plane = np.column_stack([array(1, 2), np.zeros(20)]) @ turn(3, 3)
    assert np.allclose(in_frame(plane, "minimal")[:, 2], 0, atol=1e-9)


def test_a_result_is_placed_in_its_frame():
    names = tuple("abcdefghijklmnopqrst")
    result = Calibration(array(0, 2), names, "joint", 0, np.array([50.0]), 0.1, 3, 1.5, True, known=("a",))
    assert np.array_equal(placed_in_frame(result, None).positions[:, :2], result.positions)
    assert placed_in_frame(replace(result, known=()), None).frame == "axes"
    with pytest.raises(InputError, match="no microphone was known; use frame minimal or axes"):
        placed_in_frame(replace(result, known=()), "known")
    assert placed_in_frame(replace(result, known=None), None).frame == "known"
