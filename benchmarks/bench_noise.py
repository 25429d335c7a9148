"""Noise: RMS error of arrays 1 and 2 against the Cramer-Rao bound, 90 modes, with three known microphones and blind.

Pooled over draws of source, noise and, for array 2, array; the bound is pooled alike. A draw is lost if its RMS error
is more than three times its own bound.
"""

import os
from collections.abc import Iterator

from .draws import draw, summary
from .report import Figure

DRAWS = int(os.environ.get("FDCAL_BENCH_DRAWS", "20"))
MODES = 90
SNR_DB = {60: None, 40: 1.3, 30: 1.3, 20: 1.3, 10: 1.3}  # for each SNR the largest RMS error allowed, over the bound
AUTO_DB = 20  # the SNR at which the noise is estimated, too


def run() -> Iterator[Figure]:
    for name in ("array1_circle", "array2_random"):
        yield from rows(name, "all")
        yield from rows(name, "none")


def rows(name: str, known: str) -> Iterator[Figure]:
    """Yield the figures of one array, with `known` microphones "all" or "none"."""
    words = "three known" if known == "all" else "blind"
    for snr, limit in SNR_DB.items():
        drawn = [draw(name, seed, MODES, snr) for seed in range(DRAWS)]
        yield from summary(f"{name}, {words}, {snr} dB", drawn, known, MODES, limit)
        if snr == AUTO_DB:
            yield from summary(f"{name}, {words}, {snr} dB, noise estimated", drawn, known, MODES, limit, noise="auto")
