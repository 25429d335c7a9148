"""A whole run as one HTML file that plays offline: the page's scene, curves, table and maps, without a server.

The file holds the states as compressed numbers; positions are accurate to 1e-8 of the size of the run. It loads nothing
from other files; its content security policy forbids this. Its parts are in `replay_page/`. The address after #
contains step, microphone, modes and view (`replay_page/address.js`), so that a link leads to a state.

packed     arrays as one text that the page unpacks (`replay_page/unpack.js`). Integers of four bytes are stored as
           differences along the first axis. An array begins with the lowest bytes of all its values, followed by the
           second lowest bytes and so on, because values that hardly change then compress well. The compression is that
           of zlib, which browsers call "deflate"
map_data   the data with which the browser computes the cost of moving any microphone, at any state, with any modes
           (`replay_page/eq7.js`): the pressures, as 16-bit numbers of each mode and channel; the gains and noise of the
           channels are with the states. It has only modes whose expansion at the order of `fdcal.cost.eq7` has fewer
           functions than there are microphones ("carried" modes), the lowest ones up to MAX_PRESSURES pressures
"""

import base64
import io
import json
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..cost.eq7 import ReferenceCost, carried_modes, expansion_of, reference_cost_of
from ..cost.maps import eq7_maps, refined
from ..cost.scale import DECADES, DEPTH, FEW_MODES, LEAST_RANGE
from ..model.address import ADDRESS
from ..model.gauge import align, fixes_gauge
from ..model.measurement import Measurement
from ..model.problem import Problem
from ..model.scene import Scene
from ..model.settings import SolverSettings, search_around
from ..model.validation import evenly_spaced
from ..solvers.interface import RunState
from .heatmap import SHOWN, colour_limits, normalise, to_rgb
from .marks import EDGE, MARKS, marks_json, symbol_svg
from .picture import focus_of, wall_height, z_range_of


def packed(arrays: Mapping[str, np.ndarray]) -> dict:
    """Return arrays of int16, int32, float32 or float64 for JSON: "arrays", name to [type, shape], and "bytes".

    A difference may overflow: the sum in the browser then overflows as well and restores the value.
    """
    listed, content = {}, b""
    for name, values in arrays.items():
        values = np.asarray(values)
        code = f"{values.dtype.kind}{values.dtype.itemsize}"
        listed[name] = [code, list(values.shape)]
        if code == "i4" and len(values):
            values = np.concatenate([values[:1], np.diff(values, axis=0)]).astype(values.dtype)
        flat = np.ascontiguousarray(values, values.dtype.newbyteorder("<")).reshape(-1, 1)
        content += flat.view(np.uint8).reshape(len(flat), -1).T.tobytes()  # the lowest bytes of all values first
    return {"arrays": listed, "bytes": base64.b64encode(zlib.compress(content, 9)).decode("ascii")}


MAX_PRESSURES = 200_000  # largest number of pressures in a file, 0.8 MB before compression
LEVELS = 32767  # integer for the largest real or imaginary part of a mode; rounding errors are 96 dB lower


