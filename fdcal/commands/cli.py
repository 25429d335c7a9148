"""The command line: it reads arguments and options, and calls the other packages.

Exit codes: 0 done, 1 out of memory or a fault of fdcal itself, 2 bad input, 3 a file that cannot be read or written,
4 calibrated but the verdict is not "good" (all output is written nevertheless), 5 the list that `--check` compares with
does not fit or is in another order, 130 interrupted. `doctor` returns 5 if the list does not fit, and 4 if it finds
another fault or cannot judge the list. `study` returns 4 if all calibrations are refused.
An error is printed as one line on standard error; `--debug` prints the traceback as well. Libraries that take long to
load are imported by the command that needs them.
"""

import contextlib
import os
import signal
import sys
import time
import traceback
import webbrowser
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import entry_points
from typing import Any

import click

from ..assessment.result_file import save_result
from ..model.libraries import missing_library
from ..model.measurement import microphone_index, save_measurement
from ..model.scene import load_scene, scene_names
from ..model.storage import write_atomically
from ..model.validation import InputError
from ..session.lesson import lesson_names, load_lesson
from ..session.process import handled_by, one_blas_thread
from ..session.sources import with_settings
from . import file_commands, plot_commands, report
from . import options as opt

INTERRUPTED = "interrupted; no incomplete file is left"
NO_MEMORY = "there is not enough memory for this; use fewer microphones, frequencies or candidate positions"
REPORT = "this is a fault of fdcal; please report it with the command, its input and what the same command prints with"
LONGEST = 600  # largest number of characters of an error message
ENTRY_POINTS = "fdcal.commands"


def printable(text: str) -> str:
    """Return a text without control characters, which may occur in names of files and microphones."""
    return "".join(x if x.isprintable() or x in "\n\t" else "?" for x in text)


@dataclass(eq=False)
class PrintableOutput:
    """A stream that writes only `printable` text."""

    _stream: Any

    def write(self, text: str) -> int:
        """Write a text."""
        return self._stream.write(printable(text) if isinstance(text, str) else text)  # TypeError unless it is a text

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _described(error: BaseException, given: list[str]) -> tuple[str, int]:
    """Return the message for an exception, and the exit code."""
    if isinstance(error, ImportError):
        error = missing_library(error) or error
    if isinstance(error, (click.exceptions.Abort, KeyboardInterrupt)):
        return str(error) or str(error.__cause__ or "") or INTERRUPTED, 130  # click turns an interrupt into an Abort
    if isinstance(error, click.ClickException):
        return error.format_message(), 2
    if isinstance(error, InputError):
        return error.worded(opt.OPTIONS) + _elsewhere(error, given), 2
    if isinstance(error, MemoryError):
        return NO_MEMORY, 1
    if isinstance(error, OSError):
        return str(error), 3
    return f"{REPORT} --debug ({type(error).__name__}: {error})", 1


def _elsewhere(error: InputError, given: list[str]) -> str:
    """Return a remark if the remedy names an option that the command in the arguments `given` lacks, otherwise ""."""
    named = {text.split()[0] for key, text in opt.OPTIONS.items() if f"<{key}>" in error.remedy}
    options = {name: {flag for one in found.params for flag in one.opts} for name, found in commands.commands.items()}
    missing = named - options.get(next((one for one in given if one in options), ""), named)
    owner = next((name for name in options if missing and missing <= options[name]), "")
    return f" (an option of fdcal {owner})" if owner else ""


