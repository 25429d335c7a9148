"""The result of a calibration: `Calibration`, its parts, and its errors against the true positions.

`fdcal.METHODS` binds methods that other modules implement: files, tables, pictures, formats of other programs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from ..model.gauge import align, in_frame, position_errors
from ..model.measurement import Measurement, MicrophonePositions
from ..model.problem import ChannelCorrection, Problem
from ..model.settings import SolverSettings
from ..model.validation import InputError, frozen_array, length_text

DECIBELS_PER_NEPER = 20 / np.log(10)
CHANNEL_NUMBERS = ("gain_db", "gain_sigma_db", "phase_deg", "phase_sigma_deg", "noise_db")  # attributes of `Channels`


class FrozenArrays:
    """Replaces the attributes that `arrays` names by read-only float64 copies, where they are given."""

    arrays: ClassVar[tuple[str, ...]]

    def __post_init__(self):
        for name in self.arrays:
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen_array(getattr(self, name), float))


@dataclass(frozen=True, eq=False)
class Evidence(FrozenArrays):
    """The figures behind a verdict.

    Attributes
    ----------
    residual_to_noise : float
        Reduced chi-square of the pressures: power of the residual divided by that of the noise.
    leave_one_out_db : float or None
        Leave-one-out prediction error relative to the pressure, decibels, of all microphones and frequencies together.
    microphones_db : (N,) float64 or None
        The same for each microphone.
    frequencies_db : (M,) float64 or None
        The same for each frequency.
    noise_to_given : float or None
        Ratio of the noise that the solver finds, one fraction for all frequencies, to the median of the given noise;
        the verdict model_mismatch quotes it. None if the given noise is 0, or none is given.
    """

    arrays = "microphones_db", "frequencies_db"
    residual_to_noise: float
    leave_one_out_db: float | None = None
    microphones_db: np.ndarray | None = None
    frequencies_db: np.ndarray | None = None
    noise_to_given: float | None = None


@dataclass(frozen=True)
class FaultKind:
    """What all faults of a kind have in common."""

    question: str  # question of `fdcal doctor` to which the fault belongs
    mend: bool = False  # whether the user can repair it, by exchanging cables or by correcting a row of a list
    minor: bool = False  # whether the microphone may just be of another type, whose response a calibration corrects


# All kinds of faults, for verdict, `--check`, import, `fdcal record` and `fdcal doctor`. `fdcal.recordings.channels`
# finds faults of samples, `fdcal.recordings.synchrony` those of clocks, `fdcal.assessment.channels` those of channels
# and given positions, `fdcal.assessment.position_check` those of lists, and `fdcal.session.doctor` those of whole
# recordings.
FAULTS: Mapping[str, FaultKind] = MappingProxyType({
    "silent": FaultKind("samples", mend=True),
    "clipped": FaultKind("samples"),
    "copy": FaultKind("samples", mend=True),
    "wrapped": FaultKind("wrapped"),
    "drift": FaultKind("synchronous"),
    "jump": FaultKind("synchronous"),
    "lost": FaultKind("synchronous"),
    "field": FaultKind("field"),
    "rays": FaultKind("measured"),
    "inverted": FaultKind("channels", mend=True),
    "dead": FaultKind("channels", mend=True),
    "noisy": FaultKind("channels", mend=True),
    "delayed": FaultKind("channels"),
    "high_pass": FaultKind("channels", minor=True),
    "gain": FaultKind("channels", minor=True),
    "swapped": FaultKind("list", mend=True),
    "misplaced": FaultKind("list", mend=True),
    "repeated": FaultKind("list", mend=True),
    "off": FaultKind("list", mend=True),
    "size": FaultKind("list", mend=True),
    "other": FaultKind("list", mend=True),
})  # fmt: skip
OF_LIST = frozenset(kind for kind, one in FAULTS.items() if one.question == "list")  # faults of given positions


@dataclass(frozen=True)
class ChannelFault:
    """What is wrong with a channel, or with the position given for it; `fdcal.assessment.words` has the sentences.

    Attributes
    ----------
    name : str
        Name of the microphone.
    kind : str
        A key of `FAULTS`. A result has the kinds "inverted", "dead", "noisy", "delayed", "high_pass", "gain",
        "misplaced" and "swapped", which `fdcal.assessment.channels` explains.
    value : float or None
        Gain or noise relative to the median channel in decibels, phase in degrees, delay in seconds, corner frequency
        minus that of the others in hertz, or distance from the given position in metres.
    unit : str
        Unit of `value`: "dB", "degrees", "s", "Hz" or "m"; "" without a value.
    partner : str or None
        Name of the other microphone of a swap or a copy.
    """

    name: str
    kind: str
    value: float | None = None
    unit: str = ""
    partner: str | None = None


@dataclass(frozen=True)
class GivenPosition:
    """A given position and the one found for its microphone.

    Examples
    --------
    >>> GivenPosition("7", (0.0, 0.0), (0.003, 0.004), 0.001, True).difference
    0.005
    """

    name: str  # name of the microphone
    # given, found: metres
    given: tuple[float, ...]
    found: tuple[float, ...]
    sigma: float  # metres, one sigma of the position found, the square root of the trace of its covariance
    wrong: bool  # whether the pressures contradict the position given

    @property
    def difference(self) -> float:
        """Distance of the position found from the one given, metres."""
        return math.dist(self.given, self.found)


@dataclass(frozen=True, eq=False)
class Channels(FrozenArrays):
    """Gain and noise of every channel, and the positions found where positions were given.

    Solver "robust" estimates gains and corrects given positions. Solver "joint" takes gains as 1 except for gross
    faults, and given positions as exact.

    Attributes
    ----------
    gain_db, gain_sigma_db : (N,) float64
        Gain relative to that of the median channel, and its standard deviation, decibels.
    phase_deg, phase_sigma_deg : (N,) float64
        Phase relative to that of the median channel, from -180 to 180, and its standard deviation, degrees.
    noise_db : (N,) float64
        Noise relative to that of the median channel, decibels.
    faults : tuple of ChannelFault
        Faults of channels and of given positions, in the order of the microphones.
    given : tuple of GivenPosition
        Given and found positions of the microphones whose positions were given, in the order of the microphones.
    """

    arrays = CHANNEL_NUMBERS
    gain_db: np.ndarray
    gain_sigma_db: np.ndarray
    phase_deg: np.ndarray
    phase_sigma_deg: np.ndarray
    noise_db: np.ndarray
    faults: tuple[ChannelFault, ...] = ()
    given: tuple[GivenPosition, ...] = ()

    @property
    def gains_sought(self) -> bool:
        """Whether the solver sought the gains, so that they are uncertain."""
        return bool(np.any(self.gain_sigma_db))

    @property
    def faulty(self) -> set[str]:
        """Names of the microphones with a faulty channel; a wrong given position is not a fault of the channel."""
        return {fault.name for fault in self.faults if fault.kind != "misplaced"}

    @property
    def correction(self) -> ChannelCorrection:
        """Gains and noise as factors, which `fdcal.cost` needs."""
        gains = 10 ** (self.gain_db / 20) * np.exp(1j * np.radians(self.phase_deg))
        return ChannelCorrection(gains, 10 ** (self.noise_db / 10))


@dataclass(frozen=True, eq=False)
class Run:
    """The input of a calibration, from which its run can be repeated."""

    measurement: Measurement
    problem: Problem
    settings: SolverSettings
    seed: int
    step: int  # number of steps that the run took
    states: Callable[[], Iterator[Any]]  # runs the solver again and yields its states


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(FrozenArrays):
    """Positions of the microphones of an array, and whether to trust them.

    Attributes
    ----------
    positions : (N, D) float64
        Metres, in the axes that `frame` names, as in every file and table of this result.
    names : tuple of N str
    solver : str
    seed : int
    frequencies : (M,) float64
        Frequencies in use, Hz, ascending.
    cost : float
        What the solver minimised; dimensionless with modes of unit RMS. Solvers minimise different quantities.
    cost_db : float or None
        Eq. 7 summed over all modes whose expansion has fewer functions than there are microphones, dB relative to the
        power of these modes; comparable between solvers.
    sweeps : int
        Number of times that all free microphones were moved.
    elapsed : float
        Duration of the run, seconds.
    converged : bool
    known : tuple of str or None
        Names of the microphones whose positions were given; None if the file does not say.
    excluded : tuple of str
        Names of microphones left out, which have no row in `positions`.
    aligned : bool
        Whether nothing fixes translation, rotation and mirror image, so that the errors are those after the best
        rigid motion.
    mean_error, rms_error, max_error : float or None
        Mean, root mean square and largest of `errors` over the microphones that `counted` returns, metres; None if the
        true positions are unknown.
    errors : (N,) float64 or None
        Distance of each microphone from its true position, metres.
    sound_speed : float or None
        Given or estimated sound speed, m/s.
    verdict : str
        A code of `fdcal.assessment.findings`, such as "good"; "" if the file has none.
    verdict_text : str
        The verdict in words.
    uncertainty : (N,) float64 or None
        One sigma of each position, metres; 0 for a known microphone that the solver did not move.
    covariance : (N, D, D) float64 or None
        Covariance of each position, metres^2.
    evidence : Evidence or None
        The figures behind the verdict.
    channels : Channels or None
        Gain and noise of every channel, and what is wrong with it.
    sound_speed_sigma : float or None
        One sigma of a sound speed that was estimated with the positions, m/s.
    order : tuple of str or None
        If the file has a comparison with a list of positions that fits: for each microphone, the name of the row of the
        list at whose position it stands.
    run : Run or None
        The run that `show` plays, for a result of `fdcal.calibrate`; files do not hold it.

    Examples
    --------
    >>> import fdcal
    >>> found = fdcal.Calibration([[0, 0], [3, 4]], ("a", "b"), "joint", 0, [50.0], 0.1, 3, 1.5, True, verdict="good")
    >>> fdcal.Calibration.from_json(found.to_json()).positions.tolist()
    [[0.0, 0.0], [3.0, 4.0]]
    """

    arrays = "positions", "frequencies", "errors", "uncertainty", "covariance"
    positions: np.ndarray
    names: tuple[str, ...]
    solver: str
    seed: int
    frequencies: np.ndarray
    cost: float
    sweeps: int
    elapsed: float
    converged: bool
    known: tuple[str, ...] | None = None
    excluded: tuple[str, ...] = ()
    aligned: bool = False
    mean_error: float | None = None
    max_error: float | None = None
    errors: np.ndarray | None = None
    sound_speed: float | None = None
    verdict: str = ""
    verdict_text: str = ""
    uncertainty: np.ndarray | None = None
    covariance: np.ndarray | None = None
    evidence: Evidence | None = None
    channels: Channels | None = None
    sound_speed_sigma: float | None = None
    rms_error: float | None = None
    cost_db: float | None = None
    order: tuple[str, ...] | None = None
    run: Run | None = None

    # Methods that modules above this one implement; `fdcal.METHODS` binds them.
    save: ClassVar[Callable[..., None]]
    load: ClassVar[Callable[..., Calibration]]
    to_json: ClassVar[Callable[..., str]]
    from_json: ClassVar[Callable[..., Calibration]]
    export: ClassVar[Callable[..., None]]
    to_dataframe: ClassVar[Callable[..., Any]]
    plot: ClassVar[Callable[..., Any]]
    show: ClassVar[Callable[..., Any]]

    @property
    def healthy(self) -> np.ndarray:
        """Numbers of the microphones with a healthy channel, or of all if there is none : (K,) int64."""
        faulty = set() if self.channels is None else self.channels.faulty
        healthy = np.flatnonzero([name not in faulty for name in self.names])
        return healthy if len(healthy) else np.arange(len(self.names))

    def counted(self, given=()) -> np.ndarray:
        """Return the numbers of the microphones whose errors are averaged: those sought, with a healthy channel.

        Parameters
        ----------
        given : sequence of int
            Microphones whose positions were given; they are only counted if no other microphone is left.

        Returns
        -------
        (K,) int64
        """
        sought = np.setdiff1d(self.healthy, np.asarray(given, np.int64))
        return sought if len(sought) else self.healthy

    @property
    def frame(self) -> str:
        """The coordinate axes of `positions`, and of every file and table of this result.

        "known" are the axes of the given positions. "axes" are those of an array without given positions: the origin is
        its centre, x its longest axis and y the next one.
        """
        return "axes" if self.known == () else "known"

    def positions_for(self, measurement: Measurement) -> np.ndarray:
        """Return the positions in the axes of a measurement's true positions, where it has them.

        A result without given positions is moved as a whole onto the true positions. The microphones with healthy
        channels determine this motion.

        Parameters
        ----------
        measurement : Measurement

        Returns
        -------
        (N, D) float64
            Metres.

        Raises
        ------
        InputError
            Result and measurement have different numbers of microphones or coordinates.
        """
        shape = (measurement.count, measurement.array_dimension)
        if self.positions.shape != shape:
            problem = f"the result has positions of shape {self.positions.shape}, the measurement {shape}"
            remedy = "use the result of this measurement"
            if self.excluded:
                names = ", ".join(self.excluded)
                problem = f"the result leaves out microphone {names}, but the positions of all are needed"
                remedy = "calibrate again without <exclude>"
            raise InputError(problem, remedy, key="result")
        truth = measurement.positions
        if truth is None:
            return self.positions
        return align(self.positions, truth, self.healthy) if self.aligned else self.positions

    def compared_with(self, measurement: Measurement, given=()) -> Calibration:
        """Return this calibration with its errors against the true positions of a measurement, where it has them.

        Parameters
        ----------
        measurement : Measurement
        given : sequence of int
            As in `counted`.

        Returns
        -------
        Calibration
        """
        if measurement.positions is None:
            return self
        errors = position_errors(self.positions_for(measurement), measurement.positions)
        of = errors[self.counted(given)]
        mean, rms, largest = float(of.mean()), float(np.sqrt(np.mean(of**2))), float(of.max())
        return replace(self, errors=errors, mean_error=mean, rms_error=rms, max_error=largest)

    def __repr__(self) -> str:
        known = "" if self.known is None else f", {len(self.known)} known"
        error = "" if self.mean_error is None else f", mean error {length_text(self.mean_error)}"
        return (
            f"<Calibration by {self.solver}: {len(self.names)} microphones{known},"
            f" {len(self.frequencies)} frequencies, verdict {self.verdict or 'unknown'}{error}>"
        )


def placed_in_frame(result: Calibration, frame: str | None) -> MicrophonePositions:
    """Return the microphones of a result, in its own frame or in `frame`, one of `fdcal.model.gauge.FRAMES`."""
    if frame == "known" and result.known == ():
        problem = "frame = known, but no microphone was known"
        raise InputError(problem, "use <frame> minimal or axes", key="frame")
    positions = result.positions if frame in (None, result.frame) else in_frame(result.positions, frame)
    return MicrophonePositions(result.names, positions, result.uncertainty, frame or result.frame)
