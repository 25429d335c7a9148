"""Every calibration of a study is in one panel of its figures, and no figure has more panels than can be read."""

import itertools

import pytest

from fdcal.graphics.study_report import MAX_PANELS, study_panels

STUDIES = {
    "one": {"snr_db": [20, 40]},
    "names": {"solver.name": ["joint", "robust"], "scene": ["tiny", "array1_circle"]},
    "four": {"solver.name": ["a", "b", "c", "d"], "solver.modes": [8, 16], "snr_db": [20, 40], "scene": ["x", "y"]},
    "many": {"known": [0, 3, 4, 6], "radius": [0.1, 0.2], "snr_db": [20, 40], "size": [[1, 2], [3, 4], [5, 6]]},
    "fixed": {"snr_db": [30], "radius": [0.1, 0.2, 0.3]},
}


@pytest.mark.parametrize("name", STUDIES)
def test_each_calibration_is_in_one_panel(name):
    import pandas

    from fdcal.assessment.study_statistics import column_value, rows_of

    axes = STUDIES[name]
    points = [dict(zip(axes, map(column_value, values), strict=True)) for values in itertools.product(*axes.values())]
    rows, shown = pandas.DataFrame(points), study_panels(axes)
    parts = [rows_of(rows, values) for values in shown.panels]
    assert sorted(itertools.chain.from_iterable(part.index for part in parts)) == list(rows.index)
    assert len(shown.panels) <= MAX_PANELS and shown.columns <= len(shown.panels)
    assert len(axes[shown.x]) > 1 and (shown.y == "" or len(axes[shown.y]) > 1)
    named = {shown.x, shown.y, *shown.averaged, *shown.panels[0]}
    assert {key for key, values in axes.items() if len(values) > 1} <= named


def test_noise_is_along_x_and_solvers_are_side_by_side():
    shown = study_panels(STUDIES["four"])
    assert (shown.y, shown.x) == ("solver.modes", "snr_db")
    assert shown.panels[0] == {"solver.name": "a", "scene": "x"} and len(shown.panels) == 8


def test_axes_that_are_chosen_stay():
    shown = study_panels(STUDIES["four"], ("snr_db", "solver.name"))
    assert (shown.y, shown.x) == ("snr_db", "solver.name")
    assert {"solver.modes", "scene"} == set(shown.panels[0])
