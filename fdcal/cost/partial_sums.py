"""The landscape of one microphone while modes are added one by one: partial sums of the cost, and their local minima.

partial_sums    maps of the first mode, of the first two, and so on
ambiguous_mode  the mode whose own map has most local minima
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..model.problem import Problem
from ..model.settings import Search
from .landscapes import cost_maps, local_minima, power_shares


@dataclass(frozen=True)
class PartialSum:
    """The map of some modes.

    Attributes
    ----------
    modes : in the order in which they were added, counted from 1
    cost : (ny, nx) float64, of Eq. 7 relative to the power of the pressures of these modes
    minima : (K, 2) int64, rows and columns of its local minima, the lowest first
    """

    modes: tuple[int, ...]
    cost: np.ndarray
    minima: np.ndarray


def partial_sums(
    problem: Problem,
    solver,
    state,
    n: int,
    modes: Sequence[int],
    order_offset: int | None,
    search: Search | None = None,
    counts: Sequence[int] | None = None,
) -> Iterator[PartialSum]:
    """Yield the map of the first of `modes`, of the first two, and so on to all of them.

    The work of a step is that of one mode. Parameters are as of `landscapes.cost_maps`, with which each sum agrees.

    Parameters
    ----------
    modes : (P,) int, counted from 1, in the order in which they are added
    counts : how many modes the sums have that are yielded, ascending; 1 to P unless given

    Raises
    ------
    InputError
        There is no search domain, or a mode cannot be shown at this order.
    """
    modes, counts = tuple(modes), range(1, len(modes) + 1) if counts is None else counts
    share = np.ones(len(modes)) if order_offset is None else power_shares(problem, state, modes)
    total, power = np.zeros(1), 0.0
    for i, mode in enumerate(modes):
        total = total + share[i] * cost_maps(problem, solver, state, n, (mode,), order_offset, search)[0]
        power += share[i]
        if i + 1 in counts:
            cost = total if order_offset is None else total / power
            yield PartialSum(modes[: i + 1], cost, local_minima(cost))


def ambiguous_mode(problem: Problem, solver, state, n: int, modes: Sequence[int], order_offset: int | None) -> int:
    """Return the mode whose map over the search lattice has most local minima, the lowest of several.

    Parameters are as of `partial_sums`.
    """
    counts = [len(local_minima(cost_maps(problem, solver, state, n, (mode,), order_offset)[0])) for mode in modes]
    return int(modes[int(np.argmax(counts))])
