"""A measurement: pressures, and what is known about them. True positions, if it has them, are for comparison only.

The `Problem` that a solver gets has no true positions. A measurement is checked when it is made. Known or true
positions may also be added later, by name or in the order of the channels. The .npz file of a measurement is a public
format (docs/reference/files.md).
"""

from __future__ import annotations

import contextlib
import functools
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from .gauge import align, minimal_frame, position_errors
from .problem import Problem, ShortWindows, joined_windows, mode_power
from .quantities import MetresPerSecond, Seconds
from .settings import Search
from .storage import load_archive
from .validation import LIMITS, InputError, convert, frozen_array, naming, refusal, require_array, require_choice

LATEST_ARRIVAL = 1e4  # seconds, latest arrival time that is accepted
ARRIVAL_SIGMA = 3e-4  # metres, one sigma of an arrival, times the sound speed, unless it is given
ROUNDING = 1e-9  # relative to the wavenumber; an imaginary part below this may have either sign
CERTAIN = 6.0  # number of sigmas by which the power of noise may by chance be below its mean
DUPLICATE = 1e-9  # difference of two channels up to a factor, relative to their norm, below which they are copies
PARALLEL = 1e-6  # 1 - abs(correlation) up to which the difference of two channels is computed


OF_ROWS = ("frequencies", "pressures", "wavenumbers", "noise_power", "takes")  # fields with an entry for each row
COMPUTED: Any = None  # default of a field that `__post_init__` then computes


