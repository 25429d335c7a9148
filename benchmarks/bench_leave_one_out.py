"""Leave-one-out error: how well the other microphones predict each one, and what that says about the positions.

Frequencies up to 300 Hz; RMS over draws of source, noise and, for array 2, array.
"""

import os
from collections.abc import Iterator

import numpy as np

from fdcal.assessment.field import cross_validate

from .draws import Draw, draw, pooled, solve
from .report import Figure

DRAWS = int(os.environ.get("FDCAL_BENCH_DRAWS", "5"))
MODES = {"array2_random": 67, "ball3d": 57}  # up to 300 Hz
TARGETS = {("array2_random", 40): -35.0, ("array2_random", 20): -17.0}  # dB
DISPLACEMENTS = (1.0, 3.0, 10.0, 30.0)  # mm, by which microphones are displaced


def run() -> Iterator[Figure]:
    for name in MODES:
        for snr in (40, 20):
            yield from figures_of(name, snr).values()
    yield from figures_displaced()


def figures_of(name: str, snr: int) -> dict[str, Figure]:
    """Return the figures at the positions that `draws.SOLVER` finds in draws of a scene, by short names."""
    drawn = [draw(name, seed, MODES[name], snr) for seed in range(DRAWS)]
    outcomes = [solve(d.measurement, "all", MODES[name]) for d in drawn]
    reports = [_report(d, o.positions) for d, o in zip(drawn, outcomes, strict=True)]
    words, limit = f"{name}, {snr} dB", TARGETS.get((name, snr))
    whole = _mean_db([r.overall for r in reports])
    target = ("", None) if limit is None else (f"at most {limit:g}", whole <= limit)
    truths = [_report(d, d.measurement.positions) for d in drawn]
    return {
        "whole": Figure(f"{words}: leave-one-out error, {len(drawn)} draws pooled", whole, "dB", *target),
        "draw": Figure(f"{words}: of the worst draw", max(r.overall for r in reports), "dB"),
        "modes": Figure(f"{words}: of the worst frequency of any", max(r.modes.max() for r in reports), "dB"),
        "microphones": Figure(
            f"{words}: of the worst microphone of any", max(r.microphones.max() for r in reports), "dB"
        ),
        "true": Figure(f"{words}: at the true positions", _mean_db([r.overall for r in truths]), "dB"),
        "position": Figure(f"{words}: RMS position error", 1e3 * pooled([o.rms for o in outcomes]), "mm"),
        "median": Figure(f"{words}: of the median draw", 1e3 * float(np.median([o.rms for o in outcomes])), "mm"),
        "lost": Figure(f"{words}: draws more than 0.1 m off", sum(o.rms > 0.1 for o in outcomes), f"of {len(drawn)}"),
    }


def _report(drawn: Draw, positions):
    problem = drawn.measurement.problem()
    return cross_validate(problem, positions, slice(0, len(problem.frequencies)), problem.noise_power)


def _mean_db(values) -> float:
    return float(10 * np.log10(np.mean(10 ** (np.array(values) / 10))))


def figures_displaced() -> Iterator[Figure]:
    """Leave-one-out error at true positions with random displacements, and its prediction k^2 d^2 / 2."""
    drawn = [draw("array2_random", seed, MODES["array2_random"], 40) for seed in range(DRAWS)]
    for far in DISPLACEMENTS:
        reports, predicted = [], []
        for seed, d in enumerate(drawn):
            m = d.measurement
            moved = np.random.default_rng([seed, 5]).normal(scale=far / 1e3 / np.sqrt(2), size=m.positions.shape)
            reports.append(_report(d, m.positions + moved).overall)
            k = np.real(m.wavenumbers)
            rest = 10 ** (_report(d, m.positions).overall / 10)
            predicted.append(10 * np.log10(rest + np.mean(k**2) * np.sum(moved**2) / m.count / 2))
        yield Figure(f"array2_random, 40 dB, displaced by {far:g} mm RMS: leave-one-out error", _mean_db(reports), "dB")
        yield Figure(f"array2_random, 40 dB, displaced by {far:g} mm RMS: k^2 d^2 / 2", _mean_db(predicted), "dB")
