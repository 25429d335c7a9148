"""What was measured. It may hold the true positions, for scoring alone; the `Problem` that a solver sees cannot.

`fdcal.model.measurement_checks` validates it. Its .npz file is a public format (docs/reference/files.md): the keys are
the fields of `Measurement` and those of the search domain.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import IO, Any, ClassVar

import numpy as np

from . import measurement_checks as checks
from .gauge import align, minimal_frame, position_errors
from .measurement_checks import exclude_microphones, microphone_index
from .problem import Problem, mode_power
from .settings import Search
from .storage import read_archive, require_regular
from .validation import LIMITS, InputError, StorageError, frozen_array, require_array, require_choice


@dataclass(frozen=True, init=False, repr=False)
class Measurement:
    """Pressures of M modes at N microphones and what is known about them.

    Parameters
    ----------
    frequencies : (M,) float64
        Hz, ascending; of rows of several takes, or of several sources of one take, equal ones are allowed.
    pressures : (M, N) complex128
        In any one unit for all (recordings are not calibrated).
    sound_speed : float
        c, m/s. With `dataclasses.replace`, wavenumbers that were not given follow a new one; those that were must be
        given again.
    dimension : int
        Of the sound field, 2 or 3.
    array_dimension : int, optional
        D of all positions, 2 or 3; `dimension` unless given.
    wavenumbers : (M,) complex128, optional
        k, rad/m, time sign exp(+j w t); 2 pi f / c unless given.
    noise_power : (M,) float64, optional
        In the unit of abs(pressures)**2.
    names : (N,) tuple of str, optional
        "0", "1", ... unless given.
    positions : (N, D) float64, optional
        True positions, metres, for scoring alone.
    known : (A,) int64
        Indices of known microphones, in any order; kept ascending.
    known_positions : (A, D) float64, optional
        Metres; the true positions unless given.
    search : Search, optional
        Lattice of candidates and expansion radius.
    spectrum : (2, F) or (1 + T, F) float64, optional
        The spectrum that the frequencies were picked from, for display alone: Hz, ascending, and the mean power of all
        microphones, in any one unit; of several takes one row of power for each, or one for all.
    takes : (M,) int64, optional
        The take of each row, counted from 0; one take unless given. A take is one recording of all microphones with
        the source at one place: the channels and the positions are common to all takes, the sound field is not.
    arrivals : (T, N) float64, optional
        When the direct sound arrives at each microphone in each take, seconds; row t belongs to take t, and its origin
        is arbitrary. NaN where the direct sound does not stand out.
    arrival_sigma : (T,) float64 or float, optional
        One sigma of an arrival of each take, seconds, as far as it is known; 0.3 mm over the sound speed unless given.
    nominal : bool, optional
        Whether `positions` are nominal, those of the plan of the array, rather than true.

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
    dimension: int
    array_dimension: int
    wavenumbers: np.ndarray
    noise_power: np.ndarray | None
    names: tuple[str, ...]
    positions: np.ndarray | None
    known: np.ndarray
    known_positions: np.ndarray
    search: Search | None
    spectrum: np.ndarray | None
    takes: np.ndarray
    arrivals: np.ndarray | None
    arrival_sigma: np.ndarray | None
    nominal: bool

    # Carried out by `fdcal.recordings`; `fdcal.METHODS` binds it.
    from_pyfar: ClassVar[Callable[..., Measurement]]

    def __init__(
        self,
        frequencies: Any,
        pressures: Any,
        sound_speed: Any,
        dimension: Any = 2,
        array_dimension: Any = None,
        wavenumbers: Any = None,
        noise_power: Any = None,
        names: Sequence[str] | np.ndarray | None = None,
        positions: Any = None,
        known: Any = (),
        known_positions: Any = None,
        search: Search | None = None,
        spectrum: Any = None,
        takes: Any = None,
        arrivals: Any = None,
        arrival_sigma: Any = None,
        nominal: Any = False,
    ):
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        put("sound_speed", checks.sound_speed(sound_speed))
        put("dimension", checks.dimension("dimension", dimension, (2, 3)))
        own = self.dimension if array_dimension is None else array_dimension
        put("array_dimension", checks.dimension("array_dimension", own, range(2, self.dimension + 1)))
        put("frequencies", require_array("frequencies", frequencies, "real", (None,), "Hz"))
        put("pressures", checks.pressures(pressures, len(self.frequencies), names))
        put("wavenumbers", checks.wavenumbers(wavenumbers, self.frequencies, self.sound_speed))
        if noise_power is not None:
            noise_power = require_array("noise_power", noise_power, "real", self.frequencies.shape, "one for each mode")
        put("noise_power", noise_power)
        put("takes", checks.takes(takes, len(self.frequencies)))
        put("names", checks.names(names, self.count))
        times, sigma = checks.arrivals(arrivals, arrival_sigma, self.takes, self.count, self.sound_speed)
        put("arrivals", times)
        put("arrival_sigma", sigma)
        if positions is not None:
            positions = require_array("positions", positions, "real", (self.count, self.array_dimension), "m")
        put("positions", positions)
        put("nominal", checks.flag("nominal", nominal))
        put("spectrum", None if spectrum is None else checks.spectrum(spectrum, self.takes))
        indices, places = checks.known(known, known_positions, self.positions, self.count, self.array_dimension)
        put("known", indices)
        put("known_positions", places)
        put("search", search)
        checks.require_search_dimension(search, self.array_dimension)
        checks.require_order(self.frequencies, repeated=takes is not None)
        checks.require_usable(
            self.frequencies, self.pressures, self.wavenumbers, self.noise_power, self.names, self.sound_speed
        )

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
        """Return a measurement of arrays as another program holds them.

        Parameters
        ----------
        frequencies : (M,) array_like
            Hz, ascending.
        pressures : (M, N) array_like, complex
            In any one unit, of microphones that recorded at the same time.
        sound_speed : float
            m/s; 343.2 at 20 degrees Celsius.
        dimension : int
            Of the sound field: 3 in a room, 2 over a plate.
        names : (N,) sequence of str, optional
            "0", "1", ... unless given.
        positions : (N, D) array_like, optional
            True positions, metres, for scoring alone.
        known : mapping or sequence, optional
            Microphones whose positions the solver gets, by name or number: a mapping to positions (D,), metres; or a
            sequence of those whose `positions` are right.
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
        pressures = np.asarray(pressures)
        labels = [str(n) for n in range(pressures.shape[-1] if pressures.ndim else 0)] if names is None else list(names)
        known = () if known is None else known
        numbers = [microphone_index(str(one), labels, "known") for one in known]
        places = [np.asarray(place, float).tolist() for place in known.values()] if isinstance(known, Mapping) else None
        columns = np.shape(positions if positions is not None else places or ())[1:]
        others = {"array_dimension": columns[0] if columns else None, "known_positions": places} | others
        return cls(
            frequencies,
            pressures.conj() if time_convention == "exp(-jwt)" else pressures,
            sound_speed,
            dimension,
            names=None if names is None else labels,
            positions=positions,
            known=numbers,
            **others,
        )

    @classmethod
    def from_takes(cls, measurements: Sequence[Measurement]) -> Measurement:
        """Return one measurement of several takes of one array, the source at another place in each.

        Parameters
        ----------
        measurements : sequence of Measurement
            Of the same microphones, in the same order, none of them moved in between. Each becomes a take; one that
            has several takes keeps them. Known and true positions are those of the first that has any.

        Returns
        -------
        Measurement
            Rows by frequency, then by take. It has noise, or a spectrum, only if all of them have.

        Raises
        ------
        InputError
            There is none, or two differ in microphones, dimension, sound speed or given positions.

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
                    problem = f"measurement {number} has other {key} than the first: {getattr(one, key)!r}"
                    raise InputError(problem[:300], "import all takes alike", key=key)
        known = next((one for one in each if len(one.known)), each[0])
        placed = next((one for one in each if one.positions is not None), None)
        for number, one in enumerate(each, 1):
            same = np.array_equal(one.known, known.known) and np.allclose(one.known_positions, known.known_positions)
            if len(one.known) and not same:
                problem = f"measurement {number} gives other known positions than another take"
                raise InputError(problem, "give them once, or alike", key="known")
        firsts = np.cumsum([0, *(_take_rows(one) for one in each)])
        f = np.concatenate([one.frequencies for one in each])
        takes = np.concatenate([one.takes + first for one, first in zip(each, firsts, strict=False)])
        order = np.lexsort((takes, f))
        noise = [one.noise_power for one in each if one.noise_power is not None]
        return cls(
            f[order],
            np.concatenate([one.pressures for one in each])[order],
            each[0].sound_speed,
            each[0].dimension,
            each[0].array_dimension,
            wavenumbers=np.concatenate([one.wavenumbers for one in each])[order],
            noise_power=np.concatenate(noise)[order] if len(noise) == len(each) else None,
            names=each[0].names,
            positions=None if placed is None else placed.positions,
            nominal=placed is not None and placed.nominal,
            known=known.known,
            known_positions=known.known_positions,
            search=each[0].search,
            spectrum=_joined_spectrum(each),
            takes=takes[order],
            **_joined_arrivals(each),
        )

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
            Its number, one of `takes`.

        Returns
        -------
        Measurement
            Of these rows alone, with the same microphones.

        Raises
        ------
        InputError
            If there is no such take.
        """
        chosen, numbers = self.takes == take, np.unique(self.takes)
        if not np.any(chosen):
            listed = ", ".join(map(str, numbers[:20]))
            raise InputError(f"there is no take {take}", f"use one of {listed}", key="take", value=take)
        spectrum, others = self.spectrum, np.arange(take + 1)[:, None] != take
        if spectrum is not None and len(spectrum) > 2:  # one for each take
            spectrum = spectrum[[0, 1 + int(np.searchsorted(numbers, take))]]
        return replace(
            self,
            frequencies=self.frequencies[chosen],
            pressures=self.pressures[chosen],
            wavenumbers=self.wavenumbers[chosen],
            noise_power=None if self.noise_power is None else self.noise_power[chosen],
            spectrum=spectrum,
            takes=self.takes[chosen],
            arrivals=None if self.arrivals is None else np.where(others, np.nan, self.arrivals[: take + 1]),
            arrival_sigma=None if self.arrival_sigma is None else self.arrival_sigma[: take + 1],
        )

    @property
    def reference(self) -> str:
        """What `positions` are, in a word: "true" or "nominal"."""
        return "nominal" if self.nominal else "true"

    @property
    def blind(self) -> bool:
        """Whether no microphone is known: translation, rotation and mirror image of the array are undetermined."""
        return not len(self.known)

    def aligned_truth(self, positions: Any, by: slice | np.ndarray = slice(None)) -> np.ndarray | None:
        """Return the true positions as they compare with estimated ones.

        Parameters
        ----------
        positions : (N, D) float64
            Estimated positions, metres.
        by : slice or index array
            Microphones that determine the motion of a blind array; all unless given.

        Returns
        -------
        (N, D) float64 or None
            Metres; None if they are not known. Of a blind array they are aligned with `positions` by the best rigid
            motion of the whole, a mirror image allowed.
        """
        return align(self.positions, positions, by) if self.blind and self.positions is not None else self.positions

    def errors(self, positions: Any, by: slice | np.ndarray = slice(None)) -> np.ndarray | None:
        """Return the distance of each position from the true one, as of `aligned_truth`.

        Parameters
        ----------
        positions : (N, D) array_like
            Metres.
        by : slice or index array
            As of `aligned_truth`.

        Returns
        -------
        (N,) float64 or None
            Metres; None where the true positions are unknown.
        """
        truth = self.aligned_truth(positions, by)
        return None if truth is None else position_errors(positions, truth)

    def problem(self, weights: str = "unit", known: str = "all") -> Problem:
        """Return what a solver sees.

        Parameters
        ----------
        weights : str
            "unit", modes of unit RMS; or "raw", as measured, the paper's.
        known : str
            "all" that are known; "minimal", the minimal gauge of them (`fdcal.model.gauge.GaugeFrame`); or "none".

        Returns
        -------
        Problem

        Raises
        ------
        InputError
            For another choice, raw pressures too small or large to be squared, or too few known microphones for the
            minimal gauge.
        """
        require_choice("weights", weights, ("unit", "raw"))
        require_choice("known", known, ("all", "minimal", "none"))
        pressures, noise = self._unit_modes() if weights == "unit" else self._raw_modes()
        everything = known == "all"
        return Problem(
            pressures=frozen_array(pressures, complex),
            wavenumbers=self.wavenumbers,
            frequencies=self.frequencies,
            known=self.known if everything else frozen_array([], np.int64),
            known_positions=self.known_positions if everything else frozen_array(self.known_positions[:0], float),
            search=self.search,
            noise_power=None if noise is None else frozen_array(noise, float),
            sound_speed=self.sound_speed,
            dimension=self.dimension,
            array_dimension=self.array_dimension,
            frame=minimal_frame(self.known, self.known_positions) if known == "minimal" else None,
            takes=self.takes,
            arrivals=self.arrivals,
            arrival_sigma=self.arrival_sigma,
        )

    def _unit_modes(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Return pressures (M, N) of unit RMS and their noise power (M,), whatever the unit.

        Divided by a power of two first, which rounds nothing and keeps the squares within the range of floats.
        """
        _, exponent = np.frexp(_largest(self.pressures))
        pressures = np.empty_like(self.pressures)
        pressures.real = np.ldexp(np.real(self.pressures), -exponent[:, None])
        pressures.imag = np.ldexp(np.imag(self.pressures), -exponent[:, None])
        power = mode_power(pressures)
        noise = None if self.noise_power is None else np.ldexp(self.noise_power, -2 * exponent) / power
        return pressures / np.sqrt(power)[:, None], noise

    def _raw_modes(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Return pressures and noise power as measured; InputError where a cost would leave the range of floats."""
        largest = _largest(self.pressures)
        for value in (largest.min(), largest.max()):
            if not LIMITS.weakest <= value <= LIMITS.strongest:
                problem = f'pressures of {value:.3g} cannot be squared with solver.weights = "raw"'
                unit = f"use another unit, between {LIMITS.weakest:g} and {LIMITS.strongest:g}"
                raise InputError(problem, f'{unit}, or solver.weights = "unit"', key="solver.weights", value="raw")
        return self.pressures, self.noise_power


def _joined_spectrum(each: Sequence[Measurement]) -> np.ndarray | None:
    """Return the spectra of all takes over the frequencies of the finest : (1 + T, F) float64; None if one lacks it."""
    spectra = [s for one in each if (s := one.spectrum) is not None and len(s) == 1 + one.take_count]
    if len(spectra) < len(each):
        return None
    f = max((spectrum[0] for spectrum in spectra), key=len)
    return np.stack([f, *(np.interp(f, spectrum[0], power) for spectrum in spectra for power in spectrum[1:])])


def _take_rows(measurement: Measurement) -> int:
    """Number of takes, counted to the last that has a row or arrivals."""
    own = 0 if measurement.arrivals is None else len(measurement.arrivals)
    return max(int(measurement.takes.max()) + 1, own)


def _joined_arrivals(each: Sequence[Measurement]) -> dict[str, np.ndarray]:
    """Arrivals of all takes, and their sigma, as arguments of a measurement; NaN for those without."""
    if all(one.arrivals is None for one in each):
        return {}
    times: list[np.ndarray] = []
    sigma: list[np.ndarray] = []
    for one in each:
        rows = _take_rows(one)
        usual = np.full(rows, checks.ARRIVAL_SIGMA / one.sound_speed)
        times.append(np.full((rows, one.count), np.nan) if one.arrivals is None else one.arrivals)
        sigma.append(usual if one.arrival_sigma is None else one.arrival_sigma)
    return {"arrivals": np.concatenate(times), "arrival_sigma": np.concatenate(sigma)}


def _largest(pressures: np.ndarray) -> np.ndarray:
    """Return the largest real or imaginary part of each mode : (M,) float64; its modulus could overflow."""
    return np.maximum(np.abs(np.real(pressures)), np.abs(np.imag(pressures))).max(axis=1)


REQUIRED = ("frequencies", "pressures", "sound_speed", "dimension")
SEARCH = ("search_origin", "search_size", "search_step", "radius")
OPTIONAL = tuple(field.name for field in fields(Measurement) if field.name not in (*REQUIRED, "search"))


def save_measurement(measurement: Measurement, file: Any, others: Mapping[str, np.ndarray] | None = None) -> None:
    """Write a measurement as .npz, into a path or an open file; `others` have keys that `load_measurement` ignores."""
    table: dict[str, Any] = {key: getattr(measurement, key) for key in REQUIRED + OPTIONAL}
    table["names"] = np.array(measurement.names)
    if measurement.take_count == 1 and np.all(np.diff(measurement.frequencies) > 0):
        table["takes"] = None
    table["nominal"] = measurement.nominal or None
    if measurement.search is not None:
        s = measurement.search
        table |= dict(zip(SEARCH, (s.origin, s.size, s.step, s.radius), strict=True))
    table = {key: value for key, value in table.items() if value is not None} | dict(others or {})
    if isinstance(file, (str, Path)):
        with open(file, "wb") as stream:  # given a name, NumPy would add .npz to it
            np.savez_compressed(stream, **table)
    else:
        np.savez_compressed(file, **table)


def load_measurement(path: Any, excluded: Sequence[str] = (), called: str = "") -> Measurement:
    """Return the measurement of an .npz file, a path or open, that has all REQUIRED keys and all or none of SEARCH.

    `excluded`: names or numbers of microphones that are left out before anything is checked; `called`: what messages
    call the file; its path unless given.
    """
    table = _read_arrays(path)
    path = called or path
    for key in REQUIRED:
        if key not in table:
            raise InputError(f'{path} has no "{key}"', f"a measurement needs {', '.join(REQUIRED)}", key=key)
    given = [key for key in SEARCH if key in table]
    if given and len(given) < len(SEARCH):
        remedy = f"a search domain needs {', '.join(SEARCH)}"
        raise InputError(f"{path} has {', '.join(given)} alone", remedy, key=given[0])
    try:
        search = None
        if given:
            for key in SEARCH[:2]:
                if np.shape(table[key]) not in ((2,), (3,)):
                    raise InputError(f"{key} has shape {np.shape(table[key])}", "give two or three numbers", key=key)
            kinds = zip(SEARCH, ((None,), (None,), (), ()), strict=True)
            values = [require_array(key, table[key], "real", shape, "m").tolist() for key, shape in kinds]
            search = Search(tuple(values[0]), tuple(values[1]), *values[2:])
        table = exclude_microphones({key: table[key] for key in OPTIONAL + REQUIRED if key in table}, excluded)
        return Measurement(**table, search=search)
    except InputError as error:
        raise error.within(path) from None


def _read_arrays(path: str | Path | IO[bytes]) -> dict[str, np.ndarray]:
    """Return the arrays of an .npz file whose keys are those of a measurement; no pickled objects are read."""
    try:
        if isinstance(path, (str, Path)):
            require_regular(path)
        # Opened here, since NumPy does not close a file that it finds damaged.
        with open(path, "rb") if isinstance(path, (str, Path)) else nullcontext(path) as file:
            return read_archive(file, lambda key: key in REQUIRED + OPTIONAL + SEARCH)
    except (FileNotFoundError, PermissionError, IsADirectoryError) as error:
        raise StorageError(f"cannot read {path}: {error.strerror}") from error
    except InputError as error:
        raise error.within(path) from error
    except Exception as error:  # a damaged archive raises anything from zipfile, zlib or NumPy
        problem = f"{path} is not an .npz file that can be read ({type(error).__name__})"
        raise InputError(problem, "write it with numpy.savez") from error
