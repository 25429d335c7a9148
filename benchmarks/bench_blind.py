"""How often few microphones are found from one place of the source, with no position given: verdicts and errors.

16 microphones and one take of 8 s of noise at 30 dB, in a living room and in a studio, as in `fdcal_bench`.
FDCAL_BENCH_DRAWS sets the draws of each room, 12 unless given.
"""

import os
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import soundfile

import fdcal
from fdcal.session.plan import Layout, PlanRequest, make_plan
from fdcal_bench.cases import LIVING, SNR_DB, STUDIO, Case, Family
from fdcal_bench.scores import error_mm

DRAWS = int(os.environ.get("FDCAL_BENCH_DRAWS", "12"))
COUNT = 16
CASES = (Family("living room 0.4 s, 16 in 0.4 m", LIVING, 0.4, "noise", COUNT, 0.4),
         Family("studio 0.2 s, 16 in 0.3 m", STUDIO, 0.2, "noise", COUNT, 0.3))  # fmt: skip


def calibrated(case: Case) -> fdcal.Calibration:
    """Return the calibration of the first take of a case."""
    samples = case.recordings[0]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "take.wav"
        soundfile.write(path, 0.5 * samples.T / np.abs(samples).max(), case.rate, subtype="FLOAT")
        return fdcal.calibrate(fdcal.load(path, kind="stationary", sound_speed=case.speed), known="none")


def run() -> Iterator[str]:
    for family in CASES:
        verdicts: Counter[str] = Counter()
        errors, planned = [], []
        for draw in range(DRAWS):
            case, names = family.draw(draw), tuple(map(str, range(COUNT)))
            found = calibrated(case)
            verdicts[found.verdict] += 1
            errors.append(error_mm(np.asarray(found.positions), case.truth))
            request = PlanRequest(Layout("drawn", names, case.truth), family.room, family.reverberation, SNR_DB)
            planned.append(1e3 * make_plan(request).forecast.rms)
        reached, expected = (float(np.sqrt(np.mean(np.square(values)))) for values in (errors, planned))
        said = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.most_common())
        yield f"{family.name}: {reached:.1f} mm RMS, {expected:.1f} mm expected; {said}"
