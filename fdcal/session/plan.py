"""A plan: how exact an array will be calibrated, before anything is recorded, as numbers, in words and as JSON.

The bound takes all frequencies as independent. They are not: the pressures of a room that decays evenly are alike over
a distance of x Hz as

    |r|^2 = 1 / (1 + (pi x / s)^2),    s = 6.9 / T60 nepers per second

The solver takes them as independent, too. The covariance of its gradient is then F + sum |r|^2 F' over all pairs of
frequencies, where F' is the part of the information F that is not of noise; that of the positions is larger by as much.
The forecast takes F' = F / 2, and adds what arrival times say of impulses:

    r_n = c tau_n - |x_n - s| - b      path to microphone n; source s and time of emission b are unknown

Less noise never makes the forecast worse: each signal-to-noise ratio is judged by the same frequencies and the same
places of the source, and the information of a Gaussian field falls with its noise. Lengths are metres in JSON,
millimetres in words.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..acoustics.room_modes import decay_rate
from ..assessment.uncertainty import Bound, Information, diffuse_information, position_bound
from ..model.arrays import WALL_DISTANCE_M, encloses, random_source
from ..model.gauge import fixes_gauge
from ..model.validation import InputError, length_text
from .plan_request import PLAN_LIMITS, PlanRequest, evenly
from .process import one_blas_thread


@dataclass(frozen=True)
class ForecastRules:
    """What is added to the bound; figures are of 40 draws with noise and 30 of impulses of `fdcal_bench`."""

    # F' / F of the module's head: of 8 to 48 microphones at 30 dB the exact sum is that of 0.3 to 0.8
    field_part: float = 0.5
    # metres, one sigma of an arrival time: 0.1 to 0.8 mm in simulated rooms, 0.9 mm of the measured array
    arrival_sigma_m: float = 5e-4
    freedom: float = 3.0  # of the Student t distribution that the solver takes for arrival times
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
    source_sets: int = 8  # sets of places of the source, over which arrival times are averaged
    takes: tuple[int, ...] = (1, 2, 4, 8)  # numbers of takes that a plan compares, and its own
    more_db: tuple[float, ...] = (0.0, 3.0, 6.0, 10.0)  # ratios above its own that it compares
    # dB, greatest ratio that is compared. Channels that are equal to 0.1 dB and 0.5 degrees err by as much as noise 38
    # dB below the signal, so that less noise is of no use
    max_snr_db: float = 40.0
    # relative one sigma of the size, or of a stretch, from which a plan mentions it: over an array of 1 m it is the
    # accuracy that is wanted by default, 10 mm
    blurred: float = 0.01
    # microphones at most of which a blind calibration from one place is often not good: figures of `python -m
    # benchmarks blind`, 16 microphones in a living room and a studio
    few_blind: int = 16


FORECAST = ForecastRules()


@dataclass(frozen=True)
class Forecast:
    """The error that a calibration will have, root mean square over the microphones that are sought, metres."""

    rms: float  # expected
    low: float  # 8 of 10 recordings err between `low` and `high`
    high: float
    timed: bool = False  # whether arrival times lower it


@dataclass(frozen=True)
class Plan:
    """What is to be expected of an array."""

    request: PlanRequest
    bound: Bound  # in a diffuse field
    forecast: Forecast
    # snr_db: (S,) ascending, takes: (T,) ascending, expected: (T, S) float64, metres, the forecast of other numbers of
    # places of the source and other signal-to-noise ratios. The first ratio is that of the request
    snr_db: tuple[float, ...]
    takes: tuple[int, ...]
    expected: np.ndarray
    degeneracies: tuple[str, ...]  # what the pressures determine badly, in words


def make_plan(request: PlanRequest) -> Plan:
    """Return the bound of a request, the error to be expected, and what more takes or a better signal bring."""
    rules, x, takes = FORECAST, request.layout.positions, tuple(sorted({*FORECAST.takes, request.takes}))
    best = max(rules.max_snr_db, request.snr_db)
    ratios = tuple(sorted({min(request.snr_db + more, best) for more in rules.more_db}))
    with one_blas_thread():
        arrivals = _arrival_information(request, takes)
        others = [replace(request, takes=count) for count in takes]
        used = evenly(request.band_frequencies, max(PLAN_LIMITS.min_frequencies, PLAN_LIMITS.work // len(x)))
        k, noise = 2 * np.pi * used / request.sound_speed, [10 ** (-snr_db / 10) for snr_db in ratios]
        of_frequency = [  # in a diffuse field, the mean over the band
            diffuse_information(x, k, one / (1 + one), request.dimension).scaled(1 / len(used)) for one in noise
        ]
        table = [[_forecast(other, one, arrivals[other.takes]) for one in of_frequency] for other in others]
        bound = position_bound(of_frequency[0].scaled(request.rows), request.prior)
    expected = np.array([[cell.rms for cell in row] for row in table])
    forecast = table[takes.index(request.takes)][0]
    return Plan(request, bound, forecast, ratios, takes, expected, _degeneracies(request, bound))


def _forecast(request: PlanRequest, of_frequency: Information, arrivals: Sequence[np.ndarray]) -> Forecast:
    """Return the error to be expected; `arrivals`: of `_arrival_information`, for some sets of sources."""
    information = of_frequency.scaled(request.rows)
    if request.is_plane_in_room:
        bound = position_bound(information, request.prior)
        low, middle, high = (factor * bound.rms for factor in FORECAST.plane)
        return Forecast(middle, low, high)
    f, s = request.frequencies, decay_rate(request.reverberation_time)
    alike = np.sum(1 / (1 + (np.pi * (f[:, None] - f) / s) ** 2), axis=1) - 1
    field = information.scaled(float(np.mean(1 / (1 + FORECAST.field_part * alike))))

    def scattering(found: list[Bound], factor: float, timed: bool) -> Forecast:
        rms = factor * float(np.sqrt(np.mean([one.rms**2 for one in found])))
        scatter = np.mean([1 / (2 * one.freedom) for one in found]) + FORECAST.field_scatter**2
        low, high = (rms * float(np.exp(sign * FORECAST.quantile * np.sqrt(scatter) - scatter)) for sign in (-1, 1))
        return Forecast(rms, low, high, timed)

    plain = scattering([position_bound(field, request.prior)], 1.0, False)
    if not arrivals:
        return plain
    cases = [position_bound(replace(field, matrix=field.matrix + matrix), request.prior) for matrix in arrivals]
    # arrival times never make it worse: where they add little, their factor alone would
    return min(plain, scattering(cases, FORECAST.arrival_margin, True), key=lambda one: one.rms)


def _arrival_information(request: PlanRequest, takes: Sequence[int]) -> dict[int, list[np.ndarray]]:
    """Return what arrival times add to the matrix of `Information`, by the number of takes, for some sets of sources.

    Empty without impulses. Nor does the forecast of a plane array in a room count on them.
    """
    found: dict[int, list[np.ndarray]] = {count: [] for count in takes}
    if request.kind != "impulse" or request.is_plane_in_room:
        return found
    (N, D), places = request.layout.positions.shape, places_in_room(request)
    on = np.append(np.arange(N * D), N * D + N)  # coordinates, and the logarithm of the sound speed
    for seed in range(FORECAST.source_sets):
        rng, matrix = np.random.default_rng([request.seed, 11, seed]), np.zeros((N * D + N + 1,) * 2)
        for count in range(1, max(takes) + 1):
            source = random_source(
                request.room, places, PLAN_LIMITS.clearance, rng, lambda one: not encloses(places[:, :2], one[:2])
            )
            if source is None:
                problem = f"no place of the room is {PLAN_LIMITS.clearance:g} m from the array"
                raise InputError(problem, "give a larger <room>", key="room")
            matrix[np.ix_(on, on)] += arrival_matrix(places, source, D)
            if count in found:
                found[count].append(matrix.copy())
    return found


def arrival_matrix(places: np.ndarray, source: np.ndarray, D: int) -> np.ndarray:
    """Return what arrival times of one take say : (N D + 1, N D + 1) float64, of positions and log sound speed.

    Microphones at `places` (N, 2 or 3), `source` likewise, metres; the first D coordinates of a microphone are sought.
    The source and the time of emission are unknown: the residuals' part along them is projected out.
    """
    (N, size), rules, away = places.shape, FORECAST, places - source
    path = np.linalg.norm(away, axis=1)
    along, each = away / path[:, None], np.arange(N)[:, None]
    slopes = np.zeros((N, N * D + 1))  # of -r
    slopes[each, D * each + np.arange(D)] = along[:, :D]
    slopes[:, -1] = np.median(path) - path
    basis = np.linalg.svd(np.column_stack([along, np.ones(N)]), full_matrices=False)[0][:, : size + 1]
    slopes -= basis @ (basis.T @ slopes)
    return (rules.freedom + 1) / (rules.freedom * rules.arrival_sigma_m**2) * slopes.T @ slopes


def places_in_room(request: PlanRequest) -> np.ndarray:
    """Return the microphones in the room : (N, 2 or 3) float64, metres.

    Their own coordinates where these lie inside; otherwise the array is moved off the room's middle.
    """
    size, x = np.array(request.room), request.stated_places
    if np.all((x > WALL_DISTANCE_M) & (x < size - WALL_DISTANCE_M)):
        return x
    edge = np.ptp(x, axis=0) / 2 + WALL_DISTANCE_M
    centre = np.clip(np.array(PLAN_LIMITS.place[: len(size)]) * size, edge, size - edge)
    return x - (x.min(axis=0) + x.max(axis=0)) / 2 + centre


def _degeneracies(request: PlanRequest, bound: Bound) -> tuple[str, ...]:
    """Return in words what pressures and given positions leave undetermined."""
    x, found, D = request.layout.positions, [], request.layout.positions.shape[1]
    if not fixes_gauge(x[request.prior.known]):
        what, line = ("the array's plane", "on one line") if D == 2 else ("the array", "in one plane")
        side = "; the side of the array's plane on which the source was is not determined"
        found.append(
            f"{what} can be mirrored: pressures determine it up to a rotation, a translation and a mirror image,"
            f" {D + 1} given positions that are not {line} decide it{side if D < request.dimension else ''}"
        )
    if bound.scale_sigma > FORECAST.blurred:
        found.append(f"size is determined to {100 * bound.scale_sigma:.2g} % only: give one distance or position more")
    elif bound.deformations[-1] > FORECAST.blurred:
        axis = np.linalg.eigh(bound.shapes[-1])[1][:, -1]
        along = ", ".join(f"{value:.2g}" for value in axis)
        found.append(f"a stretch along ({along}) is determined to {100 * bound.deformations[-1]:.2g} % only")
    count = len(request.frequencies)
    if request.takes * count * 2 < x.size:
        takes = f" in each of {request.takes} takes" if request.takes > 1 else ""
        found.append(f"{count} frequencies{takes} for {x.size} coordinates are few: use a wider band")
    return tuple(found)


def plan_sentences(plan: Plan) -> tuple[list[str], tuple[str, str]]:
    """Return what a plan says: the lines before its table, and the caption of the table and the advice after it."""
    request, forecast, sigma = plan.request, plan.forecast, plan.bound.sigma[plan.bound.free]
    (low, high), count = request.limits, len(request.frequencies)
    field = "a diffuse field" if request.room is None else f"a room of {'x'.join(f'{v:g}' for v in request.room)} m"
    takes = f", the source at {request.takes} places, recorded equally long from each" if request.takes > 1 else ""
    lines = [
        f"{len(request.layout.names)} microphones ({request.layout.name}) in {field},"
        f" reverberation time {request.reverberation_time:g} s, {request.snr_db:g} dB{takes}"
    ]
    if request.room is not None and not np.array_equal(places_in_room(request), request.stated_places):
        centre = ", ".join(f"{value:.3g}" for value in places_in_room(request).mean(axis=0))
        lines.append(
            f"the layout does not lie inside the room: the array is moved as a whole, its centre to ({centre}) m"
        )
    if request.layout.axes is not None:
        along = " and ".join(f"({', '.join(f'{value + 0.0:.3g}' for value in axis)})" for axis in request.layout.axes)
        lines.append(f"a plane array that is not level: its coordinates are along {along}")
    wanted = len(request.band_frequencies)
    of = f" in each take, as many of {wanted} as an import takes by default," if count < wanted else ""
    top = high if request.band is None else request.band[1]
    left_out = f", so that of {low:g} to {top:g} Hz the higher ones are left out" if top > high else ""
    lines.append(
        f"frequencies: {count} independent ones{of} from {low:.0f} to {high:.0f} Hz;"
        f" the array interpolates up to {request.f_max:.0f} Hz{left_out}"
    )
    why = ""
    if request.is_plane_in_room:
        why = "; the size of a plane array follows from equal waves from all directions, which no room has"
    elif forecast.timed:
        why = "; arrival times included, which the bound leaves out"
    elif request.kind == "impulse":
        why = "; arrival times add too little to count"
    ends = f"{length_text(forecast.low)} to {length_text(forecast.high)}"
    lines.append(f"expected error: {length_text(forecast.rms)} rms, {ends} in 8 of 10 recordings{why}")
    few = len(request.layout.names) <= FORECAST.few_blind and request.takes == 1
    if few and request.dimension == 3 and not request.known:
        lines.append(
            "so few microphones, from one place of the source and without given positions, are often not found, or"
            " with a larger error than expected; use more places of the source"
        )
    lines.append(
        f"least error (Cramer-Rao bound): {length_text(plan.bound.rms)} rms, {length_text(float(sigma.max()))} at the"
        " worst microphone, in a diffuse field"
    )
    more = "; 3 dB more is twice as long a recording in the same noise" if len(plan.snr_db) > 1 else ""
    head = f"expected error by places of the source, each recorded equally long, and signal-to-noise ratio{more}:"
    return [*lines, *plan.degeneracies], (head, _advice(plan))


def plan_table(plan: Plan) -> list[list[str]]:
    """Return the table of expected errors as texts, its head first: a row for each number of places of the source."""
    rows = [[f"{takes} place{'s' if takes > 1 else ''}", *map(length_text, row.tolist())]
            for takes, row in zip(plan.takes, plan.expected, strict=True)]  # fmt: skip
    return [["", *(f"{snr_db:g} dB" for snr_db in plan.snr_db)], *rows]


def plan_lines(plan: Plan) -> list[str]:
    """Return what a plan says, a line each."""
    (lines, (head, advice)), table = plan_sentences(plan), plan_table(plan)
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    rows = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in table]
    return [*lines, head, *rows, advice]


def _advice(plan: Plan) -> str:
    """Return what reaches the accuracy that is wanted, by the table alone."""
    request, wanted = plan.request, f"{length_text(plan.request.accuracy)} rms"
    reached = plan.expected <= request.accuracy
    own = plan.takes.index(request.takes)
    if reached[own, 0]:
        return f"{wanted} is expected as planned"
    ways = []
    if reached[:, 0].any():
        ways.append(f"{plan.takes[int(np.argmax(reached[:, 0]))]} places of the source")
    if reached[own].any():
        ways.append(f"{plan.snr_db[int(np.argmax(reached[own]))]:g} dB")
    if ways:
        return f"{wanted} needs {' or '.join(ways)}"
    if reached.any():
        row = int(np.argmax(reached.any(axis=1)))
        snr_db = plan.snr_db[int(np.argmax(reached[row]))]
        return f"{wanted} needs {plan.takes[row]} places of the source and {snr_db:g} dB"
    uncertain = request.known_sigma > 0 and len(request.known) > 0
    remedy = "measure the given positions better" if uncertain else "use more microphones or a wider band"
    return f"nothing in this table reaches {wanted}: {remedy}"


FORMAT = 1  # of the JSON


def plan_dict(plan: Plan) -> dict:
    """Return a plan as JSON holds it: lengths in metres, frequencies in hertz."""
    request = plan.request
    return {
        "format": FORMAT,
        "layout": request.layout.name,
        "names": list(request.layout.names),
        "positions_m": request.layout.positions.tolist(),
        "room_m": None if request.room is None else list(request.room),
        "reverberation_time_s": request.reverberation_time,
        "snr_db": request.snr_db,
        "band_hz": list(request.limits),
        "f_max_hz": request.f_max,
        "modes": len(request.frequencies),
        "takes": request.takes,
        "known": [request.layout.names[n] for n in request.known],
        "known_sigma_m": request.known_sigma,
        "gain_sigma_db": request.gain_sigma_db,
        "kind": request.kind,
        "accuracy_m": request.accuracy,
        "expected_rms_m": plan.forecast.rms,
        "expected_range_m": [plan.forecast.low, plan.forecast.high],
        "bound_rms_m": plan.bound.rms,
        "bound_m": plan.bound.sigma.tolist(),
        "covariance_m2": plan.bound.covariance.tolist(),
        "scale_sigma": plan.bound.scale_sigma,
        "table": {"takes": list(plan.takes), "snr_db": list(plan.snr_db), "expected_rms_m": plan.expected.tolist()},
        "degeneracies": list(plan.degeneracies),
        "text": plan_lines(plan),
    }
