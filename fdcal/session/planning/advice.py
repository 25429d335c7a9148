"""What would improve a calibration, with numbers: one more microphone, a tape measure, less noise, another size."""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...assessment.uncertainty import Bound, Information, Prior, aligned_rms, position_bound
from ...model.gauge import fixes_gauge
from ...model.validation import InputError
from .bounds import arrival_matrices, forecast, information_at, sparse_information
from .request import ASSUMED, PlanRequest


@dataclass(frozen=True)
class AccuracyRules:
    """When an accuracy counts as reached."""

    # dB, greatest ratio that is proposed. Channels that are equal to 0.1 dB and 0.5 degrees err by as much as noise 38
    # dB below the signal, so that less noise is of no use.
    max_snr_db: float = 40.0
    # of the logarithm of the error over that of the noise's amplitude. Where it is below, twice as long a recording
    # lowers the error by less than an eighth: noise is not what limits it.
    min_slope: float = 0.4
    # factors on the size of the array that are tried beside its own
    sizes: tuple[float, ...] = (0.35, 0.5, 0.71, 1.41, 2.0, 2.83)


ACCURACY_RULES = AccuracyRules()
MIN_SNR_DB, SNR_STEP_DB = 0.1, 0.1  # of the search for the ratio
SLOPE_DB = 3.0  # to both sides of a ratio, over which the slope is taken


@dataclass(frozen=True)
class AccuracyAdvice:
    """What reaches the accuracy that is wanted."""

    # error of a calibration over the bound that is reckoned with, of the request as it is; infinite where most trials
    # were refused
    margin: float
    snr_db: (
        float | None
    )  # dB, least signal-to-noise ratio that reaches it; None if none does, or if noise hardly matters there
    quiet_rms: float  # metres, error that is reckoned with at the greatest ratio that is proposed
    # the recording's length over the present one that gives this ratio with steady noise
    recording_factor: float | None
    sizes: np.ndarray  # (S, 2) float64, factor on the size of the array and the bound, metres
    size: float | None  # largest factor on the size of the array that reaches it; None if none does


def accuracy_advice(request: PlanRequest, margin: float | None = None) -> AccuracyAdvice:
    """Return what reaches the accuracy of a request; `margin`: error over the bound, of trials.

    Without a margin the error of each ratio and size is forecast: arrival times do not change with noise.
    """
    arrivals = arrival_matrices(request) if margin is None else ()

    def error_at(snr_db: float) -> float:
        information = information_at(request, snr_db)
        bound = position_bound(information, request.prior)
        return reckoned_margin(request, information, bound, margin, arrivals) * bound.rms

    factors, bounds, errors = sizes_of(request, margin).T
    own = int(np.flatnonzero(factors == 1)[0])
    snr = needed_snr(request.accuracy, error_at)
    return AccuracyAdvice(
        margin=float(errors[own] / bounds[own]),
        snr_db=snr,
        quiet_rms=error_at(ACCURACY_RULES.max_snr_db),
        recording_factor=None if snr is None else 10 ** ((snr - request.snr_db) / 10),
        sizes=np.column_stack([factors, bounds]),
        size=largest_size(np.column_stack([factors, errors]), request.accuracy),
    )


def reckoned_margin(
    request: PlanRequest,
    information: Information,
    bound: Bound,
    margin: float | None,
    arrivals: tuple[np.ndarray, ...] | None = None,
) -> float:
    """Return the error over the bound that is reckoned with: `margin`, or that of the forecast without one."""
    return forecast(request, information, bound, arrivals).margin if margin is None else margin


def needed_snr(wanted: float, error_at: Callable[[float], float]) -> float | None:
    """Return the least ratio, dB, at which `error_at` it, metres, is as low as the accuracy that is wanted, metres.

    None where no ratio in use reaches it, or where the error hardly depends on noise there.
    """
    low, high = MIN_SNR_DB, ACCURACY_RULES.max_snr_db
    if error_at(high) > wanted:
        return None
    while high - low > SNR_STEP_DB:
        middle = (low + high) / 2
        low, high = (low, middle) if error_at(middle) <= wanted else (middle, high)
    below, above = error_at(high - SLOPE_DB), error_at(high + SLOPE_DB)
    slope = np.log(below / above) / np.log(10 ** (2 * SLOPE_DB / 20))
    return high if slope >= ACCURACY_RULES.min_slope else None


