"""Positions from short windows (`fdcal.cost.short_windows`), as a term of what the last stage minimises.

The windows are fitted alone, from low to high frequencies, from two starts: one by coherence, and the array that the
long rows, the spectra of whole recordings, have determined. Waves are added to the field of each take one after the
other, the direct sound and then early reflections, as long as each clearly decreases the cost. Near the optimum x_s
the fit is approximated by a quadratic that moves and turns with the array:

    S(x) = (x' - x_s)^T A (x' - x_s) / 2,    x' the array x moved onto x_s,    A^-1 = COVARIANCE_INFLATION lambda F^-1
    F       Fisher information on the positions, with all other parameters eliminated
    lambda  dispersion sum_g s_g^T I^-1 s_g / P, with the Fisher information I of all P parameters and the score s_g
            of group g minus the mean score; it exceeds 1 because the windows of one room are not independent

The likelihood of the long rows is divided by `Claim.excess` (`spread`), so that its weight agrees with the claimed
covariance. It and S are also divided by `WindowTerm.disagreement`, the factor by which they disagree.
"""

import functools
from dataclasses import dataclass, replace

import numpy as np

from ...acoustics.coherence import squared_coherence
from ...cost.short_windows import (
    ShortField,
    ShortLikelihood,
    advanced,
    first_field,
    free_parameters,
    other_places,
    upright,
    with_wave,
)
from ...model.gauge import align, rigid_motions
from ...model.problem import MAX_COUNT, Problem, ShortWindows
from ...model.validation import Bools, InputError, Integers, Reals
from ..levenberg_marquardt import FIRST_DAMPING, NewtonTerms, damped_step
from ..starts import coherence_start

MIN_MICROPHONES = 5  # least number whose shape and size the windows determine
# Largest ratio of the diameter of the array to the path of sound during one window. In a larger array a reflection
# falls into different windows at the two ends, which the covariance neglects. An array of 3 m, for which windows of
# 30 ms are too short, has an error of 49 mm with this term and of 8 mm without it. Arrays of 1.6 m have errors of 5 to
# 30 mm with it and of 15 to 118 mm without it.
MAX_DIAMETER = 0.2
# Ratio of the covariance of the result to that of the fit. The power by direction (`ShortField.spectrum`) has few
# parameters, and its misfit is the same in all windows, so that more windows do not reduce its effect. Without this
# factor the median error of simulated and measured arrays is 2.2 times the claimed sigma. In a plane array the misfit
# acts as a stretch and a shear of the whole array, which more than STRETCH_COUNT microphones do not reduce. This
# enlarges the claim alone (`enlarging`) and not the weight beside the long rows, whose model has the same misfit.
COVARIANCE_INFLATION, STRETCH_COUNT = 4.0, 8
# noise fraction of a channel, and its delay (times the sound speed), metres, above which its windows are not used
MAX_NOISE, MAX_DELAY = 0.1, 0.02
STAGES = (11.0, 27.5)  # rad/m, largest wavenumbers of the first stages: 600 and 1500 Hz in air
START_BAND = 36.7  # rad/m, largest wavenumber of the start by coherence: 2 kHz in air
MAX_STEP = 0.25  # largest change of a coordinate in a step, in shortest wavelengths
STEPS, WAVE_STEPS, LAST_STEPS = 25, 6, 40  # largest number of steps: usual, after one more wave, in the last stages
# nats; a stage ends when a step lowers the cost by less than DECREASE, or by less than ENOUGH times the dispersion once
# this is known, and the last one when a step lowers it by less than LAST_DECREASE. With 0.2 instead of 0.05 one
# circle of 8 microphones is not recognised as flat, and its error grows from 5 to 10 mm.
DECREASE, ENOUGH, LAST_DECREASE = 10.0, 0.5, 0.05
# Smallest decrease of the cost, nats divided by the dispersion, for which one more wave is kept. Only every second
# frequency is used for this, to save time. For a ball of 32 microphones in a dry room, the ninth wave decreases the
# cost by 100, and the error falls; for a circle of 8, the second wave decreases it by 30, and the error does not
# change.
WAVE_NATS = 50.0
# Largest number of waves of a take for an array in a plane and in space. In a dry room 20 decrease the errors of a ball
# of 32 from 2.8 to 1.6 mm and increase those of a spiral of 64 from 9 to 14 mm, because a plane array cannot tell the
# elevations of the waves from a shear of its own.
MAX_WAVES = {2: 10, 3: 20}
ROUNDS = 2  # number of iterations in which the dispersion lambda is found
# Largest difference of the costs of two arrays that the misfit of the model can cause, nats divided by the dispersion.
# If a level circle is assumed to be upright, the cost can be lower by up to 43. If one microphone of a ball of 32 is
# moved to its mirror image, the cost rises by 35 to 70 if the source is near the middle of the room, and by 210 or more
# otherwise.
MISFIT_NATS = 75.0
LOW_BAND = 16.0  # rad/m, largest wavenumber of the search for other places of a microphone
APART = np.pi / 2  # least distance of two places of a microphone, times LOW_BAND: a quarter of a wavelength
MAX_EXAMINED = 4  # number of microphones whose other place is tried, to save time
# standard deviation of the angular frequency over the power spectrum of a Hann window, times the length of the window
BANDWIDTH = np.pi * np.sqrt(4 / 3)
ZERO = 1e-6  # relative eigenvalue of the information below which only the priors determine a direction


