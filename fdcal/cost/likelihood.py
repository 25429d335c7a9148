"""The Gaussian likelihood of the pressures: a cost that does not lie in noise.

With the coefficients of the field isotropic Gaussian (a diffuse field) and noise added, the pressures of mode m have
the covariance

    C_m = s_m kappa(k_m |x_i - x_j|) + v_m I,     kappa = J_0 in 2-D, sin(z) / z in 3-D,
    cost(x) = sum_m [ log det (C_m / v_m) + p_m^H C_m^-1 p_m ]

    s, v      power of the field and of the noise, one each a mode
    kappa     correlation of a diffuse field, the limit of W W^H as the order grows (Graf)
    u         C^-1 p

No centre, no order, no truncation; translation, rotation and mirror leave it unchanged. It is Eq. 7 with a Tikhonov
weight v / s, divided by v, plus the log-determinant, without which microphones flee outward: far away the kernel tends
to the identity and explains anything. kappa takes the real part of the wavenumber: J_0 of a complex one is no
covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg.blas import dtrmm
from scipy.linalg.lapack import dtrtri
from scipy.optimize import minimize, minimize_scalar
from scipy.special import j0

from ..model.power import mode_power
from ..model.validation import frozen_array

FLOOR = 1e-3  # least power of the field as a part of the pressures' power
LEAST_NOISE = 1e-6  # least noise, likewise; the real kernel leaves that much of a windowed field unexplained
LEAST_NEAR_NOISE = 1e-10  # with complex wavenumbers and near sources, which explain it
BLOCK = 2_000_000  # numbers of a microphone and a candidate, of each mode at work, that are in memory at once
DIFFUSE_ENOUGH = {2: 1e-5, 3: 2e-6}  # noise's share of the power: with less, a near source and damping count
STRAINED = 1e-8, 3.0  # least noise to judge by, and `Unexplained.strain` above which positions are not believed


@dataclass(frozen=True)
class DiffuseField:
    """What is supposed of the sound field and the noise.

    Attributes
    ----------
    wavenumbers : (M,) float64, rad/m; or complex128, and then C is s W W^H + v I of the dictionary about the centre
        of mass, which the kernel is not
    power : (M,) float64, s, in the unit of abs(pressures)**2
    noise : (M,) float64, v, in the same unit
    dimension : 2 or 3, of the sound field
    log_det : whether the log-determinant counts; without it the cost is the paper's, Eq. 7, with a Tikhonov weight
    near : whether a source may be close to the array (see `fdcal.cost.low_rank_covariance`)
    about : (N, D) float64, metres, or None: positions whose centre of mass and extent the two above are about, those
        of the microphones unless given; the gradient takes them as fixed
    prior : (M, Q) float64 or None, power by direction where the field is not diffuse (`fdcal.cost.angular_prior`);
    in 2-D
    """

    wavenumbers: np.ndarray
    power: np.ndarray
    noise: np.ndarray
    dimension: int
    log_det: bool = True
    near: bool = False
    about: np.ndarray | None = None
    prior: np.ndarray | None = None


def diffuse_field(
    pressures, wavenumbers, noise, dimension: int, log_det: bool = True, near: bool = False, about=None
) -> DiffuseField:
    """Field whose power is what the pressures (M, N) have beyond the noise (M,), and never quite zero.

    With `near` the imaginary part of the wavenumbers counts, too, if they have one.
    """
    measured = mode_power(pressures)
    power = np.maximum(measured - noise, FLOOR * measured)
    damped = near and np.any(np.imag(wavenumbers))
    k = frozen_array(wavenumbers, complex) if damped else frozen_array(np.real(wavenumbers), float)
    fixed = frozen_array(power, float), frozen_array(noise, float), dimension, log_det, near
    return DiffuseField(k, *fixed, None if about is None else frozen_array(about, float))


def kernel(z: np.ndarray, dimension: int) -> np.ndarray:
    """kappa(z): J_0 in 2-D, sin(z) / z in 3-D; z not negative."""
    if dimension == 2:
        return j0(z)
    from ..acoustics.sinc import sinc  # compiled code is loaded with the first step

    return sinc(z)[0]


def _covariance(positions, field: DiffuseField) -> tuple[np.ndarray, np.ndarray]:
    """C (M, N, N) and k r (M, N, N)."""
    distance = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    z = field.wavenumbers[:, None, None] * distance
    C = field.power[:, None, None] * kernel(z, field.dimension)
    diagonal = np.arange(len(positions))
    C[:, diagonal, diagonal] += field.noise[:, None]
    return C, z


def likelihood(positions, pressures, field: DiffuseField) -> np.ndarray:
    """Cost of every mode, -log of the probability density up to a constant, never negative : (M,) float64.

    positions (N, D) metres, pressures (M, N) complex128. Raises numpy.linalg.LinAlgError where C is singular.
    """
    G = np.linalg.cholesky(_covariance(positions, field)[0])
    y = np.linalg.solve(G, pressures[..., None])[..., 0]
    logarithms = np.log(np.diagonal(G, axis1=1, axis2=2))
    return 2 * logarithms.sum(axis=1) - len(positions) * np.log(field.noise) + np.sum(np.abs(y) ** 2, axis=1)


def newton_terms(positions, pressures, field: DiffuseField) -> tuple[float, np.ndarray, np.ndarray]:
    """Cost summed over the modes, its gradient and its Gauss-Newton curvature.

    positions (N, D) metres, pressures (M, N) complex128. Raises numpy.linalg.LinAlgError where C is singular.

    Returns
    -------
    cost : float; of a projection (see `DiffuseField`) sum_m p^H P p, Eq. 7 with a Tikhonov weight v / s
    gradient : (N, D) float64, 1/m; exact
    curvature : (N, D, N, D) float64, 1/m^2; H_ia,jb = 2 Re sum_m conj(g_mia) C^-1_mij g_mjb, g_a = D_a u
    """
    return _terms(positions, pressures, field, 2)


def total(positions, pressures, field: DiffuseField) -> float:
    """The cost of `newton_terms` alone."""
    return _terms(positions, pressures, field, 0)[0]


def slopes(positions, pressures, field: DiffuseField) -> np.ndarray:
    """The gradient of `newton_terms` of every mode alone : (M, N, D) float64, 1/m."""
    found = []
    for m in range(len(pressures)):
        one = replace(field, **{k: getattr(field, k)[m : m + 1] for k in ("wavenumbers", "power", "noise")})
        one = one if field.prior is None else replace(one, prior=field.prior[m : m + 1])
        found.append(_terms(positions, pressures[m : m + 1], one, 1)[1])
    return np.array(found)


def _terms(positions, pressures, field: DiffuseField, derivatives: int):
    """Through the expansion in two dimensions and for complex wavenumbers; through the kernel in three."""
    from .angular_prior import learned_terms
    from .dense_covariance import dense_terms  # compiled code is loaded with the first step
    from .low_rank_covariance import expansion_terms

    k, s, v = field.wavenumbers, field.power, field.noise
    if field.prior is not None:
        return learned_terms(positions, pressures, k, s, v, field.prior, field.log_det, derivatives)
    if field.dimension == 2 or field.near or np.iscomplexobj(k):
        rest = field.dimension, field.log_det, field.near, field.about, derivatives
        return expansion_terms(positions, pressures, k, s, v, *rest)
    return dense_terms(positions, pressures, k, s, v, field.log_det, derivatives)


def likelihood_landscape(positions, n: int, candidates, pressures, field: DiffuseField) -> np.ndarray:
    """Cost of every mode with microphone `n` at each candidate (C, D), metres, the others held : (M, C) float64."""
    return likelihood_landscapes(positions, [n], candidates, pressures, field)[:, 0]


def likelihood_landscapes(positions, chosen, candidates, pressures, field: DiffuseField) -> np.ndarray:
    """The same of several microphones, the others held each time : (M, len(chosen), C) float64.

    With K = C^-1, u = K p and c_j = s kappa(k |x_j - x|), j = 1..N, leaving microphone n out takes (K c)_n^2 / K_nn off
    c^T K c, and (K c)_n u_n / K_nn off c^T u: its own place drops out, and one product K c serves all of them. The cost
    at x is log det (C_-n / v) + p_-n^H C_-n^-1 p_-n + log (V / v) + |p_n - q|^2 / V, V = s + v less the first, q the
    second.
    """
    from ..acoustics.compiled import at_once  # compiled code is loaded with the first step

    C, _ = _covariance(positions, field)
    chosen, N = np.asarray(chosen), len(positions)
    leaving = at_once(lambda m: _leaving_out(C[m], pressures[m], chosen, field.noise[m]), range(len(pressures)))
    costs = []
    for block in np.array_split(candidates, -(-N * len(candidates) // BLOCK)):
        distance = np.linalg.norm(positions[:, None] - block[None], axis=-1)

        def of_mode(m: int, distance=distance) -> np.ndarray:
            s, (X, rows, u, d, base) = field.power[m], leaving[m]
            c = s * kernel(field.wavenumbers[m] * distance, field.dimension)
            along = rows @ c
            missed = pressures[m, chosen, None] - (u.real @ c + 1j * (u.imag @ c)) + along * (u[chosen] / d)[:, None]
            Xc = dtrmm(1.0, X, c.T, side=1, lower=1, trans_a=1, overwrite_b=1)  # transposed; c is no more
            V = s + field.noise[m] - np.einsum("cn,cn->c", Xc, Xc) + along**2 / d[:, None]
            return base[:, None] + np.log(V) + np.abs(missed) ** 2 / V

        costs.append(at_once(of_mode, range(len(pressures))))
    return np.concatenate(costs, axis=2)


def _leaving_out(C, p, chosen, noise: float) -> tuple[np.ndarray, ...]:
    """Of one mode: X with C^-1 = X^T X, rows `chosen` of C^-1, C^-1 p, their diagonal, and the cost of the others."""
    G = np.linalg.cholesky(C)
    X = dtrtri(G, lower=1)[0]
    y, rows = X @ p, X[:, chosen].T @ X
    u, d = X.T @ y, rows[np.arange(len(chosen)), chosen]
    base = 2 * np.log(np.diagonal(G)).sum() + np.log(d) - len(C) * np.log(noise)
    return X, rows, u, d, base + np.sum(np.abs(y) ** 2) - np.abs(u[chosen]) ** 2 / d


def left_out(positions, pressures, field: DiffuseField) -> np.ndarray:
    """How well each microphone is predicted by the others: mean over the modes of |error|^2 / its variance : (N,).

    About 1 where the model holds. Leaving microphone n out, the error is u_n / (C^-1)_nn, its variance
    1 / (C^-1)_nn.
    """
    u, d = explained(positions, pressures, field)
    return np.mean(np.abs(u) ** 2 / d, axis=0)


def explained(positions, pressures, field: DiffuseField) -> tuple[np.ndarray, np.ndarray]:
    """C^-1 p (M, N) complex128 and the diagonal of C^-1 (M, N) float64, of the real kernel."""
    N = len(positions)
    pairs = np.tril_indices(N, -1)
    distance = np.linalg.norm(positions[pairs[0]] - positions[pairs[1]], axis=1)
    u, d, C = np.empty(pressures.shape, complex), np.empty(pressures.shape), np.zeros((N, N))
    for m, (k, s, v) in enumerate(zip(np.real(field.wavenumbers), field.power, field.noise, strict=True)):
        C[pairs] = s * kernel(k * distance, field.dimension)
        np.fill_diagonal(C, s + v)
        X = dtrtri(np.linalg.cholesky(C), lower=1)[0]  # C^-1 = X^T X
        u[m], d[m] = X.T @ (X @ pressures[m]), np.sum(X**2, axis=0)
    return u, d


@dataclass(frozen=True)
class Unexplained:
    """What positions leave unexplained of the pressures.

    Attributes
    ----------
    noise : share of the power of every mode, from LEAST_NOISE (near: LEAST_NEAR_NOISE) to 1/2
    spread : metres, error of the positions beside it, each microphone's for itself; its share grows as k^2
    cost : -log of the probability density, up to a constant that depends on the number of modes and microphones alone
    strain : p^H C^-1 p over the number of pressures with the noise told and no spread; 1 is expected
    dimension : 2 or 3, of the sound field
    """

    noise: float
    spread: float
    cost: float
    strain: float
    dimension: int

    def shares(self, wavenumbers, spread: bool = True) -> np.ndarray:
        """Share of every mode's power (M,): noise and, unless told otherwise, what the spread adds; at most 1/2."""
        more = (np.real(wavenumbers) * self.spread) ** 2 / self.dimension if spread else 0.0
        return np.minimum(self.noise + more, 0.5) + np.zeros(len(wavenumbers))


