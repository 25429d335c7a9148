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

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize_scalar
from scipy.special import j0, j1

from .checks import frozen_array

FLOOR = 1e-3  # least power of the field as a part of the pressures' power
LEAST_NOISE = 1e-6  # least noise, likewise; the real kernel leaves that much of a windowed field unexplained


@dataclass(frozen=True)
class DiffuseField:
    """What is supposed of the sound field and the noise.

    Attributes
    ----------
    wavenumbers : (M,) float64, rad/m, real
    power : (M,) float64, s, in the unit of abs(pressures)**2
    noise : (M,) float64, v, in the same unit
    dimension : 2 or 3, of the sound field
    """

    wavenumbers: np.ndarray
    power: np.ndarray
    noise: np.ndarray
    dimension: int


def diffuse_field(pressures, wavenumbers, noise, dimension: int) -> DiffuseField:
    """Field whose power is what the pressures (M, N) have beyond the noise (M,), and never quite zero."""
    measured = np.mean(np.abs(pressures) ** 2, axis=1)
    power = np.maximum(measured - noise, FLOOR * measured)
    k = np.real(wavenumbers)
    return DiffuseField(frozen_array(k, float), frozen_array(power, float), frozen_array(noise, float), dimension)


def kernel(z: np.ndarray, dimension: int) -> np.ndarray:
    """kappa(z): J_0 in 2-D, sin(z) / z in 3-D."""
    return j0(z) if dimension == 2 else np.sinc(z / np.pi)


def kernel_slope_over_z(z: np.ndarray, dimension: int) -> np.ndarray:
    """kappa'(z) / z, finite at 0."""
    small = np.abs(z) < 1e-4
    safe = np.where(small, 1.0, z)
    if dimension == 2:
        return np.where(small, -0.5 + z**2 / 16, -j1(safe) / safe)
    return np.where(small, -1 / 3 + z**2 / 30, (np.cos(safe) - np.sin(safe) / safe) / safe**2)


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

    Returns
    -------
    cost : float
    gradient : (N, D) float64, 1/m; exact
    curvature : (N, D, N, D) float64, 1/m^2; H_ia,jb = 2 Re sum_m conj(g_mia) C^-1_mij g_mjb, g_a = D_a u
    """
    C, z = _covariance(positions, field)
    inverse = np.linalg.inv(C)
    u = (inverse @ pressures[..., None])[..., 0]
    log_det = np.sum(np.linalg.slogdet(C)[1] - len(positions) * np.log(field.noise))
    cost = float(log_det + np.sum(pressures.conj() * u).real)
    slope = (field.power * field.wavenumbers**2)[:, None, None] * kernel_slope_over_z(z, field.dimension)
    apart = np.moveaxis(positions[:, None] - positions[None], -1, 0)  # (D, N, N)
    products = np.real(u[:, :, None] * u[:, None].conj())
    weight = np.einsum("mij,mij->ij", inverse - products, slope)
    gradient = 2 * np.einsum("ij,aij->ia", weight, apart)
    g = np.stack([((slope * d) @ u[..., None])[..., 0] for d in apart], axis=1)  # (M, D, N)
    return cost, gradient, _curvature(inverse, g)


def _curvature(inverse: np.ndarray, g: np.ndarray) -> np.ndarray:
    """2 Re sum_m conj(g_mai) inverse_mij g_mbj : (N, D, N, D)."""
    _, D, N = g.shape
    parts = np.concatenate([g.real, g.imag])  # Re(conj(a) b) = a.re b.re + a.im b.im
    twice = np.concatenate([inverse, inverse])
    H = np.empty((N, D, N, D))
    for a in range(D):
        rows = parts[:, a, :, None] * twice
        for b in range(D):
            H[:, a, :, b] = 2 * np.einsum("mij,mj->ij", rows, parts[:, b])
    return H


def likelihood_landscape(positions, n: int, candidates, pressures, field: DiffuseField) -> np.ndarray:
    """Cost of every mode with microphone `n` at each candidate (C, D), metres, the others held : (M, C) float64.

    With C_-n = G G^H, y = G^-1 p_-n, c_j = s kappa(k |x_j - x|) and t = G^-1 c, the cost at x is
    log det (C_-n / v) + |y|^2 + log (V / v) + |p_n - t^H y|^2 / V,  V = s + v - |t|^2.
    """
    others = np.arange(len(positions)) != n
    C, _ = _covariance(positions[others], field)
    distance = np.linalg.norm(positions[others][:, None] - candidates[None], axis=-1)
    costs = np.empty((len(pressures), len(candidates)))
    for m, p in enumerate(pressures):
        G = np.linalg.cholesky(C[m])
        y = solve_triangular(G, p[others], lower=True)
        t = solve_triangular(G, field.power[m] * kernel(field.wavenumbers[m] * distance, field.dimension), lower=True)
        V = field.power[m] + field.noise[m] - np.sum(t**2, axis=0)
        base = 2 * np.log(np.diagonal(G)).sum() - len(positions) * np.log(field.noise[m]) + np.sum(np.abs(y) ** 2)
        costs[m] = base + np.log(V) + np.abs(p[n] - y @ t) ** 2 / V
    return costs


def noise_ratio(positions, pressures, wavenumbers, dimension: int) -> float:
    """Share of noise in the power of the pressures that makes them most likely, one for all modes : LEAST_NOISE to 1/2.

    What the positions cannot explain counts as noise too.
    """
    k = np.real(wavenumbers)
    distance = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    values, vectors = np.linalg.eigh(kernel(k[:, None, None] * distance, dimension))
    values = np.maximum(values, 0.0)
    power = np.mean(np.abs(pressures) ** 2, axis=1)[:, None]
    along = np.abs((vectors.swapaxes(1, 2) @ pressures[..., None])[..., 0]) ** 2 / power

    def cost(log_ratio: float) -> float:
        ratio = np.exp(log_ratio)
        spectrum = (1 - ratio) * values + ratio
        return float(np.sum(np.log(spectrum) + along / spectrum))

    best = minimize_scalar(cost, bounds=(np.log(LEAST_NOISE), np.log(0.5)), method="bounded")
    return float(np.exp(best.x))