@dataclass(frozen=True)
class WindowTerm:
    """The quadratic term S of the module docstring."""

    positions: Reals  # (N, D) float64, metres, x_s
    precision: Reals  # (N D, N D) float64, 1/m^2, A; 0 for microphones whose windows are not used
    rival: Reals | None = None  # (N, D) float64, metres, another array that explains the windows as well

    def laid_on(self, positions: Reals) -> "WindowTerm":
        """Return the term moved, turned and perhaps mirrored onto an array (N, D), metres."""
        used = np.flatnonzero(np.diag(self.precision).reshape(positions.shape).any(axis=1))
        laid = align(self.positions, positions, used)
        whole = np.kron(np.eye(len(positions)), _turn(self.positions, laid))
        return WindowTerm(laid, whole.T @ self.precision @ whole)

    def terms(self, positions: Reals) -> tuple[float, np.ndarray, np.ndarray]:
        """Return cost, gradient (N D,) and matrix (N D, N D) at positions (N, D), metres."""
        laid = self.laid_on(positions)
        away = (positions - laid.positions).ravel()
        gradient = laid.precision @ away
        return float(away @ gradient) / 2, gradient, laid.precision

    def costs(self, positions: Reals, n: int, places: Reals) -> np.ndarray:
        """Return the cost (...) with microphone `n` of positions (N, D) moved horizontally to `places` (..., 2)."""
        D = positions.shape[1]
        here, gradient, matrix = self.terms(positions)
        own = matrix[D * n : D * n + 2, D * n : D * n + 2]
        away = places - positions[n, :2]
        return here + away @ gradient[D * n : D * n + 2] + np.sum(away @ own * away, axis=-1) / 2

    def disagreement(self, positions: Reals, covariance: Reals) -> float:
        """Return the factor, at least 1, by which the covariances of this term and another estimate must grow to agree.

        It is the reduced chi-square of their difference (Birge 1932). The other estimate has `positions` (N, D),
        metres, and `covariance` (N D, N D), metres^2.
        """
        laid = self.laid_on(positions)
        used = np.diag(laid.precision) > 0
        away = (positions - laid.positions).ravel()[used]
        both = (np.linalg.pinv(laid.precision, rcond=1e-9, hermitian=True) + covariance)[np.ix_(used, used)]
        # Each covariance is zero along the rotations of its own array. If the shapes differ, these are not the same
        # moves, and the sum of the covariances is small, but not zero, along them. These directions are left out.
        motions = rigid_motions(positions.ravel()[used].reshape(-1, positions.shape[1]))
        shape = np.linalg.qr(motions, mode="complete")[0][:, motions.shape[1] :]
        away, both = shape.T @ away, shape.T @ both @ shape
        return max(1.0, float(away @ np.linalg.solve(both, away)) / len(away))


def _turn(before: Reals, after: Reals) -> np.ndarray:
    """Return the rotation or reflection R (D, D) for which after - mean = (before - mean) R."""
    U, _, V = np.linalg.svd((before - before.mean(axis=0)).T @ (after - after.mean(axis=0)))
    return U @ V


