"""The dictionary W of a sound field without sources, in two dimensions and in three (Eqs. 2 to 4, 8, 9 of the paper).

    W[n, l]      = J_l(k r_n) exp(j l theta_n)                          in a plane,  l = -L..L
    W[n, (l, m)] = sqrt(4 pi) j_l(k r_n) Y_lm(theta_n, phi_n)           in space,    l = 0..L,  m = -l..l

k               wavenumber, rad/m, may be complex (time sign exp(+j w t))
L               maximum order (Eq. 3): 2 L + 1 functions in a plane (Eq. 8), (L + 1)^2 in space
R               radius of the expansion, metres
r, theta, phi   coordinates of a microphone about the centre of the expansion; in space theta is from the z axis
Y_lm            orthonormal over the sphere, with the sign of Condon and Shortley

Because of the factor sqrt(4 pi), the elements of W W^H for real k tend to sin(k d) / (k d) as L grows, where d is the
distance between two microphones. This is the covariance of a diffuse field of unit power. It does not depend on the
centre of the expansion (addition theorem). For complex k, the limit of W W^H depends on the centre.

Microphones in a plane can also measure a field of three dimensions. In the plane through the centre the functions with
l + m odd are zero, and the (L + 1)(L + 2) / 2 functions with l + m even remain. Positions with two coordinates are
assumed to lie in that plane.

The module also computes W over a search lattice. Its Bessel, sine, cosine and sinc functions are faster than those of
NumPy and SciPy. The recurrences of the Bessel functions run downward (Miller's algorithm), from an order beyond the
argument, where the functions are negligible; an upward recurrence would lose all digits. Sine and cosine are computed
from the tangent or the exponential, for which NumPy has vectorised loops that are up to 15 times as fast.
"""

import functools

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import jv, sph_harm_y_all, spherical_jn

from ..model.settings import Search
from ..model.validation import Complexes, Numbers, Reals

NO_EXTENT = 1e-9  # metres, radius below which all microphones of an array count as being at one position


def max_order(wavenumbers: Numbers | complex, radius: float, offset: int = 0) -> np.ndarray:
    """Return the order L = ceil(Re(k) R) + offset of the expansion (Eq. 3); k in rad/m, R in metres.

    With the paper's offset of 0, the truncation error in the low modes is larger than the effect of moving a microphone
    by a centimetre. An offset of 2 avoids that.
    """
    return np.ceil(np.real(wavenumbers) * radius).astype(np.int64) + offset


def f_max(count: int, radius: float, sound_speed: float, dimension: int = 2, planar: bool = False) -> float:
    """Return the highest frequency that an array can interpolate (Eq. 9).

    At this frequency the expansion of order L = k R has as many functions as there are microphones: 2 L + 1 = N in a
    plane, that is f_max = (N - 1) c / (4 pi R); (L + 1)^2 = N in space; (L + 1)(L + 2) / 2 = N for an array in a plane
    in space (`planar`).

    `count` is N, `radius` R, metres, `sound_speed` c, m/s. The result is in Hz; it is infinite for a radius below 1 nm,
    which occurs when all microphones start at one position.
    """
    if radius < NO_EXTENT:
        return float("inf")
    if dimension == 2:
        order = (count - 1) / 2
    else:
        order = (np.sqrt(8 * count + 1) - 3) / 2 if planar else np.sqrt(count) - 1
    return float(order * sound_speed / (2 * np.pi * radius))


def array_f_max(positions: Reals, sound_speed: float, dimension: int) -> float:
    """Return `f_max`, Hz, of an array (N, D), metres, with R the largest distance of a microphone from the centroid."""
    positions = np.asarray(positions, float)
    radius = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
    return f_max(len(positions), radius, sound_speed, dimension, positions.shape[1] < dimension)


def fourier_bessel(positions: np.ndarray, wavenumber: complex, order: int, centre: ArrayLike) -> np.ndarray:
    """Return W[n, l] = J_l(k r_n) exp(j l theta_n), l = -L..L (Eq. 4) : (N, 2L + 1) complex128.

    positions : (N, 2), metres; wavenumber : k, rad/m, complex for a damped field; centre : (2,), metres
    """
    offsets = np.asarray(positions) - np.asarray(centre)
    r = np.hypot(offsets[:, 0], offsets[:, 1])
    theta = np.arctan2(offsets[:, 1], offsets[:, 0])
    k = wavenumber if np.imag(wavenumber) else np.real(wavenumber)
    l = np.arange(order + 1)  # noqa: E741
    return join_orders(jv(l, k * r[:, None]), np.exp(1j * l * theta[:, None]))


