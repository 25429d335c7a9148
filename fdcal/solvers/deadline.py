"""The end of the time of a calibration, which the loops inside a step look at.

A step may take many trials, and the end of one attempt includes the start of the next. The loops of such work call
`check_deadline`, so that a calibration ends soon after its time and not after the step. A deadline holds in the thread
that has set it: calibrations in other threads, and the page's session, have their own or none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_time_is_up: ContextVar[Callable[[], bool] | None] = ContextVar("time_is_up", default=None)


class OutOfTime(Exception):
    """The time of a calibration is used up; the last state before holds its best positions."""


@contextmanager
def deadline(end: float, clock: Callable[[], float]) -> Iterator[None]:
    """Let `check_deadline` raise OutOfTime inside this context once `clock` is past `end`.

    Parameters
    ----------
    end : float, seconds
    clock : callable
        Returns seconds, as `time.process_time` does.
    """
    token = _time_is_up.set(lambda: clock() > end)
    try:
        yield
    finally:
        _time_is_up.reset(token)


def check_deadline() -> None:
    """Raise OutOfTime if the deadline of this thread has passed; without a deadline do nothing."""
    time_is_up = _time_is_up.get()
    if time_is_up is not None and time_is_up():
        raise OutOfTime
