"""The .npz file of a measurement, a public format (docs/reference/files.md).

Its keys are the fields of `fdcal.model.measurement.Measurement`, and those of the search domain.
"""

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from .channels import exclude_microphones
from .measurement import Measurement
from .reading import read_archive, require_regular
from .settings import Search
from .validation import InputError, StorageError, require_array

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


def _read_arrays(path: str | Path) -> dict[str, np.ndarray]:
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
