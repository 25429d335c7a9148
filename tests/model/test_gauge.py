"""Rigid alignment and position errors."""

import numpy as np
import pytest

from fdcal.model.gauge import align, fixes_gauge, position_errors


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("mirror", [1, -1])
def test_alignment_undoes_any_rigid_motion(dimension, mirror):
    rng = np.random.default_rng(dimension)
    truth = rng.normal(size=(12, dimension))
    Q = np.linalg.qr(rng.normal(size=(dimension, dimension)))[0]
    Q[:, 0] *= mirror
    aligned = align(truth @ Q + rng.normal(size=dimension), truth)
    assert position_errors(aligned, truth) == pytest.approx(0, abs=1e-12)


def test_alignment_does_not_scale():
    truth = np.random.default_rng(0).normal(size=(9, 2))
    assert position_errors(align(2 * truth, truth), truth).max() > 0.1


def test_known_microphones_on_one_line_leave_the_mirror_open():
    line = np.column_stack([np.arange(4.0), 2 * np.arange(4.0)])
    assert not fixes_gauge(line)
    assert not fixes_gauge(line[:2])
    assert fixes_gauge([[0, 0], [1, 0], [0, 1]])
    assert not fixes_gauge([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
