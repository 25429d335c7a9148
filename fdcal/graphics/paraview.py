"""Maps and microphones for ParaView.

landscape   the cost of moving one microphone, mode by mode and summed: .vti, values at the candidates
cloud       microphones as points: .vtp
"""

from __future__ import annotations

import numpy as np

from ..model.measurement import Measurement
from . import vtk_xml
from .landscape_figure import LandscapePanels

ESTIMATED, TRUE, KNOWN = 0, 1, 2  # `kind` of a point


def landscape(panels: LandscapePanels, height: float = 0.0) -> str:
    """The text of a .vti file; `height` is that of the map, metres."""
    fields = {
        f"mode {m}, {f:.2f} Hz": map_
        for m, f, map_ in zip(panels.modes, panels.frequencies, panels.maps[:-1], strict=True)
    }
    fields["sum"] = panels.maps[-1]
    search = panels.search
    ny, nx = panels.maps.shape[1:]
    return vtk_xml.image((nx, ny, 1), (*search.origin[:2], height), (search.step, search.step, search.step), fields)


def point_cloud(measurement: Measurement, positions, sigma=None, height: float = 0.0) -> str:
    """The text of a .vtp file: estimated, true and known microphones, a line from each true place to the estimate.

    Fields of every point: `kind` (0 estimated, 1 true, 2 known), `microphone` (its number), `name`, `error` (3,),
    metres, from the true place to the estimate, `error_length` and `uncertainty` (one sigma), metres; NaN where not
    known. To see errors as arrows: Threshold by kind 1, Glyph by error without scaling.

    Without any known microphone the true places are moved as a whole to where the estimate is.

    Parameters
    ----------
    positions : (N, D), metres
    sigma : (N,), metres, or None
    height : metres, of an array in a plane
    """
    N, truth, known = measurement.count, measurement.aligned_truth(positions), measurement.known
    everyone = np.arange(N)
    groups = [(ESTIMATED, everyone, positions)]
    groups += [] if truth is None else [(TRUE, everyone, truth)]
    groups += [(KNOWN, known, measurement.known_positions)]
    number = np.concatenate([members for _, members, _ in groups])
    nothing = np.full(N, np.nan)
    apart = np.zeros((N, 3)) if truth is None else _in_space(np.subtract(positions, truth), 0.0)
    length = nothing if truth is None else measurement.errors(positions)
    fields = {
        "kind": np.concatenate([np.full(len(members), kind) for kind, members, _ in groups]),
        "microphone": number,
        "name": np.array(measurement.names)[number],
        "error": apart[number],
        "error_length": length[number],
        "uncertainty": (nothing if sigma is None else np.asarray(sigma, float))[number],
    }
    places = np.concatenate([_in_space(places, height) for _, _, places in groups])
    lines = np.zeros((0, 2)) if truth is None else np.column_stack([everyone + N, everyone])
    return vtk_xml.points(places, lines, fields)


def _in_space(values, height: float) -> np.ndarray:
    """(P, 2) with a third column of `height`; (P, 3) as it is."""
    values = np.asarray(values, float)
    return values if values.shape[1] == 3 else np.column_stack([values, np.full(len(values), height)])
