"""The result of a calibration: `Calibration`, its parts, its errors against the truth, and what it can be turned into.

What is carried out elsewhere (files, tables, pictures, other programs' formats) is looked up in `fdcal.EXTENSIONS`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

import fdcal

from ..cost.channel_correction import ChannelCorrection
from ..model.gauge import align, in_frame, position_errors
from ..model.lengths import length_text
from ..model.measurement import Measurement
from ..model.validation import InputError, frozen_array, require_choice

if TYPE_CHECKING:
    from ..model.microphones import MicrophonePositions

DECIBELS_PER_NEPER = 20 / np.log(10)
CHANNEL_NUMBERS = ("gain_db", "gain_sigma_db", "phase_deg", "phase_sigma_deg", "noise_db")  # attributes of `Channels`


def _freeze(part: object, *names: str) -> None:
    """Replace attributes by read-only float64 copies, where they are given."""
    for name in names:
        if getattr(part, name) is not None:
            object.__setattr__(part, name, frozen_array(getattr(part, name), float))


@dataclass(frozen=True, eq=False)
class Evidence:
    """The figures behind a verdict.

    Attributes
    ----------
    residual_to_noise : float
        Reduced chi-square of the pressures: power of the residual over that of the noise.
    leave_one_out_db : float or None
        Leave-one-out prediction error over pressure, decibels, of all microphones and frequencies together.
    microphones_db : (N,) float64 or None
        The same of each microphone.
    frequencies_db : (M,) float64 or None
        The same of each frequency.
    noise_to_given : float or None
        Noise that the solver finds over the noise given, medians of the frequencies: the factor in the words of
        the verdict model_mismatch. None without a given noise.
    """

    residual_to_noise: float
    leave_one_out_db: float | None = None
    microphones_db: np.ndarray | None = None
    frequencies_db: np.ndarray | None = None
    noise_to_given: float | None = None

    def __post_init__(self):
        _freeze(self, "microphones_db", "frequencies_db")


@dataclass(frozen=True, eq=False)
class KnownRoom:
    """What solver "room" finds beside the positions.

    Attributes
    ----------
    size : tuple of D float
        Metres.
    source : (D,) float64
        Position of the source, metres.
    admittance : complex
        Specific admittance of the walls.
    symmetries : tuple of (str, (N, D) float64)
        Each array that the pressures cannot distinguish from the one found, which comes first: the map, such as
        "(6 - x, y)", and the positions, metres.
    """

    size: tuple[float, ...]
    source: np.ndarray
    admittance: complex
    symmetries: tuple[tuple[str, np.ndarray], ...]

    def __post_init__(self):
        _freeze(self, "source")


@dataclass(frozen=True)
class ChannelFault:
    """What is wrong with a channel, or with the position given for it.

    Attributes
    ----------
    name : str
        Of the microphone.
    kind : str
        "inverted", "dead", "noisy", "delayed", "high_pass", "gain", "misplaced" or "exchanged", see
        `fdcal.assessment.channels`.
    value : float or None
        Gain or noise over the median channel in decibels, phase in degrees, delay in seconds, corner frequency over
        that of the others in hertz, or distance from the given position in metres.
    unit : str
        Of the value: "dB", "degrees", "s", "Hz" or "m"; "" without a value.
    partner : str or None
        Name of the other microphone of an exchange.
    """

    name: str
    kind: str
    value: float | None = None
    unit: str = ""
    partner: str | None = None

    @property
    def text(self) -> str:
        """The fault in words.

        Examples
        --------
        >>> ChannelFault("17", "inverted").text
        'microphone 17: inverted'
        >>> ChannelFault("4", "delayed", 3e-4, "s").text
        'microphone 4: delayed by 0.3 ms'
        """
        value = self.value or 0.0
        words = {
            "noisy": f"noise {value:.0f} dB over the others'",
            "delayed": f"delayed by {1e3 * value:.2g} ms",
            "high_pass": f"high-pass at {value:.3g} Hz"
            if value > 0
            else f"more bass than the others, as if theirs were a high-pass at {-value:.3g} Hz",
            "gain": f"phase {value:.0f} degrees" if self.unit == "degrees" else f"gain {value:+.1f} dB",
            "misplaced": f"{1e3 * value:.3g} mm from the position given",
            "exchanged": f"exchanged with microphone {self.partner}",
        }
        return f"microphone {self.name}: {words.get(self.kind, self.kind)}"


@dataclass(frozen=True)
class GivenPosition:
    """A given position and the one found for its microphone.

    Examples
    --------
    >>> GivenPosition("7", (0.0, 0.0), (0.003, 0.004), 0.001, True).difference
    0.005
    """

    name: str  # of the microphone
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
class Channels:
    """Gain and noise of every channel, and given positions as found.

    Solver "robust" seeks gains and corrects given positions; "joint" takes gains as 1, but for gross faults, and given
    positions as exact.

    Attributes
    ----------
    gain_db, gain_sigma_db : (N,) float64
        Gain over that of the median channel and its one sigma, decibels.
    phase_deg, phase_sigma_deg : (N,) float64
        Phase against that of the median channel and its one sigma, degrees, from -180 to 180.
    noise_db : (N,) float64
        Noise over that of the median channel, decibels.
    faults : tuple of ChannelFault
        In the order of the microphones.
    given : tuple of GivenPosition
        Of the microphones whose positions were given, in their order.
    """

    gain_db: np.ndarray
    gain_sigma_db: np.ndarray
    phase_deg: np.ndarray
    phase_sigma_deg: np.ndarray
    noise_db: np.ndarray
    faults: tuple[ChannelFault, ...] = ()
    given: tuple[GivenPosition, ...] = ()

    def __post_init__(self):
        _freeze(self, *CHANNEL_NUMBERS)

    @property
    def gains_sought(self) -> bool:
        """Whether the solver sought the gains, so that they are uncertain."""
        return bool(np.any(self.gain_sigma_db))

    @property
    def faulty(self) -> set[str]:
        """Names of the microphones whose channel is not sound; a position given wrongly is no fault of a channel."""
        return {fault.name for fault in self.faults if fault.kind != "misplaced"}

    @property
    def correction(self) -> ChannelCorrection:
        """Gains and noise as costs take them."""
        gains = 10 ** (self.gain_db / 20) * np.exp(1j * np.radians(self.phase_deg))
        return ChannelCorrection(gains, 10 ** (self.noise_db / 10))


@dataclass(frozen=True, eq=False, repr=False)
class Calibration:
    """Positions of the microphones of an array, and whether to trust them.

    Attributes
    ----------
    positions : (N, D) float64
        Metres.
    names : tuple of N str
    solver : str
    seed : int
    frequencies : (M,) float64
        Those used, Hz, ascending.
    cost : float
        What the solver minimised; dimensionless with modes of unit RMS. Solvers minimise different quantities.
    cost_db : float or None
        Eq. 7 over all modes that the microphones can carry, dB of their power: alike for all solvers.
    sweeps : int
        Number of times that all free microphones were moved.
    elapsed : float
        Seconds.
    converged : bool
    known : tuple of str or None
        Names of the microphones whose positions were given; None if the file does not say.
    excluded : tuple of str
        Names of microphones left out, which have no row in `positions`.
    aligned : bool
        Whether nothing fixes translation, rotation and mirror image, so that the errors are those after the best
        rigid motion.
    mean_error, rms_error, max_error : float or None
        Over the microphones that `counted` names, metres; None where the true positions are unknown.
    errors : (N,) float64 or None
        Distance of each microphone from its true position, metres.
    sound_speed : float or None
        As given or as estimated, m/s.
    verdict : str
        A code of `fdcal.assessment.findings`, such as "good"; "" if the file has none.
    verdict_text : str
        The verdict in words.
    uncertainty : (N,) float64 or None
        One sigma of each position, metres; 0 for a known microphone whose position the solver held.
    covariance : (N, D, D) float64 or None
        Of each position, metres^2.
    evidence : Evidence or None
    room : KnownRoom or None
        Of solver "room" only.
    channels : Channels or None
        Gain and noise of every channel, and what is wrong with it; of all solvers but "room".
    sound_speed_sigma : float or None
        One sigma of a sound speed that was estimated with the positions, m/s.

    Examples
    --------
    >>> found = Calibration([[0, 0], [3, 4]], ("a", "b"), "joint", 0, [50.0], 0.1, 3, 1.5, True, verdict="good")
    >>> Calibration.from_json(found.to_json()).positions.tolist()
    [[0.0, 0.0], [3.0, 4.0]]
    """

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
    room: KnownRoom | None = None
    channels: Channels | None = None
    sound_speed_sigma: float | None = None
    rms_error: float | None = None
    cost_db: float | None = None

    def __post_init__(self):
        _freeze(self, "positions", "frequencies", "errors", "uncertainty", "covariance")

    @property
    def healthy(self) -> np.ndarray:
        """Numbers of the microphones with a sound channel, of all if there is none : (K,) int64."""
        faulty = set() if self.channels is None else self.channels.faulty
        healthy = np.flatnonzero([name not in faulty for name in self.names])
        return healthy if len(healthy) else np.arange(len(self.names))

    def counted(self, given=()) -> np.ndarray:
        """Return the numbers of the microphones whose errors are averaged: those sought, with a sound channel.

        Parameters
        ----------
        given : sequence of int
            Microphones whose positions were given; they count only where no other is left.

        Returns
        -------
        (K,) int64
        """
        sought = np.setdiff1d(self.healthy, np.asarray(given, np.int64))
        return sought if len(sought) else self.healthy

    def positions_for(self, measurement: Measurement) -> np.ndarray:
        """Return the positions in the axes of a measurement's true positions, where it has them.

        A blind result is moved as a whole onto the true positions, by its sound channels; of the symmetries of a known
        room the nearest one is taken.

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
            The result is of another number of microphones than the measurement.
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
        if self.room is not None:
            return min((array for _, array in self.room.symmetries), key=lambda array: np.sum((array - truth) ** 2))
        return align(self.positions, truth, self.healthy) if self.aligned else self.positions

    def compared_with(self, measurement: Measurement, given=()) -> Calibration:
        """Return this calibration with its errors against the true positions of a measurement, where it has them.

        Parameters
        ----------
        measurement : Measurement
        given : sequence of int
            As of `counted`.

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

    def to_json(self) -> str:
        """Return the text of a result file.

        Returns
        -------
        str

        Raises
        ------
        InputError
            A value is not finite, or an array has the wrong shape.
        """
        return fdcal.extension("result_text")(self)

    @staticmethod
    def from_json(text: str | bytes, where: str = "the result") -> Calibration:
        """Return the calibration of a result file with this text.

        Parameters
        ----------
        text : str, or bytes in UTF-8
        where : str
            What an error calls the text, as the path of its file.

        Returns
        -------
        Calibration

        Raises
        ------
        InputError
            `text` is no JSON, or a key is missing or malformed.
        """
        return fdcal.extension("read_result")(text, where)

    def save(self, path: str | PathLike[str], *, force: bool = False) -> None:
        """Write the result as JSON, which `fdcal.Calibration.load` and every `--result` read.

        Parameters
        ----------
        path : str or path
        force : bool
            Whether an existing file is overwritten.

        Raises
        ------
        InputError
            The file exists, and `force` is not set.
        StorageError
            The file cannot be written.

        Examples
        --------
        >>> import tempfile, fdcal
        >>> found = fdcal.calibrate(fdcal.load("tiny"), modes=12)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     found.save(f"{folder}/tiny.json")
        ...     fdcal.Calibration.load(f"{folder}/tiny.json").names == found.names
        True
        """
        fdcal.extension("save_result")(self, path, force)

    @staticmethod
    def load(path: str | PathLike[str]) -> Calibration:
        """Return the calibration in a file that `save` or `fdcal calibrate -o` wrote.

        Parameters
        ----------
        path : str or path

        Returns
        -------
        Calibration

        Raises
        ------
        InputError, StorageError
            The file is no result, or cannot be read.

        Examples
        --------
        >>> import tempfile, fdcal
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     fdcal.calibrate(fdcal.load("tiny"), modes=12).save(f"{folder}/tiny.json")
        ...     fdcal.Calibration.load(f"{folder}/tiny.json").known
        ('0', '5', '7')
        """
        return fdcal.extension("load_result")(path)

    def export(
        self,
        path: str | PathLike[str],
        *,
        frame: str | None = None,
        original: str | PathLike[str] | None = None,
        table: str = "positions",
        force: bool = False,
    ) -> None:
        """Write the positions, or the gains of the channels, for another program; the suffix selects the format.

        Parameters
        ----------
        path : str or path
            Ends in .csv (a table), .json, .xml (Acoular), .sofa or .npy (pyroomacoustics).
        frame : str, optional
            "known", the axes of the known microphones, as by default; "minimal" or "axes", as by default without any.
        original : str or path, optional
            A SOFA file into a copy of which the positions are written.
        table : str
            "positions", or "gains": a .csv table of gain, phase and noise of every channel, of solver "robust".
        force : bool
            Whether an existing file is overwritten.

        Raises
        ------
        InputError
            No format has this suffix, the frame does not exist, or the file exists and `force` is not set.
        StorageError
            The file cannot be written.

        Examples
        --------
        >>> import tempfile, fdcal
        >>> from pathlib import Path
        >>> found = fdcal.calibrate(fdcal.load("tiny"), modes=12)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     found.export(f"{folder}/tiny.csv")
        ...     Path(f"{folder}/tiny.csv").read_text().splitlines()[0]
        'name,x,y,z,uncertainty'
        """
        require_choice("table", table, ("positions", "gains"))
        if table == "gains":
            fdcal.extension("export_gains")(self, path, force)
        else:
            fdcal.extension("export_positions")(self, path, frame, original, force)

    def to_pyfar(self, *, frame: str | None = None) -> Any:
        """Return the positions as `pyfar.Coordinates`; needs the extra "pyfar".

        Parameters
        ----------
        frame : str, optional
            As of `export`.

        Returns
        -------
        pyfar.Coordinates

        Examples
        --------
        >>> import fdcal
        >>> fdcal.calibrate(fdcal.load("tiny"), modes=12).to_pyfar().cshape
        (16,)
        """
        return fdcal.extension("pyfar_coordinates")(placed_in_frame(self, frame))

    def to_dataframe(self) -> Any:
        """Return a pandas table with one row a microphone, if pandas is installed.

        Columns: x, y (z), metres; known; uncertainty, one sigma in metres; error, metres, where it is known; where the
        solver finds them gain_db, gain_sigma_db, phase_deg, phase_sigma_deg, noise_db and fault, "" where sound,
        and of given positions given_x, given_y (given_z) and given_difference, metres, NaN where none is given. The
        index are the names.

        Returns
        -------
        pandas.DataFrame

        Raises
        ------
        InputError
            pandas is not installed.

        Examples
        --------
        >>> import fdcal
        >>> found = fdcal.calibrate(fdcal.load("tiny"), modes=12)
        >>> found.to_dataframe().columns.tolist()[:6]
        ['x', 'y', 'known', 'uncertainty', 'error', 'gain_db']
        """
        return fdcal.extension("data_frame")(self)

    def plot(self, truth=None) -> Any:
        """Return a matplotlib figure of the positions, with error ellipses and the known microphones.

        Parameters
        ----------
        truth : (N, D) array_like, optional
            True positions to draw as well, metres, in the axes of the result.

        Returns
        -------
        matplotlib.figure.Figure

        Examples
        --------
        >>> import fdcal
        >>> measurement = fdcal.load("tiny")
        >>> figure = fdcal.calibrate(measurement, modes=12).plot(measurement.positions)
        >>> figure.axes[0].get_xlabel()
        'x (m)'
        """
        return fdcal.extension("draw_calibration")(self, truth)

    def __repr__(self) -> str:
        known = "" if self.known is None else f", {len(self.known)} known"
        error = "" if self.mean_error is None else f", mean error {length_text(self.mean_error)}"
        return (
            f"<Calibration by {self.solver}: {len(self.names)} microphones{known},"
            f" {len(self.frequencies)} frequencies, verdict {self.verdict or 'unknown'}{error}>"
        )

    def _repr_html_(self) -> str:
        return fdcal.extension("calibration_html")(self)


def placed_in_frame(result: Calibration, frame: str | None) -> MicrophonePositions:
    """Return the microphones of a result in a frame; None for that of the known ones, or "axes" without any."""
    blind = result.known == ()
    if frame is None:
        frame = "axes" if blind else "known"
    if frame == "known" and blind:
        raise InputError(
            "frame = known, but no microphone was known", "use <frame> minimal or axes", key="frame", value="known"
        )
    from ..model.microphones import MicrophonePositions

    return MicrophonePositions(result.names, in_frame(result.positions, frame), result.uncertainty, frame)
