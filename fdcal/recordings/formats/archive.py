"""NumPy's .npz with `recordings` (N, T) and `sample_rate`, Hz; optionally `kind`, `names`, `positions`, `sound_speed`.

A measurement, which has pressures instead, is read by `fdcal.model.measurement_file`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...model.reading import read_archive, require_regular
from ...model.validation import InputError, require_array, require_choice
from ..recording import KINDS, OLD_KINDS, Recording, recording_of

SUFFIXES = (".npz",)
KEYS = {
    "recordings": ("real", (None, None)),
    "sample_rate": ("real", ()),
    "kind": ("text", ()),
    "names": ("text", (None,)),
    "positions": ("real", (None, None)),
    "sound_speed": ("real", ()),
}


def keys_of(path: Path) -> list[str]:
    """Return the names of the arrays in an archive; none where it cannot be read."""
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            return list(archive.files)
    except Exception:  # a damaged archive raises anything
        return []


def read(path: Path, source: int | None = None) -> Recording:
    """Return the recording of an archive; raise InputError for one that is damaged or has no recordings."""
    try:
        require_regular(path)
        with open(path, "rb") as file:
            table = read_archive(file, KEYS.__contains__)
    except InputError as error:
        raise error.within(path) from error
    except OSError as error:
        raise error if error.strerror else InputError(f"{path} is not a .npz file: {error}") from error
    except MemoryError:
        raise InputError(
            f"{path} holds more than fits into memory, and an .npz file is read as a whole",
            "give WAV, W64, FLAC or HDF5",
        ) from None
    except Exception as error:
        raise InputError(
            f"{path} is not an .npz file that can be read ({type(error).__name__})", "write it again"
        ) from error
    if "pressures" in keys_of(path):
        raise InputError(f"{path} is a measurement already", "give it to `fdcal calibrate`")
    for key in ("recordings", "sample_rate"):
        if key not in table:
            raise InputError(
                f'{path} has no "{key}"', "give recordings (N, T) and sample_rate, or a measurement", key=key
            )
    value = {key: require_array(f"{path}: {key}", table[key], *KEYS[key]) for key in table if key != "recordings"}
    data = table["recordings"]
    if data.ndim != 2 or data.dtype.kind not in "fiu":
        raise InputError(f"{path}: recordings is {data.dtype} of shape {data.shape}", "give real numbers (N, T)")
    kind = value["kind"].item() if "kind" in value else None
    kind = OLD_KINDS.get(kind or "", kind)
    if kind is not None:
        require_choice(f"{path}: kind", kind, KINDS)
    return recording_of(
        str(path),
        kind,
        value["sample_rate"].item(),
        data,
        names=tuple(value["names"].tolist()) if "names" in value else (),
        positions=value.get("positions"),
        sound_speed=value["sound_speed"].item() if "sound_speed" in value else None,
    )
