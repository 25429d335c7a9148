"""Eq. 7 of one microphone over a search domain of three dimensions, at any of its points.

    cost_volume  the terms of the cost at a few thousand nodes; the modes are fitted once
    CostVolume   the cost on any lattice: a coarse one at once, a fine one later, a plane of either direction

It is the cost of `fdcal.cost.eq7_maps`, summed over the modes: cost(x) = r0 + |p_n - f(x)|^2 / (1 + h(x)), of which f
and h are computed at Chebyshev nodes (`fdcal.cost.map_nodes`) and interpolated along x, y and z in turn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..model.problem import Problem
from ..model.settings import Search
from ..model.validation import InputError
from .channel_correction import ChannelCorrection, equalised
from .eq7 import LeaveOneOutFit
from .eq7_maps import expansion_of, fits_and_rows, require_carried
from .field_expansion import FieldExpansion
from .map_nodes import interpolation, node_counts, node_points

NEGLIGIBLE = 1e-8  # Chebyshev coefficient that is left out, of the field that a microphone records
BATCH = 6  # modes whose rows are in memory at the same time


@dataclass(frozen=True)
class ModeTerms:
    """What one mode adds to the cost.

    Attributes
    ----------
    r0 : float, squared residual of the other microphones
    p_n : complex, pressure of the microphone
    terms : (3, nz, ny, nx) float64, h and the real and imaginary part of f at the nodes
    """

    r0: float
    p_n: complex
    terms: np.ndarray


@dataclass(frozen=True)
class CostVolume:
    """The cost of moving one microphone through a domain of three dimensions.

    Attributes
    ----------
    domain : Search
    modes : tuple of ModeTerms
    power : float, of the pressures of all these modes, to which the cost is relative
    """

    domain: Search
    modes: tuple[ModeTerms, ...]
    power: float

    def on(self, x, y, z, cancelled: Callable[[], bool] = lambda: False) -> np.ndarray | None:
        """Return the cost at all points (x, y, z) of a lattice, relative to the power.

        Parameters
        ----------
        x, y, z : (nx,), (ny,), (nz,) float64, metres, within the domain
        cancelled : tells whether the values are no longer wanted

        Returns
        -------
        (nz, ny, nx) float64, or None once cancelled
        """
        places = [np.atleast_1d(np.asarray(axis, float)) for axis in (x, y, z)]
        onto: dict[tuple[int, ...], list[np.ndarray]] = {}
        total = np.zeros([len(axis) for axis in places[::-1]])
        for mode in self.modes:
            if cancelled():
                return None
            counts = mode.terms.shape[:0:-1]
            if counts not in onto:
                onto[counts] = [interpolation(self.domain, places[a], a, counts[a]) for a in range(3)]
            x_onto, y_onto, z_onto = onto[counts]
            terms = y_onto @ (mode.terms @ x_onto.T)
            h, re, im = (z_onto @ term.reshape(len(term), -1) for term in terms)
            excess = ((mode.p_n.real - re) ** 2 + (mode.p_n.imag - im) ** 2) / (1.0 + np.maximum(h, 0.0))
            total += mode.r0 + excess.reshape(total.shape)
        return total / self.power


def cost_volume(
    problem: Problem,
    positions,
    n: int,
    modes: Sequence[int],
    order_offset: int,
    channels: ChannelCorrection | None = None,
    cancelled: Callable[[], bool] = lambda: False,
    negligible: float = NEGLIGIBLE,
) -> CostVolume | None:
    """Return the cost of moving microphone `n` through the search domain, the others at `positions`.

    Parameters
    ----------
    problem : Problem, of an array in three dimensions
    positions : (N, 3) float64, metres
    n : int, microphone
    modes : (P,) int, counted from 1
    order_offset : added to ceil(k R) in the order of every mode
    channels : gains and noise that the solver estimates; None for the pressures as recorded
    cancelled : tells whether the volume is no longer wanted
    negligible : Chebyshev coefficient that is left out; a larger one makes a volume sooner

    Returns
    -------
    CostVolume, or None once cancelled

    Raises
    ------
    InputError
        The array is not in three dimensions, there is no search domain, or a mode has too many functions for the
        microphones at this order.
    """
    require_carried(problem, modes, order_offset)
    domain, x = problem.search, np.asarray(positions, float)
    if domain is None or len(domain.origin) != 3 or x.shape[1] != 3:
        raise InputError("the array is in a plane", "use a map of two dimensions", key="dimension", value=x.shape[1])
    expansion, chosen = expansion_of(problem, order_offset), np.asarray(modes) - 1
    numbers = np.searchsorted(expansion.carried.modes, chosen)
    counts = [node_counts(domain, k, 3, negligible) for k in np.real(problem.wavenumbers[chosen]).tolist()]
    pressures, scale = equalised(problem.pressures, channels)
    found: list[ModeTerms] = []
    for shape in sorted(set(counts)):
        points = node_points(domain, shape)
        alike = numbers[[count == shape for count in counts]]
        for group in _batches(expansion, alike):
            if cancelled():
                return None
            fits, rows = fits_and_rows(pressures, scale, expansion, x, n, points, group)
            found += [_terms(fit, w, shape) for fit, w in zip(fits, rows, strict=True)]
    return CostVolume(domain, tuple(found), float(np.sum(np.abs(pressures[chosen]) ** 2)))


def _batches(expansion: FieldExpansion, numbers: np.ndarray) -> list[np.ndarray]:
    """Modes of one order, BATCH of them at most."""
    groups = expansion.groups(numbers)
    return [group[i : i + BATCH] for group in groups for i in range(0, len(group), BATCH)]


def _terms(fit: LeaveOneOutFit, rows: np.ndarray, counts: tuple[int, ...]) -> ModeTerms:
    """Return what one mode adds, from its rows (C, K) at the nodes."""
    product = rows @ np.column_stack([fit.Z, fit.alpha])
    f, parts = product[:, -1], np.ascontiguousarray(product[:, :-1]).view(float)
    terms = np.stack([np.einsum("ij,ij->i", parts, parts), np.real(f), np.imag(f)])
    return ModeTerms(fit.r0, fit.p_n, terms.reshape(3, *counts[::-1]))
