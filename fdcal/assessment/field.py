"""The sound field between the microphones, and the prediction of each microphone by the others.

The expansion of Eq. 2 is fitted to the pressures of each frequency. The prior of its coefficients is a diffuse field in
noise, so that a high order does no harm. The fit is the conditional mean of a Gaussian process with the covariance
s W W^H + v I; k may be complex.

    alpha = A^-1 W^H p,    A = W^H W + mu I,    mu = v / s,    p(x) = w(x)^T alpha,    sigma(x)^2 = v w^T A^-1 w*

    W, w     dictionary at the microphones and at x, about the centre of the array (Eq. 4, or its equivalent in space)
    s, v     power of the field and of the noise
    C        W W^H + mu I; the leave-one-out error of p_n is (C^-1 p)_n / (C^-1)_nn

Cross-validation does not need the true positions and can therefore check every calibration. It is slightly optimistic,
because the pressures of a microphone were used to estimate its position.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from ..acoustics.dictionary import dictionary, max_order
from ..cost.kernels import applied, blocks, hermitian_inverses
from ..cost.likelihood import FieldModel, field_covariance, isotropic_field
from ..cost.noise import DIFFUSE_FLOOR, estimate_noise
from ..model.measurement import Measurement
from ..model.problem import Problem, mode_power
from ..model.quantities import Hertz, Metres
from ..model.validation import InputError, convert, frozen_array

EXTRA_ORDERS = 8  # orders beyond ceil(k R), after which the rest of W W^H is below 1e-9
NOISE_DEFLATION = 3.0  # divisor of the noise in mu, because a room's field is less isotropic than this prior
TINY = np.finfo(float).tiny
BLOCK = 4096  # points evaluated together
CELLS = 60  # lattice cells along the longest side, unless a step is given
MAX_POINTS = 500_000  # of the lattice
FREQUENCY_TOLERANCE = 0.05  # largest relative difference between the frequency asked for and the nearest measured one
EDGE = 1e-9  # tolerance, as a fraction of the array's extent, so that microphones on the hull are inside


def interpolated(
    problem: Problem, positions, points, modes: slice, noise: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pressures (modes, C) at points (C, D), metres, from microphones at `positions` (N, D), and one sigma.

    `noise` (M,) is estimated if None.
    """
    x, field, D = np.asarray(positions, float), _field(problem, positions, modes, noise), problem.dimension
    centre, p, k = x.mean(axis=0), problem.pressures[modes], problem.wavenumbers[modes]
    orders = max_order(k, float(np.linalg.norm(x - centre, axis=1).max()), EXTRA_ORDERS).tolist()
    pressure, sigma = np.empty((len(p), len(points)), complex), np.empty((len(p), len(points)))
    for m, mu in enumerate(field.noise / (NOISE_DEFLATION * field.power)):
        W = dictionary(x, k[m], orders[m], centre, D)
        G = cholesky(W.conj().T @ W + mu * np.eye(W.shape[1]), lower=True)
        alpha = cho_solve((G, True), W.conj().T @ p[m])
        for start in range(0, len(points), BLOCK):
            block = slice(start, start + BLOCK)
            w = dictionary(points[block], k[m], orders[m], centre, D)
            whitened = solve_triangular(G, w.conj().T, lower=True)
            pressure[m, block] = w @ alpha
            sigma[m, block] = np.sqrt(field.noise[m] * np.sum(np.abs(whitened) ** 2, axis=0))
    return pressure, sigma


