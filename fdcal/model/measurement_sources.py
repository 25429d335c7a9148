"""Other ways to make a `Measurement`: from arrays with names in place of numbers, and from objects of pyfar."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

import fdcal

from .channels import microphone_index
from .validation import require_choice


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
