"""How long a plan takes, and how close the solver comes to the bound that a plan promises."""

import time
from collections.abc import Iterator

from fdcal.session.planning.bounds import request_information
from fdcal.session.planning.plan import make_plan
from fdcal.session.planning.request import PlanRequest, read_layout
from fdcal.session.planning.trials import run_trials, workers_for

from .report import Figure

TRIALS = 50
LAYOUTS = (
    ("circle 16 0.2", (0, 5, 9)),
    ("rectangle 5x5 0.8x0.8", (0, 4, 20)),
    ("ball 32 0.3", (2, 5, 24, 28)),
)


def run() -> Iterator[Figure]:
    for text, known in LAYOUTS:
        request = PlanRequest(read_layout(text), room=(7.0, 6.0, 2.7), known=known)
        began = time.process_time()
        make_plan(request, with_advice=False)
        middle = time.process_time()
        make_plan(request)
        bounds, advice = middle - began, time.process_time() - middle
        yield Figure(f"{text}: bounds", bounds, "s cpu", "<= 1 s", bounds <= 1)
        yield Figure(f"{text}: bounds and advice", advice, "s cpu")
        began = time.perf_counter()
        trials = run_trials(request, request_information(request), TRIALS, workers=workers_for(TRIALS))
        passed = time.perf_counter() - began
        yield Figure(f"{text}: trials that found the array", 100 * trials.found, "%")
        yield Figure(f"{text}: median error over the bound", trials.percentile(50) / trials.bound, "")
        yield Figure(f"{text}: a trial", trials.seconds, "s cpu")
        yield Figure(f"{text}: {TRIALS} trials on all cores", passed, "s", "<= 60 s", passed <= 60)
