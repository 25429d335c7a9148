"""The one solver thread, its commands, and a worker that only runs the newest request.

A session plays, pauses, steps, rewinds and resets a solver without blocking whoever asks. It knows no screen:
commands go in through a queue, one frozen `SessionView` at a time comes out. The solver thread alone calls the
solver's `init`, `step` and `use_modes`; each state carries all that `step` needs, so going on from any of them is free.
This is the only module that uses threads.
"""

from __future__ import annotations

import collections
import itertools
import logging
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from .checks import InputError
from .history import History, SessionView

log = logging.getLogger(__name__)


class Session:
    """A solver on its own thread.

    Parameters
    ----------
    problem : Problem, or whatever the solver's functions take
    settings : scene.Solver; its name picks the solver
    seed : int, of the start
    module : object with `init(problem, settings, seed)`, `step(problem, state)` and
        `use_modes(problem, state, first, last, automatic)`; the solver named in `settings` unless given

    Raises what the solver's `init` raises. Later exceptions pause the session and are told in `view.error`.

    Examples
    --------
    >>> session = Session(problem, scene.solver, scene.seed)  # doctest: +SKIP
    >>> session.sweep()  # doctest: +SKIP
    >>> session.wait_for(lambda view: view.state.sweep == 1, timeout=60)  # doctest: +SKIP
    """

    NEWEST_ONLY = ("seek", "use_modes")  # of several such commands in a row only the last matters

    def __init__(self, problem, settings, seed: int, module=None):
        if module is None:
            from . import solvers

            module = solvers.load(settings.name)
        self._problem, self._settings, self._seed, self._module = problem, settings, int(seed), module
        self._commands: queue.SimpleQueue = queue.SimpleQueue()
        self._changed = threading.Condition()
        self._states = [module.init(problem, settings, self._seed)]
        self._goal: Callable[[Any], bool] | None = None  # true once the state reached ends the run
        self._view = SessionView(self._states[0], 0, 1, False, "", History(self._states, 1))
        self._thread = threading.Thread(target=self._serve, name="fdcal-solver", daemon=True)
        self._thread.start()

    @property
    def view(self) -> SessionView:
        """The newest published view; cheap, from any thread."""
        return self._view

    def play(self) -> None:
        """Go on until `pause` or until the solver has finished."""
        self._commands.put(("play",))

    def pause(self) -> None:
        """Stop after the step under way."""
        self._commands.put(("pause",))

    def step(self) -> None:
        """Take one step (one microphone)."""
        self._commands.put(("step",))

    def sweep(self) -> None:
        """Go on until the state's sweep number rises or the solver has finished."""
        self._commands.put(("sweep",))

    def reset(self, seed: int | None = None) -> None:
        """Start anew, from `seed` or from the last one used."""
        self._commands.put(("reset", seed))

    def seek(self, index: int) -> None:
        """Look at state `index` of the history (bounded to it) and pause; going on from there drops the later ones."""
        self._commands.put(("seek", int(index)))

    def use_modes(self, first: int, last: int, automatic: bool) -> None:
        """Set the modes in use (counted from 1, inclusive) and whether the solver adds more by itself."""
        self._commands.put(("use_modes", int(first), int(last), bool(automatic)))

    def close(self, timeout: float = 2.0) -> bool:
        """End the thread after the step under way; False if it was still at work after `timeout` seconds."""
        self._commands.put(("close",))
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def wait_for(self, predicate: Callable[[SessionView], bool], timeout: float | None = None) -> bool:
        """Block until `predicate(view)` holds; False if it did not within `timeout` seconds."""
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
            if self._goal is not None:
                self._guarded(self._advance)
            time.sleep(0)  # let go of the interpreter: a solver that never does would starve the page

    def _pending(self) -> list[tuple]:
        """All commands that wait (blocking for one when idle), without those a later one makes void."""
        commands = [self._commands.get()] if self._goal is None else []
        while not self._commands.empty():
            commands.append(self._commands.get())
        after = [command[0] for command in commands[1:]]
        return [
            command
            for command, name in itertools.zip_longest(commands, after)
            if command[0] != name or name not in self.NEWEST_ONLY
        ]

    def _guarded(self, function: Callable, *arguments) -> None:
        """Call a function of this thread; its exception pauses the session and is told, the thread lives on."""
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

    def _keep(self, states: list, error: str = "") -> None:
        """Make the last of `states` the one looked at. Published lists are only appended to, never cut."""
        self._states, count = states, len(states)
        self._publish(
            state=states[-1],
            index=count - 1,
            count=count,
            running=self._goal is not None,
            error=error,
            history=History(states, count),
        )

    def _upto(self, count: int) -> list:
        """The first `count` states, as a list that may be appended to."""
        return self._states if count == len(self._states) else self._states[:count]

    def _advance(self) -> None:
        """One step from the state looked at, unless it is the solver's last."""
        view = self._view
        if view.state.finished:
            self._goal = None
            self._publish(running=False)
            return
        state = self._module.step(self._problem, view.state)
        if state.finished or self._goal(state):
            self._goal = None
        states = self._upto(view.index + 1)
        states.append(state)
        self._keep(states)

    def _run(self, goal: Callable[[Any], bool]) -> None:
        self._goal = goal
        self._publish(running=True, error="")

    def _on_play(self) -> None:
        self._run(lambda state: False)

    def _on_pause(self) -> None:
        self._goal = None
        self._publish(running=False)

    def _on_step(self) -> None:
        self._goal = lambda state: True
        self._advance()

    def _on_sweep(self) -> None:
        start = self._view.state.sweep
        self._run(lambda state: state.sweep > start)

    def _on_reset(self, seed: int | None) -> None:
        state = self._module.init(self._problem, self._settings, self._seed if seed is None else int(seed))
        self._seed = self._seed if seed is None else int(seed)
        self._goal = None
        self._keep([state])

    def _on_seek(self, index: int) -> None:
        self._goal = None
        index = min(max(index, 0), len(self._states) - 1)
        self._publish(state=self._states[index], index=index, running=False)

    def _on_use_modes(self, first: int, last: int, automatic: bool) -> None:
        """The changed state takes the place of the one looked at: a slider on its way must not fill the history."""
        state = self._module.use_modes(self._problem, self._view.state, first, last, automatic)
        self._keep([*self._states[: self._view.index], state])


