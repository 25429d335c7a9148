"""A measured room: the array is found blind, to millimetres, and the verdict is good."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from fdcal.commands.report import summary
from fdcal.model.scene_file import load_scene
from fdcal.session.calibration_run import solve
from fdcal.session.sources import scene_input


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_the_listening_lab_is_found_blind(seed):
    inputs = scene_input(dataclasses.replace(load_scene("listening_lab"), seed=seed))
    assert inputs.measurement.blind
    result = solve(inputs)
    errors = inputs.measurement.errors(result.positions)
    assert np.sqrt(np.mean(errors**2)) < 4e-3 and errors.max() < 10e-3, "free gains cost a tenth"
    assert result.uncertainty is not None and np.all(errors < 3 * result.uncertainty)
    assert result.verdict == "good"
    assert "modelled between the microphones" in summary(inputs, result)
