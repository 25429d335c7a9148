"""A plan: a forecast, before anything is recorded, of how exactly an array will be calibrated.

A `PlanRequest` is an array, from a table, a geometry of Acoular, a scene or words such as "circle 16 0.2", and the
circumstances of its calibration. The bound assumes that all frequencies are independent. They are not: the pressures in
a room that decays evenly have, at a distance of x Hz, the squared correlation

    |r|^2 = 1 / (1 + (pi x / s)^2),    s = 6.9 / T60 nepers per second

The solver makes the same assumption, so the covariance of its gradient is F + sum |r|^2 F' over all pairs of different
frequencies, where F' is the part of the information F that the field contributes, not the noise. The covariance of the
positions is larger by the same factor. The forecast assumes F' = F / 2. With impulses it adds the information of the
arrival times tau_n, where the position y of the source and b are unknown:

    r_n = c tau_n - |x_n - y| - b      residual at microphone n, metres; b is c times the time of emission

For a small array in a field of three dimensions it adds the short windows of the recording. They count as
`ForecastRules.windows` independent windows, whatever the length of the recording, because a room has few waves. For a
plane array this is the number of each take.

Less noise never makes the forecast worse: each signal-to-noise ratio is judged by the same frequencies and the same
positions of the source, and the information of a Gaussian field decreases with its noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from scipy.spatial.distance import pdist

from ..acoustics.box_field import independent_frequencies
from ..acoustics.dictionary import array_f_max
from ..acoustics.measure import cached_measurement
from ..assessment.uncertainty import Bound, Information, Prior, diffuse_information, position_bound
from ..model.arrays import WALL_DISTANCE_M, geometry, hull_meets, positions_of, random_source
from ..model.gauge import fixes_gauge
from ..model.measurement import checked_known
from ..model.problem import MAX_COUNT
from ..model.quantities import Metres, MetresPerSecond, Seconds, Seed
from ..model.scene import Array, MeasuredScene, Scene, load_scene, scene_names
from ..model.validation import InputError, check, evenly_spaced, frozen_array, length_text, refusal, within
from ..recordings.formats.positions import READERS, read_positions
from ..recordings.frequencies import default_max_rows
from ..recordings.short_windows import HIGHEST, LOWEST, WINDOW
from ..solvers.robust.windows import MAX_DIAMETER
from .process import one_blas_thread

FLAT_M = 1e-6  # metres, distance from a plane up to which microphones count as lying in it
FORMS = ("circle", "rectangle", "ball", "box")
EXAMPLES = '"circle 16 0.2", "rectangle 4x4 0.6x0.6", "ball 32 0.3" or "box 32 0.6x0.6x0.4"'


@dataclass(frozen=True)
class Layout:
    """The microphones of a plan."""

    name: str  # name of the file or scene, or the words
    names: tuple[str, ...]  # (N,) tuple of str
    positions: np.ndarray  # (N, D) float64, metres; D is 2 for a plane array, whose coordinates are in its plane
    scene: Scene | None = None


def read_layout(text: str, seed: int = 0) -> Layout:
    """Return the array of a table or geometry, a scene, or a geometry in words.

    The words are the name of a geometry of scenes, then count and radius, or shape and size, metres; `seed`: that of
    the random positions of "ball" and "box".
    """
    words = text.split()
    if Path(text).suffix.lower() in READERS:
        placed = read_positions(text)
        name, x = Path(text).name, np.asarray(placed.positions, float)
        if np.ptp(x[:, 2]) < FLAT_M:
            x = x[:, :2]
        elif len(x) > 3:  # a plane array that is not level gets coordinates in its plane
            along = (x - x.mean(axis=0)) @ np.linalg.svd(x - x.mean(axis=0))[2].T
            if np.abs(along[:, 2]).max() < FLAT_M:
                name, x = f"{name}, coordinates in its plane", along[:, :2]
        return Layout(name, placed.names, frozen_array(x, float))
    if len(words) > 1 or text in FORMS:
        positions = _of_words(words, text, seed)
        return Layout(text, tuple(map(str, range(len(positions)))), frozen_array(positions, float))
    if text in scene_names() or text.lower().endswith(".toml"):
        scene = load_scene(text)
        if not isinstance(scene, MeasuredScene):
            positions = positions_of(scene)
            return Layout(scene.name, tuple(map(str, range(len(positions)))), positions, scene)
        measurement = cached_measurement(scene)
        if measurement.positions is not None:
            return Layout(scene.name, measurement.names, measurement.positions)
        raise InputError(f"{scene.name} is a measurement without positions", "give a table of them", key="layout")
    files = f"a file of positions ({', '.join(sorted(READERS))})"
    remedy = f"give {files}, a scene ({', '.join(scene_names())}), or a geometry as {EXAMPLES}"
    raise InputError(f'"{text}" names no array', remedy, key="layout")


def _of_words(words: list[str], text: str, seed: int) -> np.ndarray:
    try:
        kind, number, length = words
        counts, lengths = tuple(map(int, number.lower().split("x"))), tuple(map(float, length.lower().split("x")))
        center = (0.0,) * (2 if FORMS.index(kind) < 2 else 3)
        size: dict[str, Any] = {"shape": counts} if kind == "rectangle" else dict(zip(["count"], counts, strict=True))
        size |= {"size": lengths} if kind in ("rectangle", "box") else dict(zip(["radius"], lengths, strict=True))
    except ValueError:  # also for more or fewer words or numbers than the geometry has
        raise InputError(f'"{text}" is not a geometry', f"write it as {EXAMPLES}", key="layout") from None
    return geometry(Array(kind, center=center, **size), np.random.default_rng(seed))


ONE_PLACE = 1e-6  # fraction of the array's extent; microphones that are closer count as one


@dataclass(frozen=True)
class PlanLimits:
    """Defaults, limits, and how much is computed."""

    low: float = 20.0  # Hz, lowest frequency by default
    # highest frequency by default, divided by f_max (Eq. 9): at f_max the field has as many functions as there are
    # microphones, so that the pressures do not predict each other
    high: float = 0.7
    # largest number of frequencies times microphones for which the information is computed; above it some frequencies
    # are left out, and the result is scaled
    work: int = 3000
    min_frequencies: int = 16  # least number of frequencies for which it is computed
    clearance: float = 0.7  # least distance of a source from the microphones in a room, metres
    # an array that does not lie inside the room is moved to this place, relative to the lengths of the room
    centre: tuple[float, float, float] = (0.43, 0.46, 0.45)
    # largest values in a plan
    max_microphones: int = 300
    max_takes: int = 100
    max_snr_db: float = 120.0
    wide: float = 5.0  # metres; the message for a wider array that is refused asks whether positions are in metres


PLAN_LIMITS = PlanLimits()


MIN_FREQUENCIES = 3  # smallest number of frequencies that a calibration needs


@dataclass(frozen=True)
class PlanRequest:
    """An array, and the circumstances of its calibration."""

    layout: Layout
    # (2,) or (3,) tuple of float, metres, lengths of a rectangular room; None for a diffuse field, which is in
    # space unless the layout is that of a scene in a plane
    room: tuple[Metres, ...] | None = None
    reverberation_time: Seconds = 0.5
    # signal-to-noise ratio of each frequency
    snr_db: Annotated[float, within(0.1, PLAN_LIMITS.max_snr_db, "dB")] = 30.0
    # (2,) tuple of float, Hz; the default is 20 Hz, or f_max / 10 (Eq. 9) if that is lower, to 0.7 f_max. No frequency
    # above f_max is used
    band: tuple[float, float] | None = None
    known: tuple[int, ...] = ()  # (A,) tuple of int, microphones whose positions are given
    # one sigma of each of their coordinates; 0 for exact ones
    known_sigma: Annotated[float, within(0, 1e12, "m")] = 0.0
    # standard deviation of the channels' gains; 0 for equal channels
    gain_sigma_db: Annotated[float, within(0, 1e12, "dB")] = 0.0
    sound_speed: MetresPerSecond = 343.0
    accuracy: Metres = 0.01  # RMS error to be reached
    seed: Seed = 0  # seed of the positions of the source
    # number of source positions, each recorded by itself at `snr_db`; every take has the same frequencies
    takes: Annotated[int, within(1, PLAN_LIMITS.max_takes)] = 1
    # what the source plays; "impulse" includes sweeps and claps, and arrival times are used in addition
    kind: Literal["stationary", "impulse"] = "stationary"

    def __post_init__(self):
        x, room = self.layout.positions, self.room
        (N, D), low, high = x.shape, x.shape[1] + 3, PLAN_LIMITS.max_microphones
        if not low <= N <= high:
            raise InputError(f"the layout has {N} microphones", f"give {low} to {high}", key="layout")
        apart = pdist(x)
        if apart.min() <= ONE_PLACE * apart.max():
            first, second = (self.layout.names[rows[np.argmin(apart)]] for rows in np.triu_indices(N, 1))
            raise InputError(f"microphones {first} and {second} coincide", "move one or leave it out", key="layout")
        check(self, names={"snr_db": "snr", "band": "frequencies", "reverberation_time": "rt60"})
        if room is not None and len(room) not in (2, 3):
            raise refusal("room", list(room), f"has {len(room)} lengths", "give <room> two or three")
        if room is not None and len(room) < D:
            raise InputError("the array has heights, but the room has none", "give <room> three lengths", key="room")
        if self.kind == "impulse" and room is None:
            raise InputError("arrival times of impulses depend on the room", "give <room>", key="room")
        checked_known(self.known, None, self.layout.positions, N, D)
        if self.known_sigma and not self.known:
            raise InputError("known_sigma is for given positions", "give <known>, or use 0", key="known_sigma")
        extent, sides = np.ptp(x, axis=0), np.array(room or (np.inf,) * D)
        if self.is_plane_in_room:  # its plane may have any direction
            extent, sides = np.sort(extent), np.sort(sides)[1:]
        if np.any(extent > sides - 2 * WALL_DISTANCE_M):
            array, size = (" x ".join(f"{length:.3g}" for length in lengths) for lengths in (extent, room or ()))
            problem = f"the array, {array} m, does not fit into the room, {size} m,"
            problem += f" {WALL_DISTANCE_M:g} m from its walls"
            raise InputError(problem, "give a smaller array or a larger <room>, both in metres", key="room")
        if len(self.frequencies) < MIN_FREQUENCIES:
            low, high = self.limits
            problem = f"{low:.1f} to {high:.1f} Hz with a reverberation time of {self.reverberation_time:g} s hold"
            problem += f" {len(self.frequencies)} independent frequencies, but a calibration needs {MIN_FREQUENCIES}"
            remedy = "use a wider band (<frequencies>), or a smaller array, whose band reaches higher" + self._width
            raise InputError(problem, remedy, key="frequencies")

    @property
    def dimension(self) -> int:
        """Dimension of the sound field, 2 or 3."""
        return len(self.room or ()) or (3 if self.layout.scene is None else self.layout.scene.room.dimension)

    @property
    def is_plane_in_room(self) -> bool:
        """Whether the array is plane and the room has three dimensions."""
        return self.room is not None and len(self.room) == 3 and self.layout.positions.shape[1] == 2

    @property
    def f_max(self) -> float:
        """The highest frequency that the array can interpolate (Eq. 9), Hz."""
        return array_f_max(self.layout.positions, self.sound_speed, self.dimension)

    @property
    def limits(self) -> tuple[float, float]:
        """The band in use, Hz: the given or default band, cut off at `f_max`."""
        low, high = self.band or (min(PLAN_LIMITS.low, self.f_max / 10), PLAN_LIMITS.high * self.f_max)
        if not 0 < low < high:
            raise InputError(f"{low:g} to {high:g} Hz is not a band", "give <frequencies> as LO:HI", key="frequencies")
        if low >= self.f_max:
            problem = f"the array interpolates up to {self.f_max:.0f} Hz, but the band begins at {low:g} Hz"
            remedy = "use a lower band (<frequencies>), a smaller array or more microphones" + self._width
            raise InputError(problem, remedy, key="frequencies")
        return low, min(high, self.f_max)

    @property
    def _width(self) -> str:
        """The advice to give positions in metres, for a very wide array; "" for others."""
        width = float(np.ptp(self.layout.positions, axis=0).max())
        wide = f"; the array is {width:.3g} m wide: give its positions in metres, not in centimetres or millimetres"
        return wide if width > PLAN_LIMITS.wide else ""

    @property
    def band_frequencies(self) -> np.ndarray:
        """All independent frequencies of the band : float64, Hz."""
        return independent_frequencies(*self.limits, self.reverberation_time, self.sound_speed, self.room)

    @property
    def frequencies(self) -> np.ndarray:
        """The frequencies of one take : (M,) float64, Hz, spread evenly over those of the band, as an import does."""
        f = self.band_frequencies
        return f[evenly_spaced(len(f), default_max_rows(len(self.layout.names), self.takes))]

    @property
    def prior(self) -> Prior:
        """What is known in addition to the pressures."""
        return Prior(np.array(self.known, int), self.known_sigma, self.gain_sigma_db * np.log(10) / 20)


@dataclass(frozen=True)
class ForecastRules:
    """What the forecast adds to the bound; the figures are from 40 draws with noise and 30 with impulses."""

    # F' / F, see the module's docstring. With 8 to 48 microphones at 30 dB the exact sum corresponds to values from 0.3
    # to 0.8.
    field_part: float = 0.5
    # one sigma of an arrival time as a path, metres: it is 0.1 to 0.8 mm in simulated rooms, 0.9 mm in a measured array
    arrival_sigma_m: float = 5e-4
    freedom: float = 3.0  # degrees of freedom of the Student t distribution that the solver assumes for arrival times
    # Ratio of the error to the bound of field and arrival times together; it is 1.5 to 2.2 in the draws. The solver
    # treats all rows as independent and gives them too much weight compared with arrival times.
    arrival_margin: float = 1.7
    # One sigma of the logarithm of the error by which one room and source differ from the diffuse field, in addition to
    # the scatter that follows from the covariance.
    field_scatter: float = 0.2
    quantile: float = 1.28  # standard deviations to both sides, within which 8 of 10 draws lie
    # Ratio of the error to the bound of a plane array in a room: low, middle, high. The bound assumes equally strong
    # waves from all directions, from which the size of such an array would follow; no room has such waves.
    plane: tuple[float, float, float] = (2.0, 2.8, 4.0)
    source_sets: int = 8  # number of sets of source positions over which arrival times are averaged
    takes: tuple[int, ...] = (1, 2, 4, 8)  # numbers of takes that a plan compares with its own
    more_db: tuple[float, ...] = (0.0, 3.0, 6.0, 10.0)  # signal-to-noise ratios that a plan compares, dB above its own
    # Largest ratio that is compared, dB. Differences of 0.1 dB and 0.5 degrees between the channels cause the same
    # errors as noise 38 dB below the signal, so that less noise is of no use.
    max_snr_db: float = 40.0
    # A plan mentions one sigma of the size, relative, if it exceeds this: 10 mm in an array of 1 m, which equals the
    # default accuracy.
    blurred: float = 0.01
    # Number of independent short windows, of all frequencies together, that explains the errors of `python -m
    # benchmarks comparison`.
    windows: float = 960.0
    window_noise: float = 0.05  # least fraction of the power of the windows that their model leaves unexplained
    window_frequencies: int = 40  # number of frequencies at which the information of the windows is computed
    size_sigma: float = 0.02  # relative one sigma of the size of a plane array by the short windows of one take


FORECAST = ForecastRules()


@dataclass(frozen=True)
class Forecast:
    """The error that a calibration is expected to have: RMS over the microphones that are sought, metres."""

    rms: float  # expected error
    low: float  # the errors of 8 of 10 recordings are between `low` and `high`
    high: float
    beyond: str = ""  # information that the forecast uses and the bound does not, in words

    @property
    def without(self) -> str:
        """Beginning of a sentence about the bound."""
        return f"without {self.beyond} " if self.beyond else ""


@dataclass(frozen=True)
class Plan:
    """The forecast for a request, and for other numbers of takes and other signal-to-noise ratios."""

    request: PlanRequest
    bound: Bound  # Cramer-Rao bound in a diffuse field
    forecast: Forecast
    # snr_db: (S,) ascending, takes: (T,) ascending, expected: (T, S) float64, metres, the forecast for other numbers of
    # source positions and other signal-to-noise ratios. The first ratio is that of the request
    snr_db: tuple[float, ...]
    takes: tuple[int, ...]
    expected: np.ndarray
    degeneracies: tuple[str, ...]  # what the pressures determine badly, in words


def make_plan(request: PlanRequest) -> Plan:
    """Return the bound of a request, the expected error, and those with other numbers of takes or less noise."""
    rules, x, takes = FORECAST, request.layout.positions, tuple(sorted({*FORECAST.takes, request.takes}))
    best = max(rules.max_snr_db, request.snr_db)
    ratios = tuple(sorted({min(request.snr_db + more, best) for more in rules.more_db}))
    with one_blas_thread():
        arrivals = _arrival_information(request, takes)
        others = [replace(request, takes=count) for count in takes]
        used = request.band_frequencies
        used = used[evenly_spaced(len(used), max(PLAN_LIMITS.min_frequencies, PLAN_LIMITS.work // len(x)))]
        k, noise = 2 * np.pi * used / request.sound_speed, [10 ** (-snr_db / 10) for snr_db in ratios]
        of_frequency = [  # in a diffuse field, the mean over the band
            diffuse_information(x, k, one / (1 + one), request.dimension).scaled(1 / len(used)) for one in noise
        ]
        windows: list[Information | None] = [None] * len(noise)
        widest = MAX_DIAMETER * WINDOW * request.sound_speed
        if request.dimension == 3 and len(x) <= MAX_COUNT[x.shape[1]] and pdist(x).max() <= widest:
            k = 2 * np.pi * np.linspace(LOWEST, HIGHEST, rules.window_frequencies) / request.sound_speed
            unexplained = [max(one / (1 + one), rules.window_noise) for one in noise]
            windows = [diffuse_information(x, k, one, 3).scaled(rules.windows / len(k)) for one in unexplained]
        table = [
            [_forecast(other, *one, arrivals[other.takes]) for one in zip(of_frequency, windows, strict=True)]
            for other in others
        ]
        bound = position_bound(of_frequency[0].scaled(request.takes * len(request.frequencies)), request.prior)
    expected = np.array([[cell.rms for cell in row] for row in table])
    forecast = table[takes.index(request.takes)][0]
    return Plan(request, bound, forecast, ratios, takes, expected, _degeneracies(request, bound, forecast.without))


def _forecast(
    request: PlanRequest, of_frequency: Information, windows: Information | None, arrivals: Sequence[np.ndarray]
) -> Forecast:
    """Return the expected error; `arrivals`: from `_arrival_information`, one matrix for each set of sources."""
    information = of_frequency.scaled(request.takes * len(request.frequencies))

    def scattering(found: list[Bound], factor: float, beyond: str) -> Forecast:
        rms = factor * float(np.sqrt(np.mean([one.rms**2 for one in found])))
        scatter = np.mean([1 / (2 * one.freedom) for one in found]) + FORECAST.field_scatter**2
        low, high = (rms * float(np.exp(sign * FORECAST.quantile * np.sqrt(scatter) - scatter)) for sign in (-1, 1))
        return Forecast(rms, low, high, beyond)

    if request.is_plane_in_room:
        bound = position_bound(information, request.prior)
        low, middle, high = (factor * bound.rms for factor in FORECAST.plane)
        found = [Forecast(middle, low, high)]
        if windows is not None:
            prior = replace(request.prior, sound_speed_sigma=FORECAST.size_sigma / np.sqrt(request.takes))
            found.append(scattering([position_bound(windows.scaled(request.takes), prior)], 1.0, "short windows"))
        return min(found, key=lambda one: one.rms)
    f, s = request.frequencies, np.log(1000) / request.reverberation_time
    alike = np.sum(1 / (1 + (np.pi * (f[:, None] - f) / s) ** 2), axis=1) - 1
    field = information.scaled(float(np.mean(1 / (1 + FORECAST.field_part * alike))))
    if windows is not None:
        field = replace(field, matrix=field.matrix + windows.matrix)
    of_windows = "" if windows is None else "short windows"
    plain = scattering([position_bound(field, request.prior)], 1.0, of_windows)
    if not arrivals:
        return plain
    cases = [position_bound(replace(field, matrix=field.matrix + matrix), request.prior) for matrix in arrivals]
    both = f"{of_windows} and arrival times" if of_windows else "arrival times"
    # Where arrival times add little, `arrival_margin` would make the forecast worse: then they are left out.
    return min(plain, scattering(cases, FORECAST.arrival_margin, both), key=lambda one: one.rms)


def _arrival_information(request: PlanRequest, takes: Sequence[int]) -> dict[int, list[np.ndarray]]:
    """Return what arrival times add to the matrix of `Information`, by the number of takes, for some sets of sources.

    The lists are empty without impulses, and for a plane array in a room.
    """
    found: dict[int, list[np.ndarray]] = {count: [] for count in takes}
    if request.kind != "impulse" or request.is_plane_in_room:
        return found
    (N, D), x = request.layout.positions.shape, positions_in_room(request)
    on = np.append(np.arange(N * D), N * D + N)  # coordinates, and the logarithm of the sound speed
    for seed in range(FORECAST.source_sets):
        rng, matrix = np.random.default_rng([request.seed, 11, seed]), np.zeros((N * D + N + 1,) * 2)
        for count in range(1, max(takes) + 1):
            source = random_source(
                request.room, x, PLAN_LIMITS.clearance, rng, lambda at: not hull_meets(x[:, :2], at[None, :2])
            )
            if source is None:
                why = f"has no point that is {PLAN_LIMITS.clearance:g} m from the array"
                raise refusal("room", request.room, why, "give a larger <room>", "m")
            matrix[np.ix_(on, on)] += arrival_matrix(x, source)
            if count in found:
                found[count].append(matrix.copy())
    return found


def arrival_matrix(positions: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Return the information of the arrival times of one take : (N D + 1, N D + 1) float64.

    It is the information on the coordinates of the microphones and on the logarithm of the sound speed. `positions`
    (N, D), metres, are those of the microphones, and `source` (D,) is the position of the source. The solver does not
    know this position and the time of emission: both are projected out of the residuals.
    """
    (N, D), rules, away = positions.shape, FORECAST, positions - source
    path = np.linalg.norm(away, axis=1)
    along, each = away / path[:, None], np.arange(N)[:, None]
    slopes = np.zeros((N, N * D + 1))  # derivatives of -r
    slopes[each, D * each + np.arange(D)] = along
    slopes[:, -1] = np.median(path) - path
    basis = np.linalg.svd(np.column_stack([along, np.ones(N)]), full_matrices=False)[0]
    slopes -= basis @ (basis.T @ slopes)
    return (rules.freedom + 1) / (rules.freedom * rules.arrival_sigma_m**2) * slopes.T @ slopes


