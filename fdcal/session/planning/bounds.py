"""Sound fields of a plan, the information that their frequencies hold, and the error that follows from it.

The fields are of sources in a rectangular room, or drawn from a diffuse field. The bound takes all frequencies as
independent. They are not: the pressures of a room that decays evenly are alike over a distance of x Hz as

    |r|^2 = 1 / (1 + (pi x / s)^2),    s = 6.9 / T60 nepers per second

The solver takes them as independent, too. The covariance of its gradient is then F + sum |r|^2 F' over all pairs of
frequencies, where F' is the part of the information F that is not of noise; that of the positions is larger by as much.
`forecast` takes F' = F / 2, and adds what arrival times say of impulses.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ...acoustics.box_field import point_source_pressures
from ...acoustics.room_modes import PointSourceModel, decay_rate, point_source_model, room_pressures
from ...assessment.uncertainty import Bound, Information, diffuse_information, position_bound
from ...cost.kernels import diffuse_kernel
from ...model.arrays import WALL_DISTANCE_M, encloses, random_source
from ...model.problem import mode_power
from ...model.room import Room
from ...model.validation import InputError
from ...solvers.robust.arrivals import Arrivals, Source
from .request import ASSUMED, PLAN_LIMITS, PlanRequest


def wavenumbers_of(request: PlanRequest, frequencies) -> np.ndarray:
    """Return k of `frequencies` (M,), Hz, with the decay of the room : (M,) complex128, rad/m."""
    s = decay_rate(request.reverberation_time) if request.room is not None else 0.0
    return (2 * np.pi * np.asarray(frequencies) - 1j * s) / request.sound_speed


def places_in_room(request: PlanRequest) -> np.ndarray:
    """Return the microphones in the room : (N, 2 or 3) float64, metres.

    Their own coordinates where these lie inside; otherwise the array is moved off the room's middle.
    """
    size, x = np.array(request.room), request.stated_places
    if _inside(x, size):
        return x
    edge = np.ptp(x, axis=0) / 2 + WALL_DISTANCE_M
    centre = np.clip(np.array(PLAN_LIMITS.place[: len(size)]) * size, edge, size - edge)
    return x - (x.min(axis=0) + x.max(axis=0)) / 2 + centre


def is_moved(request: PlanRequest) -> bool:
    """Return whether the array's own coordinates do not lie inside the room, so that it is moved there."""
    return request.room is not None and not _inside(request.stated_places, np.array(request.room))


def _inside(places: np.ndarray, size: np.ndarray) -> bool:
    return bool(np.all((places > WALL_DISTANCE_M) & (places < size - WALL_DISTANCE_M)))


