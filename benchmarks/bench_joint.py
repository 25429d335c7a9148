"""How long `joint` takes, from measurement to verdict, for array 1 and a ball, and how that depends on N and M.

All code is compiled beforehand, and times are medians of REPEATS, of the processor and of the clock. For the comparison
with descent, joint is timed until Eq. 7 at its positions, with the same frequencies and orders, is as low as at the end
of descent. Each size is measured in a process of its own; its memory is the peak minus that before the run.
"""

import os
import resource
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from fdcal import solvers
from fdcal.acoustics.box_field import point_source_pressures
from fdcal.acoustics.dictionary import fourier_bessel, max_order
from fdcal.acoustics.measure import cached_measurement, draw_measurement
from fdcal.acoustics.spectrum import ModalPressures
from fdcal.cost import eq7
from fdcal.model.measurement import Measurement
from fdcal.model.problem import mode_power
from fdcal.model.scene import Room, load_scene
from fdcal.model.settings import SolverSettings
from fdcal.session.calibration_run import solve
from fdcal.session.sources import CalibrationInput

from .draws import draw, eigenfrequencies
from .draws import solve as calibrated
from .report import Figure

REPEATS = 5
EVALUATIONS = 60  # largest number in least_squares, each with finite differences for all unknowns
MICROPHONES = (16, 32, 64, 128, 256, 512)  # with 57 modes
MODES = (8, 16, 32, 57, 128, 256)  # with 64 microphones
CHILD = "import sys; from benchmarks.bench_joint import report_size; report_size(int(sys.argv[1]), int(sys.argv[2]))"


def run() -> list[Figure]:
    array1, ball = cached_measurement(load_scene("array1_circle")), draw("ball3d", 0, 79, 40).measurement
    return [
        *_whole("array1_circle, 57 modes, blind", _blind(array1), 57, 0.5),
        *_whole("array1_circle, 57 modes, three known", array1, 57, 0.2),
        *_whole("ball3d, 79 modes, 40 dB, blind", _blind(ball), 79, 2.0),
        *_against_descent(array1),
        *_against_least_squares(array1),
        *_sizes(),
    ]


def _blind(measurement):
    return replace(measurement, known=(), known_positions=None)


def _whole(name: str, measurement, modes: int, limit: float) -> list[Figure]:
    """Return the times from measurement to verdict."""
    inputs = CalibrationInput(name, None, measurement, SolverSettings(name="joint", modes=modes), 0)
    solve(inputs)
    wall, cpu = np.transpose([timed(lambda: solve(inputs)) for _ in range(REPEATS)])
    took = float(np.median(wall))
    return [
        Figure(f"{name}: measurement to verdict", took, "s", f"at most {limit:g}", took <= limit),
        Figure(f"{name}: time of the processor", float(np.median(cpu)), "s"),
    ]


def timed(function) -> tuple[float, float]:
    """Return the seconds of a call by the clock and of the processor."""
    wall, cpu = time.perf_counter(), time.process_time()
    function()
    return time.perf_counter() - wall, time.process_time() - cpu


def _against_descent(measurement) -> list[Figure]:
    problem = measurement.problem()
    settings = replace(load_scene("array1_circle").solver, name="descent", start="random")
    solvers.load("descent").step(problem, solvers.load("descent").init(problem, settings, 0))  # compiles
    states = []
    slow, slow_cpu = timed(lambda: states.extend(solvers.run(problem, settings, 0)))
    goal = equation7(problem, states[-1].positions, settings)
    rule, settings = settings, replace(settings, name="joint", start="affine")
    whole = float(np.median([timed(lambda: list(solvers.run(problem, settings, 0)))[0] for _ in range(REPEATS)]))
    runs = [_until(problem, settings, rule, goal) for _ in range(REPEATS)]
    fast, fast_cpu, ratio = (float(np.median(column)) for column in np.transpose([(*r, slow / r[0]) for r in runs]))
    return [
        Figure("descent, array1_circle, 57 modes, seed 0: Eq. 7 at its end", goal, ""),
        Figure("descent: time", slow, "s"),
        Figure("descent: time of the processor", slow_cpu, "s"),
        Figure("joint, start included, until Eq. 7 is as low", fast, "s"),
        Figure("joint: time of the processor", fast_cpu, "s"),
        Figure("descent over joint", ratio, "times", "at least 50", ratio >= 50),
        Figure("descent over the whole of joint", slow / whole, "times"),
        Figure("descent over joint, processor", slow_cpu / fast_cpu, "times"),
    ]


def _against_least_squares(measurement) -> list[Figure]:
    """Compare joint with `scipy.optimize.least_squares` on the residuals of Eq. 7, from the same start."""
    problem, settings = measurement.problem(), SolverSettings(name="joint", modes=57)
    start, free = solvers.load("joint").init(problem, settings, 0).positions, problem.free
    orders = max_order(problem.wavenumbers[: settings.modes], problem.search.radius, settings.order_offset)

    def residuals(unknowns) -> np.ndarray:
        x = np.array(start)
        x[free] = unknowns.reshape(-1, x.shape[1])
        left = []
        for k, order, p in zip(problem.wavenumbers, orders, problem.pressures, strict=False):
            Q = np.linalg.qr(fourier_bessel(x, k, int(order), x.mean(axis=0)))[0]
            left.append(p - Q @ (Q.conj().T @ p))
        return np.concatenate(left).view(float)

    found = []
    _, slow = timed(lambda: found.append(least_squares(residuals, start[free].ravel(), max_nfev=EVALUATIONS)))
    inputs = CalibrationInput("array1_circle", None, measurement, settings, 0)
    fast = float(np.median([timed(lambda: list(solvers.run(problem, settings, 0)))[1] for _ in range(REPEATS)]))
    error = np.linalg.norm(found[0].x.reshape(-1, 2) - measurement.positions[free], axis=1).mean()
    own = np.linalg.norm(solve(inputs).positions[free] - measurement.positions[free], axis=1).mean()
    name = f"least_squares, variable projection, {found[0].nfev} evaluations"
    return [
        Figure(f"{name}: time of the processor", slow, "s"),
        Figure(f"{name}: mean error", 1e3 * float(error), "mm"),
        Figure("joint from the same start: time of the processor", fast, "s"),
        Figure("joint: mean error", 1e3 * float(own), "mm"),
        Figure("least_squares over joint, processor", slow / fast, "times", "at least 100", slow / fast >= 100),
    ]


