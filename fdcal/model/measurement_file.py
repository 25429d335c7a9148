"""The .npz file of a measurement: a public contract (README, "The measurement file").

save_measurement, load_measurement    the keys, which are those of `fdcal.model.measurement.Measurement`
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path

import numpy as np

from .channels import exclude_microphones
from .measurement import Measurement
from .settings import Search
from .validation import InputError, StorageError, require_array

REQUIRED = ("frequencies", "pressures", "sound_speed", "dimension")
SEARCH = ("search_origin", "search_size", "search_step", "radius")
OPTIONAL = (
    "array_dimension",
    "wavenumbers",
    "noise_power",
    "names",
    "positions",
    "known",
    "known_positions",
    "spectrum",
)


def save_measurement(measurement: Measurement, file, others: Mapping[str, np.ndarray] | None = None) -> None:
    """Write `measurement` to an open binary `file` or a path, as .npz (see `load_measurement` for the keys).

    `others` are arrays under keys of their own, which `load_measurement` passes over.
    """
    table = {key: getattr(measurement, key) for key in REQUIRED + OPTIONAL}
    table["names"] = np.array(measurement.names)
    if measurement.search is not None:
        s = measurement.search
        table |= dict(zip(SEARCH, (s.origin, s.size, s.step, s.radius), strict=True))
    table = {key: value for key, value in table.items() if value is not None} | dict(others or {})
    if isinstance(file, (str, Path)):
        with open(file, "wb") as stream:  # given a name, NumPy would add .npz to it
            np.savez_compressed(stream, **table)
    else:
        np.savez_compressed(file, **table)


def load_measurement(path, excluded: Sequence[str] = (), called: str = "") -> Measurement:
    """Measurement from an .npz file, or an open binary one, which messages call `called`.

    Keys: `frequencies` (M,) Hz, `pressures` (M, N) complex, `sound_speed` m/s, `dimension`; optionally
    `array_dimension`, `wavenumbers` (M,) complex rad/m, `noise_power` (M,), `names` (N,), `positions` (N, D) m,
    `known` (A,) with `known_positions` (A, D) m, and all or none of `search_origin`, `search_size`,
    `search_step`, `radius`, m.

    The microphones `excluded`, by name or number, are left out before anything is checked.

    Raises StorageError if the file cannot be read, InputError if it does not hold a measurement.
    """
    table = _read_arrays(path)
    path = called or path
    for key in REQUIRED:
        if key not in table:
            raise InputError(f'{path} has no "{key}"; a measurement needs {", ".join(REQUIRED)}')
    given = [key for key in SEARCH if key in table]
    if given and len(given) < len(SEARCH):
        raise InputError(f"{path} has {', '.join(given)} alone; a search domain needs {', '.join(SEARCH)}")
    try:
        search = None
        if given:
            kinds = zip(SEARCH, ((None,), (None,), (), ()), strict=True)
            values = [require_array(key, table[key], "real", shape, "m").tolist() for key, shape in kinds]
            search = Search(tuple(values[0]), tuple(values[1]), *values[2:])
        table = exclude_microphones({key: table[key] for key in OPTIONAL + REQUIRED if key in table}, excluded)
        return Measurement(**table, search=search)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _read_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """The arrays of an .npz file whose keys are a measurement's; no pickled objects."""
    key = ""
    try:
        # Opened here, for NumPy leaves open what it finds damaged.
        with (
            open(path, "rb") if isinstance(path, (str, Path)) else nullcontext(path) as file,
            np.load(file, allow_pickle=False) as archive,
        ):
            table = {}
            for key in archive.files:
                if key in REQUIRED + OPTIONAL + SEARCH:
                    table[key] = archive[key]
            return table
    except (FileNotFoundError, PermissionError, IsADirectoryError) as error:
        raise StorageError(f"cannot read {path}: {error.strerror}") from error
    except Exception as error:  # a damaged archive raises anything from zipfile, zlib or NumPy
        if key:
            raise InputError(
                f'{path}: "{key}" is damaged or no plain array of numbers ({error}); write it anew'
            ) from error
        raise InputError(f"{path} is not an .npz file that can be read ({type(error).__name__})") from error
