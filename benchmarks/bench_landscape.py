"""The landscape of one microphone: against Eq. 7 by brute force, Fig. 1's panels, many modes, the pruned search."""

from __future__ import annotations

import numpy as np

from benchmarks.report import Figure, best_time
from fdcal.cost import lattice_landscape, lattice_of, leave_one_out
from fdcal.dictionary import Lattice
from fdcal.pruned import best_candidate
from fdcal.scene import load_scene
from fdcal.store import cached_measurement

MICROPHONE = 7


def run() -> list[Figure]:
    scene = load_scene("array1_circle")
    measurement = cached_measurement(scene)
    problem = measurement.problem()
    lattice = lattice_of(problem, scene.solver.order_offset)
    rng = np.random.default_rng(0)
    guess = lattice.points[[lattice.index(x) for x in measurement.positions + rng.normal(0, 0.03, (65, 2))]]
    return [
        *_one_mode(problem, lattice, guess),
        *_many_modes(problem, lattice, guess),
    ]


def _one_mode(problem, lattice, guess) -> list[Figure]:
    """A landscape at 300 Hz and the brute-force one, `pinv` of the whole dictionary for each candidate."""
    mode = int(np.argmin(np.abs(problem.frequencies - 300)))
    centre = lattice.nearest(guess.mean(axis=0))
    rows = lattice.dictionaries(centre, [mode])[0]
    W = lattice.microphones(guess, centre, [mode])
    p = problem.pressures[mode : mode + 1]

    def closed_form():
        return leave_one_out(W, p, MICROPHONE)[0].cost_of(rows)

    def brute_force():
        candidate, costs = W[0].copy(), np.empty(len(rows))
        for c, row in enumerate(rows):
            candidate[MICROPHONE] = row
            costs[c] = np.sum(np.abs(candidate @ (np.linalg.pinv(candidate) @ p[0]) - p[0]) ** 2)
        return costs

    fast, slow = best_time(closed_form, 20), best_time(brute_force, 1)
    difference = float(np.abs(closed_form() - brute_force()).max())
    table = best_time(lambda: lattice.dictionaries(centre, [mode]))
    label = f"one mode, {problem.frequencies[mode]:.0f} Hz, order {lattice.orders[mode]}, 121 x 121"
    return [
        Figure(f"{label}: closed form", 1e3 * fast, "ms"),
        Figure(f"{label}: its dictionary, from the table of radii", 1e3 * table, "ms"),
        Figure(f"{label}: brute-force Eq. 7 / closed form", slow / fast, "times", "at least 300", slow / fast >= 300),
        Figure(f"{label}: largest difference", difference, "", "at most 1e-10", difference <= 1e-10),
    ]


def _many_modes(problem, lattice, guess) -> list[Figure]:
    """Fig. 1's four panels; 57 modes summed; one descent step, pruned and not."""
    centre, modes = lattice.nearest(guess.mean(axis=0)), range(57)
    panels = best_time(lambda: _three_and_their_sum(problem, lattice, guess, centre))
    rows = lattice.dictionaries(centre, modes)
    W = lattice.microphones(guess, centre, modes)
    fits = leave_one_out(W, problem.pressures[:57], MICROPHONE)
    here = lattice.index(guess[MICROPHONE])

    def full():
        return sum(fit.cost_of(w) for fit, w in zip(fits, rows, strict=True))

    def pruned():
        return best_candidate(lattice, centre, slice(0, 57), fits, here)

    whole, short = best_time(full), best_time(pruned, 20)
    fitting = best_time(lambda: leave_one_out(W, problem.pressures[:57], MICROPHONE), 20)
    agree = int(full().argmin()) == pruned()[0]
    build = best_time(lambda: Lattice(problem.search, problem.wavenumbers[:57], lattice.orders[:57]), 2)
    gather = best_time(lambda: lattice.dictionaries(centre, modes), 2)
    return [
        Figure("Fig. 1: three modes and their sum", 1e3 * panels, "ms", "at most 30", panels <= 0.03),
        Figure("57 modes summed, dictionary in memory", 1e3 * (whole + fitting), "ms", "at most 150", whole <= 0.15),
        Figure("57 modes: table of radii, once a problem", 1e3 * build, "ms"),
        Figure("57 modes: dictionary of the grid about one centre, from the table", 1e3 * gather, "ms"),
        Figure("57 modes: fit of the other 64 microphones", 1e3 * fitting, "ms"),
        Figure("57 modes: pruned search", 1e3 * short, "ms"),
        Figure("57 modes: full landscape / pruned search", whole / short, "times", "at least 10", whole / short >= 10),
        Figure("57 modes: argmin pruned = argmin full", float(agree), "", "1", agree),
    ]


def _three_and_their_sum(problem, lattice, guess, centre):
    maps = lattice_landscape(problem, lattice, guess, MICROPHONE, centre, slice(10, 31, 10))
    return maps, maps.sum(axis=0)
