"""The background threads of a session, and a memo of the last result.

Besides the main loop a session has three threads: that of its solver; `maps`, for computations that follow a pointer;
and `jobs`, for longer ones. Only the newest request of each computation is carried out; older ones are dropped.
"""

import time
from collections.abc import Callable
from typing import Any

from ..session.session import Session
from ..session.worker import Lane, LatestWorker

VALUES = (int, float, str, tuple)  # compared by value; objects of other types are compared by identity


class Memo:
    """Keeps the last value, unless it is None, and returns it while its inputs are the same. Threads may share it."""

    def __init__(self):
        self._kept: tuple[tuple, Any] = (), None

    def get(self, *inputs) -> Any:
        """Return the value if it was made from these inputs, else None."""
        kept, value = self._kept
        same = len(kept) == len(inputs) and all(
            a is b or (isinstance(a, VALUES) and a == b) for a, b in zip(kept, inputs, strict=True)
        )
        return value if same else None

    def __call__(self, make: Callable[[], Any], *inputs) -> Any:
        """Return the value for these inputs; call `make` if the last one was made from others."""
        value = self.get(*inputs)
        if value is None:
            value = make()
            self._kept = inputs, value
        return value


class Scheduler:
    """Owns the threads of a session; all of them end together.

    `wake` makes the main loop update the page at once; `session` owns the thread of the solver, or is None at first.
    """

    def __init__(self, wake: Callable[[], None] = lambda: None):
        self._wake = wake
        self.session: Session | None = None
        self._maps, self._jobs = Lane("fdcal-maps"), Lane("fdcal-jobs")

    def map(self, function: Callable) -> LatestWorker:
        """Return a worker that calls `function`, which is quick, with the newest request."""
        return LatestWorker(function, "a map", notify=self._wake, lane=self._maps)

    def job(self, function: Callable, keep: int = 1) -> LatestWorker:
        """Return a worker that calls `function`, which takes longer, with the newest requests; `keep` may wait."""
        return LatestWorker(function, "a job", keep, self._wake, self._jobs)

    def close(self, timeout: float) -> None:
        """End all threads after the work in progress; wait at most `timeout`, s."""
        owned = [owner for owner in (self.session, self._maps, self._jobs) if owner is not None]
        end = time.perf_counter() + timeout
        for owner in owned:  # all are asked to stop before any is waited for
            owner.close(0.0)
        for owner in owned:
            owner.close(max((end - time.perf_counter()) / 2, 0.0))
