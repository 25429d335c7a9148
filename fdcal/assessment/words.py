"""A result in words: the sentences, in plain text, that terminal, page, HTML and notebook show.

`result_sentences` describes a calibration, `fault_words` a fault of a channel, `list_faults` and
`comparison_sentences` the comparison with a list of positions.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..model.measurement import Measurement
from ..model.validation import length_text, word_arguments
from ..solvers.interface import RunState
from .calibration import Calibration, ChannelFault
from .position_check import MAX_SCALE, TRUSTED, ListFit, PositionCheck

MIN_MOVE = 1e-3  # metres, smallest correction of a given position that is mentioned
MAX_ROWS = 12  # largest number of rows of the table of given positions
# why a run that did not converge can have the verdict "good"
STEP_LEFT = "the remaining step is small compared with one sigma"


def end_word(converged: bool, trusted: bool) -> str:
    """Return how a run ended, in words; "Ended" means that it did not converge, but its result is trusted."""
    return "Converged" if converged else "Ended" if trusted else "Stopped before it converged"


NOT_STARTED = "Not started"
SMALLEST = 1e-5  # metres; a smaller error is stated as "less than" this


def state_word(state: RunState, running: bool, error: str = "", verdict: str = TRUSTED) -> str:
    """Return what the solver is doing or, after the end of the run, the result of `end_word`.

    A run counts as trusted unless another `verdict` is given.
    """
    if not error and not state.finished and state.best_positions is not state.positions:
        return f"{'Trying' if running else 'Paused at'} another start; the best so far is kept"
    if error or running:
        return "Stopped by an error" if error else "Running"
    waiting = "Paused" if state.step else NOT_STARTED
    return end_word(state.converged, verdict == TRUSTED) if state.finished else waiting


def row_label(measurement: Measurement, mode: int) -> str:
    """Return the name of a row: "frequency 38, 211.5 Hz", or with several takes "frequency 38, take 1, 211.5 Hz"."""
    take = f", take {measurement.takes[mode - 1]}" if measurement.take_count > 1 else ""
    return f"frequency {mode}{take}, {measurement.frequencies[mode - 1]:.1f} Hz"


def count_label(measurement: Measurement, modes: tuple[int, ...]) -> str:
    """Return how many rows are summed: "20 frequencies", "20 frequencies of take 1", "40 frequencies of 2 takes"."""
    count, takes = len(modes), np.unique(measurement.takes[np.asarray(modes) - 1])
    text = f"{count} {'frequencies' if count > 1 else 'frequency'}"
    if measurement.take_count == 1:
        return text
    return f"{text} of {f'take {takes[0]}' if len(takes) == 1 else f'{len(takes)} takes'}"


def plane_words(measurement: Measurement) -> str:
    """Return a sentence if the heights of the microphones are not sought; else ""."""
    return "all microphones are sought in one plane" if measurement.array_dimension < measurement.dimension else ""


def modes_label(measurement: Measurement, modes: tuple[int, ...]) -> str:
    """Return the names of the rows of a map, ascending.

    Examples are "frequency 38", "frequencies no. 1 to 20" and "4 frequencies between no. 2 and no. 9".
    """
    first, last, count = modes[0], modes[-1], len(modes)
    if count == 1:
        return row_label(measurement, first).rpartition(", ")[0]
    if measurement.take_count > 1:
        return count_label(measurement, modes)
    whole = last - first + 1 == count
    return f"frequencies no. {first} to {last}" if whole else f"{count} frequencies between no. {first} and no. {last}"


def band_label(measurement: Measurement, modes: tuple[int, ...]) -> str:
    """Return the frequencies of the modes of a map: "211.5 Hz", "34 to 392 Hz"."""
    f = measurement.frequencies[np.asarray(modes) - 1]
    return f"{f[0]:.1f} Hz" if f.min() == f.max() else f"{f.min():.0f} to {f.max():.0f} Hz"


def cost_words(cost: float, corrected: bool = False) -> str:
    """Return the reference cost, dB, and its meaning; "unknown" for NaN.

    corrected : whether the gains of the channels are corrected
    """
    number = "unknown" if np.isnan(cost) else f"{cost:.1f} dB"
    return f"{number} (Eq. 7, {'gains corrected' if corrected else 'all frequencies'})"


def result_title(result: Calibration) -> str:
    """Return a result in one line, for the head of a picture or a page."""
    error = "" if result.mean_error is None else f", {error_words(result)}"
    return f"{len(result.positions)} microphones, solver {result.solver}: {result.verdict or 'no verdict'}{error}"


def listed(parts: Iterable[str]) -> str:
    """Return names as a text: "a, b and c"."""
    names = list(parts)
    return ", ".join(names) if len(names) < 2 else f"{', '.join(names[:-1])} and {names[-1]}"


def counted(count: int, noun: str) -> str:
    """Return a number of things: "1 take", "2 takes"."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def result_sentences(
    result: Calibration, measurement: Measurement, given: Sequence[int] = (), truth: str = ""
) -> dict[str, str]:
    """Return what a calibration found: sentences by heading, in the order of display.

    given : numbers of the microphones whose positions the solver was given; truth : name of the measurement's
    positions, by default "the true positions" or "the nominal positions"
    """
    f, takes, nominal = result.frequencies, measurement.take_count, measurement.nominal
    end = end_word(result.converged, result.verdict == TRUSTED)
    said = {
        "band": f"{len(f)} frequencies{f' of {takes} takes' if takes > 1 else ''}, {f[0]:.1f} to {f[-1]:.1f} Hz",
        "run": f"{result.sweeps} sweeps in {result.elapsed:.1f} s, {end[0].lower()}{end[1:]}",
    }
    if end == "Ended":
        said["run"] += f"; {STEP_LEFT}"
    if result.cost_db is not None:
        said["cost"] = f"{result.cost_db:.1f} dB, the unexplained power (Eq. 7, all usable frequencies)"
    numbers = result.counted(given)
    error = ""
    if result.mean_error is not None and result.max_error is not None:
        truth = truth or ("the nominal positions" if nominal else "the true positions")
        faultless = " without a faulty channel" if len(result.healthy) < len(result.names) else ""
        sought = " sought" if len(given) and not np.isin(numbers, given).any() else ""
        over = f"{'the' if faultless or sought else 'all'} {len(numbers)} microphones{sought}{faultless}"
        error = f"{error_words(result)} over {over}"
        error += f", moved as a whole onto {truth}" if result.aligned else f", against {truth}" if nominal else ""
    if result.uncertainty is not None:
        sigma = length_text(float(np.sqrt(np.mean(result.uncertainty[numbers] ** 2))), 2)
        error += f"; one sigma {sigma}" if error else f"expected: one sigma {sigma}"
    said["error"] = error
    if (evidence := result.evidence) is not None:
        overall, each, modes = evidence.leave_one_out_db, evidence.microphones_db, evidence.frequencies_db
        said["predict"] = "no leave-one-out prediction in the file"
        if overall is not None and each is not None and modes is not None:
            n, m = int(result.healthy[each[result.healthy].argmax()]), int(modes.argmax())
            said["predict"] = (
                f"{prediction_words(overall)} (at best minus the SNR; 0 dB: nothing is predicted); worst microphone:"
                f" {result.names[n]}, {each[n]:.1f} dB; worst frequency: {f[m]:.1f} Hz, {modes[m]:.1f} dB"
            )
    if (channels := result.channels) is not None:
        spread = gain_words(result) if channels.gains_sought else "gains taken as equal"
        faults = faults_text(channels.faults)
        said["channels"] = f"{spread}; {'faulty: ' + faults if faults else 'none is faulty'}"
    said["verdict"] = f"{result.verdict}: {result.verdict_text}"
    return said


