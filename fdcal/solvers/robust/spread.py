"""The covariance of the positions that the likelihood solver finds: by its model, and corrected by the data.

    H      Gauss-Newton matrix of cost and priors over all free unknowns;  P = H^-1, the covariance by the model
    g_b    gradient of one block, minus the mean over blocks; a block is a group of neighbouring rows, sorted by take
           and frequency, or the arrivals of a take
    H_b    part of H that belongs to block b

H is computed with the power of the field multiplied by `FIELD_POWER_FACTOR`, which weakens the prior of an isotropic
field. A combination of positions that then becomes uncertain was determined by that prior and not by the wave equation.
Without given positions the covariance excludes the rigid motions of the array, or belongs to the array moved into its
frame.

A room is not the random field of the model, so that its blocks differ by more, or less, than H predicts. The sandwich
estimator measures this (Huber 1967, White 1980), with the leverage of each block corrected as if the block were left
out (MacKinnon and White 1985):

    J = sum_b H^-1 g_b g_b^T (H - H_b)^-1,    Q = P (sum_b H_b) P,    dispersion = tr J / tr Q

The traces are over the coordinates of healthy microphones. Where the model holds, J equals Q on average: the part of P
that is due to errors of the data. The other part of P is due to the priors, and the blocks hold no information on it.

Where short windows are used (`windows`), the likelihood is tempered, and H is computed with the power of the field as
it is. The size and the shear of a plane array without given positions are then less certain (`windows.enlarging`).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ...model.gauge import GaugeFrame, rigid_motions
from ...model.problem import Problem
from ...model.validation import Bools, Reals
from ..interface import PositionSpread
from . import noise
from . import objective as objectives
from .objective import Evaluation, Objective, Quadratic, Unknowns
from .state import State
from .windows import enlarging, must_be_flat

# Number of blocks of rows, and the least number that gives a dispersion. Neighbouring rows are not independent: with 20
# blocks J would be a tenth lower.
BLOCKS, MIN_BLOCKS = 10, 4
LEVERAGE = 0.95  # part of H_b that is subtracted from H, so that H - H_b is regular even if one block determines all


@dataclass(frozen=True)
class Claim:
    """The objective at the end of a run, and the covariance that follows from it."""

    objective: Objective
    evaluated: Evaluation  # the objective at the final unknowns
    weakened: Evaluation  # the objective at the same unknowns, with a more powerful field
    likely: Quadratic  # quadratic of the weakened objective
    spread: PositionSpread
    excess: float  # ratio of the claimed variance to that of the likelihood, at least 1


def claim_of(problem: Problem, state: State) -> Claim:
    """Return objective and covariance at `state`, in its last stage."""
    used, here = objectives.used_modes(problem, state), objectives.unknowns_of(state)
    objective = objectives.objective_of(problem, state, used)
    evaluated = objective.evaluate(here)
    try:
        weakened = objective.weakened().evaluate(here)
    except np.linalg.LinAlgError:  # C is singular with the more powerful field
        weakened = evaluated
    own, likely = objectives.quadratic(here, objective, evaluated), objectives.quadratic(here, objective, weakened)
    counted = np.repeat(noise.healthy(state.model), state.positions.shape[1])
    gauge = _gauge(problem, state.positions, counted)
    newton = gauge @ likely.covariance @ gauge.T
    data, dispersion = _of_data(problem, state, objective, likely, gauge, counted)
    if not len(problem.known):  # without given positions the size of the array is as uncertain as the sound speed
        x = (state.positions - state.positions.mean(axis=0)).ravel()
        newton = newton + (state.settings.sound_speed_sigma or 0.0) ** 2 * np.outer(x, x)
        if state.model.window_positions is not None and (problem.array_dimension == 2 or must_be_flat(state.positions)):
            wide = enlarging(state.positions)
            newton, data = wide @ newton @ wide, wide @ data @ wide
    spread = PositionSpread(newton, data, dispersion, own.step, own.sigma)
    claimed, least = (float(np.sum(np.diag(one)[counted])) for one in (spread.covariance, own.covariance))
    return Claim(objective, evaluated, weakened, likely, spread, excess=max(1.0, claimed / max(least, 1e-300)))


def _of_data(
    problem: Problem, state: State, objective: Objective, likely: Quadratic, gauge: Reals, counted: Bools
) -> tuple[Reals, float]:
    """Return Q of the module docstring (N D, N D), and tr J / tr Q, which is 1 if there are too few blocks.

    counted : (N D,) bool, coordinates over which the traces are taken; gauge : (N D, N D), result of `_gauge`
    """
    here, index = likely.unknowns, np.ix_(likely.free, likely.free)
    order = np.argsort(problem.takes[objectives.used_modes(problem, state)], kind="stable")
    blocks = np.array_split(order, max(1, min(BLOCKS, len(order) // 2)))
    gradients, matrices = list[Reals](), list[Reals]()
    field = objective.field
    for rows in blocks:
        k, power, noise_power = field.wavenumbers[rows], field.power[rows], field.noise[rows]
        directions = None if field.directions is None else field.directions[rows]
        of_rows = replace(field, wavenumbers=k, power=power, noise=noise_power, directions=directions)
        part = replace(objective, pressures=objective.pressures[rows], field=of_rows, arrivals=None, windows=None)
        gradients.append(part.likelihood(here)[0][likely.free])
        matrices.append(part.weakened().likelihood(here)[1][index])
    for gradient, matrix in _of_arrivals(here, objective):
        gradients.append(gradient[likely.free])
        matrices.append(matrix[index])
    outputs = np.zeros((gauge.shape[0], len(likely.free)))
    outputs[:, : len(likely.coordinates)] = gauge[:, likely.coordinates]
    across = outputs @ likely.inverse
    data = across @ np.sum(matrices, axis=0) @ across.T
    if len(blocks) < MIN_BLOCKS:
        return data, 1.0
    try:
        return data, sandwich(likely.inverse, np.array(gradients), np.array(matrices), outputs[counted])
    except np.linalg.LinAlgError:
        return data, 1.0


def sandwich(P: Reals, gradients: Reals, matrices: Reals, outputs: Reals) -> float:
    """Return tr J / tr Q of the module docstring for linear functions of the unknowns, the rows of `outputs` (K, F).

    P : (F, F); gradients, matrices : (B, F) and (B, F, F), g_b and H_b of the blocks
    """
    H, centred, across = np.linalg.inv(P), gradients - gradients.mean(axis=0), outputs @ P
    others = np.asarray(H - LEVERAGE * matrices)
    left_out = np.asarray(np.linalg.solve(others, np.asarray(centred[..., None])))[..., 0]
    found = np.sum((centred @ across.T) * (left_out @ outputs.T))
    model = np.sum((across @ matrices.sum(axis=0)) * across)
    return float(found / model) if model > 0 else 1.0


def _of_arrivals(here: Unknowns, objective: Objective) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield gradient and Gauss-Newton matrix of each take's arrivals with respect to all unknowns."""
    if objective.arrivals is None:
        return
    index = objectives.arrival_index(here)
    terms = objective.arrivals.terms(here.positions, here.log_speed, True, here.delays)
    for gradient, slopes in zip(terms.gradient, terms.slopes, strict=True):
        whole, matrix = np.zeros(here.vector.size), np.zeros((here.vector.size,) * 2)
        whole[index], matrix[np.ix_(index, index)] = gradient, slopes.T @ slopes
        yield whole, matrix


