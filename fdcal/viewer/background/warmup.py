"""The compiling of `fdcal.solvers.warmup` on a thread of its own, beside the simulation and then beside the page."""

from __future__ import annotations

import time
from collections.abc import Callable

from ...model.scene import Scene
from ...session.worker import LatestWorker
from ...solvers.warmup import pieces

LOOK = 0.05  # s between two looks at how far it is
LONG = 1.0  # s after which a piece is not read from the disk but compiled


class Rehearsal:
    """Begins at once. `stop` ends it after the piece under way."""

    def __init__(self, scene: Scene):
        first, last = pieces(scene.room.dimension, scene.solver.name)
        self._pieces, self._first, self._done = [*first, *last], len(first), 0
        self._since, self.stop = time.perf_counter(), False
        self._worker = LatestWorker(self._rehearse, "fdcal-rehearsal")
        self._worker.request()

    def _rehearse(self) -> None:
        for piece in self._pieces:
            if self.stop:
                return
            self._since = time.perf_counter()
            piece()
            self._done += 1

    @property
    def busy(self) -> bool:
        """Whether there is still something to compile; not where a piece has failed, which the solver will tell."""
        return self._worker.busy

    @property
    def text(self) -> str:
        """How far it is, in words; empty where nothing takes long."""
        if not self.busy or time.perf_counter() - self._since < LONG:
            return ""
        return f"Compiling (first run only) ... {self._done + 1} of {len(self._pieces)}"

    def wait_for_first(self, look: Callable[[], object]) -> None:
        """Wait until what the solver begins with is there; `look` is called now and then, and may raise."""
        while self.busy and self._done < self._first:
            look()
            time.sleep(LOOK)

    def close(self, timeout: float) -> bool:
        """End the thread after the piece under way; False if that took longer than `timeout` seconds."""
        self.stop = True
        return self._worker.close(timeout)
