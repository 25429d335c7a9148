"""The curve of the cost along a run, on which the playhead of Explore moves."""

import dataclasses
import re
from types import SimpleNamespace

import numpy as np
import pytest
from doubles import State, view_of

from fdcal.session.session import StateCosts
from fdcal.viewer.explore import CURVE_HEIGHT, CURVE_POINTS, Explore, run_curve


@pytest.mark.parametrize("count", [2, 7, 1000])
def test_the_curve_falls_with_the_cost_and_has_few_points(count):
    states = [State(np.zeros((1, 2)), step=i, cost=-float(i)) for i in range(count)]
    view = dataclasses.replace(view_of(states), costs=StateCosts(lambda state: state.cost))
    assert run_curve(view) == "", "no cost is computed here"
    for state in states:
        view.costs.compute(state)
    x, y = np.array([pair.split() for pair in re.split("[ML]", run_curve(view))[1:]], float).T
    assert 2 <= len(x) <= CURVE_POINTS and (x[0], x[-1]) == (0, 100) and (np.diff(x) > 0).all()
    assert (np.diff(y) >= 0).all() and 0 < y[0] < y[-1] < CURVE_HEIGHT, "downwards on a screen"


def test_before_the_first_session_the_bar_says_what_is_prepared_and_how_far_it_is():
    shown = {}
    overlay = SimpleNamespace(on=lambda *_: None, show=lambda region, html: shown.update({region: html}))
    switcher = SimpleNamespace(progress=SimpleNamespace(text="Simulating 3 %"), error=None, title="A < B")
    page = SimpleNamespace(viewer=None, panels=SimpleNamespace(overlay=overlay), switcher=switcher)
    explore = Explore(page, SimpleNamespace(page=page))
    explore.show()
    assert "A &lt; B" in shown["bar"] and "Simulating 3 %" in shown["bar"] and "button" not in shown["bar"]
    switcher.progress = None
    explore.show()
    assert shown == {"bar": ""}