def leave_one_out_errors(
    problem: Problem, positions, modes: slice, noise: np.ndarray | None = None, healthy: np.ndarray | None = None
) -> np.ndarray:
    """Return the pressure of each microphone minus its prediction by the others : (modes, N) complex128.

    Only `healthy` (N,) bool microphones are used to predict; None for all. Other parameters as of `interpolated`.
    """
    x, errors = np.asarray(positions, float), np.array(problem.pressures[modes])
    seen = np.ones(len(x), bool) if healthy is None else healthy
    some = replace(problem, pressures=problem.pressures[:, seen])
    field = replace(_field(some, x[seen], modes, noise), wavenumbers=problem.wavenumbers[modes], about=x[seen])
    mu, diagonal = field.noise / (NOISE_DEFLATION * field.power), np.arange(int(np.sum(seen)))
    for m in blocks(len(errors), 2 * len(x) ** 2):
        K = field_covariance(x, field, m, False)[0]
        C = K[:, seen][:, :, seen]
        C[:, diagonal, diagonal] += mu[m, None]
        inverse = hermitian_inverses(np.ascontiguousarray(C))[0]
        u = applied(inverse, errors[m][:, seen])
        predicted = applied(np.ascontiguousarray(K[:, ~seen][:, :, seen]), u)
        errors[m, ~seen] -= predicted
        errors[m, seen] = u / np.real(inverse[:, diagonal, diagonal])
    return errors


def _field(problem: Problem, positions, modes: slice, noise: np.ndarray | None) -> FieldModel:
    """Return an isotropic field of the modes in use, with the `noise` (M,) or, without it, with the estimated noise."""
    p, k = problem.pressures[modes], problem.wavenumbers[modes]
    power = mode_power(p)
    if noise is None:
        unit = p / np.sqrt(power)[:, None]
        field = isotropic_field(unit, k, np.zeros(len(p)), problem.dimension)
        v = estimate_noise(positions, unit, field, DIFFUSE_FLOOR).alone * power
    else:
        v = np.maximum(np.asarray(noise)[modes], DIFFUSE_FLOOR * power)
    return isotropic_field(p, k, v, problem.dimension)


@dataclass(frozen=True)
class CrossValidation:
    """Leave-one-out prediction error over pressure, in decibels."""

    overall: float  # power of the error over power of the pressures, every mode with the same weight
    microphones: np.ndarray  # (N,) float64, the same for each microphone
    modes: np.ndarray  # (modes in use,) float64, of each frequency


def cross_validate(
    problem: Problem, positions, modes: slice, noise: np.ndarray | None = None, healthy: np.ndarray | None = None
) -> CrossValidation:
    """Return the normalised leave-one-out errors; `problem` has pressures divided by the gains of the channels."""
    if healthy is not None and (np.all(healthy) or np.sum(healthy) <= problem.array_dimension):
        healthy = None
    errors = leave_one_out_errors(problem, positions, modes, noise, healthy)
    return summarise(problem.pressures[modes], errors, healthy)


def summarise(pressures: np.ndarray, errors: np.ndarray, healthy: np.ndarray | None = None) -> CrossValidation:
    """Return the normalised powers of the leave-one-out errors of pressures (M, N), averaged over `healthy` ones."""
    counted = slice(None) if healthy is None else healthy
    power = mode_power(pressures[:, counted])[:, None]
    signal, error = np.abs(pressures) ** 2 / power, np.abs(errors) ** 2 / power
    return CrossValidation(
        overall=float(_decibels(error[:, counted].sum() / signal[:, counted].sum())),
        microphones=frozen_array(_decibels(error.sum(axis=0) / np.maximum(signal.sum(axis=0), TINY)), float),
        modes=frozen_array(_decibels(error[:, counted].mean(axis=1)), float),
    )


def _decibels(ratio):
    return 10 * np.log10(np.maximum(ratio, 1e-30))


@dataclass(frozen=True)
class FieldMap:
    """Pressures on a lattice inside an array."""

    axes: tuple[np.ndarray, ...]  # D arrays of float64, metres, the coordinates of the lattice
    frequencies: np.ndarray  # (F,) float64
    # (F, nx, ny[, nz]) complex128, in the measurement's unit, time sign exp(+j w t); NaN outside the array
    pressure: np.ndarray
    uncertainty: np.ndarray  # the same shape, float64, one sigma
    microphones: np.ndarray  # (N, D) float64, metres

    @property
    def inside(self) -> np.ndarray:
        """Points of the lattice that lie in the convex hull of the array : (nx, ny[, nz]) bool."""
        return np.isfinite(self.uncertainty[0])

    @property
    def points(self) -> np.ndarray:
        """Points inside the array, (P, D) float64, metres, the last coordinate fastest."""
        return np.stack([grid[self.inside] for grid in np.meshgrid(*self.axes, indexing="ij")], axis=-1)


