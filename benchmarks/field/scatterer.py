"""The field that a cylinder inside the array adds, in two dimensions."""

import numpy as np
from scipy.special import hankel2, jv

ORDERS = 6
RING = 64  # points on which the incident field is expanded


def scattered_field(points, centre, radius: float, admittance: float, wavenumbers, incident) -> np.ndarray:
    """Return the field scattered by a cylinder, in free space around it.

    Parameters
    ----------
    points : (N, 2) float64, metres, outside of the cylinder
    centre : (2,) float64, metres
    radius : metres
    admittance : specific, dimensionless
    wavenumbers : (M,) complex128, rad/m
    incident : callable
        Points (P, 2), metres, to the incident pressures (M, P).

    Returns
    -------
    (M, N) complex128
    """
    angle = 2 * np.pi * np.arange(RING) / RING
    ring = 1.2 * max(radius, 0.05)
    around = incident(centre + ring * np.c_[np.cos(angle), np.sin(angle)])
    r, direction = np.linalg.norm(points - centre, axis=1), np.arctan2(*(points - centre).T[::-1])
    total = np.zeros((len(wavenumbers), len(points)), complex)
    for row, pressures, k in zip(total, around, wavenumbers, strict=True):
        for order in range(-ORDERS, ORDERS + 1):
            amplitude = np.mean(pressures * np.exp(-1j * order * angle)) / jv(order, k * ring)
            slope_in = (jv(order - 1, k * radius) - jv(order + 1, k * radius)) / 2
            slope_out = (hankel2(order - 1, k * radius) - hankel2(order + 1, k * radius)) / 2
            numerator = slope_in - 1j * admittance * jv(order, k * radius)
            denominator = slope_out - 1j * admittance * hankel2(order, k * radius)
            reflected = -numerator / denominator
            row += amplitude * reflected * hankel2(order, k * r) * np.exp(1j * order * direction)
    return total
