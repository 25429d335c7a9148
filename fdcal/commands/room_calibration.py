"""What `fdcal calibrate --room` asks of a measurement, and what it writes and tells beyond other solvers.

The result has, beside the usual keys, `room` (D,), metres; `symmetries`, a list of `map`, such as "(6 - x, y)", and
`positions` (N, D), every array that the pressures cannot tell from the one found, itself first; `source` (D,), metres;
`admittance`, real and imaginary part, of the walls.
"""

from __future__ import annotations

import numpy as np

from ..model.measurement import Measurement
from ..model.power import mode_power
from ..model.scene import SolverSettings
from ..model.validation import InputError


def check(measurement: Measurement, settings: SolverSettings) -> None:
    """Raise InputError for a room that is smaller than the array, where the measurement tells positions."""
    if measurement.positions is None or settings.room is None or len(settings.room) != measurement.array_dimension:
        return
    apart = np.linalg.norm(measurement.positions[:, None] - measurement.positions, axis=-1)
    extent, diagonal = float(apart.max()), float(np.linalg.norm(settings.room))
    if extent > diagonal:
        text = "x".join(f"{length:g}" for length in settings.room)
        raise InputError(
            f"--room {text}: smaller than the array, whose microphones are up to {extent:.3g} m apart; give metres"
        )


def trusted(given, problem, state) -> tuple[np.ndarray, object, dict]:
    """Positions, problem, and the keys of the verdict and of the room."""
    from ..assessment.cross_validation import report_of  # these bring the compiler, which other commands do without
    from ..assessment.room_verdict import judge

    found = judge(problem, state, given.measurement.names)
    p = problem.pressures[state.modes]
    p = p / np.sqrt(mode_power(p)[:, None])
    heard, verdict, positions = report_of(p, found.left_out), found.verdict, np.asarray(state.positions)
    keys = {
        "uncertainty_m": verdict.uncertainty.tolist(),
        "residual_to_noise": verdict.residual_to_noise,
        "verdict": verdict.code,
        "verdict_text": verdict.text,
        "left_out_db": heard.whole,
        "left_out_microphones_db": heard.microphones.tolist(),
        "left_out_frequencies_db": heard.modes.tolist(),
        "room": list(map(float, given.settings.room)),
        "symmetries": [{"map": str(image), "positions": image.of(positions).tolist()} for image in found.images],
        "source": found.source.tolist(),
        "admittance": [found.admittance.real, found.admittance.imag],
    }
    return positions, problem, keys


def lines(result: dict) -> list[str]:
    """What the summary tells of a known room; nothing without one."""
    if "symmetries" not in result:
        return []
    size, place = (" x ".join(f"{x:.4g}" for x in result["room"])), ", ".join(f"{x:.2f}" for x in result["source"])
    others = ", ".join(image["map"] for image in result["symmetries"][1:])
    return [
        f"room    {size} m; source at ({place}) m, walls of admittance {result['admittance'][0]:.2g}",
        f"mirrors as good as this array: {others}",
    ]
