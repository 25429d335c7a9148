"""Fields that the model does not contain: their verdict, and that no single channel is blamed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fields import disc, waves, with_noise
from scipy.special import eval_legendre, spherical_jn, spherical_yn

import fdcal
from fdcal.acoustics.coherence import is_single_wave
from fdcal.model.measurement import Measurement

SPEED, MODES, KNOWN = 343.0, 30, np.array([0, 5, 11, 17])


def anechoic(dimension):
    """A monopole 2 m away in free space (in the plane: far enough for the decay of a line source)."""
    x = disc(24) if dimension == 2 else 0.4 * np.random.default_rng(2).uniform(-1, 1, (18, 3))
    f, r = np.linspace(60, 400, 14), np.linalg.norm(x - [1.6, 1.2, 0.0][:dimension], axis=1)
    return x, f, np.exp(-2j * np.pi * np.outer(f, r) / SPEED) / r ** (0.5 if dimension == 2 else 1.0)


def rigid_sphere(count=18, radius=0.1):
    """Total pressure of plane waves on a rigid sphere (Morse and Ingard, Theoretical Acoustics, 8.2)."""
    i = np.arange(count) + 0.5
    z, t = 1 - 2 * i / count, np.pi * (1 + np.sqrt(5)) * i
    u = np.c_[np.sqrt(1 - z**2) * np.cos(t), np.sqrt(1 - z**2) * np.sin(t), z]
    f, rng, rows = np.linspace(150, 2000, 14), np.random.default_rng(3), []
    for k in 2 * np.pi * f / SPEED:
        towards = rng.normal(size=(8, 3))
        cosine = u @ (towards / np.linalg.norm(towards, axis=1)[:, None]).T
        amplitude, p = rng.normal(size=8) + 1j * rng.normal(size=8), np.zeros(count, complex)
        for degree in range(int(k * radius) + 12):
            slope = spherical_jn(degree, k * radius, True) - 1j * spherical_yn(degree, k * radius, True)
            scattered = (2 * degree + 1) * 1j ** (degree - 1) / ((k * radius) ** 2 * slope)
            p += scattered * (eval_legendre(degree, cosine) @ amplitude)
        rows.append(p)
    return radius * u, f, np.array(rows)


def measured(field, snr_db=40.0):
    x, f, p = field
    p, noise = with_noise(p, snr_db, np.random.default_rng(4))
    return Measurement(f, p, SPEED, x.shape[1], positions=x, known=KNOWN, noise_power=noise)


def faults(found):
    return [fault.name for fault in found.channels.faults]


def test_without_reflections_the_field_is_reported_as_a_single_wave():
    measurement = measured(anechoic(3), snr_db=20.0)
    found = fdcal.calibrate(measurement, solver="robust")
    assert found.verdict == "model_mismatch" and "single wave" in found.verdict_text and faults(found) == []
    with pytest.raises(fdcal.InputError, match="hardly any reflections"):
        fdcal.calibrate(replace(measurement, known=np.zeros(0, int), known_positions=None), solver="robust")


def test_bending_waves_of_a_plate_are_a_mismatch_and_not_too_many_frequencies():
    """The sound speed with which the given positions agree is impossible in air."""
    f = np.linspace(40, 400, MODES)
    # The wavenumber grows with the square root of f.
    pressures = waves(disc(24), 2 * np.pi * np.sqrt(200 * f) / SPEED, 8, 1)
    found = fdcal.calibrate(measured((disc(24), f, pressures)), solver="robust")
    assert found.verdict == "model_mismatch" and "sound field" in found.verdict_text


def test_on_a_rigid_sphere_no_channel_is_faulty_and_the_verdict_is_not_good():
    # A rigid sphere measures a diffuse field as a larger open sphere does: the shape is right, the size is not.
    found = fdcal.calibrate(measured(rigid_sphere()), solver="robust")
    assert found.verdict in ("model_mismatch", "known_position", "ambiguous", "scale_undetermined")
    assert faults(found) == []


@pytest.mark.parametrize("count", [2, 3, 8])
def test_several_waves_are_not_reported_as_a_single_one(count):
    f = np.linspace(60, 400, MODES)
    for seed in range(5):
        assert not is_single_wave(waves(disc(24), 2 * np.pi * f / SPEED, count, seed))


def test_an_array_far_below_the_wavelength_is_not_judged():
    p = anechoic(2)[2]
    assert is_single_wave(p) and not is_single_wave(p[:6])
