"""Which microphones take part: some left out, dead or doubled channels refused by name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .validation import InputError

ALIKE = 1e-9  # of a channel's norm: two that differ less, a factor apart, are one recording


def exclude_microphones(table: dict, chosen: Sequence[str]) -> dict:
    """The keys of a measurement (see `fdcal.model.measurement.Measurement`) less the microphones `chosen`, by name
    or number.

    A name goes before a number. Those that stay keep their names, or their old numbers as names. Keys not there or
    None stay so. Raises InputError for one that is not there.
    """
    pressures = np.asarray(table["pressures"])
    if not chosen or pressures.ndim != 2:
        return table
    count = pressures.shape[1]
    names = table.get("names")
    names = [str(n) for n in range(count)] if names is None else [str(name) for name in names]
    left_out = {microphone_index(text, names, "--exclude") for text in chosen}
    kept = np.array([n for n in range(count) if n not in left_out], dtype=np.int64)
    changed = dict(table, pressures=pressures[:, kept], names=tuple(names[n] for n in kept))
    if table.get("positions") is not None:
        changed["positions"] = np.asarray(table["positions"])[kept]
    if table.get("known") is not None:
        known = np.asarray(table["known"])
        stays = np.isin(known, kept)
        changed["known"] = np.searchsorted(kept, known[stays])
        if table.get("known_positions") is not None:
            changed["known_positions"] = np.asarray(table["known_positions"])[stays]
    return changed


def microphone_index(text: str, names: Sequence[str], option: str) -> int:
    """Number of the microphone that `text` names, or counts from 0; InputError naming `option` if there is none."""
    names = list(names)
    if text in names:
        return names.index(text)
    if text.isascii() and text.isdigit() and int(text) < len(names):
        return int(text)
    raise InputError(f"{option} {text} names no microphone; give names, or numbers from 0 to {len(names) - 1}")


def check_channels(pressures: np.ndarray, names: Sequence[str]) -> None:
    """Raise InputError naming the channels that hold nothing or the same as another, and the option to leave them out.

    pressures : (M, N) complex128
    """
    dead = [name for name, column in zip(names, pressures.T, strict=True) if np.all(column == column[0])]
    if dead and len(pressures) > 1:
        raise InputError(
            f'microphone "{dead[0]}" has one and the same pressure at every frequency; --exclude {dead[0]}'
        )
    if len(pressures) < 2:
        return
    scale = np.abs(pressures).max(axis=0)
    unit = pressures / scale
    unit = unit / np.linalg.norm(unit, axis=0)
    alike = np.abs(unit.conj().T @ unit)
    for a, b in np.argwhere(np.triu(alike > 1 - 1e-6, 1)):
        rest = unit[:, b] - unit[:, a] * (unit[:, a].conj() @ unit[:, b])
        if np.linalg.norm(rest) < ALIKE:
            raise InputError(
                f'microphones "{names[a]}" and "{names[b]}" heard the same at every frequency: one recording, or one'
                f" place; leave one out with --exclude {names[b]}"
            )
