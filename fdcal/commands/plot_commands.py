"""Commands that draw: `landscape`, `field`, `snapshot`, `replay` and `paper`."""

from __future__ import annotations

from pathlib import Path

import click

from . import parameter_types
from .options import (
    force_option,
    loaded_input,
    output_option,
    progress_bar,
    radius_option,
    result_of,
    result_option,
    search_option,
    simulated,
)


@click.command()
@click.argument("source", metavar="SCENE|FILE.npz")
@click.option("--microphone", type=int, required=True, metavar="N", help="The one to move, counted from 0.")
@click.option("--mode-numbers", metavar="M,M,...", help="Modes to draw, counted from 1.  [default: 1,5,9]")
@result_option
@output_option("FIG.png|svg|vti")
@search_option
@radius_option
@force_option
def landscape(source, microphone, mode_numbers, result, output, search, radius, force):
    """Draw the cost of moving one microphone, mode by mode and summed: the paper's Fig. 1.

    The suffix tells the format: a picture, a drawing, or numbers for ParaView. The other microphones stand at their
    true positions, or at those of a result.
    """
    path = parameter_types.output_path(output, [".png", ".svg", ".vti"], force)
    from ..graphics.landscape_figure import landscape_panels
    from ..model.storage import write_atomically
    from .plotting import shown_positions

    inputs = loaded_input(source, search, radius)
    measurement = inputs.measurement
    n = parameter_types.microphone_number(microphone, measurement.count)
    modes = parameter_types.mode_numbers(mode_numbers, len(measurement.frequencies))
    positions = shown_positions(measurement, result_of(result))
    problem = measurement.problem(inputs.settings.weights)
    panels = landscape_panels(problem, positions, n, modes, inputs.settings.order_offset)
    content = _landscape_bytes(path.suffix.lower(), panels, measurement)
    write_atomically(path, lambda file: file.write_bytes(content), force)
    x, y = panels.minima[-1]
    print(f"{path}: microphone {n}, least cost {panels.maps[-1].min():.3g} at ({x:.4g}, {y:.4g}) m")


def _landscape_bytes(suffix: str, panels, measurement) -> bytes:
    """Panels in the format of a suffix."""
    if suffix == ".vti":
        from ..graphics.paraview import landscape

        return landscape(panels).encode()
    from ..graphics.landscape_figure import draw_landscape, figure_bytes

    truth = None if measurement.positions is None else measurement.positions[panels.microphone]
    return figure_bytes(draw_landscape(panels, truth), suffix[1:])


@click.command()
@click.argument("source", metavar="SCENE|FILE")
@result_option
@click.option("--frequencies", metavar="HZ,HZ,...", help="Measured ones.  [default: lowest, middle and highest]")
@click.option("--step", type=float, metavar="METRES", help="Of the lattice.  [default: a 60th of the longest side]")
@output_option("FILE.npz|csv|png|vti")
@force_option
def field(source, result, frequencies, step, output, force):
    """Map the sound field inside the array, from positions found (--result) or, without, those in the input."""
    from ..graphics import field_files
    from ..model.storage import write_atomically
    from .plotting import field_inside

    path = parameter_types.output_path(output, sorted(field_files.WRITERS), force, source, result)
    wanted = None if frequencies is None else parameter_types.numbers(frequencies, "--frequencies", float)
    found = result_of(result)
    inputs = loaded_input(source, excluded=found.excluded if found else ())
    mapped = field_inside(inputs.measurement, found, wanted, step)
    write_atomically(path, lambda file: field_files.write(file, path, mapped), force)
    heard = ", ".join(f"{f:.1f}" for f in mapped.frequencies)
    print(f"{path}: pressure at {heard} Hz, {len(mapped.points)} points inside {inputs.measurement.count} microphones")