def fault_words(fault: ChannelFault) -> str:
    """Return the fault of a channel or a given position in words, without the name of the microphone.

    Examples
    --------
    >>> fault_words(ChannelFault("17", "inverted"))
    'inverted'
    >>> fault_words(ChannelFault("4", "delayed", 3e-4, "s"))
    'delayed by 0.3 ms'
    >>> fault_words(ChannelFault("6", "high_pass", -30.7, "Hz"))
    'more bass than the others, which lose level below about 31 Hz'
    """
    value = fault.value or 0.0
    words = {
        "copy": f"a copy of {fault.partner}",
        "noisy": f"noise {value:.0f} dB over the others'",
        "delayed": f"delayed by {1e3 * value:.2g} ms",
        "high_pass": f"less bass than the others: it loses level below about {value:.0f} Hz"
        if value > 0
        else f"more bass than the others, which lose level below about {-value:.0f} Hz",
        "gain": f"phase {value:.0f} degrees" if fault.unit == "degrees" else f"gain {value:+.1f} dB",
        "misplaced": f"{length_text(value)} from the position given",
        "swapped": f"swapped with microphone {fault.partner}",
    }
    return words.get(fault.kind, fault.kind)


def clock_words(kind: str, value: float, since: float) -> str:
    """Return the fault of a channel's clock in words: a "drift" of `value` ppm, a "jump" of `value` s, or "lost"."""
    if kind == "drift":
        return f"drifts by {value:+.3g} ppm"
    if kind == "jump":
        return f"jumps by {1e3 * value:+.3g} ms at about {since:.3g} s"
    return f"has another clock than the others from {since:.3g} s on"