def must_be_flat(positions: Reals) -> bool:
    """Return whether there are so many positions (N, D) in space that the windows are used only for a flat array."""
    return positions.shape[1] == 3 and len(positions) > MAX_COUNT[3]


def usable(problem: Problem, positions: Reals, counted: Bools, flat: bool = False) -> bool:
    """Return whether there are windows of a field in space, and enough `counted` microphones in a small enough array.

    flat : whether the array lies in a plane of the space. Then MAX_COUNT allows more microphones.
    """
    if problem.windows is None or problem.dimension != 3 or np.sum(counted) < MIN_MICROPHONES:
        return False
    x = positions[counted]
    diameter, limit = float(np.linalg.norm(x[:, None] - x, axis=2).max()), MAX_COUNT[2 if flat else x.shape[1]]
    return len(positions) <= limit and diameter <= MAX_DIAMETER * problem.windows.length * problem.sound_speed


def window_term(
    problem: Problem, positions: Reals, phases: Reals, counted: Bools, flat: bool = False
) -> WindowTerm | None:
    """Return the term of the windows of a problem; None if they do not determine the array.

    positions : (N, D), metres, as found from the long rows; phases : (N,), radians, that of an inverted channel and 0
    for the others, because the fit itself estimates small phases and gains; counted : (N,) bool, channels in use;
    flat : whether an array in space is fitted in its plane, with a prior of standard deviation FLAT_SIGMA for heights
    """
    assert problem.windows is not None  # `usable`
    (N, D), x = positions.shape, np.array(positions)
    likelihood = likelihood_of(problem.windows.of_microphones(counted), problem.sound_speed, phases[counted])
    axes = plane_axes(x[counted])
    plane = axes[:2] if flat else np.eye(D)
    start, height = x[counted] @ plane.T, np.mean(x[counted], axis=0) @ (np.eye(D) - plane.T @ plane)
    starts = [(start, STAGES[1:])]
    if (coherent := _coherent(likelihood, len(plane))) is not None:
        starts = [(coherent, STAGES), *starts]
    try:
        likelihood, field, free = fitted(likelihood, starts)
        # Other places are only sought for microphones without a given position, and only without arrival times, because
        # these decide between two places.
        sought = np.isin(np.flatnonzero(counted), problem.known, invert=True) & (problem.arrivals is None)
        field, other = with_rival(likelihood, field, free, sought)
        covariance, found = covariance_of(likelihood, field, free), field.positions[:, free]
        y = align(found, start)
        whole = np.kron(np.eye(len(found)), _turn(found, y))
        precision = precision_of(whole.T @ covariance @ whole, y)
    except np.linalg.LinAlgError:
        return None
    x[counted] = y @ plane + height
    turn = np.kron(np.eye(len(y)), plane)
    precision = turn.T @ precision @ turn
    if flat:
        tilts = np.linalg.qr(np.column_stack([np.ones(len(y)), y]))[0]
        precision += np.kron(np.eye(len(y)) - tilts @ tilts.T, np.outer(axes[2], axes[2])) / FLAT_SIGMA**2
    index = np.arange(N * D).reshape(N, D)[counted].ravel()
    embedded, rival = np.zeros((N * D, N * D)), None
    embedded[np.ix_(index, index)] = precision
    if other is not None:
        rival = np.array(x)
        rival[counted] = align(other, y) @ plane + height
    return WindowTerm(x, embedded, rival)


def precision_of(covariance: Reals, positions: Reals) -> np.ndarray:
    """Return the inverse (N D, N D), 1/m^2, of a covariance without rigid motions; along these the precision is 0.

    A pseudo-inverse would take the rounding errors of the motions for a very small variance. Raises LinAlgError if the
    covariance is singular in other directions, too.
    """
    motions = np.linalg.qr(rigid_motions(positions))[0]
    moved, variance = motions @ motions.T, float(np.trace(covariance)) / len(covariance)
    np.linalg.cholesky(covariance + variance * moved)
    return np.linalg.inv(covariance + variance * moved) - moved / variance