def source_place(request: PlanRequest, places: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a random source in the room, away from the microphones : (2 or 3,) float64, metres; or InputError."""
    source = random_source(
        request.room, places, PLAN_LIMITS.clearance, rng, lambda place: not encloses(places[:, :2], place[:2])
    )
    if source is not None:
        return source
    problem = f"no place of the room is {PLAN_LIMITS.clearance:g} m from the array"
    raise InputError(problem, "give a larger <room>", key="room")


def room_field(request: PlanRequest, frequencies, rng: np.random.Generator) -> np.ndarray:
    """Return the pressures of a random source in the room, of unit power in every mode : (M, N) complex128."""
    places, k = places_in_room(request), wavenumbers_of(request, frequencies)
    source = source_place(request, places, rng)
    if request.dimension == 3:
        p = point_source_pressures(Room(size=request.room), source, places, k)
    else:
        model = _rectangle(request.room, tuple(k.tolist()))
        p = room_pressures(model.excitation(source), model.shapes(places))
    return p / np.sqrt(mode_power(p))[:, None]


@lru_cache(maxsize=2)
def _rectangle(size: tuple[float, ...], wavenumbers: tuple[complex, ...]) -> PointSourceModel:
    """Return the model of a rigid rectangle, which all sources of a plan share."""
    return point_source_model(size, np.array(wavenumbers), 0.0)


def diffuse_field(request: PlanRequest, frequencies, rng: np.random.Generator) -> np.ndarray:
    """Return pressures drawn from a diffuse field, of unit power in every mode : (M, N) complex128."""
    x, k = request.layout.positions, np.real(wavenumbers_of(request, frequencies))
    N = len(x)
    distance = np.linalg.norm(x[:, None] - x[None], axis=-1)
    kappa = diffuse_kernel(distance.ravel(), k, request.dimension, False)[0].reshape(-1, N, N)
    values, vectors = np.linalg.eigh(kappa)
    z = rng.normal(scale=np.sqrt(0.5), size=(2, len(k), N))
    p = np.einsum("mij,mj->mi", vectors, np.sqrt(np.maximum(values, 0.0)) * (z[0] + 1j * z[1]))
    return p / np.sqrt(mode_power(p))[:, None]


def field_of(request: PlanRequest, frequencies, rng: np.random.Generator) -> np.ndarray:
    """Return the pressures of one random source: in the room, or in a diffuse field without one."""
    return (diffuse_field if request.room is None else room_field)(request, frequencies, rng)


def request_information(request: PlanRequest) -> Information:
    """Return the information of all frequencies and takes of a request on its array, in a diffuse field.

    The fields of two takes are independent draws, so that each adds as much as the first.
    """
    return sparse_information(request, request.layout.positions, most=PLAN_LIMITS.max_frequencies)


def sparse_information(
    request: PlanRequest, positions, noise: float | None = None, most: int = PLAN_LIMITS.search_frequencies
) -> Information:
    """Return the information of `most` frequencies, scaled to all of them, of an array (N, D), metres.

    `noise`: its power in that of the pressures; that of the request unless given.
    """
    used, noise = request.spaced(most), request.noise_fraction if noise is None else noise
    found = diffuse_information(positions, 2 * np.pi * used / request.sound_speed, noise, request.dimension)
    return found.scaled(request.takes * len(request.frequencies) / len(used))


def information_at(request: PlanRequest, snr_db: float) -> Information:
    """Return the information of a request at another signal-to-noise ratio, dB, by `sparse_information`."""
    noise = 10 ** (-snr_db / 10)
    return sparse_information(request, request.layout.positions, noise / (1 + noise))


TAKES = (1, 2, 4, 8)  # numbers of takes that a plan compares, and its own


@dataclass(frozen=True)
class TakesCase:
    """The error expected with several places of the source, or with a longer recording from one, RMS, metres.

    Arrival times are left out. The bound is no measure here: takes share the rows of an import, and it counts rows as
    independent. Fewer rows per take are farther apart and less alike, which only the expected error takes into account.
    """

    takes: int  # places of the source
    rms: float  # each recorded for as long as one
    shared: float  # all of them together recorded for as long as one, each at a lower signal-to-noise ratio
    longer: float  # one place, recorded `takes` times as long, at a higher signal-to-noise ratio


def takes_cases(request: PlanRequest, information: Information, bound: Bound) -> tuple[TakesCase, ...]:
    """Return what more places of the source bring, and what a longer recording from one place brings instead.

    A recording that is n times as long has a signal-to-noise ratio higher by 10 log10 n dB, the noise being steady. The
    cases take fewer frequencies, which is faster, and are scaled so that the one of the request itself has the expected
    error that follows from the `information` of all frequencies and its `bound`.
    """

    def expected(takes: int, more_db: float = 0.0) -> float:
        other = replace(request, takes=takes)
        information = information_at(other, request.snr_db + more_db)
        return forecast(other, information, position_bound(information, request.prior), ()).rms

    scale = forecast(request, information, bound, ()).rms / expected(request.takes)
    return tuple(
        TakesCase(
            takes,
            scale * expected(takes),
            scale * expected(takes, -10 * np.log10(takes)),
            scale * expected(1, 10 * np.log10(takes)),
        )
        for takes in sorted({*TAKES, request.takes})
    )


@dataclass(frozen=True)
class ForecastRules:
    """What is added to the bound; figures are of 40 draws with noise and 30 of impulses of `fdcal_bench`."""

    # F' / F of the module's head: of 8 to 48 microphones at 30 dB the exact sum is that of 0.3 to 0.8
    field_part: float = 0.5
    # error over that of field and arrival times together, by Fisher information: 1.5 to 2.2. The solver gives rows that
    # are not independent too much weight beside arrival times
    arrival_margin: float = 1.7
    # of the logarithm of the error, one sigma: how far one room and source differ from the diffuse field, beside the
    # scatter of errors that the covariance itself has
    field_scatter: float = 0.2
    quantile: float = 1.28  # standard deviations to both sides, within which 8 of 10 draws are
    # of a plane array in a room, error over the bound: low, middle, high. Its size follows from equally strong waves
    # from all directions, which the bound assumes and no room has
    plane: tuple[float, float, float] = (2.0, 2.8, 4.0)
    source_sets: int = 8  # places of the source, over which arrival times are averaged
    batch: int = 4  # takes whose arrival times are computed at once, which bounds the memory


FORECAST = ForecastRules()


@dataclass(frozen=True)
class Forecast:
    """The error that a calibration will have, root mean square over the microphones that are sought, metres."""

    rms: float  # expected
    low: float  # 8 of 10 recordings err between `low` and `high`
    high: float
    # factor by which advice multiplies the bound: `rms` over it, or `high` over it for a plane array in a room
    margin: float
    timed: bool = False  # whether arrival times lower it


def forecast(
    request: PlanRequest, information: Information, bound: Bound, arrivals: tuple[np.ndarray, ...] | None = None
) -> Forecast:
    """Return the error to be expected, from the information of all frequencies and the bound that follows from it.

    `arrivals`: `arrival_matrices` of the request, which do not depend on noise; computed unless given.
    """
    if request.is_plane_in_room:
        low, middle, high = FORECAST.plane
        return Forecast(middle * bound.rms, low * bound.rms, high * bound.rms, high)
    f, s = request.frequencies, decay_rate(request.reverberation_time)
    alike = np.sum(1 / (1 + (np.pi * (f[:, None] - f) / s) ** 2), axis=1) - 1
    field = information.scaled(float(np.mean(1 / (1 + FORECAST.field_part * alike))))
    plain = _scattering([position_bound(field, request.prior)], 1.0, bound)
    arrivals = arrival_matrices(request) if arrivals is None else arrivals
    if not arrivals:
        return plain
    cases = [position_bound(replace(field, matrix=field.matrix + matrix), request.prior) for matrix in arrivals]
    # arrival times never make it worse: where they add little, their factor alone would
    timed = replace(_scattering(cases, FORECAST.arrival_margin, bound), timed=True)
    return min(plain, timed, key=lambda one: one.rms)


def _scattering(found: list[Bound], factor: float, bound: Bound) -> Forecast:
    """Return the forecast of an error `factor` times that of `found`, and how far single recordings scatter."""
    rms = factor * float(np.sqrt(np.mean([one.rms**2 for one in found])))
    scatter = np.mean([1 / (2 * one.freedom) for one in found]) + FORECAST.field_scatter**2
    low, high = (rms * float(np.exp(sign * FORECAST.quantile * np.sqrt(scatter) - scatter)) for sign in (-1, 1))
    return Forecast(rms, low, high, rms / bound.rms)


def arrival_matrices(request: PlanRequest) -> tuple[np.ndarray, ...]:
    """Return what arrival times add to the matrix of `Information`, for some sets of sources; empty without impulses.

    Nor does the forecast of a plane array in a room reckon with them.
    """
    if request.kind != "impulse" or request.is_plane_in_room:
        return ()
    return tuple(_arrival_matrix(request, seed) for seed in range(FORECAST.source_sets))


def _arrival_matrix(request: PlanRequest, seed: int) -> np.ndarray:
    """Return what arrival times from a random place of the source for each take add to the matrix of `Information`."""
    places, rng = places_in_room(request), np.random.default_rng([request.seed, 11, seed])
    sources = np.array([source_place(request, places, rng) for _ in range(request.takes)])
    x, size = request.layout.positions, request.layout.positions.size + len(request.layout.names) + 1
    matrix, on = np.zeros((size, size)), np.append(np.arange(x.size), size - 1)  # coordinates, log of the sound speed
    for some in np.array_split(sources, -(-len(sources) // FORECAST.batch)):
        away, T = some - places.mean(axis=0), len(some)
        distance, sigma = np.linalg.norm(away, axis=1), np.full(T, ASSUMED.arrival_sigma_m)
        paths = np.linalg.norm(some[:, None] - places, axis=2)
        paths -= np.median(paths, axis=1, keepdims=True)
        start = Source(away / distance[:, None], 1 / distance, np.zeros(T))
        terms = Arrivals(paths, np.ones(paths.shape, bool), sigma, sigma, request.dimension, start).terms(x)
        matrix[np.ix_(on, on)] += terms.matrix
    return matrix
