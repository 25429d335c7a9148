"""Bessel functions of all orders, sine and cosine, and sin(z) / z, of many arguments at once.

The recurrences of the Bessel functions run downward, from orders beyond the argument where the functions are negligible
(Miller): upward they lose all digits. Tangent and exponential take the place of sine and cosine: of them NumPy computes
many values at once, up to 15 times as fast.
"""

import numpy as np

from ..model.types import Complexes, Numbers, Reals

SMALL_BESSEL = 0.2  # below it the power series is used: the recurrence would overflow within a few orders
SPARE = 24  # orders beyond the argument and the highest order wanted, at which the recurrence begins
FIRST, LARGE = 1e-290, 1e250  # the recurrence begins with one and is divided by the other where it has grown beyond it
INTERVAL = 8  # orders between two looks at the size of the values


def bessel(z: Numbers, top: int, spherical: bool = False) -> np.ndarray:
    """Return J_0 to J_top of every argument, or the spherical j_0 to j_top : (top + 1, ...), of the type of `z`.

    J_l is normalised by J_0 + 2 (J_2 + J_4 + ...) = 1, the spherical j_l by j_0 or j_1, whichever is larger.
    """
    z, odd = np.asarray(z), int(spherical)
    size = np.abs(z)
    small = size < SMALL_BESSEL
    apart, start = np.where(small, 1.0, z), top + int(size.max(initial=0.0)) + SPARE
    # Multiples of the functions, another one for each argument: f_(l-1) = (2 l + odd) f_l / z - f_(l+1).
    f, inverse = np.empty((start + 1, *z.shape), apart.dtype), 1.0 / apart
    f[start] = FIRST
    np.multiply(inverse, (2 * start + odd) * FIRST, out=f[start - 1])
    for l in range(start - 1, 0, -1):  # noqa: E741
        below = np.multiply(inverse, 2 * l + odd, out=f[l - 1])
        below *= f[l]
        below -= f[l + 1]
        if l % INTERVAL == 0:
            large = np.abs(below) > LARGE
            if large.any():
                f[l - 1 :] *= np.where(large, 1 / LARGE, 1.0)
    if spherical:
        zero = np.sin(apart) / apart
        one = (zero - np.cos(apart)) / apart
        f[: top + 1] *= np.where(np.abs(zero) > np.abs(one), zero / f[0], one / f[1])
    else:
        f[: top + 1] /= f[0] + 2 * f[2::2].sum(axis=0)
    # The first terms of the power series for small arguments.
    half, l = z[small] / 2, np.arange(top + 1)[:, None] + odd / 2  # noqa: E741
    lead = np.ones((top + 1, len(half)), z.dtype)
    np.cumprod(half / l[1:], axis=0, out=lead[1:])
    term, total, square = np.ones_like(lead), np.ones_like(lead), half * half
    for t in range(1, 7):
        term *= -square / (t * (t + l))
        total += term
    f[: top + 1, small] = lead * total
    return f[: top + 1]


SMALL_SINC = 0.02  # below it the derivative is computed by its series; the error is below 1e-12 on both sides


def cosine_and_sine(z: Reals) -> tuple[np.ndarray, np.ndarray]:
    """Return the cosine and the sine of a float64 array, which is overwritten."""
    sine = np.multiply(z, 0.5, out=z)
    np.tan(sine, out=sine)
    cosine = sine * sine
    cosine += 1.0
    np.divide(2.0, cosine, out=cosine)
    sine *= cosine
    cosine -= 1.0
    return cosine, sine


def sinc(z: Reals) -> tuple[np.ndarray, np.ndarray]:
    """Return sin(z) / z and its derivative over z, of z not negative."""
    z = np.asarray(z, float)
    half = np.tan(z / 2)
    weight = 2 / (1 + half * half)
    small = z < SMALL_SINC
    apart = np.where(small, 1.0, z)
    kappa = half * weight / apart
    slope = (weight - 1 - kappa) / (apart * apart)
    if small.any():
        square = z[small] ** 2
        kappa[small] = 1 - square / 6 * (1 - square / 20 * (1 - square / 42))
        slope[small] = square / 30 * (1 - square / 28) - 1 / 3
    return kappa, slope


def complex_sinc(square: Complexes) -> tuple[np.ndarray, np.ndarray]:
    """Return sin(z) / z and its derivative over z, of the square of a complex z: entire functions of it."""
    w = np.asarray(square, complex)
    small = np.abs(w) < SMALL_SINC**2
    w = np.where(small, 1.0, w)
    z = np.sqrt(w)
    half, growth = np.tan(np.real(z) / 2), np.exp(np.imag(z))
    weight, cosh, sinh = 2 / (1 + half * half), (growth + 1 / growth) / 2, (growth - 1 / growth) / 2
    sine, cosine = half * weight, weight - 1
    kappa, slope = np.empty_like(w), np.empty_like(w)
    kappa.real, kappa.imag = sine * cosh, cosine * sinh
    slope.real, slope.imag = cosine * cosh, -sine * sinh
    kappa /= z
    slope -= kappa
    slope /= w
    if small.any():
        near = np.asarray(square)[small]
        kappa[small] = 1 - near / 6 * (1 - near / 20 * (1 - near / 42))
        slope[small] = near / 30 * (1 - near / 28) - 1 / 3
    return kappa, slope
