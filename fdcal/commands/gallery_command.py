"""The command `gallery`: a static site of replays."""

from __future__ import annotations

import click

from .options import force_option, output_option, progress_bar


@click.command()
@output_option("FOLDER")
@force_option
def gallery(output: str, force: bool):
    """Write a static site of replays with an index page, which any web server can host and any browser opens.

    It shows the paper's arrays 1 and 2, its Fig. 1, an array in three dimensions, a race of two solvers and a bad
    channel. It needs no network.
    """
    from ..model.storage import folder_in_progress

    with folder_in_progress(output, force) as folder:
        from .gallery_pages import gallery_pages

        sizes = []
        with progress_bar("calibrating") as progress:
            for name, text in gallery_pages(progress):
                (folder / name).write_text(text, encoding="utf-8")
                sizes.append((folder / name).stat().st_size)
    print(f"{output}: {len(sizes)} pages, {sum(sizes) / 1e6:.2g} MB; open {output}/index.html")


COMMANDS = (gallery,)
