"""Measure a scene: simulate its room, pick the modes and read the pressures of its microphones, with noise."""

from __future__ import annotations

import math

import numpy as np

from ..model.arrays import positions_of
from ..model.arrays_3d import positions_3d
from ..model.measurement import Measurement
from ..model.power import mode_power
from ..model.scene import Scene


def require_measurable(scene: Scene) -> None:
    """Raise InputError for what can be told without simulating: a recording too short, too high a band."""
    source, sensing = scene.source, scene.measurement
    if scene.room.dimension == 3:
        from .box_field import require_resolved

        require_resolved(source, sensing)
        return
    from .spectrum import check_band

    check_band(source.duration, source.sample_rate, sensing.highest, sensing.resolution)


def measure(scene: Scene, recordings: np.ndarray | None = None, progress=None) -> Measurement:
    """What the microphones of a scene measure: simulation or closed form, modes, complex pressures, noise.

    Parameters
    ----------
    scene : Scene
    recordings : (N, T) float64, as `fdcal.acoustics.fdtd.simulate` returns them; simulated unless given. A room of
        three
        dimensions has none: its field is known in closed form (`fdcal.acoustics.box_field`)
    progress : callable(float) or None, told the fraction done of the simulation

    Returns
    -------
    Measurement of every mode picked, with the truth, the known microphones and the search domain. Its wavenumbers are
    complex where the room rings (see `fdcal.acoustics.spectrum`). `noise_power` is zero without noise.

    Raises InputError for whatever the scene does not allow.
    """
    require_measurable(scene)
    positions, dimension = positions_of(scene), scene.room.dimension
    if dimension == 3:
        from .box_field import modal_pressures

        heard = modal_pressures(scene.room, scene.source, positions_3d(scene), scene.measurement, progress)
    else:
        heard = _from_recordings(scene, positions, recordings, progress)
    frequencies, wavenumbers, clean, spectrum = heard
    noise_power = mode_power(clean) * 10 ** (-scene.measurement.snr_db / 10)
    rng = np.random.default_rng([scene.seed, 1])
    noise = rng.normal(scale=math.sqrt(0.5), size=(2, *clean.shape))  # of unit power, whatever the SNR
    wrong = 1 + scene.measurement.sound_speed_error
    return Measurement(
        frequencies=frequencies,
        pressures=clean + np.sqrt(noise_power)[:, None] * (noise[0] + 1j * noise[1]),
        sound_speed=wrong * scene.room.sound_speed,
        dimension=dimension,
        array_dimension=positions.shape[1],
        wavenumbers=wavenumbers / wrong,
        noise_power=noise_power,
        positions=positions,
        known=scene.gauge.indices(len(positions)),
        search=scene.search,
        spectrum=spectrum,
    )


def _from_recordings(scene: Scene, positions, recordings, progress):
    """Frequencies (M,), wavenumbers (M,), pressures (M, N), mean power (2, F); of recordings simulated unless given."""
    from . import spectrum  # the signal library, which reading a measurement does without

    if recordings is None:
        from .fdtd import simulate

        recordings = simulate(scene.room, scene.source, positions, progress)
    fs, c, sensing = scene.source.sample_rate, scene.room.sound_speed, scene.measurement
    first, step, power = spectrum.mean_power(recordings, fs, sensing.lowest, sensing.highest, sensing.resolution)
    frequencies = spectrum.pick_peaks(power, first, step, sensing.prominence_db, sensing.resolution)
    s = spectrum.window_rate(recordings, fs)
    wavenumbers = spectrum.wavenumber_continuous(frequencies, s, c)
    if sensing.wavenumber == "discrete":
        wavenumbers = spectrum.wavenumber_discrete(frequencies, s, c, scene.room.cell, fs)
    seen = np.stack([first + step * np.arange(len(power)), power])
    return frequencies, wavenumbers, spectrum.laplace_transform(recordings, fs, s, frequencies), seen