def main(args: list[str] | None = None) -> None:
    """Run a command and exit with its code; print an error as one line, with `--debug` after its traceback."""
    given = list(sys.argv[1:] if args is None else args)
    stop = given.index("--") if "--" in given else len(given)
    debug = "--debug" in given[:stop]  # at any place before --
    given = [argument for argument in given[:stop] if argument != "--debug"] + given[stop:]
    output: Any = PrintableOutput(sys.stdout)
    try:
        ended = handled_by(signal.default_int_handler, every=False)  # SIGTERM and SIGHUP end a command as Ctrl-C does
        with contextlib.redirect_stdout(output), ended, one_blas_thread():
            code = commands.main(args=given, prog_name="fdcal", standalone_mode=False) or 0
            try:
                sys.stdout.flush()
            except OSError:  # the reader of the output is gone: leave Python nothing to write when it exits
                with contextlib.suppress(OSError, ValueError, AttributeError):
                    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
                raise
    except (KeyboardInterrupt, Exception) as error:
        if debug:
            with contextlib.suppress(OSError):
                traceback.print_exc()
        message, code = _described(error, given)
        line = " ".join(message.split())
        line = line if len(line) <= LONGEST else f"{line[: LONGEST - 3]}..."
        with contextlib.suppress(OSError, ValueError):  # standard error may be closed
            print("error:", printable(line), file=sys.stderr, flush=True)
    sys.exit(code)


class Commands(click.Group):
    """The commands of fdcal, and those that other distributions register in the entry point group `fdcal.commands`."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands that are installed."""
        return sorted({*self.commands, *entry_points(group=ENTRY_POINTS).names})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command; raise InputError for one that belongs to a distribution that is not installed."""
        if cmd_name in self.commands:
            return self.commands[cmd_name]
        for found in entry_points(group=ENTRY_POINTS, name=cmd_name):
            return found.load()
        if cmd_name == "study":
            remedy = "install it: pip install ./fdcal_bench in a checkout of fdcal"
            raise InputError("the command study belongs to fdcal_bench", remedy, key=cmd_name)
        return None


@click.group(cls=Commands, invoke_without_command=True, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="fdcal", message="%(prog)s %(version)s", help="Show the version.")
@click.option("--debug", is_flag=True, expose_value=False, help="Show the traceback of an error.")
@click.pass_context
def commands(context):
    """Microphone positions from the resonances of a room.

    SCENE is a .toml file or the name of a scene that comes with fdcal: see `fdcal scenes`. FILE.npz is a measurement.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


@commands.command()
@click.argument("scene", required=False, metavar="[SCENE|FILE|SESSION]")
@opt.option("--lesson FILE.toml", "own", "File of your own lesson; the page opens with the first one.", multiple=True)
@opt.option("--host", "Network address at which the page is served.", default="127.0.0.1")
@opt.option("--port", "Port; 0 selects a free one.", type=int, default=8080)
@click.option("--no-browser", is_flag=True, help="Only print the address; do not open a browser.")
def view(scene: str | None, own: tuple[str, ...], host: str, port: int, no_browser: bool):
    """Watch a calibration in the browser; Ctrl-C ends it.

    Without an argument, the page plays a short film that shows how one microphone is found. FILE is a measurement, or
    a recording that `fdcal import` can read. SESSION is a session that was saved on the page.
    """
    from ..viewer.server.hardening import is_loopback

    lessons = [load_lesson(name) for name in (*own, *lesson_names())]
    request = None if scene is None else opt.open_request_of(scene)
    if not is_loopback(host):  # other machines can reach the page
        tunnel = f"{port or 8080}:127.0.0.1:{port or 8080}"
        print(
            f"The page at {host} can be opened and used by anyone who reaches this machine: there is no password.\n"
            f"It is safer to leave out --host and to run on the other machine:  ssh -L {tunnel} USER@THIS-MACHINE",
            file=sys.stderr,
        )

    def on_ready(url: str) -> None:
        print(url, flush=True)
        # Without a screen a text browser would start.
        seen = not sys.platform.startswith("linux") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        if seen and not no_browser:
            webbrowser.open(url)

    printed = set[str]()

    def on_progress(text: str) -> None:
        if opt.rewrites_lines():
            print(f"\r{text:<40}" if text else f"\r{'':<40}\r", end="", file=sys.stderr, flush=True)
        elif text and not text.endswith("%") and text not in printed:  # each stage once
            printed.add(text)
            print(text, file=sys.stderr, flush=True)

    from ..viewer import serve

    serve(request, host, port, on_ready, lessons, lessons[0] if own else None, on_progress)


