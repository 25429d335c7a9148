"""Checks of a measurement: each returns the value as a read-only array, or raises InputError with key and remedy.

After them, which microphones take part: some are left out; channels without signal and duplicates are refused by name.
"""

import weakref
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .declared import require_positive
from .settings import Search
from .validation import LIMITS, InputError, frozen_array, refusal, require_array, require_choice

LATEST_ARRIVAL = 1e4  # seconds
ARRIVAL_SIGMA = 3e-4  # one sigma of an arrival unless it is given, metres over the sound speed
ROUNDING = 1e-9  # relative to a wavenumber: an imaginary part this small may have either sign


def sound_speed(value: Any) -> float:
    """Return a positive number, m/s."""
    speed = float(require_array("sound_speed", value, "real", ()).item())
    require_positive("sound_speed", speed, "m/s")
    return speed


def dimension(key: str, value: Any, choices: Iterable[int]) -> int:
    """Return a number of dimensions, one of `choices`."""
    number = int(require_array(key, value, "index", ()).item())
    require_choice(key, number, choices)
    return number


def flag(key: str, value: Any) -> bool:
    """Return what is true or false, as a bool or an array of one."""
    if not isinstance(value, (bool, np.bool_, np.ndarray)) or np.shape(value) != () or np.asarray(value).dtype != bool:
        raise InputError(f"{key} is neither true nor false", "give True or False", key=key)
    return bool(value)


def pressures(values: Any, modes: int, labels: Sequence[str] | np.ndarray | None) -> np.ndarray:
    """Return the pressures : (M, N) complex128; `labels` are the names of the microphones, if there are any."""
    array = np.asarray(values)
    if array.ndim == 2 and array.dtype.kind in "fc":  # the first microphone with NaN is named, unless all have it
        bad = np.flatnonzero(~np.all(np.isfinite(array), axis=0))
        named = np.arange(array.shape[1]) if labels is None else np.asarray(labels)
        if 0 < len(bad) < array.shape[1] and named.shape == array.shape[1:]:
            name = named[int(bad[0])]
            problem = f'pressures of microphone "{name}" are not all finite numbers'
            raise InputError(problem, f"correct them, or leave the microphone out: <exclude> {name}", key="pressures")
    what = "the transform at each of the frequencies, one column a microphone"
    return require_array("pressures", values, "complex", (modes, None), what)


def wavenumbers(values: Any, frequencies: np.ndarray, speed: float) -> np.ndarray:
    """Return the wavenumbers, 2 pi f / c unless given : (M,) complex128, rad/m."""
    given = given_wavenumbers(values, speed)
    array = 2 * np.pi * frequencies / speed if given is None else given
    checked = require_array("wavenumbers", array, "number", (len(frequencies),), "rad/m")
    return remember(checked, speed, given is None)


def names(values: Sequence[str] | np.ndarray | None, count: int) -> tuple[str, ...]:
    """Return the names of the microphones, their numbers unless given."""
    given = [str(n) for n in range(count)] if values is None else values
    found = tuple(require_array("names", given, "text", (None,)).tolist())
    if not len(found) == len(set(found)) == count:
        raise InputError(f"names must be {count} different texts", "give one for each microphone", key="names")
    return found


def spectrum(values: Any, takes: Any) -> np.ndarray:
    """Return frequencies and the mean power, of all takes or of each : (2 or 1 + T, F) float64."""
    rows = (2, 1 + len(np.unique(takes)))
    array = require_array("spectrum", values, "real", (None, None), "Hz and mean power")
    if len(array) not in rows:
        problem, remedy = f"spectrum has {len(array)} rows", f"give frequencies and power: {rows[-1]}, or 2 rows"
        raise InputError(problem, remedy, key="spectrum")
    if array.shape[1] < 2 or np.any(np.diff(array[0]) <= 0) or np.any(array[1:] < 0):
        problem = "spectrum must hold ascending frequencies and powers that are not negative"
        raise InputError(problem, "leave it out", key="spectrum")
    return array


def takes(values: Any, rows: int) -> np.ndarray:
    """Return the take of each row, 0 unless given : (M,) int64. One take stays one where rows are left out."""
    one = values is None or (isinstance(values, np.ndarray) and not np.any(values))
    numbers = require_array("takes", np.zeros(rows, np.int64) if one else values, "index", (rows,))
    if np.any(numbers < 0):
        raise InputError("takes must be counted from 0", "give one number for each row", key="takes")
    return frozen_array(numbers, np.int64)