@dataclass(frozen=True)
class Delivery:
    """What a `LatestWorker` made: the request's arguments, and its result or the exception, as text too.

    `began` and `ended` are readings of `time.perf_counter`, s.
    """

    request: tuple
    result: Any = None
    error: str = ""
    cause: Exception | None = None
    began: float = 0.0
    ended: float = 0.0


class LatestWorker:
    """A thread that runs only the newest request, or the newest `keep`, oldest first; others that wait are dropped.

    `latest` is the newest `Delivery`, None before the first. An exception becomes `latest.error`; the thread lives on.
    """

    def __init__(self, function: Callable, name: str = "fdcal-worker", keep: int = 1):
        self._function = function
        self._changed = threading.Condition()
        self._waiting: collections.deque[tuple] = collections.deque(maxlen=keep)
        self._busy = self._closed = False
        self._latest: Delivery | None = None
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)
        self._thread.start()

    @property
    def latest(self) -> Delivery | None:
        return self._latest

    @property
    def busy(self) -> bool:
        """Whether a request waits or is being worked on."""
        with self._changed:
            return self._busy or bool(self._waiting)

    @property
    def full(self) -> bool:
        """Whether one more request would drop one that waits."""
        return len(self._waiting) == self._waiting.maxlen

    def request(self, *arguments) -> None:
        """Ask for `function(*arguments)`, in place of the oldest request not begun yet where it is `full`."""
        with self._changed:
            self._waiting.append(arguments)
            self._changed.notify_all()

    def wait_for(self, predicate: Callable[[Delivery | None], bool], timeout: float | None = None) -> bool:
        """Block until `predicate(latest)` holds; False if it did not within `timeout` seconds."""
        with self._changed:
            return self._changed.wait_for(lambda: predicate(self._latest), timeout)

    def close(self, timeout: float = 2.0) -> bool:
        """End the thread after the request under way; False if it was still at work after `timeout` seconds."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _serve(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._waiting)
                if self._closed:
                    return
                arguments, self._busy = self._waiting.popleft(), True
            began = time.perf_counter()
            delivery = replace(self._work(arguments), began=began, ended=time.perf_counter())
            with self._changed:
                self._latest, self._busy = delivery, False
                self._changed.notify_all()

    def _work(self, arguments: tuple) -> Delivery:
        try:
            return Delivery(arguments, result=self._function(*arguments))
        except Exception as error:
            told = isinstance(error, (InputError, OSError))  # one line says it all, and whoever asked says it
            log.log(logging.DEBUG if told else logging.ERROR, "%s failed", self._thread.name, exc_info=True)
            return Delivery(arguments, error=f"{type(error).__name__}: {error}", cause=error)
