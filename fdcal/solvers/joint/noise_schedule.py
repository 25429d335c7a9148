"""What `joint` supposes of noise and field in a stage, and what it makes of what the stage leaves unexplained.

Less noise is supposed in the end than there is, by up to 10 dB: the positions then lean on the pressures and not on the
field being isotropic, which in a room it is not. It takes away most of that prior's bias: see `confidence`.

All of them take the measured `Problem` and the `State` of `fdcal.solvers.joint`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...cost.likelihood import DiffuseField, diffuse_field
from ...cost.noise_model import NOISE, NoiseEstimate
from ...model.power import mode_power
from ...model.problem import Problem
from ...model.settings import SolverSettings
from ...model.validation import frozen_array
from .. import initial_positions
from .state import State

NOISY_ENOUGH = 3e-3  # noise's share of the power from which it pays to learn
UNEXPLAINED = 3.0  # times the noise told: more of it and what is told is not believed
EVEN = 1.05  # times the noise left: less of noise and spread together, and the microphones are as good as in place
CONVINCING = 1.2  # times the noise told: less of it, and the end needs no other attempt
NOISY = {2: 0.1, 3: 0.01}  # share of noise in the power from which the prior is trusted, in 2-D and 3-D
FAINT = 1e-4  # part of the power that need not be explained in any case


def confidence(share: np.ndarray, problem: Problem) -> np.ndarray:
    """By how much less noise is supposed than its share of the power, from 1 to 10.

    The prior of an isotropic field pulls at the positions with a force that does not shrink with the noise. Supposing
    less noise weakens that pull as much against the pressures. In much noise the prior is needed, and its pull is
    smaller than the error; in space, where a mode has more coefficients, sooner; and always where the array is a plane
    of it, since then the prior is what tells its size.
    """
    if problem.array_dimension < problem.dimension:
        return np.ones_like(share)
    return np.clip(NOISY[problem.dimension] / np.maximum(share, 1e-12), 1.0, 10.0)


def model(problem: Problem, state: State) -> tuple[np.ndarray, DiffuseField]:
    """Pressures (modes in use, N) of the stage and what it supposes of their field; for a bend, of enough modes."""
    used = initial_positions.plenty(problem, state.modes) if state.phase == "bend" else state.modes
    p, k, noise = (values[used] for values in (problem.pressures, problem.wavenumbers, state.noise))
    likely = state.settings.cost == "likelihood"
    field = diffuse_field(p, k, noise, problem.dimension, likely, state.near, state.shape)
    return p, field if state.prior is None else replace(field, prior=state.prior)


def supposing(problem: Problem, state: State, rest: NoiseEstimate | None = None) -> State:
    """The noise is what the positions leave unexplained or, in the end, that of the measurement."""
    rest = initial_positions.left_over(problem, state.positions, state.modes) if rest is None else rest
    power = mode_power(problem.pressures)
    told = told_noise(problem, state.settings)
    share, near = rest.shares(problem.wavenumbers), False
    if state.phase == "sharp":
        believed = told is not None and rest.noise <= UNEXPLAINED * float(np.median(told / power))
        share = told / power if believed else rest.shares(problem.wavenumbers, spread=False)
        near = bool(np.median(share[state.modes]) <= NOISE.near_field(problem.dimension))
        # What the real kernel leaves unexplained says little of the noise where the near model is yet to come.
        leap = near and not believed and not state.near and attempt(problem, state)[0] != "gentle"
        share = np.zeros_like(share) if leap else share / confidence(share, problem)
    least = NOISE.near_field_floor if near or state.near else NOISE.diffuse_floor
    return replace(
        state,
        noise=frozen_array(np.maximum(share, least) * power, float),
        noise_power=frozen_array(rest.noise * power if told is None else told, float),
        noise_told=told is not None,
        near=near,
        spread=rest.spread,
    )


def attempt(problem: Problem, state: State) -> tuple[str, float]:
    """Which of `starts.attempts` this is."""
    return initial_positions.attempts(problem, state.settings.modes)[state.attempt]


def told_noise(problem: Problem, settings: SolverSettings) -> np.ndarray | None:
    """Noise power (M,) that the settings or the measurement tell, None where it is to be estimated."""
    if settings.snr_db is not None:
        return mode_power(problem.pressures) / (1 + 10 ** (settings.snr_db / 10))
    return problem.noise_power if settings.noise == "reported" else None


def rough(problem: Problem, state: State, rest: NoiseEstimate) -> bool:
    """Whether the spread still falls and is more than the noise, or a microphone stands in a wrong basin."""
    highest = float(np.real(problem.wavenumbers[state.modes]).max())
    spread = (highest * rest.spread) ** 2 / rest.dimension > rest.noise and rest.spread < 0.7 * state.spread
    return spread or (
        state.stage_steps > 1
        and float(initial_positions.misfits(problem, state.positions, state.modes, rest).max())
        > (initial_positions.ASTRAY if even(problem, rest) else initial_positions.MISFIT)
    )


def even(problem: Problem, rest: NoiseEstimate) -> bool:
    """Whether noise alone is left: a wrong end, even one that two attempts share, leaves a spread."""
    return float(np.median(rest.shares(problem.wavenumbers))) <= max(EVEN * rest.noise, FAINT)


def another(problem: Problem, state: State, sharper: State) -> bool:
    """Whether `sharper` supposes other noise than `state`: less, or, after the least that there can be, a little."""
    before, after = (float(np.median(s.noise / mode_power(problem.pressures))) for s in (state, sharper))
    least = before <= 2 * NOISE.near_field_floor
    return after < 0.5 * before or (least and 2 * before < after <= NOISE.near_field(problem.dimension))


def worth_learning(problem: Problem, state: State) -> bool:
    """Whether there is so much noise that directions learned from the pressures help."""
    noisy = float(np.median(state.noise_power / mode_power(problem.pressures))) >= NOISY_ENOUGH
    return problem.dimension == 2 and noisy and state.settings.cost == "likelihood"


def faint(problem: Problem, state: State) -> float | None:
    """Share of the noise told, where it is so little that the near model is to explain all; None elsewhere."""
    share = float(np.median(state.noise_power / mode_power(problem.pressures)))
    return share if state.noise_told and share <= NOISE.near_field(problem.dimension) else None


def certain(problem: Problem, state: State) -> bool:
    """Whether hardly any noise is told and the near model explains all but that."""
    told = faint(problem, state)
    if told is None:
        return False
    return initial_positions.left_over(problem, state.positions, state.modes, True, told).chi_square <= NOISE.chi_square


def attempts(problem: Problem, state: State) -> list[tuple[str, float]]:
    """What may be tried: `starts.attempts`, the last of which is for the near model."""
    tries = initial_positions.attempts(problem, state.settings.modes)
    return tries if state.near or faint(problem, state) is not None else tries[:-1]


def outdone(problem: Problem, state: State) -> bool:
    """Whether an attempt before ended better than where this one is, by the same model."""
    if state.best is None:
        return False
    cost, near = state.best[0], state.best[-1] and faint(problem, state) is None
    return cost < initial_positions.left_over(problem, state.positions, state.modes, near).cost


def convincing(problem: Problem, state: State, rest: NoiseEstimate) -> bool:
    """Whether what an attempt leaves is the noise told, or, where none is, what another attempt has left, too.

    Two attempts may share a wrong end, which leaves a spread; not so easily one with another direction.
    """
    redirected = ("redirected", 0) in attempts(problem, state)[: state.attempt + 1]
    same = state.best is not None and abs(state.best[0] - rest.cost) < 1.0 + 1e-4 * abs(rest.cost)
    if faint(problem, state) is not None:
        return same and redirected
    told = float(np.median(state.noise_power / mode_power(problem.pressures))) if state.noise_told else 0.0
    share = float(np.median(rest.shares(problem.wavenumbers)))
    if share <= max(EVEN * told, FAINT):
        return True
    return (even(problem, rest) and (share <= CONVINCING * told or same)) or (same and redirected)
