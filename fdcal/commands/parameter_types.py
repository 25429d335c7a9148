"""Command-line values: lists, sizes, lengths with a unit and distances, each refused with an example of a right one.

A function here is the `type` of an option: click calls it with the text, and names the option before the message.
"""

import math
import re
from dataclasses import replace
from typing import NoReturn

import click

from ..model.settings import KNOWN_ROOM_SOLVERS, Search
from ..model.validation import LIMITS, InputError

MIN_PIXELS, MAX_PIXELS = 64, 8192  # of one side of a picture
UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "ms": 1e-3, "s": 1.0}
NUMBER = r"([0-9.]+(?:e-?[0-9]+)?)"


def refuse(message: str) -> NoReturn:
    """Raise the error of click for a value; it adds which option the value belongs to."""
    raise click.BadParameter(message)


def whole_numbers(value: str) -> list[int]:
    """Whole numbers with commas between, such as "1,5,9"."""
    return _numbers(value, int, "whole numbers")


def numbers(value: str) -> list[float]:
    """Numbers with commas between, such as "1.5,2,9"."""
    return _numbers(value, float, "numbers")


def _numbers(value: str, kind: type, words: str) -> list:
    try:
        return [kind(part) for part in value.split(",")]
    except ValueError:
        refuse(f'"{value}" is no list of {words}; write them with commas between, as 1,5,9')


def microphone_names(value: str | tuple[str, ...]) -> tuple[str, ...]:
    """Names with commas between, such as "3,17"; the default of an option is the tuple already."""
    if isinstance(value, tuple):
        return value
    parts = tuple(part.strip() for part in value.split(","))
    if not all(parts):
        refuse(f'"{value}" is no list of microphones; write them with commas between, as 3,17')
    return parts


def distance(value: str) -> tuple[str, str, float]:
    """Two microphones, by name or number, and metres, such as "0,5,1.25"."""
    try:
        first, second, metres = (part.strip() for part in value.split(","))
        if not (first and second):
            raise ValueError
        return first, second, float(metres)
    except ValueError:
        refuse(f'"{value}" must be two microphones and metres, as 0,5,1.25')


def room_size(value: str) -> tuple[float, ...]:
    """Lengths of a rectangular room, metres, such as "6x5" or "6x5x2.7"."""
    try:
        size = tuple(float(part) for part in value.lower().split("x"))
    except ValueError:
        size = ()
    if len(size) not in (2, 3):
        refuse(f'"{value}" is no size of a room; write LENGTHxWIDTH or LENGTHxWIDTHxHEIGHT, as 6x5x2.7')
    for length in size:
        if not LIMITS.smallest <= length <= LIMITS.largest:
            refuse(f"{length:g} m must be finite and above zero")
    return size


def picture_size(value: str) -> tuple[int, int]:
    """Width and height of a picture in pixels, such as "1280x800"."""
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", value)
    width, height = (int(match[1]), int(match[2])) if match else (0, 0)
    if not (MIN_PIXELS <= width <= MAX_PIXELS and MIN_PIXELS <= height <= MAX_PIXELS):
        refuse(f'"{value}" is no picture size; write WIDTHxHEIGHT, as 1280x800, {MIN_PIXELS} to {MAX_PIXELS} each')
    return width, height


def slice_plane(value: str) -> tuple[str, float | None]:
    """A plane through a volume: an axis, "x=1.5" for its place in metres, too, or "none"."""
    axis, equals, place = value.partition("=")
    try:
        position = float(place) if equals else None
    except ValueError:
        position = math.nan
    if axis not in ("x", "y", "z", "none") or (axis == "none" and equals) or not math.isfinite(position or 0.0):
        refuse(f'"{value}" is no slice; write x, y, z, x=1.5 for a place in metres, or none')
    return axis, position


def noise_level(value: str) -> str:
    """A signal-to-noise ratio in decibels, "auto" or "reported"; "told" is an old spelling of "reported"."""
    value = "reported" if value == "told" else value
    if value in ("auto", "reported"):
        return value
    try:
        decibels = float(value)
    except ValueError:
        decibels = math.nan
    if not abs(decibels) <= LIMITS.decibels:
        refuse(
            f'"{value}" is unknown; use "auto", "reported" or a number of decibels from -{LIMITS.decibels:g} to'
            f" {LIMITS.decibels:g}"
        )
    return value


