"""The options that several commands have: their values, and the files that they name.

A `ValueOf` is the type of an option. click puts the name of the option before the message for a wrong value; the
message contains an example of a correct value.
"""

import math
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import click

from ..model.scene import MeasuredScene, load_scene, scene_names
from ..model.settings import SolverSettings
from ..model.validation import LIMITS, InputError, StorageError, declaration
from ..recordings.recording import ImportOptions
from ..session import session_file, sources
from ..solvers import names

MIN_PIXELS, MAX_PIXELS = 64, 8192  # limits for one side of a picture
UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "ms": 1e-3, "s": 1.0}
NUMBER = r"([0-9.]+(?:e-?[0-9]+)?)"


@dataclass(frozen=True)
class ValueOf(click.ParamType):
    """The type of an option."""

    read: Callable[[str], Any]  # parses a text; raises ValueError if it cannot
    words: str  # the end of the message for a text that `read` cannot parse
    name = "value"

    def convert(self, value, param, ctx) -> Any:
        try:
            return value if not isinstance(value, str) else self.read(value)  # a default is not parsed
        except ValueError:
            self.fail(f'"{value}" {self.words}', param, ctx)


def _matched(pattern: str, value: str, flags: int = 0) -> Sequence[str]:
    """Return the groups of the pattern; raise ValueError if it does not match the whole text."""
    match = re.fullmatch(pattern, value.strip(), flags)
    if match is None:
        raise ValueError
    return match.groups()


def _quantity(value: str, units: str, low: float = 0.0) -> float:
    """Return a quantity: a length in metres, a time in seconds, or a number with another of the `units`.

    Raises ValueError for any other unit, or for a value below `low`.
    """
    number, unit = _matched(rf"{NUMBER}\s*({units})", value)
    if not low <= (found := float(number) * UNITS.get(unit, 1.0)) < math.inf:
        raise ValueError
    return found


def _names(value: str) -> tuple[str, ...]:
    parts = tuple(part.strip() for part in value.split(","))
    if not all(parts):
        raise ValueError
    return parts


def _distance(value: str) -> tuple[str, str, float]:
    first, second, metres = _names(value)
    return first, second, float(metres)


def _separated(
    value: str, separator: str, kind: type, low: float = -math.inf, high: float = math.inf, counts: Sequence[int] = ()
) -> tuple[Any, ...]:
    """Return the numbers in a text.

    Raises ValueError unless all are from `low` to `high`, and their count is one of `counts`, if any are given.
    """
    found = tuple(kind(part) for part in value.lower().split(separator))
    if not all(low <= number <= high for number in found) or (counts and len(found) not in counts):
        raise ValueError
    return found


microphone_names = ValueOf(_names, "is not a list of microphones; separate them by commas, for example 3,17")
distance = ValueOf(_distance, "must be two microphones and metres, for example 0,5,1.25")
room_size = ValueOf(
    lambda value: _separated(value, "x", float, LIMITS.smallest, LIMITS.largest, (2, 3)),
    "is not the size of a room; write lengths above zero, in metres, for example 6x5 or 6x5x2.7",
)
picture_size = ValueOf(
    lambda value: _separated(value, "x", int, MIN_PIXELS, MAX_PIXELS, (2,)),
    f"is not a picture size; write WIDTHxHEIGHT, for example 1280x800, each from {MIN_PIXELS} to {MAX_PIXELS}",
)
gain_sigma = ValueOf(  # dB and degrees
    lambda value: tuple(map(float, _matched(rf"{NUMBER}\s*dB\s*,\s*{NUMBER}\s*deg", value, re.IGNORECASE))),
    "must be decibels and degrees with their units, for example 1dB,5deg",
)
length = ValueOf(lambda text: _quantity(text, "mm|cm|m"), "must be a length with its unit, for example 5mm")
band = ValueOf(
    lambda value: _separated(value, ":", float, counts=(2,)), "is not a band; write LO:HI in hertz, for example 20:300"
)
duration = ValueOf(
    lambda value: _quantity(value, "ms|s", LIMITS.smallest), "must be a time with its unit, for example 10s"
)
source_number = ValueOf(
    lambda value: value if value == "all" else int(value), "is not a source; write a whole number from 0, or all"
)
decibels = ValueOf(lambda value: _quantity(value, "(?i:dB)"), "must be decibels with their unit, for example 1dB")
percentage = ValueOf(lambda value: _quantity(value, "%") / 100, "must be a percentage with its sign, for example 0.3%")


