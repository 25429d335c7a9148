"""Broken files for every reader, and hostile pages: 10,000 each; a fault is printed with the number of its case.

FDCAL_BENCH_CASES gives another number of cases, FDCAL_FUZZ some of the readers, separated by commas; "page" is one.
"""

import os
import time

from .fuzzing.examine import faults_apart
from .fuzzing.hostile_page import page_faults
from .fuzzing.readers import READERS
from .report import Figure

ALONE = True
BATCH = 500  # cases in one process
PAGE = "page"


def run() -> list[Figure]:
    count = int(os.environ.get("FDCAL_BENCH_CASES", 10_000))
    figures, wanted = [], os.environ.get("FDCAL_FUZZ", ",".join([*READERS, PAGE])).split(",")
    for name in wanted:
        start, found = time.perf_counter(), []
        for first in range(0, count, BATCH):
            size = min(BATCH, count - first)
            found += page_faults(first, size) if name == PAGE else faults_apart(name, first, size)
        for fault in found[:5]:
            print(fault, flush=True)
        spent = time.perf_counter() - start
        figures.append(Figure(f"{name}: faults in {count} cases", len(found), f"{spent:.0f} s", "0", not found))
    return figures