def likelihood_of(windows: ShortWindows, sound_speed: float, phases: Reals) -> ShortLikelihood:
    """Return the likelihood of windows, with the `phases` (N,) of the channels removed and their mean levels equal."""
    k = 2 * np.pi * windows.frequencies / sound_speed
    power = np.mean(np.abs(windows.pressures) ** 2, axis=(0, 1))
    factors = np.exp(-1j * phases) / np.sqrt(np.maximum(power, np.finfo(power.dtype).tiny))
    takes = np.unique(windows.takes, return_inverse=True)[1]
    pressures = windows.pressures * factors.astype(windows.pressures.dtype)
    return ShortLikelihood(k, takes, pressures, BANDWIDTH / (windows.length * sound_speed))


def _coherent(likelihood: ShortLikelihood, axes: int) -> np.ndarray | None:
    """Return positions (N, axes), metres, from the coherence of the windows; None if it does not determine them."""
    count = likelihood.pressures.shape[1]
    p, k = likelihood.pressures.reshape(-1, likelihood.pressures.shape[2]), np.repeat(likelihood.wavenumbers, count)
    kept = np.any(p, axis=1) & (k <= START_BAND)
    p, k = p[kept], k[kept]
    try:
        return coherence_start(p / np.sqrt(np.mean(np.abs(p) ** 2, axis=1))[:, None], k, None, 3, axes)
    except (InputError, np.linalg.LinAlgError, ValueError):
        return None


def fitted(
    likelihood: ShortLikelihood, starts: list[tuple[Reals, tuple[float, ...]]]
) -> tuple[ShortLikelihood, ShortField, Integers]:
    """Return the likelihood with its dispersion, the likeliest field, and the axes.

    starts : positions (N, D), metres, each with the largest wavenumbers of its first stages, rad/m;
    axes : (D,) int64, which of the field's three coordinates are free
    """
    takes, axes = int(likelihood.takes.max()) + 1, np.arange(starts[0][0].shape[1])
    ended = list[tuple[ShortField, float]]()
    for positions, stages in starts:
        field, cost = first_field(positions, takes), np.inf
        for top in stages:
            part = _low(likelihood, top)
            field, _ = _minimised(part, first_field(field.positions, takes), axes)
            field, cost = _minimised(part, with_wave(part, field), axes)
        ended.append((field, cost))
    k, take = likelihood.wavenumbers, likelihood.takes
    half = _of_groups(likelihood, np.sum((take[:, None] == take) & (k[:, None] > k), axis=1) % 2 == 0)
    field, _ = _minimised(half, min(ended, key=lambda one: one[1])[0], axes)
    field, cost = _minimised(half, field, axes, spectrum=5, steps=LAST_STEPS)
    dispersion = 1.0
    while field.curvature.shape[1] < MAX_WAVES[starts[0][0].shape[1]]:
        more, lower = _minimised(half, with_wave(half, field), axes, spectrum=5, steps=WAVE_STEPS)
        dispersion = _dispersion(half, more, axes, spectrum=5)
        if cost - lower < WAVE_NATS * dispersion:
            break
        field, cost = more, lower
    least = max(DECREASE, ENOUGH * dispersion)
    (start, axes), *standing = upright(field, axes)
    field, cost = _minimised(likelihood, start, axes, spectrum=7, steps=LAST_STEPS, least=least)
    for start, other in standing:
        found, lower = _minimised(likelihood, start, other, spectrum=7, steps=LAST_STEPS, least=least)
        if cost - lower > MISFIT_NATS * _dispersion(likelihood, field, axes, spectrum=7):
            field, axes = found, other
    for _ in range(ROUNDS):
        dispersion = _dispersion(likelihood, field, axes, spectrum=7, channels=True)
        likelihood = replace(likelihood, dispersion=dispersion)
        field, _ = _minimised(likelihood, field, axes, spectrum=7, channels=True, steps=LAST_STEPS, least=LAST_DECREASE)
    return likelihood, field, axes


def covariance_of(likelihood: ShortLikelihood, field: ShortField, axes: Integers) -> np.ndarray:
    """Return the covariance (N D, N D), metres^2, of the positions at the optimum `field`, without rigid motions."""
    free = free_parameters(field, axes, channels=True, spectrum=7)
    at = np.searchsorted(np.flatnonzero(free), (5 * np.arange(len(field.positions))[:, None] + axes).ravel())
    inverse = np.linalg.pinv(likelihood.terms(field, free).fisher, rcond=1e-10, hermitian=True)
    motions = np.linalg.qr(rigid_motions(field.positions[:, axes]))[0]
    fixed = np.eye(len(at)) - motions @ motions.T
    return COVARIANCE_INFLATION * (fixed @ inverse[np.ix_(at, at)] @ fixed)


