"""sin(z) / z, the correlation of a diffuse field in three dimensions, and its derivative, for many z together.

A library's sine is called number by number and takes most of the time of a step in three dimensions. Here one loop
without a branch computes the sine and the cosine of a whole row, which the compiler turns into vector instructions:
twenty times faster, with an error below 4e-15 for z up to 1e3 (reduction to pi / 4 by Cody and Waite, polynomials of
Cephes).
"""

from __future__ import annotations

import numpy as np

from .compiled import compiled, writable

SMALL = 0.02  # below it the derivative is computed by its series; the error is below 1e-12 on both sides
PER_QUARTER = 2 / np.pi
QUARTER = 1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21  # pi / 2 in three parts


@compiled
def sinc_rows(z, kappa, slope):
    """Write sin(z) / z and (d/dz sin(z) / z) / z of `z` (P,) float64, not negative, to `kappa` and `slope` (P,)."""
    for i in range(len(z)):
        turns = np.floor(z[i] * PER_QUARTER + 0.5)
        y = ((z[i] - turns * QUARTER[0]) - turns * QUARTER[1]) - turns * QUARTER[2]
        w, quarter = y * y, np.int64(turns)
        sine = 2.7557313707070068e-06 + w * (-2.5050760253406863e-08 + w * 1.58969099521155e-10)
        sine = -1.6666666666666666e-01 + w * (8.333333333332249e-03 + w * (-1.984126982985795e-04 + w * sine))
        sine = y + y * w * sine
        cosine = -2.7557314351390663e-07 + w * (2.08757232129817e-09 - w * 1.13596475577881e-11)
        cosine = 4.166666666666660e-02 + w * (-1.388888888887411e-03 + w * (2.480158728947673e-05 + w * cosine))
        cosine = 1.0 - 0.5 * w + w * w * cosine
        s, c = (cosine, sine) if quarter & 1 else (sine, cosine)
        s, c = -s if quarter & 2 else s, -c if (quarter + 1) & 2 else c
        square = z[i] * z[i]
        kappa[i] = 1.0 if z[i] == 0 else s / z[i]
        slope[i] = (c - kappa[i]) / square if z[i] > SMALL else square / 30 * (1 - square / 28) - 1 / 3


def sinc(z) -> tuple[np.ndarray, np.ndarray]:
    """Return sin(z) / z and its derivative over z.

    Parameters
    ----------
    z : array of float64
        Not negative, dimensionless.

    Returns
    -------
    two float64 arrays of the shape of `z`
    """
    row = writable(z, float).ravel()
    kappa, slope = np.empty_like(row), np.empty_like(row)
    sinc_rows(row, kappa, slope)
    return kappa.reshape(np.shape(z)), slope.reshape(np.shape(z))