def faults_text(faults: Iterable[ChannelFault]) -> str:
    """Return the faults of several microphones, as in "microphones 4 and 9: dead; microphone 17: inverted"."""
    names = dict[str, list[str]]()
    for fault in faults:
        names.setdefault(fault_words(fault), []).append(fault.name)
    return "; ".join(f"microphone{'' if len(of) == 1 else 's'} {listed(of)}: {fault}" for fault, of in names.items())


def error_words(result: Calibration) -> str:
    """Return mean and largest error of a result that has them."""
    assert result.mean_error is not None and result.max_error is not None
    return f"mean {length_text(result.mean_error)}, largest {length_text(result.max_error)}"


def error_parts(errors: np.ndarray | None, aligned: bool = False, nominal: bool = False) -> tuple[str, str, str]:
    """Return the name of errors (K,), metres, their figures, and remarks on the comparison; all "" without errors.

    errors : None if the true positions are unknown; aligned : whether the array was moved as a whole onto the positions
    with which it is compared; nominal : whether these are nominal
    """
    if errors is None:
        return "", "", ""
    figures = length_text(float(errors[0]))
    if len(errors) > 1:
        figures = f"mean {length_text(float(errors.mean()))}, largest {length_text(float(errors.max()))}"
    remarks = [words for words, said in (("from nominal", nominal), ("after alignment", aligned)) if said]
    return "deviation" if nominal else "error", figures, ", ".join(remarks)


def error_line(errors: np.ndarray | None, aligned: bool = False, nominal: bool = False) -> str:
    """Return `error_parts` in one line; "" without errors."""
    noun, *others = error_parts(errors, aligned, nominal)
    return f"{noun}: {', '.join(filter(None, others))}" if noun else ""


def state_error_words(measurement: Measurement, errors: np.ndarray | None, faulty: int = 0) -> str:
    """Return the error of a state in a few words, as in "0.3 mm off on average"; "" if it is unknown.

    errors : (K,), metres, of the healthy microphones; faulty : number of the others
    """
    if errors is None:
        return ""
    mean = float(errors.mean())
    size = f"less than {length_text(SMALLEST)}" if 0 < mean < SMALLEST else length_text(mean)
    text = f"{size} {'from nominal' if measurement.nominal else 'off'}{' on average' if len(errors) > 1 else ''}"
    return text + (f" without {counted(faulty, 'faulty channel')}" if faulty else "")


def prediction_words(leave_one_out_db: float | None) -> str:
    """Return the leave-one-out error in words; "" if it is unknown."""
    return "" if leave_one_out_db is None else f"leave-one-out error {leave_one_out_db:.1f} dB"


