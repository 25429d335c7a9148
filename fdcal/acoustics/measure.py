"""Measure a scene: simulate its room, pick the modes and compute the pressures at its microphones, with noise."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ..model.arrays import positions_3d, positions_of
from ..model.measurement import Measurement, load_measurement, save_measurement
from ..model.problem import mode_power
from ..model.scene import MeasuredScene, Scene, response_path
from ..model.settings import DEAD_FRACTION, Faults
from ..model.storage import cache_key, load_cached, load_or_make
from ..model.validation import InputError

if TYPE_CHECKING:  # at run time it would load scipy.fft, which reading a measurement does not need
    from .spectrum import ModalPressures


def require_measurable(scene: Scene) -> None:
    """Raise InputError if the scene's duration or frequency band cannot be simulated."""
    if scene.room.response is not None:
        from .plane_waves import load_sdm_response, require_rendered

        require_rendered(load_sdm_response(response_path(scene.room.response)), scene.measurement)
    elif scene.room.dimension == 3:
        from .box_field import require_affordable

        require_affordable(scene.emitter, scene.measurement, scene.array.number)
    else:
        from .spectrum import check_band

        source, sensing = scene.emitter, scene.measurement
        check_band(source.duration, source.band.sample_rate, sensing.highest, sensing.resolution)


def measure(scene: Scene, recordings: np.ndarray | None = None, progress=None, cached: bool = False) -> Measurement:
    """Return what the microphones of a scene measure: complex pressures of the modes, with noise.

    `recordings` (N, T) of a two-dimensional room are simulated unless they are given; in three dimensions the pressures
    are computed without recordings. `progress` is called with the fraction done. If `cached` is true, recordings are
    read from the cache, or simulated and stored there. The wavenumbers are complex if the sound lasts to the end of the
    recording (see `fdcal.acoustics.spectrum`). Raises InputError for a scene that cannot be simulated, or for
    recordings of a scene whose source has several positions.
    """
    if scene.source is not None and scene.source.positions:
        positions_of(scene)  # raises the error for an impossible source position with its number among all positions
    takes, fields = scene.takes(), []
    if recordings is not None and len(takes) > 1:
        problem = f"the source has {len(takes)} positions, but the recordings belong to one"
        raise InputError(problem, "measure each of scene.takes()", key="source.positions")
    for number, take in enumerate(takes):
        report = None
        if progress is not None:
            report = partial(lambda number, done: progress((number + done) / len(takes)), number)
        if cached:
            require_measurable(take)
        simulated = cached and recordings is None and scene.room.dimension == 2
        fields.append(sound_field(take, cached_recordings(take, report) if simulated else recordings, report))
    return measured(scene, fields)


def sound_field(scene: Scene, recordings: np.ndarray | None = None, progress=None) -> ModalPressures:
    """Return the pressures at the modes that are picked, without noise and faults; parameters as in `measure`.

    The source must have one position. The field only depends on the room, the source, the array and the rules for
    picking modes. Measurements that differ in noise or faults only can therefore use the same field.
    """
    require_measurable(scene)
    room, sensing = scene.room, scene.measurement
    if room.response is not None:
        from . import plane_waves

        response = plane_waves.load_sdm_response(response_path(room.response))
        return plane_waves.modal_pressures(response, positions_3d(scene), sensing, room.sound_speed, progress)
    if room.dimension == 3:
        from .box_field import modal_pressures

        return modal_pressures(room, scene.emitter, positions_3d(scene), sensing, progress)
    from . import spectrum

    if recordings is None:
        from .fdtd import simulate

        recordings = simulate(room, scene.emitter, positions_of(scene), progress)
    fs, c = scene.emitter.band.sample_rate, room.sound_speed
    first, step, power = spectrum.mean_power(recordings, fs, sensing.lowest, sensing.highest, sensing.resolution)
    frequencies = spectrum.pick_peaks(power, first, step, sensing.prominence_db, sensing.resolution)
    s = spectrum.window_rate(recordings, fs)
    k = spectrum.wavenumber_continuous(frequencies, s, c)
    if sensing.wavenumber == "discrete":
        k = spectrum.wavenumber_discrete(frequencies, s, c, room.cell_size, fs)
    pressures = spectrum.laplace_transform(recordings, fs, s, frequencies)
    return spectrum.ModalPressures(frequencies, k, pressures, np.stack([first + step * np.arange(len(power)), power]))