def map_data(problem: Problem, settings: SolverSettings) -> tuple[dict, dict[str, np.ndarray]] | None:
    """Return data and arrays for the maps of a problem; None without a search domain or without carried modes.

    "pressures" (M, N, 2) int16 are multiplied by "mode_scale" (M,) and "channel_scale" (N,). "descent" has the settings
    for steps of descent in the browser, or is None if descent cannot solve the problem.
    """
    reference_cost = reference_cost_of(problem)
    if reference_cost is None or problem.search is None:
        return None
    carried = carried_modes(problem, reference_cost.order_offset)
    kept = slice(0, max(1, MAX_PRESSURES // problem.pressures.shape[1]))
    modes, search, names = carried.modes[kept], problem.search, ("order_offset", "ample_modes", "known_weight")
    descends = problem.dimension == problem.array_dimension == 2 and fixes_gauge(problem.known_positions)
    descends = descends and settings.order_offset <= carried.order_offset  # a step may not exceed the order of the maps
    data = {
        "origin": list(search.origin[:2]),
        "step": search.step,
        "shape": list(search.shape[:2]),
        "modes": (modes + 1).tolist(),
        "orders": carried.orders[kept].tolist(),
        "order_offset": carried.order_offset,
        "left_out": len(carried.modes) - len(modes),
        "dimension": problem.dimension,
        "decades": DECADES,
        "least": LEAST_RANGE,
        "percentiles": SHOWN,
        "depth": DEPTH,
        "few": FEW_MODES,
        "colours": to_rgb(np.arange(256) / 255).ravel().tolist(),
        "descent": {name: getattr(settings, name) for name in names} if descends else None,
    }
    pressures, k = problem.pressures[modes], np.asarray(problem.wavenumbers[modes], complex)
    channel_rms = np.sqrt(np.mean(np.abs(pressures) ** 2, axis=0))
    channel_rms[channel_rms == 0] = 1.0
    parts = _parts(pressures) / channel_rms[:, None]
    mode_peak = np.abs(parts).max(axis=(1, 2), initial=0.0)
    mode_peak[mode_peak == 0] = 1.0
    return data, {
        "wavenumbers": _parts(k),
        "pressures": np.rint(parts / mode_peak[:, None, None] * LEVELS).astype("<i2"),
        "mode_scale": (mode_peak / LEVELS).astype("<f8"),
        "channel_scale": channel_rms.astype("<f8"),
    }


def _parts(values: np.ndarray) -> np.ndarray:
    """Return real and imaginary parts along a new last axis."""
    return np.stack([np.real(values), np.imag(values)], axis=-1)


MAX_BYTES = 4_500_000  # largest size of a file; a longer run keeps fewer states, evenly spaced
STATE_NUMBERS = tuple("step sweep stage restart moved first last".split())  # attributes of a state
MAX_COSTS = 400  # number of states, evenly spaced, whose cost is computed
BASE_BYTES, NAME_BYTES = 100_000, 60  # size of the page without data, and of the data of one microphone
POSITION_LEVELS = 2**28  # integer for the largest distance of a coordinate from the centre of the array
PAGE = Path(__file__).with_name("replay_page")
PAGE_MARKS = {  # names of the page for entries of the table of marks
    "true": "microphones/true", "estimate": "microphones/estimate", "known": "microphones/known",
    "error": "microphones/error", "ball": "microphones/ball", "selected": "selected/true", "moved": "selected/estimate",
    "lowest": "lowest", "minima": "minima", "trail": "trails", "pointed": "microphones/pointed", "ellipse": "ellipses",
}  # fmt: skip
SCRIPTS = ("unpack.js", "eq7.js", "view.js", "map.js", "play.js", "lesson.js", "address.js", "start.js")


def replay_html(
    scene: Scene | None, measurement: Measurement, states: Sequence, title: str, *costs, opens_at: str = "", **options
) -> str:
    """Return the HTML of a run of any solver.

    `costs`: the parameters `reference_cost` and `sought` of `run_data`; `options`: its further parameters; `opens_at`:
    the part after # that is assumed if the address has none.
    """
    return page_html(title, [run_data(scene, measurement, states, *costs, **options)], opens_at)


def page_html(title: str, runs: Sequence[dict], opens_at: str = "", lesson: dict | None = None) -> str:
    """Return the HTML of some runs, of which the page shows one at a time.

    `runs`: data from `run_data`; `lesson`: its steps, each with parts that show a range of the states of one of the
    runs (`fdcal.commands.gallery_pages`).
    """
    data = runs[0] | {"title": title, "lesson": lesson, "opens_at": opens_at, "others": list(runs[1:])}
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    page = {
        "TITLE": escape(title),
        "STYLE": (PAGE / "page.css").read_text(encoding="utf-8"),
        "SCRIPT": "\n".join((PAGE / name).read_text(encoding="utf-8") for name in SCRIPTS),
        "DATA": text.replace("<", "\\u003c"),  # so that no text can end the element <script> that contains it
    }
    return filled((PAGE / "page.html").read_text(encoding="utf-8"), page)


def run_data(
    scene: Scene | None,
    measurement: Measurement,
    states: Sequence,
    reference_cost: ReferenceCost | None = None,
    sought=None,
    *,
    problem: Problem | None = None,
    microphone: int | None = None,
    max_bytes: int = MAX_BYTES,
    parts: Sequence[dict] = (),
) -> dict:
    """Return the data of a run of any solver.

    If the data exceed `max_bytes`, fewer states are kept, evenly spaced. Without `reference_cost` no cost is shown,
    without `problem` no map. `sought`: numbers of the microphones whose errors are averaged; `microphone`: the one
    whose map is shown first, by default the one that the step moved; `parts`: parts of a lesson, whose "range" is
    changed to the numbers of the states that are kept.
    """
    search, truth = measurement.search, measurement.positions
    if search is not None and truth is not None and measurement.blind:
        # The states are drawn in the frame of the true positions, and so is the search domain.
        search = search_around(states[-1].positions, search, truth)
        measurement = replace(measurement, search=search)
        problem = None if problem is None else replace(problem, search=search)
    settings = getattr(states[-1], "settings", SolverSettings())
    maps, arrays = (None if problem is None else map_data(problem, settings)) or (None, {})
    corrected = maps is not None and any(state.channels is not None for state in states)  # by gains and noise
    (N, D), count = states[0].positions.shape, len(states)
    numbers = (reference_cost is not None) + 2 * (truth is not None)  # cost; mean and largest error
    space = max_bytes - BASE_BYTES - NAME_BYTES * N - sum(a.nbytes for a in arrays.values()) * 4 / 3
    each = 4 * N * (D + 3 * corrected) + 4 * len(STATE_NUMBERS) + 8 * numbers  # bytes of a state before they are coded
    kept = evenly_spaced(count, max(2, int(space / (each * 4 / 3))))
    for part in parts:
        part["range"] = np.searchsorted(kept, part["range"]).tolist()
    ends = [end for part in parts for end in part["range"]]
    changing, table = _state_data(measurement, [states[i] for i in kept], reference_cost, sought, ends, corrected)
    room = None if scene is None or scene.source is None else scene
    fixed = {
        "names": list(measurement.names),
        "known": measurement.known.tolist(),
        "given": np.round(np.asarray(measurement.known_positions, float), 6).tolist(),
        "reference": measurement.reference,
        "aligned": bool(measurement.blind),  # each state is moved as a whole to the true positions
        "dimension": measurement.array_dimension,
        "frequencies": np.round(measurement.frequencies, 3).tolist(),
        "focus": focus_of(measurement),
        "heights": z_range_of(scene, measurement),
        "marks": marks_json(PAGE_MARKS),
        "address": ADDRESS,
        "outline": None if room is None else np.asarray(room.room.vertices, float).tolist(),
        "sources": [] if room is None else [list(place) for place in room.emitter.places],
        "tall": 0.0 if room is None else wall_height(room),
    }
    data = fixed | changing | {"taken": count, "microphone": microphone}
    return data | {"maps": maps, "packed": packed(arrays | table)}


def filled(template: str, parts: Mapping[str, str]) -> str:
    """Return a template with each @NAME@ replaced by the part of that name."""
    return re.sub(r"@([A-Z]+)@", lambda match: parts[match[1]], template)


def _state_data(
    measurement: Measurement, states: Sequence, reference_cost, sought, ends: Sequence[int], corrected: bool
) -> tuple[dict, dict[str, np.ndarray]]:
    """Return the origin and the unit of the positions, metres, and the arrays that change from state to state.

    `ends`: states whose cost is computed in any case; `corrected`: whether the arrays include gain (T, N, 2) and noise
    (T, N) of the channels.
    """
    positions, truth = np.array([state.positions for state in states], float), measurement.positions
    free = np.setdiff1d(np.arange(measurement.count), measurement.known) if sought is None else sought
    counted = free if len(free) else slice(None)
    if measurement.blind and truth is not None:  # aligned by the same microphones as in `Calibration.positions_for`
        positions = np.array([align(estimate, truth, counted) for estimate in positions])
    origin = positions[-1].mean(axis=0)
    unit = float(np.abs(positions - origin).max()) / POSITION_LEVELS or 1.0
    arrays = {name: np.array([getattr(state, name) for state in states], "<i4") for name in STATE_NUMBERS}
    arrays["positions"] = np.rint((positions - origin) / unit).astype("<i4")
    if corrected:
        uncorrected = np.ones(measurement.count)
        gains = np.array([uncorrected if (one := state.channels) is None else one.gains for state in states], complex)
        noise = np.array([uncorrected if (one := state.channels) is None else one.noise for state in states], float)
        arrays |= {"gains": _parts(gains).astype("<f4"), "noise": noise.astype("<f4")}
    if reference_cost is not None:  # dB; interpolated between MAX_COSTS states at most, and `ends`
        computed = np.union1d(evenly_spaced(len(states), MAX_COSTS), ends).astype(int)
        costs = np.array([reference_cost.of(states[i]) for i in computed])
        finite = np.isfinite(costs)
        every = np.arange(len(states))
        arrays["cost"] = np.interp(every, computed[finite], costs[finite]) if finite.any() else 0.0 * every
    if truth is not None:
        errors = np.linalg.norm(positions - truth, axis=2)[:, counted]
        arrays |= {"truth": truth - origin, "mean": errors.mean(axis=1), "largest": errors.max(axis=1)}
    averaged = np.arange(measurement.count)[counted].tolist()  # microphones whose errors are averaged
    return {"count": len(states), "origin": origin.tolist(), "unit": unit, "averaged": averaged}, arrays


THUMBNAIL = 96  # pixels along the longer edge of the map in a picture of the index
MARK_EDGE = 6  # width and height of a symbol in this picture, pixels


def index_html(title: str, introduction: str, entries: Sequence[tuple[str, ...]], opening: str) -> str:
    """Return the index page of a gallery.

    `entries`: for each page its address (file, # and view), title, description, a line of figures (solver, mean error,
    size) and the HTML of a picture; `opening`: the address of the page that plays above the entries.
    """
    cards = "\n".join(
        f'<a href="{escape(file)}">{picture}<h2>{escape(name)}</h2><p>{escape(text)}</p>'
        f"<p class='figures'>{escape(figures)}</p></a>"
        for file, name, text, figures, picture in entries
    )
    middle, scale = EDGE / 2, MARK_EDGE / EDGE
    marks = "".join(
        f'<g id="{name}" transform="scale({scale:g}) translate({-middle:g} {-middle:g})">'
        f"{symbol_svg(MARKS[PAGE_MARKS[name]])}</g>"
        for name in ("true", "estimate")
    )
    parts = {"TITLE": escape(title), "INTRODUCTION": escape(introduction), "CARDS": cards, "MARKS": marks}
    return filled((PAGE / "index.html").read_text(encoding="utf-8"), parts | {"OPENING": escape(opening)})


def picture_of(
    measurement: Measurement, problem: Problem, state: RunState, n: int, modes: Sequence[int], by: Any = slice(None)
) -> str:
    """Return a picture of the map of microphone `n` with the true and the estimated positions, as SVG for the index.

    `modes`: numbers of the modes, from 1; () for all carried ones; `by`: numbers of the microphones by which an array
    without known microphones is aligned.
    """
    reference_cost, domain = reference_cost_of(problem), problem.search
    if reference_cost is None or domain is None:
        return ""
    lattice, offset = refined(domain, THUMBNAIL), reference_cost.order_offset
    chosen = modes or tuple(expansion_of(problem, offset).carried.modes + 1)
    cost = eq7_maps(problem, state.positions, n, chosen, offset, lattice, state.channels).sum(axis=0)
    low, high = colour_limits(cost, True)
    image = Image.fromarray(to_rgb(normalise(cost, low, high, True))[::-1])
    file = io.BytesIO()
    image.save(file, "PNG", optimize=True)
    width, height = image.size
    corner = np.asarray(lattice.origin[:2]) - lattice.step / 2
    truth = measurement.aligned_truth(state.positions, by)
    groups = {"estimate": state.positions} if truth is None else {"true": truth, "estimate": state.positions}
    marks = ""
    for name, group in groups.items():
        places = (np.asarray(group, float)[:, :2] - corner) / lattice.step
        marks += "".join(f'<use href="#{name}" x="{x:.1f}" y="{height - y:.1f}"/>' for x, y in places)
    coded = base64.b64encode(file.getvalue()).decode("ascii")
    return (
        f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="Map with the microphones">'
        f'<image href="data:image/png;base64,{coded}" width="{width}" height="{height}"/>{marks}</svg>'
    )
