"""The one solver thread and its commands.

A session plays, pauses, steps, rewinds and resets a solver without blocking the caller. It does not depend on a user
interface: commands go in through a queue, and one frozen `SessionView` at a time comes out. Only the solver thread
calls the solver's `init`, `step` and `use_modes`. A state holds all that `step` needs, so that a run can be continued
from any of them. This module, `fdcal.session.worker` and, for sums over modes, `fdcal.acoustics.compiled` are the only
ones that use threads.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ..model.validation import frozen_array
from .commands import CommandQueue, YieldTimer
from .history import MOST_STATES, History, SessionView, thinned

YIELD_TIME = 0.15  # s without a step after a request of the user

log = logging.getLogger(__name__)


class Session:
    """A solver on its own thread.

    Parameters
    ----------
    problem : Problem, or whatever the solver's functions take
    settings : scene.SolverSettings; its name selects the solver
    seed : int, of the start
    module : object with `init(problem, settings, seed)`, `step(problem, state)` and
        `use_modes(problem, state, first, last, automatic)`; the solver named in `settings` unless given
    states : sequence of its states, oldest first, with which the history begins; the start alone unless given
    index : int, which of them is shown; the last unless given
    yield_time : float, s without a step after `yield_to_ui`

    It raises what the solver's `init` raises. Later exceptions pause the session and appear in `view.error`.

    Examples
    --------
    >>> session = Session(problem, scene.solver, scene.seed)  # doctest: +SKIP
    >>> session.sweep()  # doctest: +SKIP
    >>> session.wait_for(lambda view: view.state.sweep == 1, timeout=60)  # doctest: +SKIP
    """

    def __init__(
        self,
        problem,
        settings,
        seed: int,
        module=None,
        states=(),
        index: int | None = None,
        yield_time: float = YIELD_TIME,
    ):
        if module is None:
            from .. import solvers

            module = solvers.load(settings.name)
        self._problem, self._settings, self._seed, self._module = problem, settings, int(seed), module
        self._commands, self._yielding = CommandQueue(), YieldTimer(yield_time)
        self._changed = threading.Condition()
        self._states = list(states) or [module.init(problem, settings, self._seed)]
        count = len(self._states)
        index = count - 1 if index is None else min(max(int(index), 0), count - 1)
        self._goal: Callable[[Any], bool] | None = None  # true once the state reached ends the run
        self._pause = 0.0  # s between two steps
        self._stepped = 0.0  # reading of `time.monotonic` at the last step
        self._gesture: object = None  # the gesture that the last state came from, if the user placed a microphone
        self._view = SessionView(self._states[index], index, count, False, "", History(self._states, count))
        self._thread = threading.Thread(target=self._serve, name="fdcal-solver", daemon=True)
        self._thread.start()

    @property
    def view(self) -> SessionView:
        """The newest published view; cheap, from any thread."""
        return self._view

    def play(self) -> None:
        """Run until `pause` or until the solver has finished."""
        self._commands.put(("play",))

    def pause(self) -> None:
        """Stop after the present step."""
        self._commands.put(("pause",))

    def step(self, count: int = 1) -> None:
        """Take one step (one microphone), or `count` of them."""
        self._commands.put(("step", int(count)))

    def sweep(self, count: int = 1) -> None:
        """Run until the state's sweep number has risen by `count` or the solver has finished."""
        self._commands.put(("sweep", int(count)))

    def stage(self, count: int = 1) -> None:
        """Run until the state's stage number has risen by `count` or the solver has finished."""
        self._commands.put(("stage", int(count)))

    def pace(self, rate: float) -> None:
        """Take at most `rate` steps per second while running; 0 stands for no limit."""
        self._commands.put(("pace", float(rate)))

    def yield_to_ui(self) -> None:
        """Begin no step for `yield_time` seconds, so that the user interface can respond to the user.

        Continuous requests slow the run down to one step in twice that time, and do not stop it.
        """
        self._yielding.request()

    def reset(self, seed: int | None = None, settings=None) -> None:
        """Restart, with `seed` or the last one used, and perhaps with other `settings`, another solver included."""
        self._commands.put(("reset", seed, settings))

    def place(self, microphone: int, position, gesture: object = None) -> None:
        """Move a microphone to `position`, metres, its first coordinates or all of them, and pause.

        Moves of one `gesture` (any object but None) make one state of the history.
        """
        self._commands.put(("place", int(microphone), tuple(map(float, position)), gesture))

    def seek(self, index: int) -> None:
        """Show state `index` of the history (clipped to it) and pause; continuing from there drops the later ones."""
        self._commands.put(("seek", int(index)))

    def use_modes(self, first: int, last: int, automatic: bool) -> None:
        """Set the modes in use (counted from 1, inclusive) and whether the solver adds more."""
        self._commands.put(("use_modes", int(first), int(last), bool(automatic)))

    @property
    def alive(self) -> bool:
        """Whether the solver thread still runs."""
        return self._thread.is_alive()

    def close(self, timeout: float = 2.0) -> bool:
        """End the thread after the present step; return False if that takes longer than `timeout` seconds."""
        self._commands.put(("close",))
        self._thread.join(timeout)
        return not self.alive

    def wait_for(self, predicate: Callable[[SessionView], bool], timeout: float | None = None) -> bool:
        """Block until `predicate(view)` is true; return False if it is not within `timeout` seconds."""
        with self._changed:
            return self._changed.wait_for(lambda: predicate(self._view), timeout)

    # Below: the solver thread alone.

    def _serve(self) -> None:
        while True:
            for command in self._pending():
                if command[0] == "close":
                    self._goal = None
                    self._publish(running=False)
                    return
                self._guarded(getattr(self, f"_on_{command[0]}"), *command[1:])
            if self._goal is not None and time.monotonic() >= self._yielding.until:
                self._guarded(self._advance)
                self._stepped = time.monotonic()
                self._yielding.step_taken()
            time.sleep(0)  # release the interpreter: a solver that never does would starve the page

    def _pending(self) -> list[tuple]:
        """The commands that wait; when idle, or before the next step is due, this blocks for one."""
        if self._goal is None:
            return self._commands.take(None)
        return self._commands.take(max(self._stepped + self._pause, self._yielding.until) - time.monotonic())

    def _guarded(self, function: Callable, *arguments) -> None:
        """Call a function of this thread; an exception pauses the session and is shown, the thread continues."""
        try:
            function(*arguments)
        except Exception as error:
            log.exception("the solver stopped at state %d", self._view.index)
            self._goal = None
            self._publish(running=False, error=f"{type(error).__name__}: {error}")

    def _publish(self, **changes) -> None:
        with self._changed:
            self._view = replace(self._view, **changes)
            self._changed.notify_all()

    def _keep(self, states: list, error: str = "", lineage: object = None) -> None:
        """Show the last of `states`. Published lists are only appended to, never cut."""
        self._states, count = states, len(states)
        self._gesture = None
        self._publish(
            state=states[-1],
            index=count - 1,
            count=count,
            running=self._goal is not None,
            error=error,
            history=History(states, count, lineage),
        )

    def _up_to(self, count: int) -> tuple[list, object]:
        """The first `count` states, as a list that may be appended to, and the lineage that they continue."""
        if count < len(self._states):
            return self._states[:count], None
        states = self._states if count < MOST_STATES else thinned(self._states)
        return states, self._view.history.lineage

    def _advance(self) -> None:
        """One step from the state that is shown, unless it is finished."""
        view = self._view
        if view.state.finished:
            self._goal = None
            self._publish(running=False)
            return
        state = self._module.step(self._problem, view.state)
        if state.finished or self._goal is None or self._goal(state):
            self._goal = None
        states, lineage = self._up_to(view.index + 1)
        states.append(state)
        self._keep(states, lineage=lineage)

    def _run(self, goal: Callable[[Any], bool]) -> None:
        self._goal = goal
        self._publish(running=True, error="")

    def _on_play(self) -> None:
        self._run(lambda state: False)

    def _on_pause(self) -> None:
        self._goal = None
        self._publish(running=False)

    def _on_step(self, count: int) -> None:
        end = self._view.state.step + count
        self._goal = lambda state: state.step >= end
        self._advance()

    def _on_sweep(self, count: int) -> None:
        end = self._view.state.sweep + count
        self._run(lambda state: state.sweep >= end)

    def _on_stage(self, count: int) -> None:
        end = self._view.state.stage + count
        self._run(lambda state: state.stage >= end)

    def _on_pace(self, rate: float) -> None:
        self._pause = 1 / rate if rate > 0 else 0.0

    def _on_reset(self, seed: int | None, settings=None) -> None:
        seed, module = self._seed if seed is None else int(seed), self._module
        if settings is None:
            settings = self._settings
        elif settings.name != self._settings.name:
            from .. import solvers

            module = solvers.load(settings.name)
        state = module.init(self._problem, settings, seed)
        self._module, self._settings, self._seed, self._goal = module, settings, seed, None
        self._keep([state])

    def _on_seek(self, index: int) -> None:
        self._goal = self._gesture = None
        index = min(max(index, 0), len(self._states) - 1)
        self._publish(state=self._states[index], index=index, running=False)

    def _on_use_modes(self, first: int, last: int, automatic: bool) -> None:
        """Replace the state that is shown: a slider that is dragged must not fill the history."""
        state = self._module.use_modes(self._problem, self._view.state, first, last, automatic)
        self._keep([*self._states[: self._view.index], state])

    def _on_place(self, microphone: int, position: tuple, gesture: object) -> None:
        """Append a state with the microphone moved; the next one of the same gesture replaces it."""
        old = self._view.state
        positions = np.array(old.positions)
        positions[microphone, : len(position)] = position  # a move in the plan view leaves the height as it is
        state = replace(old, positions=frozen_array(positions, float))
        state = self._module.use_modes(self._problem, state, old.first, old.last, old.automatic)
        kept = self._view.index + (0 if gesture is not None and gesture == self._gesture else 1)
        self._goal = None
        self._keep([*self._states[:kept], state])
        self._gesture = gesture