def join_orders(J: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """Return W of orders -L..L from J_l and exp(j l theta) of orders 0..L, each (..., L + 1); J_{-l} = (-1)^l J_l."""
    sign = (-1.0) ** np.arange(J.shape[-1] - 1, 0, -1)
    return np.concatenate([sign * (J * phase.conj())[..., :0:-1], J * phase], axis=-1)


@functools.lru_cache(maxsize=256)
def degrees(order: int, planar: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return degree l and order m of every column of W, each (K,) int64, read-only, in ascending order.

    planar : only the columns with l + m even, since the others vanish in a plane through the centre
    """
    l = np.repeat(np.arange(order + 1), 2 * np.arange(order + 1) + 1)  # noqa: E741
    m = np.arange(len(l)) - l * (l + 1)
    kept = (l + m) % 2 == 0 if planar else slice(None)
    found = l[kept], m[kept]
    for array in found:
        array.setflags(write=False)
    return found


def harmonics(offsets: Reals, order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return degree l (K,) of every column, distance from the centre (N,) and Y_lm (N, K); columns as in `degrees`.

    `offsets` (N, 3), or (N, 2) in a plane through the centre, are relative to the centre, in any unit, which is also
    that of the distance.
    """
    l, m = degrees(order, offsets.shape[1] == 2)  # noqa: E741
    x, y = offsets.T[:2]
    height = offsets[:, 2] if offsets.shape[1] == 3 else np.zeros(len(offsets))
    across = np.hypot(x, y)
    Y = sph_harm_y_all(order, order, np.arctan2(across, height), np.arctan2(y, x))  # (L + 1, 2L + 1, N), m = -1 last
    return l, np.hypot(across, height), Y[l, m].T


def spherical_bessel(positions: Reals, wavenumber: complex, order: int, centre: ArrayLike) -> np.ndarray:
    """Return W[n, (l, m)] = sqrt(4 pi) j_l(k r_n) Y_lm(theta_n, phi_n) : (N, K) complex128, columns as in `degrees`.

    positions : (N, 3), or (N, 2) in a plane through `centre`, metres; wavenumber : k, rad/m, complex for a damped field
    """
    l, distance, Y = harmonics(np.asarray(positions, float) - np.asarray(centre, float), order)  # noqa: E741
    k = wavenumber if np.imag(wavenumber) else np.real(wavenumber)
    return np.sqrt(4 * np.pi) * spherical_jn(np.arange(order + 1), k * distance[:, None])[:, l] * Y


def dictionary(points: Reals, wavenumber: complex, order: int, centre: ArrayLike, dimension: int) -> np.ndarray:
    """Return the rows of W at points (C, D), metres, in a field of 2 or 3 dimensions : (C, K) complex128."""
    functions = fourier_bessel if dimension == 2 else spherical_bessel
    return functions(np.asarray(points, float), complex(wavenumber), order, centre)


SMALL_BESSEL = 0.2  # argument below which the power series is used, because the recurrence would soon overflow
SPARE = 24  # the recurrence begins this many orders above the sum of the argument and the highest order wanted
FIRST, LARGE = 1e-290, 1e250  # first value of the recurrence; size of a value at which all values are scaled down
INTERVAL = 8  # number of orders after which the recurrence looks for values above LARGE again


def bessel(z: Numbers, top: int, spherical: bool = False) -> np.ndarray:
    """Return J_0 to J_top of every argument, or the spherical j_0 to j_top : (top + 1, ...), of the dtype of `z`.

    The recurrence yields the functions times an unknown factor. For J_l the identity J_0 + 2 (J_2 + J_4 + ...) = 1
    determines this factor; for the spherical j_l the closed form of j_0 or j_1 does, whichever is larger.
    """
    z, odd = np.asarray(z), int(spherical)
    size = np.abs(z)
    small = size < SMALL_BESSEL
    safe, start = np.where(small, 1.0, z), top + int(size.max(initial=0.0)) + SPARE  # 1 replaces small arguments
    # f holds the functions times an unknown factor for each argument; f_(l-1) = (2 l + odd) f_l / z - f_(l+1).
    f, inverse = np.empty((start + 1, *z.shape), safe.dtype), 1.0 / safe
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
        zero = np.sin(safe) / safe
        one = (zero - np.cos(safe)) / safe
        f[: top + 1] *= np.where(np.abs(zero) > np.abs(one), zero / f[0], one / f[1])
    else:
        f[: top + 1] /= f[0] + 2 * f[2::2].sum(axis=0)
    # Small arguments: sum the first terms of the power series.
    half = z[small] / 2
    l = np.arange(top + 1)[:, None] + odd / 2  # noqa: E741
    lead = np.ones((top + 1, len(half)), z.dtype)
    np.cumprod(half / l[1:], axis=0, out=lead[1:])
    term, total, square = np.ones_like(lead), np.ones_like(lead), half * half
    for t in range(1, 7):
        term *= -square / (t * (t + l))
        total += term
    f[: top + 1, small] = lead * total
    return f[: top + 1]


SMALL_SINC = 0.02  # argument below which the power series is used; near it both formulas have errors below 1e-12


def cosine_and_sine(z: Reals) -> tuple[np.ndarray, np.ndarray]:
    """Return the cosine and the sine of a float64 array `z`, radians, of any shape; `z` is overwritten."""
    sine = np.multiply(z, 0.5, out=z)
    np.tan(sine, out=sine)
    cosine = sine * sine
    cosine += 1.0
    np.divide(2.0, cosine, out=cosine)
    sine *= cosine
    cosine -= 1.0
    return cosine, sine


def sinc(z: Reals) -> tuple[np.ndarray, np.ndarray]:
    """Return sin(z) / z and its derivative divided by z, for real z >= 0 of any shape : float64."""
    z = np.asarray(z, float)
    half = np.tan(z / 2)
    weight = 2 / (1 + half * half)
    small = z < SMALL_SINC
    safe = np.where(small, 1.0, z)
    kappa = half * weight / safe
    slope = (weight - 1 - kappa) / (safe * safe)
    if small.any():
        square = z[small] ** 2
        kappa[small] = 1 - square / 6 * (1 - square / 20 * (1 - square / 42))
        slope[small] = square / 30 * (1 - square / 28) - 1 / 3
    return kappa, slope


def complex_sinc(square: Complexes) -> tuple[np.ndarray, np.ndarray]:
    """Return sin(z) / z and its derivative divided by z, given complex z^2 of any shape : complex128.

    Both are entire functions of z^2, so that the sign of z has no effect.
    """
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


SPARE_ORDERS = 8  # number of orders computed beyond those in use, so that the latter are exact to rounding errors


class LatticeDictionary:
    """The dictionary of every candidate of a search lattice, from one table of radial functions.

    The centre of the expansion is a point of the lattice. The offsets of the candidates from it are therefore whole
    multiples of the step along each axis, and the squares of their lengths, in steps, are integers. J_l is only needed
    at a few thousand radii, which are the same for all centres.

    `points` (C, 2) float64 are the candidates, metres, x fastest; `shape` is (ny, nx). `row` (d2max + 1,) int32
    maps the squared length of an offset, in steps, to a row of the table, or to -1 if no candidate has this offset.
    """

    def __init__(self, search: Search, wavenumbers: np.ndarray, orders: np.ndarray):
        nx, ny = search.shape
        self.search, self.wavenumbers, self.orders = search, np.asarray(wavenumbers, complex), np.asarray(orders)
        self.shape, self.nearest = (ny, nx), search.nearest
        ix, iy = np.meshgrid(np.arange(nx), np.arange(ny))
        self.steps = np.stack([ix.ravel(), iy.ravel()], axis=1)
        self.points = np.asarray(search.origin) + search.step * self.steps
        self._phases: tuple = None, None
        squared = np.unique(np.add.outer(np.arange(nx) ** 2, np.arange(ny) ** 2))
        self.row = np.full(squared[-1] + 1, -1, dtype=np.int32)
        self.row[squared] = np.arange(len(squared))
        self._radii = search.step * np.sqrt(squared)
        self._radial = np.zeros((len(self.orders), len(squared), int(self.orders.max()) + 1), dtype=complex)
        self._made = np.zeros(len(self.orders), bool)

    def radial(self, modes: slice) -> np.ndarray:
        """Return J_l of some modes at the U radii : (M, U, Lmax + 1) complex128, zero above the order of the mode.

        The table of a mode is computed at its first use, because a solver begins with few modes, and the tables of all
        modes take a second.
        """
        for m in range(len(self.orders))[modes]:
            if not self._made[m]:
                L = int(self.orders[m])
                self._radial[m, :, : L + 1] = bessel(self.wavenumbers[m] * self._radii, L + SPARE_ORDERS)[: L + 1].T
                self._made[m] = True
        return self._radial[modes]

    def index(self, point: ArrayLike) -> int:
        """Return the number of the candidate nearest to `point` (2,), metres."""
        ix, iy = self.search.index(point)
        return int(iy * self.shape[1] + ix)

    def phases(self, centre: Reals) -> tuple[np.ndarray, np.ndarray]:
        """Return exp(j theta) (C,) complex128 and the row in the table (C,) int32 of every candidate about `centre`."""
        index = tuple(self.search.index(centre).tolist())
        cached, phases = self._phases  # those of the last centre, because the centre rarely moves from step to step
        if cached != index:
            offset = self.steps - index
            squared = np.sum(offset**2, axis=1)
            unit = (offset[:, 0] + 1j * offset[:, 1]) / np.sqrt(np.maximum(squared, 1))
            unit[squared == 0] = 1.0
            phases = unit, self.row[squared]
            self._phases = index, phases
        return phases

    def dictionary(self, positions: Reals, centre: Reals, modes: ArrayLike) -> list[np.ndarray]:
        """Return W (N, 2L + 1) of each of `modes` for any positions (N, 2), metres, on the lattice or not."""
        x, y = (np.asarray(positions) - centre).T
        distance, angle, modes = np.hypot(x, y), np.arctan2(y, x), np.asarray(modes)
        W: dict[int, np.ndarray] = {}
        for L in np.unique(self.orders[modes]):  # modes of equal order in one batch
            batch = modes[self.orders[modes] == L]
            J = bessel(np.multiply.outer(self.wavenumbers[batch], distance), L)
            phase = np.exp(1j * np.multiply.outer(angle, np.arange(L + 1)))
            W |= zip(batch.tolist(), join_orders(np.moveaxis(J, 0, -1), phase), strict=True)
        return [W[m] for m in modes.tolist()]
