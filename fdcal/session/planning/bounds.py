"""Information of a request's frequencies in a diffuse field: of all of them, or of a few that stand for them."""

from __future__ import annotations

import numpy as np

from ...assessment.bound import Information, diffuse_information, position_bound
from .request import LIMITS, PlanRequest


def request_information(request: PlanRequest) -> Information:
    """Return the information of all frequencies of a request on its array, in a diffuse field."""
    used = request.spaced(LIMITS.most_frequencies)
    k = 2 * np.pi * used / request.sound_speed
    found = diffuse_information(request.layout.positions, k, request.noise_share, request.dimension)
    return found.scaled(len(request.frequencies) / len(used))


def sparse_information(request: PlanRequest, positions, share: float | None = None) -> Information:
    """Return the information of a few frequencies, scaled to all of them.

    Parameters
    ----------
    request : PlanRequest
    positions : (N, D) float64, metres, in place of those of the request
    share : float, optional
        Power of the noise in that of the pressures, that of the request unless given.
    """
    used = request.spaced(LIMITS.search_frequencies)
    share = request.noise_share if share is None else share
    k = 2 * np.pi * used / request.sound_speed
    found = diffuse_information(positions, k, share, request.dimension)
    return found.scaled(len(request.frequencies) / len(used))


def rms_at(request: PlanRequest, snr_db: float) -> float:
    """Return the bound at another signal-to-noise ratio, dB: root mean square, metres."""
    noise = 10 ** (-snr_db / 10)
    found = sparse_information(request, request.layout.positions, noise / (1 + noise))
    return position_bound(found, request.prior).rms