def gain_words(result: Calibration) -> str:
    """Return how gains and phases of the healthy channels differ, in words, for a result with channels."""
    assert result.channels is not None
    each = (result.channels.gain_db, result.channels.phase_deg)
    gain, phase = (float(np.std(values[result.healthy])) for values in each)
    gains = f"gains spread by {gain:.2f} dB" if gain >= 0.005 else "no differences of gain found"
    return f"{gains}, {f'phases by {phase:.1f} degrees' if phase >= 0.05 else 'no differences of phase found'}"


def given_table(result: Calibration) -> tuple[str, list[list[str]]] | None:
    """Return a sentence on the given positions that were corrected by more than MIN_MOVE, and a table of them.

    The first row of the table holds the headings. The result is None if there are no such positions.
    """
    given = () if result.channels is None else result.channels.given
    rows = sorted((one for one in given if one.difference > MIN_MOVE), key=lambda one: -one.difference)
    if not rows:
        return None
    table = [["microphone", "given (m)", "found (m)", "difference", "one sigma", ""]]
    for one in rows[:MAX_ROWS]:
        places = (", ".join(f"{x:z.4f}" for x in place) for place in (one.given, one.found))
        lengths = (length_text(x, 2) for x in (one.difference, one.sigma))
        table.append([one.name, *places, *lengths, "wrong" if one.wrong else ""])
    more = f"; the {MAX_ROWS} largest corrections" if len(rows) > MAX_ROWS else ""
    head = f"{len(rows)} of {len(given)} given positions corrected by more than {1e3 * MIN_MOVE:g} mm{more}"
    if result.verdict == TRUSTED and not any(one.wrong for one in given):
        head += "; none of them contradicts the pressures"
    return head, table


def list_faults(check: PositionCheck, fit: ListFit | None, names: Sequence[object]) -> list[str]:
    """Return the faults of a list that fits the array found, in words: swapped channels, wrong rows, its size."""
    found = [f"channels {names[a]} and {names[b]} are swapped" for a, b in check.swapped]
    for cycle in check.permuted:
        found.append(f"channels {', '.join(str(names[n]) for n in cycle)} are swapped in a cycle")
    if fit is None:
        return found
    found += [f"{names[n]} is {1e3 * fit.errors[n]:.0f} mm from its listed position" for n in fit.misplaced]
    if fit.poor and fit.trusted:
        found.append(f"the listed positions are {1e3 * fit.rms:.0f} mm off (RMS)")
    if fit.sized:
        found.append(_of_size(fit.scale))
    if fit.repeated:
        sharing = ", ".join(str(names[n]) for n in fit.repeated)
        found.append(f"the list gives the same position to more than one microphone: {sharing}")
    return found


def _of_size(scale: float) -> str:
    """Return what it means, in words, if a list is `scale` times as large as the array found.

    Pressures depend on k r only. If the sound speed is higher than assumed, the array is found too small by the same
    factor, and the list seems too large. The absolute temperature is proportional to the square of the sound speed.
    """
    kelvin = 293.15 * (scale**2 - 1)
    air = f"{abs(kelvin):.0f} K {'warmer' if kelvin > 0 else 'colder'} than assumed"
    size = f"{100 * abs(scale - 1):.1f} % too {'large' if scale > 1 else 'small'}"
    return f"the list is {size}, or the air is {air}"


MAX_LISTED = 0.5  # fraction of swapped microphones above which the swaps are not named one by one
UNITS = (("centimetres", 100.0), ("millimetres", 1000.0), ("feet", 3.281), ("inches", 39.37))  # number in a metre
UNIT_TOLERANCE = 0.1  # a unit is suggested if the list's scale differs from its factor by less than this fraction


