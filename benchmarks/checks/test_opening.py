"""The film of the opening equals what its scene gives now: `docs/opening.py` wrote it with this version."""

import base64
import json
import re

import numpy as np

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.cost.eq7 import ORDER_OFFSET
from fdcal.cost.maps import interpolate, map_minima, partial_sums
from fdcal.graphics.heatmap import WHOLE, colour_limits, normalise
from fdcal.model.measurement import load_measurement
from fdcal.model.scene import load_scene
from fdcal.viewer import opening

ROUNDED = 6e-4  # metres, of the places in the film


def test_the_files_equal_what_the_scene_gives():
    film = json.loads(re.search(r'json">(.*?)</script>', opening.film_html())[1])
    n, maps = film["n"], np.frombuffer(base64.b64decode(film["levels"]), np.uint8).astype(float)
    scene = load_scene(opening.SCENE)
    measurement, shipped = cached_measurement(scene), load_measurement(opening.MEASUREMENT)
    for name in ("frequencies", "pressures", "wavenumbers", "positions", "known"):
        np.testing.assert_allclose(getattr(shipped, name), getattr(measurement, name), rtol=1e-9, err_msg=name)
    problem, solver = measurement.problem(), solvers.load(scene.solver.name)
    state = solver.init(problem, solvers.with_mode_count(problem, scene.solver), scene.seed)
    modes, counts = tuple(range(opening.MODE, 0, -1)), film["summed"]
    sums = partial_sums(problem, solver, state, opening.MICROPHONE, modes, ORDER_OFFSET, counts=counts)
    parts = film["scale"], film["shown"], film["minima"]
    for one, levels, scale, shown, marked in zip(sums, maps.reshape(-1, n, n), *parts, strict=True):
        np.testing.assert_allclose(scale, colour_limits(one.cost, True, WHOLE), rtol=1e-3)
        limits = np.array(colour_limits(one.cost, True))
        np.testing.assert_allclose(shown, normalise(limits, *scale, True), atol=1e-3)
        np.testing.assert_allclose(levels, 255 * normalise(one.cost, *scale, True)[::2, ::2], atol=0.6)
        found = map_minima(
            problem, solver, state, opening.MICROPHONE, one.modes, ORDER_OFFSET, one.cost, problem.search
        )
        np.testing.assert_allclose(marked["lowest"], found.lowest, atol=ROUNDED)
        np.testing.assert_allclose(
            np.reshape(marked["others"], (-1, 2)), np.reshape(found.others, (-1, 2)), atol=ROUNDED
        )
        last = one
    heights = [interpolate(10 * np.log10(last.cost), problem.search, place) for place in film["path"]]
    assert np.all(np.diff(heights) < 0.1), "the microphone rolls downhill"
    np.testing.assert_allclose(film["path"][-1], film["minima"][-1]["lowest"][0])
    np.testing.assert_allclose(film["path"][-1], measurement.positions[opening.MICROPHONE], atol=problem.search.step)
    np.testing.assert_allclose(film["known"], measurement.known_positions, atol=ROUNDED)
    assert opening.MEASUREMENT.stat().st_size < 200_000 and opening.FILM.stat().st_size < 65_000
