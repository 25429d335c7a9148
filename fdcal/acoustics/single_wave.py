"""Whether the pressures are those of one wave that passes the array, as without any reflection.

At one frequency a single wave has the same power at every microphone, but for what a near source and the channels'
gains add, which is the same at every frequency. The field of a room has places of high and of low pressure. With q_mn
the power of a channel over its own mean and over that of the frequency, the variance of q over the microphones is near
0 for a single wave and near 1 for a diffuse field. Only frequencies count whose phases spread over the array: below,
the pressure is the same everywhere in any field.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

PROBLEM = "the pressures are those of a single wave that passes the array: there are hardly any reflections"
REMEDY = "record in a room with echoes; without them arrival times give the positions"


@dataclass(frozen=True)
class SingleWaveRules:
    """When a field counts as a single wave.

    Attributes
    ----------
    coherent : power of the mean pressure over the mean power, below which the phases spread over the array
    frequencies : fewest such frequencies
    variance : of the power over the microphones, their median; of a room's field it is 0.2 and more
    """

    coherent: float = 0.5
    frequencies: int = 5
    variance: float = 0.06


RULES = SingleWaveRules()


def is_single_wave(pressures) -> bool:
    """Return whether one wave alone explains the pressures.

    Parameters
    ----------
    pressures : (M, N) complex128

    Examples
    --------
    >>> x, k = np.random.default_rng(0).uniform(size=(20, 2)), np.linspace(1, 8, 30)
    >>> is_single_wave(np.exp(-1j * k[:, None] * x[:, 0])), is_single_wave(np.cos(k[:, None] * x[:, 0]))
    (True, False)
    """
    p = np.asarray(pressures)
    p = p / np.sqrt(np.mean(np.abs(p) ** 2, axis=1))[:, None]
    own = np.mean(np.abs(p) ** 2, axis=0)
    p = p / np.sqrt(np.maximum(own, 1e-12 * own.max()))
    mean = np.mean(np.abs(p) ** 2, axis=1)
    spread = np.abs(p.mean(axis=1)) ** 2 < RULES.coherent * mean
    if np.sum(spread) < RULES.frequencies:
        return False
    power = np.abs(p[spread]) ** 2 / mean[spread, None]
    return bool(np.median(np.var(power, axis=1)) < RULES.variance)
