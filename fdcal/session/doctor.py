"""Check a recording or a published data set: `examine` returns one finding for each question.

samples      which channels are silent, clipped or copies
wrapped      whether the beginning of impulse responses is at their end
synchronous  whether the channels share one clock (`fdcal.recordings.synchrony`)
field        whether a sound field between the microphones predicts each of them; the error of predicting it by the mean
             of the others, which is a field of order 0, is printed beside it
measured     whether the low frequencies form a sound field, too; in a simulation by rays only the arrival times fit
channels     which channels differ in polarity, gain, delay, bass or noise
list         whether a list of positions fits the array found: order, size, single microphones

Positions, gains and faults are those of `fdcal.session.calibration_run.solve`.
"""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..assessment.calibration import FAULTS, OF_LIST, Calibration
from ..assessment.field import leave_one_out_errors, summarise
from ..assessment.findings import Answer, AnswerState
from ..assessment.position_check import LIST_RULES, ListFit, PositionCheck, compare_positions, fit_result
from ..assessment.words import clock_words, faults_text, gain_words, list_faults
from ..model.measurement import Measurement
from ..model.problem import Problem
from ..model.validation import InputError
from ..recordings import importer
from ..recordings.channels import ChannelHealth, inspect_channels
from ..recordings.frequencies import NothingAboveNoise
from ..recordings.impulse_response import WrapsRound
from ..recordings.recording import ImportOptions, Recording, select_channels
from ..recordings.synchrony import ClockFault, channel_delays
from ..solvers.robust.arrivals import arrival_misfits
from .calibration_run import solve
from .sources import CalibrationInput, ProgressReport, compared_with_file, is_recording, load_input, measurement_input


@dataclass(frozen=True)
class DoctorRules:
    """Limits beyond which a finding is a fault; the figures are from `python -m benchmarks doctor`."""

    # The field is judged at this fraction of the frequencies, the lowest ones. For the measured array of the benchmark,
    # the error is -25 dB at the lowest third or fifth of the frequencies, and -11 dB at all of them.
    lowest: float = 1 / 3
    # Leave-one-out error above which there is no sound field between the microphones. Recordings without a fault have
    # -18 dB or less, simulations by rays -2.5 and -3.4 dB.
    field_db: float = -8.0
    # Frequency, Hz, below which even few microphones sample the sound field of any room. With 100 or 200 Hz instead of
    # 150 Hz the errors differ by 3.5 dB at most.
    low_frequency: float = 150.0
    # Least number of frequencies below `low_frequency`, and of the lowest ones by which the field is judged. Levels
    # scatter by up to 6 dB, so a mean of six is known to 2.5 dB.
    fewest: int = 6
    arrivals: float = 3e-3  # metres, median misfit up to which arrival times fit; those that fit have 0.05 to 0.9 mm
    # Least number of frequencies at which the channels of a stationary recording are coherent. There are 122 or more at
    # 0 dB and 26 at -5 dB, but 7 to 17 if each channel is from a different recording.
    rows: int = 20
    # Difference between the size of a list and that of the array, in sigmas, above which the list is wrong; correct
    # lists reach 2.8.
    size_sigmas: float = 4.0
    speed: float = 0.05  # one sigma of the prior of the sound speed, relative; it corresponds to 30 K


DOCTOR_RULES = DoctorRules()


