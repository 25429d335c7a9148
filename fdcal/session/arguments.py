"""Arguments of the Python API, checked: each function returns the value as the rest of fdcal takes it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from ..model.measurement import Measurement
from ..model.settings import SolverSettings
from ..model.validation import InputError, require_integer, require_number, shown_literal


def microphone_names(key: str, values: Any) -> tuple[str, ...]:
    """Return names or numbers of microphones as texts; one alone is no list of them."""
    if isinstance(values, (str, bytes)) or not isinstance(values, Iterable):
        remedy = f"put names or numbers into a list: <{key}> = [{shown_literal(values)}]"
        raise InputError(f"{key} = {shown_literal(values)} is no list of microphones", remedy, key=key, value=values)
    return tuple(str(one) for one in values)


def known_microphones(known: Any) -> Any:
    """Return known microphones that are not named by a word: a mapping, or a tuple of texts."""
    return known if isinstance(known, Mapping) else microphone_names("known", known)


def lengths(key: str, values: Any) -> tuple[float, ...]:
    """Return lengths, metres, whose number and sign others check."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        problem = f"{key} = {shown_literal(values)} is no list of lengths"
        raise InputError(problem, f"write <{key}> = (7.0, 6.0), metres", key=key, value=values)
    listed = list(values)
    for value in listed:
        require_number(key, value)
    return tuple(map(float, listed))


def mode_numbers(modes: Any, count: int) -> list[int]:
    """Return numbers of modes, counted from 1, of `count`."""
    if isinstance(modes, str) or not isinstance(modes, Iterable):
        problem = f"modes = {shown_literal(modes)} is no list of modes"
        raise InputError(problem, "write <modes> = [1, 5, 9]", key="modes", value=modes)
    listed = list(modes)
    for mode in listed:
        require_integer("modes", mode, 1)
        if mode > count:
            raise InputError(f"mode {mode} does not exist", f"give <modes> from 1 to {count}", key="modes", value=mode)
    return [int(mode) for mode in listed]


def known_distance(values: Any) -> tuple[str, str, float] | None:
    """Return two microphones and how far they are apart, metres."""
    if values is None:
        return None
    parts = [] if isinstance(values, str) or not isinstance(values, Iterable) else list(values)
    if len(parts) != 3:
        problem = f"distance = {shown_literal(values)} is not two microphones and a length"
        raise InputError(problem, "write <distance> = (0, 1, 0.25), metres", key="distance", value=values)
    require_number("distance", parts[2])
    return str(parts[0]), str(parts[1]), float(parts[2])


def require_measurement(measurement: Any, function: str) -> None:
    """Raise InputError unless `measurement` is one; a function of that name takes it."""
    if not isinstance(measurement, Measurement):
        problem = f"{function} takes a measurement, not {type(measurement).__name__}"
        raise InputError(problem, f"load it first: fdcal.{function}(fdcal.load(...))", key="measurement")


def require_settings(settings: Any) -> None:
    """Raise InputError unless `settings` are those of a solver, or None."""
    if settings is not None and not isinstance(settings, SolverSettings):
        problem = f"settings = {shown_literal(settings)} are not those of a solver"
        raise InputError(problem, "give those of a scene: fdcal.load_scene(...).solver", key="settings", value=settings)


def require_truth_value(key: str, value: Any) -> None:
    """Raise InputError unless `value` is True or False."""
    if not isinstance(value, bool):
        raise InputError(f"{key} = {shown_literal(value)} is not True or False", "use one of them", key=key)


def require_callable(key: str, value: Callable | None) -> None:
    """Raise InputError unless `value` can be called, or is None."""
    if value is not None and not callable(value):
        raise InputError(f"{key} = {shown_literal(value)} cannot be called", "give a function", key=key, value=value)
