"""The one solver thread, its commands, and the states of its run so far.

A session plays, pauses, steps, rewinds and resets a solver without blocking the caller. It does not depend on a user
interface: commands go in through a queue, and one frozen `SessionView` at a time comes out. The thread that makes a
session computes its first state and cost; later, only the solver thread calls the solver's `init`, `step` and
`use_modes`. A state holds all that `step` needs, so that a run can be continued from any state. `SolverRun` is what
the solver thread does: it carries out commands, one step or one change of state at a time; `Session` owns the thread.

The reference cost of a state does not depend on the solver. The solver thread computes it, and any thread may read it.
Since a step can take less time than its cost, the costs of some states are left out while the solver runs, and computed
when it is paused.
"""

import collections
import contextlib
import functools
import itertools
import logging
import queue
import threading
import time
import weakref
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Concatenate, ParamSpec

import numpy as np

from .. import solvers
from ..model.address import Unit
from ..model.validation import InputError, frozen_array
from ..solvers.interface import RunState, bounded

P = ParamSpec("P")

COST_TIME = 0.25  # time that costs may take while the solver runs, as a fraction of the time of the steps
FILLED = 300  # when the solver is paused, the costs of 300 to 600 states of a longer run are computed, otherwise of all


@dataclass(eq=False)
class StateCosts:
    """Costs of states, dB, kept as long as the states exist."""

    _reference_cost: Callable[..., float] | None = None  # returns the cost of a state; if None, every cost is NaN
    duration: float = 0.0  # seconds that the last cost took
    newest: float = float("nan")  # the cost computed last
    count: int = 0  # number of costs computed
    _values: dict[int, tuple[weakref.ref, float]] = field(default_factory=dict)

    def of(self, state: RunState) -> float:
        """Return the cost of a state, dB; NaN if it has not been computed."""
        found = self._values.get(id(state))
        return float("nan") if found is None or found[0]() is not state else found[1]

    def compute(self, state: RunState) -> None:
        """Compute the cost of a state, unless it is known."""
        if self._reference_cost is None or self.knows(state):
            return
        began = time.thread_time()
        try:
            value = float(self._reference_cost(state))
        except np.linalg.LinAlgError:
            value = float("nan")
        key = id(state)
        self.duration = time.thread_time() - began if self.count else 0.0  # the first computation also makes its tables
        self._values[key] = weakref.ref(state, lambda _: self._values.pop(key, None)), value
        self.newest, self.count = value, self.count + 1

    def knows(self, state: RunState) -> bool:
        """Return whether the cost of a state has been computed, or cannot be computed."""
        found = self._values.get(id(state))
        return self._reference_cost is None or (found is not None and found[0]() is state)

    def missing(self, states: Sequence[RunState]) -> list[RunState]:
        """Return the states, evenly spaced, whose cost is to be computed when the solver is paused, the last first."""
        if self._reference_cost is None:
            return []
        return [state for state in states[::-1][:: max(1, len(states) // FILLED)] if not self.knows(state)]


MAX_STATES = 4000  # largest number of states kept of a run, about 6 kB each; above it, every second state is dropped


def thinned(states: Sequence) -> list:
    """Return about half of the states: the first and last, the first of every stage, and every second of the others."""
    last = len(states) - 1
    begins = {i for i in range(1, last) if states[i].stage != states[i - 1].stage}
    return [state for i, state in enumerate(states) if i % 2 == 0 or i == last or i in begins]


def recorded(states: Iterable) -> list:
    """Return the states of a run as a session keeps them: MAX_STATES at most."""
    kept: list = []
    for state in states:
        if len(kept) >= MAX_STATES:
            kept = thinned(kept)
        kept.append(state)
    return kept


@dataclass(frozen=True)
class SessionView:
    """What a session shows; never changed after it is published."""

    state: Any  # the solver state at `index`
    index: int  # index, in the history, of the state that is shown; the run continues from this state
    history: tuple = field(compare=False)  # states, oldest first
    running: bool = False  # whether steps are being taken
    error: str = ""  # text of the last exception of the solver, "" if there is none
    # the same object as long as steps follow each other; any other change of the history makes a new one
    lineage: object = field(default_factory=object, compare=False)
    costs: StateCosts = field(default_factory=StateCosts, compare=False)  # of the states in the history
    refused: InputError | None = None  # why the last command was refused, which changed nothing

    @property
    def count(self) -> int:
        """Number of states in the history."""
        return len(self.history)

    @property
    def cost(self) -> float:
        """Reference cost of the state, dB; that of an earlier state if its own has not been computed yet."""
        state = self.history[self.index]
        return self.costs.of(state) if self.costs.knows(state) else self.costs.newest


log = logging.getLogger(__name__)


class SolverRun:
    """The states of a run and the commands that change them; only one thread may call its methods.

    The parameters are those of `Session`, and `costs` keeps the costs of the states. `view` is frozen, so that any
    thread may read it; `on_change` is called after a new one has replaced it. `pause_between_steps` is the minimum time
    between two steps, s.
    """

    def __init__(
        self, problem, settings, seed: int, module, states, index: int | None, on_change: Callable, costs: StateCosts
    ):
        self._problem, self._settings, self._seed = problem, settings, int(seed)
        self._module = solvers.load(settings.name) if module is None else module
        self._on_change, self._costs = on_change, costs
        self._states = list(states) or [self._module.init(problem, settings, self._seed)]
        count = len(self._states)
        index = count - 1 if index is None else min(max(int(index), 0), count - 1)
        self._reached: Callable[[Any], bool] | None = None  # whether a state ends the run
        self._gesture: object = None  # the gesture by which the user made the last state, if it moved a microphone
        self.pause_between_steps = 0.0
        self.spent = collections.deque([0.0], maxlen=3)  # processor time of each of the last steps, s
        self._unpaid = 0.0  # processor time of the steps since the last cost, s
        self._costs.compute(self._states[index])
        self.view = SessionView(self._states[index], index, tuple(self._states), costs=self._costs)

    def execute(self, method: Callable, *arguments, **named) -> None:
        """Call a method of this class; an exception pauses the run and is shown in the view.

        A command that is not possible changes nothing; the view then holds the reason.
        """
        before, is_command = self._reached, method is not SolverRun.advance
        if is_command:
            self.view = replace(self.view, refused=None)
        try:
            method(self, *arguments, **named)
        except Exception as error:
            if is_command and isinstance(error, InputError):
                self._reached = before
                self._publish(refused=error)
                return
            log.exception("the solver stopped at state %d", self.view.index)
            self._reached = None
            self._publish(running=False, error=f"{type(error).__name__}: {error}")

    def _publish(self, **changes) -> None:
        self.view = replace(self.view, **changes)
        self._on_change()

    def _keep(self, states: list, lineage: object = None, dragged: bool = False) -> None:
        """Show the last of `states`, with a new lineage unless it is given.

        While a microphone is dragged the cost is computed later, since the next move replaces the state.
        """
        self._states, self._gesture = states, None
        if self._reached is None and not dragged:
            self._costs.compute(states[-1])
        self._publish(
            state=states[-1],
            index=len(states) - 1,
            running=self._reached is not None,
            error="",
            history=tuple(states),
            lineage=lineage or object(),
        )

    def advance(self) -> None:
        """Take one step from the state that is shown, unless it is finished."""
        view = self.view
        if view.state.finished:
            self._reached = None
            self._publish(running=False)
            return
        began = time.thread_time()
        state = bounded(self._problem, view.state, self._module.step(self._problem, view.state))
        self.spent.append(time.thread_time() - began)
        self._unpaid += self.spent[-1]
        if COST_TIME * self._unpaid >= self._costs.duration:
            self._costs.compute(state)
            self._unpaid = 0.0
        if state.finished or (self._reached is not None and self._reached(state)):
            self._reached = None
        if view.index + 1 < len(self._states):
            self._keep([*self._states[: view.index + 1], state])
            return
        states = self._states if len(self._states) < MAX_STATES else thinned(self._states)
        states.append(state)
        self._keep(states, lineage=view.lineage)

    def play(self) -> None:
        """Run until `pause` or until the solver has finished."""
        self._reached = lambda state: False
        self._publish(running=True, error="")

    def pace(self, rate: float) -> None:
        """Take at most `rate` steps per second while running; 0 stands for no limit."""
        self.pause_between_steps = 1 / rate if rate > 0 else 0.0

    def pause(self) -> None:
        """Stop after the present step."""
        self._reached = None
        self._costs.compute(self.view.state)
        self._publish(running=False)

    def step(self, count: int = 1, unit: Unit = "step") -> None:
        """Take `count` steps, or run until the number of the sweep or stage has risen by `count` or the solver ends."""
        end = getattr(self.view.state, unit) + count
        self._reached = lambda state: getattr(state, unit) >= end
        if unit == "step":
            self.advance()
        else:
            self._publish(running=True, error="")

    def reset(self, seed: int | None = None) -> None:
        """Restart, with `seed` or the last one used."""
        seed = self._seed if seed is None else int(seed)
        state = self._module.init(self._problem, self._settings, seed)
        self._seed, self._reached = seed, None
        self._keep([state])

    def seek(self, index: int) -> None:
        """Show state `index` of the history, clipped to its range, and pause; the next step drops the later states."""
        self._reached = self._gesture = None
        index = min(max(index, 0), len(self._states) - 1)
        self._costs.compute(self._states[index])
        self._publish(state=self._states[index], index=index, running=False)

    def use_modes(self, first: int, last: int, automatic: bool) -> None:
        """Set the modes in use (counted from 1, inclusive) and whether the solver adds more.

        The new state replaces the one that is shown, so that dragging a slider does not fill the history.
        """
        state = self._module.use_modes(self._problem, self.view.state, first, last, automatic)
        self._keep([*self._states[: self.view.index], state])

    def place(self, microphone: int, position: tuple, gesture: object) -> None:
        """Append a state with the microphone at `position`; the next move of the same gesture replaces this state."""
        old = self.view.state
        positions = np.array(old.positions)
        positions[microphone, : len(position)] = position  # a move in the plan view leaves the height as it is
        state = replace(old, positions=frozen_array(positions, float))
        state = self._module.use_modes(self._problem, state, old.first, old.last, old.automatic)
        dragged = gesture is not None and gesture == self._gesture
        self._reached = None
        self._keep([*self._states[: self.view.index + (not dragged)], state], dragged=dragged)
        self._gesture = gesture


def command(method: Callable[Concatenate[SolverRun, P], None]) -> Callable[Concatenate["Session", P], None]:
    """Return a method of `Session` that makes the solver thread call a method of `SolverRun`."""

    def request(self: "Session", *arguments: P.args, **named: P.kwargs) -> None:
        self._commands.put((method, arguments, named))

    return functools.update_wrapper(request, method)


NEWEST_ONLY = (SolverRun.seek, SolverRun.use_modes, SolverRun.pace)  # of several in a row only the last one counts
YIELD_TIME = 0.15  # s without a step after a request by the user


class Session:
    """A solver on its own thread; its exceptions pause the session and appear in `view.error`.

    `module` has `init`, `step` and `use_modes`; the default is the solver that `settings` name. The history begins with
    `states`, oldest first, of which `index` is shown; the default is the start alone. `reference_cost` returns the cost
    of a state, dB, comparable between solvers (`fdcal.cost.eq7`). `notify` is called after each change except the steps
    of a run.
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
    ):
        self._commands: queue.SimpleQueue[tuple | None] = queue.SimpleQueue()  # None ends the thread
        self._yield_from, self._yield_to = 0.0, 0.0  # s, readings of `time.monotonic`
        self._changed, self.notify = threading.Condition(), lambda: None
        self._stepped = 0.0  # `time.monotonic` at the last step
        self._run = SolverRun(problem, settings, seed, module, states, index, self._notify, StateCosts(reference_cost))
        self._thread = threading.Thread(target=self._serve, name="fdcal-solver", daemon=True)
        self._thread.start()

    play, pause, step = command(SolverRun.play), command(SolverRun.pause), command(SolverRun.step)
    pace, reset = command(SolverRun.pace), command(SolverRun.reset)
    seek, use_modes = command(SolverRun.seek), command(SolverRun.use_modes)

    @property
    def view(self) -> SessionView:
        """The newest published view; cheap, from any thread."""
        return self._run.view

    @property
    def step_time(self) -> float:
        """Processor time of a step, s: the minimum of the last three, as one may include compilation; 0 at first."""
        return min(self._run.spent.copy())

    def yield_to_ui(self) -> None:
        """Begin no step for YIELD_TIME seconds, so that the user interface can respond to the user.

        Continuous requests slow the run down to one step in twice that time, but do not stop it.
        """
        now = time.monotonic()
        self._yield_from = now if now > self._yield_to else self._yield_from
        self._yield_to = now + YIELD_TIME

    def place(self, microphone: int, position, gesture: object = None) -> None:
        """Move a microphone to `position`, metres, its first coordinates or all of them, and pause.

        All moves of one `gesture` (any object but None) make a single state of the history.
        """
        self.yield_to_ui()
        self._commands.put((SolverRun.place, (int(microphone), tuple(map(float, position)), gesture), {}))

    def close(self, timeout: float = 2.0) -> bool:
        """End the thread after the present step; return False if that takes longer than `timeout` seconds."""
        self._commands.put(None)
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def wait_for(self, predicate: Callable[[SessionView], bool], timeout: float | None = None) -> bool:
        """Block until `predicate(view)` is true; return False if it is not within `timeout` seconds."""
        with self._changed:
            return self._changed.wait_for(lambda: predicate(self._run.view), timeout)

    # Only the solver thread calls the methods below.

    def _notify(self) -> None:
        with self._changed:
            self._changed.notify_all()
        if not self.view.running:  # during a run the page reads the view at intervals
            self.notify()

    def _serve(self) -> None:
        while True:
            for waiting in self._pending():
                if waiting is None:
                    self._run.pause()
                    return
                method, arguments, named = waiting
                self._run.execute(method, *arguments, **named)
            view = self.view
            if time.monotonic() >= self._no_step_before:
                if view.running:
                    self._run.execute(SolverRun.advance)
                    self._stepped = self._yield_from = time.monotonic()
                elif missing := view.costs.missing(view.history):  # left out during the run or during a drag
                    view.costs.compute(missing[0])
                    self._yield_from = time.monotonic()
            time.sleep(0)  # release the interpreter: a solver that never does would starve the page

    @property
    def _no_step_before(self) -> float:
        """Reading of `time.monotonic` until which the solver takes no step, so that the page can respond."""
        return min(self._yield_to, self._yield_from + 2 * YIELD_TIME)

    def _pending(self) -> list[tuple | None]:
        """Return the commands that wait, without those that a later one replaces.

        Block until a command comes, or until the next step is due.
        """
        view, timeout = self.view, None
        if view.running:
            timeout = max(self._stepped + self._run.pause_between_steps, self._no_step_before) - time.monotonic()
        elif view.costs.missing(view.history):
            timeout = self._no_step_before - time.monotonic()
        commands: list[tuple | None] = []
        with contextlib.suppress(queue.Empty):
            if timeout is None or timeout > 0:
                commands.append(self._commands.get(timeout=timeout))
            while True:
                commands.append(self._commands.get_nowait())
        kept: list[tuple | None] = []
        for one, after in itertools.zip_longest(commands, commands[1:]):
            if one is not None and after is not None and one[0] is after[0]:
                same_drag = one[0] is SolverRun.place and one[1][::2] == after[1][::2]  # same microphone and gesture
                if same_drag or one[0] in NEWEST_ONLY:
                    continue
            kept.append(one)
        return kept
