"""Threads that carry out only the newest request of each computation, and a memo of the last result.

Besides its main loop a page has three threads: that of its solver; `maps`, for computations that follow a pointer; and
`jobs`, for longer ones. Only the newest request of each computation is carried out; older ones are dropped.
"""

import collections
import logging
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from ..model.validation import InputError
from .session import Session

log = logging.getLogger(__name__)

Flag = threading.Event  # any thread may set it to wake a loop that waits


@dataclass(frozen=True)
class Delivery:
    """Result of a `LatestWorker`: the request, its result or its exception, and readings of `time.perf_counter`, s."""

    request: tuple
    result: Any = None
    error: Exception | None = None
    began: float = 0.0
    ended: float = 0.0


class Lane:
    """A thread that several workers share; it starts with the first request.

    If several workers have a waiting request, the worker that was made first is served first. A function that returns
    an iterator is a long computation: the requests of the other workers are carried out between its parts.
    """

    def __init__(self, name: str):
        self.changed, self.workers = threading.Condition(), list[LatestWorker]()
        self._closed = False
        self.thread = threading.Thread(target=self._serve, name=name, daemon=True)

    def close(self, timeout: float = 2.0) -> bool:
        """End the thread after the running request; return False if that takes longer than `timeout` seconds."""
        with self.changed:
            self._closed = True
            for worker in self.workers:
                worker.requested = None
            self.changed.notify_all()
        if self.thread.ident is not None:
            self.thread.join(timeout)
        return not self.thread.is_alive()

    def carry_out_one(self, besides: "LatestWorker | None" = None) -> bool:
        """Carry out a request of a worker other than `besides`, on this thread; return whether there was a request."""
        with self.changed:
            worker = next((one for one in self.workers if one.waiting and one is not besides), None)
            if worker is None or self._closed:
                return False
            arguments = worker.running = worker.waiting.popleft()
        worker.carry_out(arguments)
        return True

    def _serve(self) -> None:
        while not self._closed:
            if not self.carry_out_one():
                with self.changed:
                    self.changed.wait_for(lambda: self._closed or any(worker.waiting for worker in self.workers))


class LatestWorker:
    """Calls `function` with the newest requests; at most `keep` requests wait, and older ones are dropped.

    `lane` is the thread; without it the worker has its own. An exception becomes `latest.error`, and the thread
    continues. `notify` is called after every delivery. `latest` is the newest delivery; `requested` are the last
    arguments of `newest`, or None if they are no longer wanted.
    """

    def __init__(
        self,
        function: Callable,
        name: str = "fdcal-worker",
        keep: int = 1,
        notify: Callable[[], None] = lambda: None,
        lane: Lane | None = None,
    ):
        self._function, self._name, self._notify = function, name, notify
        self.waiting: collections.deque[tuple] = collections.deque(maxlen=keep)
        self.running: tuple | None = None  # the arguments of the request that is carried out
        self.latest: Delivery | None = None
        self.requested: tuple | None = None
        self._lane = Lane(name) if lane is None else lane
        with self._lane.changed:
            self._lane.workers.append(self)

    @property
    def busy(self) -> bool:
        """Whether a request waits or is running."""
        with self._lane.changed:
            return self.running is not None or bool(self.waiting)

    def request(self, *arguments) -> None:
        """Request `function(*arguments)`; if `keep` requests wait, this replaces the oldest of them."""
        with self._lane.changed:
            self.waiting.append(arguments)
            if self._lane.thread.ident is None:
                self._lane.thread.start()
            self._lane.changed.notify_all()

    def newest(self, *arguments) -> None:
        """Request the computation, unless it is the one requested last."""
        if arguments != self.requested:
            self.requested = arguments
            self.request(*arguments)

    def wants(self, *arguments) -> bool:
        """Return whether the result of a request is still wanted; a long computation checks this between its parts."""
        return self.requested == arguments

    def wait_for(self, predicate: Callable[[Delivery | None], bool], timeout: float | None = None) -> bool:
        """Block until `predicate(latest)` is true; return False if it is not within `timeout` seconds."""
        with self._lane.changed:
            return self._lane.changed.wait_for(lambda: predicate(self.latest), timeout)

    def close(self, timeout: float = 2.0) -> bool:
        """End the thread after the running request; return False if that takes longer than `timeout` seconds."""
        return self._lane.close(timeout)

    def carry_out(self, arguments: tuple) -> None:
        """Compute and deliver the result of a request, on the thread of the lane."""
        began, result, error = time.perf_counter(), None, None
        try:
            result = self._function(*arguments)
            for _ in result if isinstance(result, Iterator) else ():
                while self._lane.carry_out_one(besides=self):
                    pass
        except Exception as failure:
            expected = isinstance(failure, (InputError, OSError))  # the caller reports these in one line
            log.log(logging.DEBUG if expected else logging.ERROR, "%s failed", self._name, exc_info=True)
            result, error = None, failure
        with self._lane.changed:
            self.latest, self.running = Delivery(arguments, result, error, began, time.perf_counter()), None
            self._lane.changed.notify_all()
        self._notify()


VALUES = (int, float, str, tuple)  # compared by value; objects of other types are compared by identity


class Memo:
    """Keeps the last value, unless it is None, and returns it while its inputs are the same. Threads may share it."""

    _kept: tuple[tuple, Any] = (), None

    def get(self, *inputs) -> Any:
        """Return the kept value if it was made from these inputs, else None."""
        kept, value = self._kept
        same = len(kept) == len(inputs) and all(
            a is b or (isinstance(a, VALUES) and a == b) for a, b in zip(kept, inputs, strict=True)
        )
        return value if same else None

    def keep(self, value: Any, *inputs) -> Any:
        """Keep and return the value that was made from these inputs."""
        self._kept = inputs, value
        return value

    def __call__(self, make: Callable[[], Any], *inputs) -> Any:
        """Return the value for these inputs; call `make` if the kept value was made from other inputs."""
        value = self.get(*inputs)
        return self.keep(make(), *inputs) if value is None else value


class Scheduler:
    """Owns the threads of a session; all of them end together.

    `wake` makes the main loop update the page at once; `session` owns the thread of the solver, or is None at first.
    """

    def __init__(self, wake: Callable[[], None] = lambda: None):
        self._wake = wake
        self.session: Session | None = None
        self._maps, self._jobs = Lane("fdcal-maps"), Lane("fdcal-jobs")

    def worker(self, function: Callable, quick: bool = False, keep: int = 1) -> LatestWorker:
        """Return a worker that calls `function` with the newest requests, of which `keep` may wait.

        `quick`: whether the results follow a pointer; longer computations run on another thread.
        """
        name, lane = ("a map", self._maps) if quick else ("a job", self._jobs)
        return LatestWorker(function, name, keep, self._wake, lane)

    def close(self, timeout: float) -> None:
        """End all threads after the work in progress; wait at most `timeout`, s."""
        owned = [owner for owner in (self.session, self._maps, self._jobs) if owner is not None]
        end = time.perf_counter() + timeout
        for owner in owned:  # all are asked to stop before any is waited for
            owner.close(0.0)
        for owner in owned:
            owner.close(max((end - time.perf_counter()) / 2, 0.0))
