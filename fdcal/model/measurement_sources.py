"""Other ways to make a `Measurement`: from arrays with names in place of numbers, and from objects of pyfar."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

import fdcal

from .channels import microphone_index
from .measurement_checks import ARRIVALS
from .validation import InputError, require_choice


class MeasurementSources:
    """Class methods of `fdcal.model.measurement.Measurement`."""

    @classmethod
    def from_arrays(
        cls,
        frequencies,
        pressures,
        *,
        sound_speed: float = 343.2,
        dimension: int = 3,
        names: Sequence[str] | None = None,
        positions=None,
        known: Mapping | Sequence | None = (),
        time_convention: str = "exp(+jwt)",
        **others: Any,
    ) -> fdcal.Measurement:
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
        return cast(Any, cls)(
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
    def from_takes(cls, measurements: Sequence[fdcal.Measurement]) -> fdcal.Measurement:
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
        return cast(Any, cls)(
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

    @classmethod
    def from_pyfar(cls, data, coordinates=None, **options: Any) -> fdcal.Measurement:
        """Return the measurement of an object of pyfar.

        Parameters
        ----------
        data : pyfar.FrequencyData or pyfar.Signal
            One channel a microphone. Of frequency data, all frequencies are taken as they are; of a signal they are
            chosen as for a recording.
        coordinates : pyfar.Coordinates, optional
            Positions of the microphones, to compare with.
        **options
            Of frequency data, as of `from_arrays`; of a signal, fields of
            `fdcal.recordings.import_options.ImportOptions`.

        Returns
        -------
        Measurement

        Raises
        ------
        InputError
            A value is impossible.

        Examples
        --------
        >>> import fdcal, pyfar
        >>> import numpy as np
        >>> data = pyfar.FrequencyData(np.exp(1j * np.arange(12.0)).reshape(4, 3), [100, 150, 210])
        >>> fdcal.Measurement.from_pyfar(data).count
        4
        """
        return fdcal.extension("measurement_of_pyfar")(data, coordinates, **options)


def _joined_spectrum(each: Sequence[fdcal.Measurement]) -> np.ndarray | None:
    """Return the spectra of all takes over the frequencies of the finest : (1 + T, F) float64; None if one lacks it."""
    spectra = [one.spectrum for one in each if one.spectrum is not None]
    if len(spectra) < len(each) or any(
        len(spectrum) != 1 + one.take_count for spectrum, one in zip(spectra, each, strict=True)
    ):
        return None
    f = max((spectrum[0] for spectrum in spectra), key=len)
    return np.stack([f, *(np.interp(f, spectrum[0], power) for spectrum in spectra for power in spectrum[1:])])


def _take_rows(measurement: fdcal.Measurement) -> int:
    """Number of takes, counted to the last that has a row or arrivals."""
    own = 0 if measurement.arrivals is None else len(measurement.arrivals)
    return max(int(measurement.takes.max()) + 1, own)


def _joined_arrivals(each: Sequence[fdcal.Measurement]) -> dict[str, np.ndarray]:
    """Arrivals of all takes, and their sigma, as arguments of a measurement; NaN for those without."""
    if all(one.arrivals is None for one in each):
        return {}
    times, sigma = [], []
    for one in each:
        rows = _take_rows(one)
        none = np.full((rows, one.count), np.nan), np.full(rows, ARRIVALS.sigma / one.sound_speed)
        times.append(none[0] if one.arrivals is None else one.arrivals)
        sigma.append(none[1] if one.arrival_sigma is None else one.arrival_sigma)
    return {"arrivals": np.concatenate(times), "arrival_sigma": np.concatenate(sigma)}
