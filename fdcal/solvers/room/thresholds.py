"""Limits of the solver of known rooms, by what they decide."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class NoiseLimits:
    """Noise's share of the power (dimensionless), unless said otherwise.

    Attributes
    ----------
    guess : where none is reported
    least : where it is reported that there is none
    rough : added until the admittance of the walls is known
    confirmed : times the reported noise: an end that leaves less needs no other attempt
    rejected : times `rough` and noise: an attempt that leaves more ends before the exact stage
    agreed : relative difference of the costs of two attempts that have ended at the same minimum
    """

    guess: float = 1e-4
    least: float = 1e-6
    rough: float = 1e-3
    confirmed: float = 1.5
    rejected: float = 6.0
    agreed: float = 0.02


@dataclass(frozen=True)
class ModelSizes:
    """How large the exact model may become.

    Attributes
    ----------
    response : complex numbers of its response at most
    highest_2d, highest_3d : rad/m, about where its sum ends, by the dimension of the sound field
    """

    response: float = 1e7
    highest_2d: float = 26.0
    highest_3d: float = 19.0

    def highest(self, dimension: int) -> float:
        """Return the wavenumber at which the sum ends, for a sound field of 2 or 3 dimensions."""
        return self.highest_2d if dimension == 2 else self.highest_3d


@dataclass(frozen=True)
class PhaseLimits:
    """When a stage of a phase ends: `settled`, metres that no coordinate moves further by, and `steps` at most."""

    settled: float
    steps: int


PHASES = {
    "diffuse": PhaseLimits(settled=3e-3, steps=12),
    "rough": PhaseLimits(settled=1e-3, steps=12),
    "relocated": PhaseLimits(settled=1e-3, steps=12),
    "exact": PhaseLimits(settled=1e-6, steps=20),
}


@dataclass(frozen=True)
class StageLimits:
    """Stages and bounds.

    Attributes
    ----------
    spreads : lattice steps, errors of the positions assumed in the stages of phase "diffuse"
    sources : places of the source that are tried with each array
    margin : metres, least distance between a microphone and a wall
    admittance : greatest admittance of the walls
    new_damping : damping of the first step of the exact model
    """

    spreads: tuple[float, ...] = (0.3, 0.1, 0.03)
    sources: int = 4
    margin: float = 1e-3
    admittance: float = 0.2
    new_damping: float = 1e-2


NOISE = NoiseLimits()
SIZES = ModelSizes()
STAGES = StageLimits()
