"""What passes between the user interface's threads and the solver's: commands, and the request to yield."""

from __future__ import annotations

import contextlib
import itertools
import queue
import time

NEWEST_ONLY = ("seek", "use_modes", "place", "pace")  # of several such commands in a row only the last counts


class CommandQueue:
    """Commands, tuples that begin with a name; any thread may put them, one takes them."""

    def __init__(self):
        self._queue: queue.SimpleQueue[tuple] = queue.SimpleQueue()

    def put(self, command: tuple) -> None:
        """Append a command."""
        self._queue.put(command)

    def take(self, timeout: float | None) -> list[tuple]:
        """Return all commands that wait, without those that a later one replaces.

        If none waits, block for one: for `timeout` seconds, not at all if that is not positive, without limit if None.
        """
        commands = []
        if timeout is None:
            commands.append(self._queue.get())
        elif timeout > 0:
            with contextlib.suppress(queue.Empty):
                commands.append(self._queue.get(timeout=timeout))
        while not self._queue.empty():
            commands.append(self._queue.get())
        pairs = itertools.zip_longest(commands, commands[1:])
        return [command for command, after in pairs if after is None or not _replaced(command, after)]


def _replaced(command: tuple, after: tuple) -> bool:
    """Whether a command need not be done, since another one follows."""
    if command[0] != after[0] or command[0] not in NEWEST_ONLY:
        return False
    return command[0] != "place" or (command[1], command[3]) == (after[1], after[3])


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
