"""State of block coordinate descent: all that one step needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...model.settings import SolverSettings
from ..interface import RunState


@dataclass(frozen=True)
class State(RunState):
    """Everything `step` needs. A run can be continued from any state.

    Attributes
    ----------
    centre : (D,) float64, metres, centre of the expansion, read-only
    turn : int, steps taken in the present sweep, 0 to the number of free microphones less 1
    stage_sweeps : int, sweeps completed in the present stage
    changed : bool, whether a microphone has moved in the present sweep
    cost : sum over the modes in use (Eq. 7), about the centre that the last step used
    """

    solver: ClassVar[str] = "descent"

    centre: np.ndarray
    turn: int
    stage_sweeps: int
    changed: bool

    @property
    def order_offset(self) -> int:
        """The number added to ceil(kR) with the modes in use (`order_offset_of`)."""
        return order_offset_of(self.settings, self.last)

    @property
    def landscape_takes_lattice(self) -> bool:
        """Whether it is of three dimensions; in a plane the landscape is that of the search domain, about `centre`."""
        return len(self.centre) == 3


def order_offset_of(settings: SolverSettings, modes: int) -> int:
    """Return the number added to ceil(kR) in the order rule.

    It is 0 below `settings.ample_modes` modes: with more functions, few modes can be fitted at any positions.
    """
    return settings.order_offset if modes >= settings.ample_modes else 0
