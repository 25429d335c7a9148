"""Write the files with which the page opens before anything is computed: `python docs/opening.py`.

They are the measurement of the film's scene, and a part of the page's HTML with the data of the film: maps of the sums
of more and more modes, and the path of the microphone downhill over the last map (`fdcal.viewer.opening`). Run it
again whenever the simulation, the cost, the rule for local minima or the look of a relief changes;
benchmarks/checks/test_opening.py compares the files with a new computation.
"""

import base64
import json

import numpy as np

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.cost.basins import basins_of, descent_path
from fdcal.cost.eq7 import ORDER_OFFSET
from fdcal.cost.maps import map_minima, partial_sums
from fdcal.graphics import camera, heatmap, marks
from fdcal.graphics.picture import compose
from fdcal.graphics.primitives import DARK, LIGHT
from fdcal.model.measurement import save_measurement
from fdcal.model.scene import load_scene
from fdcal.viewer import opening
from fdcal.viewer import scene3d as cameras

# Numbers of modes in the sums. The first mode is the one whose map has the largest number of local minima that also
# exist on a finer lattice; lower modes are added to it.
SUMMED = (1, 2, 3, 4, 6, 9, 14, 22, 37, 60, 92)
EVERY = 2  # every second point of a map, along each axis, is kept
FEW_TIME, ONE_TIME = 10.0, 2.0  # s for which all maps with several minima are shown, and those with one
CHANGE_TIME, ROLL_TIME = 1.2, 1.4  # s: longest transition between two maps; time for which the microphone rolls
NUMBERS = ("No", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine")
ABOUT = "The red microphone's place is unknown: its recording fits where the map is low and dark. Blue ones are known."
FOUND = "The microphone is found"
PURPOSE = "fdcal finds where microphones are, from the resonances of a room."
MARGINS = (24, 24, 24, 128)  # pixels left, bottom, right and top of the map, for the words above it
NEAR = 1e-6  # metres
FILM_MARKS = {
    "true": "microphones/true", "known": "microphones/known", "lowest": "lowest", "minima": "minima",
    "ball": "microphones/ball",
}  # fmt: skip


def main() -> None:
    """Write the files."""
    scene, n = load_scene(opening.SCENE), opening.MICROPHONE
    measurement = cached_measurement(scene)
    problem, solver = measurement.problem(), solvers.load(scene.solver.name)
    state = solver.init(problem, solvers.with_mode_count(problem, scene.solver), scene.seed)
    modes = tuple(range(opening.MODE, 0, -1))
    sums = list(partial_sums(problem, solver, state, n, modes, ORDER_OFFSET, counts=SUMMED))
    last, search = sums[-1].cost, problem.search
    minima = [map_minima(problem, solver, state, n, one.modes, ORDER_OFFSET, one.cost, search) for one in sums]
    # The microphone starts at the minimum of the first map from which the path downhill to the true one is longest.
    ways = [descent_path(np.log10(last), search, basins_of(last), place) for place in minima[0].lowest]
    path = max((way for way in ways if way.basin == 0), key=lambda way: len(way.points)).points
    counts = [one.count for one in minima]
    data = {
        "scale": [heatmap.colour_limits(one.cost, True, heatmap.WHOLE) for one in sums],
        "summed": SUMMED, "starts": times(counts), "change": CHANGE_TIME, "roll": ROLL_TIME,
        "words": [words(*both) for both in zip(SUMMED, counts, strict=True)],
        "found": FOUND, "about": ABOUT,
        "minima": [{"lowest": listed(one.lowest, 3), "others": listed(one.others, 3)} for one in minima],
        "path": listed(path, 3),
        **look(measurement, heatmap.cost_floor(last, search, True, relief=True)),
    }  # fmt: skip
    data["shown"] = [
        listed(heatmap.normalise(np.array(heatmap.colour_limits(one.cost, True)), *limits, True), 4)
        for one, limits in zip(sums, data["scale"], strict=True)
    ]
    levels = [heatmap.normalise(one.cost, *limits, True) for one, limits in zip(sums, data["scale"], strict=True)]
    coarse = np.stack(levels)[:, ::EVERY, ::EVERY]
    data |= {
        "n": coarse.shape[1], "origin": list(search.origin[:2]), "size": list(search.size[:2]),
        "levels": coded(255 * coarse), "colours": coded(heatmap.to_rgb(np.arange(256) / 255)),
    }  # fmt: skip
    with open(opening.MEASUREMENT, "wb") as file:
        save_measurement(measurement, file)
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    parts = 3 * "<canvas></canvas>" + f"<h1></h1><p></p><button></button><small>{PURPOSE}</small>"
    script = f'<script type="application/json">{text}</script>'
    opening.FILM.write_text(f'<div id="fdcal-film">{parts}{script}</div>\n', encoding="utf-8")
    for path in (opening.MEASUREMENT, opening.FILM):
        print(f"{path.name}: {path.stat().st_size} bytes")
    print("local minima:", counts)


def times(counts: list[int]) -> list[float]:
    """Return when each map begins and the last one ends, s; those with several minima take most of the time."""
    several = sum(count > 1 for count in counts)
    stays = [FEW_TIME / several] * several + [ONE_TIME / (len(counts) - several)] * (len(counts) - several)
    return np.cumsum([0.0, *stays]).round(3).tolist()


def words(modes: int, places: int) -> str:
    """Return the words of the film for a map of the sum of `modes` modes with `places` local minima."""
    many = NUMBERS[modes] if modes < len(NUMBERS) else str(modes)
    return f"{many} frequenc{'y' if modes == 1 else 'ies'}: {places} place{'s fit' if places > 1 else ' fits'}"


def look(measurement, floor) -> dict:
    """Return what the film needs to draw the relief `floor`: camera, rulers, marks and colours."""
    picture = compose(None, measurement, measurement.positions, opening.MICROPHONE, floor)
    (x0, y0, x1, y1), base, radius = picture.focus, picture.z_range[0], picture.marker_radius
    rulers = next(part for part in picture.lines if part.name == "frame").segments
    hidden = (rulers[:, :, 0] > x1 - NEAR).all(axis=1) | (rulers[:, :, 1] > y1 - NEAR).all(axis=1)  # by the block
    labels = [label for label in picture.labels if label.name.startswith("frame/")]
    labels.sort(key=lambda label: label.name[-1].isdigit())  # names of axes come first; numbers give way to them
    height = heatmap.RELIEF_HEIGHT * max(measurement.search.size[:2])
    corners = [(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (base, base + height)]
    return {
        "height": height, "middle": [(x0 + x1) / 2, (y0 + y1) / 2, base], "marker": radius,
        "frame": listed(rulers[~hidden], 4), "known": listed(measurement.known_positions, 4),
        "labels": [
            {"text": one.text, "at": listed(one.position, 4), "anchor": one.anchor} for one in labels
        ],
        "corners": listed([*corners, *(one.position for one in labels)], 4), "name": "microphone 16",
        "direction": camera.OBLIQUE, "fov": float(np.radians(camera.FOV_3D)), "margin": camera.MARGIN["close"],
        "margins": MARGINS,
        # margins of the session, whose bar and legend are beside the map: on a broad canvas, another one, a phone
        "after": [cameras.BROAD_MARGINS, cameras.MARGINS, [*cameras.PHONE_MARGINS, cameras.PHONE_PANEL]],
        "broad": [cameras.BROAD, cameras.BROAD_RATIO, cameras.PHONE_WIDTH],
        "light": heatmap.TOWARDS_LIGHT.tolist(), "darkest": heatmap.DARKEST,
        "brightest": heatmap.BRIGHTEST, "marks": film_marks(),
        "themes": [
            {
                "background": theme.background, "foreground": theme.foreground,
                "sides": [part.colour for part in heatmap.relief_sides(floor, theme)],
            }
            for theme in (LIGHT, DARK)
        ],
    }  # fmt: skip


def film_marks() -> dict:
    """Return colours and sizes of the marks, which the film draws by itself."""
    table = marks.marks_json(FILM_MARKS).items()
    return {name: {key: mark[key] for key in ("colour", "reach", "width", "halo")} for name, mark in table}


def listed(values, digits: int) -> list:
    """Return rounded numbers as a list for JSON."""
    return np.asarray(values, float).round(digits).tolist()


def coded(numbers) -> str:
    """Return numbers from 0 to 255 as bytes in base64."""
    return base64.b64encode(np.rint(numbers).astype(np.uint8).tobytes()).decode("ascii")


if __name__ == "__main__":
    main()
