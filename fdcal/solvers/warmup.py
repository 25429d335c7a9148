"""Calls of every compiled kernel of the likelihood, on a few microphones, so that it is compiled before it is needed.

The first run on a machine compiles for about ten seconds; later runs read the machine code from disk. What is compiled
depends on the types of the arrays, not on their sizes. A page makes these calls while it simulates: first those that
the start, a step and a map need, then those of the last stages.
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


def warmup_calls(dimension: int, solver: str) -> tuple[list[Callable], list[Callable]]:
    """Return functions without arguments that compile what a solver needs first, and what it needs in its last stages.

    Parameters
    ----------
    dimension : 2 or 3, of the sound field
    solver : name of the solver; one that does not use the likelihood compiles nothing that takes long
    """
    if not load(solver).TRAITS.uses_likelihood:
        return [], []
    x = np.random.default_rng(0).uniform(-0.3, 0.3, (COUNT, dimension))
    waves = frozen_array(np.exp(1j * 3.0 * x[:, 0])[None], complex)  # read-only, as a problem's pressures are
    first = [lambda: _terms(x, waves, dimension), lambda: prominent_minima(x @ x.T, 0.1)]
    last = [lambda: _terms(x, waves, dimension, near_field=True)]
    if dimension == 2:
        last.append(lambda: _terms(x, waves, dimension, prior=frozen_array(np.ones((1, 2 * COUNT)), float)))
    return first, last


def _terms(x, waves, dimension: int, near_field: bool = False, prior: np.ndarray | None = None) -> None:
    """Cost, gradient and noise estimate; with the damped wavenumbers of a recording in the near field."""
    wavenumbers = np.array([3.0 - 0.01j]) if near_field else np.array([3.0])
    field = replace(diffuse_field(waves, wavenumbers, np.array([1e-2]), dimension, near_field=near_field), prior=prior)
    fixed = frozen_array(x, float)
    for positions in (x, fixed):  # two types, if a kernel is given both
        newton_terms(positions, waves, field)
    estimate_noise(fixed, waves, wavenumbers, dimension, near_field)