def enlarging(positions: Reals) -> np.ndarray:
    """Return the symmetric matrix S (N D, N D) for the claim S C S of a plane array at positions (N, D), metres.

    It enlarges size and shear in the plane, and has no effect on other moves.
    """
    centred = positions - positions.mean(axis=0)
    plane = np.linalg.svd(centred, full_matrices=False)[2][:2].T
    maps = np.asarray(np.kron(centred @ plane, plane), float)
    return np.eye(len(maps)) + (max(1.0, np.sqrt(len(positions) / STRETCH_COUNT)) - 1) * maps @ np.linalg.pinv(maps)


def _low(likelihood: ShortLikelihood, top: float) -> ShortLikelihood:
    """Return the likelihood of the wavenumbers up to `top`, rad/m, and at least of the lowest four."""
    k = likelihood.wavenumbers
    return _of_groups(likelihood, k <= max(top, np.unique(k)[:4][-1]))


def _of_groups(likelihood: ShortLikelihood, kept: Bools) -> ShortLikelihood:
    """Return the likelihood of the groups that are `kept`, (G,) bool."""
    k, takes, pressures = (part[kept] for part in (likelihood.wavenumbers, likelihood.takes, likelihood.pressures))
    return replace(likelihood, wavenumbers=k, takes=takes, pressures=pressures)


def with_rival(
    likelihood: ShortLikelihood, field: ShortField, axes: Integers, sought: Bools
) -> tuple[ShortField, np.ndarray | None]:
    """Return the likeliest field, and another array (N, D), metres, that fits the windows about as well, or None.

    In the other array one of the microphones that are `sought`, (N,) bool, stands elsewhere. If the source is near a
    plane of symmetry of the room, so is the field, and a microphone beyond that plane may stand at its mirror image.
    """
    low, part = (_low(likelihood, top) for top in (LOW_BAND, STAGES[-1]))
    low = replace(low, dispersion=_dispersion(low, field, axes, spectrum=5))
    places, gaps = other_places(low, field, axes, APART / LOW_BAND)
    gaps[~sought] = np.inf
    tried = list[tuple[float, ShortField]]()
    refit = functools.partial(_minimised, axes=axes, spectrum=7, channels=True, least=1.0)
    base = refit(part, field, steps=WAVE_STEPS)[1]
    for n in np.argsort(gaps)[:MAX_EXAMINED]:
        if gaps[n] > 2 * MISFIT_NATS:
            break
        x = np.array(field.positions)
        x[n] = places[n]
        found, other = refit(part, replace(field, positions=x), steps=WAVE_STEPS)
        moved = np.linalg.norm(align(found.positions, field.positions) - field.positions, axis=1).max()
        if moved > APART / LOW_BAND and other < base + 2 * MISFIT_NATS:
            tried.append((other, found))
    if not tried:
        return field, None
    found, other = refit(likelihood, min(tried, key=lambda one: one[0])[1])
    cost = likelihood.terms(field).cost
    if other > cost + MISFIT_NATS:
        return field, None
    better, rival = (found, field) if other < cost else (field, found)
    return better, rival.positions[:, axes] if other > cost - MISFIT_NATS else None


def _minimised(
    likelihood: ShortLikelihood,
    field: ShortField,
    axes: Integers,
    spectrum: int = 0,
    channels: bool = False,
    steps: int = STEPS,
    least: float = DECREASE,
) -> tuple[ShortField, float]:
    """Return the field with the lowest cost near `field`, and that cost.

    axes, spectrum, channels : what is free, as in `free_parameters`
    """
    free = free_parameters(field, axes, channels, spectrum)
    damping, index, cost = FIRST_DAMPING, np.flatnonzero(free), np.inf
    max_step = MAX_STEP * 2 * np.pi / float(likelihood.wavenumbers.max())
    for _ in range(steps):
        here = likelihood.terms(field, free)
        step = damped_step(
            field,
            NewtonTerms(here.cost, here.gradient, here.fisher),
            lambda tried: likelihood.terms(tried).cost,
            lambda y, field=field: advanced(field, np.asarray(np.bincount(index, y, len(free)), float)),
            lambda tried, field=field: float(np.abs(tried.positions - field.positions).max()),
            damping,
            max_step,
        )
        field, damping, cost = step.unknowns, step.damping, step.cost
        if step.decrease < least:
            break
    return field, cost


