"""The command line: arguments in, the rooms below called.

Exit codes: 0 done, 2 bad input, 3 a file that cannot be read or written, 4 calibrated, but the verdict is not "good"
(everything is written nevertheless, the verdict with it), 130 interrupted. An error is one line on
standard error. Libraries that take long to load are imported by the command that needs them.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import click

from . import arguments, runs
from .checks import InputError
from .scene import load_scene, scene_names


def main(args: list[str] | None = None) -> None:
    """Run a command and leave with its exit code."""
    try:
        code = commands.main(args=args, prog_name="fdcal", standalone_mode=False)
    except (click.exceptions.Abort, KeyboardInterrupt):
        code = _fail("interrupted; nothing is left half-written", 130)
    except click.ClickException as error:
        code = _fail(error.format_message(), 2)
    except InputError as error:
        code = _fail(error, 2)
    except OSError as error:
        code = _fail(error, 3)
    sys.exit(code)


def _fail(message, code: int) -> int:
    print("error:", " ".join(str(message).split()), file=sys.stderr)
    return code


@contextmanager
def _progress_bar(title: str) -> Iterator[runs.Progress]:
    """A bar on standard error that appears with the first call of the function it gives."""
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


@click.group(invoke_without_command=True, context_settings={"help_option_names": ["-h", "--help"]})
@click.pass_context
def commands(context):
    """Microphone positions from the resonances of a room.

    SCENE is a .toml file or the name of a scene that comes with fdcal: see `fdcal scenes`. FILE.npz is a measurement.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


def _output_option(what: str, required: bool = True):
    return click.option("-o", "--output", required=required, metavar=what, help="File to write.")


force_option = click.option("--force", is_flag=True, help="Overwrite an output that exists.")
result_option = click.option("--result", metavar="RESULT.json", help="Positions that `fdcal calibrate -o` found.")
search_option = click.option(
    "--search",
    metavar="ORIGIN,SIZE,STEP",
    help="Search domain, five numbers in metres: x,y of its lowest corner, width,height, step."
    " For example 2.01,1.71,1.2,1.2,0.01",
)
radius_option = click.option("--radius", type=float, metavar="R", help="Radius R of the order rule ceil(k R), metres.")


@commands.command()
@click.argument("scene", default="array1_circle")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to serve the page at.")
@click.option("--port", type=int, default=8080, show_default=True, help="Port; 0 takes a free one.")
@click.option("--no-browser", is_flag=True, help="Print the address, open nothing.")
def view(scene: str, host: str, port: int, no_browser: bool):
    """Watch a calibration in the browser; Ctrl-C ends it."""
    alone = arguments.address(host, port)
    loaded = load_scene(scene)
    runs.check_scene(loaded)  # one that cannot be simulated is refused before a page opens
    if not alone:
        print(arguments.warning(host, port), file=sys.stderr)

    def on_ready(url: str) -> None:
        print(url, flush=True)
        if not no_browser:
            arguments.open_page(url)

    from .viewer import Opening, serve

    serve(Opening(loaded), host, port, on_ready)


@commands.command()
@click.argument("scene")
@_output_option("FILE.npz")
@force_option
def simulate(scene: str, output: str, force: bool):
    """Simulate a scene and write what its microphones measured."""
    path = arguments.output_path(output, ".npz", force)
    measurement = _simulated(scene).measurement
    from .measurement_file import save_measurement
    from .store import write_atomically

    write_atomically(path, lambda file: save_measurement(measurement, file), force)
    f = measurement.frequencies
    print(f"{path}: {len(f)} modes, {f[0]:.1f} to {f[-1]:.1f} Hz, at {measurement.count} microphones")


