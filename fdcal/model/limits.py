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
    candidates : candidate positions of a search; the tables of the solvers take 1 to 2 GB for so many
    coordinate : largest coordinate, metres
    decibels : largest signal-to-noise ratio, and its negative the smallest, dB
    sound_speed_error : largest relative error of the sound speed, dimensionless
    weakest, strongest : pressures whose squares can be summed without leaving the range of float64, any unit
    """

    smallest: float = 1e-12
    largest: float = 1e12
    cells: int = 20_000_000
    microphones: int = 10_000
    candidates: int = 500_000
    coordinate: float = 1e9
    decibels: float = 300.0
    sound_speed_error: float = 0.5
    weakest: float = 1e-100
    strongest: float = 1e100


LIMITS = Limits()
