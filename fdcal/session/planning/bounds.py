"""Information of a request's frequencies in a diffuse field: of all of them, or of a few that stand for them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...assessment.bound import Information, diffuse_information, position_bound
from .request import LIMITS, PlanRequest


def request_information(request: PlanRequest) -> Information:
    """Return the information of all frequencies and takes of a request on its array, in a diffuse field.

    The fields of two takes are independent draws, so that each adds as much as the first.
    """
    used = request.spaced(LIMITS.most_frequencies)
    k = 2 * np.pi * used / request.sound_speed
    found = diffuse_information(request.layout.positions, k, request.noise_share, request.dimension)
    return found.scaled(request.takes * len(request.frequencies) / len(used))


def sparse_information(request: PlanRequest, positions, share: float | None = None) -> Information:
    """Return the information of a few frequencies, scaled to all of them.

    `positions` (N, D) float64, metres, in place of those of the request; `share`: power of the noise in that of the
    pressures, that of the request unless given.
    """
    used = request.spaced(LIMITS.search_frequencies)
    share = request.noise_share if share is None else share
    k = 2 * np.pi * used / request.sound_speed
    found = diffuse_information(positions, k, share, request.dimension)
    return found.scaled(request.takes * len(request.frequencies) / len(used))


def rms_at(request: PlanRequest, snr_db: float) -> float:
    """Return the bound at another signal-to-noise ratio, dB: root mean square, metres."""
    noise = 10 ** (-snr_db / 10)
    found = sparse_information(request, request.layout.positions, noise / (1 + noise))
    return position_bound(found, request.prior).rms


TAKES = (1, 2, 4, 8)  # numbers of takes that a plan compares, and its own


@dataclass(frozen=True)
class TakesCase:
    """The bound with several places of the source, or with a longer recording from one: root mean square, metres."""

    takes: int  # places of the source
    rms: float  # each recorded for as long as one
    shared: float  # all of them together recorded for as long as one, each at a lower signal-to-noise ratio
    longer: float  # one place, recorded `takes` times as long, at a higher signal-to-noise ratio


def takes_cases(request: PlanRequest) -> tuple[TakesCase, ...]:
    """Return what more places of the source bring, and what a longer recording from one place brings instead.

    A recording that is n times as long has a signal-to-noise ratio higher by 10 log10 n dB, the noise being steady.
    """
    return tuple(
        TakesCase(
            takes,
            rms_at(replace(request, takes=takes), request.snr_db),
            rms_at(replace(request, takes=takes), request.snr_db - 10 * np.log10(takes)),
            rms_at(replace(request, takes=1), request.snr_db + 10 * np.log10(takes)),
        )
        for takes in sorted({*TAKES, request.takes})
    )