def measured(scene: Scene, fields: Sequence[ModalPressures]) -> Measurement:
    """Return the measurement of a scene from its sound fields, one for each position of the source.

    Noise is drawn for each take; the faults of the channels are the same in all takes.
    """
    positions, takes = positions_of(scene), []
    for number, modes in enumerate(fields):
        take = [number] if number else []  # the first take gets the same noise as a source with one position
        noise, noise_of_dead = (np.random.default_rng([scene.seed, stream, *take]) for stream in (1, 3))
        takes.append(
            draw_measurement(
                modes,
                mode_power(modes.pressures) * 10 ** (-scene.measurement.snr_db / 10),
                noise,
                gains=scene.faults.gains(len(positions), scene.seed),
                dead=scene.faults.dead,
                dead_rng=noise_of_dead,
                sound_speed=scene.room.sound_speed,
                sound_speed_error=scene.measurement.sound_speed_error,
                dimension=scene.room.dimension,
                array_dimension=positions.shape[1],
                positions=positions,
                known=scene.gauge.indices(len(positions)),
                search=scene.search,
            )
        )
    return takes[0] if len(takes) == 1 else Measurement.from_takes(takes)


def draw_measurement(
    modes: ModalPressures,
    noise_power: np.ndarray,
    rng: np.random.Generator,
    *,
    gains: np.ndarray | float = 1.0,
    dead: Sequence[int] = (),
    dead_rng: np.random.Generator | None = None,
    sound_speed: float,
    sound_speed_error: float = 0.0,
    **described: Any,
) -> Measurement:
    """Return the measurement of a sound field, with noise, gains and dead channels.

    This function draws all simulated noise: for scenes, for the studies in `fdcal_bench` and for the benchmarks.

    Parameters
    ----------
    modes : ModalPressures
        The field without noise, M frequencies at N microphones.
    noise_power : (M,) float64
        Mean square of the noise, in the squared unit of the pressures; the noise is independent at every microphone.
    rng : Generator
        Source of the noise.
    gains : (N,) complex128 or float, optional
        Factor of each channel, dimensionless.
    dead : sequence of int, optional
        Channels that record noise with DEAD_FRACTION of the power of the field instead of the field itself.
    dead_rng : Generator, optional
        Source of the noise in dead channels; `rng` unless given.
    sound_speed : float
        True sound speed, m/s.
    sound_speed_error : float, optional
        Relative error of the sound speed and the wavenumbers in the measurement, dimensionless.
    **described
        Other fields of `Measurement`.

    Returns
    -------
    Measurement
    """
    clean, scale = modes.pressures, math.sqrt(0.5)
    noise = rng.normal(scale=scale, size=(2, *clean.shape))  # of unit power, so that the draw is the same at any SNR
    recorded = clean * gains
    if dead := list(dead):
        own = (dead_rng or rng).normal(scale=scale, size=(2, len(clean), len(dead)))
        recorded[:, dead] = np.sqrt(DEAD_FRACTION * mode_power(clean))[:, None] * (own[0] + 1j * own[1])
    factor = 1 + sound_speed_error
    return Measurement(
        frequencies=modes.frequencies,
        pressures=recorded + np.sqrt(noise_power)[:, None] * (noise[0] + 1j * noise[1]),
        sound_speed=factor * sound_speed,
        wavenumbers=modes.wavenumbers / factor,
        noise_power=noise_power,
        spectrum=modes.spectrum,
        **described,
    )


def cached_recordings(scene: Scene, progress=None) -> np.ndarray:
    """Return the recordings (N, T) of a two-dimensional scene with one source position, from the cache if possible."""
    positions = positions_of(scene)
    key = cache_key("recordings", dataclasses.asdict(scene.room), scene.emitter.table(), positions.tolist())

    def make() -> np.ndarray:
        from .fdtd import simulate

        return simulate(scene.room, scene.emitter, positions, progress)

    return load_or_make(f"{key}.npy", make, np.load, np.save)


def cached_measurement(scene: Scene, progress=None) -> Measurement:
    """Return the result of `measure` for the scene, from the cache if it is there, and store it there otherwise.

    The measurement of a `MeasuredScene` is read from its file. Raises InputError as `measure` does, or for such a scene
    without a file.
    """
    if isinstance(scene, MeasuredScene):
        if not scene.file:
            raise InputError(f"{scene.name} is a measurement, which cannot be simulated", "open its file", key="scene")
        return load_measurement(scene.file)
    return load_or_make(
        _measurement_name(scene),
        lambda: measure(scene, None, progress, cached=True),
        load_measurement,
        lambda file, made: save_measurement(made, file),
    )


def load_cached_measurement(scene: Scene) -> Measurement | None:
    """Return the measurement of the scene if it is in the cache, else None."""
    if isinstance(scene, MeasuredScene):
        return cached_measurement(scene)
    return load_cached(_measurement_name(scene), load_measurement)


def _measurement_name(scene: Scene) -> str:
    table = dataclasses.asdict(scene)
    for name in ("name", "title", "solver"):  # these do not affect the measurement
        del table[name]
    table["source"] = scene.source and scene.source.table()
    if scene.faults == Faults():
        del table["faults"]
    if scene.room.response is not None:  # the file may change, and its path does not matter
        table["room"]["response"] = hashlib.sha256(response_path(scene.room.response).read_bytes()).hexdigest()
    return f"{cache_key('measurement with its spectrum', table)}.npz"