@click.command()
@click.argument("scene")
@result_option
@click.option("--microphone", type=int, metavar="N", help="Lay the cost landscape of this one on the floor.")
@click.option("--view", type=click.Choice(["top", "3d", "close"]), default="top", show_default=True, help="Where from.")
@click.option("--size", default="1280x800", show_default=True, metavar="WxH", help="Pixels.")
@output_option("FILE.png")
@force_option
def snapshot(scene, result, microphone, view, size, output, force):
    """Draw room and microphones, and a result where inputs, without a browser."""
    path = parameter_types.output_path(output, ".png", force)
    shape = parameter_types.pixels(size)
    inputs, found = simulated(scene), result_of(result)
    from ..graphics.heatmap import cost_floor
    from ..graphics.picture import compose
    from ..graphics.snapshot import render
    from ..graphics.units import error_summary
    from .plotting import shown_positions, summed_landscape

    positions, title, floor = None, inputs.scene.title, None
    if found is not None:
        positions = shown_positions(inputs.measurement, found)
        title += f": {error_summary(inputs.measurement, positions)}"
    if microphone is not None:
        n = parameter_types.microphone_number(microphone, inputs.measurement.count)
        modes = inputs.settings.modes if found is None else len(found.frequencies)
        others = inputs.measurement.positions if found is None else positions
        floor = cost_floor(summed_landscape(inputs, others, n, modes), inputs.measurement.search, log=True)
    picture = compose(inputs.scene, inputs.measurement, positions, microphone, floor, title)
    render(picture, path, shape, view, force)
    print(path)


@click.command()
@click.argument("source", metavar="SCENE|FILE")
@click.option("--solver", metavar="NAME", help="joint, descent (the paper's) or descent+joint.  [default: the scene's]")
@click.option("--modes", type=int, metavar="M", help="Modes in use at the end, from the lowest up.")
@click.option("--seed", type=int, metavar="S", help="Draws the solver's start.  [default: the scene's]")
@output_option("FILE.html")
@search_option
@radius_option
@force_option
def replay(source, solver, modes, seed, output, search, radius, force):
    """Calibrate, and write the whole run as one page that plays offline in any browser."""
    path = parameter_types.output_path(output, ".html", force)
    from ..graphics.replay import replay_html
    from ..model.storage import write_atomically
    from ..session.history import recorded
    from .calibrate import states_of
    from .sources import with_settings

    inputs = with_settings(loaded_input(source, search, radius), solver, modes, seed)
    with progress_bar("calibrating") as progress:
        states = recorded(states_of(inputs, progress))
    title = inputs.name if inputs.scene is None else inputs.scene.title
    text = replay_html(inputs.scene, inputs.measurement, states, title, inputs.settings.weights)
    write_atomically(path, lambda file: file.write_text(text, encoding="utf-8"), force)
    print(f"{path}: {len(states)} states of {inputs.settings.name}, {len(text) / 1e6:.2g} MB")


@click.command()
@click.option("--figure", "figures", type=click.IntRange(1, 5), multiple=True, help="This one alone; may be repeated.")
@click.option("--scene", "names", multiple=True, help="An array in place of the paper's two; may be repeated.")
@click.option("--seeds", type=int, default=10, show_default=True, metavar="S", help="Random starts in the table.")
@click.option("--quick", is_flag=True, help="16 modes and two seeds at most, for a first look.")
@output_option("FOLDER")
@force_option
def paper(figures, names, seeds, quick, output, force):
    """Draw the paper's Figs. 1 to 5 from runs of ours, and write its results beside ours as a table.

    The first time it takes half an hour of a quiet machine, nearly all of it for descent; the runs are kept in the
    cache, so that drawing again is quick.
    """
    from .paper import ARRAYS, FIGURES, LANDSCAPE, array_of, files_of, pages, require_free, write

    folder, wanted = Path(output), tuple(sorted(set(figures))) or FIGURES
    require_free(folder, files_of(wanted, not figures), force)
    square = simulated((names or LANDSCAPE)[0]) if 1 in wanted else None
    arrays = [array_of(simulated(name), seeds, quick) for name in names or ARRAYS if wanted != (1,)]
    with progress_bar("running") as progress:
        for name, content in pages(wanted, not figures, square, arrays, progress):
            print(write(folder, name, content, force), flush=True)


COMMANDS = (landscape, field, snapshot, replay, paper)
