"""What would improve a calibration, with numbers: one more microphone, a tape measure, less noise, another size."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...acoustics.fourier_bessel import array_f_max
from ...assessment.fisher_information import Information, diffuse_information
from ...assessment.position_bound import Prior, position_bound, with_known
from ...model.gauge import fixes_gauge
from .request import LEAST_FREQUENCIES, LIMITS, PlanRequest


@dataclass(frozen=True)
class AdviceRules:
    """How the advice is searched for.

    Attributes
    ----------
    lattice : places along each side of the map of one more microphone
    lattice_3d : likewise in space, for each of its layers
    layers : layers of heights in space
    margin : of the map round the array, relative to the array's extent
    spacing : least distance of one more microphone from the others, relative to their median spacing
    tape_sigma : metres, one sigma of a coordinate measured by tape
    swaps : rounds in which measured microphones are exchanged for better ones
    sizes : factors on the size of the array
    most_snr : dB, greatest signal-to-noise ratio that is proposed
    """

    lattice: int = 15
    lattice_3d: int = 9
    layers: int = 3
    margin: float = 0.25
    spacing: float = 0.3
    tape_sigma: float = 0.005
    swaps: int = 4
    sizes: tuple[float, ...] = (0.35, 0.5, 0.71, 1.0, 1.41, 2.0, 2.83)
    most_snr: float = 80.0


RULES = AdviceRules()


@dataclass(frozen=True)
class ExtraMicrophone:
    """Where one more microphone helps the others most.

    Attributes
    ----------
    places : (..., D) float64, metres, lattice of candidates
    rms : (...) float64, metres, bound of the present microphones with one there; NaN too close to another
    own_sigma : (...) float64, metres, bound of the microphone that is added
    best : (D,) float64, metres
    best_rms, worst_rms, before : metres, of the present microphones
    """

    places: np.ndarray
    rms: np.ndarray
    own_sigma: np.ndarray
    best: np.ndarray
    best_rms: float
    worst_rms: float
    before: float


@dataclass(frozen=True)
class TapeMeasure:
    """The microphones that are best measured by tape.

    Attributes
    ----------
    microphones : (A,) tuple of int
    sigma : metres, of each measured coordinate
    rms, usual_rms : metres, bound of all others in the frame of the tape, and the median over other choices
    """

    microphones: tuple[int, ...]
    sigma: float
    rms: float
    usual_rms: float


@dataclass(frozen=True)
class Advice:
    """What would improve a calibration.

    Attributes
    ----------
    extra : ExtraMicrophone
    tape : TapeMeasure
    snr_db : dB, ratio at which the bound reaches the accuracy that is wanted; None if none does
    recording_factor : the recording's length over the present one that gives this ratio with steady noise
    sizes : (S, 2) float64, factor on the size of the array and the bound, metres
    """

    extra: ExtraMicrophone
    tape: TapeMeasure
    snr_db: float | None
    recording_factor: float | None
    sizes: np.ndarray


def advise(request: PlanRequest, information: Information) -> Advice:
    """Return the advice for a request; `information` is that of all its frequencies."""
    snr = _needed_snr(request)
    return Advice(
        extra=best_addition(request),
        tape=best_tape(request, information),
        snr_db=snr,
        recording_factor=None if snr is None else 10 ** ((snr - request.snr_db) / 10),
        sizes=sizes_of(request),
    )


def sparse_information(request: PlanRequest, positions, share: float | None = None, highest: float = np.inf):
    """Return the information of a few frequencies, scaled to all of them below `highest`, Hz."""
    f = request.frequencies
    f = f[f <= highest]
    used = f[np.unique(np.linspace(0, len(f) - 1, min(len(f), LIMITS.search_frequencies)).round().astype(int))]
    share = request.noise_share if share is None else share
    k = 2 * np.pi * used / request.sound_speed
    return diffuse_information(positions, k, share, request.dimension).scaled(len(f) / len(used))


def best_addition(request: PlanRequest) -> ExtraMicrophone:
    """Return the bound with one more microphone, for a lattice of places in and round the array."""
    x, prior = request.layout.positions, request.prior
    places = _lattice(x)
    flat = places.reshape(-1, x.shape[1])
    apart = np.linalg.norm(x[:, None] - x[None], axis=-1) + 1e9 * np.eye(len(x))
    least = RULES.spacing * float(np.median(apart.min(axis=1)))
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
    return ExtraMicrophone(
        places, rms.reshape(shape), own.reshape(shape), best, float(np.nanmin(rms)), float(np.nanmax(rms)), before
    )


def _lattice(x: np.ndarray) -> np.ndarray:
    """Return candidate places (ny, nx, 2), or (nz, ny, nx, 3), metres."""
    low, high = x.min(axis=0), x.max(axis=0)
    margin = RULES.margin * float((high - low).max())
    low, high = low - margin, high + margin
    if x.shape[1] == 2:
        axes = [np.linspace(low[a], high[a], RULES.lattice) for a in range(2)]
        return np.stack(np.meshgrid(*axes), axis=-1)
    axes = [np.linspace(low[a], high[a], RULES.lattice_3d) for a in range(2)]
    heights = np.linspace(low[2] + margin, high[2] - margin, RULES.layers)
    x, y = np.meshgrid(*axes)
    return np.stack([np.stack([x, y, np.full_like(x, z)], axis=-1) for z in heights])


def best_tape(request: PlanRequest, information: Information) -> TapeMeasure:
    """Return the D + 1 microphones that, measured by tape, determine the others best.

    Beginning with microphones far apart, each is exchanged for the one that lowers the bound most.
    """
    x = request.layout.positions
    count = x.shape[1] + 1
    chosen = _far_apart(x, count)
    least = _tape_rms(request, information, chosen)
    for _ in range(RULES.swaps):
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
    return TapeMeasure(tuple(sorted(chosen)), RULES.tape_sigma, least, float(np.median(usual)))


def _tape_rms(request: PlanRequest, information: Information, chosen: list[int]) -> float:
    x = information.positions
    if not fixes_gauge(x[chosen]):
        return np.inf
    prior: Prior = with_known(request.prior, sorted(chosen), RULES.tape_sigma)
    return position_bound(information, prior).rms


def _far_apart(x: np.ndarray, count: int) -> list[int]:
    chosen = [int(np.argmax(np.linalg.norm(x - x.mean(axis=0), axis=1)))]
    while len(chosen) < count:
        away = np.min([np.linalg.norm(x - x[n], axis=1) for n in chosen], axis=0)
        chosen.append(int(np.argmax(away)))
    return chosen


def _needed_snr(request: PlanRequest) -> float | None:
    """Return the least ratio, dB, at which the bound is as low as the accuracy that is wanted."""

    def rms(snr_db: float) -> float:
        noise = 10 ** (-snr_db / 10)
        found = sparse_information(request, request.layout.positions, noise / (1 + noise))
        return position_bound(found, request.prior).rms

    low, high = 0.1, RULES.most_snr
    if rms(high) > request.accuracy:
        return None
    while high - low > 0.1:
        middle = (low + high) / 2
        low, high = (low, middle) if rms(middle) <= request.accuracy else (middle, high)
    return high


def sizes_of(request: PlanRequest) -> np.ndarray:
    """Return factors on the size of the array and its bound : (S, 2) float64.

    A band that was given stays, but for frequencies that the enlarged array cannot interpolate; without one, every
    array has the band that it can interpolate.
    """
    x, rows = request.layout.positions, []
    for factor in RULES.sizes:
        scaled = x.mean(axis=0) + factor * (x - x.mean(axis=0))
        highest = array_f_max(scaled, request.sound_speed, request.dimension)
        other = replace(request, layout=replace(request.layout, positions=scaled))
        if np.sum(other.frequencies <= highest) >= LEAST_FREQUENCIES:
            rows.append((factor, position_bound(sparse_information(other, scaled, highest=highest), request.prior).rms))
    return np.array(rows)


def with_extra(request: PlanRequest, place) -> PlanRequest:
    """Return `request` with one more microphone, the last, at `place` (D,), metres."""
    layout = request.layout
    positions = np.vstack([layout.positions, place])
    names = (*layout.names, f"new {len(layout.names)}")
    return replace(request, layout=replace(layout, names=names, positions=positions))
