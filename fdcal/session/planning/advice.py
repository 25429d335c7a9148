"""What would improve a calibration, with numbers: one more microphone, a tape measure, less noise, another size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...assessment.bound import Information, Prior, aligned_rms, position_bound
from ...model.gauge import fixes_gauge
from .accuracy_advice import AccuracyAdvice, accuracy_advice
from .bounds import sparse_information
from .request import ASSUMED, PlanRequest


@dataclass(frozen=True)
class AdviceRules:
    """How the advice is searched for."""

    lattice: int = 15  # places along each side of the map of one more microphone
    lattice_3d: int = 9  # likewise in space, for each of its layers
    layers: int = 3  # layers of heights in space
    margin: float = 0.25  # of the map round the array, relative to the array's extent
    spacing: float = 0.3  # least distance of one more microphone from the others, relative to their median spacing
    swaps: int = 4  # rounds in which measured microphones are exchanged for better ones


RULES = AdviceRules()


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


def advise(request: PlanRequest, information: Information, margin: float | None = None) -> Advice:
    """Return the advice for a request.

    `information`: of all its frequencies; `margin`: error of a calibration over the bound, as trials have shown it.
    """
    return Advice(best_addition(request), best_tape(request, information), accuracy_advice(request, margin))


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
    return ExtraMicrophone(places, rms.reshape(shape), own.reshape(shape), best, float(np.nanmin(rms)), before)


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
