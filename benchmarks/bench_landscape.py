"""The landscape of one microphone: time and agreement with Eq. 7 by brute force, for one and many frequencies.

The maps of the likelihood, in the plane and in space, are compared with the likelihood at some of their points."""

from dataclasses import replace

import numpy as np

from benchmarks.report import Figure, best_time
from fdcal.acoustics.dictionary import LatticeDictionary
from fdcal.acoustics.measure import cached_measurement
from fdcal.cost.eq7 import leave_one_out_fits
from fdcal.cost.lattice import plane_lattice
from fdcal.cost.likelihood import isotropic_field, likelihood_terms
from fdcal.cost.maps import descent_maps, likelihood_maps
from fdcal.model.problem import mode_power
from fdcal.model.scene import load_scene
from fdcal.solvers import descent

MICROPHONE = 7
SAMPLES = 60  # points of a lattice at which the likelihood is computed directly
ORDER_OFFSET = 2


def run() -> list[Figure]:
    scene = load_scene("array1_circle")
    measurement = cached_measurement(scene)
    problem = measurement.problem()
    lattice = plane_lattice(problem, ORDER_OFFSET)
    rng = np.random.default_rng(0)
    guess = lattice.points[[lattice.index(x) for x in measurement.positions + rng.normal(0, 0.03, (65, 2))]]
    centre = lattice.nearest(guess.mean(axis=0))
    return [
        *_one_mode(problem, lattice, guess, centre),
        *_many_modes(problem, lattice, guess, centre),
        *_steps(problem, scene.solver, measurement.positions),
        *_likelihood("array1_circle", slice(0, 57), 0.15),
        *_likelihood("array1_circle", slice(10, 13), 0.03),
        *_likelihood("ball3d", slice(0, 79), 1.0),
    ]


def _one_mode(problem, lattice, guess, centre) -> list[Figure]:
    """Compare a landscape at 300 Hz with brute force: `pinv` of the whole dictionary for each candidate."""
    mode = int(np.argmin(np.abs(problem.frequencies - 300)))
    rows = lattice.dictionary(lattice.points, centre, [mode])[0]
    W = lattice.dictionary(guess, centre, [mode])[0]
    p = problem.pressures[mode]

    def closed_form():
        return descent_maps(problem, guess, MICROPHONE, [mode + 1], ORDER_OFFSET, centre=centre)[0].ravel()

    def brute_force():
        candidate, costs = W.copy(), np.empty(len(rows))
        for c, row in enumerate(rows):
            candidate[MICROPHONE] = row
            costs[c] = np.sum(np.abs(candidate @ (np.linalg.pinv(candidate) @ p) - p) ** 2)
        return costs

    fast, slow = best_time(closed_form, 20), best_time(brute_force, 1)
    difference = float(np.abs(closed_form() - brute_force()).max())
    label = f"one mode, {problem.frequencies[mode]:.0f} Hz, order {lattice.orders[mode]}"
    return [
        Figure(f"{label}: closed form", 1e3 * fast, "ms"),
        Figure(f"{label}: brute-force Eq. 7 / closed form", slow / fast, "times", "at least 300", slow / fast >= 300),
        Figure(f"{label}: largest difference", difference, "", "at most 1e-10", difference <= 1e-10),
    ]


