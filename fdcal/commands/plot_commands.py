"""Commands that draw: `landscape`, `field`, `snapshot`, `replay` and `gallery`."""

from dataclasses import replace

import click

from ..model.validation import InputError
from . import options as opt
from .options import microphone_number, mode_numbers


@click.command()
@click.argument("source", metavar="SCENE|FILE.npz")
@click.option("--microphone", type=int, required=True, metavar="N", help="The microphone to move, counted from 0.")
@click.option(
    "--mode-numbers",
    "numbers",
    type=opt.whole_numbers,
    metavar="M,M,...",
    help="Modes to draw, counted from 1.  [default: 1,5,9]",
)
@opt.result_option
@opt.output_option("FIG.png|svg|vti")
@opt.search_option
@opt.radius_option
@opt.force_option
def landscape(source, microphone, numbers, result, output, search, radius, force):
    """Draw the cost of moving one microphone, mode by mode.

    The modes are summed, too, as in Fig. 1 of the paper.

    The suffix selects the format: a picture, a drawing, or numbers for ParaView. The other microphones stand at their
    true positions, or at those of a result. Of an array in space there are numbers alone, in three dimensions and
    summed over all modes.
    """
    path = opt.output_path(output, [".png", ".svg", ".vti"], force)
    from ..cost.maps import landscape_panels
    from ..model.settings import search_around
    from ..model.storage import write_atomically
    from .plotting import shown_positions, write_volume

    inputs = opt.input_of(source, search, radius)
    measurement = inputs.measurement
    n = microphone_number(microphone, measurement.count)
    modes = mode_numbers(numbers, len(measurement.frequencies))
    positions = shown_positions(measurement, opt.result_of(result))
    if measurement.array_dimension == 3 and path.suffix.lower() == ".vti":
        write_volume(path, inputs, positions, n, force)
        return
    searched = replace(measurement, search=search_around(positions, measurement.search))
    problem = searched.problem(inputs.settings.weights)
    panels = landscape_panels(problem, positions, n, modes, inputs.settings.order_offset)
    if path.suffix.lower() == ".vti":
        from ..graphics.exports import landscape_vti

        content = landscape_vti(panels).encode()
    else:
        from ..graphics.landscape import draw_landscape, figure_bytes

        truth = None if measurement.positions is None else measurement.positions[n]
        content = figure_bytes(draw_landscape(panels, truth), path.suffix.lower()[1:])
    write_atomically(path, lambda file: file.write_bytes(content), force)
    x, y = panels.minima[-1]
    print(f"{path}: microphone {n}, least cost {panels.maps[-1].min():.3g} at ({x:.4g}, {y:.4g}) m")


