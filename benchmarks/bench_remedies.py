"""Whether the remedies that a verdict prints help: does the error fall, or does the verdict become right?

Jobs are the cases of `benchmarks.field`, each calibrated by several users (USERS), family by family, until WANTED of
them have printed a remedy or FDCAL_BENCH_DRAWS cases of each family (40 unless given) have been tried.
The table REMEDIES maps the words that fdcal can print to the action of somebody who follows them. A remedy helps if
the RMS error falls by a fifth, or if the answer is called good and is right (`benchmarks.field.score`). A remedy that
cannot be followed, such as more modes if all are in use, counts as no help. A remedy that does not help in most jobs
does not belong in a verdict.
"""

import io
import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fdcal.assessment.calibration import Calibration
from fdcal.model.measurement import load_measurement, with_known
from fdcal.model.storage import cache_folder
from fdcal.model.validation import InputError
from fdcal.session.calibration_run import solve
from fdcal.session.sources import CalibrationInput, measurement_input, with_settings

from .field.cases import Case, NoCaseError, build
from .field.families import FAMILIES
from .field.score import CONFIDENT_ERROR, RIGHT_ERROR, RMS_SIGMAS, _aligned
from .field.spec import Spec
from .report import Figure

ALONE = True
WANTED, FEWEST = 10, 10
DRAWS = int(os.environ.get("FDCAL_BENCH_DRAWS", "40"))
FAMILIES_WANTED = [name for name in os.environ.get("FDCAL_BENCH_FAMILIES", "").split(",") if name] or list(FAMILIES)
FALLS = 0.8  # of the error before
LOUDER_DB = 10.0
FEWER = 0.35  # of the modes, as of somebody who has chosen few
WIDER = 1.6  # of the size of the array, as of somebody who uses all modes with too few microphones
SHORT = 1.5  # seconds, as of somebody who does not want to wait
GIVEN, WRONG, OFFSET = 6, 2, 0.1  # given positions, how many of them are wrong, and by how many metres


@dataclass(frozen=True)
class Job:
    """A case, the input of its calibration, and the result."""

    case: Case
    inputs: CalibrationInput
    result: Calibration


def inputs_of(case: Case) -> CalibrationInput:
    """Return what `fdcal calibrate FILE.npz` would calibrate."""
    file = io.BytesIO()
    np.savez(file, **case.table)
    file.seek(0)
    inputs = measurement_input(load_measurement(file), "case")
    return with_settings(inputs, known=case.spec.known_mode if case.spec.known else None)


def rebuilt(job: Job, **changes) -> Case:
    """Return the case of a spec with other values."""
    return build(replace(job.case.spec, **changes), Path(cache_folder()) / "field")


def in_modes(job: Job, count: int) -> CalibrationInput:
    """Return the inputs with a number of modes; InputError where they are in use already."""
    count = min(count, len(job.inputs.measurement.frequencies))
    if count == len(job.result.frequencies):
        raise InputError("these modes are in use already")
    return with_settings(job.inputs, modes=count)


def more_known(job: Job) -> CalibrationInput:
    """Return the inputs with the true positions of the microphones that the verdict names, too."""
    known = set(job.inputs.measurement.known.tolist()) if job.inputs.settings.known == "all" else set()
    asked = job.result.verdict_text.partition("the positions of microphones ")[2].partition(" (")[0]
    places = {str(n): job.case.positions[n] for n in sorted(known | {int(n) for n in re.findall(r"\d+", asked)})}
    measurement = with_known(job.inputs.measurement, places)
    settings = replace(job.inputs.settings, known="all")
    return replace(job.inputs, measurement=measurement, settings=settings)


def measured_again(job: Job) -> CalibrationInput:
    """Return the inputs with the true positions of the microphones that are given."""
    places = {str(n): job.case.positions[n] for n in job.inputs.measurement.known.tolist()}
    return replace(job.inputs, measurement=with_known(job.inputs.measurement, places))


def with_distance(job: Job) -> CalibrationInput:
    """Return the inputs with one distance."""
    first, second = 0, len(job.case.positions) // 2
    apart = float(np.linalg.norm(np.subtract(*job.case.positions[[first, second]])))
    return replace(job.inputs, distance=(str(first), str(second), apart))


# Words of a verdict, as `InputError` writes arguments, and what somebody does who follows them.
REMEDIES: dict[str, Callable[[Job], CalibrationInput | Case]] = {
    "use modes ": lambda job: in_modes(job, int(job.result.verdict_text.partition("use modes ")[2].split(",")[0])),
    "give the positions of microphones": more_known,
    "closer together": lambda job: rebuilt(job, size=job.case.spec.size / 2),
    "record another take": lambda job: rebuilt(job, takes=job.case.spec.takes + 1),
    "10 dB louder": lambda job: rebuilt(job, snr=(job.case.spec.snr or 60.0) + LOUDER_DB),
    "use time_limit ": lambda job: replace(
        job.inputs, time_limit=float(job.result.verdict_text.split("time_limit ")[1])
    ),
    "check the positions and the cables": measured_again,
    "or one distance": with_distance,
}