def gain_sigma(value: str) -> tuple[float, float]:
    """One sigma of the channels' gains, dB, and phases, degrees, such as "1dB,5deg"."""
    match = re.fullmatch(rf"{NUMBER}\s*dB\s*,\s*{NUMBER}\s*deg", value.strip(), re.IGNORECASE)
    try:
        if match is None:
            raise ValueError
        return float(match[1]), float(match[2])
    except ValueError:
        refuse(f'"{value}" must be decibels and degrees with their units, as 1dB,5deg')


def length(value: str) -> float:
    """A length with its unit, such as "5mm"; metres."""
    return _with_unit(value, rf"{NUMBER}\s*(mm|cm|m)", "a length with its unit, mm, cm or m, as 5mm")


def duration(value: str) -> float:
    """A time with its unit, such as "10s" or "500ms"; seconds."""
    words = "a time with its unit, s or ms, as 10s"
    seconds = _with_unit(value, rf"{NUMBER}\s*(ms|s)", words)
    if not 0 < seconds < math.inf:
        refuse(f'"{value}" must be {words}')
    return seconds


def source_number(value: str) -> int | str:
    """The number of a source, from 0, or "all"."""
    try:
        return value if value == "all" else int(value)
    except ValueError:
        refuse(f'"{value}" is no number of a source; write one from 0, or all')


def decibels(value: str) -> float:
    """A number of decibels with its unit, such as "1dB"."""
    return _with_unit(value, rf"{NUMBER}\s*(?i:(dB))", "decibels with their unit, as 1dB")


def percentage(value: str) -> float:
    """A part of something with its sign, such as "0.3%"; 0.003."""
    return _with_unit(value, rf"{NUMBER}\s*(%)", "a number of percent with its sign, as 0.3%") / 100


def _with_unit(value: str, pattern: str, words: str) -> float:
    """Return the number of a text, times its unit where it has one; metres or seconds."""
    match = re.fullmatch(pattern, value.strip())
    try:
        if match is None:
            raise ValueError
        return float(match[1]) * UNITS.get(match[2], 1.0)
    except ValueError:
        refuse(f'"{value}" must be {words}')


class Number(click.types.FloatParamType):
    """A finite number: the type of every option of one number."""

    def convert(self, value, param, ctx) -> float:
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f'"{value}" is no finite number', param, ctx)
        return number


class NumberInRange(click.FloatRange, Number):
    """A finite number within bounds."""


class RecordingKind(click.Choice):
    """What a recording is; the words of older versions are accepted and not listed."""

    def convert(self, value, param, ctx):
        return super().convert({"response": "impulse", "work": "stationary"}.get(value, value), param, ctx)


class RoomOrScene(click.ParamType):
    """Lengths of a rectangular room, metres, as 7x6x2.7, or a scene whose room is a rectangle.

    A class, since click takes an `InputError` of a function for its own.
    """

    name = "room"

    def convert(self, value, param, ctx) -> tuple[float, ...]:
        if value[:1].isdigit():
            return room_size(value)
        from ..model.scene_file import MeasuredScene, load_scene

        scene = load_scene(value)
        size = scene.room.size
        if size is None or isinstance(scene, MeasuredScene):
            self.fail(f"the room of {value} is unknown or no rectangle; give its lengths, as 7x6x2.7", param, ctx)
        return tuple(size)


class KnownChoice(click.Choice):
    """Which known microphones to use; names or a file are for recordings, which an error says."""

    def convert(self, value, param, ctx):
        if value not in self.choices and (ctx is None or ctx.info_name != "calibrate"):
            self.refuse(value, param, ctx)
        return value  # of calibrate names, corners or a table, too, which `refuse` refuses but for recordings

    def refuse(self, value, param, ctx):
        """Raise the error of a value that is for recordings alone."""
        where = "known positions are given at the import: fdcal import INPUT -o FILE.npz --known FILE.csv"
        self.fail(f"{value!r} is not one of {', '.join(map(repr, self.choices))}; {where}", param, ctx)


def search_domain(
    own: Search | None, dimension: int, search: list[float] | None, radius: float | None
) -> Search | None:
    """Return the search domain of --search and --radius; what is not given is that of the measurement, its `own`."""
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
