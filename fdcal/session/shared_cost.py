"""The cost of a result in decibels, the one number by which results of all solvers can be compared."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..cost.reference_cost import reference_cost_of
from ..model.search_domain import search_round

if TYPE_CHECKING:
    from ..assessment.assess import Assessment


def cost_in_decibels(found: Assessment) -> float | None:
    """Return Eq. 7 over all modes that the microphones can carry, dB of their power, as `fdcal.cost.reference_cost`.

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
    reference_cost = reference_cost_of(problem)
    if reference_cost is None:
        return None
    cost = reference_cost(found.positions, None if found.channels is None else found.channels.correction)
    return cost if np.isfinite(cost) else None
