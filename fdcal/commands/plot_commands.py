"""Commands that draw: `landscape`, `snapshot`, `replay` and `gallery`."""

from dataclasses import replace

import click
import numpy as np

from ..assessment.calibration import Calibration
from ..assessment.result_file import load_result
from ..model.measurement import Measurement, microphone_index
from ..model.settings import search_around
from ..model.storage import folder_in_progress, write_atomically
from ..model.validation import InputError, parse_modes
from ..session.session import recorded
from ..session.sources import as_given, with_settings
from ..solvers import with_mode_count
from . import options as opt
from .report import error_title


@click.command()
@click.argument("source", metavar="SCENE|FILE.npz")
@opt.option("--microphone N", "Name of the microphone to move, or its number, counted from 0.", required=True)
@opt.option("--mode-numbers M,M,...", "Numbers of the frequencies to draw, from 1, e.g. 1-3,9.  [default: 1,5,9]")
@opt.result_option
@opt.output_option("FIG.png|svg")
@opt.force_option
def landscape(source, microphone, mode_numbers, result, output, force):
    """Draw the cost of moving one microphone, for each frequency and for their sum.

    The figure is like Fig. 1 of the paper.

    The suffix selects pixels (.png) or a vector drawing (.svg). The other microphones stand at their true positions, or
    at those of a result. For an array in space, use `fdcal snapshot`.
    """
    path = opt.output_path(output, [".png", ".svg"], force)
    from ..cost.maps import landscape_panels

    inputs = opt.input_of(source)
    measurement = inputs.measurement
    n = microphone_index(microphone, measurement.names, "microphone")
    measured = len(measurement.frequencies)
    modes = parse_modes(mode_numbers, measured) if mode_numbers else [one for one in (1, 5, 9) if one <= measured]
    positions = shown_positions(measurement, result and load_result(result))
    searched = replace(measurement, search=search_around(positions, measurement.search))
    problem = searched.problem(inputs.settings.weights)
    panels = landscape_panels(problem, positions, n, modes, inputs.settings.order_offset)
    from ..graphics.figures import draw_landscape, figure_bytes

    truth = None if measurement.positions is None else measurement.positions[n]
    content = figure_bytes(draw_landscape(panels, truth), path.suffix.lower()[1:])
    write_atomically(path, lambda file: file.write_bytes(content), force)
    x, y = panels.minima[-1]
    print(f"{path}: microphone {measurement.names[n]}, lowest cost {panels.maps[-1].min():.3g} at ({x:.4g}, {y:.4g}) m")


def shown_positions(measurement: Measurement, result: Calibration | None) -> np.ndarray:
    """Return the positions (N, D), metres, of a result or, without a result, the true positions.

    A result without given positions is aligned with the true positions.
    """
    if result is not None:
        return result.positions_for(measurement)
    if measurement.positions is None:
        raise InputError("the measurement holds no true positions", "give those of a result: <result>", key="result")
    return measurement.positions


@click.command()
@click.argument("scene")
@opt.result_option
@opt.option("--microphone N", "Microphone whose cost landscape is drawn: on the floor, or as isosurfaces in space.")
@opt.option("--view", "Camera position.", type=["top", "3d", "close"], default="top")
@opt.option("--size WxH", "Width and height, pixels.", type=opt.picture_size, default="1280x800")
@opt.output_option("FILE.png")
@opt.force_option
def snapshot(scene, result, microphone, view, size, output, force):
    """Draw a room, its microphones and a result, without a browser."""
    path = opt.output_path(output, ".png", force)
    inputs, found = opt.scene_of(scene), result and load_result(result)
    from ..graphics.picture import compose, with_volume, z_range_of
    from ..graphics.snapshot import render_png
    from ..graphics.volume import map_of
    from ..session.calibration_run import problem_of

    measurement, scene_shown = inputs.measurement, inputs.scene
    assert scene_shown is not None
    positions, title, floor, volume, n = None, scene_shown.title, None, None, None
    if found is not None:
        positions = shown_positions(measurement, found)
        title = ": ".join(filter(None, (title, error_title(measurement, found))))
    if microphone is not None:
        n = microphone_index(microphone, measurement.names, "microphone")
        modes = len(found.frequencies) if found else with_mode_count(problem_of(inputs), inputs.settings).modes
        height = z_range_of(scene_shown, measurement)[0]
        floor, volume = map_of(inputs, shown_positions(measurement, found), n, modes, height)
        if volume is not None:
            title += f"\nCost of moving microphone {measurement.names[n]}"
    png = render_png(with_volume(compose(scene_shown, measurement, positions, n, floor, title), volume), size, view)
    write_atomically(path, lambda file: file.write_bytes(png), force)
    print(path)


@click.command()
@click.argument("source", metavar="SCENE|FILE")
@opt.solver_option
@opt.modes_option
@opt.seed_option
@opt.option("--microphone N", "Microphone whose map is shown first: its name, or its number, counted from 0.")
@opt.output_option("FILE.html")
@opt.force_option
def replay(source, solver, modes, seed, microphone, output, force):
    """Write a calibration as a page that plays in any browser.

    The page maps the cost of moving any microphone, at any step, over any frequencies. The part of the address after #
    selects what is shown, for example FILE.html#step=12&microphone=9&modes=1-20&view=top.
    """
    path = opt.output_path(output, ".html", force)
    from ..cost.eq7 import reference_cost_of
    from ..graphics.replay import replay_html
    from ..session.calibration_run import counted_microphones, states_of, with_needed_domain

    inputs = with_needed_domain(with_settings(opt.input_of(source), solver, modes, seed))
    if microphone is not None:
        microphone = microphone_index(microphone, inputs.measurement.names, "microphone")
    with opt.progress_bar("calibrating") as progress:
        states = recorded(states_of(inputs, progress))
    title = inputs.title or inputs.name if inputs.scene is None else inputs.scene.title
    searched = replace(inputs.measurement, search=search_around(states[-1].positions, inputs.measurement.search))
    measurement = searched if inputs.scene is None else as_given(inputs.scene, searched)
    problem = searched.problem(inputs.settings.weights, inputs.settings.known)
    sought, cost = counted_microphones(inputs, states[-1]), reference_cost_of(problem)
    text = replay_html(inputs.scene, measurement, states, title, cost, sought, problem=problem, microphone=microphone)
    write_atomically(path, lambda file: file.write_text(text, encoding="utf-8"), force)
    print(f"{path}: {len(states)} states of {inputs.settings.name}, {len(text) / 1e6:.2g} MB")


@click.command()
@opt.output_option("FOLDER")
@opt.force_option
def gallery(output: str, force: bool):
    """Write a static site of replays with an index page, which any web server can host and any browser opens.

    The site has a replay of the paper's Fig. 1, and the lessons. It needs no network.
    """
    with folder_in_progress(output, force) as folder:
        from .gallery_pages import gallery_pages

        sizes = []
        with opt.progress_bar("calibrating") as progress:
            for name, text in gallery_pages(progress):
                (folder / name).write_text(text, encoding="utf-8")
                sizes.append((folder / name).stat().st_size)
    print(f"{output}: {len(sizes)} pages, {sum(sizes) / 1e6:.2g} MB; open {output}/index.html")


COMMANDS = (landscape, snapshot, replay, gallery)