@commands.command("import")
@click.argument("source", metavar="INPUT")
@_output_option("FILE.npz")
@click.option("--frequencies", default="auto", show_default=True, metavar="auto|LO:HI", help="Band to choose from, Hz.")
@click.option("--most", type=int, default=57, show_default=True, metavar="M", help="Frequencies to take at most.")
@click.option("--kind", default="auto", show_default=True, help="response (from silence to silence) or work.")
@click.option("--window", default="auto", show_default=True, metavar="auto|none|RATE", help="Exponential window, 1/s.")
@click.option("--temperature", type=float, metavar="C", help="Of the air, degrees Celsius; gives the speed of sound.")
@click.option("--sound-speed", "speed", type=float, metavar="M/S", help="In place of a temperature.")
@click.option("--source", "number", type=int, metavar="I", help="Which of several sources, from 0.")
@click.option("--dimension", type=int, default=3, show_default=True, help="2 or 3, of the sound field.")
@click.option("--plane", metavar="z=Z", help="Take the microphones in a plane, by the positions in the file.")
@click.option("--subset", metavar="N|I,J,...", help="Take a number of microphones at random, or those of a list.")
@click.option("--seed", type=int, default=0, show_default=True, metavar="S", help="Draws the --subset.")
@click.option("--leave-out", metavar="NAMES|bad", help="Leave out these channels, or all that are found bad.")
@click.option("--known", metavar="NAMES|corners|FILE.csv", help="Known microphones; a table tells name,x,y[,z].")
@click.option("--reference", metavar="FILE.wav", help="The signal that the source was given: deconvolve with it.")
@click.option("--reference-microphone", "against", metavar="NAME", help="Take cross-spectra against this channel.")
@click.option("--array-radius", "radius", type=float, metavar="R", help="Metres; gives the highest usable frequency.")
@force_option
def import_(source, output, number, force, **wishes):
    """Turn recordings or impulse responses into a measurement.

    INPUT is a WAV or FLAC file, a SOFA file, a folder of MeshRIR, an HDF5 file of Acoular, or an .npz file.
    """
    path = arguments.output_path(output, ".npz", force)
    if Path(source).resolve() == path.resolve():
        raise InputError(f"-o {output} is the input itself, which stays untouched; choose another name")
    from .intake import Wishes, intake, report
    from .measurement_file import save_measurement
    from .store import write_atomically

    measurement, told = intake(source, Wishes(source=number, **wishes))
    write_atomically(path, lambda file: save_measurement(measurement, file), force)
    print(report(measurement, told))
    print(path)


@commands.command()
@click.argument("source", metavar="SCENE|FILE")
@click.option("--solver", metavar="NAME", help="joint, descent (the paper's) or descent+joint.  [default: the scene's]")
@click.option("--start", metavar="affine|random", help="Positions to begin with.  [default: the solver's own]")
@click.option(
    "--known", metavar="all|minimal|none", help="Known microphones; minimal: a position, a direction, a side."
)
@click.option("--noise", metavar="DB|auto|told", help="SNR of each frequency that joint supposes; auto estimates it.")
@click.option("--cost", metavar="likelihood|projection", help="What joint minimises; projection is Eq. 7.")
@click.option("--modes", type=int, metavar="M", help="Modes in use at the end, from the lowest up.")
@click.option("--seed", type=int, metavar="S", help="Draws the solver's start.  [default: the scene's]")
@click.option("--exclude", metavar="NAME,...", help="Leave microphones out, by name or number, as 3,17.")
@click.option("--estimate-sound-speed", is_flag=True, help="Find it, too: from known microphones, or --distance.")
@click.option("--distance", metavar="I,J,METRES", help="How far two microphones are apart; where none is known.")
@click.option("--check", is_flag=True, help="Compare with the positions in the file; name swapped channels.")
@_output_option("RESULT.json", required=False)
@search_option
@radius_option
@force_option
def calibrate(
    source, solver, start, known, noise, cost, modes, seed, exclude, estimate_sound_speed, distance, check, output,
    search, radius, force,
):  # fmt: skip
    """Find the microphones, and say whether to trust the answer: exit code 4 where not."""
    path = arguments.output_path(output, ".json", force) if output else None
    given = _given(source, search, radius, arguments.names(exclude))
    given = runs.changed(given, solver, modes, seed, start=start, known=known, noise=noise, cost=cost)
    given = replace(given, estimate_sound_speed=estimate_sound_speed, distance=arguments.distance(distance))
    if check:
        runs.require_told(given.measurement)
    with _progress_bar("calibrating") as progress:
        result = runs.solve(given, progress)
    if path is not None:
        from .store import save_result

        save_result(result, path, force)
    print(runs.summary(given, result))
    if check:
        print(runs.checked(given, result))
    return 0 if result["verdict"] == "good" else 4


