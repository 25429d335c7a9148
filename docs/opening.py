"""Write the files with which the page opens before anything is computed: `python docs/opening.py`.

They are the measurement of the scene of the opening, its maps, and the first picture of its film as a part of the
page's HTML (`fdcal.viewer.opening`). Run it again whenever the simulation, the cost, the rule for local minima or the
look of a relief changes; tests/viewer/test_opening.py compares all with computation. `--still` writes the picture
alone.
"""

import base64
import io
import sys

import numpy as np
from PIL import Image

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.cost.basins import basins_of, descent_path
from fdcal.cost.expansion import ORDER_OFFSET
from fdcal.cost.maps import map_minima, partial_sums
from fdcal.model.measurement import save_measurement
from fdcal.model.scene_file import load_scene
from fdcal.viewer import app, opening

FIRST = 92  # the mode whose map has most local minima that a finer lattice has, too; lower modes are added to it
SUMMED = (1, 2, 3, 4, 6, 9, 14, 22, 37, 60, 92)


def main() -> None:
    """Write the files."""
    if "--still" not in sys.argv:
        write_maps()
    write_still()


def write_still() -> None:
    """Write the first picture of the film, light and dark, and its words, as a part of the page's HTML."""
    measurement = opening.opening_request().measurement
    if measurement is None:
        raise ValueError("the opening has a measurement")
    projector, parts = opening.Projector(measurement), []
    for dark in (False, True):
        pixels, file = opening.still(projector, dark), io.BytesIO()
        drawn = np.any(pixels != pixels[0, 0], axis=-1, keepdims=True)  # the page is seen around it
        image = Image.fromarray(np.concatenate([pixels, np.uint8(255) * drawn.astype(np.uint8)], axis=-1))
        image.save(file, "WEBP", quality=opening.STILL_QUALITY, method=6)
        print(f"{'dark' if dark else 'light'}: {image.size[0]} x {image.size[1]} pixels, {len(file.getvalue())} bytes")
        parts.append(f"data:image/webp;base64,{base64.b64encode(file.getvalue()).decode()}")
    light, dark = parts
    app.STILL.write_text(
        f'<div id="fdcal-still" data-words="{projector.film.at(0.0).words}"><picture>'
        f'<source srcset="{dark}" media="(prefers-color-scheme: dark)"><img src="{light}" alt=""></picture></div>\n',
        encoding="utf-8",
    )


def write_maps() -> None:
    """Write the measurement and the maps."""
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
