"""Bessel functions of all orders of one real or complex argument, compiled.

The recurrences run downward, from orders beyond the argument where the functions are negligible: upward they lose all
digits.
"""

from __future__ import annotations

import numpy as np

from ..acoustics.compiled import compiled


@compiled
def fill_bessel(z, top, J):
    """Fill J (top + 1,) with J_0..J_top of z by Miller's downward recurrence, normalised by J_0 + 2 (J_2 + ...) = 1."""
    if abs(z) < 0.2:
        _bessel_series(z, top, J)
        return
    start = top + int(abs(z)) + 24
    start += start % 2
    above, here, total, twice = 0 * z, 1e-290 + 0 * z, 0 * z, 2 / z
    for l in range(start, 0, -1):  # noqa: E741
        if l <= top:
            J[l] = here
        if l % 2 == 0:
            total += 2 * here
        above, here = here, l * twice * here - above
        if abs(here.real) > 1e250 or abs(here.imag) > 1e250:
            here, above, total = here * 1e-250, above * 1e-250, total * 1e-250
            for i in range(l, top + 1):
                J[i] *= 1e-250
    J[0] = here
    total += here
    for i in range(top + 1):
        J[i] /= total


@compiled
def _bessel_series(z, top, J):
    """Fill J with the first terms of the power series, for small z."""
    half = z / 2
    lead = 1.0 + 0 * z
    for l in range(top + 1):  # noqa: E741
        term, total = lead, lead
        for t in range(1, 7):
            term = -term * half * half / (t * (t + l))
            total = total + term
        J[l] = total
        lead = lead * half / (l + 1)


@compiled
def fill_spherical_bessel(z, k, J, dJ):
    """Fill J (L + 1,) with j_l(z) and dJ with k j_l'(z) by the downward recurrence, normalised by j_0 or j_1."""
    top = len(J) - 1
    if abs(z) < 1e-3:
        lead = 1.0 + 0j
        for l in range(top + 1):  # noqa: E741
            J[l] = lead * (1 - z * z / (2 * (2 * l + 3)))
            dJ[l] = k * (0j if l == 0 else l * lead / z) - k * lead * z * (l + 2) / (2 * (2 * l + 3))
            lead = lead * z / (2 * l + 3)
        return
    start = top + int(abs(z)) + 24
    above, here = 0j, 1e-290 + 0j
    last = 0j
    for l in range(start, -1, -1):  # noqa: E741
        if l <= top:
            J[l] = here
        last = above
        above, here = here, (2 * l + 1) / z * here - above
        if abs(here) > 1e250:
            here, above, last = here * 1e-250, above * 1e-250, last * 1e-250
            for i in range(l, top + 1):
                J[i] *= 1e-250
    zero, one = np.sin(z) / z, (np.sin(z) / z - np.cos(z)) / z
    factor = zero / above if abs(zero) > abs(one) else one / last
    for l in range(top + 1):  # noqa: E741
        J[l] *= factor
    first = J[1] if top >= 1 else one
    dJ[0] = -k * first
    for l in range(1, top + 1):  # noqa: E741
        dJ[l] = k * (J[l - 1] - (l + 1) / z * J[l])
