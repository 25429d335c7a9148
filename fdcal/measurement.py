"""What was measured, and what of it a solver may see.

`Measurement` may hold the true positions, for scoring alone; `Problem` cannot.
`fdcal.measurement_file` reads and writes it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .arrays import positions_of
from .checks import InputError, frozen_array, require_choice, require_finite, require_positive
from .scene import Scene, Search


@dataclass(frozen=True, eq=False)
class Problem:
    """All that a solver may see: no truth. Compared by identity, so that tables made for one can be kept.

    Attributes
    ----------
    pressures : (M, N) complex128, dimensionless with `weights = "unit"` (each mode of unit RMS)
    wavenumbers : (M,) complex128, rad/m, time sign exp(+j w t)
    frequencies : (M,) float64, Hz
    known : (A,) int64, known microphones, ascending
    known_positions : (A, D) float64, metres
    search : Search or None, lattice of candidates and expansion radius
    noise_power : (M,) float64 or None, in the unit of abs(pressures)**2
    sound_speed : float, m/s
    dimension, array_dimension : 2 or 3, of the sound field and of the positions (D)
    """

    pressures: np.ndarray
    wavenumbers: np.ndarray
    frequencies: np.ndarray
    known: np.ndarray
    known_positions: np.ndarray
    search: Search | None
    noise_power: np.ndarray | None
    sound_speed: float
    dimension: int
    array_dimension: int

    @property
    def free(self) -> np.ndarray:
        """(N - A,) int64, the microphones to be found, ascending."""
        return np.setdiff1d(np.arange(self.pressures.shape[1]), self.known)


@dataclass(frozen=True)
class Measurement:
    """Pressures of M modes at N microphones and what is known about them.

    Attributes
    ----------
    frequencies : (M,) float64, Hz, ascending
    pressures : (M, N) complex128, any one unit for all (recordings are not calibrated)
    sound_speed : float, m/s
    dimension : 2 or 3, of the sound field
    array_dimension : 2 or 3, the D of all positions; `dimension` unless given
    wavenumbers : (M,) complex128, rad/m, time sign exp(+j w t); 2 pi f / c unless given
    noise_power : (M,) float64 or None, unit of abs(pressures)**2
    names : (N,) tuple of str; "0", "1", ... unless given
    positions : (N, D) float64 or None, metres, the truth, for scoring alone
    known : (A,) int64, indices of known microphones, ascending
    known_positions : (A, D) float64, metres
    search : Search or None

    Raises InputError for a wrong shape, NaN, a dead microphone or frequency, real pressures.
    """

    frequencies: np.ndarray
    pressures: np.ndarray
    sound_speed: float
    dimension: int = 2
    array_dimension: int | None = None
    wavenumbers: np.ndarray | None = None
    noise_power: np.ndarray | None = None
    names: tuple[str, ...] | None = None
    positions: np.ndarray | None = None
    known: np.ndarray = ()
    known_positions: np.ndarray | None = None
    search: Search | None = None

    def __post_init__(self):
        _fill_defaults(self)
        _check_pressures(self)
        _check_positions(self)

    @property
    def count(self) -> int:
        """Number of microphones N."""
        return self.pressures.shape[1]

    def problem(self, weights: str = "unit") -> Problem:
        """What a solver sees: modes of unit RMS (`weights = "unit"`), or as measured ("raw", the paper's)."""
        require_choice("weights", weights, ("unit", "raw"))
        power = np.mean(np.abs(self.pressures) ** 2, axis=1) if weights == "unit" else np.ones(len(self.frequencies))
        noise = None if self.noise_power is None else frozen_array(self.noise_power / power, float)
        return Problem(
            pressures=frozen_array(self.pressures / np.sqrt(power)[:, None], complex),
            noise_power=noise,
            **{
                name: getattr(self, name)
                for name in (
                    "wavenumbers",
                    "frequencies",
                    "known",
                    "known_positions",
                    "search",
                    "sound_speed",
                    "dimension",
                    "array_dimension",
                )
            },
        )


def _fill_defaults(m: Measurement) -> None:
    """Cast every array of `m` to its type and fill in what follows from the rest."""
    put = lambda name, value: object.__setattr__(m, name, value)  # noqa: E731
    if not np.iscomplexobj(m.pressures):
        raise InputError("pressures are real; give complex pressures (the transform at each frequency), shape (M, N)")
    put("frequencies", frozen_array(m.frequencies, float))
    put("pressures", frozen_array(m.pressures, complex))
    if m.frequencies.ndim != 1 or m.pressures.ndim != 2 or len(m.pressures) != len(m.frequencies):
        raise InputError(
            f"pressures of shape {m.pressures.shape} do not match frequencies of shape {m.frequencies.shape};"
            " give (M, N) and (M,)"
        )
    require_choice("dimension", m.dimension, (2, 3))
    put("dimension", int(m.dimension))
    put("array_dimension", int(m.array_dimension or m.dimension))
    put("sound_speed", float(m.sound_speed))
    require_positive("sound_speed", m.sound_speed, "m/s")
    given = 2 * np.pi * m.frequencies / m.sound_speed if m.wavenumbers is None else m.wavenumbers
    put("wavenumbers", frozen_array(given, complex))
    put("names", tuple(str(n) for n in (range(m.count) if m.names is None else m.names)))
    if m.noise_power is not None:
        put("noise_power", frozen_array(m.noise_power, float))
    if m.positions is not None:
        put("positions", frozen_array(m.positions, float))
    order = np.argsort(m.known)
    put("known", frozen_array(np.asarray(m.known, dtype=np.int64)[order], np.int64))
    if m.known_positions is None:
        if len(m.known) and m.positions is None:
            raise InputError("known names microphones but known_positions is missing; add it, shape (A, D)")
        shape = (0, m.array_dimension)
        put("known_positions", frozen_array(m.positions[m.known] if len(m.known) else np.zeros(shape), float))
    else:
        places = np.asarray(m.known_positions)
        if places.size:
            places = places.reshape(len(places), -1)
        if len(places) != len(m.known):
            raise InputError(f"known_positions has {len(places)} rows for {len(m.known)} known microphones")
        places = places[order] if len(m.known) else np.zeros((0, m.array_dimension))
        put("known_positions", frozen_array(places, float))


def _check_pressures(m: Measurement) -> None:
    modes, count = m.pressures.shape
    if modes == 0 or count < 2:
        raise InputError(f"pressures of shape {m.pressures.shape} hold too little; give one frequency, two microphones")
    for name in ("frequencies", "pressures", "wavenumbers"):
        require_finite(name, getattr(m, name))
    if np.any(m.frequencies <= 0) or np.any(np.diff(m.frequencies) <= 0):
        raise InputError("frequencies must be above zero and ascending, each once; sort them (and the pressures)")
    if m.wavenumbers.shape != (modes,) or np.any(m.wavenumbers.real <= 0):
        raise InputError(f"wavenumbers must be {modes} numbers with a real part above zero")
    silent = np.flatnonzero(~np.any(m.pressures, axis=0))
    if len(silent):
        raise InputError(f'microphone "{m.names[silent[0]]}" has zero pressure at every frequency; leave it out')
    silent = np.flatnonzero(~np.any(m.pressures, axis=1))
    if len(silent):
        raise InputError(f"pressures at {m.frequencies[silent[0]]:g} Hz are zero at every microphone; leave it out")
    if m.noise_power is not None:
        if m.noise_power.shape != (modes,):
            raise InputError(
                f"noise_power of shape {m.noise_power.shape} must have one entry for each of {modes} modes"
            )
        require_finite("noise_power", m.noise_power)
        if np.any(m.noise_power < 0):
            raise InputError("noise_power must not be negative")


def _check_positions(m: Measurement) -> None:
    count, D = m.count, m.array_dimension
    if D not in (2, 3) or D > m.dimension:
        raise InputError(f"array_dimension = {D} must be 2 or 3 and at most dimension = {m.dimension}")
    if len(m.names) != count or len(set(m.names)) != count:
        raise InputError(f"names must be {count} different texts, one for each microphone")
    if m.positions is not None:
        if m.positions.shape != (count, D):
            raise InputError(f"positions of shape {m.positions.shape} must be ({count}, {D}), metres")
        require_finite("positions", m.positions)
    if len(m.known) and not (0 <= m.known[0] and m.known[-1] < count and np.all(np.diff(m.known) > 0)):
        raise InputError(f"known = {m.known.tolist()} must name each microphone of 0 to {count - 1} at most once")
    if m.known_positions.shape != (len(m.known), D):
        raise InputError(f"known_positions of shape {m.known_positions.shape} must be ({len(m.known)}, {D}), metres")
    require_finite("known_positions", m.known_positions)
    if m.search is not None and len(m.search.size) != D:
        raise InputError(f"search_size has {len(m.search.size)} lengths; the positions have {D} coordinates")


def require_measurable(scene: Scene) -> None:
    """Raise InputError for what can be told without simulating: a recording too short, too high a band."""
    from .spectrum import check_band

    source, sensing = scene.source, scene.measurement
    check_band(source.duration, source.sample_rate, sensing.highest, sensing.resolution)


def measure(scene: Scene, recordings: np.ndarray | None = None, progress=None) -> Measurement:
    """What the microphones of a scene measure: simulation, modes, complex pressures, noise.

    Parameters
    ----------
    scene : Scene
    recordings : (N, T) float64, as `fdcal.fdtd.simulate` returns them; simulated unless given
    progress : callable(float) or None, told the fraction done of the simulation

    Returns
    -------
    Measurement of every mode picked, with the truth, the known microphones and the search domain. Its wavenumbers are
    complex where the room rings (see `fdcal.spectrum`). `noise_power` is zero without noise.

    Raises InputError for whatever the scene does not allow.
    """
    from . import spectrum  # the signal library, which reading a measurement does without

    require_measurable(scene)
    positions = positions_of(scene)
    if recordings is None:
        from .fdtd import simulate

        recordings = simulate(scene.room, scene.source, positions, progress)
    fs, c, sensing = scene.source.sample_rate, scene.room.sound_speed, scene.measurement
    band = sensing.lowest, sensing.highest
    frequencies = spectrum.pick_modes(recordings, fs, *band, sensing.prominence_db, sensing.resolution)
    s = spectrum.window_rate(recordings, fs)
    wavenumbers = spectrum.wavenumber_continuous(frequencies, s, c)
    if sensing.wavenumber == "discrete":
        wavenumbers = spectrum.wavenumber_discrete(frequencies, s, c, scene.room.cell, fs)
    clean = spectrum.transform(recordings, fs, s, frequencies)
    noise_power = np.mean(np.abs(clean) ** 2, axis=1) * 10 ** (-sensing.snr_db / 10)
    rng = np.random.default_rng([scene.seed, 1])
    noise = rng.normal(scale=math.sqrt(0.5), size=(2, *clean.shape))  # of unit power, whatever the SNR
    return Measurement(
        frequencies=frequencies,
        pressures=clean + np.sqrt(noise_power)[:, None] * (noise[0] + 1j * noise[1]),
        sound_speed=c,
        wavenumbers=wavenumbers,
        noise_power=noise_power,
        positions=positions,
        known=scene.gauge.indices(len(positions)),
        search=scene.search,
    )
