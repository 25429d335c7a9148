"""Restarts: where the solver begins, how it returns to the likeliest optimum, and how a run ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...cost.likelihood import FieldModel
from ...model.gauge import align, move_to_frame
from ...model.problem import Problem
from ...model.settings import SolverSettings
from ...model.validation import InputError, frozen_array
from .. import starts
from . import given, noise
from .groups import other_poses
from .objective import corrected, first_model, in_unit_power, used_modes, wavenumbers
from .outliers import relocated
from .rules import ASSUMED, FINAL, NOISELESS, OUTLIERS, SCHEDULE, STAGES, STEPS
from .state import KernelName, LocalOptimum, Model, Progress, State


def begin(
    Kind: type[State], problem: Problem, settings: SolverSettings, seed: int, positions: np.ndarray | None
) -> State:
    """Return the first state, of the class of a preset, at the first start or at `positions` (N, D), metres."""
    problem, N = in_unit_power(problem), problem.pressures.shape[1]
    here = np.zeros((N, problem.array_dimension)) if positions is None else np.asarray(positions, float)
    empty = Kind(
        positions=here,
        settings=settings,
        seed=seed,
        stage=-1,  # `begin_stage` counts the first
        last=settings.modes,
        gains=np.zeros((N, 2)),
        offsets=np.zeros((N, 2)),
        model=first_model(problem, settings),
        progress=Progress(restart=0, stage=0, rounds=0, steps=0, damping=0.0),
        shape=here,
        optima=(),
    )
    return next_restart(problem, empty, 0) if positions is None else begin_restart(problem, empty, here, 0)


def begin_stage(problem: Problem, state: State, stage: int) -> State:
    """Return `state` at the beginning of a stage of the schedule, exact given positions in place."""
    damping = STEPS.deformation_damping if STAGES[stage].degree else STEPS.damping
    progress, x = replace(state.progress, stage=stage, steps=0, damping=damping), state.positions
    if state.model.known_sigma == 0 and not STAGES[stage].degree:
        x = np.array(x)
        x[problem.known] = state.model.places
        x = frozen_array(x, float)
    return replace(state, stage=state.stage + 1, progress=progress, positions=x, shape=x)


def begin_restart(problem: Problem, state: State, positions: np.ndarray, restart: int) -> State:
    """Return `state` at the beginning of a restart at `positions` (N, D), metres."""
    placed = positions if problem.frame is None else move_to_frame(positions, problem.frame)
    x, zero = frozen_array(placed, float), frozen_array(np.zeros((len(positions), 2)), float)
    model = first_model(problem, state.settings)
    progress = Progress(restart=restart, stage=0, rounds=0, steps=0, damping=0.0)
    begun = replace(state, positions=x, shape=x, gains=zero, offsets=zero, model=model, progress=progress)
    return begin_stage(problem, noise.with_noise(problem, begun), 0)


def next_restart(problem: Problem, state: State, restart: int) -> State:
    """Return the first restart, from number `restart` on, that has a start, or the last stage if there is none left.

    Raises InputError where no start is possible at all.
    """
    reported = noise.given_noise(problem, state)
    level = None if reported is None else float(np.median(reported[state.modes]))
    affine_first = is_noiseless(problem, state) or state.quick
    plan = starts.plan(problem, state.last, affine_first)
    for number, one in enumerate(plan[: SCHEDULE.restarts]):
        if number < restart:
            continue
        try:
            positions = starts.start(problem, state.last, level, *one)
        except (InputError, np.linalg.LinAlgError):  # this start needs more than the modes show
            if state.optima or number + 1 < SCHEDULE.restarts:
                continue
            raise
        return begin_restart(problem, state, positions, number)
    return begin_final(problem, state)


def with_optimum(problem: Problem, state: State, score: float, converged: bool) -> State:
    """Return `state` with where the present restart has ended, and what of it may be tried in other poses."""
    regrouped = state.progress.regrouped
    found = LocalOptimum(state.positions, state.gains, state.offsets, state.model, float(score), converged, regrouped)
    state = replace(state, optima=(*state.optima, found))
    if likeliest(state) is found:
        state = replace(state, progress=replace(state.progress, poses=_poses(problem, state)))
    return state


def likeliest(state: State) -> LocalOptimum:
    """Return the optimum of the least score."""
    return min(state.optima, key=lambda one: one.score)


def _poses(problem: Problem, state: State) -> tuple[np.ndarray, ...]:
    """The array with a group of microphones in other poses, aligned with given positions: each (N, D), metres."""
    if problem.array_dimension != 2 or not np.isfinite(state.optima[-1].score):
        return ()
    model, used = state.model, used_modes(problem, state)
    k = np.real(wavenumbers(problem, state)[used])
    field = FieldModel(k, model.power[used], model.noise[used], model.channel_noise, problem.dimension)
    try:
        found = other_poses(state.positions, corrected(problem, state, used), field)
    except np.linalg.LinAlgError:
        return ()
    placed = [starts.aligned(problem, one) for one in found] if len(problem.known) else found
    return tuple(frozen_array(one, float) for one in placed)


def next_pose(problem: Problem, state: State) -> State:
    """Return the restart from the first of the other poses."""
    first, *others = state.progress.poses
    begun = begin_restart(problem, state, first, state.progress.restart)
    return replace(begun, progress=replace(begun.progress, regrouped=True, poses=tuple(others)))


def optima_agree(problem: Problem, state: State) -> bool:
    """Return whether another restart has ended where the likeliest did; without noise their scores differ by rounding.

    A restart that began from another optimum with a group in another pose does not count: it may return to that
    optimum even if that is wrong.
    """
    best, *others = sorted(state.optima, key=lambda one: one.score)
    wavelength = 2 * np.pi / float(np.real(problem.wavenumbers[state.modes]).max())
    healthy = noise.healthy(best.model)
    for other in others:
        if np.isfinite(other.score) and not other.regrouped:
            away = np.linalg.norm(align(other.positions, best.positions) - best.positions, axis=1)
            if away[healthy].max(initial=0.0) < SCHEDULE.same_place * wavelength:
                return True
    return False


def is_noiseless(problem: Problem, state: State) -> bool:
    """Return whether the measurement is reported to have no noise to speak of, as a simulated one."""
    reported = noise.given_noise(problem, state)
    return reported is not None and float(np.median(reported[state.modes])) <= SCHEDULE.low_noise


def explains_all(problem: Problem, state: State) -> bool:
    """Return whether the array explains all but the reported noise by healthy channels.

    Of a measurement without noise, in a wrong basin no array does so. With noise some do, so that this is evidence
    only where the model has nothing else to bend: channels are matched, and exact given positions hold the size.
    """
    share, worst = state.model.share, float(state.model.channel_noise.max())
    if is_noiseless(problem, state):
        floor = 1.01 * noise.min_share(state)
        return share <= max(SCHEDULE.low_noise, floor) and share * worst <= SCHEDULE.low_noise_channel
    reported = noise.given_noise(problem, state)
    if reported is None or not state.quick or not len(problem.known):
        return False
    return share <= SCHEDULE.reported_noise * float(np.median(reported[state.modes])) and worst < OUTLIERS.suspicious


def begin_final(problem: Problem, state: State) -> State:
    """Go on from the likeliest optimum; only now, with all in place, can the directions of the field be learned."""
    best = likeliest(state)
    progress = replace(state.progress, rounds=0, stage=FINAL, regrouped=False, poses=())
    at_best = replace(state, positions=best.positions, shape=best.positions, gains=best.gains, offsets=best.offsets)
    state = replace(at_best, model=best.model, progress=progress)
    if is_noiseless(problem, state) and explains_all(problem, state):
        near = replace(state, model=replace(state.model, kernel="near", channel_noise=np.ones(len(state.positions))))
        least = frozen_array(np.full(len(state.model.noise), noise.min_share(near)), float)
        return begin_stage(problem, replace(near, model=replace(near.model, noise=least)), NOISELESS)
    state = noise.with_silent_inside(problem, relocated(problem, state, local=True)[0])
    state = given.resolved(problem, state)
    return refined(problem, replace(state, model=replace(state.model, kernel=noise.last_kernel(problem, state))))


def after_noiseless(problem: Problem, state: State) -> State:
    """Return the beginning of the last stage after the positions alone were sought."""
    placed = replace(state, positions=given.anchored(problem, state))
    return refined(problem, given.resolved(problem, placed))


def refined(problem: Problem, state: State) -> State:
    """Return the beginning of a round of the last stage: new noise, and perhaps another kernel.

    The near-field kernel is taken only if the pressures are likelier with it: it explains those of few microphones
    without any noise, but then they have more power than the field would have at most of them.
    """
    near = state.model.kernel == "near"
    fresh = _with_kernel(problem, state, state.model.kernel)
    if not near and fresh.model.share <= ASSUMED.near_share[problem.dimension]:
        other = _with_kernel(problem, state, "near")
        fresh = other if noise.misfit(problem, other) < noise.misfit(problem, fresh) else fresh
    begun = begin_stage(problem, fresh, FINAL)
    updates = ASSUMED.first_updates if begun.model.directions is None else 0
    begun = noise.with_directions(problem, begun, used_modes(problem, begun), updates)
    return begun if begun.progress.rounds else noise.with_conditional(problem, begun)


def _with_kernel(problem: Problem, state: State, kernel: KernelName) -> State:
    chosen = replace(state, model=replace(state.model, kernel=kernel), shape=state.positions)
    deflation = ASSUMED.near_deflation if kernel == "near" else 1.0
    return noise.with_noise(problem, chosen, deflation, rough=False)


def next_final(problem: Problem, state: State) -> State:
    """Return another round of the last stage, with damped waves where the noise is now so low that these count."""
    model, ahead = state.model, replace(state.progress, rounds=state.progress.rounds + 1)
    if model.kernel == "directional" and noise.isotropic_kernel(problem, state) == "series":
        model = replace(model, kernel="damped_directional")
    return refined(problem, given.resolved(problem, replace(state, model=model, progress=ahead)))


def assumes_else(before: State, after: State) -> bool:
    """Return whether a round of the last stage would assume another noise, kernel or given positions."""
    a: Model = before.model
    b: Model = after.model
    limit = SCHEDULE.tolerance_near_noise if b.kernel == "near" else SCHEDULE.tolerance_noise
    change = abs(np.log(float(np.median(b.noise)) / float(np.median(a.noise))))
    return a.kernel != b.kernel or bool(change > limit) or not given.same_given(before, after)


def finished(problem: Problem, state: State) -> State:
    """Return the end of a run: the array in its frame, the directions of the field turned with it."""
    framed = state.positions if problem.frame is None else move_to_frame(state.positions, problem.frame)
    positions = given.anchored(problem, state) if problem.frame is None else frozen_array(framed, float)
    ended = replace(state, positions=positions, finished=True)
    return noise.with_turned_directions(problem, ended, state.positions)
