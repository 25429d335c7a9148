"""What a page shows of a comparison of solvers: which are compared, and how far each has come."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...session.history import SessionView
from ...solvers.interface import RunState

MAX_POINTS = 60  # of the curves of one run


@dataclass(frozen=True)
class ComparisonSetup:
    """Which solvers are compared, and from where they start."""

    names: tuple[str, ...]  # of the solvers
    start: str  # of the positions, as in scene.Solver
    seed: int  # of the random start


@dataclass(frozen=True)
class RunSummary:
    """One run of a comparison, as it is shown."""

    name: str  # of the solver
    positions: np.ndarray  # (N, D) float64, metres
    status: str  # "running", "converged", ...
    step: int
    seconds: float  # processor time since the start, s
    # mean_error, largest_error: of the positions sought, mm; None where the true positions are unknown
    mean_error: float | None
    largest_error: float | None
    times: np.ndarray  # (P,) float64, s, of the points of the curves
    mean_errors: np.ndarray | None  # (P,) float64, mm, or None
    costs: np.ndarray  # (P,) float64, dB, of `fdcal.cost.reference_cost`
    cost: float | None = None  # dB, of the positions themselves; None until it is computed


def status_word(state: RunState, running: bool) -> str:
    """Return what a run of a comparison is doing, by its newest state and by whether it runs."""
    if running:
        return "running" if state.step else "preparing the first step"
    return ("converged" if state.converged else "not converged") if state.finished else "waiting"


def drawn_states(view: SessionView) -> list[RunState]:
    """Return the states that the curves of a run pass through: ever more of them on the same grid, and the last."""
    count = view.index + 1
    stride = 1
    while count / stride > MAX_POINTS:
        stride *= 2
    return [*view.history[0:count:stride], view.state]
