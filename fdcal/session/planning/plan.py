"""The bounds of a plan, computed in about a second: `make_plan`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...assessment.bound import Bound, Information, field_information, position_bound
from ...model.gauge import fixes_gauge
from ...model.validation import InputError
from ..blas_threads import one_blas_thread
from .advice import Advice, advise
from .bounds import TakesCase, request_information, takes_cases
from .fields import field_of, places_in_room, wavenumbers_of
from .request import ASSUMED, LIMITS, PlanRequest
from .trials import Trials


@dataclass(frozen=True)
class Case:
    """The bound under one set of assumptions."""

    name: str  # in words
    rms: float  # metres, root mean square over the microphones that are sought
    worst: float  # metres, greatest one sigma of a microphone


@dataclass(frozen=True)
class Plan:
    """What is to be expected of an array."""

    request: PlanRequest
    f_max: float  # the highest frequency that the array can interpolate (Eq. 9)
    modes: int  # independent frequencies in the band
    bound: Bound  # of the request, in a diffuse field
    room_bound: Bound | None  # in the room's own field, the mean of some sources
    cases: tuple[Case, ...]  # bounds with other knowledge
    degeneracies: tuple[str, ...]  # what the pressures determine badly, in words
    advice: Advice | None = None  # what would improve the result; empty unless asked for
    trials: Trials | None = None  # simulated calibrations; None unless asked for
    takes: tuple[TakesCase, ...] = ()  # what more places of the source bring


def make_plan(request: PlanRequest, with_advice: bool = True, trials: Trials | None = None) -> Plan:
    """Return the bounds of a request, and the advice that follows from them.

    `with_advice`: whether to search for better layouts, which takes longer; `trials`: of this request: the advice
    reckons with the errors that they have shown. Raises InputError: the room has no place for the array or for a
    source.
    """
    with one_blas_thread():
        information = request_information(request)
        bound = position_bound(information, request.prior)
        room_bound, note = _room_bound(request)
        return Plan(
            request=request,
            f_max=request.f_max,
            modes=len(request.frequencies),
            bound=bound,
            room_bound=room_bound,
            cases=_cases(request, information),
            degeneracies=(*degeneracies(request, bound), *note),
            advice=advise(request, information, trials and trials.margin) if with_advice else None,
            trials=trials,
            takes=takes_cases(request),
        )


def _room_bound(request: PlanRequest) -> tuple[Bound | None, tuple[str, ...]]:
    """Return the bound in the room's own field; None without a room, or with a note where no source fits in."""
    if request.room is None:
        return None, ()
    places_in_room(request)  # refuses an array that does not fit
    try:
        return position_bound(room_information(request), request.prior), ()
    except InputError as error:
        return None, (f"the field of the room itself is left out: {error.problem}",)


def room_information(request: PlanRequest) -> Information:
    """Return the information in the room's own field, the mean of `LIMITS.sources` sources."""
    used = request.spaced(LIMITS.most_frequencies // 3)
    k, matrices = wavenumbers_of(request, used), []
    for source in range(LIMITS.sources):
        pressures = field_of(request, used, np.random.default_rng([request.seed, source]))
        found = field_information(request.layout.positions, pressures, k, request.noise_share, request.dimension)
        matrices.append(found.matrix)
    mean = Information(request.layout.positions, np.mean(matrices, axis=0))
    return mean.scaled(request.takes * len(request.frequencies) / len(used))


def _cases(request: PlanRequest, information: Information) -> tuple[Case, ...]:
    """Return the bound with and without given positions, uncertain ones, and unknown gains."""
    prior = request.prior
    blind = replace(prior, known=np.zeros(0, int), known_sigma=0.0)
    gain = request.gain_sigma_db or ASSUMED.gain_sigma_db
    cases = [("no position given", replace(blind, gain_sigma=0.0))]
    cases += [(f"no position given, gains unknown ({gain:g} dB)", replace(blind, gain_sigma=gain * np.log(10) / 20))]
    if len(prior.known):
        tape = prior.known_sigma or ASSUMED.tape_sigma_m
        names = f"{len(prior.known)} positions given"
        cases += [(f"{names}, exact", replace(prior, known_sigma=0.0, gain_sigma=0.0))]
        cases += [(f"{names} to {1e3 * tape:g} mm", replace(prior, known_sigma=tape, gain_sigma=0.0))]
    bounds = [(name, position_bound(information, one)) for name, one in cases]
    return tuple(Case(name, one.rms, float(one.sigma[one.free].max())) for name, one in bounds)


def degeneracies(request: PlanRequest, bound: Bound) -> tuple[str, ...]:
    """Return in words what pressures and given positions leave undetermined."""
    x, prior, found = request.layout.positions, request.prior, []
    if not fixes_gauge(x[prior.known]):
        found.append(_mirror_words(request))
    if bound.scale_sigma > ASSUMED.blurred:
        found.append(f"size is determined to {100 * bound.scale_sigma:.2g} % only: give one distance or position more")
    elif bound.deformations[-1] > ASSUMED.blurred:
        axis = np.linalg.eigh(bound.shapes[-1])[1][:, -1]
        along = ", ".join(f"{value:.2g}" for value in axis)
        found.append(f"a stretch along ({along}) is determined to {100 * bound.deformations[-1]:.2g} % only")
    if request.takes * len(request.frequencies) * 2 < x.size:
        count = len(request.frequencies)
        takes = f" in each of {request.takes} takes" if request.takes > 1 else ""
        found.append(f"{count} frequencies{takes} for {x.size} coordinates are few: use a wider band")
    return tuple(found)


def _mirror_words(request: PlanRequest) -> str:
    D = request.layout.positions.shape[1]
    need = f"{D + 1} given positions that are not {'on one line' if D == 2 else 'in one plane'} decide it"
    plane = "; the side of the array's plane on which the source was is not determined" if D < request.dimension else ""
    what = "the array's plane can be mirrored" if D == 2 else "the array can be mirrored"
    return f"{what}: pressures determine it up to a rotation, a translation and a mirror image, {need}{plane}"
