"""The command `fdcal study`, which fdcal finds by the entry point group `fdcal.commands`."""

import sys
from collections import Counter
from pathlib import Path

import click

from fdcal.commands.options import progress_bar
from fdcal.model.validation import InputError

MAX_WORKERS = 1024
PAGE_COMMANDS = "fdcal study {study} -o {folder}\nfdcal study --report {folder} --page {page}"


@click.command()
@click.argument("file", required=False, metavar="[STUDY.toml]")
@click.option("-o", "--output", metavar="FOLDER", help="Folder of the results.")
@click.option("--workers", type=click.IntRange(1, MAX_WORKERS), metavar="W", help="Processes.  [default: 2]")
@click.option("--scheduler", metavar="tcp://HOST:8786", help="Scheduler of Dask to use instead of own processes.")
@click.option("--dashboard", is_flag=True, help="Serve Dask's dashboard, to this machine alone, and print its address.")
@click.option("--resume", is_flag=True, help="Continue a study that was interrupted.")
@click.option("--dry-run", is_flag=True, help="Print the number of calibrations and the expected time.")
@click.option("--report", metavar="FOLDER", help="Draw the results of a study.")
@click.option("--axes", metavar="Y,X", help="Axes of a report.  [default: Y an axis of numbers, X snr_db]")
@click.option("--at", multiple=True, metavar="KEY=VALUE", help="Value of another axis in a report; may be repeated.")
@click.option(
    "--page", metavar="FILE.md", help="With --report of a study of scenarios: write a page on its error bars."
)
def study(file, output, workers, scheduler, dashboard, resume, dry_run, report, axes, at, page):
    """Run many calibrations over the axes of a file.

    They run on Dask; --report draws what they found. Results are written as they arrive; --resume continues
    an interrupted study. The exit code is 4 if all calibrations are refused.
    """
    if report is not None:
        _require(file is None and output is None, "study", "--report takes no study file and no -o", "leave them out")
        _require(Path(report).is_dir(), "report", f"{report} is not a folder", "give the folder of a study")
        print(_report(report, axes, at) if page is None else _page(report, page))
        return 0
    _require(page is None, "page", "--page belongs to --report", "give --report FOLDER")
    _require(file is not None, "study", "no study is named", "give STUDY.toml, or --report FOLDER")
    _require(not at and axes is None, "at", "--axes and --at belong to --report", "leave them out")
    own = workers is None and not dashboard
    remedy = "leave out --workers and --dashboard"
    _require(own or scheduler is None, "scheduler", "--scheduler has its own workers and dashboard", remedy)
    from .run import expected_seconds
    from .study import load_study

    found = load_study(file)
    if dry_run:
        seconds = expected_seconds(found, workers or 2)
        took = f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
        took = took if seconds < 5400 else f"{seconds / 3600:.1f} h"
        count = f"{found.count} calibrations at {found.points} points"
        print(f"{count}, about {took} once the {workers or 2} workers have started")
        return 0
    _require(output is not None, "output", "no folder is named for the results", "give -o FOLDER")
    return run(found, output, workers or 2, scheduler, resume, dashboard)


def run(found, output: str, workers: int, scheduler: str | None, resume: bool, dashboard: bool = False) -> int:
    """Run a study, and return the exit code of the command."""
    from .run import Results, connected, read_results, run_study

    results = Results(output, found, resume)
    try:
        with connected(workers, scheduler, dashboard) as client:
            if dashboard:
                print(f"dashboard: {client.dashboard_link}", file=sys.stderr)
            with progress_bar("calibrating") as progress:
                computed = run_study(found, results, client, progress)
    except KeyboardInterrupt as error:
        kept = f"{len(results.done())} of {found.count} calibrations are in {output}"
        raise KeyboardInterrupt(f"interrupted; {kept}: the same command with --resume continues") from error
    print(f"{output}: {computed} calibrations, {found.count} in all; draw them with fdcal study --report {output}")
    _, rows = read_results(output)
    reasons = rows["reason"][rows["verdict"] == "refused"].tolist()
    if reasons:
        print(f"refused {len(reasons)} of {len(rows)}, most often: {Counter(reasons).most_common(1)[0][0]}")
    return 4 if len(reasons) == len(rows) else 0


def _report(folder: str, axes: str | None, at: tuple[str, ...]) -> Path:
    from .report import write_report
    from .run import read_results

    names = None
    if axes is not None:
        parts = [part.strip() for part in axes.split(",")]
        _require(len(parts) == 2 and all(parts), "axes", f'--axes "{axes}" is not a pair', "write Y,X")
        names = (parts[0], parts[1])
    pairs = [text.partition("=") for text in at]
    _require(all(sign for _, sign, _ in pairs), "at", "--at is not of the form KEY=VALUE", "write it as snr_db=20")
    return write_report(folder, *read_results(folder), names, {key: value for key, _, value in pairs})


def _page(folder: str, page: str) -> str:
    _require(page.endswith(".md"), "page", f"{page} does not end in .md", "give FILE.md")
    from .report import write_page
    from .run import read_results
    from .study import SCENARIO

    head, rows = read_results(folder)
    scenarios = list(head.axes) == [SCENARIO]
    _require(scenarios, "page", "only a study of scenarios has a page", "use --report without --page")
    write_page(Path(page), head, rows, folder, PAGE_COMMANDS)
    return page


def _require(condition: bool, key: str, problem: str, remedy: str) -> None:
    if not condition:
        raise InputError(problem, remedy, key=key)