@commands.command()
@click.argument("result", metavar="RESULT.json")
@_output_option("FILE.csv|json|xml|sofa|npy")
@click.option("--frame", type=click.Choice(["known", "minimal", "axes"]), help="Axes.  [default: known, else axes]")
@click.option("--original", metavar="FILE.sofa", help="Fill the positions into a copy of this file.")
@force_option
def export(result, output, frame, original, force):
    """Write the positions of a result for other programs: the suffix tells the format."""
    from . import formats
    from .frames import placed_in
    from .store import write_atomically

    path = arguments.output_path(output, formats.suffixes("write"), force)
    placed = placed_in(_result(result), frame)
    write_atomically(path, lambda file: formats.write(file, path, placed, original), force)
    print(f"{path}: {len(placed.names)} microphones, frame: {placed.frame}")


@commands.command()
@click.argument("source", metavar="SCENE|FILE.npz")
@click.option("--microphone", type=int, required=True, metavar="N", help="The one to move, counted from 0.")
@click.option("--mode-numbers", metavar="M,M,...", help="Modes to draw, counted from 1.  [default: 1,5,9]")
@result_option
@_output_option("FIG.png")
@search_option
@radius_option
@force_option
def landscape(source, microphone, mode_numbers, result, output, search, radius, force):
    """Draw the cost of moving one microphone, mode by mode and summed: the paper's Fig. 1.

    The other microphones stand at their true positions, or at those of a result.
    """
    path = arguments.output_path(output, ".png", force)
    given = _given(source, search, radius)
    measurement = given.measurement
    n = arguments.microphone_number(microphone, measurement.count)
    modes = arguments.mode_numbers(mode_numbers, len(measurement.frequencies))
    positions = runs.positions_from(measurement, _result(result))
    from .figures import draw_landscape, landscape_panels
    from .store import write_atomically

    problem = measurement.problem(given.settings.weights)
    panels = landscape_panels(problem, positions, n, modes, given.settings.order_offset)
    figure = draw_landscape(panels, None if measurement.positions is None else measurement.positions[n])
    write_atomically(path, lambda file: figure.savefig(file, format="png"), force)
    x, y = panels.found[-1]
    print(f"{path}: microphone {n}, least cost {panels.maps[-1].min():.3g} at ({x:.4g}, {y:.4g}) m")


@commands.command()
@click.argument("scene")
@result_option
@click.option("--microphone", type=int, metavar="N", help="Lay the cost landscape of this one on the floor.")
@click.option("--view", type=click.Choice(["top", "3d", "close"]), default="top", show_default=True, help="Where from.")
@click.option("--size", default="1280x800", show_default=True, metavar="WxH", help="Pixels.")
@_output_option("FILE.png")
@force_option
def snapshot(scene, result, microphone, view, size, output, force):
    """Draw room and microphones, and a result where given, without a browser."""
    path = arguments.output_path(output, ".png", force)
    shape = arguments.pixels(size)
    given, found = _simulated(scene), _result(result)
    from .painting import paint
    from .picture import compose, headline
    from .snapshot import render

    positions, title, floor = None, given.scene.title, None
    if found is not None:
        positions = runs.positions_from(given.measurement, found)
        title += f": {headline(given.measurement, positions)}"
    if microphone is not None:
        n = arguments.microphone_number(microphone, given.measurement.count)
        modes = given.settings.modes if found is None else len(found["frequencies"])
        others = given.measurement.positions if found is None else positions
        floor = paint(runs.joint_landscape(given, others, n, modes), given.measurement.search, log=True)
    picture = compose(given.scene, given.measurement, positions, microphone, floor, title)
    render(picture, path, shape, view, force)
    print(path)


@commands.command()
def scenes():
    """List the scenes that come with fdcal."""
    for name in scene_names():
        print(f"{name:<16} {load_scene(name).title}")


def _simulated(scene: str) -> runs.Given:
    if scene.lower().endswith(".npz"):
        raise InputError(f"{scene} is a measurement; give a scene: a .toml file or one of {', '.join(scene_names())}")
    return _given(scene)


def _given(
    source: str, search: str | None = None, radius: float | None = None, excluded: tuple[str, ...] = ()
) -> runs.Given:
    with _progress_bar("simulating") as progress:
        given = runs.source_of(source, progress, excluded)
    measurement = given.measurement
    domain = arguments.search_domain(measurement.search, measurement.array_dimension, search, radius)
    return replace(given, measurement=replace(measurement, search=domain))


def _result(path: str | None) -> dict | None:
    if path is None:
        return None
    from .store import load_result

    return load_result(path)
