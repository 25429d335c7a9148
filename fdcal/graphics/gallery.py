"""The index page of a gallery of replays, and the page of a race: two replays side by side, led by processor time.

Pages hold no address but those of the other files beside them: any web server can host the folder, and a browser shows
it from `file://`.
"""

import base64
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from PIL import Image

from ..cost.expansion import expansion_of, reference_cost_of
from ..cost.maps import eq7_maps, refined
from ..model.measurement import Measurement
from ..model.problem import Problem
from .heatmap import colour_limits, normalise, to_rgb
from .replay import filled
from .units import ALL

PAGES = Path(__file__).with_name("replay_page")
THUMBNAIL = 96  # pixels along the longer edge of the map in a picture of the index


@dataclass(frozen=True)
class Entry:
    """One entry of the index."""

    file: str  # of the page, with what it shows after #
    # title, text: what there is to be seen
    title: str
    text: str
    figures: str  # one line: solver, mean error, size
    picture: str  # HTML of its picture


def index_html(title: str, introduction: str, entries: Sequence[Entry], opening: str) -> str:
    """Return the index page of a gallery; `opening`: the page beside it that plays above the entries."""
    cards = "\n".join(
        f'<a href="{escape(entry.file)}">{entry.picture}<h2>{escape(entry.title)}</h2><p>{escape(entry.text)}</p>'
        f"<p class='figures'>{escape(entry.figures)}</p></a>"
        for entry in entries
    )
    parts = {"TITLE": escape(title), "INTRODUCTION": escape(introduction), "CARDS": cards, "OPENING": escape(opening)}
    return filled((PAGES / "index.html").read_text(encoding="utf-8"), parts)


def race_html(title: str, files: Sequence[str], names: Sequence[str], seconds: Sequence[np.ndarray]) -> str:
    """Return the page of a race of two replays beside the page; `seconds`: for each, times (T,) of its states, s."""
    ends = [float(times[-1]) for times in seconds]
    firsts = [float(times[times > 0].min(initial=1.0)) for times in seconds]
    data = {"files": list(files), "names": list(names), "ends": ends, "first": min(firsts)}
    frames = "\n".join(
        f'<iframe src="{escape(file)}" title="{escape(name)}"></iframe>'
        for file, name in zip(files, names, strict=True)
    )
    text = json.dumps(data, allow_nan=False).replace("<", "\\u003c")
    parts = {"TITLE": escape(title), "FRAMES": frames, "DATA": text}
    return filled((PAGES / "race.html").read_text(encoding="utf-8"), parts)


def picture_of(
    measurement: Measurement, problem: Problem, state, n: int, modes: Sequence[int] | None, by: np.ndarray | slice = ALL
) -> str:
    """Return a picture of the map of microphone `n` with the true and the estimated positions, as SVG.

    `modes`: counted from 1; all that the microphones can carry unless given; `by`: numbers of the microphones by which
    a blind array is aligned.
    """
    reference_cost, domain = reference_cost_of(problem), problem.search
    if reference_cost is None or domain is None:
        return ""
    lattice, offset = refined(domain, THUMBNAIL), reference_cost.order_offset
    chosen = modes or tuple(expansion_of(problem, offset).carried.modes + 1)
    cost = eq7_maps(problem, state.positions, n, chosen, offset, lattice, state.channels).sum(axis=0)
    low, high, _ = colour_limits(cost, True)
    image = Image.fromarray(to_rgb(normalise(cost, low, high, True))[::-1])
    file = io.BytesIO()
    image.save(file, "PNG", optimize=True)
    width, height = image.size
    corner = np.asarray(lattice.origin[:2]) - lattice.step / 2
    truth = measurement.aligned_truth(state.positions, by)

    def pixels(positions) -> np.ndarray:  # (N, 2), y downwards
        places = (np.asarray(positions, float)[:, :2] - corner) / lattice.step
        return np.column_stack([places[:, 0], height - places[:, 1]])

    marks = ""
    if truth is not None:
        circles = (f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.7"/>' for x, y in pixels(truth))
        marks = f'<g fill="none" stroke="#000" stroke-width="0.7">{"".join(circles)}</g>'
    path = "".join(f"M{x - 1:.1f} {y - 1:.1f}l2 2m0-2l-2 2" for x, y in pixels(state.positions))
    marks += f'<path d="{path}" stroke="#fff" stroke-width="1.3"/>'
    marks += f'<path d="{path}" stroke="#d61828" stroke-width="0.7"/>'
    coded = base64.b64encode(file.getvalue()).decode("ascii")
    return (
        f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="Map with the microphones">'
        f'<image href="data:image/png;base64,{coded}" width="{width}" height="{height}"/>{marks}</svg>'
    )
