"""Solver "joint": the likelihood solver (`fdcal.solvers.robust`) for matched channels and exact given positions.

The gains are fixed, except that of a channel with a gross fault such as inverted polarity. Microphones with a given
position never move. In space the field stays isotropic, since learning the power of hundreds of directions would take
most of the time. This preset takes a third to three quarters of the time of "robust".
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ..model.problem import Problem
from ..model.settings import SolverSettings
from . import robust
from .interface import Traits
from .robust import landscape, require_solvable, result, step, usable_modes, use_modes
from .robust.schedule import begin

__all__ = ["TRAITS", "State", "init", "landscape", "result", "step", "usable_modes", "use_modes"]

TRAITS: Traits = replace(
    robust.TRAITS, starts=("affine", "random"), settings=frozenset("modes noise known start sound_speed_sigma".split())
)


@dataclass(frozen=True)
class State(robust.State):
    """State of the likelihood solver with the preset of this module."""

    solver: ClassVar[str] = "joint"
    quick: ClassVar[bool] = True


def init(problem: Problem, settings: SolverSettings, seed: int, positions: np.ndarray | None = None) -> State:
    """Return the first state: at `positions` (N, D), metres, at a random start, or at the first start of the search.

    Raises InputError for too few modes or microphones, known positions that do not fix the gauge, or a random start
    without a search domain.
    """
    from . import starts

    require_solvable(problem, settings)
    if positions is None and settings.start == "random":
        positions = starts.random(problem, np.random.default_rng([seed, 0]))
    found = begin(State, problem, replace(settings, gains="fixed", known_sigma=0.0), seed, positions)
    assert isinstance(found, State)
    return found
