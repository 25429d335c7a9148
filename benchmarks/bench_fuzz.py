"""Broken files for every reader: 10,000 each, or FDCAL_BENCH_CASES; a fault is printed with the number of its case."""

from __future__ import annotations

import os
import time

from .fuzzing.examine import faults_apart
from .fuzzing.readers import READERS
from .report import Figure

ALONE = True
BATCH = 500  # cases in one process


def run() -> list[Figure]:
    count = int(os.environ.get("FDCAL_BENCH_CASES", 10_000))
    figures = []
    for name in READERS:
        start, found = time.perf_counter(), []
        for first in range(0, count, BATCH):
            found += faults_apart(name, first, min(BATCH, count - first))
        for fault in found[:5]:
            print(fault, flush=True)
        spent = time.perf_counter() - start
        figures.append(Figure(f"{name}: faults in {count} broken files", len(found), f"{spent:.0f} s", "0", not found))
    return figures
