"""The one solver thread and its commands.

A session plays, pauses, steps, rewinds and resets a solver without blocking the caller. It does not depend on a user
interface: commands go in through a queue, and one frozen `SessionView` at a time comes out. Only the solver thread
calls the solver's `init`, `step` and `use_modes`. A state holds all that `step` needs, so that a run can be continued
from any of them. This module, `fdcal.session.worker` and, for sums over modes, `fdcal.acoustics.compiled` are the only
ones that use threads; `fdcal.session.solver_run` holds what the solver thread does.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from .commands import (
    Advance,
    Close,
    Command,
    CommandQueue,
    Pace,
    Pause,
    Place,
    Play,
    Reset,
    Seek,
    UseModes,
    YieldTimer,
)
from .history import SessionView
from .solver_run import SolverRun
from .state_costs import StateCosts

YIELD_TIME = 0.15  # s without a step after a request of the user


class Session:
    """A solver on its own thread.

    `problem`: or whatever the solver's functions take; `settings`: its name selects the solver; `seed`: of the start;
    `module`: has `init(problem, settings, seed)`, `step(problem, state)` and `use_modes(problem, state, first, last,
    automatic)`; the solver named in `settings` unless given; `states`: with which the history begins, oldest first; the
    start alone unless given; `index`: which of them is shown; the last unless given; `reference_cost`: returns the cost
    of a state, dB, by which those of all solvers are compared (`fdcal.cost.reference_cost`); without one their cost is
    NaN; `yield_time`: time without a step after `yield_to_ui`, s. Raises Exception: what the solver's `init` raises.
    Later exceptions pause the session and appear in `view.error`.

    Examples
    --------
    >>> import fdcal
    >>> scene = fdcal.load_scene("tiny")
    >>> session = Session(fdcal.simulate(scene).problem(), scene.solver, scene.seed)
    >>> session.sweep()
    >>> session.wait_for(lambda view: view.state.sweep == 1, timeout=60)
    True
    >>> session.close(timeout=60)
    True
    """

    def __init__(
        self,
        problem,
        settings,
        seed: int,
        module=None,
        states=(),
        index: int | None = None,
        reference_cost: Callable[..., float] | None = None,
        yield_time: float = YIELD_TIME,
    ):
        self._commands, self._yielding = CommandQueue(), YieldTimer(yield_time)
        self._changed = threading.Condition()
        self._stepped = 0.0  # reading of `time.monotonic` at the last step
        self._run = SolverRun(problem, settings, seed, module, states, index, self._notify, StateCosts(reference_cost))
        self._thread = threading.Thread(target=self._serve, name="fdcal-solver", daemon=True)
        self._thread.start()

    @property
    def view(self) -> SessionView:
        """The newest published view; cheap, from any thread."""
        return self._run.view

    def play(self) -> None:
        """Run until `pause` or until the solver has finished."""
        self._commands.put(Play())

    def pause(self) -> None:
        """Stop after the present step."""
        self._commands.put(Pause())

    def step(self, count: int = 1) -> None:
        """Take one step (one microphone), or `count` of them."""
        self._commands.put(Advance("step", int(count)))

    def sweep(self, count: int = 1) -> None:
        """Run until the state's sweep number has risen by `count` or the solver has finished."""
        self._commands.put(Advance("sweep", int(count)))

    def stage(self, count: int = 1) -> None:
        """Run until the state's stage number has risen by `count` or the solver has finished."""
        self._commands.put(Advance("stage", int(count)))

    def pace(self, rate: float) -> None:
        """Take at most `rate` steps per second while running; 0 stands for no limit."""
        self._commands.put(Pace(float(rate)))

    def yield_to_ui(self) -> None:
        """Begin no step for `yield_time` seconds, so that the user interface can respond to the user.

        Continuous requests slow the run down to one step in twice that time, and do not stop it.
        """
        self._yielding.request()

    def reset(self, seed: int | None = None, settings=None) -> None:
        """Restart, with `seed` or the last one used, and perhaps with other `settings`, another solver included."""
        self._commands.put(Reset(seed, settings))

    def place(self, microphone: int, position, gesture: object = None) -> None:
        """Move a microphone to `position`, metres, its first coordinates or all of them, and pause.

        Moves of one `gesture` (any object but None) make one state of the history.
        """
        self._yielding.request()
        self._commands.put(Place(int(microphone), tuple(map(float, position)), gesture))

    def seek(self, index: int) -> None:
        """Show state `index` of the history (clipped to it) and pause; continuing from there drops the later ones."""
        self._commands.put(Seek(int(index)))

    def use_modes(self, first: int, last: int, automatic: bool) -> None:
        """Set the modes in use (counted from 1, inclusive) and whether the solver adds more."""
        self._commands.put(UseModes(int(first), int(last), bool(automatic)))

    @property
    def alive(self) -> bool:
        """Whether the solver thread still runs."""
        return self._thread.is_alive()

    def close(self, timeout: float = 2.0) -> bool:
        """End the thread after the present step; return False if that takes longer than `timeout` seconds."""
        self._commands.put(Close())
        self._thread.join(timeout)
        return not self.alive

    def wait_for(self, predicate: Callable[[SessionView], bool], timeout: float | None = None) -> bool:
        """Block until `predicate(view)` is true; return False if it is not within `timeout` seconds."""
        with self._changed:
            return self._changed.wait_for(lambda: predicate(self._run.view), timeout)

    # Below: the solver thread alone.

    def _notify(self) -> None:
        with self._changed:
            self._changed.notify_all()

    def _serve(self) -> None:
        while True:
            for command in self._pending():
                if isinstance(command, Close):
                    self._run.pause()
                    return
                self._run.guarded(self._run.execute, command)
            if time.monotonic() >= self._yielding.until:
                self._work()
            time.sleep(0)  # release the interpreter: a solver that never does would starve the page

    def _work(self) -> None:
        """Take a step; when idle, compute a cost that was left out while the solver ran or in a drag."""
        if self._run.running:
            self._run.guarded(self._run.advance)
            self._stepped = time.monotonic()
            self._yielding.step_taken()
        elif self._run.costs_missing:
            self._run.fill_in()
            self._yielding.step_taken()

    def _pending(self) -> list[Command]:
        """Return the commands that wait; when idle, or before the next step is due, block for one."""
        due = self._yielding.until
        if self._run.running:
            due = max(self._stepped + self._run.pause_between_steps, due)
        elif not self._run.costs_missing:
            return self._commands.take(None)
        return self._commands.take(due - time.monotonic())