def examine(
    sources: str | Sequence[str],
    positions: str | None = None,
    options: ImportOptions | None = None,
    progress: ProgressReport | None = None,
    wording: Mapping[str, str] = importer.ARGUMENTS,
) -> Iterator[Answer]:
    """Yield the findings about recordings, a measurement or a scene, each as soon as it is known.

    `positions`: file of a list to compare with; without it, the positions that the recordings, the measurement or the
    scene hold are compared. `wording`: names of the arguments in the findings.
    """
    texts = [sources] if isinstance(sources, str) else list(sources)
    if all(map(is_recording, texts)):
        wanted = replace(options or ImportOptions(), leave_out=(options and options.leave_out) or "bad")
        takes = importer.read_takes(texts, wanted)
        health = [inspect_channels(one) for one in takes]
        names = takes[0].names
        faults = {names[n]: one.fault(n, names) for one in reversed(health) for n in one.bad}
        text = "; ".join(f"{name}: {fault}" for name, fault in faults.items())
        text = text or f"none of {len(names)} channels is silent, clipped or a copy of another"
        kinds = tuple(dict.fromkeys((one.kind(n), names[n]) for one in health for n in one.bad))
        yield Answer("samples", "fault" if faults else "fine", text, len(faults), "channels", kinds)
        yield _clocks(takes, health, wanted)
        try:
            measurement, report = importer.measurement_of_takes(takes, wanted)
        except InputError as error:
            wraps = isinstance(error, WrapsRound)
            state: AnswerState = "fault" if wraps or isinstance(error, NothingAboveNoise) else "unknown"
            question = "wrapped" if wraps else "field"
            yield Answer(question, state, error.worded(wording), found=((question, ""),) if state == "fault" else ())
            return
        stationary = (report.takes or (report,))[0].kind == "stationary"
        if not stationary:
            yield Answer("wrapped", "fine", "no sound rises again before the end")
        inputs = replace(measurement_input(measurement, texts[0]), excluded=tuple(report.left_out))
    else:
        inputs, stationary = load_input(texts, progress), False
    inputs = inputs if positions is None else compared_with_file(inputs, positions)
    blind = replace(inputs.measurement, known=np.zeros(0, np.int64), known_positions=None)
    yield from _of_field(measurement_input(blind, inputs.name), stationary, progress, wording)


def _clocks(takes: Sequence[Recording], health: Sequence[ChannelHealth], options: ImportOptions) -> Answer:
    """Return which channels have a clock that differs from the others; unusable channels are left out."""
    names, faults, unknown, worst, value = takes[0].names, dict[str, ClockFault](), set[str](), -1.0, 0.0
    for one, state in zip(takes, health, strict=True):
        impulse = one.kind == "impulse" or options.kind == "impulse"
        found = None if impulse else channel_delays(select_channels(one, np.setdiff1d(np.arange(one.count), state.bad)))
        if found is None:
            continue
        usable = tuple(names[n] for n in range(one.count) if n not in state.bad)
        faults = found.faults(usable) | faults
        unknown |= set(found.unknown(usable))
        over = np.abs(found.delays) / found.limit[:, None]
        if np.isfinite(over[:, 1:]).any() and np.nanmax(over) > worst:  # the text quotes the largest delay
            worst, value = float(np.nanmax(over)), 1e6 * float(np.nanmax(np.abs(found.delays)))
    listed = [f"{name}: {clock_words(*fault)}" for name, fault in faults.items()]
    few = [name for name in names if name in unknown and name not in faults]
    listed += [f"not coherent with the others: {', '.join(few)}"] if few else []
    if faults:
        kinds = tuple((fault.kind, name) for name, fault in faults.items())
        return Answer("synchronous", "fault", "; ".join(listed), value, "µs", kinds)
    if worst < 0:
        why = "no channels are coherent" if few else "not visible in impulse responses, or in less than 8 s of sound"
        return Answer("synchronous", "unknown", why)
    text = f"delays of the channels change by {value:.2g} µs at most"
    return Answer("synchronous", "unknown" if few else "fine", "; ".join([*listed, text]), value, "µs")


def _of_field(
    inputs: CalibrationInput, stationary: bool, progress: ProgressReport | None, wording: Mapping[str, str]
) -> Iterator[Answer]:
    """Yield the findings of a calibration about field, channels and list."""
    measurement = inputs.measurement
    try:
        result = solve(inputs, progress, wording, keep=True)
    except InputError as error:
        rows = len(measurement.frequencies)
        few = stationary and rows < DOCTOR_RULES.rows  # an import keeps only coherent frequencies
        text = f"the channels are coherent at {rows} frequencies only" if few else error.worded(wording)
        yield Answer("field", "fault" if few else "unknown", text, found=(("field", ""),) if few else ())
        if measurement.positions is not None:
            yield Answer("list", "unknown", "no array was found to compare the list with")
        return
    check = None if measurement.positions is None else compare_positions(result.positions, measurement.positions)
    if check is not None and result.verdict != "good":
        # A second calibration is given all listed positions but one. It counts if it explains the pressures better.
        listed = np.asarray(measurement.positions)
        every = np.delete(np.arange(measurement.count), int(np.argmax(check.errors)))  # one must be unknown
        known = replace(measurement, known=every, known_positions=listed[every])
        with contextlib.suppress(InputError):
            settings = replace(inputs.settings, known="all")
            given = solve(replace(inputs, measurement=known, settings=settings), progress, wording, keep=True)
            result = given if _errors(given)[0] < _errors(result)[0] - 1.0 else result
    yield from _field(measurement, result)
    assert result.channels is not None
    differing = [one for one in result.channels.faults if one.kind not in OF_LIST]
    text = faults_text(differing) or gain_words(result)
    minor: AnswerState = "differs" if all(FAULTS[one.kind].minor for one in differing) else "fault"
    kinds = tuple((one.kind, one.name) for one in differing)
    yield Answer("channels", minor if differing else "fine", text, len(differing), "channels", kinds)
    if check is not None:
        yield _list(inputs, result, check, progress)


