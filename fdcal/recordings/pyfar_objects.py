"""Objects of pyfar: its signals and frequency data in, its coordinates out. Needs the extra "pyfar"."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..assessment.calibration import Calibration, placed_in_frame
from ..model.measurement import Measurement
from ..model.validation import InputError
from .formats import needs
from .import_options import ImportOptions
from .importer import measurement_of_recording
from .recording import recording_of

FLAT = 1e-6  # metres: heights that differ less are one height


def measurement_of_pyfar(data, coordinates=None, **options: Any) -> Measurement:
    """Return the measurement of an object of pyfar.

    Parameters
    ----------
    data : pyfar.FrequencyData or pyfar.Signal
        One channel a microphone. Of frequency data, all frequencies are taken as they are; of a signal they are
        chosen as for a recording.
    coordinates : pyfar.Coordinates, optional
        Positions of the microphones, to compare with.
    **options
        Of frequency data, as of `from_arrays`; of a signal, fields of
        `fdcal.recordings.import_options.ImportOptions`.

    Returns
    -------
    Measurement

    Raises
    ------
    InputError
        A value is impossible.

    Examples
    --------
    >>> import fdcal, pyfar
    >>> import numpy as np
    >>> data = pyfar.FrequencyData(np.exp(1j * np.arange(12.0)).reshape(4, 3), [100, 150, 210])
    >>> fdcal.Measurement.from_pyfar(data).count
    4
    """
    pyfar = needs("pyfar", "pyfar")
    positions = None if coordinates is None else np.asarray(coordinates.cartesian, float).reshape(-1, 3)
    if isinstance(data, pyfar.Signal):
        samples = data.time.reshape(-1, data.n_samples)
        recording = recording_of("the signal", None, data.sampling_rate, samples, positions=positions)
        return measurement_of_recording(recording, ImportOptions(**options))[0]
    if not isinstance(data, pyfar.FrequencyData):
        raise InputError(f"{type(data).__name__} is no FrequencyData and no Signal of pyfar", "give one of them")
    flat = options.get("dimension", 3) == 2
    if positions is not None and flat:
        positions = _without_height(positions)
    pressures = data.freq.reshape(-1, data.n_bins).T
    return Measurement.from_arrays(data.frequencies, pressures, positions=positions, **options)


def _without_height(positions: np.ndarray) -> np.ndarray:
    if np.ptp(positions[:, 2]) > FLAT:
        raise InputError("a field of two dimensions needs microphones of one height", "leave out <dimension>")
    return positions[:, :2]


def pyfar_coordinates(self: Calibration, *, frame: str | None = None) -> Any:
    """Return the positions as `pyfar.Coordinates`; needs the extra "pyfar".

    Parameters
    ----------
    frame : str, optional
        As of `export`.

    Returns
    -------
    pyfar.Coordinates

    Examples
    --------
    >>> import fdcal
    >>> fdcal.calibrate(fdcal.load("tiny"), modes=12).to_pyfar().cshape
    (16,)
    """
    pyfar, placed = needs("pyfar", "pyfar"), placed_in_frame(self, frame)
    return pyfar.Coordinates(*placed.positions.T.copy(), comment=f"microphones {', '.join(placed.names)}")