@commands.command()
@click.argument("scene")
@opt.output_option("FILE.npz")
@opt.force_option
def simulate(scene: str, output: str, force: bool):
    """Simulate a scene and write what its microphones measured."""
    path = opt.output_path(output, ".npz", force)
    measurement = opt.scene_of(scene).measurement
    write_atomically(path, lambda file: save_measurement(measurement, file), force)
    f = measurement.frequencies
    takes = f" of {measurement.take_count} takes" if measurement.take_count > 1 else ""
    print(f"{path}: {len(f)} frequencies{takes}, {f[0]:.1f} to {f[-1]:.1f} Hz, at {measurement.count} microphones")


@commands.command()
@click.argument("sources", nargs=-1, required=True, metavar="SCENE|FILE...")
@opt.solver_option
@opt.solver_options
@opt.option("--gain-sigma DB,DEG", "Standard deviation of gain and phase, e.g. 1dB,5deg.  [default: estimated]",
            type=opt.gain_sigma)  # fmt: skip
@opt.modes_option
@opt.seed_option
@opt.option("--exclude NAME,...", "Microphones to leave out, by name or number.", type=opt.microphone_names, default=())
@opt.option("--distance I,J,METRES", "If no position is known: distance from I to J. It gives size and sound speed.",
            type=opt.distance)  # fmt: skip
@opt.option("--time-limit SECONDS", "Processor time after which the run ends with its best positions.", type=float)
@click.option("--check", is_flag=True, help="Compare with the positions in the file and name swapped channels.")
@opt.option("--positions FILE", "File of other positions to compare with: a table name,x,y[,z], or a geometry.")
@opt.output_option("RESULT.json", required=False)
@opt.recording_options(*opt.RECORDED)
@opt.force_option
def calibrate(
    sources, solver, gain_sigma, modes, seed, exclude, distance, time_limit, check, positions, output, force,
    **settings,
):  # fmt: skip
    """Find the microphones and assess the result.

    Several files are several takes: recordings or measurements of the same channels, each with the source at another
    place. Files with one channel each are the channels of a single take. For recordings, --known also accepts names of
    channels, or a table name,x,y[,z].

    The exit code is 5 if --check finds swapped channels or a list that does not fit, otherwise 4 if the result cannot
    be trusted.
    """
    path = opt.output_path(output, ".json", force, *sources) if output else None
    from ..session.calibration_run import solve

    recorded = {key: settings.pop(key) for key in ("files", "split", "source", *opt.RECORDED)}
    if settings["known"] not in (None, *opt.KNOWN):
        recorded["known"] = settings.pop("known")
    inputs = opt.input_of(sources, exclude, positions, **recorded)
    settings |= dict(zip(("gain_sigma_db", "phase_sigma_deg"), gain_sigma or (), strict=False))
    inputs = with_settings(inputs, solver, modes, seed, **settings)
    inputs = replace(inputs, distance=distance, time_limit=time_limit)
    if check and inputs.measurement.positions is None:
        raise InputError("the file has no positions to compare with", "name a list: <positions>", key="check")
    with opt.progress_bar("calibrating") as progress:
        result = solve(inputs, progress, opt.OPTIONS)
    compared = report.comparison(inputs, result) if check else None
    if path is not None:
        save_result(result, path, force=force, check=compared)
    print(report.summary(inputs, result))
    if positions is not None and compared is None:
        print("list    add --check to see which channels are swapped, and how far each microphone is from its place")
    if compared is not None:
        from ..session.doctor import list_fit  # imported here: it loads SciPy's filters

        with opt.progress_bar("comparing") as progress:
            fit = list_fit(inputs, result, compared, progress) if compared.fits else None  # else no row is judged
        print(report.comparison_text(inputs, result, compared, fit))
        if not compared.agrees or (fit is not None and fit.wrong):
            return 5
    return 0 if result.verdict == "good" else 4


