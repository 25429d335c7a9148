"""The settings of a run: how to measure, faults of channels, where to search, how to solve.

Lengths are metres, frequencies hertz.
"""

import math
import typing
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np

from .gauge import align
from .quantities import Count, Hertz, Metres, Point, Positive, Whole, option, positive
from .validation import LIMITS, InputError, check, refusal, require_finite, shown, within


@dataclass(frozen=True)
class Sensing:
    """How pressures are derived from recordings."""

    # signal-to-noise ratio of each mode, dB; inf for no noise. The noise is added to the complex pressures
    snr_db: float = math.inf
    # lowest, highest: band in which modes are picked, Hz
    lowest: Hertz = 20.0
    highest: Hertz = 400.0
    # least height of a spectral peak above its surroundings, dB. With 0 no peaks are picked, and all frequencies of the
    # band in steps of `resolution` are used
    prominence_db: Annotated[float, within(0, LIMITS.largest, "dB")] = 1.0
    resolution: Hertz = 1.0  # smallest distance of two modes, Hz
    # "discrete" is the wavenumber of a wave on the grid of the simulation, "continuous" that of the wave equation
    wavenumber: Literal["discrete", "continuous"] = "discrete"
    # relative error of the sound speed given to the solvers, positive if it is too high: 0.01 for 1 %
    sound_speed_error: Annotated[float, within(-LIMITS.sound_speed_error, LIMITS.sound_speed_error)] = 0.0

    OPTIONAL: typing.ClassVar = ("sound_speed_error",)

    def __post_init__(self):
        if not (abs(self.snr_db) <= LIMITS.decibels or self.snr_db == math.inf):
            remedy = f"give decibels from -{LIMITS.decibels:g} to {LIMITS.decibels:g}, or inf for no noise"
            raise refusal("measurement.snr_db", self.snr_db, "is out of range", remedy)
        check(self, "measurement.")
        if not self.lowest < self.highest:
            why = f"is not below measurement.highest = {self.highest:g} Hz"
            raise refusal("measurement.lowest", self.lowest, why, "lower the first or raise the second", "Hz")


DEAD_FRACTION = 1e-6  # power of the noise in a dead channel, divided by the power of the others


@dataclass(frozen=True)
class Faults:
    """Faulty channels, and the scatter of gain and phase of all channels."""

    inverted: tuple[int, ...] = ()  # microphones of inverted polarity
    dead: tuple[int, ...] = ()  # microphones without signal: noise 60 dB below the others, besides that of `snr_db`
    # gain_db, phase_deg: standard deviation of the gains, decibels, and phases, degrees, of all channels. The seed
    # of the scene determines the values that are drawn
    gain_db: Annotated[float, within(0, 40, "dB")] = 0.0
    phase_deg: Annotated[float, within(0, 180, "degrees")] = 0.0

    OPTIONAL: typing.ClassVar = ("inverted", "dead", "gain_db", "phase_deg")

    def __post_init__(self):
        check(self, "faults.")
        both = sorted(set(self.inverted) & set(self.dead))
        if both:
            raise InputError(f"faults.inverted and faults.dead name {both[0]}", "name it once", key="faults.dead")

    def gains(self, count: int, seed: int) -> np.ndarray:
        """Return the gain of every channel, 0 of a dead one : (N,) complex128."""
        draws = np.random.default_rng([seed, 2]).normal(size=(2, count))
        gains = 10 ** (self.gain_db * draws[0] / 20) * np.exp(1j * np.radians(self.phase_deg * draws[1]))
        gains[list(self.inverted)] *= -1
        gains[list(self.dead)] = 0
        return gains


