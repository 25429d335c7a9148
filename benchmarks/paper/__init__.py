"""The figures of the paper and its results beside ours: `python -m benchmarks.paper -o FOLDER`.

study     what the paper states, and runs of both arrays from several seeds, which are kept in the cache
drawing   Figs. 2 to 5
table     the table of results
"""

import io
from collections.abc import Iterator
from pathlib import Path

from fdcal.cost.maps import landscape_panels
from fdcal.graphics.figures import draw_landscape
from fdcal.model.storage import write_atomically
from fdcal.model.validation import InputError, StorageError
from fdcal.session.sources import CalibrationInput

from . import drawing, table
from .study import ARRAYS, LANDSCAPE, Array, Progress, array_of, descents, joint_errors, outcomes

__all__ = ["ARRAYS", "FIGURES", "LANDSCAPE", "array_of", "files_of", "pages", "require_free", "write"]

FIGURES = (1, 2, 3, 4, 5)
FORMATS = ("png", "svg")


def files_of(figures: tuple[int, ...], tables: bool) -> list[str]:
    """Return the names of the files that will be written."""
    names = [f"fig{number}.{suffix}" for number in figures for suffix in FORMATS]
    return names + (["table.md", "table.csv"] if tables else [])


def require_free(folder: Path, names: list[str], force: bool) -> None:
    """Check that the files can be written.

    Raises InputError: one of them exists and `force` is not set, or `folder` is a file; StorageError: `folder` cannot
    be made.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"-o {folder} is a file", "name a folder", key="output")
    if not folder.parent.is_dir():
        raise StorageError(f"-o {folder} lies in a folder that does not exist; make it first: mkdir -p {folder.parent}")
    there = [name for name in names if (folder / name).exists()]
    if there and not force:
        remedy = "add <force> to overwrite it, or choose another folder"
        raise InputError(f"{folder / there[0]} exists", remedy, key="output")


def write(folder: Path, name: str, content: bytes, force: bool) -> Path:
    """Write a file, in a folder that is made with the first one, and return its path.

    Raises InputError, StorageError: the file exists and `force` is not set, or it cannot be written.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise StorageError(f"-o {folder} cannot be made: {error.strerror}") from error
    write_atomically(folder / name, lambda file: file.write_bytes(content), force)
    return folder / name


def pages(
    figures: tuple[int, ...], tables: bool, square: CalibrationInput | None, arrays: list[Array], progress: Progress
) -> Iterator[tuple[str, bytes]]:
    """Yield the name and the content of every file.

    `figures`: numbers of the figures to draw; `tables`: whether the table is written, too; `square`: what Fig. 1 shows;
    needed for that figure only; `progress`: called with the fraction done, 0 to 1, and a note.
    """
    if 1 in figures and square is not None:
        yield from _saved(1, landscapes(square))
    runs = [next(descents(array, 1, progress)) for array in arrays] if set(figures) & {2, 3, 4, 5} else []
    if 2 in figures:
        yield from _saved(2, drawing.draw_states(arrays, runs))
    if 3 in figures:
        yield from _saved(3, drawing.draw_iterations(arrays, runs))
    if 4 in figures:
        yield from _saved(4, drawing.draw_modes(arrays, runs, [joint_errors(array, progress) for array in arrays]))
    if 5 in figures:
        yield from _saved(5, drawing.draw_distances(arrays[-1], runs[-1]))
    if tables:
        found = [outcomes(array, progress) for array in arrays]
        yield "table.md", table.markdown(arrays, found).encode()
        yield "table.csv", table.comma_separated(arrays, found).encode()


def landscapes(inputs: CalibrationInput):
    """Return Fig. 1 of a scene; for another scene than the paper's, of its first unknown microphone and three modes."""
    name, microphone, modes = LANDSCAPE
    problem = inputs.measurement.problem(inputs.settings.weights)
    if inputs.name != name:
        microphone, last = int(problem.free[0]), min(inputs.settings.modes, len(problem.frequencies))
        modes = sorted({max(1, last // 3), max(1, 2 * last // 3), last})
    truth = inputs.measurement.positions
    if truth is None:
        raise InputError(f"{inputs.name} has no true positions", "give a scene")
    panels = landscape_panels(problem, truth, microphone, modes, inputs.settings.order_offset)
    return draw_landscape(panels, truth[microphone])


def _saved(number: int, figure) -> Iterator[tuple[str, bytes]]:
    import matplotlib

    for suffix in FORMATS:
        out = io.BytesIO()
        plain = (
            {"Date": None} if suffix == "svg" else None
        )  # without a date, so that the same figure gives the same file
        with matplotlib.rc_context({"svg.hashsalt": "fdcal"}):
            figure.savefig(out, format=suffix, metadata=plain)
        yield f"fig{number}.{suffix}", out.getvalue()
