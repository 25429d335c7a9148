"""A measured room: the array is found blind, to millimetres, and the verdict is good."""

from __future__ import annotations

import numpy as np

from fdcal.commands.report import summary
from fdcal.model.scene_file import load_scene
from fdcal.session.calibration_run import solve
from fdcal.session.sources import scene_input


def test_the_listening_lab_is_found_blind():
    inputs = scene_input(load_scene("listening_lab"))
    assert inputs.measurement.blind
    result = solve(inputs)
    errors = inputs.measurement.errors(result.positions)
    assert np.sqrt(np.mean(errors**2)) < 4e-3 and errors.max() < 10e-3, "free gains cost a tenth"
    assert result.uncertainty is not None and np.all(errors < 3 * result.uncertainty)
    assert result.verdict == "good"
    assert "modelled between the microphones" in summary(inputs, result)
