"""The options that commands share, and what they stand for: where to write, what to read, how to solve."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

import click

from ..model.declared import declaration
from ..model.settings import SolverSettings
from ..model.validation import InputError, StorageError
from ..solvers import names
from . import parameter_types as types

if TYPE_CHECKING:
    from ..assessment.calibration import Calibration
    from ..session.sources import CalibrationInput, OpenRequest, Progress


def output_path(text: str, suffix: str | Sequence[str], force: bool, *inputs: str | None) -> Path:
    """Return the path of the option -o, checked before the work begins, which may take long.

    `suffix`: those allowed, in lower case; `inputs`: files that must not be overwritten, even by `force`.
    """
    path = Path(text)
    allowed = [suffix] if isinstance(suffix, str) else suffix
    if path.suffix.lower() not in allowed:
        problem = f'-o "{text}" must end in {" or ".join(allowed)}'
        raise InputError(problem, f"write {path.stem or 'result'}{allowed[0]}", key="output", value=text)
    if path.is_dir():
        raise InputError(f"-o {text} is a folder", "name a file", key="output", value=text)
    if not path.parent.is_dir():
        raise StorageError(f"-o {text} lies in a folder that does not exist; make it first: mkdir -p {path.parent}")
    for source in map(Path, filter(None, inputs)):
        linked = source.exists() and path.exists() and source.samefile(path)  # as hard links are
        if linked or source.resolve() == path.resolve():
            problem = f"-o {text} is the input itself, which is never overwritten"
            raise InputError(problem, "choose another name", key="output", value=text)
    if path.exists() and not force:
        remedy = "add <force> to overwrite it, or choose another name"
        raise InputError(f"-o {text} exists", remedy, key="output", value=text)
    return path


SESSIONS = (".zip", ".json")


def option_name(key: str) -> str:
    """Return what the command line calls an argument that has no other name there."""
    return f"--{key.replace('_', '-')}"


# The settings of a solver that are options of `fdcal calibrate`, and what their declarations say.
SOLVER_OPTIONS = {
    field.name: declared
    for field in fields(SolverSettings)
    if "help" in (declared := declaration(SolverSettings, field.name)[1])
}

# How the command line calls the arguments that an error's remedy mentions (`InputError.worded`).
NAMED_ALIKE = (
    "array_dimension check device dimension takes estimate_sound_speed exclude force frame frequencies host kind known "
    "channels known_sigma leave_out microphone modes most original plane port positions reference reference_microphone "
    "rate resume room seconds seed solver sound_speed source split step subset table temperature window workers "
)
OPTIONS = {
    "array": "--array FILE.csv",
    "array_radius": "--array-radius R",
    "at": "--at KEY=VALUE",
    "axes": "--axes Y,X",
    "distance": "--distance I,J,METRES",
    "files": "--channels",
    "gain_sigma_db": "--gain-sigma",
    "output": "-o",
    "phase_sigma_deg": "--gain-sigma",
    "radius": "--radius R",
    "replay": "--replay FILE",
    "report": "--report FOLDER",
    "result": "--result RESULT.json",
    "scheduler": "--scheduler tcp://HOST:8786",
    "search": "--search ORIGIN,SIZE,STEP",
    "size": "--size WxH",
    "snr": "--snr DB",
    "time_limit": "--time-limit SECONDS",
}
OPTIONS |= {key: option_name(key) for key in (*NAMED_ALIKE.split(), *SOLVER_OPTIONS)}


@contextmanager
def progress_bar(title: str) -> Iterator[Progress]:
    """Give a function that shows a bar on standard error; it appears with the first call."""
    from tqdm import tqdm

    bars: list[tqdm] = []

    def progress(done: float, note: str = "") -> None:
        if not bars:
            layout = "{desc} {percentage:3.0f} % |{bar:30}| {elapsed}, {remaining} to go{postfix}"
            bars.append(tqdm(total=1.0, desc=title, bar_format=layout, mininterval=0.2, file=sys.stderr))
        bars[0].set_postfix_str(note, refresh=False)
        bars[0].update(done - bars[0].n)

    try:
        yield progress
    finally:
        for bar in bars:
            bar.close()


def output_option(what: str, required: bool = True):
    """Return the option -o of a command that writes `what`."""
    return click.option(
        "-o",
        "--output",
        required=required,
        metavar=what,
        help="Folder to write." if what == "FOLDER" else "File to write.",
    )


force_option = click.option("--force", is_flag=True, help="Overwrite an existing output file.")
basins_option = click.option(
    "--basins",
    is_flag=True,
    help="Colour the basins of attraction instead of the cost: at which minimum descent from each place ends.",
)
result_option = click.option("--result", metavar="RESULT.json", help="Positions found by `fdcal calibrate -o`.")
modes_option = click.option(
    "--modes",
    type=int,
    metavar="M",
    help="Number of modes in use at the end, lowest first.  [default: all that the array can interpolate]",
)
seed_option = click.option(
    "--seed", type=int, metavar="S", help="Random seed of the solver's start.  [default: the scene's]"
)
solver_option = click.option(
    "--solver",
    type=click.Choice(names()),
    help="robust, joint, descent (the paper's), descent+joint or room.  [default: the scene's]",
)
search_option = click.option(
    "--search",
    type=types.numbers,
    metavar="ORIGIN,SIZE,STEP",
    help="Search domain, five numbers in metres: x,y of its lowest corner, width,height, step."
    " For example 2.01,1.71,1.2,1.2,0.01",
)
radius_option = click.option(
    "--radius", type=types.Number(), metavar="R", help="Radius R of the order rule ceil(k R), metres."
)


KNOWN = ("all", "minimal", "none")  # microphones whose positions a solver is given


def solver_options(command):
    """Add an option for each of SOLVER_OPTIONS; a field of `SolverSettings` that is declared there needs no more."""
    known = types.KnownChoice(KNOWN)
    special = {"known": (known, None), "noise": (types.noise_level, "DB|auto|reported")}
    units = {"m": (types.length, "LENGTH"), "": (types.percentage, "PERCENT")}
    for key, declared in reversed(SOLVER_OPTIONS.items()):
        kind = declaration(SolverSettings, key)[0]
        choices = click.Choice(get_args(kind)) if get_origin(kind) is Literal else None
        numeric = units[declared["unit"]] if kind is float else (choices or str, None)
        shape, metavar = special.get(key, numeric)
        command = click.option(option_name(key), key, type=shape, metavar=metavar, help=declared["help"])(command)
    return command


def known_of_recordings(sources: Sequence[str], known: str) -> str:
    """Return names or a table of known microphones; click.BadParameter where `sources` are not all recordings."""
    from ..session.sources import is_recording

    if not all(map(is_recording, sources)):
        types.KnownChoice(KNOWN).refuse(known, click.Option(["--known"]), None)
    return known


def scene_of(text: str) -> CalibrationInput:
    """Return the simulated measurement of a scene; InputError for a measurement."""
    inputs = None if text.lower().endswith(".npz") else input_of(text)
    if inputs is None or inputs.scene is None:
        from ..model.scene_file import scene_names

        names = ", ".join(name for name in scene_names() if name != text)
        remedy = f"give a scene that is simulated: a .toml file or one of {names}"
        raise InputError(f"{text} is a measurement", remedy, key="scene", value=text)
    return inputs


def files_options(command):
    """Add the options of commands that read several recordings: --takes, --channels, --split and --source."""
    for option in reversed((
        click.option("--takes", "files", flag_value="takes", help="Several files are takes of the same channels."),
        click.option("--channels", "files", flag_value="channels", help="Several files are channels of one take."),
        click.option("--split", type=types.duration, metavar="TIME", help="Cut a long recording into takes, as 10s."),
        click.option("--source", "number", type=types.source_number, metavar="I|all",
                     help="Which of several sources, from 0; all: each is a take."),
    )):  # fmt: skip
        command = option(command)
    return command


def input_of(
    source: str | Sequence[str],
    /,
    search: list[float] | None = None,
    radius: float | None = None,
    excluded: tuple[str, ...] = (),
    positions: str | None = None,
    **recorded: Any,
) -> CalibrationInput:
    """Return the measurement of a scene or of files, with the values of the options.

    `positions`: file of the positions of all microphones, to compare with; `recorded`: of recordings, fields of
    `fdcal.recordings.import_options.ImportOptions`; None leaves one out.
    """
    from ..session.sources import compared_with_file, is_recording, load_input

    given, options = {key: value for key, value in recorded.items() if value is not None}, None
    if given:
        from ..recordings.import_options import ImportOptions

        texts = [source] if isinstance(source, str) else source
        other = next((text for text in texts if not is_recording(text)), None)
        if other is not None:
            key = next(iter(given))
            raise InputError(f"{other} holds no recordings", f"leave out <{key}>", key=key, value=given[key])
        options = ImportOptions(**given)
    with progress_bar("simulating") as progress:
        inputs = load_input(source, progress, excluded, options)
    if positions is not None:
        inputs = compared_with_file(inputs, positions)
    measurement = inputs.measurement
    domain = types.search_domain(measurement.search, measurement.array_dimension, search, radius)
    return replace(inputs, measurement=replace(measurement, search=domain))


def result_of(path: str | None) -> Calibration | None:
    """Return the calibration in the file of --result, None without the option."""
    if path is None:
        return None
    from ..assessment.result_file import load_result

    return load_result(path)


def open_request_of(text: str) -> OpenRequest:
    """Return what a page is to show: a saved session, a measurement or recordings, or a scene."""
    if text.lower().endswith(SESSIONS):
        from ..session.session_file import read

        return read(text)
    from ..model.scene_file import load_scene, scene_names
    from ..session.sources import OpenRequest, measurement_request

    if text in scene_names():  # every one of these is tested
        return OpenRequest(load_scene(text))
    from ..session.sources import check_scene, is_recording, load_input

    if text.lower().endswith(".npz") or is_recording(text):
        return measurement_request(load_input(text))
    scene = load_scene(text)
    check_scene(scene)  # a scene that cannot be simulated is refused before a page opens
    return OpenRequest(scene)
