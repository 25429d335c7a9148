"""What a replay needs to compute the cost of moving any microphone, at any state, from any modes (Eq. 7).

The browser computes the maps (`replay_page/eq7.js`), so that the file holds no map but the pressures, as 16-bit numbers
of each mode and channel, and what a solver estimates of the channels. Only modes that the microphones can carry at the
order of `fdcal.cost.reference_cost` are held; of more than MOST_PRESSURES numbers the highest modes are left out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..cost.expansion import CarriedModes, carried_modes
from ..cost.reference_cost import reference_cost_of
from ..model.problem import Problem
from .heatmap import DECADES, to_rgb

MOST_PRESSURES = 200_000  # complex numbers, 0.8 MB before compression
LEVELS = 32767  # of a real or imaginary part, of the largest of its mode: 96 dB below it


def map_data(problem: Problem) -> tuple[dict, dict[str, np.ndarray]] | None:
    """Return what the maps of a problem need, or None where there is no search domain or no mode is carried.

    Returns `data` search domain, modes (counted from 1), orders and the colours of the scale; `arrays` "wavenumbers"
    (M, 2) rad/m, "pressures" (M, N, 2) int16, and what they are multiplied by: "mode_scale" (M,) and "channel_scale"
    (N,).
    """
    reference_cost = reference_cost_of(problem)
    if reference_cost is None or problem.search is None:
        return None
    carried = carried_modes(problem, reference_cost.order_offset)
    kept = slice(0, max(1, MOST_PRESSURES // problem.pressures.shape[1]))
    modes, search = carried.modes[kept], problem.search
    data = {
        "origin": list(search.origin[:2]),
        "step": search.step,
        "shape": list(search.shape[:2]),
        "modes": (modes + 1).tolist(),
        "orders": carried.orders[kept].tolist(),
        "order_offset": carried.order_offset,
        "left_out": len(carried.modes) - len(modes),
        "dimension": problem.dimension,
        "decades": DECADES,
        "colours": to_rgb(np.arange(256) / 255).ravel().tolist(),
    }
    return data, _arrays(problem, CarriedModes(modes, carried.orders[kept], carried.order_offset))


def _arrays(problem: Problem, carried: CarriedModes) -> dict[str, np.ndarray]:
    pressures, k = problem.pressures[carried.modes], np.asarray(problem.wavenumbers[carried.modes], complex)
    channel = np.sqrt(np.mean(np.abs(pressures) ** 2, axis=0))
    channel[channel == 0] = 1.0
    parts = _parts(pressures) / channel[:, None]
    mode = np.abs(parts).max(axis=(1, 2), initial=0.0)
    mode[mode == 0] = 1.0
    return {
        "wavenumbers": _parts(k),
        "pressures": np.rint(parts / mode[:, None, None] * LEVELS).astype("<i2"),
        "mode_scale": (mode / LEVELS).astype("<f8"),
        "channel_scale": channel.astype("<f8"),
    }


def _parts(values: np.ndarray) -> np.ndarray:
    """Return real and imaginary parts along a new last axis."""
    return np.stack([np.real(values), np.imag(values)], axis=-1)


def channel_arrays(states: Sequence) -> dict[str, np.ndarray]:
    """Return gain (T, N, 2) and noise (T, N) of the channels in every state, where a solver estimates them."""
    found = [state.channels for state in states]
    if all(channels is None for channels in found):
        return {}
    count = len(states[0].positions)
    gains = np.array([np.ones(count) if one is None else one.gains for one in found], complex)
    noise = np.array([np.ones(count) if one is None else one.noise for one in found], float)
    return {"gains": _parts(gains).astype("<f4"), "noise": noise.astype("<f4")}
