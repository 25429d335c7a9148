"""One size of `bench_joint`: random microphones in a square of 1 m, blind, 40 dB, in a process of its own."""

import resource
import sys

import numpy as np

from fdcal.model.measurement import Measurement
from fdcal.model.problem import mode_power

from .draws import eigenfrequencies, rigid_field, solve

REPEATS = 3
SOURCE, SIZE, CENTRE = (5.47, 4.53), (6.0, 5.0), (2.61, 2.31)  # metres


def measured(count: int, modes: int) -> Measurement:
    """`count` microphones in a rigid room, `modes` modes from the lowest up."""
    rng = np.random.default_rng([count, modes])
    positions = np.array(CENTRE) + rng.uniform(-0.5, 0.5, (count, 2))
    frequencies = eigenfrequencies(SIZE, modes, 343.0, False)
    k = (2 * np.pi * frequencies - 3j) / 343.0
    clean = rigid_field(positions, SOURCE, k, SIZE)
    noise = 1e-4 * mode_power(clean)
    parts = rng.standard_normal((2, *clean.shape))
    pressures = clean + np.sqrt(noise / 2)[:, None] * (parts[0] + 1j * parts[1])
    return Measurement(frequencies, pressures, 343.0, wavenumbers=k, noise_power=noise, positions=positions)


def peak() -> float:
    """Most memory that this process has held, MB."""
    unit = 1e6 if sys.platform == "darwin" else 1e3
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def report(count: int, modes: int) -> None:
    """Print seconds of the clock and of the processor, of one step, MB beyond what there was, and metres of error."""
    for _ in range(2):
        solve(measured(24, 16), "none", 16)  # compiles, or reads what was compiled
    measurement, before = measured(count, modes), peak()
    outcomes = [solve(measurement, "none", modes)]
    after = peak()
    outcomes += [solve(measurement, "none", modes) for _ in range(REPEATS - 1 if outcomes[0].wall < 3 else 0)]
    wall, cpu = (float(np.median([getattr(o, name) for o in outcomes])) for name in ("wall", "cpu"))
    print(wall, cpu, cpu / max(1, outcomes[0].state.step), after - before, outcomes[0].rms)
