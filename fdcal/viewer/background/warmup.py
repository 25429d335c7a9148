"""Compile what `fdcal.solvers.warmup` names on a thread of its own, beside the simulation and then beside the page."""

from __future__ import annotations

import time
from collections.abc import Callable

from ...model.scene import Scene
from ...session.worker import LatestWorker
from ...solvers.warmup import warmup_calls

POLL_INTERVAL = 0.05  # s between two looks at the progress
COMPILE_TIME = 1.0  # s; a piece that takes longer is compiled, a faster one is read from the disk


class Warmup:
    """Starts at once; `close` ends it after the piece in progress.

    `scene`: whose solver decides what is compiled. `stop`: whether no other piece is begun.
    """

    def __init__(self, scene: Scene):
        self._pieces, self._done = warmup_calls(scene.solver.name), 0
        self._since, self.stop = time.perf_counter(), False
        self._worker = LatestWorker(self._compile, "fdcal-warmup")
        self._worker.request()

    def _compile(self) -> None:
        for _, compile_piece in self._pieces:
            if self.stop:
                return
            self._since = time.perf_counter()
            compile_piece()
            self._done += 1

    @property
    def busy(self) -> bool:
        """Whether something is still to be compiled; False after a failure, which the solver will report."""
        return self._worker.busy

    @property
    def ended(self) -> bool:
        """Whether `close` was called and the thread has ended."""
        return self.stop and self._worker.close(0.0)

    @property
    def text(self) -> str:
        """The progress in words; "" while nothing takes long."""
        if not self.busy or time.perf_counter() - self._since < COMPILE_TIME:
            return ""
        return f"Compiling (first run only) ... {self._done + 1} of {len(self._pieces)}"

    def wait(self, poll: Callable[[], object]) -> None:
        """Wait for all pieces; `poll` is called now and then, and may raise."""
        while self.busy and self._done < len(self._pieces):
            poll()
            time.sleep(POLL_INTERVAL)

    def close(self, timeout: float) -> bool:
        """End the thread after the piece in progress; False if that takes longer than `timeout`, s."""
        self.stop = True
        return self._worker.close(timeout)
