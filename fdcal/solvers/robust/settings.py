"""Numbers that the solver works with, with their units; all of them may be changed."""

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
    Stage("bend", 2, 30, True, False, 12, 2e-3, 0.5),
    Stage("bend", 3, 30, False, False, 12, 2e-3, 0.5),
    Stage("free", 0, 0, False, False, 5, 1e-3, 2.0),
    Stage("gains", 0, 0, False, True, 10, 1e-4, 0.3),
    Stage("final", 0, 0, False, True, 16, 1e-5, 0.01),
)


@dataclass(frozen=True)
class RobustSettings:
    """Settings of the solver `robust`.

    Attributes
    ----------
    gains : "auto" estimates their spread from the data, "fixed" holds them
    gain_sigma, phase_sigma : nepers and radians, spread of the channels to begin with
    known_sigma : metres, one sigma of a given coordinate to begin with; 0 holds the given positions
    noise_given : whether the noise of the measurement is used
    stride : of the shortest wavelength, the longest move of a microphone in one step
    rounds : stages "gains" at most in one attempt
    attempts : starts tried at most
    modes : number of modes used, the lowest; None for all
    """

    gains: str = "auto"
    gain_sigma: float = 0.02
    phase_sigma: float = 0.02
    known_sigma: float = 0.003
    noise_given: bool = True
    stride: float = 0.125
    rounds: int = 8
    attempts: int = 6
    modes: int | None = None