def field_map(
    measurement: Measurement, positions, wanted, step: float | None = None, speed: float | None = None
) -> FieldMap:
    """Return the field between microphones at `positions` (N, D), metres, at some of the measured frequencies.

    The first take is used if there are several. wanted : frequencies, Hz, by default the lowest, middle and highest;
    step : of the lattice, metres, by default a sixtieth of the longest side; speed : sound speed, m/s, by default that
    of the measurement
    """
    x = np.asarray(positions, float)
    if measurement.take_count > 1:  # equal frequencies of other takes are other fields
        measurement = measurement.of_take(int(measurement.takes.min()))
    modes = _nearest(measurement.frequencies, wanted)
    axes, inside = _lattice(x, step)
    pressure = np.full((len(modes), *inside.shape), complex(np.nan, np.nan))
    found = FieldMap(axes, measurement.frequencies[modes], pressure, np.full(pressure.shape, np.nan), x)
    points = np.stack([grid[inside] for grid in np.meshgrid(*axes, indexing="ij")], axis=-1)
    problem = measurement.problem("unit", "none")
    if speed is not None:
        problem = replace(problem, wavenumbers=problem.wavenumbers * (problem.sound_speed / speed), sound_speed=speed)
    for i, m in enumerate(modes):
        one = interpolated(problem, x, points, slice(m, m + 1), problem.noise_power)
        largest = np.abs(measurement.pressures[m]).max()  # whose square may overflow
        unit = largest * np.sqrt(mode_power(measurement.pressures[m : m + 1] / largest))
        found.pressure[i, inside], found.uncertainty[i, inside] = (unit * part[0] for part in one)
    return found


def _nearest(measured: np.ndarray, wanted) -> list[int]:
    """Return the numbers of the measured frequencies nearest to those wanted, each once."""
    if wanted is None:
        return sorted({0, len(measured) // 2, len(measured) - 1})
    found = set()
    for f in wanted:
        convert(f, Hertz, "frequencies")
        nearest = int(np.argmin(np.abs(measured - f)))
        if abs(measured[nearest] - f) > FREQUENCY_TOLERANCE * f:
            problem = f"frequencies = {f:g} Hz: nothing was measured there, the nearest is {measured[nearest]:.4g} Hz"
            remedy = f"choose <frequencies> of the {len(measured)} from {measured[0]:.4g} to {measured[-1]:.4g} Hz"
            raise InputError(problem, remedy, key="frequencies")
        found.add(nearest)
    return sorted(found)


def _lattice(positions: np.ndarray, step: float | None) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """Return the axes of a lattice over the array, and which of its points are inside."""
    from scipy.spatial import Delaunay, QhullError  # takes a tenth of a second to load

    low, extent = positions.min(axis=0), np.ptp(positions, axis=0)
    step = float(extent.max() / CELLS if step is None else step)
    convert(step, Metres, "step")
    counts = np.maximum(np.ceil(extent / step * (1 - EDGE)) + 1, 2)
    if np.prod(counts) > MAX_POINTS:
        problem = f"step = {step:g} m makes {np.prod(counts):.3g} points, more than {MAX_POINTS}"
        raise InputError(problem, "use a larger one for <step>", key="step")
    margin = ((counts - 1) * step - extent) / 2
    axes = tuple(a - m + step * np.arange(int(n)) for a, m, n in zip(low, margin, counts, strict=True))
    try:
        hull = Delaunay(positions)
    except QhullError:
        problem = "the microphones lie on a line or in a plane and enclose no field"
        raise InputError(problem, "use an array that does") from None
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return axes, hull.find_simplex(points, tol=EDGE) >= 0