@click.command()
@click.argument("source", metavar="SCENE|FILE")
@opt.result_option
@click.option(
    "--frequencies",
    type=opt.numbers,
    metavar="HZ,HZ,...",
    help="Measured frequencies.  [default: lowest, middle and highest]",
)
@click.option(
    "--step", type=opt.Number(), metavar="METRES", help="Lattice step.  [default: a 60th of the longest side]"
)
@opt.output_option("FILE.npz|csv|png")
@opt.force_option
def field(source, result, frequencies, step, output, force):
    """Map the sound field inside the array.

    The positions are those of a result (--result), or those in the input.
    """
    from ..assessment.field import field_map
    from ..graphics.exports import FIELD_WRITERS
    from ..model.storage import write_atomically
    from .plotting import shown_positions

    path = opt.output_path(output, sorted(FIELD_WRITERS), force, source, result)
    found = opt.result_of(result)
    inputs = opt.input_of(source, excluded=found.excluded if found else ())
    if frequencies is None and found is not None:
        frequencies = [found.frequencies[i] for i in (0, len(found.frequencies) // 2, -1)]
    positions, speed = shown_positions(inputs.measurement, found), None if found is None else found.sound_speed
    mapped = field_map(inputs.measurement, positions, frequencies, step, speed)
    write_atomically(path, lambda file: FIELD_WRITERS[path.suffix.lower()](file, mapped), force)
    listed = ", ".join(f"{f:.1f}" for f in mapped.frequencies)
    print(f"{path}: pressure at {listed} Hz, {len(mapped.points)} points inside {inputs.measurement.count} microphones")


@click.command()
@click.argument("scene")
@opt.result_option
@click.option(
    "--microphone",
    type=int,
    metavar="N",
    help="Draw the cost landscape of this one: on the floor, or isosurfaces of an array in space.",
)
@opt.basins_option
@opt.wave_option
@click.option(
    "--view", type=click.Choice(["top", "3d", "close"]), default="top", show_default=True, help="Camera position."
)
@click.option("--size", type=opt.picture_size, default="1280x800", show_default=True, metavar="WxH", help="Pixels.")
@opt.output_option("FILE.png")
@opt.force_option
def snapshot(scene, result, microphone, basins, wave, view, size, output, force):
    """Draw a room, its microphones and a result, without a browser."""
    path = opt.output_path(output, ".png", force)
    inputs, found = opt.scene_of(scene), opt.result_of(result)
    from ..graphics.overlays import with_volume
    from ..graphics.picture import compose
    from ..graphics.snapshot import render
    from .plotting import error_title, map_of, shown_positions

    measurement, scene_shown = inputs.measurement, inputs.scene
    if scene_shown is None:
        raise InputError(f"{scene} is a measurement", "give a scene", key="scene", value=scene)
    positions, title, shown = None, scene_shown.title, {}
    if found is not None:
        positions = shown_positions(measurement, found)
        title += f": {error_title(measurement, found)}"
    if microphone is not None:
        n = microphone_number(microphone, measurement.count)
        modes = inputs.settings.modes if found is None else len(found.frequencies)
        shown = map_of(inputs, shown_positions(measurement, found), n, modes, basins, wave)
        if "volume" in shown:
            title += f"\n{'Basins of attraction' if basins else 'Cost'} of moving microphone {measurement.names[n]}"
    picture = compose(scene_shown, measurement, positions, microphone, shown.get("floor"), title)
    picture = with_volume(picture, shown.get("volume"))
    render(picture, path, size, view, force)
    print(path)


@click.command()
@click.argument("source", metavar="SCENE|FILE")
@opt.solver_option
@opt.modes_option
@opt.seed_option
@click.option("--microphone", type=int, metavar="N", help="Whose map is shown first, counted from 0.")
@opt.output_option("FILE.html")
@opt.search_option
@opt.radius_option
@opt.force_option
def replay(source, solver, modes, seed, microphone, output, search, radius, force):
    """Write a calibration as a page that plays in any browser.

    The page maps the cost of moving any microphone, at any step, from any modes; the address after # leads to a moment,
    as in FILE.html#step=12&microphone=9&modes=1-20&view=top.
    """
    path = opt.output_path(output, ".html", force)
    from ..cost.eq7 import reference_cost_of
    from ..graphics.replay import replay_html
    from ..model.settings import search_around
    from ..model.storage import write_atomically
    from ..session.calibration_run import states_of
    from ..session.session import recorded
    from ..session.sources import as_given, with_settings
    from .plotting import counted_microphones

    inputs = with_settings(opt.input_of(source, search, radius), solver, modes, seed)
    if microphone is not None:
        microphone_number(microphone, inputs.measurement.count)
    with opt.progress_bar("calibrating") as progress:
        states = recorded(states_of(inputs, progress))
    title = inputs.title or inputs.name if inputs.scene is None else inputs.scene.title
    domain = search_around(states[-1].positions, inputs.measurement.search)
    source = replace(inputs.measurement, search=domain)
    measurement = source if inputs.scene is None else as_given(inputs.scene, source)
    problem = source.problem(inputs.settings.weights, inputs.settings.known)
    sought = counted_microphones(inputs, states[-1])
    cost = reference_cost_of(problem)
    text = replay_html(inputs.scene, measurement, states, title, cost, sought, problem=problem, microphone=microphone)
    write_atomically(path, lambda file: file.write_text(text, encoding="utf-8"), force)
    print(f"{path}: {len(states)} states of {inputs.settings.name}, {len(text) / 1e6:.2g} MB")


@click.command()
@opt.output_option("FOLDER")
@opt.force_option
def gallery(output: str, force: bool):
    """Write a static site of replays with an index page, which any web server can host and any browser opens.

    It plays the paper's Fig. 1, and holds three lessons, the paper's arrays 1 and 2, an array in three dimensions
    and a bad channel. It needs no network.
    """
    from ..model.storage import folder_in_progress

    with folder_in_progress(output, force) as folder:
        from .gallery_pages import gallery_pages

        sizes = []
        with opt.progress_bar("calibrating") as progress:
            for name, text in gallery_pages(progress):
                (folder / name).write_text(text, encoding="utf-8")
                sizes.append((folder / name).stat().st_size)
    print(f"{output}: {len(sizes)} pages, {sum(sizes) / 1e6:.2g} MB; open {output}/index.html")


COMMANDS = (landscape, field, snapshot, replay, gallery)
