"""The schedule of the solver `robust`, and the numbers that decide beside it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Stage:
    """One row of the schedule.

    Attributes
    ----------
    name : of the stage, for display
    degree : of the polynomials by which the array may deform as a whole; 0 lets every microphone move for itself
    modes : at most so many modes, evenly taken; 0 for all
    lowest : with given positions the lowest ones instead: they hold the scale
    gains : whether channel gains are free
    steps : at most
    settled : metres, a stage ends when nothing moves further
    negligible : nats, or when the cost falls by no more
    """

    name: str
    degree: int
    modes: int
    lowest: bool
    gains: bool
    steps: int
    settled: float
    negligible: float


SCHEDULE = (
    Stage("deformation", 2, 30, True, False, 12, 2e-3, 0.5),
    Stage("deformation", 3, 30, False, False, 12, 2e-3, 0.5),
    Stage("free", 0, 0, False, False, 5, 1e-3, 2.0),
    Stage("gains", 0, 0, False, True, 10, 1e-4, 0.3),
    Stage("final", 0, 0, False, True, 16, 1e-5, 0.01),
)


@dataclass(frozen=True)
class Rules:
    """What decides beside the schedule.

    Attributes
    ----------
    gain_sigma : nepers, spread of the channel gains to begin with
    phase_sigma : radians, spread of the channel phases to begin with
    known_sigma : metres, one sigma of a given coordinate to begin with, and at most
    stride : longest move of a microphone in one step, over the shortest wavelength
    rounds : stages "gains" at most in one attempt
    attempts : starts tried at most
    final_rounds : stages "final" at most
    search_modes : modes of a search for other places of outliers
    searches : rounds with such a search
    same_score : nats between the ends of two attempts that are one
    same_place : distance of these ends, over the shortest wavelength
    settled_noise : change of the logarithm of the noise after which a round is the last
    known_outlier : distance of a given position over the median of all of them, or their sigma, that leaves it out
        when the array is moved onto the given positions
    near_gain : part of the residual of the series that the near-field kernel must leave to be taken
    near_deflation : residual of the near-field kernel over the noise that is assumed with it
    """

    gain_sigma: float = 0.02
    phase_sigma: float = 0.02
    known_sigma: float = 0.003
    stride: float = 0.125
    rounds: int = 8
    attempts: int = 6
    final_rounds: int = 6
    search_modes: int = 16
    searches: int = 1
    same_score: float = 30.0
    same_place: float = 0.01
    settled_noise: float = 0.15
    known_outlier: float = 3.0
    near_gain: float = 0.5
    near_deflation: float = 3.0


RULES = Rules()