def _gauge(problem: Problem, positions: Reals, counted: Bools) -> np.ndarray:
    """Return the projection (N D, N D) that removes the rigid motions of an array; the identity with given positions.

    The array is held fixed in its frame or, without a frame, at the coordinates `counted` (N D,) bool, those of the
    healthy microphones. The position found for a dead channel is arbitrary and would move the array as a whole.
    """
    size = positions.size
    if len(problem.known):
        return np.eye(size)
    R = rigid_motions(positions)
    if problem.frame is None:
        fixed = R.T * counted if np.sum(counted) >= R.shape[1] else R.T
    else:
        fixed = _frame_rows(problem.frame, positions)
    return np.eye(size) - R @ np.linalg.solve(fixed @ R, fixed)


def _frame_rows(frame: GaugeFrame, positions: Reals) -> np.ndarray:
    """Return the linear functions of the positions that the frame fixes, as rows (F, N D)."""
    N, D = positions.shape
    axes = np.linalg.qr((positions[frame.microphones[1:]] - positions[frame.microphones[0]]).T)[0]
    fixed = [(frame.microphones[0], along) for along in np.eye(D)]
    fixed += [(n, axes[:, a]) for i, n in enumerate(frame.microphones[1:D]) for a in range(i + 1, D)]
    rows = np.zeros((len(fixed), N, D))
    for row, (n, along) in zip(rows, fixed, strict=True):
        row[n] = along
    return rows.reshape(len(fixed), -1)
