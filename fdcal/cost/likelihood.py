"""The Gaussian likelihood of the pressures: a cost that stays unbiased in noise.

The coefficients of the field are isotropic and Gaussian (a diffuse field), and noise is added. The pressures of mode m
then have the covariance

    C_m = s_m kappa(k_m |x_i - x_j|) + v_m I,     kappa = J_0 in 2-D, sin(z) / z in 3-D,
    cost(x) = sum_m [ log det (C_m / v_m) + p_m^H C_m^-1 p_m ]

    s, v      power of the field and of the noise, one value of each per mode
    kappa     spatial correlation of a diffuse field: the limit of W W^H as the order grows (Graf's theorem)
    u         C^-1 p

The cost has no centre, no order and no truncation; translation, rotation and mirror leave it unchanged. It is Eq. 7
with a Tikhonov weight v / s, divided by v, plus the log-determinant. Without the determinant microphones diverge
outward: far away the kernel tends to the identity, which fits any pressures. kappa takes the real part of the
wavenumber, because J_0 of a complex argument is not a covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import j0

from ..acoustics.sinc import sinc
from ..model.power import mode_power
from ..model.validation import frozen_array
from .mode_sums import ModeTerms, summed

LEAST_FIELD_SHARE = 1e-3  # least power of the field over that of the pressures, so that C is never pure noise


@dataclass(frozen=True)
class DiffuseField:
    """The model of the sound field and the noise.

    Attributes
    ----------
    wavenumbers : (M,) float64, rad/m; or complex128, and then C is s W W^H + v I of the dictionary about the centre
        of mass, which differs from the kernel
    power : (M,) float64, s, in the unit of abs(pressures)**2
    noise : (M,) float64, v, in the same unit
    dimension : 2 or 3, of the sound field
    log_det : whether the log-determinant counts; without it the cost is the paper's, Eq. 7, with a Tikhonov weight
    near_field : whether a source may be close to the array (see `fdcal.cost.low_rank_covariance`)
    reference : (N, D) float64, metres, or None: positions that set the centre and the extent of the expansion, in
        place of the microphones' own; the gradient takes both as constant
    prior : (M, Q) float64 or None, power by direction where the field is not diffuse (`fdcal.cost.angular_prior`),
        in 2-D only
    """

    wavenumbers: np.ndarray
    power: np.ndarray
    noise: np.ndarray
    dimension: int
    log_det: bool = True
    near_field: bool = False
    reference: np.ndarray | None = None
    prior: np.ndarray | None = None


def diffuse_field(
    pressures, wavenumbers, noise, dimension: int, log_det: bool = True, near_field: bool = False, reference=None
) -> DiffuseField:
    """Return the model whose field power is that of the pressures less the noise.

    Parameters
    ----------
    pressures : (M, N) complex128
    wavenumbers : (M,) complex128 or float64, rad/m; imaginary parts count with `near_field` only
    noise : (M,) float64, in the unit of abs(pressures)**2
    dimension, log_det, near_field, reference : as of `DiffuseField`

    Returns
    -------
    DiffuseField, its power at least LEAST_FIELD_SHARE of the pressures' power
    """
    measured = mode_power(pressures)
    power = np.maximum(measured - noise, LEAST_FIELD_SHARE * measured)
    damped = near_field and np.any(np.imag(wavenumbers))
    k = frozen_array(wavenumbers, complex) if damped else frozen_array(np.real(wavenumbers), float)
    fixed = frozen_array(power, float), frozen_array(noise, float), dimension, log_det, near_field
    return DiffuseField(k, *fixed, None if reference is None else frozen_array(reference, float))


def kernel(z: np.ndarray, dimension: int) -> np.ndarray:
    """Return kappa(z), the correlation of a diffuse field at distance z / k.

    Parameters
    ----------
    z : float64, any shape, not negative, k r
    dimension : 2 for J_0, 3 for sin(z) / z

    Returns
    -------
    float64, the shape of `z`
    """
    if dimension == 2:
        return j0(z)
    return sinc(z)[0]


def covariances(positions, field: DiffuseField) -> np.ndarray:
    """Return C = s kappa(k r) + v I of every mode.

    Parameters
    ----------
    positions : (N, D) float64, metres

    Returns
    -------
    (M, N, N) float64, in the unit of abs(pressures)**2
    """
    distance = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    z = field.wavenumbers[:, None, None] * distance
    C = field.power[:, None, None] * kernel(z, field.dimension)
    diagonal = np.arange(len(positions))
    C[:, diagonal, diagonal] += field.noise[:, None]
    return C


def likelihood(positions, pressures, field: DiffuseField) -> np.ndarray:
    """Return the cost of every mode: -log of the probability density up to a constant, never negative.

    Parameters
    ----------
    positions : (N, D) float64, metres
    pressures : (M, N) complex128

    Returns
    -------
    (M,) float64

    Raises
    ------
    numpy.linalg.LinAlgError
        C is singular.
    """
    G = np.linalg.cholesky(covariances(positions, field))
    y = np.linalg.solve(G, pressures[..., None])[..., 0]
    logarithms = np.log(np.diagonal(G, axis1=1, axis2=2))
    return 2 * logarithms.sum(axis=1) - len(positions) * np.log(field.noise) + np.sum(np.abs(y) ** 2, axis=1)


def newton_terms(positions, pressures, field: DiffuseField) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the cost summed over the modes, its gradient and its Gauss-Newton matrix.

    Parameters
    ----------
    positions : (N, D) float64, metres
    pressures : (M, N) complex128

    Returns
    -------
    cost : float; without `log_det` sum_m p^H P p, Eq. 7 with a Tikhonov weight v / s
    gradient : (N, D) float64, 1/m; exact
    curvature : (N, D, N, D) float64, 1/m^2; H_ia,jb = 2 Re sum_m conj(g_mia) C^-1_mij g_mjb, g_a = D_a u

    Raises
    ------
    numpy.linalg.LinAlgError
        C is singular, or a position is not finite.
    """
    return summed(_terms(positions, pressures, field, 2), np.shape(positions))


def total_cost(positions, pressures, field: DiffuseField) -> float:
    """Return the cost of `newton_terms` without its derivatives; parameters and errors are the same."""
    return float(_terms(positions, pressures, field, 0).costs.sum())


def mode_gradients(positions, pressures, field: DiffuseField) -> np.ndarray:
    """Return the gradient of the cost of each mode; their sum is the gradient of `newton_terms`.

    Parameters
    ----------
    positions : (N, D) float64, metres
    pressures : (M, N) complex128

    Returns
    -------
    (M, N, D) float64, 1/m
    """
    gradients = _terms(positions, pressures, field, 1).gradients
    if gradients is None:
        raise ValueError("the gradients were not computed")
    return gradients


def _terms(positions, pressures, field: DiffuseField, derivatives: int) -> ModeTerms:
    """Go through the expansion in two dimensions and for complex wavenumbers, through the kernel in three."""
    from .angular_prior import learned_terms
    from .dense_covariance import dense_terms  # the modules of one covariance are loaded with the first step
    from .low_rank_covariance import expansion_terms

    k, s, v = field.wavenumbers, field.power, field.noise
    if field.prior is not None:
        return learned_terms(positions, pressures, k, s, v, field.prior, field.log_det, derivatives)
    if field.dimension == 2 or field.near_field or np.iscomplexobj(k):
        rest = field.dimension, field.log_det, field.near_field, field.reference, derivatives
        return expansion_terms(positions, pressures, k, s, v, *rest)
    return dense_terms(positions, pressures, k, s, v, field.log_det, derivatives)