def unexplained(
    positions, pressures, wavenumbers, dimension: int, near: bool = False, told: float = 0.0
) -> Unexplained:
    """The noise, one share for all modes, and the spread of the positions that make the pressures most likely.

    An error e of a microphone changes its pressure by the gradient of the field there, of power k^2 / dimension: at
    rough positions the high modes are hard to explain and the low ones are not. `near` as of `diffuse_field`; `told` is
    the share of noise that the strain is judged by, at least STRAINED.
    """
    power = mode_power(pressures)
    values, along = _spectra(positions, pressures, wavenumbers, dimension, near)
    along = along / power[:, None]
    slope = np.real(wavenumbers)[:, None] ** 2 / dimension
    least, told = LEAST_NEAR_NOISE if near else LEAST_NOISE, max(told, STRAINED[0])

    def cost(logs) -> float:
        noise, spread = np.exp(logs)
        share = np.clip(noise + slope * spread, least, 0.5)
        spectrum = (1 - share) * values + share
        return float(np.sum(np.log(spectrum) + along / spectrum))

    top = float(slope.max())
    bounds = [(np.log(least), np.log(0.5)), (np.log(least / top), np.log(0.5 / top))]
    grid = [np.linspace(*bound, 7) for bound in bounds]
    start = min(((a, b) for a in grid[0] for b in grid[1]), key=cost)
    best = minimize(cost, start, method="Nelder-Mead", bounds=bounds, options={"xatol": 0.05, "fatol": 0.1})
    noise, variance = np.exp(best.x)
    strain = float(np.mean(along / ((1 - told) * values + told)))
    return Unexplained(float(noise), float(np.sqrt(variance)), float(best.fun), strain, dimension)


