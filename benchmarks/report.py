"""One line of a benchmark's report, and timing that a busy machine disturbs little."""

import time
from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """A measured value; `met` is None without a target."""

    name: str
    value: float
    unit: str
    target: str = ""
    met: bool | None = None

    def __str__(self) -> str:
        mark = {None: " ", True: "ok", False: "MISSED"}[self.met]
        return f"{self.name:<64} {self.value:>10.4g} {self.unit:<10} {self.target:<24} {mark}"


def best_time(function, repeats: int = 5) -> float:
    """Return the shortest time of `repeats` calls, seconds; an earlier call, which compiles, is not counted."""
    function()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times)
