"""Which axes of a study its figures show: two of them along y and x, a panel for each combination of the others."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_PANELS = 8
MOST_COLUMNS = 4
LEAST_WIDTH = 7.5  # inches, of a figure, so that its legend has room
FRAME = 0.8  # inches, for the legend and the name of the x axis
NOISE_AXIS = "snr_db"  # along x unless another is chosen
LABELS = {
    "snr_db": "signal-to-noise ratio (dB)",
    "solver.modes": "modes",
    "solver.name": "solver",
    "faults.gain_db": "channel gains, standard deviation (dB)",
    "radius": "radius of the array (m)",
    "known": "known microphones",
    "source.duration": "recording (s)",
}


@dataclass(frozen=True)
class StudyPanels:
    """How the axes of a study are laid out in a figure."""

    # y, x: names of axes; y is "" for a study of one axis
    y: str
    x: str
    # the values of other axes of each panel, by name; one empty dict without other axes
    panels: tuple[dict[str, Any], ...]
    columns: int  # panels in a row
    averaged: tuple[str, ...]  # axes over which every panel averages, since they would give too many panels

    def drawn(self, width: float, height: float) -> tuple[Figure, list[tuple[Any, dict[str, Any]]]]:
        """Return a figure with one matplotlib axes for each panel, and the panels.

        Each takes `width` x `height` inches, more where there are few.
        """
        from matplotlib.figure import Figure

        rows = -(-len(self.panels) // self.columns)
        wide = max(width * self.columns, LEAST_WIDTH)
        figure = Figure(figsize=(wide, FRAME + rows * max(height, 0.45 * wide / self.columns)), dpi=100)
        figure.set_layout_engine("constrained")
        cells = list(figure.subplots(rows, self.columns, squeeze=False, sharex=True, sharey=True).flat)
        for cell in cells[len(self.panels) :]:
            cell.set_visible(False)
        for cell, values in zip(cells, self.panels, strict=False):
            cell.set_title(", ".join(title_of(name, value) for name, value in values.items()), fontsize="medium")
        return figure, list(zip(cells, self.panels, strict=False))


def study_panels(axes: dict[str, list], names: tuple[str, str] | None = None) -> StudyPanels:
    """Return the layout of the axes of a study.

    `axes`: values of each axis, by name; `names`: axes along y and x; unless given, the signal-to-noise ratio along x
    and the last other axis of numbers along y, so that solvers and scenes are compared side by side.
    """
    y, x = names or _usual(axes)
    others = [name for name, values in axes.items() if name not in (y, x) and len(values) > 1]
    kept = list(others)
    while _count(axes, kept) > MOST_PANELS:
        kept.pop()
    kept.sort(key=lambda name: len(axes[name]))  # the longest fills the rows
    combinations = itertools.product(*(axes[name] for name in kept))
    panels = tuple(dict(zip(kept, values, strict=True)) for values in combinations)
    columns = len(axes[kept[-1]]) if len(kept) > 1 else min(len(panels), MOST_COLUMNS)
    return StudyPanels(y, x, panels, columns, tuple(name for name in others if name not in kept))


def _usual(axes: dict[str, list]) -> tuple[str, str]:
    several = [name for name, values in axes.items() if len(values) > 1] or list(axes)
    numbers = [name for name in several if all(isinstance(value, (int, float)) for value in axes[name])]
    x = NOISE_AXIS if NOISE_AXIS in several else (numbers or several)[-1]
    rest = [name for name in numbers if name != x] or [name for name in several if name != x]
    return rest[-1] if rest else "", x


def _count(axes: dict[str, list], names: list[str]) -> int:
    count = 1
    for name in names:
        count *= len(axes[name])
    return count


def label_of(name: str) -> str:
    """Return what an axis of a study is called in a figure."""
    return LABELS.get(name, name.replace("_", " "))


def title_of(name: str, value: Any) -> str:
    """Return what a value of an axis is called in a figure: a name alone, a number with its axis."""
    return str(value) if isinstance(value, str) else f"{label_of(name)}: {value}"