def judged(case: Case, result: Calibration) -> tuple[float, bool]:
    """Return the RMS error of the healthy microphones that are sought, metres, and whether the answer is called right.

    A blind array is moved onto the truth as a whole.
    """
    names = [int(name) for name in result.names]
    truth, sick = case.positions[names], {str(n) for n in case.named}
    counted = np.array([name not in sick for name in result.names])
    found = _aligned(result.positions, truth, counted) if result.aligned else result.positions
    counted &= ~np.isin(result.names, result.known)
    errors = np.linalg.norm(found - truth, axis=1)[counted]
    error = float(np.sqrt(np.mean(errors**2)))
    claim = np.inf if result.uncertainty is None else float(np.sqrt(np.mean(result.uncertainty[counted] ** 2)))
    right = error < max(RIGHT_ERROR, min(RMS_SIGMAS * claim, CONFIDENT_ERROR))
    return error, result.verdict == "good" and right


def few_modes(spec: Spec) -> tuple[Case, CalibrationInput]:
    """Return the inputs of somebody who uses a part of the modes."""
    case, inputs = by_default(spec)
    return case, with_settings(inputs, modes=round(FEWER * len(inputs.measurement.frequencies)))


def by_default(spec: Spec) -> tuple[Case, CalibrationInput]:
    """Return the inputs of somebody who leaves everything to fdcal."""
    case = build(spec, Path(cache_folder()) / "field")
    return case, inputs_of(case)


def every_mode(spec: Spec) -> tuple[Case, CalibrationInput]:
    """Return the inputs of somebody who uses all modes with an array that is too large for them."""
    case, inputs = by_default(replace(spec, size=WIDER * spec.size, beyond=True))
    return case, with_settings(inputs, modes=len(inputs.measurement.frequencies))


def impatient(spec: Spec) -> tuple[Case, CalibrationInput]:
    """Return the inputs of somebody who does not want to wait."""
    case, inputs = by_default(spec)
    return case, replace(inputs, time_limit=SHORT)


def wrong_list(spec: Spec) -> tuple[Case, CalibrationInput]:
    """Return the inputs of somebody who gives positions of which two are wrong."""
    case, inputs = by_default(replace(spec, known=GIVEN, known_mode="all", fault=None))
    places = {str(n): case.positions[n].copy() for n in case.known}
    for name in list(places)[:WRONG]:
        places[name][0] += OFFSET
    return case, replace(inputs, measurement=with_known(inputs.measurement, places))


# Who calibrates, and which of REMEDIES the verdict should print; a user is left out once all of these were printed.
ANY = ("",)
USERS: tuple[tuple[Callable[[Spec], tuple[Case, CalibrationInput]], tuple[str, ...]], ...] = (
    (by_default, ANY),
    (few_modes, ANY),
    (every_mode, ("closer together",)),
    (impatient, ("use time_limit ",)),
    (wrong_list, ("check the positions and the cables",)),
)


def jobs(printed: Mapping[str, list[int]]) -> Iterator[Job]:
    """Yield the cases, each calibrated by the users who may still print something new."""
    for spec in (spec for name in FAMILIES_WANTED for spec in FAMILIES[name](DRAWS)):
        for inputs_for, hoped in USERS:
            if all(tried[0] >= WANTED for words, tried in printed.items() if words.startswith(hoped)):
                continue
            try:
                case, inputs = inputs_for(spec)
                yield Job(case, inputs, solve(inputs))
            except (NoCaseError, InputError):
                continue


def run() -> Iterator[Figure]:
    tried = {words: [0, 0, 0] for words in REMEDIES}  # jobs that printed it, followed it, were helped
    for job in jobs(tried):
        before, _ = judged(job.case, job.result)
        for words, follow in REMEDIES.items():
            if job.result.verdict == "good" or words not in job.result.verdict_text or tried[words][0] >= WANTED:
                continue
            tried[words][0] += 1
            try:
                other = follow(job)
                case, inputs = (other, inputs_of(other)) if isinstance(other, Case) else (job.case, other)
                after, trusted = judged(case, solve(inputs))
            except (NoCaseError, InputError) as error:
                print(f"  {words}: not followed ({error})", flush=True)
                continue
            print(f"  {words}: {job.result.verdict}, {1e3 * before:.1f} -> {1e3 * after:.1f} mm, {trusted}", flush=True)
            tried[words][1] += 1
            tried[words][2] += trusted or after < FALLS * before
        if all(one[0] >= WANTED for one in tried.values()):
            break
    for words, (printed, followed, helped) in tried.items():
        target = "more than half" if printed >= FEWEST else "too few jobs"
        met = 2 * helped > printed if printed >= FEWEST else None
        yield Figure(f'"{words.strip()}" helps; {followed} followed', helped, f"of {printed}", target, met)
