"""What was measured, and what of it a solver may see.

`Measurement` may hold the true positions, for scoring alone; `Problem` cannot.
`fdcal.model.measurement_file` reads and writes it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .gauge import GaugeFrame, align, minimal_frame, position_errors
from .power import mode_power
from .settings import Search
from .validation import InputError, frozen_array, require_array, require_choice, require_positive

ROUNDING = 1e-9  # of a wavenumber: an imaginary part this small may have either sign
FAINTEST, LOUDEST = 1e-100, 1e100  # pressures whose squares, summed, can be used as they are


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
    frame : GaugeFrame or None, the least gauge, with which no microphone is `known`
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
    frame: GaugeFrame | None = None

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
    spectrum : (2, F) float64 or None, Hz, ascending, and the mean power of all microphones there, in any one unit: what
        the frequencies were picked from; to be looked at, no solver sees it

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
    spectrum: np.ndarray | None = None

    def __post_init__(self):
        _fill_defaults(self)
        _check_search(self)
        _check_pressures(self)

    @property
    def count(self) -> int:
        """Number of microphones N."""
        return self.pressures.shape[1]

    @property
    def blind(self) -> bool:
        """Whether no microphone is known, so that nothing fixes where the array is, how it is turned and mirrored."""
        return not len(self.known)

    def aligned_truth(self, positions) -> np.ndarray | None:
        """The true places : (N, D), metres, or None; of a blind array as near to `positions` (N, D) as motion brings.

        Motion is of the whole, and its mirror image counts as well.
        """
        return align(self.positions, positions) if self.blind and self.positions is not None else self.positions

    def errors(self, positions) -> np.ndarray | None:
        """Distance of each of `positions` (N, D), metres, from `aligned_truth` it : (N,) float64, or None."""
        return None if self.positions is None else position_errors(positions, self.aligned_truth(positions))

    def problem(self, weights: str = "unit", known: str = "all") -> Problem:
        """What a solver sees.

        weights : "unit", modes of unit RMS; or "raw", as measured, the paper's
        known : "all" that are known; "minimal", the least gauge of them (`fdcal.model.gauge.GaugeFrame`); or "none"
        """
        require_choice("weights", weights, ("unit", "raw"))
        require_choice("known", known, ("all", "minimal", "none"))
        pressures, noise = self._unit_modes() if weights == "unit" else self._raw_modes()
        everything = known == "all"
        return Problem(
            pressures=frozen_array(pressures, complex),
            noise_power=None if noise is None else frozen_array(noise, float),
            known=self.known if everything else frozen_array([], np.int64),
            known_positions=self.known_positions if everything else frozen_array(self.known_positions[:0], float),
            frame=minimal_frame(self.known, self.known_positions) if known == "minimal" else None,
            **{
                name: getattr(self, name)
                for name in ("wavenumbers", "frequencies", "search", "sound_speed", "dimension", "array_dimension")
            },
        )

    def _unit_modes(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Pressures (M, N) of unit RMS and their noise power (M,), whatever the unit.

        Divided by a power of two first, which rounds nothing and keeps the squares within the range of floats.
        """
        _, exponent = np.frexp(_largest(self.pressures))
        pressures = np.empty_like(self.pressures)
        pressures.real = np.ldexp(self.pressures.real, -exponent[:, None])
        pressures.imag = np.ldexp(self.pressures.imag, -exponent[:, None])
        power = mode_power(pressures)
        noise = None if self.noise_power is None else np.ldexp(self.noise_power, -2 * exponent) / power
        return pressures / np.sqrt(power)[:, None], noise

    def _raw_modes(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Pressures and noise power as measured; InputError where a cost of them would leave the range of floats."""
        largest = _largest(self.pressures)
        for value in (largest.min(), largest.max()):
            if not FAINTEST <= value <= LOUDEST:
                raise InputError(
                    f'pressures of {value:.3g} cannot be squared with solver.weights = "raw"; use another unit, between'
                    f' {FAINTEST:g} and {LOUDEST:g}, or solver.weights = "unit"'
                )
        return self.pressures, self.noise_power


def _largest(pressures: np.ndarray) -> np.ndarray:
    """Largest real or imaginary part of each mode : (M,) float64; the modulus of it could overflow."""
    return np.maximum(np.abs(pressures.real), np.abs(pressures.imag)).max(axis=1)


def _fill_defaults(m: Measurement) -> None:
    """Check kind and shape of every array of `m`, and fill in what follows from the rest."""
    put = lambda name, value: object.__setattr__(m, name, value)  # noqa: E731
    for name, kind in (("sound_speed", "real"), ("dimension", "index")):
        put(name, require_array(name, getattr(m, name), kind, ()).item())
    require_positive("sound_speed", m.sound_speed, "m/s")
    require_choice("dimension", m.dimension, (2, 3))
    own = m.dimension if m.array_dimension is None else m.array_dimension
    put("array_dimension", require_array("array_dimension", own, "index", ()).item())
    require_choice("array_dimension", m.array_dimension, range(2, m.dimension + 1))
    put("frequencies", require_array("frequencies", m.frequencies, "real", (None,), "Hz"))
    modes = len(m.frequencies)
    what = "the transform at each of the frequencies, one column a microphone"
    _name_unfinite(m)
    put("pressures", require_array("pressures", m.pressures, "complex", (modes, None), what))
    given = 2 * np.pi * m.frequencies / m.sound_speed if m.wavenumbers is None else m.wavenumbers
    put("wavenumbers", require_array("wavenumbers", given, "number", (modes,), "rad/m"))
    if m.noise_power is not None:
        put("noise_power", require_array("noise_power", m.noise_power, "real", (modes,), "one for each mode"))
    names = [str(n) for n in range(m.count)] if m.names is None else m.names
    put("names", tuple(require_array("names", names, "text", (None,)).tolist()))
    if not len(m.names) == len(set(m.names)) == m.count:
        raise InputError(f"names must be {m.count} different texts, one for each microphone")
    if m.positions is not None:
        put("positions", require_array("positions", m.positions, "real", (m.count, m.array_dimension), "m"))
    if m.spectrum is not None:
        put("spectrum", require_array("spectrum", m.spectrum, "real", (2, None), "Hz and mean power"))
        if m.spectrum.shape[1] < 2 or np.any(np.diff(m.spectrum[0]) <= 0) or np.any(m.spectrum[1] < 0):
            raise InputError("spectrum must hold ascending frequencies and powers that are not negative; leave it out")
    _fill_known(m)


def _name_unfinite(m: Measurement) -> None:
    """Raise InputError with the name of the first microphone, of a few, that heard NaN or infinity."""
    pressures = np.asarray(m.pressures)
    if pressures.ndim != 2 or pressures.dtype.kind not in "fc":
        return
    bad = np.flatnonzero(~np.all(np.isfinite(pressures), axis=0))
    names = np.arange(pressures.shape[1]) if m.names is None else m.names
    if 0 < len(bad) < pressures.shape[1] and len(names) == pressures.shape[1]:
        name = names[bad[0]]
        raise InputError(
            f'pressures of microphone "{name}" are not all finite numbers; mend them, or leave it out: --exclude {name}'
        )


def _fill_known(m: Measurement) -> None:
    """Known microphones in ascending order, and their positions: those given, or the true ones."""
    known = require_array("known", m.known, "index", (None,), "microphones counted from 0")
    order = np.argsort(known)
    if len(known) and not (known.min() >= 0 and known.max() < m.count and len(set(known.tolist())) == len(known)):
        raise InputError(f"known = {known.tolist()} must name each microphone of 0 to {m.count - 1} at most once")
    if len(known) == m.count:
        raise InputError(
            f"known names all {m.count} microphones, which leaves no microphone to be found; leave some out"
        )
    shape = len(known), m.array_dimension
    places = m.known_positions
    if places is None:
        if len(known) and m.positions is None:
            raise InputError("known names microphones but known_positions is missing; add it, shape (A, D)")
        places = m.positions[known] if len(known) else np.zeros(shape)
    places = require_array("known_positions", places, "real", shape, "m, one row for each of known")
    object.__setattr__(m, "known", frozen_array(known[order], np.int64))
    object.__setattr__(m, "known_positions", frozen_array(places[order], float))


def _check_pressures(m: Measurement) -> None:
    modes, count = m.pressures.shape
    if modes == 0 or count < 2:
        raise InputError(f"pressures of shape {m.pressures.shape} hold too little; give one frequency, two microphones")
    if np.any(m.frequencies <= 0) or np.any(np.diff(m.frequencies) <= 0):
        raise InputError("frequencies must be above zero and ascending, each once; sort them (and the pressures)")
    wrong = np.flatnonzero((m.wavenumbers.real <= 0) | (m.wavenumbers.imag > ROUNDING * m.wavenumbers.real))
    if len(wrong):
        raise InputError(
            f"wavenumbers[{wrong[0]}] = {m.wavenumbers[wrong[0]]:.6g} rad/m must have a real part above zero and, of"
            " a wave that decays, an imaginary part below it: the time sign is exp(+j w t); with the other sign take"
            " the conjugate of wavenumbers and pressures"
        )
    silent = np.flatnonzero(~np.any(m.pressures, axis=0))
    if len(silent):
        raise InputError(
            f'microphone "{m.names[silent[0]]}" has zero pressure at every frequency; leave it out:'
            f" --exclude {m.names[silent[0]]}"
        )
    silent = np.flatnonzero(~np.any(m.pressures, axis=1))
    if len(silent):
        raise InputError(f"pressures at {m.frequencies[silent[0]]:g} Hz are zero at every microphone; leave it out")
    if m.noise_power is not None and np.any(m.noise_power < 0):
        raise InputError(f"noise_power = {m.noise_power.min():g} must not be negative; use 0 for no noise")


def _check_search(m: Measurement) -> None:
    if m.search is not None and len(m.search.size) != m.array_dimension:
        raise InputError(
            f"search_size has {len(m.search.size)} lengths; the positions have {m.array_dimension} coordinates"
        )