def comparison_sentences(
    check: PositionCheck,
    names: Sequence[object],
    verdict: str = TRUSTED,
    known: bool = True,
    arguments: Mapping[str, str] | None = None,
    fit: ListFit | None = None,
) -> list[str]:
    """Return a comparison in words: the faults of the list, then the error of every microphone, the largest first.

    verdict : verdict of the calibration; unless it is "good", the absence of swaps is only stated if every microphone
    is near its listed position; known : whether known microphones fixed the frame; fit : how the rows fit, if it was
    computed
    """
    advice = word_arguments("; try <known> none", arguments or {}) if known else ""
    untrusted = "" if verdict == TRUSTED else f"not to be trusted ({verdict}){advice}"
    near = 1 / MAX_SCALE < check.scale < MAX_SCALE
    if check.fits:
        # If `check.scale` is not 1, the size is described at the end, and not among the faults.
        rows = None if fit is None else replace(fit, sized=fit.sized and check.scale == 1)
        moved = np.count_nonzero(check.order != np.arange(len(names)))
        lines = list_faults(check, rows, names)
        if moved > MAX_LISTED * len(names):
            swaps = len(check.swapped) + len(check.permuted)
            lines[:swaps] = [f"{moved} of {len(names)} channels are swapped{_pattern(check.order)}"]
        elif not moved:
            lines.insert(0, _unchanged(check, verdict, untrusted, fit))
    else:
        reason = "it belongs to another array, or most of its positions are far off"
        if untrusted:
            reason = f"the positions found are {untrusted}, or it belongs to another array"
        lines = [f"the list does not fit the array found in any order: {reason}"]
    if check.fits and check.symmetric:
        lines.append(
            "the list also fits when rotated or mirrored, since the array is symmetric: without known microphones a"
            " swap of most channels cannot be detected"
        )
    if check.fits and check.moved and check.scale == 1:  # a list in other units always has other axes
        lines.append("list and known positions have different axes: the array found is moved onto the list as a whole")
    if check.scale != 1:
        units = [name for name, factor in UNITS if abs(check.scale / factor - 1) < UNIT_TOLERANCE]
        hint = f": is it in {units[0]}? Give metres" if units else ""
        size = f"the list is about {check.scale:.3g} times as large as the array found"
        size = _of_size(check.scale) if check.fits and near else size
        after = "; the distances are those after the list is scaled to the size of the array" if check.fits else ""
        lines.append(f"{size}{hint}{after}")
    for n in np.argsort(-check.errors, kind="stable").tolist():
        row = f"{names[n]!s:>12}  {1e3 * check.errors[n]:8.1f} mm"
        if check.order[n] != n:
            row += f"  at the place of {names[int(check.order[n])]}, within {1e3 * check.distances[n]:.1f} mm"
        lines.append(row)
    return lines


def _pattern(order: np.ndarray) -> str:
    """Return a description of an order of the list that follows a rule; "" for any other order."""
    count, own, shift = len(order), np.arange(len(order)), int(order[0])
    if np.array_equal(order, own[::-1]):
        return ": the list is in reverse"
    for first in (0, 1):
        if np.array_equal(order, np.argsort(sorted(range(first, first + count), key=str))):
            return ": its rows are sorted as text (1, 10, 11, ...); it fits if they are sorted as numbers"
    if not np.array_equal(order, (own + shift) % count):
        return ""
    half = " (its halves are swapped)" if 2 * shift == count else ""
    shift = shift if 2 * shift <= count else shift - count
    return f": the list is shifted by {shift} row{'s' if abs(shift) > 1 else ''}{half}"


def _unchanged(check: PositionCheck, verdict: str, untrusted: str, fit: ListFit | None) -> str:
    if not untrusted:
        return "no channels are swapped"
    misplaced = fit.misplaced if fit is not None else ()  # `list_faults` names these
    errors, spacing = (np.delete(values, misplaced) for values in (check.errors, check.spacing))
    if len(errors) and np.all(errors < spacing / 2):
        largest, least = (length_text(float(x), 2) for x in (errors.max(), spacing.min()))
        others = " of the others" if misplaced else ""
        return (
            f"no swap is detected: the largest distance{others}, {largest}, is far below the spacing of the"
            f" microphones, {least}, though the verdict is {verdict}"
        )
    return f"swaps cannot be detected from positions that are {untrusted}"
