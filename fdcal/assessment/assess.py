"""The assessment of a run, which says whether its result can be trusted: one record for all solvers.

Faulty channels are named, and the verdict concerns the other channels only.

A given position can check the result only if the pressures and the other given positions together determine the
position of its microphone well. Without its own given position, the covariance of this microphone's position is

    (P^-1 - s I)^-1

P is the covariance with the given position, metres^2, and s the curvature of the prior of this position, 1/m^2.

Given positions that the solver does not get, for example with `known = "none"`, are compared with the result after the
best rigid motion:

    chi^2 = r^T B (B^T (C_AA + sigma^2 I) B)^-1 B^T r

r contains the differences of the coordinates of the given microphones A, metres; C_AA is the covariance of their
estimated coordinates, and sigma the standard deviation of a given coordinate. The columns of B are an orthonormal basis
of the differences that no rigid motion can produce. There are |A| D - D (D + 1) / 2 of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from scipy.special import chdtrc

from ..acoustics.coherence import is_single_wave
from ..acoustics.dictionary import array_f_max
from ..cost.likelihood import log_response
from ..model.gauge import align, rigid_motions
from ..model.problem import Problem
from ..model.validation import frozen_array, word_arguments
from ..solvers.interface import Estimate
from .calibration import DECIBELS_PER_NEPER, OF_LIST, ChannelFault, Channels, Evidence, GivenPosition
from .channels import MAX_NOISE, exchanged_back, faulty_channels
from .field import cross_validate
from .findings import Judged, first_finding
from .uncertainty import EXACT, covariance_of, one_sigma, root_mean_square, scale_sigma_of, search_spread_of

ARGUMENTS: Mapping[str, str] = MappingProxyType({})  # without other names, messages show the names of Python arguments
RIVAL_DISTANCE = 1e-3  # metres; two optima closer than this or than three sigmas count as the same
RIVAL_COST = 8.0  # nats; a rival's score exceeds the lowest one by less than this. Scores have errors of a few nats


@dataclass(frozen=True, eq=False)
class Assessment:
    """The positions at the end of a run and what is known about their quality."""

    # (N, D) float64, metres, for the estimated sound speed if there is one, with exchanges of channels undone
    positions: np.ndarray
    problem: Problem  # with the same sound speed
    # verdict, message: code of the first finding that applies, and its text with the remedy; the text has arguments in
    # angle brackets
    verdict: str
    message: str
    covariance: np.ndarray  # (N, D, D) float64, metres^2, of each position at the minimum
    evidence: Evidence
    channels: Channels  # gain and noise of every channel, and what is wrong with it
    sound_speed_sigma: float | None = None  # one sigma of an uncertain sound speed, m/s
    wording: Mapping[str, str] = field(default_factory=dict)  # names of the arguments in `verdict_text`

    @property
    def uncertainty(self) -> np.ndarray:
        """One sigma of each position, the square root of the trace of its covariance : (N,) float64, metres."""
        return one_sigma(self.covariance)

    @property
    def verdict_text(self) -> str:
        """The message with its arguments named as in `wording`."""
        return word_arguments(self.message, self.wording)


def assess(
    estimate: Estimate,
    names: Sequence[str] | None = None,
    scale: float | None = None,
    unused: Mapping[int, np.ndarray] = MappingProxyType({}),
) -> Assessment:
    """Return the assessment of an estimate.

    names : names of the microphones, by default their numbers; scale : ratio of the sound speed that follows from a
    given distance to that of the problem; unused : maps the number of a microphone to its given position (D,), metres,
    which the solver did not get
    """
    names = [str(n) for n in range(len(estimate.positions))] if names is None else list(names)
    seen = judged(estimate, names, scale, unused)
    code, message = first_finding(seen)
    if code in ("undersampled", "not_converged"):  # with these verdicts given positions cannot be judged
        of_channels = {n: one for n, one in seen.faulty.items() if one.kind not in OF_LIST}
        seen = judged(estimate, names, scale, unused, of_channels)
    problem, size = estimate.problem, scale or 1.0
    speed = problem.sound_speed * size * float(np.exp(estimate.log_speed))
    positions = exchanged_back(estimate, seen.faulty, names)
    centre = positions.mean(axis=0)
    positions = frozen_array(centre + size * (positions - centre), float)
    wavenumbers = frozen_array(problem.wavenumbers * (problem.sound_speed / speed), complex)
    corrected = replace(problem, wavenumbers=wavenumbers, sound_speed=speed)
    channels = np.hstack([estimate.channels.gains, estimate.channels.filters])
    pressures = problem.pressures * np.exp(-log_response(channels, np.real(problem.wavenumbers))[0])
    cross = cross_validate(replace(corrected, pressures=pressures), positions, estimate.modes, healthy=seen.healthy)
    to_given = estimate.field.noise_fraction / seen.given_noise if seen.given_noise else None
    evidence = Evidence(seen.residual_to_noise, cross.overall, cross.microphones, cross.modes, to_given)
    covariance = frozen_array(size**2 * seen.covariance, float)
    return Assessment(
        positions,
        corrected,
        code,
        message,
        covariance,
        evidence,
        _channels(estimate, seen, positions, one_sigma(covariance)),
        sound_speed_sigma=speed * estimate.log_speed_sigma or None,
    )


def judged(
    estimate: Estimate,
    names: Sequence[str],
    scale: float | None = None,
    unused: Mapping[int, np.ndarray] = MappingProxyType({}),
    faulty: Mapping[int, ChannelFault] | None = None,
) -> Judged:
    """Return the evidence for the verdict; see `assess` for the arguments. Without `faulty`, the faults are found."""
    problem, modes, channels, covariance = estimate.problem, estimate.modes, estimate.channels, covariance_of(estimate)
    single = is_single_wave(problem.pressures[modes])
    if faulty is None:
        faulty = {} if single else faulty_channels(estimate, covariance, names)
    healthy = ~np.isin(np.arange(len(names)), list(faulty))
    search, scale_sigma = search_spread_of(estimate, healthy), scale_sigma_of(estimate, healthy)
    wrong = [n for n, one in faulty.items() if one.kind in OF_LIST]
    if len(problem.known):
        agreement, loosest = _given_check(estimate, wrong)
    else:
        unused = {n: place for n, place in unused.items() if healthy[n]}
        agreement, loosest = _unused_agreement(estimate, unused, scale or 1.0), 0.0
    kinds = ("dead", "noisy", "misplaced", "swapped")
    sigma = root_mean_square(one_sigma(covariance)[healthy])
    placed = estimate.positions[healthy] if np.any(healthy) else estimate.positions
    # An exact position has neither a step nor a sigma.
    step_sigma = np.where(estimate.spread.sigma > 0, estimate.spread.sigma, 1.0)
    sought = np.setdiff1d(np.flatnonzero(healthy), problem.known)
    return Judged(
        estimate=estimate,
        names=names,
        covariance=covariance,
        faulty=faulty,
        agreement=agreement,
        loosest=loosest,
        search=search,
        scale_sigma=scale_sigma,
        scale=scale,
        single_wave=single,
        healthy=healthy,
        by_rows=not estimate.window_ratio,
        unexplained=[one for n, one in faulty.items() if one.kind in kinds or channels.noise[n] > MAX_NOISE],
        wrong_given=[faulty[n] for n in wrong if n in problem.known],
        sigma=sigma,
        uncertain=float(np.hypot(sigma, root_mean_square(search[healthy]))),
        radius=root_mean_square(np.linalg.norm(placed - placed.mean(axis=0), axis=1)),
        f_max=array_f_max(placed, problem.sound_speed, problem.dimension),
        highest=float(problem.frequencies[modes][-1]),
        noise_fraction=estimate.field.noise_fraction,
        given_noise=None if problem.noise_power is None else float(np.median(problem.noise_power[modes])),
        step_left=float(np.max(np.abs(estimate.spread.step[healthy]) / step_sigma[healthy], initial=0.0)),
        residual_to_noise=_residual_to_noise(estimate, healthy),
        noisiest=int(sought[np.argmax(channels.noise[sought])]) if len(sought) else -1,
        speed=(float(np.exp(estimate.log_speed)), estimate.log_speed_sigma) if scale is None else (scale, scale_sigma),
        rival=_rival(estimate, sigma, healthy),
    )


def _residual_to_noise(estimate: Estimate, healthy: np.ndarray) -> float:
    """Return the reduced chi-square of the pressures of the `healthy` channels (N,) bool.

    A channel has D + 2 real parameters, its D coordinates, gain and phase. They count as (D + 2) / 2 complex ones.
    """
    v = estimate.field.noise[:, None] * estimate.channels.noise
    parameters = estimate.problem.array_dimension + 2
    freedom = np.sum((v * estimate.field.terms.precision)[:, healthy]) - parameters * np.sum(healthy) / 2
    return float(np.sum((v * np.abs(estimate.field.terms.weighted) ** 2)[:, healthy]) / max(freedom, 1.0))


def _rival(estimate: Estimate, sigma: float, healthy: np.ndarray) -> np.ndarray:
    """Return the distance of each microphone from its place in a rival optimum : (N,), metres; 0 without a rival."""
    tried, same = estimate.tried, max(3 * sigma, RIVAL_DISTANCE)
    for one in tried[1:]:
        away = np.linalg.norm(align(one.positions, tried[0].positions, healthy) - tried[0].positions, axis=1)
        if root_mean_square(away[healthy]) > same and one.score < tried[0].score + RIVAL_COST:
            return away * healthy
    return np.zeros(len(healthy))


def _given_check(estimate: Estimate, wrong: Sequence[int]) -> tuple[float, float]:
    """Return `agreement` and `loosest` of `Judged` for the given positions that are not `wrong`."""
    problem, given = estimate.problem, estimate.given
    kept, D = ~np.isin(problem.known, wrong), problem.array_dimension
    if np.sum(kept) * D - D * (D + 1) // 2 <= 0:
        return 1.0, np.inf if len(problem.known) else 0.0
    loosest, by_model = 0.0, covariance_of(estimate, by_model=True)
    if given.sigma > 0:  # the largest sigma of a microphone as found from all other data; at most 1 m along an axis
        rows = zip(problem.known[kept], given.stiffness[kept], strict=True)
        others = [np.linalg.eigvalsh(np.linalg.inv(by_model[n]) - stiffness * np.eye(D)) for n, stiffness in rows]
        loosest = float(max(np.sqrt(np.sum(1 / np.maximum(values, 1.0))) for values in others))
    # Without given positions only the assumption of an isotropic field determines the size.
    return 1.0 if given.carry_scale else given.probability(kept), loosest


def _unused_agreement(estimate: Estimate, unused: Mapping[int, np.ndarray], scale: float) -> float:
    """Return the probability that chi^2, as defined above, is by chance at least that of the `unused` positions."""
    numbers, D = np.array([*unused], int), estimate.problem.array_dimension
    freedom = len(numbers) * D - D * (D + 1) // 2
    if freedom <= 0 or estimate.given.carry_scale:  # then the pressures hardly determine the size
        return 1.0
    there = scale * estimate.positions[numbers]
    placed = align(np.array([*unused.values()]), there)
    basis = np.linalg.svd(rigid_motions(placed))[0][:, -freedom:]
    index = (D * numbers[:, None] + np.arange(D)).ravel()
    covariance = scale**2 * estimate.spread.covariance[np.ix_(index, index)]
    covariance = covariance + max(estimate.given.expected_sigma, EXACT) ** 2 * np.eye(len(index))
    difference = basis.T @ (there - placed).ravel()
    return float(chdtrc(freedom, difference @ np.linalg.solve(basis.T @ covariance @ basis, difference)))


def _channels(estimate: Estimate, seen: Judged, positions, sigma) -> Channels:
    """Return gain, noise and fault of every channel, and the given positions with the positions found."""
    found, names, problem = estimate.channels, seen.names, estimate.problem
    wrong = {n for n, one in seen.faulty.items() if one.kind in OF_LIST}
    numbers: list[int] = problem.known.tolist()
    contradicted = estimate.given.contradicted if estimate.given.sigma == 0 else None
    given = []
    for i, (n, place) in enumerate(zip(numbers, problem.known_positions.tolist(), strict=True)):
        there, own = positions[n], sigma[n]
        if contradicted is not None and n in wrong:
            there, own = contradicted.positions[n], contradicted.sigma[i]
        given.append(GivenPosition(names[n], tuple(place), tuple(there.tolist()), float(own), n in wrong))
    return Channels(
        DECIBELS_PER_NEPER * found.gains[:, 0],
        DECIBELS_PER_NEPER * found.gain_sigma[:, 0],
        np.degrees(np.angle(np.exp(1j * found.gains[:, 1]))),
        np.degrees(found.gain_sigma[:, 1]),
        10 * np.log10(found.noise / np.median(found.noise)),
        tuple(seen.faulty.values()),
        tuple(given),
    )
