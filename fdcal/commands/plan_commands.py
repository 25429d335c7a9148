"""The commands `plan`, how exact an array will be calibrated, and `study`, many calibrations over several axes."""

import sys
from collections import Counter
from pathlib import Path

import click

from ..model.validation import LIMITS, InputError
from . import options as opt
from .options import force_option, output_option, output_path, progress_bar

SUFFIXES = [".html", ".json", ".png"]
MAX_TAKES = 100


@click.command()
@click.argument("layout", metavar="LAYOUT")
@click.option(
    "--room", type=opt.RoomOrScene(), metavar="LxWxH|SCENE", help="Rectangular room.  [default: diffuse field]"
)
@click.option("--rt60", type=opt.Number(), default=0.5, show_default=True, metavar="S", help="Reverberation time, s.")
@click.option("--snr", type=opt.Number(), default=30.0, show_default=True, metavar="DB", help="Of each frequency.")
@click.option(
    "--frequencies", metavar="LO:HI", help="Band, Hz.  [default: 20 Hz to 0.7 of what the array can interpolate]"
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
@output_option("PLAN.html|json|png", required=False)
@force_option
def plan(
    layout, room, rt60, snr, frequencies, known, known_sigma, gain_sigma, accuracy, takes, kind, seed, output, force
):
    """Tell beforehand how exact an array will be calibrated.

    LAYOUT is a table name,x,y[,z] (.csv), a geometry of Acoular (.xml), a scene, or a geometry in words: "circle 16
    0.2", "rectangle 4x4 0.6x0.6", "ball 32 0.3", "box 32 0.6x0.6x0.4", metres; "vertical" after a circle or a rectangle
    sets it upright.
    """
    path = output_path(output, SUFFIXES, force, layout) if output else None
    from ..session.plan import make_plan, plan_lines
    from ..session.plan_request import PlanRequest, read_layout

    array = read_layout(layout, seed)
    request = PlanRequest(
        layout=array,
        room=room or (None if array.scene is None else array.scene.room.size),
        reverberation_time=rt60,
        snr_db=snr,
        band=_band(frequencies),
        known=_numbers(known, array.names),
        known_sigma=known_sigma or 0.0,
        gain_sigma_db=gain_sigma or 0.0,
        accuracy=accuracy,
        seed=seed,
        takes=takes,
        kind=kind,
    )
    found = make_plan(request)
    if path is not None:
        _write(path, found, force)
    print("\n".join(plan_lines(found)))


def _band(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    low, _, high = text.partition(":")
    try:
        band = float(low), float(high)
    except ValueError:
        band = (0.0, 0.0)
    if not 0 < band[0] < band[1] < LIMITS.largest:
        raise InputError(f'"{text}" is no band', "give <frequencies> as LO:HI in hertz", key="frequencies", value=text)
    return band


def _numbers(wanted: tuple[str, ...], names: tuple[str, ...]) -> tuple[int, ...]:
    unknown = [name for name in wanted if name not in names]
    if unknown:
        remedy = f"the layout has {', '.join(names[:8])}{', ...' if len(names) > 8 else ''}"
        raise InputError(f"<known> names {unknown[0]}", remedy, key="known", value=unknown[0])
    return tuple(sorted({names.index(name) for name in wanted}))


def _write(path, found, force: bool) -> None:
    """Write a plan in the format of the suffix."""
    import json

    from ..graphics.landscape import figure_bytes
    from ..graphics.reports import draw_plan, plan_html
    from ..model.storage import write_atomically
    from ..session.plan import plan_dict

    suffix = path.suffix.lower()
    if suffix == ".png":
        content = figure_bytes(draw_plan(found), "png")
    else:
        text = plan_html(found) if suffix == ".html" else json.dumps(plan_dict(found), indent=1) + "\n"
        content = text.encode()
    write_atomically(path, lambda file: file.write_bytes(content), force)


MAX_STUDY_WORKERS = 1024


@click.command()
@click.argument("file", required=False, metavar="[STUDY.toml]")
@click.option("-o", "--output", metavar="FOLDER", help="Folder of the results.")
@click.option("--workers", type=click.IntRange(1, MAX_STUDY_WORKERS), metavar="W", help="Processes.  [default: 2]")
@click.option("--scheduler", metavar="tcp://HOST:8786", help="A scheduler of Dask in place of own processes.")
@click.option("--resume", is_flag=True, help="Go on with a study that was interrupted.")
@click.option("--dry-run", is_flag=True, help="Tell the number of calibrations and the time to be expected.")
@click.option("--report", metavar="FOLDER", help="Draw the results of a study.")
@click.option("--axes", metavar="Y,X", help="Of the map of a report.  [default: the first two]")
@click.option("--at", multiple=True, metavar="KEY=VALUE", help="Value of another axis in a report; may be repeated.")
@click.option(
    "--page", metavar="FILE.md", help="With --report, of a study of settings: whether the error bars hold, as a page."
)
def study(file, output, workers, scheduler, resume, dry_run, report, axes, at, page):
    """Run many calibrations over the axes of a file.

    They run on Dask; --report draws what they found. Results are written as they come; an interrupted study goes on
    with --resume. The exit code is 4 if all calibrations are refused.
    """
    if report is not None:
        _require(file is None and output is None, "study", "--report takes no study file and no -o", "leave them out")
        return _report(report, axes, at) if page is None else _page(report, page)
    _require(page is None, "page", "--page belongs to --report", "give --report FOLDER")
    _require(file is not None, "study", "no study is named", "give STUDY.toml, or --report FOLDER")
    _require(not at and axes is None, "at", "--axes and --at belong to --report", "leave them out")
    _require(
        workers is None or scheduler is None, "scheduler", "--scheduler has its own workers", "leave out --workers"
    )
    from ..session.study import load_study
    from ..session.study.run import expected_seconds

    found = load_study(file)
    if dry_run:
        seconds = expected_seconds(found, workers or 2)
        count = f"{found.count} calibrations at {found.points} points"
        print(f"{count}, about {_duration(seconds)} once the {workers or 2} workers have started")
        return 0
    _require(output is not None, "output", "no folder is named for the results", "give -o FOLDER")
    return _run(found, output, workers or 2, scheduler, resume)


def _run(found, output: str, workers: int, scheduler: str | None, resume: bool) -> int:
    from ..session.study.run import Results, connected, read_results, run_study

    results = Results(output, found, resume)
    try:
        with connected(workers, scheduler) as client:
            print(f"dashboard: {client.dashboard_link}", file=sys.stderr)
            with progress_bar("calibrating") as progress:
                computed = run_study(found, results, client, progress)
    except KeyboardInterrupt as error:
        kept = f"{len(results.done())} of {found.count} calibrations are in {output}"
        raise KeyboardInterrupt(f"interrupted; {kept}: the same command with --resume goes on") from error
    print(f"{output}: {computed} calibrations, {found.count} in all; draw them with fdcal study --report {output}")
    _, rows = read_results(output)
    reasons = rows["reason"][rows["verdict"] == "refused"].tolist()
    if reasons:
        print(f"refused {len(reasons)} of {len(rows)}, most often: {Counter(reasons).most_common(1)[0][0]}")
    return 4 if len(reasons) == len(rows) else 0


def _report(folder: str, axes: str | None, at: tuple[str, ...]) -> int:
    _require(Path(folder).is_dir(), "report", f"{folder} is no folder", "give the folder that a study has written")
    from ..graphics.study_report import write_report
    from ..session.study.run import read_results

    names = None
    if axes is not None:
        parts = [part.strip() for part in axes.split(",")]
        _require(len(parts) == 2 and all(parts), "axes", f'--axes "{axes}" is no pair', "write Y,X")
        names = (parts[0], parts[1])
    pairs = [text.partition("=") for text in at]
    _require(all(sign for _, sign, _ in pairs), "at", "--at must be KEY=VALUE", "write it so")
    head, rows = read_results(Path(folder))
    print(write_report(folder, head, rows, names, {key: value for key, _, value in pairs}))
    return 0


PAGE_COMMANDS = "fdcal study {study} -o {folder}\nfdcal study --report {folder} --page {page}"


def _page(folder: str, page: str) -> int:
    _require(page.endswith(".md"), "page", f"{page} is no page", "give FILE.md")
    from ..graphics.study_report import write_page
    from ..session.study import SETTING
    from ..session.study.run import read_results

    head, rows = read_results(Path(folder))
    settings = list(head["axes"]) == [SETTING]
    _require(settings, "page", "a page is of a study of settings", "use --report without --page")
    write_page(Path(page), head, rows, folder, PAGE_COMMANDS)
    print(page)
    return 0


def _require(condition: bool, key: str, problem: str, remedy: str) -> None:
    if not condition:
        raise InputError(problem, remedy, key=key)


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


COMMANDS = (plan, study)