def noise_ratio(positions, pressures, wavenumbers, dimension: int) -> float:
    """Share of noise in the power of the pressures, as `unexplained` finds it where the positions have no spread."""
    power = mode_power(pressures)
    values, along = _spectra(positions, pressures, wavenumbers, dimension, False)
    along = along / power[:, None]

    def cost(log_ratio: float) -> float:
        spectrum = (1 - np.exp(log_ratio)) * values + np.exp(log_ratio)
        return float(np.sum(np.log(spectrum) + along / spectrum))

    return float(np.exp(minimize_scalar(cost, bounds=(np.log(LEAST_NOISE), np.log(0.5)), method="bounded").x))


def _spectra(positions, pressures, wavenumbers, dimension: int, near: bool) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues of the kernel and |u^H p|^2 along its eigenvectors : two (M, N) float64 arrays."""
    damped = near and np.any(np.imag(wavenumbers))
    k = np.asarray(wavenumbers) if damped else np.real(wavenumbers)
    if dimension == 2 or near:
        from .low_rank_covariance import expansion_spectra

        pairs = expansion_spectra(positions, pressures, k, dimension, near)
        return np.array([values for values, _ in pairs]), np.array([along for _, along in pairs])
    from ..acoustics.compiled import at_once

    distance = np.linalg.norm(positions[:, None] - positions[None], axis=-1)

    def of_mode(pair) -> tuple[np.ndarray, np.ndarray]:
        values, vectors = np.linalg.eigh(kernel(pair[0] * distance, dimension))
        return np.maximum(values, 0.0), np.abs(vectors.T @ pair[1]) ** 2

    spectra = at_once(of_mode, zip(k, pressures, strict=True))
    return np.array([values for values, _ in spectra]), np.array([along for _, along in spectra])