def _errors(result: Calibration) -> tuple[float, float, np.ndarray, np.ndarray]:
    """Return leave-one-out errors, dB, and the frequencies, Hz.

    The first two are those of the lowest frequencies, predicted by a sound field and by the mean of the others. The
    third is that of each frequency by a sound field.
    """
    assert result.run is not None and result.channels is not None
    problem, healthy = result.run.problem, np.zeros(len(result.names), bool)
    healthy[result.healthy] = True
    modes = slice(0, int(np.sum(problem.frequencies <= result.frequencies[-1])))
    corrected: Problem = replace(problem, pressures=problem.pressures / result.channels.correction.gains)
    p = corrected.pressures[modes]
    errors = leave_one_out_errors(corrected, result.positions, modes, healthy=healthy)
    seen = p[:, healthy]
    mean = (seen.sum(axis=1, keepdims=True) - seen) / max(seen.shape[1] - 1, 1)
    constant = np.array(p)
    constant[:, healthy] = seen - mean
    by_field, by_mean = (summarise(p, one, healthy).modes for one in (errors, constant))
    count = max(DOCTOR_RULES.fewest, int(DOCTOR_RULES.lowest * len(p)))
    low = np.argsort(problem.frequencies[modes], kind="stable")[:count]
    return _mean_db(by_field[low]), _mean_db(by_mean[low]), by_field, problem.frequencies[modes]


def _mean_db(levels: np.ndarray) -> float:
    return float(10 * np.log10(np.mean(10 ** (levels / 10)))) if len(levels) else np.nan


def _field(measurement: Measurement, result: Calibration) -> list[Answer]:
    """Return whether there is a sound field, and whether it was measured rather than simulated by rays."""
    overall, mean_db, by_field, f = _errors(result)
    low = f <= DOCTOR_RULES.low_frequency
    low_db = _mean_db(by_field[low]) if np.sum(low) >= DOCTOR_RULES.fewest else np.nan
    one = overall < DOCTOR_RULES.field_db
    text = f"error of predicting a microphone from the others: {overall:.1f} dB by a sound field, {mean_db:.1f} dB by"
    text += " their mean (lowest third of the frequencies)"
    if not one:
        text += ": this is not one sound field, but several recordings, moving microphones, or no measurement"
    field = Answer("field", "fine" if one else "fault", text, overall, "dB", () if one else (("field", ""),))
    problem = measurement.problem("unit", "none")
    misfit = arrival_misfits(problem, np.asarray(result.positions))
    if misfit is None:
        return [field, Answer("measured", "unknown", "no arrival times, which need impulse responses")]
    if measurement.positions is not None:  # the arrival times may fit the list even if no array was found
        listed = arrival_misfits(problem, np.asarray(measurement.positions))
        misfit = misfit if listed is None else min(misfit, listed, key=np.nanmedian)
    median = float(np.nanmedian(misfit))
    text, below = f"arrival times fit to {1e3 * median:.1f} mm", f"below {DOCTOR_RULES.low_frequency:g} Hz"
    if not np.isfinite(low_db):
        text += f"; no frequencies {below} to compare with"
        return [field, Answer("measured", "unknown", text, 1e3 * median, "mm")]
    text += f"; {below} the error of predicting a microphone from the others is {low_db:.1f} dB"
    rays = median < DOCTOR_RULES.arrivals and low_db > DOCTOR_RULES.field_db
    text += ": a simulation by rays, which has no sound field at low frequencies" if rays else ""
    return [field, Answer("measured", "fault" if rays else "fine", text, low_db, "dB", (("rays", ""),) * rays)]


