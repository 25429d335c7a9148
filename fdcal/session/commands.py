"""What passes between the user interface's threads and the solver's: commands, and the request to yield."""

from __future__ import annotations

import contextlib
import itertools
import queue
import time
from dataclasses import dataclass
from typing import Any, Literal


@dataclass(frozen=True)
class Play:
    """Run until paused or finished."""


@dataclass(frozen=True)
class Pause:
    """Stop after the present step."""


@dataclass(frozen=True)
class Advance:
    """Run until the number of the state's step, sweep or stage has risen by `count`."""

    unit: Literal["step", "sweep", "stage"]
    count: int


@dataclass(frozen=True)
class Pace:
    """Take at most `rate` steps per second while running; 0 stands for no limit."""

    rate: float


@dataclass(frozen=True)
class Reset:
    """Restart."""

    seed: int | None  # None for the last one used
    settings: Any = None  # others than the present ones, or None


@dataclass(frozen=True)
class Place:
    """Move a microphone."""

    microphone: int
    position: tuple[float, ...]  # metres, its first coordinates or all of them
    gesture: object  # moves of one gesture make one state of the history; None for a move of its own


@dataclass(frozen=True)
class Seek:
    """Show a state of the history."""

    index: int


@dataclass(frozen=True)
class UseModes:
    """Set the modes in use, counted from 1, inclusive, and whether the solver adds more."""

    first: int
    last: int
    automatic: bool


@dataclass(frozen=True)
class Close:
    """End the thread."""


Command = Play | Pause | Advance | Pace | Reset | Place | Seek | UseModes | Close
NEWEST_ONLY = (Seek, UseModes, Place, Pace)  # of several such commands in a row only the last counts


class CommandQueue:
    """Commands; any thread may put them, one takes them."""

    def __init__(self):
        self._queue: queue.SimpleQueue[Command] = queue.SimpleQueue()

    def put(self, command: Command) -> None:
        """Append a command."""
        self._queue.put(command)

    def take(self, timeout: float | None) -> list[Command]:
        """Return all commands that wait, without those that a later one replaces.

        If none waits, block for one: for `timeout` seconds, not at all if that is not positive, without limit if None.
        """
        commands: list[Command] = []
        if timeout is None:
            commands.append(self._queue.get())
        elif timeout > 0:
            with contextlib.suppress(queue.Empty):
                commands.append(self._queue.get(timeout=timeout))
        while not self._queue.empty():
            commands.append(self._queue.get())
        pairs = itertools.zip_longest(commands, commands[1:])
        return [command for command, after in pairs if after is None or not _replaced(command, after)]


def _replaced(command: Command, after: Command) -> bool:
    """Whether a command need not be done, since another one follows."""
    if isinstance(command, Place) and isinstance(after, Place):
        return (command.microphone, command.gesture) == (after.microphone, after.gesture)
    return type(command) is type(after) and isinstance(command, NEWEST_ONLY)


class YieldTimer:
    """When the solver yields to the user interface: for `duration` seconds after every request.

    Continuous requests delay a step by twice that time at most.
    """

    def __init__(self, duration: float):
        self._duration, self._start, self._end = duration, 0.0, 0.0  # readings of `time.monotonic`

    def request(self) -> None:
        """Yield from now on; any thread may ask for it."""
        now = time.monotonic()
        self._start = now if now > self._end else self._start
        self._end = now + self._duration

    def step_taken(self) -> None:
        """Count the longest delay from now on."""
        self._start = time.monotonic()

    @property
    def until(self) -> float:
        """Reading of `time.monotonic` until which no step begins."""
        return min(self._end, self._start + 2 * self._duration)
