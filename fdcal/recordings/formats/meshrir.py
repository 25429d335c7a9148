"""A folder of MeshRIR: impulse responses of one microphone moved over a mesh, with several sources.

    pos_mic.npy    (M, 3), metres            ir_<i>.npy    (S, T), one for each of the M places
    pos_src.npy    (S, 3), metres            48 kHz

S. Koyama, T. Nishida, K. Kimura, T. Abe, N. Ueno, J. Brunnström, "MeshRIR: A dataset of room impulse responses on
meshed grid points for evaluating sound field analysis and synthesis methods", WASPAA 2021.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...model.validation import InputError, StorageError
from ..recording import Recording

SUFFIXES = ()
SAMPLE_RATE = 48_000.0  # Hz, of the whole data set; no file contains it


def recognises(path: Path) -> bool:
    """Return whether `path` is a folder with microphone positions."""
    return path.is_dir() and ((path / "pos_mic.npy").exists() or (path / "ir_0.npy").exists())


def read(path: Path, source: int | None = None) -> Recording:
    """Return the responses to one source, the first by default; raise InputError for a damaged folder."""
    places, sources = (_positions(path / name) for name in ("pos_mic.npy", "pos_src.npy"))
    source = 0 if source is None else source
    if not 0 <= source < len(sources):
        raise InputError(
            f"source = {source} does not exist",
            f"{path} has sources 0 to {len(sources) - 1}",
            key="source",
            value=source,
        )
    missing = [n for n in range(len(places)) if not (path / f"ir_{n}.npy").exists()]
    if missing:
        raise InputError(
            f"{path} has {len(places)} positions but no ir_{missing[0]}.npy ({len(missing)} missing)", "copy it again"
        )
    samples = _mapped(path / "ir_0.npy").shape[-1]

    def block(start: int, stop: int, chosen: np.ndarray) -> np.ndarray:
        values = np.empty((len(chosen), stop - start))
        for row, n in enumerate(chosen):
            file = path / f"ir_{n}.npy"
            data = _mapped(file)
            if data.shape != (len(sources), samples):
                wanted = (len(sources), samples)
                raise InputError(
                    f"{file} has shape {data.shape}, but pos_src.npy and ir_0.npy call for {wanted}", "copy it again"
                )
            values[row] = data[source, start:stop]
        return values

    return Recording(str(path), "response", SAMPLE_RATE, len(places), samples, block, positions=places)


def source_count(path: Path) -> int:
    """Return the number of sources of a folder."""
    return len(_positions(path / "pos_src.npy"))


def _positions(path: Path) -> np.ndarray:
    values = _mapped(path)
    if values.ndim != 2 or values.shape[1] != 3 or not len(values):
        raise InputError(f"{path} has shape {values.shape}", "it must be (number, 3), metres")
    if not np.all(np.isfinite(values)):
        raise InputError(f"{path} holds a number that is not finite", "repair it")
    return np.array(values, dtype=float)


def _mapped(path: Path) -> np.ndarray:
    """Return an .npy file of real numbers, memory-mapped."""
    try:
        values = np.load(path, mmap_mode="r", allow_pickle=False)
    except OSError as error:
        raise StorageError(f"cannot read {path}: {error.strerror or error}") from error
    except Exception as error:  # a damaged header raises anything
        raise InputError(f"{path} is damaged or truncated ({error})", "copy it again") from error
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu" or values.ndim == 0:
        raise InputError(f"{path} holds no array of real numbers", "copy it again")
    return values
