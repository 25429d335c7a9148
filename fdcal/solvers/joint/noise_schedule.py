"""The noise and the sound field that the joint solver assumes in a stage.

In the end less noise is assumed than there is, by up to 10 dB: the positions then depend more on the pressures and
less on the assumption that the field is isotropic, which the field in a room is not. This removes most of the bias of
that assumption (`noise_deflation`).
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
from ..initial_positions import attempts
from ..residual_noise import enough_modes, noise_at
from .state import State
from .thresholds import NOISE_LIMITS


def noise_deflation(share: np.ndarray, problem: Problem) -> np.ndarray:
    """Return the factor by which less noise is assumed than there is, from 1 to 10.

    The prior of an isotropic field biases the positions by an amount that does not shrink with the noise. Assuming
    less noise weakens the prior against the pressures. With much noise the prior is needed and its bias is smaller
    than the error; in space, where a mode has more coefficients, this begins at less noise. A plane array in a field
    of three dimensions always needs the prior, since it determines its size.

    Parameters
    ----------
    share : (M,) float64, noise's share of the power
    problem : Problem

    Returns
    -------
    (M,) float64
    """
    if problem.array_dimension < problem.dimension:
        return np.ones_like(share)
    return np.clip(NOISE_LIMITS.deflated(problem.dimension) / np.maximum(share, 1e-12), 1.0, NOISE_LIMITS.deflation)


def stage_model(problem: Problem, state: State) -> tuple[np.ndarray, DiffuseField]:
    """Return the pressures (modes, N) that the stage uses and the model of their field.

    These are the modes in use; in phase "deformation", which has few parameters, a part of them.
    """
    used = enough_modes(problem, state.modes) if state.phase.name == "deformation" else state.modes
    assumed = state.field
    p, k, noise = (values[used] for values in (problem.pressures, problem.wavenumbers, assumed.noise))
    with_log_det = state.settings.cost == "likelihood"
    field = diffuse_field(p, k, noise, problem.dimension, with_log_det, assumed.near_field, state.phase.origin)
    return p, field if assumed.prior is None else replace(field, prior=assumed.prior)


def with_noise(problem: Problem, state: State, residual: NoiseEstimate | None = None) -> State:
    """Return `state` with the noise that its stage assumes.

    That is the whole residual at its positions or, in phase "refinement", the noise of the measurement, deflated.
    """
    residual = noise_at(problem, state.positions, state.modes) if residual is None else residual
    power = mode_power(problem.pressures)
    given = given_noise(problem, state.settings)
    share, near_field = residual.shares(problem.wavenumbers), False
    if state.phase.name == "refinement":
        believed = given is not None and residual.noise <= NOISE_LIMITS.believed * float(np.median(given / power))
        share = given / power if believed else residual.shares(problem.wavenumbers, spread=False)
        near_field = bool(np.median(share[state.modes]) <= NOISE.near_field(problem.dimension))
        # The residual of the real kernel says little about the noise until the near-field model has been used.
        at_once = near_field and not believed and not state.field.near_field and attempt(problem, state)[0] != "gradual"
        share = np.zeros_like(share) if at_once else share / noise_deflation(share, problem)
    least = NOISE.near_field_floor if near_field or state.field.near_field else NOISE.diffuse_floor
    assumed = replace(
        state.field,
        noise=frozen_array(np.maximum(share, least) * power, float),
        noise_power=frozen_array(residual.noise * power if given is None else given, float),
        noise_given=given is not None,
        near_field=near_field,
        spread=residual.spread,
    )
    return replace(state, field=assumed)


def attempt(problem: Problem, state: State) -> tuple[str, float]:
    """Return kind and value of the present attempt, of `fdcal.solvers.initial_positions.attempts`."""
    return attempts(problem, state.settings.modes)[state.attempt.number]


def given_noise(problem: Problem, settings: SolverSettings) -> np.ndarray | None:
    """Return the noise power (M,) that the settings or the measurement report; None if it must be estimated."""
    if settings.snr_db is not None:
        return mode_power(problem.pressures) / (1 + 10 ** (settings.snr_db / 10))
    return problem.noise_power if settings.noise == "reported" else None