def equation7(problem, positions, settings) -> float:
    """Return Eq. 7 summed over the modes of `settings`, about the centre of mass."""
    modes = slice(0, settings.modes)
    k = problem.wavenumbers[modes]
    orders = max_order(k, problem.search.radius, settings.order_offset)
    W = (fourier_bessel(positions, *one, positions.mean(axis=0)) for one in zip(k, orders, strict=True))
    return sum(float(eq7.fit(w[None], p[None])[2][0]) for w, p in zip(W, problem.pressures[modes], strict=True))


def _until(problem, settings, rule, goal: float) -> tuple[float, float]:
    """Return seconds of clock and processor until joint brings Eq. 7 down to `goal`; infinite if it never does."""
    joint, total = solvers.load("joint"), np.zeros(2)
    state = None

    def advance():
        nonlocal state
        state = joint.init(problem, settings, 0) if state is None else joint.step(problem, state)

    while state is None or not state.finished:
        total += timed(advance)
        if equation7(problem, state.positions, rule) <= goal:
            return tuple(total)
    return np.inf, np.inf


def _sizes() -> list[Figure]:
    """Return time and memory against N and M, and the exponents fitted to the larger half of each."""
    figures, targets = [], {(512, 128): 30.0}
    table = {size: _size(*size) for size in {*((n, 57) for n in MICROPHONES), *((64, m) for m in MODES), *targets}}
    for (n, m), (wall, cpu, step, megabytes, rms) in sorted(table.items()):
        limit = targets.get((n, m))
        target, met = ("", None) if limit is None else (f"at most {limit:g}", wall <= limit)
        figures += [
            Figure(f"N = {n}, M = {m}, blind: time", wall, "s", target, met),
            Figure(f"N = {n}, M = {m}: time of the processor", cpu, "s"),
            Figure(f"N = {n}, M = {m}: one step, mean, processor", 1e3 * step, "ms"),
            Figure(f"N = {n}, M = {m}: increase of the peak memory", megabytes, "MB"),
            Figure(f"N = {n}, M = {m}: RMS error", 1e3 * rms, "mm"),
        ]
    for name, sizes, rows in (
        ("N", MICROPHONES, [table[n, 57] for n in MICROPHONES]),
        ("M", MODES, [table[64, m] for m in MODES]),
    ):
        half = len(sizes) // 2
        for what, column in (("time of the processor", 1), ("time of a step", 2), ("memory", 3)):
            values = np.maximum([row[column] for row in rows[half:]], 1e-9)
            slope = float(np.polyfit(np.log(sizes[half:]), np.log(values), 1)[0])
            figures.append(Figure(f"{what}: exponent of {name} in the larger half", slope, ""))
    return figures


def _size(count: int, modes: int) -> tuple[float, ...]:
    command = [sys.executable, "-c", CHILD, str(count), str(modes)]
    environment = {**os.environ, "FDCAL_BENCH_SOLVER": "joint"}
    child = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    return tuple(map(float, child.stdout.split()))


# One size: random microphones in a square of 1 m, blind, 40 dB, in a process of its own.


SIZE_REPEATS = 3
SIZE_SOURCE, SIZE_ROOM, SIZE_CENTRE = (5.47, 4.53), (6.0, 5.0), (2.61, 2.31)  # metres


def measured(count: int, modes: int) -> Measurement:
    """Return a measurement of `count` microphones in a rigid room with its `modes` lowest modes."""
    rng = np.random.default_rng([count, modes])
    positions = np.array(SIZE_CENTRE) + rng.uniform(-0.5, 0.5, (count, 2))
    frequencies = eigenfrequencies(SIZE_ROOM, modes, 343.0, False)
    k = (2 * np.pi * frequencies - 3j) / 343.0
    clean = point_source_pressures(Room(size=SIZE_ROOM), SIZE_SOURCE, positions, k)
    field = ModalPressures(frequencies, k, clean)
    return draw_measurement(field, 1e-4 * mode_power(clean), rng, sound_speed=343.0, positions=positions)


def peak() -> float:
    """Return the peak memory of this process, MB."""
    unit = 1e6 if sys.platform == "darwin" else 1e3
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def report_size(count: int, modes: int) -> None:
    """Print wall time, processor time, and that of one step, s; the growth of memory, MB; and the error, metres."""
    for _ in range(2):
        calibrated(measured(24, 16), "none", 16)  # compiles, or reads what was compiled
    measurement, before = measured(count, modes), peak()
    outcomes = [calibrated(measurement, "none", modes)]
    after = peak()
    outcomes += [calibrated(measurement, "none", modes) for _ in range(SIZE_REPEATS - 1 if outcomes[0].wall < 3 else 0)]
    wall, cpu = (float(np.median([getattr(o, name) for o in outcomes])) for name in ("wall", "cpu"))
    print(wall, cpu, cpu / max(1, outcomes[0].state.step), after - before, outcomes[0].rms)
