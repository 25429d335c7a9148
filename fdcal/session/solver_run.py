"""What the solver thread does: it carries out commands, one step or one change of state at a time.

`fdcal.session.session` owns the thread and calls these functions from it alone.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from ..model.validation import frozen_array
from ..solvers.interface import bounded
from .commands import Advance, Close, Command, Pace, Pause, Place, Play, Reset, Seek, UseModes
from .history import MOST_STATES, History, SessionView, thinned
from .state_costs import StateCosts

log = logging.getLogger(__name__)


class SolverRun:
    """The states of a run and the commands that change them; for one thread.

    `problem`: or whatever the solver's functions take; `settings`: its name selects the solver; `seed`: of the start;
    `module`: has `init`, `step` and `use_modes`; the solver named in `settings` unless given; `states`: with which the
    history begins, oldest first; the start alone if empty; `index`: which of them is shown; the last unless given;
    `on_change`: called after `view` has changed; `costs`: of the states. `view`: the newest view, frozen; any thread
    may read it; `pause_between_steps`: least time between two steps, s.
    """

    def __init__(
        self,
        problem,
        settings,
        seed: int,
        module,
        states,
        index: int | None,
        on_change: Callable[[], None],
        costs: StateCosts | None = None,
    ):
        self._problem, self._settings, self._seed = problem, settings, int(seed)
        self._module = _solver(settings.name) if module is None else module
        self._on_change, self._costs = on_change, costs or StateCosts()
        self._states = list(states) or [self._module.init(problem, settings, self._seed)]
        count = len(self._states)
        index = count - 1 if index is None else min(max(int(index), 0), count - 1)
        self._goal: Callable[[Any], bool] | None = None  # true once the state reached ends the run
        self._gesture: object = None  # the gesture that the last state came from, if the user placed a microphone
        self.pause_between_steps = 0.0
        history = History(self._states, count)
        self._costs.compute(self._states[index])
        self.view = SessionView(self._states[index], index, count, False, "", history, self._costs)

    @property
    def running(self) -> bool:
        """Whether there is a goal that has not been reached."""
        return self._goal is not None

    def guarded(self, function: Callable, *arguments) -> None:
        """Call a function; an exception pauses the run and is shown in the view."""
        try:
            function(*arguments)
        except Exception as error:
            log.exception("the solver stopped at state %d", self.view.index)
            self._goal = None
            self._publish(running=False, error=f"{type(error).__name__}: {error}")

    def execute(self, command: Command) -> None:
        """Carry out a command."""
        match command:
            case Play():
                self._run_to(lambda state: False)
            case Pause() | Close():
                self.pause()
            case Advance(unit, count):
                self.advance_by(unit, count)
            case Pace(rate):
                self.pause_between_steps = 1 / rate if rate > 0 else 0.0
            case Reset(seed, settings):
                self.reset(seed, settings)
            case Place(microphone, position, gesture):
                self.place(microphone, position, gesture)
            case Seek(index):
                self.seek(index)
            case UseModes(first, last, automatic):
                self.use_modes(first, last, automatic)

    def _publish(self, **changes) -> None:
        self.view = replace(self.view, **changes)
        self._on_change()

    def _keep(self, states: list, error: str = "", lineage: object = None, dragged: bool = False) -> None:
        """Show the last of `states`. Published lists are only appended to, never cut.

        The cost of a state that the next move of a drag will replace is computed when there is time (`fill_in`).
        """
        self._states, count = states, len(states)
        self._gesture = None
        if self._goal is None and not dragged:
            self._costs.compute(states[-1])
        self._publish(
            state=states[-1],
            index=count - 1,
            count=count,
            running=self._goal is not None,
            error=error,
            history=History(states, count, lineage),
        )

    def _up_to(self, count: int) -> tuple[list, object]:
        """Return the first `count` states, as a list that may be appended to, and the lineage that they continue."""
        if count < len(self._states):
            return self._states[:count], None
        states = self._states if count < MOST_STATES else thinned(self._states)
        return states, self.view.history.lineage

    def advance(self) -> None:
        """Take one step from the state that is shown, unless it is finished."""
        view = self.view
        if view.state.finished:
            self._goal = None
            self._publish(running=False)
            return
        began = time.thread_time()
        state = bounded(self._problem, view.state, self._module.step(self._problem, view.state))
        self._costs.compute_in_passing(state, time.thread_time() - began)
        if state.finished or self._goal is None or self._goal(state):
            self._goal = None
        states, lineage = self._up_to(view.index + 1)
        states.append(state)
        self._keep(states, lineage=lineage)

    def _run_to(self, goal: Callable[[Any], bool]) -> None:
        self._goal = goal
        self._publish(running=True, error="")

    def pause(self) -> None:
        """Stop after the present step."""
        self._goal = None
        self._costs.compute(self.view.state)
        self._publish(running=False)

    def advance_by(self, unit: Literal["step", "sweep", "stage"], count: int) -> None:
        """Run until the number of the state's step, sweep or stage has risen by `count`; the first step at once."""
        end = getattr(self.view.state, unit) + count
        if unit == "step":
            self._goal = lambda state: state.step >= end
            self.advance()
        else:
            self._run_to(lambda state: getattr(state, unit) >= end)

    def reset(self, seed: int | None, settings=None) -> None:
        """Restart, with `seed` or the last one used, and perhaps with other `settings`."""
        seed, module = self._seed if seed is None else int(seed), self._module
        if settings is None:
            settings = self._settings
        elif settings.name != self._settings.name:
            module = _solver(settings.name)
        state = module.init(self._problem, settings, seed)
        self._module, self._settings, self._seed, self._goal = module, settings, seed, None
        self._keep([state])

    def seek(self, index: int) -> None:
        """Show state `index` of the history, clipped to it, and pause."""
        self._goal = self._gesture = None
        index = min(max(index, 0), len(self._states) - 1)
        self._costs.compute(self._states[index])
        self._publish(state=self._states[index], index=index, running=False)

    def use_modes(self, first: int, last: int, automatic: bool) -> None:
        """Replace the state that is shown: a slider that is dragged must not fill the history."""
        state = self._module.use_modes(self._problem, self.view.state, first, last, automatic)
        self._keep([*self._states[: self.view.index], state])

    @property
    def costs_missing(self) -> bool:
        """Whether costs were left out while the solver ran."""
        return bool(self._costs.missing(self.view.history))

    def fill_in(self) -> None:
        """Compute one of the costs that were left out."""
        for state in self._costs.missing(self.view.history)[:1]:
            self._costs.compute(state)

    def place(self, microphone: int, position: tuple, gesture: object) -> None:
        """Append a state with the microphone moved; the next one of the same gesture replaces it."""
        old = self.view.state
        positions = np.array(old.positions)
        positions[microphone, : len(position)] = position  # a move in the plan view leaves the height as it is
        state = replace(old, positions=frozen_array(positions, float))
        state = self._module.use_modes(self._problem, state, old.first, old.last, old.automatic)
        dragged = gesture is not None and gesture == self._gesture
        self._goal = None
        self._keep([*self._states[: self.view.index + (not dragged)], state], dragged=dragged)
        self._gesture = gesture


def _solver(name: str):
    """Return the solver of a name; it is imported here, because that takes seconds."""
    from .. import solvers

    return solvers.load(name)
