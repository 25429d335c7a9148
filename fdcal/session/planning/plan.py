"""The bounds of a plan, computed in about a second, in words and as JSON.

Lengths are metres in JSON, millimetres in words.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...assessment.uncertainty import Bound, Information, field_information, position_bound
from ...model.gauge import fixes_gauge
from ...model.validation import InputError, length_text
from ..process import one_blas_thread
from .advice import ACCURACY_RULES, AccuracyAdvice, Advice, advise
from .bounds import (
    Forecast,
    TakesCase,
    field_of,
    forecast,
    is_moved,
    places_in_room,
    request_information,
    takes_cases,
    wavenumbers_of,
)
from .request import ASSUMED, PLAN_LIMITS, PlanRequest
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
    forecast: Forecast  # the error to be expected
    room_bound: Bound | None  # in the room's own field, the mean of some sources
    cases: tuple[Case, ...]  # bounds with other knowledge
    degeneracies: tuple[str, ...]  # what the pressures determine badly, in words
    advice: Advice | None = None  # what would improve the result; empty unless asked for
    trials: Trials | None = None  # simulated calibrations; None unless asked for
    takes: tuple[TakesCase, ...] = ()  # what more places of the source bring


def make_plan(request: PlanRequest, with_advice: bool = True, trials: Trials | None = None) -> Plan:
    """Return the bounds of a request, and the advice, which takes longer, with the errors that trials have shown."""
    with one_blas_thread():
        information = request_information(request)
        bound = position_bound(information, request.prior)
        room_bound, note = _room_bound(request)
        expected = forecast(request, information, bound)
        margin = None if trials is None else trials.margin
        return Plan(
            request=request,
            f_max=request.f_max,
            modes=len(request.frequencies),
            bound=bound,
            forecast=expected,
            room_bound=room_bound,
            cases=_cases(request, information),
            degeneracies=(*degeneracies(request, bound), *note),
            advice=advise(request, information, margin) if with_advice else None,
            trials=trials,
            takes=takes_cases(request, information, bound),
        )


def _room_bound(request: PlanRequest) -> tuple[Bound | None, tuple[str, ...]]:
    """Return the bound in the room's own field; None without a room, or with a note where no source fits in."""
    if request.room is None:
        return None, ()
    try:
        return position_bound(room_information(request), request.prior), ()
    except InputError as error:
        return None, (f"the field of the room itself is left out: {error.problem}",)


