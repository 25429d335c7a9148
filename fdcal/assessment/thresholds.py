"""The limits beyond which a figure of an assessment becomes a finding."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class VerdictThresholds:
    """Limits of `fdcal.assessment.verdict`; the figures are those of `fdcal.assessment.diagnostics.Diagnostics`.

    Attributes
    ----------
    unpredicted_share : power of an odd channel's leave-one-out error over the channel's power
    unpredicted_to_median : the same over that of the median channel
    unpredicted_to_unpredictable : the same over the share that the others cannot predict there; far out in a sparse
        array that share is large
    unpredictable_share, unpredictable_to_median : share of the variance that the others cannot predict, and the same
        over that of the median channel, of a microphone estimated far from the array
    odd_channels, odd_one_in : more odd channels than this number, and than one in so many, are no single odd channels
    studentised_to_median : mean squared studentised residual over that of the median channel, of many modes
    studentised_modes : M modes raise that limit by the factor 1 + studentised_modes / sqrt(M), for sampling errors
    kernel_share : noise below this share of the power shows the limits of the real kernel, not of the model
    residual_to_noise : reduced chi-square where the noise is given
    unexplained_share : share of the power left unexplained where the measurement is said to be free of noise
    noise_share : noise over the power of the pressures
    sound_speed_least, sound_speed_most : relative errors between which an error counts as one of the sound speed
    sound_speed_sigmas : sigmas
    implied_speed : relative difference of the sound speed that follows from a given distance; 5 % are 30 K in air
    known_shift : metres, shift of a known microphone
    known_sigmas : sigmas, Mahalanobis distance of that shift
    relative_sigma : one sigma of the positions over the root mean square radius of the array
    scale_sigma : one sigma of the array's size, relative
    mirror_sigmas : sigmas of the least certain microphone; known microphones farther than this from a line or plane
        determine the side
    rival_cost : difference of -log probability density below which another array fits as well
    rival_sigmas : sigmas, root mean square distance from which another array counts as different
    rival_distance : the same, relative to the root mean square radius of the array
    """

    unpredicted_share: float = 0.1
    unpredicted_to_median: float = 4.0
    unpredicted_to_unpredictable: float = 3.0
    unpredictable_share: float = 0.5
    unpredictable_to_median: float = 3.0
    odd_channels: int = 2
    odd_one_in: int = 5
    studentised_to_median: float = 3.0
    studentised_modes: float = 3.0
    kernel_share: float = 1e-4
    residual_to_noise: float = 2.0
    unexplained_share: float = 3e-3
    noise_share: float = 0.3
    sound_speed_least: float = 0.01
    sound_speed_most: float = 0.15
    sound_speed_sigmas: float = 4.0
    implied_speed: float = 0.05
    known_shift: float = 0.01
    known_sigmas: float = 5.0
    relative_sigma: float = 0.1
    scale_sigma: float = 0.05
    mirror_sigmas: float = 20.0
    rival_cost: float = 6.0
    rival_sigmas: float = 3.0
    rival_distance: float = 0.01


@dataclass(frozen=True)
class RoomThresholds:
    """Further limits of `fdcal.assessment.room_verdict`.

    Attributes
    ----------
    odd_residual : squared residual of an odd channel over that of the median channel
    odd_microphones : fewest microphones of an array in which a channel can be called odd
    size_error : relative error of a length of the room
    size_sigmas : sigmas of that error
    size_improvement : another size must reduce the squared residual to this share of it
    sigma : metres, one sigma of the positions
    """

    odd_residual: float = 6.0
    odd_microphones: int = 5
    size_error: float = 2e-3
    size_sigmas: float = 5.0
    size_improvement: float = 0.5
    sigma: float = 0.1


LIMITS = VerdictThresholds()
ROOM_LIMITS = RoomThresholds()
