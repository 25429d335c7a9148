"""MATLAB's .mat with an impulse response from the spatial decomposition method: one point, a direction for each sample.

It has no channels of its own: those of an array are rendered at given positions. The response is measured; the field
between the microphones is modelled (`fdcal.acoustics.plane_waves`).
"""

from pathlib import Path

import numpy as np

from ...acoustics.plane_waves import MAX_FREQUENCY, plane_wave_responses
from ...model.room import MEASURED_AND_MODELLED
from ...model.sdm_response import load_sdm_response
from ...model.validation import InputError
from ..recording import Recording, recording_of
from . import Format


def _read(path: Path, source: int | None = None) -> Recording:
    """Raise InputError: the file has no channels."""
    load_sdm_response(path)  # a damaged file is reported first
    problem = f"{path} is an impulse response at one point, with directions, and has no channels"
    raise InputError(problem, "import it with <array>, the positions at which to render them", key="array")


def _render(path: Path, names: tuple[str, ...], positions: np.ndarray, sound_speed: float) -> Recording:
    """Return what an array (N, 3), metres from the point of the measurement, would record from the direct sound on."""
    response = load_sdm_response(path)
    return recording_of(
        str(path),
        "impulse",
        response.sample_rate,
        plane_wave_responses(response, positions, sound_speed),
        names=names,
        positions=positions,
        highest=MAX_FREQUENCY * response.sample_rate,
        modelled=MEASURED_AND_MODELLED,
    )


FORMATS = (Format((".mat",), read=_read, render=_render),)