@dataclass(frozen=True, repr=False)
class Measurement:
    """Pressures of M modes at N microphones and what is known about them.

    Parameters
    ----------
    frequencies : (M,) float64
        Hz, ascending. Rows of several takes, or of several sources of one take, may have equal frequencies.
    pressures : (M, N) complex128
        In any unit common to all of them; recordings need not be calibrated.
    sound_speed : float
        c, m/s. If `dataclasses.replace` changes it, wavenumbers that were not given, or that equal 2 pi f / c, are
        computed again; others must be given again, or None.
    dimension : int
        Dimension of the sound field, 2 or 3.
    array_dimension : int, optional
        Number D of coordinates of every position, 2 or 3; `dimension` unless given.
    wavenumbers : (M,) complex128, optional
        k, rad/m, time sign exp(+j w t); 2 pi f / c unless given.
    noise_power : (M,) float64, optional
        Mean power of the noise in the pressures of each row, in the unit of abs(pressures)**2.
    names : (N,) tuple of str, optional
        Names of the microphones; "0", "1", ... unless given.
    positions : (N, D) float64, optional
        True positions, metres, against which errors are computed; no solver gets them.
    known : (A,) int64
        Indices of known microphones, in any order; they are sorted.
    known_positions : (A, D) float64, optional
        Positions of the known microphones, metres; the true positions unless given.
    search : Search, optional
        Lattice of candidates and expansion radius.
    spectrum : (2, F) or (1 + T, F) float64, optional
        The spectrum from which the frequencies were picked, for plots only: Hz, ascending, and the mean power of all
        microphones, in any unit. With several takes there is one row of power for each, or one for all.
    takes : (M,) int64, optional
        The take of each row, counted from 0; the default is one take. A take is a recording of all microphones with the
        source at one position: all takes have the same channels and positions, but not the same sound field.
    arrivals : (T, N) float64, optional
        Times at which the direct sound arrives at each microphone in each take, seconds. Row t belongs to take t, and
        its origin is arbitrary. NaN where the direct sound is too weak.
    arrival_sigma : (T,) float64 or float, optional
        Estimated sigma of an arrival of each take, seconds; the default is 0.3 mm divided by the sound speed.
    windows : ShortWindows, optional
        Spectra of short windows of the recordings, which solvers "robust" and "joint" use in addition to the rows.
    nominal : bool, optional
        Whether `positions` are nominal, those of the plan of the array, rather than true.
    origin : (array, float, bool), optional
        For `dataclasses.replace` only: the wavenumbers, their sound speed, and whether they follow from it.

    Raises
    ------
    InputError
        For a wrong shape, NaN, a microphone or frequency without pressure, or pressures that are real numbers.

    Examples
    --------
    >>> import numpy as np
    >>> pressures = np.exp(1j * np.arange(12.0)).reshape(3, 4)
    >>> Measurement([100.0, 150.0, 210.0], pressures, sound_speed=343.0).count
    4
    """

    frequencies: np.ndarray
    pressures: np.ndarray
    sound_speed: float
    dimension: int = 2
    array_dimension: int = COMPUTED
    wavenumbers: np.ndarray = COMPUTED
    noise_power: np.ndarray | None = None
    names: tuple[str, ...] = COMPUTED
    positions: np.ndarray | None = None
    known: np.ndarray = COMPUTED
    known_positions: np.ndarray = COMPUTED
    search: Search | None = None
    spectrum: np.ndarray | None = None
    takes: np.ndarray = COMPUTED
    arrivals: np.ndarray | None = None
    arrival_sigma: np.ndarray | None = None
    windows: ShortWindows | None = None
    nominal: bool = False
    origin: tuple[np.ndarray, float, bool] | None = None

    def __post_init__(self):
        put = functools.partial(object.__setattr__, self)
        put("sound_speed", convert(self.sound_speed, MetresPerSecond, "sound_speed"))
        put("dimension", convert(self.dimension, Literal[2, 3], "dimension"))
        D = self.dimension if self.array_dimension is None else convert(self.array_dimension, int, "array_dimension")
        require_choice("array_dimension", D, range(2, self.dimension + 1))
        put("array_dimension", D)
        put("frequencies", require_array("frequencies", self.frequencies, "real", (None,), "Hz"))
        rows = len(self.frequencies)
        put("pressures", _checked_pressures(self.pressures, rows, self.names))
        N, k = self.count, self.wavenumbers
        derived = k is None or np.array_equal(k, 2 * np.pi * self.frequencies / self.sound_speed)
        if self.origin is not None and k is self.origin[0]:  # this is a call of `dataclasses.replace`
            _, of_speed, derived = self.origin
            if not derived and of_speed != self.sound_speed:
                speeds = f"sound_speed = {self.sound_speed:g} m/s, but the wavenumbers belong to {of_speed:g} m/s"
                remedy = "give <wavenumbers>, too: those of the new speed, or None for 2 pi f / c"
                raise InputError(speeds, remedy, key="wavenumbers")
        k = 2 * np.pi * self.frequencies / self.sound_speed if derived else k
        put("wavenumbers", require_array("wavenumbers", k, "number", (rows,), "rad/m"))
        put("origin", (self.wavenumbers, self.sound_speed, derived))
        if self.noise_power is not None:
            put("noise_power", require_array("noise_power", self.noise_power, "real", (rows,), "one for each mode"))
        several = self.takes is not None
        one_take = not several or (isinstance(self.takes, np.ndarray) and not np.any(self.takes))
        numbers = require_array("takes", np.zeros(rows, np.int64) if one_take else self.takes, "index", (rows,))
        if np.any(numbers < 0):
            raise InputError("takes must be counted from 0", "give one number for each frequency", key="takes")
        put("takes", numbers.astype(np.int64))
        labels = [str(n) for n in range(N)] if self.names is None else self.names
        put("names", tuple(require_array("names", labels, "text", (None,)).tolist()))
        if not len(self.names) == len(set(self.names)) == N:
            raise InputError(f"names must be {N} different texts", "give one for each microphone", key="names")
        times, sigma = _checked_arrivals(self.arrivals, self.arrival_sigma, self.takes, N, self.sound_speed)
        put("arrivals", times)
        put("arrival_sigma", sigma)
        if self.windows is not None and self.windows.pressures.shape[2] != N:
            problem = f"short_pressures have {self.windows.pressures.shape[2]} microphones, and pressures have {N}"
            raise InputError(problem, "leave the short windows out", key="short_pressures")
        if self.positions is not None:
            put("positions", require_array("positions", self.positions, "real", (N, D), "m"))
        put("nominal", convert(self.nominal, bool, "nominal"))
        if self.spectrum is not None:
            drawn = require_array("spectrum", self.spectrum, "real", (None, None), "Hz and mean power")
            lengths, ascending = (2, 1 + self.take_count), drawn.shape[1] > 1 and np.all(np.diff(drawn[0]) > 0)
            if len(drawn) not in lengths or not ascending or np.any(drawn[1:] < 0):
                raise InputError("spectrum needs ascending frequencies, then powers", "leave it out", key="spectrum")
            put("spectrum", drawn)
        known, places = checked_known(self.known, self.known_positions, self.positions, N, D)
        put("known", known)
        put("known_positions", places)
        if self.search is not None and len(self.search.size) != D:
            raise refusal("search_size", list(self.search.size), f"does not fit {D} coordinates", f"give {D} lengths")
        steps = np.diff(self.frequencies)
        if np.any(self.frequencies <= 0) or np.any(steps < 0) or (not several and np.any(steps == 0)):
            problem = "frequencies must be above zero and ascending" + ("" if several else ", each once")
            remedy = "sort them (and the pressures)" + ("" if several else "; with several takes give 'takes', too")
            raise InputError(problem, remedy, key="frequencies")
        _require_usable(self)

    @classmethod
    def from_arrays(
        cls,
        frequencies: Any,
        pressures: Any,
        *,
        sound_speed: float = 343.2,
        dimension: int = 3,
        names: Sequence[str] | None = None,
        positions: Any = None,
        known: Mapping[Any, Any] | Sequence[Any] | None = (),
        time_convention: str = "exp(+jwt)",
        **others: Any,
    ) -> Measurement:
        """Return the measurement with the arrays of another program.

        Parameters
        ----------
        frequencies : (M,) array_like
            Hz, ascending.
        pressures : (M, N) array_like, complex
            In any unit common to all of them, of microphones that recorded at the same time.
        sound_speed : float
            m/s; 343.2 at 20 degrees Celsius.
        dimension : int
            Dimension of the sound field: 3 in a room, 2 over a plate.
        names : (N,) sequence of str, optional
            Names of the microphones; "0", "1", ... unless given.
        positions : (N, D) array_like, optional
            True positions, metres, against which errors are computed; no solver gets them.
        known : mapping or sequence, optional
            Microphones whose positions the solver gets, by name or number: a mapping to positions (D,), metres; or a
            sequence of microphones whose `positions` it gets.
        time_convention : str
            "exp(+jwt)", that of NumPy's FFT and of fdcal; or "exp(-jwt)", whose pressures are conjugated.
        **others
            Any other parameter of `Measurement`.

        Returns
        -------
        Measurement

        Raises
        ------
        InputError
            A value is impossible, or a microphone does not exist.

        Examples
        --------
        >>> import fdcal
        >>> import numpy as np
        >>> pressures = np.exp(1j * np.arange(12.0)).reshape(3, 4)
        >>> corners = {"a": (0, 0, 0), "b": (1, 0, 0), "d": (0, 1, 0)}
        >>> m = fdcal.Measurement.from_arrays([100, 150, 210], pressures, names="abcd", known=corners)
        >>> m.known.tolist()
        [0, 1, 3]
        """
        require_choice("time_convention", time_convention, ("exp(+jwt)", "exp(-jwt)"))
        places, columns = list(known.values()) if isinstance(known, Mapping) else (), ()
        with contextlib.suppress(ValueError):  # rows of different lengths are refused below
            columns = np.shape(places if positions is None else positions)[1:]
        given = {"array_dimension": columns[0] if columns else None, "positions": positions}
        given["names"] = None if names is None else list(names)
        made = cls(frequencies, pressures, sound_speed, dimension, **given | others)
        made = replace(made, pressures=made.pressures.conj()) if time_convention == "exp(-jwt)" else made
        return made if known is None or not len(known) else with_known(made, known)

    @classmethod
    def from_takes(cls, measurements: Sequence[Measurement]) -> Measurement:
        """Return one measurement of several takes of the same array, each with the source at another position.

        Parameters
        ----------
        measurements : sequence of Measurement
            Measurements of the same microphones, in the same order, none of which was moved in between. Each
            measurement becomes a take, or several if it has several. Known and true positions are those of the first
            measurement that has any.

        Returns
        -------
        Measurement
            Its rows are sorted by frequency, then by take. It has noise powers only if all measurements have them, and
            a spectrum only if all have one.

        Raises
        ------
        InputError
            No measurement is given, or two differ in microphones, dimension, sound speed or given positions.

        Examples
        --------
        >>> import fdcal
        >>> import numpy as np
        >>> one, two = (np.exp(1j * a * np.arange(12.0)).reshape(3, 4) for a in (1, 2))
        >>> takes = [fdcal.Measurement.from_arrays([100, 150, 210], p) for p in (one, two)]
        >>> fdcal.Measurement.from_takes(takes).takes.tolist()
        [0, 1, 0, 1, 0, 1]
        """
        each = list(measurements)
        if not each:
            raise InputError("no measurement is given", "give one for each take", key="takes")
        for key in ("names", "dimension", "array_dimension", "sound_speed"):
            for number, one in enumerate(each[1:], 2):
                if getattr(one, key) != getattr(each[0], key):
                    problem = f"measurement {number} and the first one differ in {key}: {getattr(one, key)!r}"
                    raise InputError(problem[:300], "import all takes with the same options", key=key)
        known = next((one for one in each if len(one.known)), each[0])
        placed = next((one for one in each if one.positions is not None), None)
        for number, one in enumerate(each, 1):
            same = np.array_equal(one.known, known.known) and np.allclose(one.known_positions, known.known_positions)
            if len(one.known) and not same:
                raise InputError(f"measurement {number} has other known positions", "give the same ones", key="known")
        # number of takes of each measurement, up to the last one with a row or arrivals
        numbers = [max(int(m.takes.max()) + 1, 0 if m.arrivals is None else len(m.arrivals)) for m in each]
        f = np.concatenate([one.frequencies for one in each])
        firsts = np.cumsum([0, *numbers[:-1]])
        takes = np.concatenate([one.takes + first for one, first in zip(each, firsts, strict=True)])
        order = np.lexsort((takes, f))
        noise = [one.noise_power for one in each if one.noise_power is not None]
        spectra = [s for one in each if (s := one.spectrum) is not None and len(s) == 1 + one.take_count]
        spectrum = arrivals = sigma = None
        if len(spectra) == len(each):  # interpolated at the frequencies of the finest one
            grid = max((one[0] for one in spectra), key=len)
            spectrum = np.stack([grid, *(np.interp(grid, one[0], row) for one in spectra for row in one[1:])])
        if any(one.arrivals is not None for one in each):
            times, sigmas = list[np.ndarray](), list[np.ndarray]()
            for one, rows in zip(each, numbers, strict=True):
                usual = np.full(rows, ARRIVAL_SIGMA / one.sound_speed)
                times.append(np.full((rows, one.count), np.nan) if one.arrivals is None else one.arrivals)
                sigmas.append(usual if one.arrival_sigma is None else one.arrival_sigma)
            arrivals, sigma = np.concatenate(times), np.concatenate(sigmas)
        merged = replace(
            each[0],
            frequencies=f[order],
            pressures=np.concatenate([one.pressures for one in each])[order],
            wavenumbers=np.concatenate([one.wavenumbers for one in each])[order],
            noise_power=np.concatenate(noise)[order] if len(noise) == len(each) else None,
            positions=None if placed is None else placed.positions,
            nominal=placed is not None and placed.nominal,
            known=known.known,
            known_positions=known.known_positions,
            spectrum=spectrum,
            takes=takes[order],
            arrivals=arrivals,
            arrival_sigma=sigma,
            windows=joined_windows([one.windows for one in each], firsts.tolist()),
        )
        return with_different_takes(merged)

    def __repr__(self) -> str:
        f = self.frequencies
        band = f"{len(f)} {'frequencies' if self.take_count == 1 else 'rows'} from {f[0]:.1f} to {f[-1]:.1f} Hz"
        band += f" of {self.take_count} takes" if self.take_count > 1 else ""
        return f"<Measurement: {self.count} microphones, {len(self.known)} known, {band}>"

    @property
    def count(self) -> int:
        """Number of microphones N."""
        return self.pressures.shape[1]

    @property
    def take_count(self) -> int:
        """Number of takes."""
        return len(np.unique(self.takes))

    def of_take(self, take: int) -> Measurement:
        """Return the rows of one take.

        Parameters
        ----------
        take : int
            Number of the take, one of `takes`.

        Returns
        -------
        Measurement
            A measurement with the rows of this take only and the same microphones.

        Raises
        ------
        InputError
            If there is no such take.
        """
        chosen, numbers = self.takes == take, np.unique(self.takes)
        if not np.any(chosen):
            listed = ", ".join(map(str, numbers[:20]))
            raise InputError(f"there is no take {take}", f"use one of {listed}", key="take")
        spectrum, others = self.spectrum, np.arange(take + 1)[:, None] != take
        if spectrum is not None and len(spectrum) > 2:  # one for each take
            spectrum = spectrum[[0, 1 + int(np.searchsorted(numbers, take))]]
        rows = {key: values[chosen] for key in OF_ROWS if (values := getattr(self, key)) is not None}
        return replace(
            self,
            **rows,
            spectrum=spectrum,
            arrivals=None if self.arrivals is None else np.where(others, np.nan, self.arrivals[: take + 1]),
            arrival_sigma=None if self.arrival_sigma is None else self.arrival_sigma[: take + 1],
            windows=None if self.windows is None else self.windows.of_take(take),
        )

    @property
    def reference(self) -> str:
        """The kind of `positions`: "true" or "nominal"."""
        return "nominal" if self.nominal else "true"

    @property
    def blind(self) -> bool:
        """Whether no microphone is known, so that translation, rotation and mirror image are undetermined."""
        return not len(self.known)

    def aligned_truth(self, positions: Any, by: slice | np.ndarray = slice(None)) -> np.ndarray | None:
        """Return the true positions in the axes of estimated ones.

        Parameters
        ----------
        positions : (N, D) float64
            Estimated positions, metres.
        by : slice or index array
            Microphones that determine the motion of an array without known microphones; all unless given.

        Returns
        -------
        (N, D) float64 or None
            Metres; None if they are unknown. Without known microphones they are aligned with `positions` by the best
            rigid motion, which may include a mirror image.
        """
        return align(self.positions, positions, by) if self.blind and self.positions is not None else self.positions

    def errors(self, positions: Any, by: slice | np.ndarray = slice(None)) -> np.ndarray | None:
        """Return the distance of each position from the true one of `aligned_truth`.

        Parameters
        ----------
        positions : (N, D) array_like
            Metres.
        by : slice or index array
            As in `aligned_truth`.

        Returns
        -------
        (N,) float64 or None
            Metres; None where the true positions are unknown.
        """
        truth = self.aligned_truth(positions, by)
        return None if truth is None else position_errors(positions, truth)

    def problem(self, weights: str = "unit", known: str = "all") -> Problem:
        """Return the problem that a solver gets.

        Parameters
        ----------
        weights : str
            "unit", modes of unit RMS; or "raw", as measured and as in the paper.
        known : str
            "all" known microphones; "minimal", their minimal gauge (`fdcal.model.gauge.GaugeFrame`); or "none".

        Returns
        -------
        Problem

        Raises
        ------
        InputError
            Another choice is given, raw pressures are too small or large to be squared, or the known microphones are
            too few for the minimal gauge.
        """
        require_choice("weights", weights, ("unit", "raw"))
        require_choice("known", known, ("all", "minimal", "none"))
        pressures, noise = self.pressures, self.noise_power
        # The largest real or imaginary part of each mode : (M,) float64; its modulus could overflow.
        largest = np.maximum(np.abs(np.real(pressures)), np.abs(np.imag(pressures))).max(axis=1)
        if weights == "unit":  # division by a power of two is exact and keeps the squares finite
            exponent = np.maximum(np.frexp(largest)[1], -1023)
            scaled = pressures * np.ldexp(1.0, -exponent)[:, None]
            power = mode_power(scaled)
            noise = None if noise is None else np.ldexp(noise, -2 * exponent) / power
            pressures = scaled / np.sqrt(power)[:, None]
        elif wrong := [x for x in (largest.min(), largest.max()) if not LIMITS.weakest <= x <= LIMITS.strongest]:
            problem = f'pressures of {wrong[0]:.3g} cannot be squared with solver.weights = "raw"'
            unit = f"use another unit, between {LIMITS.weakest:g} and {LIMITS.strongest:g}"
            raise InputError(problem, f'{unit}, or solver.weights = "unit"', key="solver.weights")
        own: dict[str, Any] = {one.name: getattr(self, one.name) for one in fields(Problem) if one.name != "frame"}
        own["pressures"] = frozen_array(pressures, complex)
        own["noise_power"] = None if noise is None else frozen_array(noise, float)
        if known != "all":
            own |= {"known": self.known[:0], "known_positions": self.known_positions[:0]}
        return Problem(**own, frame=minimal_frame(self.known, self.known_positions) if known == "minimal" else None)


