"""Files for other programs, read back by those programs' own readers."""

import csv
import io
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from fdcal.acoustics.measure import cached_measurement
from fdcal.assessment.result_file import position_table
from fdcal.cost.maps import landscape_panels
from fdcal.graphics import exports
from fdcal.graphics.landscape import draw_landscape, figure_bytes
from fdcal.model.gauge import position_errors
from fdcal.model.measurement import Measurement
from fdcal.model.scene import load_scene


@pytest.fixture(scope="module")
def measured():
    scene = load_scene("tiny")
    measurement = cached_measurement(scene)
    return measurement, measurement.problem()


@pytest.fixture(scope="module")
def solid():
    """An array in space, with names that are no plain texts."""
    rng = np.random.default_rng(3)
    pressures = rng.normal(size=(2, 9)) + 1j * rng.normal(size=(2, 9))
    names = ('"a", b', "<i>", "ü&", "=1+1", *"efghi")
    return Measurement(
        [100.0, 150.0], pressures, 343.0, 3, names=names, positions=rng.normal(size=(9, 3)), known=[1, 4, 5, 6]
    )


def opened(text, name, tmp_path):
    import pyvista

    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return pyvista.read(path)


def test_a_landscape_for_paraview(measured, tmp_path):
    measurement, problem = measured
    panels = landscape_panels(problem, measurement.positions, 9, [2, 5], 2)
    grid = opened(exports.landscape_vti(panels, 0.7), "map.vti", tmp_path)
    search = problem.search
    assert grid.dimensions == (*search.shape, 1) and np.allclose(grid.origin, (*search.origin, 0.7))
    assert set(grid.point_data) == {*(f"mode {m}, {problem.frequencies[m - 1]:.2f} Hz" for m in (2, 5)), "sum"}
    assert np.array_equal(grid["sum"].reshape(search.shape[::-1]), panels.maps[-1])
    lowest = grid.points[grid["sum"].argmin()]
    assert np.allclose(lowest, (*measurement.positions[9], 0.7)), "the minimum lies at the true place"


def test_the_table_of_microphones_is_complete(measured, solid):
    measurement, _ = measured
    blind = Measurement(measurement.frequencies, measurement.pressures, 343.0)
    rows = list(csv.DictReader(io.StringIO(position_table(blind, measurement.positions))))
    assert len(rows) == 16 and "z_m" not in rows[0]
    assert {row[key] for row in rows for key in ("true_x_m", "true_y_m", "error_m", "uncertainty_m")} == {""}
    estimate = solid.positions + [0.0, 0.003, 0.004]
    rows = list(csv.DictReader(io.StringIO(position_table(solid, estimate, np.full(9, 0.002)))))
    assert [row["name"] for row in rows] == list(solid.names)
    assert [row["known"] for row in rows] == ["yes" if n in (1, 4, 5, 6) else "no" for n in range(9)]
    for start, values in (("", estimate), ("true_", solid.positions)):
        np.testing.assert_allclose([[float(row[f"{start}{a}_m"]) for a in "xyz"] for row in rows], values, rtol=1e-8)
    errors = position_errors(estimate, solid.positions).tolist()
    assert [float(row["error_m"]) for row in rows] == pytest.approx(errors, rel=1e-8)
    assert ",2.47," in position_table(solid, np.full_like(estimate, 2.4699999999999998))
    assert {row["uncertainty_m"] for row in rows} == {"0.002"}


def test_figures_as_picture_and_drawing(measured):
    measurement, problem = measured
    panels = landscape_panels(problem, measurement.positions, 9, [1, 5], 2)
    figure = draw_landscape(panels, measurement.positions[9], heading="a $ and $ <b>")
    image = Image.open(io.BytesIO(figure_bytes(figure, "png")))
    assert image.format == "PNG" and len(np.unique(np.asarray(image.convert("RGB")).reshape(-1, 3), axis=0)) > 100
    drawing = ElementTree.fromstring(figure_bytes(figure, "svg"))
    texts = {"".join(node.itertext()) for node in drawing.iter("{http://www.w3.org/2000/svg}text")}
    assert {"a $ and $ <b>", f"mode 5, {problem.frequencies[4]:.1f} Hz", "sum of the 2 modes", "x (m)"} <= texts
    assert len(list(drawing.iter("{http://www.w3.org/2000/svg}image"))) >= 3