def positions_in_room(request: PlanRequest) -> np.ndarray:
    """Return the positions of the microphones in the room : (N, 2 or 3) float64, metres.

    If those of the layout do not lie inside, the array is moved near the middle of the room, to `PLAN_LIMITS.centre`.
    """
    size, x = np.array(request.room), request.layout.positions
    if np.all((x > WALL_DISTANCE_M) & (x < size - WALL_DISTANCE_M)):
        return x
    edge = np.ptp(x, axis=0) / 2 + WALL_DISTANCE_M
    centre = np.clip(np.array(PLAN_LIMITS.centre[: len(size)]) * size, edge, size - edge)
    return x - (x.min(axis=0) + x.max(axis=0)) / 2 + centre


def _degeneracies(request: PlanRequest, bound: Bound, without: str) -> tuple[str, ...]:
    """Return sentences about what the pressures and the given positions do not determine."""
    x, found, D = request.layout.positions, [], request.layout.positions.shape[1]
    if not fixes_gauge(x[request.prior.known]):
        what, line = ("the array in its plane", "on one line") if D == 2 else ("the array", "in one plane")
        side = "; the pressures do not show on which side of the array's plane the source was"
        found.append(
            f"pressures determine {what} up to a rotation, a translation and a mirror image; {D + 1} given positions"
            f" that are not {line} determine these, too{side if D < request.dimension else ''}"
        )
    if bound.scale_sigma > FORECAST.blurred:
        size = f"the size is known only to {100 * bound.scale_sigma:.2g} %: one given distance determines it"
        found.append(without + size)
    return tuple(found)


