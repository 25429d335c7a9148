"""Attempts from several starts, and the refinement of the likeliest of their ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...cost.channel_likelihood import ChannelField
from ...model.gauge import align, fixes_gauge, move_to_frame
from ...model.problem import Problem
from ...model.validation import InputError, frozen_array
from . import assumptions, given_positions, hyperparameters, kernels, starts
from .conditional import with_conditional
from .groups import other_poses
from .relocation import relocated
from .settings import ASSUMED, FINAL, NOISELESS, OUTLIERS, RULES, SCHEDULE
from .state import End, KernelName, Model, Progress, State

DEFORMATION_DAMPING, DAMPING = 1e-3, 1e-6  # of the first step of a row


def begin_attempt(problem: Problem, state: State, positions: np.ndarray, attempt: int) -> State:
    """Return `state` at the beginning of attempt number `attempt`, at `positions` (N, D), metres."""
    zero = frozen_array(np.zeros((len(positions), 2)), float)
    begun = replace(
        state,
        positions=frozen_array(positions, float),
        shape=frozen_array(positions, float),
        gains=zero,
        offsets=zero,
        model=assumptions.first_model(problem, state.settings),
        progress=Progress(attempt=attempt, row=0, rounds=0, steps=0, damping=0.0),
    )
    return begin_row(problem, hyperparameters.with_noise(problem, begun), 0)


def begin_row(problem: Problem, state: State, row: int) -> State:
    """Return `state` at the beginning of a row of the schedule."""
    damping = DEFORMATION_DAMPING if SCHEDULE[row].degree else DAMPING
    progress = replace(state.progress, row=row, steps=0, damping=damping)
    return replace(state, stage=state.stage + 1, progress=progress, shape=state.positions)


def end_attempt(problem: Problem, state: State, score: float, settled: bool) -> State:
    """Return the beginning of another attempt, or of the last row from the likeliest end."""
    regrouped = state.progress.regrouped
    end = End(state.positions, state.gains, state.offsets, state.model, float(score), settled, regrouped)
    state = replace(state, ends=(*state.ends, end))
    if _agreed(problem, state) or is_low_noise_end(problem, state):
        return _begin_final(problem, state)
    best = min(state.ends, key=lambda one: one.score)
    poses = _other_poses(problem, state) if best is end else state.progress.poses
    tried = sum(one.regrouped for one in state.ends)
    if best.regrouped and (not poses or tried >= RULES.attempts):
        return _begin_final(problem, state)
    if poses and tried < RULES.attempts:
        begun = begin_attempt(problem, state, poses[0], state.progress.attempt)
        return replace(begun, progress=replace(begun.progress, regrouped=True, poses=poses[1:]))
    return next_attempt(problem, state, state.progress.attempt + 1)


def _other_poses(problem: Problem, state: State) -> tuple[np.ndarray, ...]:
    """The last end with a group of microphones in other poses, aligned with given positions: each (N, D), metres."""
    if problem.array_dimension != 2 or not np.isfinite(state.ends[-1].score):
        return ()
    model, used = state.model, assumptions.used_modes(problem, state, 0)
    k = np.real(assumptions.wavenumbers(problem, state)[used])
    field = ChannelField(k, model.power[used], model.noise[used], model.channel_noise, problem.dimension)
    try:
        found = other_poses(state.positions, assumptions.corrected(problem, state, used), field)
    except np.linalg.LinAlgError:
        return ()
    placed = found if not len(problem.known) else [starts.aligned(problem, one) for one in found]
    return tuple(frozen_array(one, float) for one in placed)


def next_attempt(problem: Problem, state: State, attempt: int) -> State:
    """Return the beginning of the first attempt, from number `attempt` on, whose start there is; else of the last row.

    Raises
    ------
    InputError
        If there is no start at all.
    """
    given = hyperparameters.given_noise(problem, state)
    noise = None if given is None else float(np.median(given[state.modes]))
    plan = starts.plan(problem, state.last, hyperparameters.is_noiseless(problem, state))
    for number, one in enumerate(plan[: RULES.attempts]):
        if number < attempt:
            continue
        try:
            positions = starts.start(problem, state.last, noise, *one)
        except (InputError, np.linalg.LinAlgError):  # this start needs more than the modes show
            if state.ends or number + 1 < RULES.attempts:
                continue
            raise
        return begin_attempt(problem, state, positions, number)
    return _begin_final(problem, state)


def _agreed(problem: Problem, state: State) -> bool:
    """Whether another attempt has ended where the likeliest did; without noise their scores differ by rounding.

    An attempt that began from another end with a group in another pose does not count: it may return to that end even
    if that end is wrong.
    """
    best, *others = sorted(state.ends, key=lambda end: end.score)
    independent = (end for end in others if np.isfinite(end.score) and not end.regrouped)
    return any(_near(problem, state, end.positions, best) for end in independent)


def is_low_noise_end(problem: Problem, state: State) -> bool:
    """Whether, without noise, the array explains all pressures by sound channels: in a wrong basin none does so."""
    if not hyperparameters.is_noiseless(problem, state):
        return False
    share, worst = state.model.share, float(state.model.channel_noise.max())
    least = 1.01 * hyperparameters.least_share(state)
    return share <= max(RULES.low_noise, least) and share * worst <= RULES.low_noise_channel


def _near(problem: Problem, state: State, positions, end: End) -> bool:
    """Whether every healthy microphone is, after alignment, within a part of the shortest wavelength of `end`."""
    wavelength = 2 * np.pi / float(np.real(problem.wavenumbers[state.modes]).max())
    away = np.linalg.norm(align(positions, end.positions) - end.positions, axis=1)
    healthy = end.model.channel_noise < OUTLIERS.suspicious
    return bool(away[healthy].max(initial=0.0) < RULES.same_place * wavelength)


def _begin_final(problem: Problem, state: State) -> State:
    """Go on from the likeliest end; only now, with all in place, can the directions of the field be learned."""
    best = min(state.ends, key=lambda end: end.score)
    state = replace(
        state,
        positions=_gathered(best),
        gains=best.gains,
        offsets=best.offsets,
        model=best.model,
        shape=_gathered(best),
        progress=replace(state.progress, rounds=0, row=FINAL, regrouped=False, poses=()),
    )
    if is_low_noise_end(problem, state):
        return _begin_noiseless(problem, state)
    state = given_positions.resolved(problem, relocated(problem, state, local=True)[0])
    return refined(problem, replace(state, model=replace(state.model, kernel=kernels.last_kernel(problem, state))))


def _begin_noiseless(problem: Problem, state: State) -> State:
    """Begin with the near-field kernel and as little noise as it can show, alike in all channels."""
    state = replace(state, model=replace(state.model, kernel="near", channel_noise=np.ones(len(state.positions))))
    noise = frozen_array(np.full(len(state.model.noise), hyperparameters.least_share(state)), float)
    return begin_row(problem, replace(state, model=replace(state.model, noise=noise)), NOISELESS)


def end_noiseless(problem: Problem, state: State) -> State:
    """Return the beginning of the last row after the positions alone were sought."""
    placed = replace(state, positions=anchored(problem, state))
    return refined(problem, given_positions.resolved(problem, placed))


def _gathered(end: End) -> np.ndarray:
    """Positions with outliers no farther from the centre than the others: beyond, the near-field kernel diverges."""
    x, healthy = end.positions, end.model.channel_noise < OUTLIERS.suspicious
    if np.all(healthy) or not np.any(healthy):
        return x
    centre = x[healthy].mean(axis=0)
    away = np.linalg.norm(x - centre, axis=1)
    far = ~healthy & (away > away[healthy].max())
    inward = np.where(far, away[healthy].max() / np.maximum(away, 1e-9), 1.0)
    return frozen_array(centre + inward[:, None] * (x - centre), float)


def refined(problem: Problem, state: State) -> State:
    """Return the beginning of a round of the last row: new noise, and perhaps another kernel.

    The near-field kernel is taken only if the pressures are likelier with it: it explains those of few microphones
    without any noise, but then they have more power than the field would have at most of them.
    """
    near = state.model.kernel == "near"
    fresh = _with_kernel(problem, state, state.model.kernel, RULES.near_deflation if near else 1.0)
    if not near and kernels.near_field_counts(problem, fresh):
        other = _with_kernel(problem, state, "near", RULES.near_deflation)
        likelier = hyperparameters.misfit(problem, other) < hyperparameters.misfit(problem, fresh)
        fresh = other if likelier else fresh
    begun = begin_row(problem, fresh, FINAL)
    first = ASSUMED.first_updates if begun.model.directions is None else 0
    begun = kernels.with_directions(problem, begun, assumptions.used_modes(problem, begun, 0), first)
    return begun if begun.progress.rounds else with_conditional(problem, begun)


def _with_kernel(problem: Problem, state: State, kernel: KernelName, deflation: float) -> State:
    chosen = replace(state, model=replace(state.model, kernel=kernel), shape=state.positions)
    return hyperparameters.with_noise(problem, chosen, deflation, rough=False)


def end_final(problem: Problem, state: State, settled: bool) -> State:
    """Return another round of the last row if the noise or the kernel has changed; otherwise the end."""
    ahead = replace(state, progress=replace(state.progress, rounds=state.progress.rounds + 1))
    again = refined(problem, given_positions.resolved(problem, kernels.with_damping(problem, ahead)))
    changed = _changed(state.model, again.model) or not given_positions.same_given(state, again)
    if changed and again.progress.rounds < RULES.final_rounds:
        return again
    framed = state.positions if problem.frame is None else move_to_frame(state.positions, problem.frame)
    positions = anchored(problem, state) if problem.frame is None else frozen_array(framed, float)
    ended = replace(state, positions=positions, finished=True, converged=settled)
    return kernels.with_turned_directions(problem, ended, state.positions)


def _changed(before: Model, after: Model) -> bool:
    """Whether the last row has to be gone through again."""
    limit = RULES.settled_near_noise if after.kernel == "near" else RULES.settled_noise
    change = np.log(float(np.median(after.noise)) / float(np.median(before.noise)))
    return before.kernel != after.kernel or bool(abs(change) > limit)


def anchored(problem: Problem, state: State) -> np.ndarray:
    """Return the array moved as a whole onto the given positions, if any, without outliers among them; exact ones stay.

    The pressures do not fix the array as a whole, and the last steps hardly see the weak pull of the given positions
    where there is hardly any noise.
    """
    x, (known, given) = state.positions, assumptions.held(problem, state)
    if state.settings.known_sigma == 0:
        exact = np.array(x)
        exact[known] = given
        return frozen_array(exact, float)
    away = np.linalg.norm(x[known] - given, axis=1)
    near = away <= RULES.known_outlier * max(float(np.median(away)) if len(away) else 0.0, state.model.known_sigma)
    if not len(known) or np.sum(near) <= x.shape[1] or not fixes_gauge(given[near]):
        return x
    moved = starts.onto(x, known[near], given[near])
    before, after = (np.sum((y[known[near]] - given[near]) ** 2) for y in (x, moved))
    return frozen_array(moved, float) if after < before else x
