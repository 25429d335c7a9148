"""Three dimensions: 64 microphones in a ball, blind; 11 x 11 on a plane, four corners known and blind.

Arrays and room are those of the scenes ball3d and plane3d, with 79 of the room's frequencies up to 300 Hz, over draws
of source, noise and, in the ball, array. On a plane the wavenumber hardly determines the size: without known
microphones the shape is scored, after a similarity, and the verdict must say that the scale is not determined.
"""

import os
from collections.abc import Iterator

import numpy as np

from fdcal.assessment.assess import assess
from fdcal.model.gauge import align, position_errors
from fdcal.solvers import load

from .draws import SOLVER, draw, pooled, solve, summary
from .report import Figure

DRAWS = int(os.environ.get("FDCAL_BENCH_DRAWS", "20"))
MODES = 79
BALL = {50: None, 30: 1.3, 20: 1.3, 10: 1.3}  # SNR, dB, and the largest error allowed, over the bound


def run() -> Iterator[Figure]:
    yield from ball()
    yield from corners()
    yield from shape()


def ball() -> Iterator[Figure]:
    for snr, limit in BALL.items():
        drawn = [draw("ball3d", seed, MODES, snr) for seed in range(DRAWS)]
        rows = summary(f"ball3d, blind, {snr} dB", drawn, "none", MODES, limit)
        if limit is None:
            rows[0] = _at_most(rows[0].name, rows[0].value, 3.0)
        yield from rows


def corners() -> list[Figure]:
    drawn = [draw("plane3d", seed, MODES, 40) for seed in range(DRAWS)]
    rows = summary("plane3d, corners known, 40 dB", drawn, "all", MODES, None)
    return [_at_most(rows[0].name, rows[0].value, 6.0), *rows[1:]]


def shape() -> list[Figure]:
    errors, scales, verdicts = [], [], []
    for seed in range(DRAWS):
        measurement = draw("plane3d", seed, MODES, 50).measurement
        outcome = solve(measurement, "none", MODES)
        scaled, scale = similar(outcome.positions, measurement.positions)
        errors.append(pooled(position_errors(scaled, measurement.positions)))
        scales.append(scale)
        estimate = load(SOLVER).result(measurement.problem(known="none"), outcome.state)
        verdicts.append(assess(estimate, measurement.names).verdict)
    said, name = verdicts.count("scale_undetermined"), "plane3d, blind, 50 dB"
    others = ", ".join(sorted(set(verdicts) - {"scale_undetermined"})) or "none"
    worst = float(np.max(np.abs(np.log(scales))))
    return [
        _at_most(f"{name}: RMS error of the shape, {DRAWS} draws pooled", 1e3 * pooled(errors), 8.0),
        Figure(f"{name}: largest error of the size", 100 * float(np.expm1(worst)), "%"),
        Figure(
            f"{name}: verdict scale_undetermined (others: {others})",
            said,
            "draws",
            str(DRAWS),
            said == DRAWS,
        ),
    ]


def similar(estimate, truth) -> tuple[np.ndarray, float]:
    """Return `estimate` (N, D), metres, after the best similarity onto `truth`, and the scale of this similarity."""
    turned = align(estimate, truth)
    offset, goal = turned - turned.mean(axis=0), truth - truth.mean(axis=0)
    scale = float(np.sum(offset * goal) / np.sum(offset**2))
    return scale * offset + truth.mean(axis=0), scale


def _at_most(name: str, value: float, limit: float) -> Figure:
    """Return a figure in millimetres with its target."""
    return Figure(name, value, "mm", f"at most {limit:g}", value <= limit)