@commands.command()
@click.argument("layout", metavar="LAYOUT")
@opt.option("--room LxWxH", "Rectangular room.  [default: the scene's, or a diffuse field]", type=opt.room_size)
@opt.option("--rt60 S", "reverberation_time", "Reverberation time, s.", type=float, default=0.5)
@opt.option("--snr DB", "snr_db", "Signal-to-noise ratio of each frequency.", type=float, default=30.0)
@opt.option("--frequencies LO:HI", "band", "Band, Hz.  [default: 20 to 0.7 f_max of Eq. 9]", type=opt.band)
@opt.option("--known NAME,...", "Microphones whose positions are given.", type=opt.microphone_names, default=())
@opt.option("--known-sigma LENGTH", "Standard deviation of each given coordinate.", type=opt.length, default="0mm")
@opt.option("--gain-sigma DB", "gain_sigma_db", "Spread of the channels' gains.", type=opt.decibels, default="0dB")
@opt.option("--accuracy LENGTH", "RMS error to aim for.", type=opt.length, default="10mm")
@opt.option("--takes N", "Number of source positions, each recorded for the same time.", type=int, default=1)
@opt.option("--kind", "impulse: arrival times are used as well.", type=["stationary", "impulse"], default="stationary")
@opt.option("--seed S", "Random seed of source positions, and of a ball or box.", type=click.IntRange(0), default=0)
def plan(layout, room, known, seed, **given):
    """Forecast how accurately an array can be calibrated.

    LAYOUT is a table name,x,y[,z] or another file of positions, a scene, or a geometry in words, with lengths in
    metres: "circle 16 0.2", "rectangle 4x4 0.6x0.6", "ball 32 0.3", "box 32 0.6x0.6x0.4".
    """
    from ..session.plan import PlanRequest, make_plan, plan_lines, read_layout

    array = read_layout(layout, seed)
    room = room or (None if array.scene is None else array.scene.room.size)
    numbers = {microphone_index(name, array.names, "known") for name in known}
    request = PlanRequest(array, room, known=tuple(sorted(numbers)), seed=seed, **given)
    print("\n".join(plan_lines(make_plan(request))))


@commands.command()
def scenes():
    """List the scenes that come with fdcal."""
    faults = []
    for name in scene_names():
        try:
            print(f"{name:<16} {load_scene(name).title}")
        except InputError as error:  # the other scenes are listed nevertheless
            faults.append(error)
    if faults:
        raise faults[0]


@commands.command()
def warm():
    """Compile code in advance, so that the first runs do not have to wait for it.

    The simulation of a scene, the solver descent and the maps of the page need compiled code. The calibration of a
    measurement needs none.
    """
    pieces = all_pieces()
    for number, (name, compile_piece) in enumerate(pieces, 1):
        start = time.perf_counter()
        print(f"{number} of {len(pieces)}: {name} ...", end="", file=sys.stderr, flush=True)
        compile_piece()
        print(f" {time.perf_counter() - start:.1f} s", file=sys.stderr, flush=True)


def all_pieces() -> list[tuple[str, Callable[[], object]]]:
    """Return descriptions of what is compiled, and the functions that compile it."""
    from ..solvers import MINIMA, SEARCH

    def simulate_rooms() -> None:  # one with few rows, and one with enough for several threads
        import numpy as np

        from ..acoustics import fdtd
        from ..model.scene import Room, Source

        source = Source(position=(0.1, 0.1), low=1000.0, high=3000.0, sample_rate=13000.0, duration=0.02)
        for height in (0.4, 4.0):
            fdtd.simulate(Room(size=(0.4, height), walls="rigid", cell=0.04), source, np.array([[0.3, 0.3]]))

    return [("simulation of a room", simulate_rooms), SEARCH, MINIMA]


for command in (*file_commands.COMMANDS, *plot_commands.COMMANDS):
    commands.add_command(command)