def sizes_of(request: PlanRequest, margin: float | None) -> np.ndarray:
    """Return factors on the size of the array, its bound and the error that is reckoned with : (S, 3) float64.

    A band that was given stays, but for frequencies that the enlarged array cannot interpolate; without one, every
    array has the band that it can interpolate.
    """
    rows = []
    for factor in (1.0, *ACCURACY_RULES.sizes):
        # the band of such an array holds too few frequencies, or it does not fit into the room of its arrival times
        with contextlib.suppress(InputError):
            other = request if factor == 1 else resized(request, factor)
            information = sparse_information(other, other.layout.positions)
            bound = position_bound(information, request.prior)
            rows.append((factor, bound.rms, bound.rms * reckoned_margin(other, information, bound, margin)))
    return np.array(sorted(rows))


def resized(request: PlanRequest, factor: float) -> PlanRequest:
    """Return `request` with an array that is `factor` times as large."""
    x = request.layout.positions
    scaled = x.mean(axis=0) + factor * (x - x.mean(axis=0))
    return replace(request, layout=replace(request.layout, positions=scaled))


def largest_size(sizes: np.ndarray, wanted: float) -> float | None:
    """Return the largest factor at which the array has an error that is wanted, metres; None without.

    `sizes` (S, 2): factors, ascending, and errors, metres, between which it is interpolated.
    """
    factors, rms = np.log(sizes).T
    below = np.flatnonzero(rms <= np.log(wanted))
    if not len(below):
        return None
    i = int(below[-1])
    if i == len(sizes) - 1:
        return float(sizes[i, 0])
    share = (np.log(wanted) - rms[i]) / (rms[i + 1] - rms[i])
    return float(np.exp(factors[i] + share * (factors[i + 1] - factors[i])))


@dataclass(frozen=True)
class AdviceRules:
    """How the advice is searched for."""

    lattice: int = 15  # places along each side of the map of one more microphone
    lattice_3d: int = 9  # likewise in space, for each of its layers
    layers: int = 3  # layers of heights in space
    margin: float = 0.25  # of the map round the array, relative to the array's extent
    spacing: float = 0.3  # least distance of one more microphone from the others, relative to their median spacing
    swaps: int = 4  # rounds in which measured microphones are exchanged for better ones


ADVICE_RULES = AdviceRules()


@dataclass(frozen=True)
class ExtraMicrophone:
    """Where one more microphone helps the others most."""

    places: np.ndarray  # (..., D) float64, metres, lattice of candidates
    rms: np.ndarray  # (...) float64, metres, bound of the present microphones with one there; NaN too close to another
    own_sigma: np.ndarray  # (...) float64, metres, bound of the microphone that is added
    best: np.ndarray  # (D,) float64, metres
    # best_rms, before: metres, of the present microphones
    best_rms: float
    before: float


@dataclass(frozen=True)
class TapeMeasure:
    """The microphones that are best measured by tape."""

    microphones: tuple[int, ...]  # (A,) tuple of int
    sigma: float  # metres, of each measured coordinate
    # rms, usual_rms: metres, bound of all others in the frame of the tape, and the median over other choices
    rms: float
    usual_rms: float
    # shape_rms, shape_before: metres, bound of the shape of the array with the tape and without given positions: of all
    # microphones after the best rigid motion
    shape_rms: float
    shape_before: float


@dataclass(frozen=True)
class Advice:
    """What would improve a calibration."""

    extra: ExtraMicrophone
    tape: TapeMeasure
    accuracy: AccuracyAdvice


def advise(request: PlanRequest, information: Information, margin: float | None) -> Advice:
    """Return the advice for a request, from the information of all its frequencies; `margin`: of `accuracy_advice`."""
    return Advice(best_addition(request), best_tape(request, information), accuracy_advice(request, margin))