LOWEST_GROUPS = 5  # number of frequencies at which the coherence is examined
MIN_COHERENCE = 0.2  # smallest squared coherence with some other microphone; a dead channel has about 1 / windows
FLAT_NATS = 3.0  # evidence, nats, above which an array counts as flat
FLAT_SIGMA = 2e-3  # metres, standard deviation of the heights of a flat array as it is built
HEIGHT = 0.5  # prior sigma of the heights of an array that is not flat, divided by its RMS radius


def is_flat(windows: ShortWindows, sound_speed: float) -> bool:
    """Return whether the windows show an array that is flat within their accuracy (`flat_evidence`)."""
    correlated = _correlated(windows)
    if np.sum(correlated) < MIN_MICROPHONES:
        return False
    likelihood = likelihood_of(windows.of_microphones(correlated), sound_speed, np.zeros(int(np.sum(correlated))))
    start = _coherent(likelihood, 3)
    if start is None:
        return False
    try:
        likelihood, field, axes = fitted(likelihood, [(start, STAGES)])
        covariance = covariance_of(likelihood, field, axes)
    except np.linalg.LinAlgError:
        return False
    return flat_evidence(field.positions, covariance) > FLAT_NATS


def plane_axes(positions: Reals) -> np.ndarray:
    """Return the principal axes (D, D) of positions (N, D), metres, as rows, the shortest one last."""
    return np.linalg.svd(positions - positions.mean(axis=0), full_matrices=False)[2]


def flat_evidence(positions: Reals, covariance: Reals) -> float:
    """Return the log evidence, nats, for a flat array, relative to one that is not flat.

    h are the heights of positions (N, 3), metres, above the plane of least squares and C is their covariance, both
    without motions of the plane. If the heights of an array that is not flat have the sigma s, the evidence is

        [log det(I + s^2 C^-1) - h^T (C^-1 - (C + s^2 I)^-1) h] / 2
    """
    x: Reals = positions - positions.mean(axis=0)
    along = plane_axes(positions)
    rest: Reals = np.linalg.svd(np.column_stack([np.ones(len(x)), x @ along[:2].T]))[0][:, 3:]
    heights: Reals = rest.T @ x @ along[2]
    across: Reals = rest.T @ np.asarray(np.kron(np.eye(len(x)), along[2]), float)
    values, vectors = np.linalg.eigh(np.asarray(across @ covariance @ across.T, float))
    values = np.maximum(values, 1e-300)
    spread = np.asarray(HEIGHT**2 * 3 * float(np.mean(x**2)) / values)
    squares = np.asarray((heights @ vectors) ** 2 / values)
    return float(np.sum(np.log1p(spread) - squares * spread / (1 + spread)) / 2)


def _correlated(windows: ShortWindows) -> np.ndarray:
    """Return which microphones have a clear coherence with another one at the lowest frequencies : (N,) bool.

    A dead channel has no coherence with the others, so that the position found for it would be arbitrary.
    """
    p = windows.pressures[np.argsort(windows.frequencies)[:LOWEST_GROUPS]]
    return np.mean(squared_coherence(p), axis=0).max(axis=0) > MIN_COHERENCE


def _dispersion(
    likelihood: ShortLikelihood, field: ShortField, axes: Integers, spectrum: int, channels: bool = False
) -> float:
    """Return lambda of the module docstring, at least 1."""
    here = replace(likelihood, dispersion=1.0).terms(field, free_parameters(field, axes, channels, spectrum))
    (values, vectors), scores = np.linalg.eigh(here.fisher), here.scores - here.scores.mean(axis=0)
    kept = values > ZERO * values[-1]
    return max(1.0, float((np.sum(np.asarray(scores @ vectors[:, kept]) ** 2, axis=0) / values[kept]).mean()))
