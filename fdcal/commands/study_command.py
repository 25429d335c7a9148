"""The command `study`: many calibrations over the axes of a file, and their report."""

import sys
from pathlib import Path

import click

from ..model.validation import InputError
from .options import progress_bar

MAX_WORKERS = 1024


@click.command()
@click.argument("file", required=False, metavar="[STUDY.toml]")
@click.option("-o", "--output", metavar="FOLDER", help="Folder of the results.")
@click.option("--workers", type=click.IntRange(1, MAX_WORKERS), metavar="W", help="Processes.  [default: 2]")
@click.option("--scheduler", metavar="tcp://HOST:8786", help="A scheduler of Dask in place of own processes.")
@click.option("--resume", is_flag=True, help="Go on with a study that was interrupted.")
@click.option("--dry-run", is_flag=True, help="Tell the number of calibrations and the time to be expected.")
@click.option("--report", metavar="FOLDER", help="Draw the results of a study.")
@click.option("--axes", metavar="Y,X", help="Of the map of a report.  [default: the first two]")
@click.option("--at", multiple=True, metavar="KEY=VALUE", help="Value of another axis in a report; may be repeated.")
@click.option("--page", metavar="FILE.md", help="With --report: whether the error bars hold, as a page.")
def study(file, output, workers, scheduler, resume, dry_run, report, axes, at, page):
    """Run many calibrations over the axes of a file.

    They run on Dask; --report draws what they found. Results are written as they come; an interrupted study goes on
    with --resume.
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
        print(f"{count}, about {_duration(seconds)}, {workers or 2} workers")
        return 0
    _require(output is not None, "output", "no folder is named for the results", "give -o FOLDER")
    return _run(found, output, workers or 2, scheduler, resume)


def _run(found, output: str, workers: int, scheduler: str | None, resume: bool) -> int:
    from ..session.study.run import Results, connected, run_study

    results = Results(output, found, resume)
    with connected(workers, scheduler) as client:
        print(f"dashboard: {client.dashboard_link}", file=sys.stderr)
        with progress_bar("calibrating") as progress:
            computed = run_study(found, results, client, progress)
    print(f"{output}: {computed} calibrations, {found.count} in all; draw them with fdcal study --report {output}")
    return 0


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


def _page(folder: str, page: str) -> int:
    _require(page.endswith(".md"), "page", f"{page} is no page", "give FILE.md")
    from ..graphics.calibration_report import write_page
    from ..session.study.run import read_results

    head, rows = read_results(Path(folder))
    stem = Path(page).stem
    name = stem.removeprefix("study-")
    study = f"studies/{name}.toml"
    commands = f"fdcal study {study} -o {name}\nfdcal study --report {name} --page docs/explanation/{stem}.md"
    write_page(Path(page), head, rows, study, commands)
    print(page)
    return 0


def _require(condition: bool, key: str, problem: str, remedy: str) -> None:
    if not condition:
        raise InputError(problem, remedy, key=key)


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


COMMANDS = (study,)
