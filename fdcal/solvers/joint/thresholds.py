"""Limits of the joint solver, by what they decide."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PhaseLimits:
    """When a stage of a phase ends.

    Attributes
    ----------
    settled : metres, a step that moves no coordinate further is the last
    negligible : fall of -log likelihood that makes a step the last
    """

    settled: float
    negligible: float


PHASES = {
    "deformation": PhaseLimits(settled=2e-3, negligible=1.0),
    "free": PhaseLimits(settled=3e-4, negligible=1.0),
    "refinement": PhaseLimits(settled=2e-5, negligible=1e-3),
    "angular_prior": PhaseLimits(settled=1e-6, negligible=0.3),
}


@dataclass(frozen=True)
class StageLimits:
    """Sizes of stages and steps.

    Attributes
    ----------
    first_modes : modes in use in the first deformation
    steps : steps of one stage at most
    free : stages of phase "free" in one attempt at most
    refinement : stages of phase "refinement" at most, about
    refinement_damping : damping with which a stage near the solution begins; damping slows weakly determined directions
    stride : shortest wavelengths that a coordinate moves in one step at most
    diverged : shortest wavelengths: a microphone that moves further in a late stage has left its basin
    """

    first_modes: int = 28
    steps: int = 60
    free: int = 4
    refinement: int = 4
    refinement_damping: float = 1e-7
    stride: float = 0.125
    diverged: float = 0.5


@dataclass(frozen=True)
class PriorLimits:
    """The angular prior.

    Attributes
    ----------
    least_noise : noise's share of the power from which the prior is used
    updates : stages of phase "angular_prior"
    iterations : iterations of the prior's estimate, more by that number in each stage
    deflation : noise deflation at most: this prior is better than that of a diffuse field
    """

    least_noise: float = 3e-3
    updates: int = 3
    iterations: int = 5
    deflation: float = 3.0


@dataclass(frozen=True)
class NoiseLimits:
    """Decisions about the noise.

    Attributes
    ----------
    believed : times the reported noise: if more is estimated, the reported noise is not believed
    noise_alone : times the estimated noise: with less of noise and position error together, the positions are right
    confirmed : times the reported noise: an end that leaves less needs no other attempt
    negligible : share of the power that need not be explained in any case
    deflated_2d, deflated_3d : noise's share of the power below which less noise is assumed than there is
    deflation : greatest noise deflation
    """

    believed: float = 3.0
    noise_alone: float = 1.05
    confirmed: float = 1.2
    negligible: float = 1e-4
    deflated_2d: float = 0.1
    deflated_3d: float = 0.01
    deflation: float = 10.0

    def deflated(self, dimension: int) -> float:
        """Return the share below which less noise is assumed, for a sound field of 2 or 3 dimensions."""
        return self.deflated_2d if dimension == 2 else self.deflated_3d


STAGES = StageLimits()
PRIOR = PriorLimits()
NOISE_LIMITS = NoiseLimits()
