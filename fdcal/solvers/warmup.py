"""Every kernel of the joint solver called once, on a few microphones, so that nobody waits for it to be compiled later.

The first run on a machine compiles for some ten seconds, the next ones find the machine code on disk. What compiles
depends on the types of the arrays and not on their sizes. So here is that work in pieces, which a page can have done
beside the simulation, telling how far it is: first those that the start, a step and a map need, then those of the
stages at the end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..cost.likelihood import diffuse_field, newton_terms
from ..cost.noise_model import estimate_noise
from ..cost.watershed import prominent_minima
from ..model.validation import frozen_array
from . import load

COUNT = 5  # microphones, enough for every kernel


def pieces(dimension: int, solver: str) -> tuple[list[Callable], list[Callable]]:
    """Functions without arguments: what a solver needs to begin with, and what it needs in the end.

    dimension : 2 or 3, of the sound field
    solver : the solver's name; one that does not use the likelihood compiles nothing that takes long
    """
    if not load(solver).TRAITS.uses_likelihood:
        return [], []
    x = np.random.default_rng(0).uniform(-0.3, 0.3, (COUNT, dimension))
    waves = frozen_array(np.exp(1j * 3.0 * x[:, 0])[None], complex)  # read-only, as a problem's pressures are
    first = [lambda: _terms(x, waves, dimension), lambda: prominent_minima(x @ x.T, 0.1)]
    last = [lambda: _terms(x, waves, dimension, near=True)]
    if dimension == 2:
        last.append(lambda: _terms(x, waves, dimension, prior=frozen_array(np.ones((1, 2 * COUNT)), float)))
    return first, last


def _terms(x, waves, dimension: int, near: bool = False, prior: np.ndarray | None = None) -> None:
    """Cost, slopes and what is left over; with the damped wavenumbers of a recording where sources may be near."""
    wavenumbers = np.array([3.0 - 0.01j]) if near else np.array([3.0])
    field = replace(diffuse_field(waves, wavenumbers, np.array([1e-2]), dimension, near_field=near), prior=prior)
    fixed = frozen_array(x, float)
    for positions in (x, fixed):  # two types, if a kernel is given both
        newton_terms(positions, waves, field)
    estimate_noise(fixed, waves, wavenumbers, dimension, near)