def _many_modes(problem, lattice, guess, centre) -> list[Figure]:
    """Time the four panels of Fig. 1, a sum of 57 modes, and one compiled search."""

    def summed(modes):
        return descent_maps(problem, guess, MICROPHONE, modes, ORDER_OFFSET, centre=centre).sum(axis=0)

    def search():
        fits = leave_one_out_fits(lattice.dictionary(guess, centre, range(57)), problem.pressures[:57], MICROPHONE)
        return lattice.best(centre, slice(0, 57), fits, guess[MICROPHONE])[0]

    panels, whole = best_time(lambda: summed((11, 21, 31))), best_time(lambda: summed(range(1, 58)))
    short = best_time(search, 20)
    agree = np.array_equal(lattice.points[summed(range(1, 58)).argmin()], search())
    build = best_time(lambda: LatticeDictionary(problem.search, problem.wavenumbers, lattice.orders), 2)
    return [
        Figure("Fig. 1: three modes and their sum", 1e3 * panels, "ms", "at most 30", panels <= 0.03),
        Figure("57 modes summed", 1e3 * whole, "ms", "at most 150", whole <= 0.15),
        Figure(f"table of radii of all {len(lattice.orders)} modes, once a problem", 1e3 * build, "ms"),
        Figure("57 modes: fits and pruned search", 1e3 * short, "ms"),
        Figure("57 modes: full landscape / pruned search, fits included", whole / short, "times"),
        Figure("57 modes: argmin pruned = argmin full", float(agree), "", "1", agree),
    ]


def _steps(problem, settings, truth) -> list[Figure]:
    """Compare a whole step of descent with the same step by the full landscape, from three states."""
    figures = []
    start = descent.use_modes(problem, descent.init(problem, settings, 0), 1, 57, automatic=False)
    lattice = plane_lattice(problem, start.order_offset)
    near = truth + np.random.default_rng(1).normal(0, 0.02, truth.shape)
    for name, positions, least in (
        ("a random start", start.positions, 0.5), ("2 cm off", near, 3), ("the truth", truth, 10),
    ):  # fmt: skip
        on_lattice = lattice.points[[lattice.index(x) for x in positions]]
        centre = lattice.nearest(on_lattice.mean(axis=0))
        state = replace(start, positions=on_lattice, centre=centre)
        step = best_time(lambda state=state: descent.step(problem, state), 10)
        n = descent.step(problem, state).moved
        whole = best_time(
            lambda state=state, n=n: descent.landscape(problem, state, n, state.modes).sum(axis=0).argmin()
        )
        best = int(descent.landscape(problem, state, n, state.modes).sum(axis=0).argmin())
        same = best == lattice.index(descent.step(problem, state).positions[n])
        ratio, goal = whole / step, f"at least {least:g}"
        figures.append(
            Figure(f"57 modes, {name}: full landscape / whole step", ratio, "times", goal, ratio >= least and same)
        )
    return figures


def _likelihood(name: str, modes: slice, most: float) -> list[Figure]:
    """Compare maps of the likelihood with direct values, at 40 dB with microphones 1 cm off."""
    measurement = cached_measurement(load_scene(name))
    problem = measurement.problem()
    guess = measurement.positions + np.random.default_rng(0).normal(0, 0.01, measurement.positions.shape)
    p = problem.pressures[modes]
    noise = 1e-4 * mode_power(p)
    layer = problem.search.layer(float(guess[MICROPHONE, -1]))
    field = isotropic_field(p, problem.wavenumbers[modes], noise, problem.dimension)
    maps = likelihood_maps(problem, guess, MICROPHONE, modes, noise)
    chosen = np.random.default_rng(1).choice(maps[0].size, SAMPLES, replace=False)
    direct = np.empty((len(maps), SAMPLES))
    for i, point in enumerate(layer.reshape(-1, layer.shape[-1])[chosen]):
        moved = guess.copy()
        moved[MICROPHONE] = point
        direct[:, i] = likelihood_terms(moved, p, field, derivatives=False).costs
    direct -= len(guess) * np.log(noise)[:, None]  # maps leave this constant out
    off = np.abs(maps.reshape(len(maps), -1)[:, chosen] - direct).max(axis=1)
    difference = float((off / np.ptp(maps, axis=(1, 2))).max())
    took = best_time(lambda: likelihood_maps(problem, guess, MICROPHONE, modes, noise))
    label = f"likelihood, {name}, {len(maps)} modes, {layer.shape[1]} x {layer.shape[0]}"
    return [
        Figure(label, 1e3 * took, "ms", f"at most {1e3 * most:.0f}", took <= most),
        Figure(f"{label}: difference, of the range", difference, "", "at most 1e-6", difference <= 1e-6),
    ]
