"""Sound fields of a plan, and the information that their frequencies hold: all of them, or a few that stand for all.

The fields are of sources in a rectangular room, or drawn from a diffuse field.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ...acoustics.box_field import point_source_pressures
from ...acoustics.room_modes import PointSourceModel, decay_rate, point_source_model, room_pressures
from ...assessment.uncertainty import Information, diffuse_information, position_bound
from ...cost.kernels import diffuse_kernel
from ...model.arrays import WALL_DISTANCE_M, encloses, random_source
from ...model.problem import mode_power
from ...model.room import Room
from ...model.validation import InputError
from .request import LIMITS, PlanRequest


def wavenumbers_of(request: PlanRequest, frequencies) -> np.ndarray:
    """Return k of `frequencies` (M,), Hz, with the decay of the room : (M,) complex128, rad/m."""
    s = decay_rate(request.reverberation_time) if request.room is not None else 0.0
    return (2 * np.pi * np.asarray(frequencies) - 1j * s) / request.sound_speed


def places_in_room(request: PlanRequest) -> np.ndarray:
    """Return the microphones in the room : (N, 2 or 3) float64, metres.

    Their own coordinates where these lie inside; otherwise the array is moved off the room's middle.
    """
    size, x = np.array(request.room), request.layout.positions
    if len(size) == 3:
        x = request.layout.in_space(LIMITS.place[2] * size[2])
    if _inside(x, size):
        return x
    extent = np.ptp(x, axis=0)
    if np.any(extent > size - 2 * WALL_DISTANCE_M):
        raise InputError("the array does not fit into the room", "give a larger <room>", key="room", value=request.room)
    edge = extent / 2 + WALL_DISTANCE_M
    centre = np.clip(np.array(LIMITS.place[: len(size)]) * size, edge, size - edge)
    return x - (x.min(axis=0) + x.max(axis=0)) / 2 + centre


def is_moved(request: PlanRequest) -> bool:
    """Return whether the array's own coordinates do not lie inside the room, so that it is moved there."""
    if request.room is None:
        return False
    size, x = np.array(request.room), request.layout.positions
    x = request.layout.in_space(LIMITS.place[2] * size[2]) if len(size) == 3 else x
    return not _inside(x, size)


def _inside(places: np.ndarray, size: np.ndarray) -> bool:
    return bool(np.all((places > WALL_DISTANCE_M) & (places < size - WALL_DISTANCE_M)))


def source_place(request: PlanRequest, places: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a random source in the room, away from the microphones : (2 or 3,) float64, metres; or InputError."""
    source = random_source(
        request.room, places, LIMITS.clearance, rng, lambda place: not encloses(places[:, :2], place[:2])
    )
    if source is not None:
        return source
    problem = f"no place of the room is {LIMITS.clearance:g} m from the array"
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
    return sparse_information(request, request.layout.positions, most=LIMITS.max_frequencies)


def sparse_information(
    request: PlanRequest, positions, noise: float | None = None, most: int = LIMITS.search_frequencies
) -> Information:
    """Return the information of `most` frequencies, scaled to all of them, of an array (N, D), metres.

    `noise`: its power in that of the pressures; that of the request unless given.
    """
    used, noise = request.spaced(most), request.noise_fraction if noise is None else noise
    found = diffuse_information(positions, 2 * np.pi * used / request.sound_speed, noise, request.dimension)
    return found.scaled(request.takes * len(request.frequencies) / len(used))


def rms_at(request: PlanRequest, snr_db: float) -> float:
    """Return the bound at another signal-to-noise ratio, dB: root mean square, metres."""
    noise = 10 ** (-snr_db / 10)
    found = sparse_information(request, request.layout.positions, noise / (1 + noise))
    return position_bound(found, request.prior).rms


TAKES = (1, 2, 4, 8)  # numbers of takes that a plan compares, and its own


@dataclass(frozen=True)
class TakesCase:
    """The bound with several places of the source, or with a longer recording from one: root mean square, metres."""

    takes: int  # places of the source
    rms: float  # each recorded for as long as one
    shared: float  # all of them together recorded for as long as one, each at a lower signal-to-noise ratio
    longer: float  # one place, recorded `takes` times as long, at a higher signal-to-noise ratio


def takes_cases(request: PlanRequest) -> tuple[TakesCase, ...]:
    """Return what more places of the source bring, and what a longer recording from one place brings instead.

    A recording that is n times as long has a signal-to-noise ratio higher by 10 log10 n dB, the noise being steady.
    """
    return tuple(
        TakesCase(
            takes,
            rms_at(replace(request, takes=takes), request.snr_db),
            rms_at(replace(request, takes=takes), request.snr_db - 10 * np.log10(takes)),
            rms_at(replace(request, takes=1), request.snr_db + 10 * np.log10(takes)),
        )
        for takes in sorted({*TAKES, request.takes})
    )