def arrivals(
    times: Any, sigma: Any, takes: Any, count: int, speed: float
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return the arrivals (T, N), of `count` microphones, and their sigmas (T,), seconds; None and None without any."""
    rows = int(takes.max(initial=0)) + 1
    if times is None:
        if sigma is not None:
            raise InputError("arrival_sigma belongs to arrivals, which are missing", "add them", key="arrival_sigma")
        return None, None
    try:
        array = np.asarray(times)
        missing = np.isnan(array)
        array = np.where(missing, 0.0, array)
        rows = max(rows, len(array))  # a take may have arrivals alone
    except (TypeError, ValueError):  # texts, or rows of different lengths: `require_array` says which
        array, missing = times, np.zeros((rows, count), bool)
    array = require_array("arrivals", array, "real", (rows, count), "s, one row for each take")
    latest = float(np.abs(array).max(initial=0.0))
    if latest > LATEST_ARRIVAL:
        problem = f"an arrival of {latest:.3g} s is too late"
        raise InputError(problem, f"use times within {LATEST_ARRIVAL:g} s of 0", key="arrivals")
    sigma = ARRIVAL_SIGMA / speed if sigma is None else sigma
    if np.ndim(sigma) == 0:
        require_positive("arrival_sigma", np.asarray(sigma).item(), "s")
        sigma = np.full(rows, float(sigma))
    deviation = require_array("arrival_sigma", sigma, "real", (rows,), "s, one for each take")
    if np.any(deviation <= 0):
        raise InputError("arrival_sigma must be above zero", "give one for each take, s", key="arrival_sigma")
    return frozen_array(np.where(missing, np.nan, array), float), deviation


def known(indices: Any, places: Any, truth: np.ndarray | None, count: int, D: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the known microphones (A,), ascending, and their positions (A, D), metres: `places`, else of `truth`."""
    numbers = require_array("known", indices, "index", (None,), "microphones counted from 0")
    listed = numbers.tolist()
    if listed and not (min(listed) >= 0 and max(listed) < count and len(set(listed)) == len(listed)):
        remedy = f"name each microphone of 0 to {count - 1} at most once"
        raise InputError(f"known = {listed} names a microphone twice or one that does not exist", remedy, key="known")
    if len(listed) == count:
        problem = f"known names all {count} microphones, which leaves no microphone to be found"
        raise InputError(problem, "leave some out", key="known", value=listed)
    if places is None:
        if listed and truth is None:
            problem = "known names microphones but known_positions is missing"
            raise InputError(problem, "add it, shape (A, D)", key="known_positions")
        places = np.zeros((0, D)) if truth is None else truth[numbers]
    places = require_array("known_positions", places, "real", (len(listed), D), "m, one row for each of known")
    order = np.argsort(numbers)
    return frozen_array(numbers[order], np.int64), frozen_array(places[order], float)


def require_search_dimension(search: Search | None, D: int) -> None:
    """Raise InputError unless the search domain has as many lengths as a position has coordinates."""
    if search is not None and len(search.size) != D:
        problem = f"search_size has {len(search.size)} lengths and the positions have {D} coordinates"
        raise InputError(problem, f"give {D} lengths", key="search_size", value=search.size)


def require_order(frequencies: np.ndarray, repeated: bool) -> None:
    """Raise InputError unless the frequencies are positive and ascend; `repeated` ones are those of several takes."""
    steps = np.diff(frequencies)
    if np.any(frequencies <= 0) or np.any(steps < 0) or (not repeated and np.any(steps == 0)):
        problem = "frequencies must be above zero and ascending" + ("" if repeated else ", each once")
        remedy = "sort them (and the pressures)" + ("" if repeated else "; of several takes give 'takes', too")
        raise InputError(problem, remedy, key="frequencies")


def require_usable(
    frequencies: Any, values: Any, k: Any, noise_power: Any, labels: tuple[str, ...], speed: float
) -> None:
    """Raise InputError for too few pressures, a wrong sign, or a microphone or mode without pressure."""
    modes, count = values.shape
    if modes == 0 or count < 2:
        problem = f"pressures of shape {values.shape} are too few"
        raise InputError(problem, "give at least one frequency and two microphones", key="pressures")
    # Waves that run backwards, or grow with time.
    wrong = np.flatnonzero((np.real(k) <= 0) | (np.imag(k) > ROUNDING * np.real(k)))
    if len(wrong):
        problem = (
            f"wavenumbers[{wrong[0]}] = {k[wrong[0]]:.6g} rad/m must have a real part above zero and, of a wave that"
            " decays, an imaginary part below it: the time sign is exp(+j w t)"
        )
        remedy = "with the other sign take the conjugate of wavenumbers and pressures"
        raise InputError(problem, remedy, key="wavenumbers", value=k[wrong[0]])
    # Wavenumbers that no wave of these frequencies has at about this speed of sound.
    ratio = np.abs(k) * speed / (2 * np.pi * frequencies)
    wrong = np.flatnonzero((ratio > LIMITS.dispersion) | (ratio < 1 / LIMITS.dispersion))
    if len(wrong):
        m = wrong[0]
        problem = (
            f"wavenumbers[{m}] = {k[m]:.6g} rad/m cannot be that of {frequencies[m]:g} Hz with sound_speed ="
            f" {speed:g} m/s, where 2 pi f / c = {2 * np.pi * frequencies[m] / speed:.6g} rad/m"
        )
        raise InputError(problem, "correct them, or leave them out", key="wavenumbers", value=k[m])
    silent = np.flatnonzero(~np.any(values, axis=0))
    if len(silent):
        name = labels[silent[0]]
        problem = f'microphone "{name}" has zero pressure at every frequency'
        raise InputError(problem, f"leave it out: <exclude> {name}", key="pressures")
    silent = np.flatnonzero(~np.any(values, axis=1))
    if len(silent):
        problem = f"pressures at {frequencies[silent[0]]:g} Hz are zero at every microphone"
        raise InputError(problem, "leave that frequency out", key="pressures")
    if noise_power is not None:
        if np.any(noise_power < 0):
            raise refusal("noise_power", float(noise_power.min()), "is negative", "use 0 for no noise")
        _require_noise_below_signal(values, noise_power, frequencies)


CERTAIN = 6.0  # sigmas: chance does not lower the power of noise alone any further


def _require_noise_below_signal(values: np.ndarray, noise_power: np.ndarray, frequencies: np.ndarray) -> None:
    """Raise InputError where the noise is stronger than all that was measured, which includes it.

    The mean power of n values of noise alone is of a gamma distribution of shape n (Wilson-Hilferty approximation).
    """
    largest = np.maximum(np.abs(values).max(axis=1), np.finfo(float).tiny)
    power = np.mean(np.abs(values / largest[:, None]) ** 2, axis=1)
    noise = np.sqrt(noise_power) / largest  # squared after the division: no unit leaves the range of floats
    with np.errstate(over="ignore"):
        ratio = np.minimum(noise**2 / power, 1e30)
    for m, n in ((int(ratio.argmax()), values.shape[1]), (-1, values.size)):
        lowest = max(0.0, 1 - 1 / (9 * n) - CERTAIN / np.sqrt(9 * n)) ** 3
        ratio_of_all = ratio[m] if m >= 0 else 1 / np.mean(1 / np.maximum(ratio, 1e-30))
        if ratio_of_all * lowest > 1:
            where = f"at {frequencies[m]:g} Hz" if m >= 0 else "on average"
            problem = (
                f"noise_power is {ratio_of_all:.3g} times the power of the pressures {where}, which holds the noise"
            )
            remedy = "give it in the unit of abs(pressures)**2, not in decibels, or leave that frequency out"
            raise InputError(f"{problem} as well", remedy, key="noise_power", value=noise_power[m])


@dataclass(frozen=True)
class WavenumberOrigin:
    """Wavenumbers of a measurement: whether they follow from frequency and sound speed, or were given.

    `dataclasses.replace` hands a measurement the very array that another one holds, so that a change of the sound
    speed alone would leave the wavenumbers, and all positions that follow from them, at the old one.
    """

    array: weakref.ref  # reference to them; dead after the last measurement that holds them
    speed: float  # sound speed of this measurement, m/s
    derived: bool  # whether they are 2 pi f / c


_origins: dict[int, WavenumberOrigin] = {}  # by the id of the array


def remember(array: np.ndarray, speed: float, derived: bool) -> np.ndarray:
    """Remember wavenumbers (M,), rad/m, as long as they live, and return them."""
    key = id(array)
    _origins[key] = WavenumberOrigin(weakref.ref(array, lambda _: _origins.pop(key, None)), speed, derived)
    return array


def given_wavenumbers(values: Any, speed: float):
    """Return the wavenumbers that are given for a measurement, None where they are to follow from the frequencies.

    Those of another measurement count as given only if they were given there, at the same `speed`, m/s.
    """
    origin = _origins.get(id(values))
    if origin is None or origin.array() is not values:
        return values
    if origin.derived:
        return None
    if origin.speed != speed:
        problem = f"sound_speed = {speed:g} m/s, and the wavenumbers belong to a measurement of {origin.speed:g} m/s"
        remedy = "give <wavenumbers>, too: None for 2 pi f / c, those of the new speed, or a copy to keep the old ones"
        raise InputError(problem, remedy, key="wavenumbers", value=speed)
    return values


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
