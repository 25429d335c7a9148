"""The numbers of the conditional likelihood in the last row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType


@dataclass(frozen=True)
class ConditionalRules:
    """When and how the last row minimises the conditional likelihood.

    Attributes
    ----------
    power : factor on the power of the field in it
    weight : of the likelihood of a random field beside it; by dimension of the field: a plane field has fewer
        directions, and their power is learned better
    stretch_sigma : one sigma of the least certain stretching of the array, relative, up to which it is minimised
    blind_stretch_sigma : the same without given positions, where nothing else shows that there is no such field
    noise_share : noise as a part of the mean power up to which it is minimised: with more, what the noise does to the
        positions is more than what the room does, and the sharper likelihood is better
    most_products : products M N^3 at most
    """

    power: float = 50.0
    weight: Mapping[int, float] = field(default_factory=lambda: MappingProxyType({2: 0.3, 3: 0.1}))
    stretch_sigma: float = 0.05
    blind_stretch_sigma: float = 0.02
    noise_share: float = 5e-4
    most_products: float = 1e8


CONDITIONAL = ConditionalRules()
