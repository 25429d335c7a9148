"""Which microphones take part: some are left out; channels without signal and duplicates are refused by name."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .validation import InputError

DUPLICATE = 1e-9  # difference, up to a factor, over the norm of one, of channels that count as one recording
PARALLEL = 1e-6  # 1 - abs(correlation) of the pairs whose difference is computed


def exclude_microphones(table: dict[str, Any], chosen: Sequence[str]) -> dict[str, Any]:
    """Return a table of keys of a measurement without the microphones `chosen`, names or numbers; a name goes first.

    Keys that are missing or None stay so; the others keep their names, or their old numbers as names.
    """
    pressures = np.asarray(table["pressures"])
    if not chosen or pressures.ndim != 2:
        return table
    count = pressures.shape[1]
    names = table.get("names")
    names = [str(n) for n in range(count)] if names is None else [str(name) for name in names]
    left_out = {microphone_index(text, names, "exclude") for text in chosen}
    kept = np.array([n for n in range(count) if n not in left_out], dtype=np.int64)
    changed = dict(table, pressures=pressures[:, kept], names=tuple(names[n] for n in kept))
    if table.get("positions") is not None:
        changed["positions"] = np.asarray(table["positions"])[kept]
    arrivals = table.get("arrivals")
    if arrivals is not None and np.ndim(arrivals) == 2 and np.shape(arrivals)[1] == count:
        changed["arrivals"] = np.asarray(arrivals)[:, kept]
    if table.get("known") is not None:
        known = np.asarray(table["known"])
        stays = np.isin(known, kept)
        changed["known"] = np.searchsorted(kept, known[stays])
        if table.get("known_positions") is not None:
            changed["known_positions"] = np.asarray(table["known_positions"])[stays]
    return changed


def microphone_index(text: str, names: Sequence[str], key: str) -> int:
    """Return the number, from 0, of the microphone with a name or number; InputError, of argument `key`, if none."""
    names = list(names)
    if text in names:
        return names.index(text)
    if text.isascii() and text.isdigit() and len(text) < 10 and int(text) < len(names):
        return int(text)
    remedy = f"give <{key}> names, or numbers from 0 to {len(names) - 1}"
    raise InputError(f'"{text}" names no microphone', remedy, key=key, value=text)


def check_channels(pressures: np.ndarray, names: Sequence[str]) -> None:
    """Refuse channels of `pressures` (M, N) without signal, or the same as another up to a factor, by name."""
    if len(pressures) < 2:
        return
    for name, column in zip(names, pressures.T, strict=True):
        if np.all(column == column[0]):
            problem = f'microphone "{name}" has one and the same pressure at every frequency'
            raise InputError(problem, f"leave it out: <exclude> {name}", key="pressures")
    scale = np.abs(pressures).max(axis=0)
    unit = pressures / scale
    unit = unit / np.linalg.norm(unit, axis=0)
    correlation = np.abs(unit.conj().T @ unit)
    for a, b in np.argwhere(np.triu(correlation > 1 - PARALLEL, 1)):
        difference = unit[:, b] - unit[:, a] * (unit[:, a].conj() @ unit[:, b])
        if np.linalg.norm(difference) < DUPLICATE:
            problem = f'microphones "{names[a]}" and "{names[b]}" recorded the same at every frequency'
            remedy = f"leave one out: <exclude> {names[b]}"
            raise InputError(f"{problem}: one recording, or one place", remedy, key="pressures")
