"""What is assumed of the sound field behind channels with gains and noise of their own, and the terms of the cost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Conditional:
    """A conditional likelihood, which hardly assumes anything of the field (`fdcal.cost.conditional_likelihood`).

    Attributes
    ----------
    power : float, factor on the power of the field in it
    weight : float, of the likelihood of a random field beside it
    damped : whether the imaginary part of the wavenumbers counts in it
    reference : (M, N) or (1, N) complex128, log response of the channels behind which the noise is the one assumed
    """

    power: float
    weight: float
    damped: bool
    reference: np.ndarray


@dataclass(frozen=True)
class ChannelField:
    """What is assumed of the sound field and of the noise.

    Attributes
    ----------
    wavenumbers : (M,) float64 or complex128, rad/m; complex ones take the series, real ones the diffuse kernel
    power, noise : (M,) float64, s and v, in the unit of abs(pressures)**2
    channel_noise : (N,) float64, tau
    dimension : 2 or 3, of the sound field
    near : whether a source may be close to the array; with the series only
    about : (N, D) float64, metres, or None: positions that give the centre of the series, those of the microphones
        unless given; the gradient takes it as fixed
    directions : (M, Q) float64 or None: power by direction, mean 1 (`fdcal.cost.angular_prior`)
    conditional : Conditional or None, for a conditional likelihood beside that of the random field
    """

    wavenumbers: np.ndarray
    power: np.ndarray
    noise: np.ndarray
    channel_noise: np.ndarray
    dimension: int
    near: bool = False
    about: np.ndarray | None = None
    directions: np.ndarray | None = None
    conditional: Conditional | None = None


@dataclass(frozen=True)
class Terms:
    """The cost at one set of parameters, and what follows from the same factorisation.

    Attributes
    ----------
    cost : float
    costs : (M,) float64, of every mode
    gradient : (N, P) float64, by position, log gain, phase and, if wanted, delay and corner; None for the cost alone
    curvature : (N, P, N, P) float64, Gauss-Newton; None for the cost alone
    weighted : (M, N) complex128, u = C^-1 q
    precision : (M, N) float64, d, the diagonal of C^-1
    corrected : (M, N) complex128, q
    slopes : (M, N, P) float64, gradient of every mode; None unless wanted
    """

    cost: float
    costs: np.ndarray
    gradient: np.ndarray | None
    curvature: np.ndarray | None
    weighted: np.ndarray
    precision: np.ndarray
    corrected: np.ndarray
    slopes: np.ndarray | None = None

    def newton(self) -> tuple[np.ndarray, np.ndarray]:
        """Return gradient and curvature. Raises ValueError where the cost alone was computed."""
        if self.gradient is None or self.curvature is None:
            raise ValueError("these terms were computed without derivatives")
        return self.gradient, self.curvature