def _checked_pressures(values: Any, modes: int, labels: Sequence[str] | np.ndarray | None) -> np.ndarray:
    """Return checked pressures : (M, N) complex128; `labels` are the names of the microphones, or None."""
    array = np.asarray(0.0)
    with contextlib.suppress(ValueError):  # rows of different lengths are refused below
        array = np.asarray(values)
    if array.ndim == 2 and array.dtype.kind in "fc":  # name the first microphone with NaN, unless all have it
        bad = np.flatnonzero(~np.all(np.isfinite(array), axis=0))
        named = np.arange(array.shape[1]) if labels is None else np.asarray(labels)
        if 0 < len(bad) < array.shape[1] and named.shape == array.shape[1:]:
            name = named[int(bad[0])]
            problem = f'pressures of microphone "{name}" are not all finite numbers'
            raise InputError(problem, f"correct them, or leave the microphone out: <exclude> {name}", key="pressures")
    what = "the transform at each frequency, one column for each microphone"
    return require_array("pressures", values, "complex", (modes, None), what)


def _checked_arrivals(
    times: Any, sigma: Any, takes: Any, count: int, speed: float
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return checked arrivals (T, N) of `count` microphones and their sigmas (T,), s; both None without arrivals."""
    if times is None:
        if sigma is not None:
            raise InputError("arrival_sigma is given without arrivals", "add them", key="arrival_sigma")
        return None, None
    array = require_array("arrivals", times, "real", (None, count), "s, one row for each take", missing=True)
    rows, least = len(array), int(takes.max(initial=0)) + 1
    if rows < least:  # more are allowed: a take may have arrivals but no frequencies
        raise InputError(f"arrivals has shape {array.shape}", f"give {least} rows, one for each take", key="arrivals")
    latest = float(np.nanmax(np.abs(array), initial=0.0))
    if latest > LATEST_ARRIVAL:
        raise InputError(f"arrivals = {latest:.3g} s is too late", f"use up to {LATEST_ARRIVAL:g} s", key="arrivals")
    sigma = ARRIVAL_SIGMA / speed if sigma is None else sigma
    if np.ndim(sigma) == 0:
        sigma = np.full(rows, convert(np.asarray(sigma).item(), Seconds, "arrival_sigma"))
    deviation = require_array("arrival_sigma", sigma, "real", (rows,), "s, one for each take")
    if np.any(deviation <= 0):
        raise InputError("arrival_sigma must be above zero", "give one for each take, s", key="arrival_sigma")
    return array, deviation


def checked_known(
    indices: Any, positions: Any, truth: np.ndarray | None, count: int, D: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the known microphones (A,), ascending, and their `positions` (A, D), metres, or else those in `truth`."""
    numbers = () if indices is None else indices
    numbers = require_array("known", numbers, "index", (None,), "microphones counted from 0")
    listed = numbers.tolist()
    if listed and not (min(listed) >= 0 and max(listed) < count and len(set(listed)) == len(listed)):
        raise refusal("known", listed, "are not different microphones", f"name each of 0 to {count - 1} at most once")
    if len(listed) == count:
        raise InputError(f"known names all {count} microphones: none is left to be found", "leave one out", key="known")
    if positions is None:
        if listed and truth is None:
            raise InputError("known_positions is missing", "add it, shape (A, D)", key="known_positions")
        positions = np.zeros((0, D)) if truth is None else truth[numbers]
    positions = require_array("known_positions", positions, "real", (len(listed), D), "m, one row for each of known")
    order = np.argsort(numbers)
    return frozen_array(numbers[order], np.int64), frozen_array(positions[order], float)


def _require_usable(measurement: Measurement) -> None:
    """Raise InputError for too few pressures, wrong wavenumbers, a silent microphone or mode, or too much noise."""
    values, f, k = measurement.pressures, measurement.frequencies, measurement.wavenumbers
    noise = measurement.noise_power
    if not len(values) or measurement.count < 2:
        raise InputError(f"pressures have shape {values.shape}", "give two microphones or more", key="pressures")
    # With other signs a wave would travel backwards or grow with time.
    wrong = np.flatnonzero((np.real(k) <= 0) | (np.imag(k) > ROUNDING * np.real(k)))
    if len(wrong):
        problem = f"wavenumbers[{wrong[0]}] = {k[wrong[0]]:.6g} rad/m must have a real part above zero and an imaginary"
        problem += " part of zero, or below zero for a wave that decays: the time sign is exp(+j w t)"
        remedy = "with the other time sign give the conjugates of wavenumbers and pressures"
        raise InputError(problem, remedy, key="wavenumbers")
    # Wavenumbers far from 2 pi f / c are mistakes.
    usual = 2 * np.pi * f / measurement.sound_speed
    wrong = np.flatnonzero(np.abs(np.log(np.abs(k) / usual)) > np.log(LIMITS.dispersion))
    if len(wrong):
        m = wrong[0]
        problem = f"wavenumbers[{m}] = {k[m]:.6g} rad/m cannot be that of {f[m]:g} Hz with sound_speed ="
        problem += f" {measurement.sound_speed:g} m/s, where 2 pi f / c = {usual[m]:.6g} rad/m"
        raise InputError(problem, "correct them, or leave them out", key="wavenumbers")
    silent = np.flatnonzero(~np.any(values, axis=0))
    if len(silent):
        name = measurement.names[silent[0]]
        raise InputError(f'microphone "{name}" has zero pressure', f"leave it out: <exclude> {name}", key="pressures")
    silent = np.flatnonzero(~np.any(values, axis=1))
    if len(silent):
        raise InputError(f"pressures at {f[silent[0]]:g} Hz are all zero", "leave that frequency out", key="pressures")
    if noise is None:
        return
    if np.any(noise < 0):
        raise refusal("noise_power", float(noise.min()), "is negative", "use 0 for no noise")
    # The pressures include the noise, so that its power cannot be larger than theirs. The mean power of n values
    # of noise alone has a gamma distribution of shape n (Wilson-Hilferty approximation).
    largest = np.maximum(np.abs(values).max(axis=1), np.finfo(float).tiny)
    power = np.mean(np.abs(values / largest[:, None]) ** 2, axis=1)
    with np.errstate(over="ignore"):  # squared after the division, so that no unit leaves the range of floats
        ratio = np.minimum((np.sqrt(noise) / largest) ** 2 / power, 1e30)
    m, every = int(ratio.argmax()), 1 / np.mean(1 / np.maximum(ratio, 1e-30))
    for worst, n, where in ((ratio[m], measurement.count, f"at {f[m]:g} Hz"), (every, values.size, "on average")):
        if worst * max(0.0, 1 - 1 / (9 * n) - CERTAIN / np.sqrt(9 * n)) ** 3 > 1:
            problem = f"noise_power is {worst:.3g} times the power of the pressures {where}, which include the noise"
            remedy = "give it in the unit of abs(pressures)**2, not in decibels, or leave that frequency out"
            raise InputError(problem, remedy, key="noise_power")


def exclude_microphones(table: dict[str, Any], chosen: Sequence[str]) -> dict[str, Any]:
    """Return a table with keys of a measurement without the microphones `chosen`, given by name or else by number.

    Keys may be missing or None. The other microphones keep their names, or get their old numbers as names. What does
    not fit the pressures stays as it is, and the checks of `Measurement` refuse it.
    """
    pressures = np.asarray(table["pressures"])
    if not chosen or pressures.ndim != 2:
        return table
    count = pressures.shape[1]
    names = table.get("names")
    names = [str(n) for n in range(count)] if names is None else [str(name) for name in np.ravel(names)]
    if len(names) != count:
        return table
    left_out = {microphone_index(text, names, "exclude") for text in chosen}
    kept = np.array([n for n in range(count) if n not in left_out], dtype=np.int64)
    changed = dict(table, names=tuple(names[n] for n in kept))
    for key, axis in (("pressures", 1), ("positions", 0), ("arrivals", 1)):
        values: Any = table.get(key)
        if np.shape(values)[axis : axis + 1] == (count,):
            changed[key] = np.take(values, kept, axis)
    windows = table.get("windows")
    if windows is not None and windows.pressures.shape[2] == count:
        changed["windows"] = windows.of_microphones(kept)
    known, places = np.asarray(table.get("known")), table.get("known_positions")
    fits = known.ndim == 1 and known.dtype.kind in "iu" and set(known.tolist()) <= set(range(count))
    if fits and (places is None or np.shape(places)[:1] == known.shape):
        stays = np.isin(known, kept)
        changed["known"] = np.searchsorted(kept, known[stays])
        changed["known_positions"] = None if places is None else np.asarray(places)[stays]
    return changed


def microphone_index(text: str, names: Sequence[str], key: str) -> int:
    """Return the number, from 0, of the microphone with this name or number; raise InputError if there is none."""
    names = list(names)
    if text in names:
        return names.index(text)
    if text.isascii() and text.isdigit() and len(text) < 10 and int(text) < len(names):
        return int(text)
    remedy = f"give <{key}> a name, or a number from 0 to {len(names) - 1}"
    raise InputError(f'"{text}" is not the name of a microphone', remedy, key=key)


def check_channels(pressures: np.ndarray, names: Sequence[str]) -> None:
    """Raise InputError for a channel of `pressures` (M, N) that is constant or a multiple of another channel."""
    if len(pressures) < 2:
        return
    for name, column in zip(names, pressures.T, strict=True):
        if np.all(column == column[0]):
            raise InputError(f'microphone "{name}" has constant pressure', f"use <exclude> {name}", key="pressures")
    unit = pressures / np.abs(pressures).max(axis=0)
    unit = unit / np.linalg.norm(unit, axis=0)
    for a, b in np.argwhere(np.triu(np.abs(unit.conj().T @ unit) > 1 - PARALLEL, 1)):
        difference = unit[:, b] - unit[:, a] * (unit[:, a].conj() @ unit[:, b])
        if np.linalg.norm(difference) < DUPLICATE:
            problem = f'microphones "{names[a]}" and "{names[b]}" recorded the same at every frequency'
            remedy = f"leave one out: <exclude> {names[b]}"
            raise InputError(f"{problem}: the same channel, or the same position", remedy, key="pressures")


def with_different_takes(measurement: Measurement) -> Measurement:
    """Return the measurement; raise InputError if all rows of a take are multiples of the rows of another take."""
    unit = measurement.pressures / np.abs(measurement.pressures).max(axis=1)[:, None]  # no square overflows
    unit = unit / np.linalg.norm(unit, axis=1)[:, None]
    rows = [np.flatnonzero(measurement.takes == take) for take in np.unique(measurement.takes)]
    for (a, one), (b, other) in itertools.combinations(enumerate(rows, 1), 2):
        if len(one) != len(other) or not np.allclose(measurement.frequencies[one], measurement.frequencies[other]):
            continue
        if np.all(np.abs(np.sum(unit[one].conj() * unit[other], axis=1)) > 1 - DUPLICATE):
            raise InputError(f"takes {a} and {b} are copies, except for factors", "give each take once", key="takes")
    return measurement


@dataclass(frozen=True)
class MicrophonePositions:
    """Positions of named microphones in space."""

    names: tuple[str, ...]  # (N,) tuple of str, each different
    positions: np.ndarray  # (N, 3) float64, metres; (N, 2) is taken as the plane z = 0
    uncertainty: np.ndarray | None = None  # (N,) float64 or None, one standard deviation of the position, metres
    frame: str = "as found"  # name of the coordinate system

    def __post_init__(self):
        positions = require_array("positions", self.positions, "real", (len(self.names), None), "m")
        if positions.shape[1] not in (2, 3):
            raise InputError(f"positions have shape {positions.shape}", "give (N, 2) or (N, 3) metres", key="positions")
        space = np.zeros((len(positions), 3))
        space[:, : positions.shape[1]] = positions
        object.__setattr__(self, "positions", frozen_array(space, float))
        if self.uncertainty is not None:
            sigma = require_array("uncertainty_m", self.uncertainty, "real", (len(self.names),), "m")
            object.__setattr__(self, "uncertainty", sigma)
        if len(set(self.names)) < len(self.names):
            raise InputError("two microphones have the same name", "rename one of them", key="names")


FLAT = 1e-6  # metres, difference up to which heights count as equal
NEARLY_FLAT = 0.1  # largest difference of heights in the list of a plane array, divided by its width


def with_known(measurement: Measurement, known: Mapping[Any, Any] | Sequence[Any]) -> Measurement:
    """Return a measurement with other known microphones.

    `known` is a mapping of names or numbers of microphones to positions (D,), metres, or a sequence of names or numbers
    of microphones whose positions the measurement has.
    """
    names, D = measurement.names, measurement.array_dimension
    numbers = [microphone_index(str(key), names, "known") for key in known]
    own = {} if measurement.positions is None else dict(enumerate(measurement.positions))
    own |= dict(zip(measurement.known.tolist(), measurement.known_positions, strict=True))
    given = known.values() if isinstance(known, Mapping) else [own.get(number) for number in numbers]
    rows = np.zeros((len(numbers), D))
    for row, number, position in zip(rows, numbers, given, strict=True):
        if position is None:
            raise InputError(f"microphone {names[number]} has no position", "give it in <known>", key="known")
        row[:] = require_array("known", position, "real", (D,), f"metres, for {names[number]}")
    return replace(measurement, known=numbers, known_positions=rows)


def with_positions(measurement: Measurement, placed: MicrophonePositions, excluded: Sequence[str] = ()) -> Measurement:
    """Return a measurement with the positions of all microphones in a list, to compare results with.

    Rows belong to channels by name if the list has all names, otherwise by order. `placed` may also have rows for the
    channels that were left out of the measurement, whose names or numbers are `excluded`.
    """
    rows = _rows(measurement.names, placed.names, excluded)
    positions, D = np.asarray(placed.positions)[rows], measurement.array_dimension
    if D == 2 and np.ptp(positions[:, 2]) > max(FLAT, NEARLY_FLAT * np.ptp(positions[:, :2], axis=0).max()):
        problem = "the array lies in a plane, but z differs between the positions"
        raise InputError(problem, "give x and y in that plane", key="positions")
    return replace(measurement, positions=positions[:, :D], nominal=False)


def list_labels(
    names: Sequence[str], given: Sequence[str], excluded: Sequence[str] = ()
) -> tuple[tuple[str, ...], str]:
    """Return labels of the channels for a comparison with a list, and a remark if its rows are matched by order.

    `given` are the names in the list. A label is the name of the channel, followed by that of its row in parentheses if
    they differ.
    """
    rows = _rows(names, given, excluded)
    labels = tuple(n if given[row] == n else f"{n} ({given[row]})" for n, row in zip(names, rows, strict=True))
    shared = len(set(names) & set(given))
    if list(names) == [given[row] for row in rows]:
        return labels, ""
    few = f"{shared} of {len(names)} names are names of channels" if 0 < shared < len(names) else "the names differ"
    return labels, f"{few}: the list is taken in row order, {given[rows[0]]} = channel {names[0]}"


def _rows(names: Sequence[str], given: Sequence[str], excluded: Sequence[str]) -> list[int]:
    """Return for each of `names` the index of its row among `given`, by name or else by order.

    In a list numbered from 1, name n belongs to channel n - 1. If channel 0 is `excluded`, such a list has all `names`;
    its additional name N shows that it is numbered from 1.
    """
    numbers, others = [int(name) for name in names if name.isascii() and name.isdigit()], set(given) - set(names)
    counted = len(numbers) == len(names) == len(given) - len(set(excluded)) and max(numbers) < len(given)
    if set(names) <= set(given) and not (counted and others and others.isdisjoint(excluded)):
        return [list(given).index(name) for name in names]
    if len(given) == len(names):
        return list(range(len(names)))
    if counted:
        return numbers
    problem = f"{len(given)} positions are given for {len(names)} microphones"
    remedy = "give <positions> of all microphones, in the order of the channels or with their names"
    if set(given) <= set(names):
        lacking = [name for name in names if name not in given]
        problem += f", none for {', '.join(lacking[:6])}{' ...' if len(lacking) > 6 else ''}"
        remedy += "; if only these positions are known, give the list as <known>"
    else:
        problem += ", and their names differ"
    raise InputError(problem, remedy, key="positions")


VERSION = 1  # version of the file format; files of other programs may omit it
REQUIRED = ("frequencies", "pressures", "sound_speed", "dimension")
SEARCH = ("search_origin", "search_size", "search_step", "radius")
OPTIONAL = tuple(f.name for f in fields(Measurement) if f.name not in (*REQUIRED, "search", "windows", "origin"))
SHORT = ("short_frequencies", "short_takes", "short_pressures", "short_length")  # keys of `ShortWindows`


def save_measurement(measurement: Measurement, file: Any, others: Mapping[str, np.ndarray] | None = None) -> None:
    """Write a measurement as .npz, into a path or an open file; `others` have keys that `load_measurement` ignores."""
    table: dict[str, Any] = {key: getattr(measurement, key) for key in REQUIRED + OPTIONAL}
    table |= {"names": np.array(measurement.names), "version": VERSION}
    if measurement.take_count == 1 and np.all(np.diff(measurement.frequencies) > 0):
        table["takes"] = None
    table["nominal"] = measurement.nominal or None
    if measurement.search is not None:
        s = measurement.search
        table |= dict(zip(SEARCH, (s.origin, s.size, s.step, s.radius), strict=True))
    if measurement.windows is not None:
        w = measurement.windows
        table |= dict(zip(SHORT, (w.frequencies, w.takes, w.pressures, w.length), strict=True))
    table = {key: value for key, value in table.items() if value is not None} | dict(others or {})
    # Given a name, NumPy would add .npz to it.
    with open(file, "wb") if isinstance(file, (str, Path)) else contextlib.nullcontext(file) as stream:
        np.savez_compressed(stream, **table)


def load_measurement(path: Any, excluded: Sequence[str] = (), called: str = "") -> Measurement:
    """Return the measurement of an .npz file, which is given as a path or as an open file.

    The file needs all REQUIRED keys, and all or none of SEARCH and of SHORT. `excluded` are names or numbers of
    microphones that are left out before anything is checked; `called` is the name of the file in messages, by default
    its path.
    """
    table = load_archive(path, (*REQUIRED, *OPTIONAL, *SEARCH, *SHORT, "version").__contains__, called)
    path = called or path
    if "version" in table and not np.array_equal(table["version"], VERSION):
        raise InputError(f"{path} is not of version {VERSION}", "write it again with this fdcal", key="version")
    for key in REQUIRED:
        if key not in table:
            raise InputError(f'{path} has no "{key}"', f"a measurement needs {', '.join(REQUIRED)}", key=key)
    for what, keys in (("a search domain needs", SEARCH), ("short windows need", SHORT)):
        given = [key for key in keys if key in table]
        if 0 < len(given) < len(keys):
            raise InputError(f"{path} has only {', '.join(given)}", f"{what} {', '.join(keys)}", key=given[0])
    with naming(path):
        search = windows = None
        if SEARCH[0] in table:
            kinds = zip(SEARCH, ((None,), (None,), (), ()), strict=True)
            values = [require_array(key, table[key], "real", shape, "m").tolist() for key, shape in kinds]
            search = Search(tuple(values[0]), tuple(values[1]), *values[2:])
        if SHORT[0] in table:
            length = require_array(SHORT[3], table[SHORT[3]], "real", (), "s").item()
            windows = ShortWindows(table[SHORT[0]], table[SHORT[1]], table[SHORT[2]], length)
        table = {key: table[key] for key in OPTIONAL + REQUIRED if key in table} | {"windows": windows}
        table = exclude_microphones(table, excluded)
        return with_different_takes(Measurement(**table, search=search))
