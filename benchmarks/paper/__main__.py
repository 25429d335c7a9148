"""The command: `python -m benchmarks.paper -o FOLDER`."""

import sys
from pathlib import Path

import click

from fdcal.commands import cli
from fdcal.commands.options import force_option, output_option, progress_bar, scene_of

from . import ARRAYS, FIGURES, LANDSCAPE, array_of, files_of, pages, require_free, write


@click.command()
@click.option(
    "--figure", "figures", type=click.IntRange(1, 5), multiple=True, help="Only this figure; may be repeated."
)
@click.option("--scene", "names", multiple=True, help="A scene instead of the paper's two; may be repeated.")
@click.option("--seeds", type=int, default=10, show_default=True, metavar="S", help="Random starts in the table.")
@click.option("--quick", is_flag=True, help="At most 16 modes and two seeds, for a preview.")
@output_option("FOLDER")
@force_option
def paper(figures, names, seeds, quick, output, force):
    """Draw the figures of the paper from our own runs.

    They are its Figs. 1 to 5, and a table that compares its results with ours.

    The first time this takes half an hour on an idle machine, nearly all of it for solver descent; the runs are kept
    in the cache, so that drawing again is fast.
    """
    folder, wanted = Path(output), tuple(sorted(set(figures))) or FIGURES
    require_free(folder, files_of(wanted, not figures), force)
    square = scene_of((names or LANDSCAPE)[0]) if 1 in wanted else None
    arrays = [array_of(scene_of(name), seeds, quick) for name in names or ARRAYS if wanted != (1,)]
    with progress_bar("running") as progress:
        for name, content in pages(wanted, not figures, square, arrays, progress):
            print(write(folder, name, content, force), flush=True)


def main(arguments: list[str] | None = None) -> None:
    """Run the command, with the errors and exit codes of `fdcal`."""
    cli.commands.add_command(paper)
    cli.main(["paper", *(sys.argv[1:] if arguments is None else arguments)])


if __name__ == "__main__":
    main()
