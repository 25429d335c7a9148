"""The command `plan`: how exact an array will be calibrated."""

import json

import click

from . import options as opt
from .options import force_option, output_option, output_path

SUFFIXES = [".json", ".png"]
MAX_TAKES = 100


@click.command()
@click.argument("layout", metavar="LAYOUT")
@click.option(
    "--room", type=opt.RoomOrScene(), metavar="LxWxH|SCENE", help="Rectangular room.  [default: diffuse field]"
)
@click.option("--rt60", type=opt.Number(), default=0.5, show_default=True, metavar="S", help="Reverberation time, s.")
@click.option("--snr", type=opt.Number(), default=30.0, show_default=True, metavar="DB", help="Of each frequency.")
@click.option(
    "--frequencies",
    type=opt.band,
    metavar="LO:HI",
    help="Band, Hz.  [default: 20 Hz to 0.7 of what the array can interpolate]",
)
@click.option(
    "--known",
    type=opt.microphone_names,
    default=(),
    metavar="NAME,...",
    help="Microphones whose positions are given.",
)
@click.option("--known-sigma", type=opt.length, metavar="LENGTH", help="One sigma of each given coordinate, as 5mm.")
@click.option("--gain-sigma", type=opt.decibels, metavar="DB", help="Spread of the channels' gains, as 1dB.")
@click.option(
    "--accuracy", type=opt.length, default="10mm", show_default=True, metavar="LENGTH", help="That is wanted."
)
@click.option(
    "--takes",
    type=click.IntRange(1, MAX_TAKES),
    default=1,
    show_default=True,
    metavar="N",
    help="Places of the source, recorded equally long from each.",
)
@click.option(
    "--kind",
    type=click.Choice(["stationary", "impulse"]),
    default="stationary",
    show_default=True,
    help="Noise or music, or impulses and sweeps, whose arrival times count.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, metavar="S", help="Of places drawn.")
@output_option("PLAN.json|png", required=False)
@force_option
def plan(
    layout, room, rt60, snr, frequencies, known, known_sigma, gain_sigma, accuracy, takes, kind, seed, output, force
):
    """Tell beforehand how exact an array will be calibrated.

    LAYOUT is a table name,x,y[,z] or another file of positions, a scene, or a geometry in words: "circle 16
    0.2", "rectangle 4x4 0.6x0.6", "ball 32 0.3", "box 32 0.6x0.6x0.4", metres.
    """
    path = output_path(output, SUFFIXES, force, layout) if output else None
    from ..graphics.landscape import figure_bytes
    from ..graphics.reports import draw_plan
    from ..model.measurement import microphone_index
    from ..model.storage import write_atomically
    from ..session.plan import PlanRequest, make_plan, plan_dict, plan_lines, read_layout

    array = read_layout(layout, seed)
    request = PlanRequest(
        layout=array,
        room=room or (None if array.scene is None else array.scene.room.size),
        reverberation_time=rt60,
        snr_db=snr,
        band=frequencies,
        known=tuple(sorted({microphone_index(name, array.names, "known") for name in known})),
        known_sigma=known_sigma or 0.0,
        gain_sigma_db=gain_sigma or 0.0,
        accuracy=accuracy,
        seed=seed,
        takes=takes,
        kind=kind,
    )
    found = make_plan(request)
    if path is not None:
        if path.suffix.lower() == ".png":
            content = figure_bytes(draw_plan(array.positions, found.bound), "png")
        else:
            content = (json.dumps(plan_dict(found), indent=1) + "\n").encode()
        write_atomically(path, lambda file: file.write_bytes(content), force)
    print("\n".join(plan_lines(found)))


COMMANDS = (plan,)