def room_information(request: PlanRequest) -> Information:
    """Return the information in the room's own field, the mean of `PLAN_LIMITS.sources` sources."""
    used = request.spaced(PLAN_LIMITS.max_frequencies // 3)
    k, matrices = wavenumbers_of(request, used), []
    for source in range(PLAN_LIMITS.sources):
        pressures = field_of(request, used, np.random.default_rng([request.seed, source]))
        found = field_information(request.layout.positions, pressures, k, request.noise_fraction, request.dimension)
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


FORMAT = 1  # of the JSON
LIKELY = 0.9  # fraction of simulated calibrations from which an answer is yes
LARGER = 1.05  # factor on that size from which an array counts as larger
NO_TRIALS = "no calibration was simulated: some trials, of seconds each, would say whether this array will be found"
SIZES = (0.5, 0.71, 1.41, 2.0)  # factors on the size of the array that are put in words


def plan_lines(plan: Plan) -> list[str]:
    """Return what a plan says, a line each."""
    request, bound = plan.request, plan.bound
    low, high = request.limits
    field = "a diffuse field" if request.room is None else f"a room of {'x'.join(f'{v:g}' for v in request.room)} m"
    takes = f", the source at {request.takes} places, recorded equally long from each" if request.takes > 1 else ""
    lines = [
        f"{len(request.layout.names)} microphones ({request.layout.name}) in {field},"
        f" reverberation time {request.reverberation_time:g} s, {request.snr_db:g} dB{takes}",
        f"frequencies: {plan.modes} independent ones{_of_import(request)} from {low:.0f} to {high:.0f} Hz;"
        f" the array interpolates up to {plan.f_max:.0f} Hz{_left_out(request)}",
        *_plane_lines(request),
        forecast_line(request, plan.forecast),
        *([] if plan.trials is not None else _blind_lines(request)),
        f"least error (Cramer-Rao bound): {_mm(bound.rms)} rms, {_mm(bound.sigma[bound.free].max())} at the worst"
        " microphone, in a diffuse field",
    ]
    if plan.room_bound is not None:
        lines.append(f"in this room, mean of some source positions: {_mm(plan.room_bound.rms)} rms{_moved(request)}")
    lines += [f"{case.name}: {_mm(case.rms)} rms, {_mm(case.worst)} at the worst" for case in plan.cases]
    lines += list(plan.degeneracies)
    lines += takes_lines(plan.takes, request.takes, plan.forecast.timed)
    if plan.trials is not None:
        lines[1:1] = [_judgement(plan.trials), *trial_lines(plan.trials), *_trials_without(request)]
    else:
        lines.insert(0, NO_TRIALS)
    if plan.advice is not None:
        lines += advice_lines(plan, plan.advice)
    return lines


def forecast_line(request: PlanRequest, found: Forecast) -> str:
    """Return in words the error to be expected, and between which bounds it will be in 8 of 10 recordings."""
    why = ""
    if request.is_plane_in_room:
        why = "; the size of a plane array follows from equal waves from all directions, which no room has"
    elif found.timed:
        why = "; arrival times included, which the bounds below leave out"
    elif request.kind == "impulse":
        why = "; arrival times add too little to count"
    return f"expected error: {_mm(found.rms)} rms, {_mm(found.low)} to {_mm(found.high)} in 8 of 10 recordings{why}"


FEW_BLIND = 16  # microphones at most of which a blind calibration from one place is often not good


def _blind_lines(request: PlanRequest) -> list[str]:
    """Return in words how often few microphones are found from one place of the source with nothing given.

    Figures of `python -m benchmarks blind`: 16 microphones in a living room and a studio.
    """
    if request.known or request.takes > 1 or request.dimension < 3 or len(request.layout.names) > FEW_BLIND:
        return []
    return [
        "so few microphones, from one place of the source and without given positions, are often not found, or with a"
        " larger error than expected; use more places of the source, or try some trials"
    ]


def _plane_lines(request: PlanRequest) -> list[str]:
    """Return in words along which directions the coordinates of an array are that is plane and not level."""
    if request.layout.axes is None:
        return []
    along = " and ".join(f"({', '.join(f'{value + 0.0:.3g}' for value in axis)})" for axis in request.layout.axes)
    return [f"a plane array that is not level: its coordinates are along {along}"]


def takes_lines(cases: Sequence[TakesCase], own: int = 1, timed: bool = False) -> list[str]:
    """Return what more places of the source bring to the expected error, a line for each way to record them.

    `timed`: whether the expected error of the plan has arrival times, which these leave out.
    """
    several = [case for case in cases if case.takes > 1]
    if not several:
        return []
    one = _mm(next(case.rms for case in cases if case.takes == 1))
    left_out = ", arrival times left out" if timed else ""

    def row(words: str, name: str) -> str:
        return f"{words}: " + ", ".join(f"{case.takes} places {_mm(getattr(case, name))}" for case in several)

    mine = next(case for case in cases if case.takes == max(own, 2))
    times = "twice" if mine.takes == 2 else f"{mine.takes} times"
    return [
        row(f"more places of the source, each recorded as long as one ({one} rms expected{left_out})", "rms"),
        row("the same recording time in all, divided among the places", "shared"),
        f"one place, recorded {times} as long: {_mm(mine.longer)}",
    ]


def _moved(request: PlanRequest) -> str:
    """Return in words where the array is put whose own coordinates do not lie inside the room; "" if they do."""
    if not is_moved(request):
        return ""
    centre = ", ".join(f"{value:.3g}" for value in places_in_room(request).mean(axis=0))
    return f"; the layout does not lie inside it: the array is moved as a whole, its centre to ({centre}) m"


def _of_import(request: PlanRequest) -> str:
    """Return in words that there are more frequencies than an import takes; "" if there are not."""
    wanted = min(request.modes or request.max_modes, request.max_modes)
    if len(request.frequencies) == wanted:
        return ""
    return f" in each take, as many of {wanted} as an import takes by default,"


def _left_out(request: PlanRequest) -> str:
    """Return in words which frequencies of the given band are not used; "" if all are."""
    low, high = request.limits
    if request.band is None or request.band[1] <= high:
        return ""
    return f", so that of {low:g} to {request.band[1]:g} Hz the higher ones are left out"


def _judgement(trials: Trials) -> str:
    """Return in one line whether the array will be found, from simulated calibrations."""
    if trials.found >= LIKELY and trials.accurate >= LIKELY:
        return f"yes: such an array is found, and every microphone within {_mm(trials.accuracy)}"
    if trials.found >= LIKELY:
        return f"in part: such an array is found, but not every microphone within {_mm(trials.accuracy)}"
    return (
        "no: such an array is not found often enough; add microphones or frequencies, make it smaller, record with less"
        " noise, or measure some positions by tape"
    )


def bound_lines(request: PlanRequest, bound: Bound) -> list[str]:
    """Return the least error and the frequencies of a request, a line each."""
    f, sigma = request.frequencies, bound.sigma[bound.free]
    each = f" in each of {request.takes} takes" if request.takes > 1 else ""
    return [
        f"least error (one sigma): median {_mm(float(np.median(sigma)))}, worst {_mm(float(sigma.max()))},"
        f" rms {_mm(bound.rms)}",
        f"{len(f)} independent frequencies{each} from {f[0]:.0f} to {f[-1]:.0f} Hz; highest usable frequency"
        f" {request.f_max:.0f} Hz",
    ]


def trial_lines(trials: Trials) -> list[str]:
    """Return the results of simulated calibrations, a line each."""
    count, verdicts = len(trials.verdicts), Counter(trials.verdicts)
    good = verdicts.pop("good", 0)
    others = "".join(f", {verdict} in {number / count:.0%}" for verdict, number in verdicts.most_common())
    return [
        f"{count} simulated calibrations: every microphone within {_mm(trials.accuracy)} in {trials.accurate:.0%},"
        f" the array found in {trials.found:.0%}, verdict good in {good / count:.0%}{_wrongly(trials)}{others}",
        f"their error: median {_mm(trials.percentile(50))}, 95th percentile {_mm(trials.percentile(95))};"
        f" the bound is {_mm(trials.bound)}",
    ]


def _trials_without(request: PlanRequest) -> list[str]:
    """Return in words what the trials of a request leave out; none if nothing."""
    if request.kind != "impulse":
        return []
    return ["simulated calibrations leave out arrival times, with which impulses err less than they show"]


def _wrongly(trials: Trials) -> str:
    """Return in words in how many trials the verdict was good and the array not found; "" in none."""
    wrong = trials.trusted_wrongly
    return f", in {wrong:.0%} wrongly: a calibration does not show that such an array was not found" if wrong else ""


def advice_lines(plan: Plan, advice: Advice) -> list[str]:
    """Return the advice, a line each."""
    extra, tape, names = advice.extra, advice.tape, plan.request.layout.names
    place = ", ".join(f"{value:.3g}" for value in extra.best)
    chosen = ", ".join(names[n] for n in tape.microphones)
    lines = [
        f"one more microphone helps the others most at ({place}) m: {_mm(extra.before)} -> {_mm(extra.best_rms)}",
        f"measure microphones {chosen} by tape, each coordinate to {_mm(tape.sigma)}: the others come out to"
        f" {_mm(tape.rms)} in the frame of the tape, {_mm(tape.usual_rms)} with a random choice; the shape of the"
        f" array, after alignment, {_mm(tape.shape_before)} -> {_mm(tape.shape_rms)}",
    ]
    if not np.isfinite(advice.accuracy.margin):
        return [*lines, "no advice on noise and size: most simulated calibrations were refused"]
    return [*lines, _snr_line(plan, advice.accuracy), _size_line(plan, advice.accuracy)]


def _snr_line(plan: Plan, advice: AccuracyAdvice) -> str:
    wanted = f"{_mm(plan.request.accuracy)} rms"
    if advice.snr_db is None or advice.recording_factor is None:
        if advice.margin * plan.bound.rms <= plan.request.accuracy:
            return f"{wanted} is within reach at {plan.request.snr_db:g} dB, and noise is not what limits the error"
        given = plan.request.known_sigma > 0 and len(plan.request.known) > 0
        remedy = "measure the given positions better" if given else "add microphones or frequencies"
        best = f"{ACCURACY_RULES.max_snr_db:g} dB, where {_mm(advice.quiet_rms)} are expected"
        if advice.quiet_rms <= plan.request.accuracy:
            return f"less noise hardly lowers the error to {wanted} (up to {best}): {remedy}"
        return f"no signal-to-noise ratio reaches {wanted} (up to {best}): {remedy}"
    if advice.recording_factor <= 1:
        return f"{wanted} needs {advice.snr_db:.0f} dB, which {plan.request.snr_db:g} dB exceeds"
    longer = f"{advice.recording_factor:.2g} times as long a recording in the same noise"
    return f"{wanted} needs {advice.snr_db:.0f} dB: {longer}, or a louder source"


def _size_line(plan: Plan, advice: AccuracyAdvice) -> str:
    bounds = dict(advice.sizes.tolist())
    others = "; ".join(f"{factor:g} times as large {_mm(bounds[factor])}" for factor in SIZES if factor in bounds)
    wanted, reckoned = f"{_mm(plan.request.accuracy)} rms", "by the expected error of each size"
    if plan.trials is not None or plan.request.is_plane_in_room:
        reckoned = f"where calibrations err {advice.margin:.2g} times the bound"
    if advice.size is None:
        judged = f"no size from {advice.sizes[0, 0]:g} to {advice.sizes[-1, 0]:g} times reaches {wanted}"
    elif advice.size < 1:
        judged = f"{wanted} needs an array of {advice.size:.2g} times the size"
    elif advice.size < LARGER:
        judged = f"the array must not be larger for {wanted}"
    else:
        judged = f"the array may be {advice.size:.2g} times as large for {wanted}"
    return f"size: {judged}, {reckoned} (least errors: {others}; as it is {_mm(plan.bound.rms)})"


def _mm(metres: float) -> str:
    return length_text(metres) if np.isfinite(metres) else "none (trials were refused)"


def plan_dict(plan: Plan) -> dict:
    """Return a plan as JSON holds it: lengths in metres, frequencies in hertz."""
    request = plan.request
    return {
        "format": FORMAT,
        "layout": request.layout.name,
        "names": list(request.layout.names),
        "positions_m": request.layout.positions.tolist(),
        "room_m": None if request.room is None else list(request.room),
        "reverberation_time_s": request.reverberation_time,
        "snr_db": request.snr_db,
        "band_hz": list(request.limits),
        "f_max_hz": plan.f_max,
        "modes": plan.modes,
        "takes": request.takes,
        "takes_expected_rms_m": [
            {"takes": case.takes, "same_each": case.rms, "same_in_all": case.shared, "one_place_longer": case.longer}
            for case in plan.takes
        ],
        "known": [request.layout.names[n] for n in request.known],
        "known_sigma_m": request.known_sigma,
        "gain_sigma_db": request.gain_sigma_db,
        "kind": request.kind,
        "expected_rms_m": plan.forecast.rms,
        "expected_range_m": [plan.forecast.low, plan.forecast.high],
        "bound_rms_m": plan.bound.rms,
        "bound_m": plan.bound.sigma.tolist(),
        "covariance_m2": plan.bound.covariance.tolist(),
        "room_bound_rms_m": None if plan.room_bound is None else plan.room_bound.rms,
        "scale_sigma": plan.bound.scale_sigma,
        "cases": [{"name": case.name, "rms_m": case.rms, "worst_m": case.worst} for case in plan.cases],
        "degeneracies": list(plan.degeneracies),
        "advice": None if plan.advice is None else _advice_dict(plan, plan.advice),
        "trials": None if plan.trials is None else _trials_dict(plan.trials),
        "text": plan_lines(plan),
    }


def _advice_dict(plan: Plan, advice: Advice) -> dict:
    extra, tape = advice.extra, advice.tape
    return {
        "extra_microphone_m": extra.best.tolist(),
        "extra_rms_m": extra.best_rms,
        "rms_before_m": extra.before,
        "tape": [plan.request.layout.names[n] for n in tape.microphones],
        "tape_sigma_m": tape.sigma,
        "tape_rms_m": tape.rms,
        "tape_shape_rms_m": tape.shape_rms,
        "shape_rms_before_m": tape.shape_before,
        "accuracy_m": plan.request.accuracy,
        "margin": _finite(advice.accuracy.margin),
        "snr_needed_db": advice.accuracy.snr_db,
        "recording_factor": advice.accuracy.recording_factor,
        "sizes": advice.accuracy.sizes.tolist(),
        "size_factor": advice.accuracy.size,
    }


def _trials_dict(trials: Trials) -> dict:
    return {
        "count": len(trials.verdicts),
        "accurate": trials.accurate,
        "found": trials.found,
        "trusted_wrongly": trials.trusted_wrongly,
        "median_m": _finite(trials.percentile(50)),
        "percentile_95_m": _finite(trials.percentile(95)),
        "bound_m": trials.bound,
        "rms_m": [_finite(value) for value in trials.rms],
        "verdicts": list(trials.verdicts),
        "seconds": trials.seconds,
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