def plan_lines(plan: Plan) -> list[str]:
    """Return the lines of text that describe a plan."""
    request, forecast, sigma = plan.request, plan.forecast, plan.bound.sigma[plan.bound.free]
    (low, high), count = request.limits, len(request.frequencies)
    field = "a diffuse field" if request.room is None else f"a room of {'x'.join(f'{v:g}' for v in request.room)} m"
    takes = f", the source at {request.takes} places, each recorded for the same time" if request.takes > 1 else ""
    lines = [
        f"{len(request.layout.names)} microphones ({request.layout.name}) in {field},"
        f" reverberation time {request.reverberation_time:g} s, {request.snr_db:g} dB{takes}"
    ]
    inside = request.room is None or request.is_plane_in_room
    if not inside and not np.array_equal(positions_in_room(request), request.layout.positions):
        centre = ", ".join(f"{value:.3g}" for value in positions_in_room(request).mean(axis=0))
        moved = f"the array is moved as a whole, its centre to ({centre}) m"
        lines.append(f"the coordinates of the layout are not inside the room: {moved}")
    wanted = len(request.band_frequencies)
    of = f" in each take (the band has {wanted}; by default an import uses {count})" if count < wanted else ""
    top = high if request.band is None else request.band[1]
    left_out = f"; of {low:g} to {top:g} Hz the higher ones are left out" if top > high else ""
    lines.append(
        f"frequencies: {count} independent ones{of} from {low:.0f} to {high:.0f} Hz;"
        f" the array interpolates up to {request.f_max:.0f} Hz{left_out}"
    )
    why = ""
    if forecast.beyond:
        why = f"; it includes {forecast.beyond}"
    elif request.is_plane_in_room:
        why = "; only an isotropic field determines the size of a plane array, and no room is isotropic"
    elif request.kind == "impulse":
        why = "; arrival times hardly reduce it"
    ends = f"{length_text(forecast.low)} to {length_text(forecast.high)}"
    lines.append(f"expected error: {length_text(forecast.rms)} rms, {ends} in 8 of 10 recordings{why}")
    lines.append(
        f"least error {forecast.without}(Cramer-Rao bound): {length_text(plan.bound.rms)} rms,"
        f" {length_text(float(sigma.max()))} at the worst microphone, in a diffuse field"
    )
    more = "; 3 dB more SNR needs twice the recording time in the same noise" if len(plan.snr_db) > 1 else ""
    head = f"expected error by number of source positions, each recorded for the same time, and by SNR{more}:"
    table = [["", *(f"{snr_db:g} dB" for snr_db in plan.snr_db)]]
    for number, expected in zip(plan.takes, plan.expected, strict=True):
        table.append([f"{number} place{'s' if number > 1 else ''}", *map(length_text, expected.tolist())])
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    rows = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in table]
    return [*lines, *plan.degeneracies, head, *rows, _advice(plan)]


def _advice(plan: Plan) -> str:
    """Return the sentence that says which number of source positions or which SNR reaches the wanted accuracy."""
    request, wanted = plan.request, f"{length_text(plan.request.accuracy)} rms"
    reached = plan.expected <= request.accuracy
    own = plan.takes.index(request.takes)
    if reached[own, 0]:
        return f"the plan is expected to reach the wanted {wanted}"
    needed = []
    if reached[:, 0].any():
        needed.append(f"{plan.takes[int(np.argmax(reached[:, 0]))]} places of the source")
    if reached[own].any():
        needed.append(f"{plan.snr_db[int(np.argmax(reached[own]))]:g} dB")
    if needed:
        return f"the wanted {wanted} needs {' or '.join(needed)}"
    if reached.any():
        row = int(np.argmax(reached.any(axis=1)))
        snr_db = plan.snr_db[int(np.argmax(reached[row]))]
        return f"the wanted {wanted} needs {plan.takes[row]} places of the source and {snr_db:g} dB"
    uncertain = request.known_sigma > 0 and len(request.known) > 0
    remedy = "measure the given positions better" if uncertain else "use more microphones or a wider band"
    return f"nothing in this table reaches the wanted {wanted}: {remedy}"