def output_path(text: str, suffix: str | Sequence[str], force: bool, *inputs: str | None, flag: str = "-o") -> Path:
    """Return the path of the option `flag`; commands check it before they begin work that may take long.

    `suffix`: allowed suffixes, in lower case; `inputs`: files that must not be overwritten, even with `force`.
    """
    path = Path(text)
    allowed = [suffix] if isinstance(suffix, str) else suffix
    if path.suffix.lower() not in allowed:
        raise InputError(f'{flag} "{text}" must end in {" or ".join(allowed)}', f"write NAME{allowed[0]}", key="output")
    if path.is_dir():
        raise InputError(f"{flag} {text} is a folder", "name a file", key="output")
    if not path.parent.is_dir():
        raise StorageError(f"{flag} {text} lies in a folder that does not exist; make it first: mkdir -p {path.parent}")
    for source in map(Path, filter(None, inputs)):
        linked = source.exists() and path.exists() and source.samefile(path)  # true for hard links, too
        if linked or os.path.realpath(source) == os.path.realpath(path):
            raise InputError(f"{flag} {text} is the input itself", "choose another name, to keep it", key="output")
    if path.exists() and not force:
        raise InputError(f"{flag} {text} exists", "add <force> to overwrite it, or choose another name", key="output")
    return path


# Names of the options for the arguments that the remedy of an error mentions (`InputError.worded`).
NAMED_ALIKE = (
    "array_dimension channels device exclude force frame frequencies gains kind known known_sigma leave_out microphone "
    "modes noise port positions rate reference room seconds solver sound_speed sound_speed_sigma source split start "
    "subset table temperature"
)
OPTIONS = {
    "array_radius": "--array-radius R",
    "distance": "--distance I,J,METRES",
    "files": "--channels",
    "gain_sigma_db": "--gain-sigma",
    "output": "-o",
    "phase_sigma_deg": "--gain-sigma",
    "replay": "--replay FILE",
    "result": "--result RESULT.json",
    "time_limit": "--time-limit SECONDS",
}
OPTIONS |= {key: f"--{key.replace('_', '-')}" for key in NAMED_ALIKE.split()}


BAR = "{desc} {percentage:3.0f} % |{bar:30}| {elapsed}, {remaining} to go{postfix}"


def rewrites_lines() -> bool:
    """Return whether standard error is a terminal on which a line of progress can replace the previous one."""
    return sys.stderr.isatty() and os.environ.get("TERM") != "dumb"


@contextmanager
def progress_bar(title: str) -> Iterator[sources.ProgressReport]:
    """Yield a function that shows progress in a bar on standard error; the bar appears with the first call.

    While the fraction done is 0, the bar shows only the elapsed time. Nothing is written unless standard error is a
    terminal on which a line can be rewritten.
    """
    from tqdm import tqdm

    bars: list[tqdm] = []

    def progress(done: float, note: str = "") -> None:
        if not bars:
            bars.append(tqdm(total=1.0, desc=title, mininterval=0.2, file=sys.stderr, disable=not rewrites_lines()))
        bars[0].bar_format = BAR if done else "{desc} {elapsed}{postfix}"
        bars[0].set_postfix_str(note, refresh=False)
        if done < bars[0].n:  # a new run or a restart; `update` alone would show nothing for a long time
            bars[0].n = bars[0].last_print_n = done
            bars[0].refresh()
        bars[0].update(done - bars[0].n)

    try:
        yield progress
    finally:
        for bar in bars:
            bar.close()


def option(name: str, *texts: str, type: Any = None, **more: Any):
    """Return an option of click.

    `name`: the option and its placeholder, for example "--snr DB"; `texts`: the name of the function's argument, if it
    differs from the option's, and the help; `type`: a type of click, or a list of the choices.
    """
    (name, _, metavar), (*argument, text) = name.partition(" "), texts
    kind = click.Choice(type) if isinstance(type, (list, tuple)) else type
    shown = more.get("default") not in (None, ())
    return click.option(name, *argument, type=kind, metavar=metavar or None, help=text, show_default=shown, **more)


def output_option(what: str, required: bool = True):
    """Return the option -o of a command that writes `what`."""
    text = "Folder to write." if what == "FOLDER" else "File to write."
    return click.option("-o", "--output", required=required, metavar=what, help=text)


force_option = click.option("--force", is_flag=True, help="Overwrite an existing output file.")
result_option = option("--result RESULT.json", "Positions found by `fdcal calibrate -o`.")
modes_option = option("--modes M", "Use only the M lowest frequencies.  [default: all usable ones]", type=int)
seed_option = option("--seed S", "Random seed of the solver's start.  [default: the scene's]", type=int)
solver_option = option("--solver", "joint: for equal channels; descent: the paper's method.  [default: the scene's]",
                       type=names())  # fmt: skip