def _size(
    inputs: CalibrationInput, listed: np.ndarray, right: np.ndarray, sigma: float, progress: ProgressReport | None
) -> tuple[float, float]:
    """Return the ratio of the size of a list to that of the array, and its sigma, infinite if it is unknown.

    The pressures determine the size far better if the shape is given. A calibration therefore gets the positions that
    are `right`, with one `sigma` of each coordinate, metres, and estimates the sound speed: only k r matters, so that
    the ratio of the sound speeds is that of the sizes.
    """
    known = np.flatnonzero(right)
    if len(known) == len(listed):
        # one must be unknown: the central one
        known = np.delete(known, int(np.argmin(np.linalg.norm(listed - listed.mean(axis=0), axis=1))))
    measurement = replace(inputs.measurement, known=known, known_positions=listed[known], positions=None)
    settings = replace(inputs.settings, known="all", known_sigma=sigma, sound_speed_sigma=DOCTOR_RULES.speed)
    try:
        found = solve(replace(inputs, measurement=measurement, settings=settings), progress)
    except InputError:
        return 1.0, np.inf
    c, speed, speed_sigma = measurement.sound_speed, found.sound_speed, found.sound_speed_sigma
    if speed is None or speed_sigma is None or found.verdict == "not_converged":
        return 1.0, np.inf
    return speed / c, speed_sigma / c


def list_fit(
    inputs: CalibrationInput, result: Calibration, check: PositionCheck, progress: ProgressReport | None = None
) -> ListFit:
    """Return how each row of the list of a measurement fits, after `check` has found that the list fits as a whole.

    If the array found has another size than the list, a second calibration with the shape of the list gives the size.
    """
    listed = np.asarray(inputs.measurement.positions)
    fit = fit_result(check, result, listed)
    differs = abs(fit.scale - 1) > LIST_RULES.scale / 2
    if check.scale != 1 or not differs or result.verdict in ("scale_undetermined", "not_converged"):
        return fit
    right = ~np.isin(np.arange(len(listed)), fit.misplaced)
    size, sigma = _size(inputs, listed[check.order], right, fit.rms / np.sqrt(listed.shape[1]), progress)
    if not np.isfinite(sigma):
        return fit
    off, limit = abs(size - 1), LIST_RULES.scale
    # Unless both calibrations agree, the second one has found another array.
    confirmed = abs(size - fit.scale) < limit and (size - 1) * (fit.scale - 1) > 0
    return replace(fit, scale=size, sized=confirmed and off > max(limit, DOCTOR_RULES.size_sigmas * sigma))


def _list(
    inputs: CalibrationInput, result: Calibration, check: PositionCheck, progress: ProgressReport | None
) -> Answer:
    """Return whether the list fits: its order, its size, and each microphone."""
    measurement = inputs.measurement
    listed, names = np.asarray(measurement.positions), measurement.names
    if result.known:  # it is the second calibration, which was given the list
        check = compare_positions(result.positions, listed)
    sure = result.verdict == "good"
    if not check.fits:
        text = "the list does not fit the array found in any order: it belongs to another array, or is mostly far off"
        text += "" if sure else f"; {result.verdict_text}"
        return Answer("list", "fault" if sure else "unknown", text, found=(("other", ""),) if sure else ())
    fit = list_fit(inputs, result, check, progress)
    faults = list_faults(check, fit, names)
    moved = np.flatnonzero(check.order != np.arange(len(listed)))
    kinds = [("swapped", names[n]) for n in moved] + [("misplaced", names[n]) for n in fit.misplaced]
    kinds += [("repeated", names[n]) for n in fit.repeated]
    kinds += ([("off", "")] if fit.poor and sure else []) + ([("size", "")] if fit.sized else [])
    unknown = fit.poor or (check.scale != 1 and not sure)  # the size of an untrusted array says nothing about the list
    rms = 1e3 * fit.rms  # mm
    state = "fault" if faults else "unknown" if unknown else "fine"
    text = "; ".join(faults) or f"the list fits to {rms:.1f} mm, its size differs by {100 * (fit.scale - 1):+.1f} %"
    text += "" if faults or not unknown else f"; {result.verdict_text}"
    return Answer("list", state, text, rms, "mm", tuple(kinds))
