"""How large an input may be: beyond these limits a value is taken for a mistake and refused."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Limits of what a scene, a measurement or an option may ask for.

    Attributes
    ----------
    smallest, largest : of any length, time, frequency or number that must be positive, in its own unit
    cells : cells of a simulation; each of its fields takes 8 bytes a cell
    microphones : microphones of an array
    microphones_3d : likewise in a room of three dimensions, whose field is summed at each of them
    field_values : microphones times frequencies of the spectrum of such a room
    pairs : pairs of microphones times modes of a calibration; each takes 16 bytes or less
    phase : largest wavenumber times half the extent of the array in a calibration, radians: the order of its field
    phase_per_microphone : likewise, for each microphone of a large array
    dispersion : largest ratio of a wavenumber to 2 pi f / c, and its inverse the smallest
    seconds : processor time of a calibration with up to `usual_pairs`; in proportion to the pairs beyond
    usual_pairs : pairs of microphones times modes, 64 microphones at 64 frequencies
    candidates : candidate positions of a search; the tables of the solvers take 1 to 2 GB for so many
    coordinate : largest coordinate, metres
    decibels : largest signal-to-noise ratio, and its negative the smallest, dB
    sound_speed_error : largest relative error of the sound speed, dimensionless
    weakest, strongest : pressures whose squares can be summed without leaving the range of float64, any unit
    digits : whole numbers of more digits than this one are not shown
    text : bytes of a file of text, as a scene
    result : bytes of a result file
    unfolded : bytes that a compressed file may unfold to
    """

    smallest: float = 1e-12
    largest: float = 1e12
    cells: int = 20_000_000
    microphones: int = 10_000
    microphones_3d: int = 2_000
    field_values: int = 5_000_000
    pairs: float = 1e8
    phase: float = 100.0
    phase_per_microphone: float = 2.0
    dispersion: float = 10.0
    seconds: float = 45.0
    usual_pairs: float = 64.0**3
    candidates: int = 500_000
    coordinate: float = 1e9
    decibels: float = 300.0
    sound_speed_error: float = 0.5
    weakest: float = 1e-100
    strongest: float = 1e100
    digits: int = 10**30
    text: int = 1_000_000
    result: int = 50_000_000
    unfolded: int = 400_000_000


LIMITS = Limits()
