"""The function `fdcal.landscape`: the cost of moving one microphone of a measurement."""

from __future__ import annotations

from collections.abc import Sequence

from ..assessment.calibration import Calibration
from ..cost.maps import LandscapePanels, landscape_panels
from ..model.measurement import Measurement, microphone_index
from ..model.settings import SolverSettings
from ..model.validation import InputError, shown_literal
from .api import mode_numbers, require_measurement, require_settings
from .process import one_blas_thread


def landscape(
    measurement: Measurement,
    microphone: str | int,
    modes: Sequence[int] = (1, 5, 9),
    *,
    calibration: Calibration | None = None,
    settings: SolverSettings | None = None,
) -> LandscapePanels:
    """Return the cost of moving one microphone, mode by mode and summed.

    The cost is Eq. 7; drawn, it is the paper's Fig. 1.

    Parameters
    ----------
    measurement : Measurement
        Of a two-dimensional field, with a search domain.
    microphone : str or int
        Name, or number counted from 0.
    modes : sequence of int
        Counted from 1.
    calibration : Calibration, optional
        Where the other microphones are; at their true positions unless given.
    settings : SolverSettings, optional
        For `weights` and `order_offset`, such as those of a scene (`scene.solver`).

    Returns
    -------
    LandscapePanels
        `maps` (P + 1, ny, nx), the last their sum; `minima` (P + 1, 2), metres; `plot()` draws them.

    Raises
    ------
    InputError
        A microphone or mode does not exist, no positions are known, or there is no search domain.

    Examples
    --------
    >>> import fdcal
    >>> panels = fdcal.landscape(fdcal.load("tiny"), 3, modes=[1, 2, 3])
    >>> panels.maps.shape
    (4, 25, 25)
    """
    require_measurement(measurement, "landscape")
    require_settings(settings)
    settings, used = settings or SolverSettings(), mode_numbers(modes, len(measurement.frequencies))
    n = microphone_index(str(microphone), measurement.names, "microphone")
    if calibration is not None and not isinstance(calibration, Calibration):
        problem = f"calibration = {shown_literal(calibration)} is none"
        raise InputError(problem, "give what fdcal.calibrate returns", key="calibration", value=calibration)
    positions = measurement.positions if calibration is None else calibration.positions_for(measurement)
    if positions is None:
        raise InputError(
            "the measurement holds no true positions", "give the calibration that found the others", key="calibration"
        )
    with one_blas_thread():
        return landscape_panels(measurement.problem(settings.weights), positions, n, used, settings.order_offset)
