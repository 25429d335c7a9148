"""Write the files with which the page opens before anything is computed: `python docs/opening.py`.

They are the measurement of the scene of the opening, and its maps (`fdcal.viewer.opening`). Run it again whenever the
simulation, the cost or the rule for local minima changes; tests/viewer/test_opening.py compares both with computation.
"""

from __future__ import annotations

import numpy as np

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.cost.basins import basins_of
from fdcal.cost.descent_path import descent_path
from fdcal.cost.maps import map_minima, partial_sums
from fdcal.cost.reference_cost import ORDER_OFFSET
from fdcal.model.measurement_file import save_measurement
from fdcal.model.scene_file import load_scene
from fdcal.viewer import opening

FIRST = 92  # the mode whose map has most local minima that a finer lattice has, too; lower modes are added to it
SUMMED = (1, 2, 3, 4, 6, 9, 14, 22, 37, 60, 92)


def main() -> None:
    """Write both files."""
    scene = load_scene(opening.SCENE)
    measurement, n = cached_measurement(scene), opening.MICROPHONE
    problem, solver = measurement.problem(), solvers.load(scene.solver.name)
    state = solver.init(problem, solvers.with_mode_count(problem, scene.solver), scene.seed)
    modes = tuple(range(FIRST, 0, -1))
    sums = list(partial_sums(problem, solver, state, n, modes, ORDER_OFFSET, counts=SUMMED))
    costs = np.stack([one.cost for one in sums])
    last, search = costs[-1], problem.search
    minima = [map_minima(problem, solver, state, n, one.modes, ORDER_OFFSET, one.cost, search) for one in sums]
    # it begins in the false minimum of the first map from which the way to the last one is longest
    ways = [descent_path(np.log10(last), search, basins_of(last), place) for place in minima[0].lowest]
    path = max((way for way in ways if way.basin == 0), key=lambda way: len(way.points))
    film = opening.Film(
        modes=np.array(modes), summed=np.array(SUMMED), decibels=10 * np.log10(costs),
        minima=tuple(minima), path=path.points,
    )  # fmt: skip
    with open(opening.MEASUREMENT, "wb") as file:
        save_measurement(measurement, file)
    film.save()
    for file in (opening.MEASUREMENT, opening.MAPS):
        print(f"{file.name}: {file.stat().st_size} bytes")
    print("local minima:", [one.count for one in minima], "from", path.points[0], "to", path.points[-1])


if __name__ == "__main__":
    main()
