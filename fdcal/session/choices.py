"""What somebody chooses for a calibration: solver, number of modes, seed and settings, checked against the solver."""

from __future__ import annotations

from dataclasses import replace

from ..model.settings import SolverSettings
from ..model.validation import InputError, require_integer
from ..solvers import load
from .sources import CalibrationInput, with_mode_number

# of solver robust; joint takes the last one, too
CHANNEL_SETTINGS = ("gains", "gain_sigma_db", "phase_sigma_deg", "known_sigma", "sound_speed_sigma")


def with_settings(
    inputs: CalibrationInput,
    solver: str | None = None,
    modes: int | None = None,
    seed: int | None = None,
    **others: str | float | tuple[float, ...] | None,
) -> CalibrationInput:
    """Return `inputs` with another solver, number of modes, seed, or other fields of `SolverSettings`.

    Parameters
    ----------
    inputs : CalibrationInput
    solver, modes, seed, **others
        None leaves a setting as it is.

    Raises
    ------
    InputError
        A value is out of range, or does nothing with this solver.
    """
    given = {key: value for key, value in others.items() if value is not None}
    settings = replace(inputs.settings, **given)
    if seed is not None:
        require_integer("seed", seed)
    if modes is not None:
        require_integer("modes", modes, 1, f"use 1 to {len(inputs.measurement.frequencies)}")
        settings = replace(settings, modes=modes, first_modes=min(settings.first_modes, modes))
        inputs = replace(inputs, all_modes=False)
    settings = replace(settings, name=settings.name if solver is None else solver)
    traits = load(settings.name).TRAITS
    _require_used(given, settings)
    if traits.needs_room and inputs.scene is not None:
        from ..model.scene import require_rectangle

        require_rectangle(inputs.scene)
        settings = replace(settings, room=settings.room or inputs.scene.room.size)
    return with_mode_number(replace(inputs, settings=settings, seed=inputs.seed if seed is None else seed))


def _require_used(given: dict, settings: SolverSettings) -> None:
    """Raise InputError for a given setting that does nothing with the solver of `settings`."""
    traits, remedies = load(settings.name).TRAITS, dict.fromkeys(("noise", "start"), "joint")
    remedies |= dict.fromkeys(CHANNEL_SETTINGS, "robust")
    for key, other in remedies.items():
        ignored = traits.ignores(key) or (key == "start" and not traits.starts)
        if key in given and ignored:
            problem = f'{key} = "{given[key]}" does nothing with solver.name = "{settings.name}"'
            raise InputError(problem, f"leave out <{key}>, or use <solver> {other}", key=key, value=given[key])
    for key in ("gain_sigma_db", "phase_sigma_deg"):
        if key in given and settings.gains == "fixed":
            problem = f"{key} = {given[key]:g} does nothing with solver.gains = fixed"
            raise InputError(problem, f"leave out <{key}>, or use <gains> auto", key=key, value=given[key])
