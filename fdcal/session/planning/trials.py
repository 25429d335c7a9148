"""Simulated calibrations of a plan: random sources, noise and gains, and the real solver."""

import functools
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from ...assessment.calibration import Calibration
from ...assessment.uncertainty import Information, position_bound
from ...model.measurement import Measurement
from ...model.settings import SolverSettings
from ...model.validation import InputError
from ..calibration_run import solve
from ..sources import CalibrationInput
from .bounds import field_of, wavenumbers_of
from .request import PlanRequest

MAX_FREQUENCIES = 120  # of a simulated calibration: more take longer and hardly change the answer
FOUND_BOUNDS = 3.0  # times the bound: an array whose error is below was found
MIN_FOUND_M = 0.005  # likewise: half of the accuracy that is wanted by default
TRIALS_PER_WORKER = 5  # at least, which take longer than the start of a process
MAX_WORKERS = 16  # by default


@dataclass(frozen=True)
class Trials:
    """Results of simulated calibrations."""

    errors: np.ndarray  # (T, N) float64, metres, of every microphone; NaN in a trial that was refused
    verdicts: tuple[str, ...]  # (T,) tuple of str, "refused" where the solver could not start
    free: np.ndarray  # (N,) bool, microphones that are sought
    bound: float  # metres, root mean square of the bound for as many frequencies as the trials use
    accuracy: float  # metres, that is wanted
    seconds: float  # of processor time a calibration, median

    @property
    def rms(self) -> np.ndarray:
        """Root mean square error of the sought microphones in each trial : (T,) float64, metres."""
        return np.sqrt(np.mean(self.errors[:, self.free] ** 2, axis=1))

    @property
    def margin(self) -> float:
        """Median error over the bound, at least 1; infinite where most trials were refused."""
        return max(self.percentile(50) / self.bound, 1.0)

    @property
    def found(self) -> float:
        """Fraction of trials in which the array was found: error below 5 mm or three times the bound."""
        return float(np.mean(self.rms < max(MIN_FOUND_M, FOUND_BOUNDS * self.bound)))

    @property
    def accurate(self) -> float:
        """Fraction of trials in which every microphone is within the accuracy that is wanted."""
        return float(np.mean(np.all(self.errors[:, self.free] < self.accuracy, axis=1)))

    @property
    def trusted_wrongly(self) -> float:
        """Fraction of trials with verdict good in which the array was not found."""
        wrong = ~(self.rms < max(MIN_FOUND_M, FOUND_BOUNDS * self.bound))
        return float(np.mean(wrong & (np.array(self.verdicts) == "good")))

    def percentile(self, q: float) -> float:
        """Return a percentile of the trials' root mean square errors, metres; infinite where trials were refused."""
        return float(np.percentile(np.where(np.isfinite(self.rms), self.rms, np.inf), q, method="higher"))


def run_trials(
    request: PlanRequest,
    information: Information,
    count: int,
    progress: Callable[[float, str], None] | None = None,
    workers: int = 1,
) -> Trials:
    """Return the results of `count` simulated calibrations; `information`: of all frequencies of the request.

    `workers` processes share them, on which the results do not depend. With more than one, a script that calls this
    needs the guard `if __name__ == "__main__"` that `multiprocessing` asks for.
    """
    used = len(request.spaced(MAX_FREQUENCIES)) / len(request.frequencies)
    bound = position_bound(information.scaled(used), request.prior)
    done: list[Outcome] = []
    with _mapping(workers) as mapped:
        for outcome in mapped(functools.partial(run_trial, request), range(count)):
            done.append(outcome)
            if progress is not None:
                progress(len(done) / count, f"trial {len(done)} of {count}")
    lost = np.full(len(bound.free), np.nan)
    return Trials(
        np.array([lost if one.errors is None else one.errors for one in done]),
        tuple(one.verdict for one in done),
        bound.free,
        bound.rms,
        request.accuracy,
        float(np.median([one.seconds for one in done])),
    )


def workers_for(count: int) -> int:
    """Return how many processes are worth their start for `count` trials on this machine."""
    return max(1, min(os.cpu_count() or 1, MAX_WORKERS, count // TRIALS_PER_WORKER))


@contextmanager
def _mapping(workers: int) -> Iterator[Callable]:
    """Yield `map`, or that of a pool of processes, whose trials end with the block."""
    if workers == 1:
        yield map
        return
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _ignore_interrupt)
    try:
        yield pool.map
    except BrokenProcessPool as error:
        raise InputError("a worker process has ended", "use fewer <workers>", key="workers", value=workers) from error
    finally:
        pool.shutdown(cancel_futures=True)


def _ignore_interrupt() -> None:
    """In a worker: Ctrl-C ends the process that waits for it, and that ends the workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@dataclass(frozen=True)
class Outcome:
    """One trial: errors (N,) float64, metres, or None where the solver refused; its verdict; processor time, s."""

    errors: np.ndarray | None
    verdict: str
    seconds: float


def run_trial(request: PlanRequest, trial: int) -> Outcome:
    """Return the outcome of a simulated calibration, which depends on the request and the number of the trial alone."""
    began = time.process_time()
    found = _calibrate(draw_measurement(request, trial), request, trial)
    seconds = time.process_time() - began
    return Outcome(None, "refused", seconds) if found is None else Outcome(found.errors, found.verdict, seconds)


def draw_measurement(request: PlanRequest, trial: int) -> Measurement:
    """Return what the microphones measure of random sources, with noise, gains and errors of the given positions.

    Each take is the field of another source, with noise of its own; the microphones and their gains are those of all.
    """
    rng = np.random.default_rng([request.seed, 7, trial])
    frequencies, x = request.spaced(MAX_FREQUENCIES), request.layout.positions
    clean = field_of(request, frequencies, rng)
    noise = 10 ** (-request.snr_db / 10)
    gain = 10 ** (request.gain_sigma_db / 20 * rng.normal(size=len(x)))
    parts = rng.normal(scale=np.sqrt(noise / 2), size=(2, *clean.shape))
    known = np.array(request.known, int)
    first = Measurement(
        frequencies=frequencies,
        pressures=clean * gain + parts[0] + 1j * parts[1],
        sound_speed=request.sound_speed,
        dimension=request.dimension,
        array_dimension=x.shape[1],
        wavenumbers=wavenumbers_of(request, frequencies),
        noise_power=np.full(len(frequencies), noise),
        names=request.layout.names,
        positions=x,
        known=known,
        known_positions=x[known] + request.known_sigma * rng.normal(size=(len(known), x.shape[1])),
    )
    takes = [first]
    while len(takes) < request.takes:
        other, parts = field_of(request, frequencies, rng), rng.normal(scale=np.sqrt(noise / 2), size=parts.shape)
        takes.append(replace(first, pressures=other * gain + parts[0] + 1j * parts[1]))
    return first if request.takes == 1 else Measurement.from_takes(takes)


def _calibrate(measurement: Measurement, request: PlanRequest, trial: int) -> Calibration | None:
    """Return the calibration of a simulated measurement, None if the solver refuses it."""
    modes = len(measurement.frequencies)
    settings = SolverSettings(
        name=request.solver,
        modes=modes,
        first_modes=min(3, modes),
        gains="auto" if request.gain_sigma_db else "fixed",
        gain_sigma_db=request.gain_sigma_db or None,
        known_sigma=request.known_sigma or None,
    )
    try:
        return solve(CalibrationInput("plan", None, measurement, settings, trial))
    except InputError:
        return None
