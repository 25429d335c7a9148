"""The maps of single modes and of their sum that belong to one request, and what they are called."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...cost.expansion import expansion_of
from ...cost.maps import cost_maps, power_shares, refined
from ...graphics.heatmap import cost_label
from ...graphics.units import row_word
from ...model.measurement import Measurement
from ...model.settings import Search
from ...model.validation import InputError
from ...solvers.interface import RunState
from .map_request import CostMapRequest
from .prepare import PreparedRun

MAX_PANELS = 9  # maps of single modes that are drawn one by one


@dataclass(frozen=True)
class ModePanels:
    """Maps of single modes, on the lattice of the map on the floor."""

    modes: tuple[int, ...]  # (K,) int, counted from 1
    maps: np.ndarray  # (K, ny, nx) float64
    total: np.ndarray  # (ny, nx) float64, the sum over all modes of the request
    search: Search  # the lattice


def map_label(run: PreparedRun, request: CostMapRequest) -> str:
    """Return name and unit of what a map shows."""
    if request.order_offset is not None:
        return "cost, Eq. 7 (dB)" if request.style.log else "cost, Eq. 7 (relative to the power)"
    if run.solver.TRAITS.uses_likelihood:
        return "negative log-likelihood of the solver"
    return cost_label(run.scene.solver.weights).replace("cost", "cost of the solver")


def row_label(measurement: Measurement, mode: int) -> str:
    """Return which row a map is of: "mode 38, 211.5 Hz", or, of several takes, "row 38, take 1, 211.5 Hz"."""
    take = f", take {measurement.takes[mode - 1]}" if measurement.take_count > 1 else ""
    return f"{row_word(measurement)} {mode}{take}, {measurement.frequencies[mode - 1]:.1f} Hz"


def count_label(measurement: Measurement, modes: tuple[int, ...]) -> str:
    """Return how many rows are summed: "20 modes", or, of several takes, "20 rows of take 1", "40 rows of 2 takes"."""
    count, takes = len(modes), np.unique(measurement.takes[np.asarray(modes) - 1])
    text = f"{count} {row_word(measurement)}{'s' if count > 1 else ''}"
    if measurement.take_count == 1:
        return text
    return f"{text} of {f'take {takes[0]}' if len(takes) == 1 else f'{len(takes)} takes'}"


def modes_label(measurement: Measurement, modes: tuple[int, ...]) -> str:
    """Return which modes a map is of, ascending: "mode 38", "modes 1 to 20", "4 modes from 2 to 9"."""
    first, last, count = modes[0], modes[-1], len(modes)
    if measurement.take_count > 1:
        return count_label(measurement, modes) if count > 1 else f"row {first}, take {measurement.takes[first - 1]}"
    if count == 1:
        return f"mode {first}"
    return f"modes {first} to {last}" if last - first + 1 == count else f"{count} modes from {first} to {last}"


def map_modes(
    run: PreparedRun,
    state: RunState,
    chosen: tuple[int, ...] | None,
    order_offset: int | None,
    take: int | None = None,
) -> tuple[int, ...]:
    """Return the modes of a map, counted from 1.

    `state`: of the solver; `chosen`: by the user; None for the modes in use, of Eq. 7 those that the microphones can
    carry, if there are any; `order_offset`: of the map of Eq. 7; None for what the solver minimises; `take`: whose rows
    alone are shown, the lowest where none of its rows is chosen; None for those of all takes.
    """
    if chosen is not None:
        return of_take(run, chosen, take)
    used = of_take(run, tuple(range(state.first, state.last + 1)), take)
    carried = set(carried_modes(run, order_offset, max(state.last, used[-1])))
    return tuple(mode for mode in used if mode in carried) or used


def of_take(run: PreparedRun, modes: tuple[int, ...], take: int | None) -> tuple[int, ...]:
    """Return those of some modes that belong to a take, its lowest where none does; all for None."""
    if take is None:
        return modes
    takes = run.problem.takes
    return tuple(mode for mode in modes if takes[mode - 1] == take) or (int(np.argmax(takes == take)) + 1,)


def carried_modes(run: PreparedRun, order_offset: int | None, last: int) -> tuple[int, ...]:
    """Return the modes up to `last`, counted from 1, of which the microphones can carry a map of Eq. 7.

    Without a search domain, and for a map of what the solver minimises (`order_offset` None), these are all.
    """
    if order_offset is None or run.problem.search is None:
        return tuple(range(1, last + 1))
    carried = expansion_of(run.problem, order_offset).carried.modes + 1
    return tuple(int(mode) for mode in carried if mode <= last)


def shown_modes(count: int, most: int = MAX_PANELS) -> np.ndarray:
    """Return which of `count` maps are drawn one by one, evenly spaced : indices."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def fine_panels(
    run: PreparedRun, request: CostMapRequest, cancelled: Callable[[], bool] = lambda: False, most: int = MAX_PANELS
) -> ModePanels | None:
    """Return the maps of a request on a lattice as fine as the screen, computed mode by mode; None once cancelled.

    `cancelled`: tells whether the maps are no longer wanted; `most`: maps of single modes that are kept. Raises
    InputError: there is no search domain, or a mode cannot be shown at the order of the request.
    """
    problem, modes, offset = run.problem, request.modes, request.order_offset
    if problem.search is None:
        raise InputError("there is no map without a search domain", "give <search> and <radius>", key="search")
    search, shown = refined(problem.search), set(shown_modes(len(modes), most).tolist())
    share = np.ones(len(modes)) if offset is None else power_shares(problem, request.state, modes)
    total, kept = np.zeros(1), []
    for i, mode in enumerate(modes):
        if cancelled():
            return None
        cost = cost_maps(problem, run.solver, request.state, request.microphone, (mode,), offset, search)[0]
        total = total + share[i] * cost
        if i in shown:
            kept.append(share[i] * cost)
    return ModePanels(tuple(modes[i] for i in sorted(shown)), np.stack(kept), total, search)
