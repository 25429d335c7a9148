"""Which signal-to-noise ratio, and which size of the array, reach the accuracy that is wanted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...assessment.bound import position_bound
from ...model.validation import InputError
from .bounds import rms_at, sparse_information
from .request import PlanRequest


@dataclass(frozen=True)
class AccuracyRules:
    """When an accuracy counts as reached."""

    # error of a calibration over the bound, unless trials have shown another: what simulated calibrations by the solver
    # "robust" in two-dimensional rooms and in diffuse fields stay below, in the median of some draws
    margin: float = 1.5
    # likewise for a plane array in a room of three dimensions. Its size follows from equally strong waves from all
    # directions, which the bound assumes and no room has.
    plane_margin: float = 4.0
    # dB, greatest ratio that is proposed. Channels that are equal to 0.1 dB and 0.5 degrees err by as much as noise 38
    # dB below the signal, so that less noise is of no use.
    most_snr_db: float = 40.0
    # of the logarithm of the error over that of the noise's amplitude. Where it is below, twice as long a recording
    # lowers the error by less than an eighth: noise is not what limits it.
    least_slope: float = 0.4
    # factors on the size of the array that are tried beside its own
    sizes: tuple[float, ...] = (0.35, 0.5, 0.71, 1.41, 2.0, 2.83)


RULES = AccuracyRules()
LEAST_SNR_DB, SNR_STEP_DB = 0.1, 0.1  # of the search for the ratio
SLOPE_DB = 3.0  # to both sides of a ratio, over which the slope is taken


@dataclass(frozen=True)
class AccuracyAdvice:
    """What reaches the accuracy that is wanted."""

    # error of a calibration over the bound that is reckoned with; infinite where most trials were refused
    margin: float
    snr_db: float | None  # dB, least signal-to-noise ratio that reaches it; None if none does
    # the recording's length over the present one that gives this ratio with steady noise
    recording_factor: float | None
    sizes: np.ndarray  # (S, 2) float64, factor on the size of the array and the bound, metres
    size: float | None  # largest factor on the size of the array that reaches it; None if none does


def accuracy_advice(request: PlanRequest, margin: float | None = None) -> AccuracyAdvice:
    """Return what reaches the accuracy of a request.

    `margin`: error of a calibration over the bound, as trials have shown it.
    """
    margin, sizes = usual_margin(request) if margin is None else margin, sizes_of(request)
    if not np.isfinite(margin):
        return AccuracyAdvice(margin, None, None, sizes, None)
    snr = needed_snr(request, margin)
    factor = None if snr is None else 10 ** ((snr - request.snr_db) / 10)
    return AccuracyAdvice(margin, snr, factor, sizes, largest_size(sizes, request.accuracy / margin))


def usual_margin(request: PlanRequest) -> float:
    """Return the error of a calibration over the bound that is reckoned with where no trials have shown it."""
    return RULES.plane_margin if request.is_plane_in_room else RULES.margin


def needed_snr(request: PlanRequest, margin: float) -> float | None:
    """Return the least ratio, dB, at which `margin` times the bound is as low as the accuracy that is wanted.

    None where no ratio in use reaches it, or where the error hardly depends on noise there.
    """
    wanted = request.accuracy / margin
    low, high = LEAST_SNR_DB, RULES.most_snr_db
    if rms_at(request, high) > wanted:
        return None
    while high - low > SNR_STEP_DB:
        middle = (low + high) / 2
        low, high = (low, middle) if rms_at(request, middle) <= wanted else (middle, high)
    below, above = rms_at(request, high - SLOPE_DB), rms_at(request, high + SLOPE_DB)
    slope = np.log(below / above) / np.log(10 ** (2 * SLOPE_DB / 20))
    return high if slope >= RULES.least_slope else None


def sizes_of(request: PlanRequest) -> np.ndarray:
    """Return factors on the size of the array and its bound : (S, 2) float64.

    A band that was given stays, but for frequencies that the enlarged array cannot interpolate; without one, every
    array has the band that it can interpolate.
    """
    rows = [(1.0, position_bound(sparse_information(request, request.layout.positions), request.prior).rms)]
    for factor in RULES.sizes:
        try:
            other = resized(request, factor)
        except InputError:  # its band holds too few frequencies
            continue
        rows.append((factor, position_bound(sparse_information(other, other.layout.positions), request.prior).rms))
    return np.array(sorted(rows))


def resized(request: PlanRequest, factor: float) -> PlanRequest:
    """Return `request` with an array that is `factor` times as large.

    Raises InputError: the band of this array holds too few frequencies.
    """
    x = request.layout.positions
    scaled = x.mean(axis=0) + factor * (x - x.mean(axis=0))
    return replace(request, layout=replace(request.layout, positions=scaled))


def largest_size(sizes: np.ndarray, bound: float) -> float | None:
    """Return the largest factor at which the array has a bound, metres, between those of `sizes_of`; None without."""
    factors, rms = np.log(sizes).T
    below = np.flatnonzero(rms <= np.log(bound))
    if not len(below):
        return None
    i = int(below[-1])
    if i == len(sizes) - 1:
        return float(sizes[i, 0])
    share = (np.log(bound) - rms[i]) / (rms[i + 1] - rms[i])
    return float(np.exp(factors[i] + share * (factors[i + 1] - factors[i])))
