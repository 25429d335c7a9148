"""The cost of a result in decibels, the one number by which results of all solvers can be compared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..cost.yardstick import yardstick_of
from ..model.search_domain import search_round
from .assess import Assessment


def cost_in_decibels(found: Assessment) -> float | None:
    """Return Eq. 7 over all modes that the microphones can carry, dB of their power, as `fdcal.cost.yardstick`.

    A problem without a search domain gets one round the positions found, as on the page.

    Parameters
    ----------
    found : Assessment

    Returns
    -------
    float or None
        None where a position is not finite, or the microphones are too few for any mode.
    """
    problem = found.problem
    if not np.isfinite(found.positions).all():
        return None
    if problem.search is None:
        problem = replace(problem, search=search_round(found.positions))
    yardstick = yardstick_of(problem)
    if yardstick is None:
        return None
    cost = yardstick(found.positions, None if found.channels is None else found.channels.correction)
    return cost if np.isfinite(cost) else None
