"""The uncertainty of each estimated position and what is known of the channels, as the page shows them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...assessment.calibration import Channels
from ...assessment.uncertainty import confidence_factor, ellipse_axes
from ...session.calibrate import Assessment


@dataclass(frozen=True)
class PositionUncertainty:
    """Uncertainty of N positions."""

    axes: np.ndarray  # (N, D, D) float64, metres, half axes of the 95 % ellipses in rows, the longest last
    sigma: np.ndarray  # (N,) float64, metres, one standard deviation
    # verdict, text: the verdict and its message
    verdict: str = ""
    text: str = ""
    channels: Channels | None = None  # of a solver that finds the gains of the channels, or None


def uncertainty_of(found: Assessment | None) -> PositionUncertainty | None:
    """Return the uncertainty at the end of a run, None before it and where it cannot be determined.

    In a known room each position has images; their ellipses are not drawn.

    `found`: Assessment of the state on the screen, or None.
    """
    if found is None or found.room is not None or not np.isfinite(found.covariance).all():
        return None
    axes = ellipse_axes(found.covariance, confidence_factor(0.95, found.covariance.shape[-1]))
    return PositionUncertainty(axes, found.uncertainty, found.verdict, found.verdict_text, found.channels)
