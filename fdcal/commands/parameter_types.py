"""Types of command-line values: lists, sizes, distances and choices, each refused with an example of a right one."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import click

from ..model.limits import LIMITS
from ..model.settings import KNOWN_ROOM_SOLVERS, Search
from ..model.validation import InputError

MIN_PIXELS, MAX_PIXELS = 64, 8192  # of one side of a picture


class RenamedChoice(click.Choice):
    """One of several words; old spellings of some are accepted and not listed.

    Parameters
    ----------
    choices : sequence of str
    old : mapping of str to str
        Old spelling to present one.
    """

    def __init__(self, choices: Sequence[str], old: Mapping[str, str]):
        super().__init__(choices)
        self.old = old

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return super().convert(self.old.get(value, value), param, ctx)


class KnownChoice(click.Choice):
    """Which known microphones to use; names or a file are for the import, which an error says."""

    def __init__(self):
        super().__init__(["all", "minimal", "none"])

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value not in self.choices:
            where = "known positions are given at the import: fdcal import INPUT -o FILE.npz --known FILE.csv"
            self.fail(f"{value!r} is not one of {', '.join(map(repr, self.choices))}; {where}", param, ctx)
        return value


class NumberList(click.ParamType):
    """Numbers with commas between, such as "1,5,9"; `kind` is int or float."""

    name = "numbers"

    def __init__(self, kind: type):
        self.kind = kind

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> list:
        if isinstance(value, list):
            return value
        try:
            return [self.kind(part) for part in value.split(",")]
        except ValueError:
            words = "whole numbers" if self.kind is int else "numbers"
            self.fail(f'"{value}" is no list of {words}; write them with commas between, as 1,5,9', param, ctx)


class NameList(click.ParamType):
    """Names with commas between, such as "3,17"."""

    name = "names"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        if isinstance(value, tuple):
            return value
        parts = tuple(part.strip() for part in value.split(","))
        if not all(parts):
            self.fail(f'"{value}" is no list of microphones; write them with commas between, as 3,17', param, ctx)
        return parts


class Distance(click.ParamType):
    """Two microphones, by name or number, and metres, such as "0,5,1.25"."""

    name = "distance"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, str, float]:
        if isinstance(value, tuple):
            return value
        parts = [part.strip() for part in value.split(",")]
        try:
            first, second, metres = parts
            if not (first and second):
                raise ValueError
            return first, second, float(metres)
        except ValueError:
            self.fail(f'"{value}" must be two microphones and metres, as 0,5,1.25', param, ctx)


class RoomSize(click.ParamType):
    """Lengths of a rectangular room, metres, such as "6x5" or "6x5x2.7"."""

    name = "room"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        if isinstance(value, tuple):
            return value
        try:
            size = tuple(float(part) for part in value.lower().split("x"))
        except ValueError:
            size = ()
        if len(size) not in (2, 3):
            self.fail(
                f'"{value}" is no size of a room; write LENGTHxWIDTH or LENGTHxWIDTHxHEIGHT, as 6x5x2.7', param, ctx
            )
        for length in size:
            if not LIMITS.smallest <= length <= LIMITS.largest:
                self.fail(f"{length:g} m must be finite and above zero", param, ctx)
        return size


class PictureSize(click.ParamType):
    """Width and height of a picture in pixels, such as "1280x800"."""

    name = "pixels"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        if isinstance(value, tuple):
            return value
        match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", value)
        width, height = (int(match[1]), int(match[2])) if match else (0, 0)
        if not (MIN_PIXELS <= width <= MAX_PIXELS and MIN_PIXELS <= height <= MAX_PIXELS):
            self.fail(
                f'"{value}" is no picture size; write WIDTHxHEIGHT, as 1280x800, {MIN_PIXELS} to {MAX_PIXELS} each',
                param,
                ctx,
            )
        return width, height


class SlicePlane(click.ParamType):
    """A plane through a volume: an axis, "x=1.5" for its place in metres, too, or "none"."""

    name = "slice"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None):
        if isinstance(value, tuple):
            return value
        axis, equals, place = value.partition("=")
        try:
            position = float(place) if equals else None
        except ValueError:
            position = math.nan
        if axis not in ("x", "y", "z", "none") or (axis == "none" and equals) or not math.isfinite(position or 0.0):
            self.fail(f'"{value}" is no slice; write x, y, z, x=1.5 for a place in metres, or none', param, ctx)
        return axis, position


class NoiseLevel(click.ParamType):
    """A signal-to-noise ratio in decibels, "auto" or "reported"; "told" is an old spelling of "reported"."""

    name = "noise"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        value = "reported" if value == "told" else value
        if value in ("auto", "reported"):
            return value
        try:
            decibels = float(value)
        except ValueError:
            decibels = math.nan
        if not abs(decibels) <= LIMITS.decibels:
            self.fail(
                f'"{value}" is unknown; use "auto", "reported" or a number of decibels from -{LIMITS.decibels:g} to'
                f" {LIMITS.decibels:g}",
                param,
                ctx,
            )
        return value


def search_domain(
    own: Search | None, dimension: int, search: list[float] | None, radius: float | None
) -> Search | None:
    """Return the search domain of --search and --radius; what is not given is that of the measurement.

    Parameters
    ----------
    own : Search or None
        Of the measurement.
    dimension : int
        2 or 3, of the array.
    search : list of float or None
        Origin, size and step, metres.
    radius : float or None
        R of Eq. 3, metres.

    Raises
    ------
    InputError
        A part is given neither here nor in the measurement, or `search` has a wrong number of values.
    """
    if search is None and radius is None:
        return own
    if own is None and (search is None or radius is None):
        raise InputError("the measurement has no search domain", "give both <search> and <radius>", key="search")
    if own is not None:
        radius = own.radius if radius is None else radius
        if search is None:
            return replace(own, radius=radius)
    if search is None or radius is None:
        return None
    if len(search) != 2 * dimension + 1:
        layout = ",".join([*"xyz"[:dimension], *("width", "height", "depth")[:dimension], "step"])
        text = ",".join(f"{value:g}" for value in search)
        remedy = f"give {2 * dimension + 1} metres: {layout}"
        raise InputError(f"--search {text} has {len(search)} numbers", remedy, key="search", value=search)
    return Search(tuple(search[:dimension]), tuple(search[dimension:-1]), search[-1], radius)


def room_solver(size: tuple[float, ...] | None, solver: str | None) -> str | None:
    """Return the solver for a room of known size; `solver` without one. Raises InputError for another solver."""
    if size is None:
        return solver
    if solver not in (None, *KNOWN_ROOM_SOLVERS):
        raise InputError("--room is for --solver room", f"leave out --solver {solver}", key="solver", value=solver)
    return KNOWN_ROOM_SOLVERS[0]


def mode_numbers(modes: list[int] | None, measured: int) -> list[int]:
    """Return modes counted from 1, each once, ascending; 1, 5 and 9 unless given."""
    if modes is None:
        return [m for m in (1, 5, 9) if m <= measured]
    for mode in modes:
        if not 1 <= mode <= measured:
            remedy = f"the measurement has 1 to {measured}"
            raise InputError(f"--mode-numbers names mode {mode}", remedy, key="mode_numbers", value=mode)
    return sorted(set(modes))


def microphone_number(number: int, count: int) -> int:
    """Return the number of a microphone, counted from 0; InputError if there is none."""
    if not 0 <= number < count:
        remedy = f"the array has microphones 0 to {count - 1}"
        raise InputError(f"--microphone {number} does not exist", remedy, key="microphone", value=number)
    return number
