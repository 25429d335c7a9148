"""The frame in which the page draws: that of the true positions, which therefore stand still during a run.

The pressures of a blind array determine neither where it stands nor how it is turned nor which of two mirror images it
is. Each state is therefore moved as a whole onto the true positions before it is drawn, and what a user places is moved
back before the session gets it. Of every other array nothing is moved.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from ..model.gauge import align, rigid_motion
from ..model.validation import Reals, frozen_array
from ..session.session import SessionView
from ..solvers.interface import RunState
from .background.prepare import Last, PreparedRun, Same

ROUNDS = 100  # at most, until a placed microphone is drawn where it was placed
NEGLIGIBLE = 1e-12  # m


def anchor_of(run: PreparedRun) -> Reals | None:
    """Return the true positions onto which the page moves each state (N, D), metres; None where it moves none."""
    moves = run.measurement.blind and not run.solver.TRAITS.needs_room  # a known room determines the frame
    return run.measurement.positions if moves else None


def drawn_truth(run: PreparedRun, positions: Any) -> Reals | None:
    """Return the true positions beside the `positions` that the page draws; None where they are unknown."""
    anchor = anchor_of(run)
    return run.measurement.aligned_truth(positions) if anchor is None else anchor


class DisplayFrame:
    """Moves positions (N, D), metres, into the frame of the page and back.

    `by`: the microphones that determine the motion, all at first.
    """

    def __init__(self, run: PreparedRun):
        self._run, self._anchor = run, anchor_of(run)
        self.by = np.arange(run.measurement.count)
        self._moved = Last()

    def move_by(self, microphones: np.ndarray) -> None:
        """Let these microphones determine the motion: those whose errors count."""
        if not np.array_equal(microphones, self.by):
            self.by = microphones

    def positions(self, positions: Any) -> Reals:
        """Return positions as the page draws them."""
        x = np.asarray(positions, float)
        return x if self._anchor is None else align(x, self._anchor, self.by)

    def truth(self, positions: Any) -> Reals | None:
        """Return the true positions beside the `positions` that the page draws; None where they are unknown."""
        return drawn_truth(self._run, positions)

    def state(self, state: RunState) -> RunState:
        """Return a state with its positions as the page draws them; the same one for the same as last time."""
        if self._anchor is None:
            return state
        return self._moved.of(
            lambda: replace(state, positions=frozen_array(self.positions(state.positions), float)),
            Same(state), Same(self.by),
        )  # fmt: skip

    def view(self, view: SessionView) -> SessionView:
        """Return the view of a session with the state that is shown as the page draws it; the history is as it was."""
        return replace(view, state=self.state(view.state))

    def axes(self, positions: Any, axes: Reals) -> Reals:
        """Return half axes (N, D, D) of ellipses around positions, in rows, as the page draws them."""
        return axes if self._anchor is None else axes @ self._motion(positions, self._anchor)[0]

    def placed(self, positions: Any, microphone: int, place: Any) -> np.ndarray:
        """Return where a session has to place a microphone so that the page draws it at a place, its last state known.

        `positions`: of the state of the session; `place`: its first coordinates or all of them. The array turns a
        little with each microphone, so that the place is found by repetition.
        """
        place = np.asarray(place, float)
        if self._anchor is None:
            return place
        moved = np.array(positions, float)
        wanted = self.positions(moved)[microphone]
        wanted[: len(place)] = place
        for _ in range(ROUNDS):
            turn, centre, target = self._motion(moved, self._anchor)
            back = (wanted - target) @ turn.T + centre
            change = float(np.abs(back - moved[microphone]).max())
            moved[microphone] = back
            if change < NEGLIGIBLE:
                break
        return moved[microphone]

    def _motion(self, positions: Any, anchor: Reals) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return rigid_motion(np.asarray(positions)[self.by], anchor[self.by])