def best_addition(request: PlanRequest) -> ExtraMicrophone:
    """Return the bound with one more microphone, for a lattice of places in and round the array."""
    x, prior = request.layout.positions, request.prior
    places = _lattice(x)
    flat = places.reshape(-1, x.shape[1])
    apart = np.linalg.norm(x[:, None] - x[None], axis=-1) + 1e9 * np.eye(len(x))
    least = ADVICE_RULES.spacing * float(np.median(apart.min(axis=1)))
    rms, own = np.full(len(flat), np.nan), np.full(len(flat), np.nan)
    for i, place in enumerate(flat):
        if np.linalg.norm(x - place, axis=1).min() < least:
            continue
        bound = position_bound(sparse_information(request, np.vstack([x, place])), prior)
        rms[i] = np.sqrt(np.mean(bound.sigma[:-1][bound.free[:-1]] ** 2))
        own[i] = bound.sigma[-1]
    before = position_bound(sparse_information(request, x), prior).rms
    shape = places.shape[:-1]
    best = flat[np.nanargmin(rms)]
    return ExtraMicrophone(places, rms.reshape(shape), own.reshape(shape), best, float(np.nanmin(rms)), before)


def _lattice(x: np.ndarray) -> np.ndarray:
    """Return candidate places (ny, nx, 2), or (nz, ny, nx, 3), metres."""
    low, high = x.min(axis=0), x.max(axis=0)
    margin = ADVICE_RULES.margin * float((high - low).max())
    low, high = low - margin, high + margin
    flat = x.shape[1] == 2
    count = ADVICE_RULES.lattice if flat else ADVICE_RULES.lattice_3d
    across, along = np.meshgrid(*(np.linspace(low[a], high[a], count) for a in range(2)))
    if flat:
        return np.stack([across, along], axis=-1)
    heights = np.linspace(low[2] + margin, high[2] - margin, ADVICE_RULES.layers)
    return np.stack([np.stack([across, along, np.full_like(across, z)], axis=-1) for z in heights])


def best_tape(request: PlanRequest, information: Information) -> TapeMeasure:
    """Return the D + 1 microphones that, measured by tape, determine the others best.

    Beginning with microphones far apart, each is exchanged for the one that lowers the bound most.
    """
    x = request.layout.positions
    count = x.shape[1] + 1
    chosen = _far_apart(x, count)
    least = _tape_rms(request, information, chosen)
    for _ in range(ADVICE_RULES.swaps):
        before = least
        for i in range(count):
            for n in range(len(x)):
                trial = [*chosen[:i], n, *chosen[i + 1 :]]
                rms = _tape_rms(request, information, trial) if n not in chosen else np.inf
                if rms < least * (1 - 1e-9):
                    chosen, least = trial, rms
        if least == before:
            break
    rng = np.random.default_rng(request.seed)
    usual = [_tape_rms(request, information, rng.choice(len(x), count, replace=False).tolist()) for _ in range(40)]
    sigma, taken = ASSUMED.tape_sigma_m, tuple(sorted(chosen))
    shapes = [aligned_rms(information, _with_tape(request, known)) for known in (taken, ())]
    return TapeMeasure(taken, sigma, least, float(np.median(usual)), *shapes)


def _tape_rms(request: PlanRequest, information: Information, chosen: list[int]) -> float:
    x = information.positions
    if not fixes_gauge(x[chosen]):
        return np.inf
    return position_bound(information, _with_tape(request, chosen)).rms


def _with_tape(request: PlanRequest, known: Sequence[int]) -> Prior:
    """Return the prior of a request with the positions of some microphones from a tape measure."""
    return replace(request.prior, known=np.array(known, int), known_sigma=ASSUMED.tape_sigma_m)


def _far_apart(x: np.ndarray, count: int) -> list[int]:
    chosen = [int(np.argmax(np.linalg.norm(x - x.mean(axis=0), axis=1)))]
    while len(chosen) < count:
        away = np.min([np.linalg.norm(x - x[n], axis=1) for n in chosen], axis=0)
        chosen.append(int(np.argmax(away)))
    return chosen