KNOWN = ("all", "minimal", "none")  # microphones whose positions a solver is given


def declared_options(record: type, names: Sequence[str] = (), **types: Any) -> Callable[[Any], Any]:
    """Return a decorator that adds the options that the fields of a dataclass declare: all, or those in `names`.

    `types`: type of an option by the name of its field, where the declared type cannot parse the text.
    """

    def add(command):
        for field in reversed([one for one in fields(record) if "help" in one.metadata]):
            if names and field.name not in names:
                continue
            kind, number = declaration(record, field.name)[0], None
            if get_origin(kind) is Literal:
                choices = get_args(kind)
                number = int if isinstance(choices[0], int) else None
                kind = click.Choice([str(one) for one in choices])
            fixed = field.default is not None and record is ImportOptions  # else the scene gives the default
            default = f"  [default: {field.default}]" if fixed else ""
            command = click.option(
                f"--{field.name.replace('_', '-')}",
                type=types.get(field.name, kind),
                metavar=field.metadata["metavar"],
                callback=lambda _, __, value, number=number: number(value) if number and value else value,
                help=field.metadata["help"] + default,
            )(command)
        return command

    return add


solver_options = declared_options(SolverSettings, known=str, known_sigma=length, sound_speed_sigma=percentage)


# The options of recordings that `calibrate` and `doctor` have; `import` has all.
RECORDED = ("frequencies", "kind", "reference", "temperature", "rate", "array_dimension", "array_radius")


def recording_options(*names: str) -> Callable[[Any], Any]:
    """Return a decorator that adds the options of `ImportOptions`, all or those in `names`, and those of files."""

    def add(command):
        command = declared_options(ImportOptions, names)(command)
        for one in reversed((
            click.option("--takes", "files", flag_value="takes", help="Each of several files is one take."),
            click.option("--channels", "files", flag_value="channels", help="The files are channels of one take."),
            option("--split TIME", "Cut a long recording into takes of this length, e.g. 10s.", type=duration),
            option("--source I|all", "Number of the source, from 0; all: a take for each source.", type=source_number),
        )):  # fmt: skip
            command = one(command)
        return command

    return add


def import_options(files: Sequence[str], recorded: Mapping[str, Any]) -> ImportOptions | None:
    """Return the options of recordings, or None if none is given; otherwise all `files` must be recordings."""
    given = {key: value for key, value in recorded.items() if value is not None}
    if not given:
        return None
    other = next((one for one in files if not sources.is_recording(one)), None)
    if other is not None:
        key, imported = next(iter(given)), "give it to the import: fdcal import INPUT -o FILE.npz --known FILE.csv"
        remedy = f"use <known> {', '.join(KNOWN)}, or {imported}" if key == "known" else f"leave out <{key}>"
        raise InputError(f"{other} holds no recordings", remedy, key=key)
    return ImportOptions(**given)


def scene_of(text: str) -> sources.CalibrationInput:
    """Return the simulated measurement of a scene; raise InputError for a measurement."""
    inputs = None if text.lower().endswith(".npz") else input_of(text)
    if inputs is None or inputs.scene is None:
        names = ", ".join(name for name in scene_names() if not isinstance(load_scene(name), MeasuredScene))
        raise InputError(f"{text} is a measurement", f"give a scene: a .toml file or one of {names}", key="scene")
    return inputs


def input_of(
    source: str | Sequence[str], /, excluded: tuple[str, ...] = (), positions: str | None = None, **recorded: Any
) -> sources.CalibrationInput:
    """Return the measurement of a scene or of files, with the values of the options.

    `positions`: file with positions to compare with; `recorded`: fields of `ImportOptions`, None for those not given.
    """
    first = source if isinstance(source, str) else source[0]
    options = import_options([source] if isinstance(source, str) else source, recorded)
    with progress_bar("simulating" if options is None and not sources.is_recording(first) else "importing") as progress:
        inputs = sources.load_input(source, progress, excluded, options)
    return inputs if positions is None else sources.compared_with_file(inputs, positions)


def open_request_of(text: str) -> sources.OpenRequest:
    """Return the request for a page that shows a saved session, a measurement or recordings, or a scene."""
    if text.lower().endswith(".zip"):
        return session_file.read(text)
    shipped = text in scene_names()
    if not shipped and (text.lower().endswith(".npz") or sources.is_recording(text)):
        return sources.measurement_request(sources.load_input(text))
    scene = load_scene(text)
    if not shipped:
        sources.check_scene(scene)  # reports a scene that cannot be simulated before a page opens
    return sources.scene_request(scene)