@dataclass(frozen=True)
class Search:
    """Lattice of candidate positions and the expansion radius R of Eq. 3.

    Attributes
    ----------
    origin : tuple of float
        Corner with the lowest coordinates, metres.
    size : tuple of float
        Lengths along each axis, metres, whole multiples of `step`.
    step : float
        Distance of neighbouring candidates, metres.
    radius : float
        R, metres.
    """

    origin: Point
    size: tuple[Metres, ...]
    step: Metres = 0.01
    radius: Metres = 0.8

    def __post_init__(self):
        if len(self.origin) != len(self.size):
            why = f"and search.size = {shown(list(self.size))} differ in dimension"
            raise refusal("search.origin", list(self.origin), why, "give both as many numbers as a position has")
        require_finite("search.origin", self.origin)
        check(self, "search.")
        if min(self.size) < self.step * (1 - 1e-9):
            raise refusal("search.step", self.step, f"is above search.size = {list(self.size)} m", "lower it", "m")
        if math.prod(self.shape) > LIMITS.candidates:
            remedy = f"use a larger one ({LIMITS.candidates} candidates at most)"
            raise refusal("search.step", self.step, f"gives {float(math.prod(self.shape)):.3g} candidates", remedy, "m")
        for length in self.size:
            steps = length / self.step
            if abs(steps - round(steps)) > 1e-6:
                below, above = (f(steps) * self.step for f in (math.floor, math.ceil))
                why = f"is not a whole number of steps of search.step = {self.step:g} m"
                raise refusal("search.size", length, why, f"use {below:g} or {above:g} m", "m")

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of candidates along each axis."""
        return tuple(round(length / self.step) + 1 for length in self.size)

    def index(self, point: Any) -> np.ndarray:
        """Return the indices of the candidate that is nearest to a point.

        Parameters
        ----------
        point : (..., D) float64, metres
            One place or several, also outside of the search domain.

        Returns
        -------
        (..., D) int64, along each axis
        """
        index = np.rint((np.asarray(point) - self.origin) / self.step).astype(np.int64)
        return np.clip(index, 0, np.array(self.shape) - 1)

    def nearest(self, point: Any) -> np.ndarray:
        """Return the candidate that is nearest to a point.

        Parameters
        ----------
        point : (..., D) float64, metres
            One place or several, also outside of the search domain.

        Returns
        -------
        (..., D) float64, metres
        """
        return np.asarray(self.origin) + self.step * self.index(point)

    def layer(self, height: float = 0.0) -> np.ndarray:
        """Return the candidates of a horizontal layer; all of them in two dimensions.

        Parameters
        ----------
        height : float
            Height of the layer, metres.

        Returns
        -------
        (ny, nx, D) float64, metres
        """
        x, y = (o + self.step * np.arange(n) for o, n in zip(self.origin[:2], self.shape[:2], strict=True))
        return np.stack((*np.meshgrid(x, y), np.full((len(y), len(x)), height))[: len(self.origin)], axis=-1)


ALL_MODES = 10**9  # `SolverSettings.modes`: as many as the measurement, its array and the solver allow


@dataclass(frozen=True)
class SolverSettings:
    """Which solver, and its settings.

    Attributes
    ----------
    name : str
        "robust", which also estimates the gains of the channels; "joint", the same for matched channels and exact given
        positions; or "descent", the paper's algorithm.
    modes, first_modes : int
        Number of modes in use at the end and, for "descent", at the start. `modes` is ALL_MODES unless given: all that
        were measured and that the solver can use (`fdcal.solvers.requirements`).
    mode_order : str
        Order in which "descent" adds modes: "ascending", as in the paper, or "descending", which begins with mode
        `modes` alone and adds lower ones.
    order_offset : int
        Number added to the order ceil(kR) of Eq. 3; the paper adds 0.
    ample_modes : int
        Number, from 1, of a mode. "descent" adds `order_offset` if this mode or a higher one is in use, otherwise 0.
    known_weight : float
        Weight of a known microphone's squared residual in "descent"; in the paper it is 1.
    weights : str
        "unit", each mode scaled to unit RMS, or "raw", as in the paper.
    max_sweeps : int
        Largest number of sweeps of "descent" in one stage.
    start : str or None
        "affine" or "random"; the default of "descent" is "random". "robust" always uses its own starts; "joint" uses
        the same ones unless `start` is "random".
    noise : str
        "reported" uses the noise power of the measurement, if it has one; "auto" estimates it; a number of decibels is
        the signal-to-noise ratio of each mode.
    known : str
        Microphones whose positions are given to the solver: "all" known ones; "minimal", only what fixes
        translation, rotation and mirror image; or "none".
    gains : str
        With "auto", "robust" estimates gain and phase of every channel and their standard deviations; with "fixed" they
        do not change.
    gain_sigma_db, phase_sigma_deg : float or None
        For "robust": standard deviation of the gains, decibels, and of the phases, degrees; estimated unless given.
    known_sigma : float or None
        For "robust": standard deviation of each coordinate of a given position, metres; with 0 the positions are exact
        and never move. Unless it is given, it is estimated, and is at most 3 mm if the pressures do not contradict the
        given positions. For a plane array in space, whose size follows from the given positions, it is 1 mm.
    sound_speed_sigma : float or None
        For "robust" and "joint": relative standard deviation of the sound speed (0.003 is 0.3 %). Unless it is given,
        the sound speed counts as exact.
    """

    name: str = "robust"
    modes: Count = ALL_MODES
    first_modes: Count = 3
    mode_order: Literal["ascending", "descending"] = "ascending"
    order_offset: Whole = 2
    ample_modes: Count = 15
    known_weight: Positive = 1000.0
    weights: Literal["unit", "raw"] = "unit"
    max_sweeps: Count = 20
    # Fields that are made by `option` are options of `fdcal calibrate`, too.
    start: Annotated[Literal["affine", "random"] | None, within(solver="joint")] = option(
        None, "Positions to begin with.  [default: the solver's own]"
    )
    noise: Annotated[str, within(solver="joint")] = option(
        "reported", "SNR of each frequency, dB; auto: estimated; reported: taken from the file.", "DB|auto|reported"
    )
    known: Literal["all", "minimal", "none"] = option(
        "all",
        "Known microphones to use; minimal: only what fixes position, rotation and mirror image.",
        "all|minimal|none|NAMES|FILE.csv",
    )
    gains: Annotated[Literal["auto", "fixed"], within(solver="robust")] = option(
        "auto", "auto: solver robust estimates gain and phase of every channel; fixed: it does not."
    )
    gain_sigma_db: Annotated[float, positive("dB", solver="robust", with_gains=True)] | None = None
    phase_sigma_deg: Annotated[float, positive("degrees", solver="robust", with_gains=True)] | None = None
    known_sigma: Annotated[float, within(0, LIMITS.largest, "m", solver="robust")] | None = option(
        None, "For robust: one sigma of each given coordinate, e.g. 5mm; 0mm: exact.  [default: estimated]", "LENGTH"
    )
    sound_speed_sigma: Annotated[float, positive(solver="robust")] | None = option(
        None, "For robust, joint: one sigma of the sound speed, e.g. 0.3%.  [default: it is exact]", "PERCENT"
    )

    OPTIONAL: typing.ClassVar = (
        "modes", "mode_order", "start", "noise", "known", "gains", "gain_sigma_db", "phase_sigma_deg",
        "known_sigma", "sound_speed_sigma",
    )  # fmt: skip

    def __post_init__(self):
        check(self, "solver.")
        if self.first_modes > self.modes:
            raise refusal("solver.first_modes", self.first_modes, f"is above solver.modes = {self.modes}", "lower it")
        _ = self.snr_db  # raises for a `noise` that is neither a choice nor a number

    @property
    def snr_db(self) -> float | None:
        """Signal-to-noise ratio in `noise`, dB; None if `noise` is not a number."""
        if self.noise in ("reported", "auto"):
            return None
        try:
            value = float(self.noise)
        except ValueError:
            value = math.nan
        if not -LIMITS.decibels <= value <= LIMITS.decibels:
            raise refusal("solver.noise", self.noise, "is unknown", 'use "reported", "auto" or a number of decibels')
        return value


# A search domain around an estimate, for a measurement without one. Maps, the reference cost, the order rule, solver
# `descent` and random starts need a search domain; other solvers do not.
MARGIN = 0.25  # distance of the domain's edge from the outermost estimates, divided by the longest side of the array
MIN_MARGIN = 0.05  # m, smallest such distance
CELLS = {2: 120, 3: 60}  # largest number of steps along the longest side, by the number of coordinates
STEPS = (1.0, 2.0, 5.0)  # first digits that a step may have


def search_around(positions: Any, own: Search | None = None, truth: Any = None) -> Search:
    """Return the search domain `own`, or one around positions (N, D), metres, if there is none.

    If `truth` (N, D) is given, as for an array without known microphones, the positions are first moved onto it as a
    whole. The domain `own` may still have the axes of the estimate; after such a motion it is therefore used only if it
    contains the centre of the moved positions.

    The step of a new domain is 1, 2 or 5 times a power of ten. Its radius R is that of `own`. Without `own`, it is the
    distance from the centre to a corner in the plane. In space it is the distance from the centre to the outermost
    position, plus the margin.
    """
    positions = np.asarray(positions, float) if truth is None else align(positions, truth)
    if own is not None:
        offset = positions.mean(axis=0) - own.origin
        if truth is None or ((offset >= 0) & (offset <= own.size)).all():
            return own
    low, high = positions.min(axis=0), positions.max(axis=0)
    margin = max(MARGIN * float((high - low).max()), MIN_MARGIN)
    sides = high - low + 2 * margin
    least = float(sides.max()) / CELLS[len(sides)]
    power = 10.0 ** np.floor(np.log10(least))
    step = float(next(digit * power for digit in (*STEPS, 10.0) if digit * power >= least * (1 - 1e-9)))
    centre, size = (low + high) / 2, np.ceil(sides / step - 1e-9).astype(int) * step
    outermost = float(np.linalg.norm(positions - centre, axis=1).max()) + margin
    radius = float(np.linalg.norm(size)) / 2 if len(size) == 2 else outermost
    radius = radius if own is None else own.radius
    return Search(tuple((centre - size / 2).tolist()), tuple(size.tolist()), step, radius)
