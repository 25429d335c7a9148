"""A microphone that is dragged and let go rolls into the minimum below it, and the session gets one state more."""

import numpy as np
import pytest

from fdcal.cost.basins import basins_of, local_minima
from fdcal.cost.maps import cost_maps, map_positions, refined
from fdcal.model.scene_file import load_scene
from fdcal.session.sources import OpenRequest
from fdcal.viewer import drop as drop_module

MODE = 20  # of `tiny`, whose map has several minima


@pytest.fixture
def opened(page_of, monkeypatch):
    """The page of `tiny` with the map of one mode, and a function that ticks it until something happens."""
    monkeypatch.setattr(drop_module, "ROLL_TIME", 0.3)
    page, turn_until = page_of
    page.open(OpenRequest(load_scene("tiny"), choices={"microphone": 9, "follow": False, "modes": [MODE]}))
    turn_until(lambda: page.viewer is not None and page.viewer.snapshot.picture.floor is not None)
    return page, turn_until


def said(page):
    return page.panels.overlay._regions["words"].content


def labels(viewer):
    return [label.text for label in viewer.snapshot.picture.labels if label.name == "selected/name"]


def minima_of(viewer):
    """The local minima of the map of microphone 9, metres, and the number of that whose basin holds the truth."""
    run, state, choices = viewer.run, viewer.run.session.view.state, viewer.binding.choices
    search = refined(run.problem.search)
    cost = cost_maps(run.problem, run.solver, state, 9, (MODE,), choices.order_offset, search).sum(axis=0)
    return map_positions(local_minima(cost), search), basins_of(cost), search


def test_a_microphone_shows_cost_and_path_and_rolls_into_a_minimum_which_is_named(opened):
    page, turn_until = opened
    viewer, session = page.viewer, page.viewer.run.session
    before, truth = session.view, viewer.run.measurement.positions[9]
    for tries, at_home in enumerate([False, True], start=1):
        minima, basins, search = minima_of(viewer)
        number = next(n for n in range(len(minima)) if (n == basins.at(search, truth)) == at_home)
        start = minima[number] + [0.004, -0.003]
        turn_until(lambda: viewer.snapshot.view.count == tries)  # noqa: B023
        viewer.drop.move(9, start + [0.02, 0.02], tries, False)
        viewer.drop.move(9, start, tries, False)
        turn_until(lambda: any("dB" in text for text in labels(viewer)))
        names = {part.name for part in (*viewer.snapshot.picture.lines, *viewer.snapshot.picture.meshes)}
        assert "ball/path" in names and "dB" in said(page)
        assert session.view.count == tries, "nothing of the session changes while it is dragged"
        viewer.drop.move(9, start, tries, True)
        turn_until(lambda: session.view.count == tries + 1 and viewer.drop._drag is None)  # noqa: B023
        end = session.view.state.positions[9]
        np.testing.assert_allclose(end, minima[number], atol=1e-9)
        off = np.linalg.norm(end - truth)
        word = "home" if at_home else "trapped"
        text = f"{1e3 * off:.0f} mm" if off < 0.0995 else f"{1e2 * off:.0f} cm"
        assert f"{word}, {text} off" in said(page) and f"{tries - 1} of {tries} home" in said(page)
        assert drop_module.CONTINUE in said(page)
        turn_until(lambda: not any(part.name == "ball/path" for part in viewer.snapshot.picture.lines))
    session.seek(0)
    turn_until(lambda: viewer.snapshot.view.index == 0)
    np.testing.assert_array_equal(session.view.state.positions, before.state.positions)
    page.words.press(drop_module.CONTINUE)
    turn_until(lambda: session.view.running)
    session.pause()
    session.reset()
    turn_until(lambda: session.view.count == 1 and "home" not in said(page))


def test_every_flick_counts_even_between_two_ticks_and_each_gives_one_state(opened):
    page, turn_until = opened
    viewer, session = page.viewer, page.viewer.run.session
    minima, *_ = minima_of(viewer)
    for gesture in (1, 2):
        viewer.drop.move(9, minima[0] + [0.01, 0.0], gesture, False)
        viewer.drop.move(9, minima[0] + [0.005, 0.0], gesture, True)
        turn_until(lambda: viewer.drop.tries == gesture and viewer.drop._drag is None)  # noqa: B023
        assert session.view.count == gesture + 1


def test_a_drag_of_another_microphone_stays_one_drag_while_its_map_is_made(opened):
    page, turn_until = opened
    viewer, session = page.viewer, page.viewer.run.session
    for step, released in enumerate([False, False, True]):
        viewer.drop.move(12, (0.6 + 0.01 * step, 0.5), 7, released)
        viewer.tick(1e6 + step)
        assert session.view.count == 1 and viewer.drop._drag is not None
    turn_until(lambda: viewer.drop._drag is None)
    assert session.view.count == 2 and viewer.drop.tries == 1


def test_with_shift_what_rolls_stays_where_the_pointer_puts_it(opened):
    page, turn_until = opened
    viewer, session = page.viewer, page.viewer.run.session
    viewer.drop.move(9, (0.6, 0.5), 1, True)
    viewer.drop.place(9, (0.7, 0.6), 2, True)
    turn_until(lambda: np.allclose(session.view.state.positions[9], (0.7, 0.6)))
    viewer.tick(1e6)
    assert viewer.drop._drag is None and viewer.drop.tries == 0


def test_without_a_cost_the_microphone_follows_the_pointer(opened):
    page, turn_until = opened
    viewer, session = page.viewer, page.viewer.run.session
    viewer.binding.choose(shown=False)
    turn_until(lambda: viewer.snapshot.picture.floor is None)
    place = viewer.run.measurement.positions[9] + 0.01
    viewer.drop.move(9, place, 1, False)
    turn_until(lambda: session.view.count == 2)
    np.testing.assert_allclose(session.view.state.positions[9], place)


def test_in_space_it_falls_along_its_path_to_a_lower_cost(page_of, monkeypatch):
    monkeypatch.setattr(drop_module, "ROLL_TIME", 0.3)
    page, turn_until = page_of
    choices = {"microphone": 9, "follow": False, "modes": [9], "volume": True}
    page.open(OpenRequest(load_scene("ball3d"), choices=choices))
    turn_until(lambda: page.viewer is not None and page.viewer.snapshot.picture.surfaces)
    viewer, session = page.viewer, page.viewer.run.session
    start = session.view.state.positions[9] + [0.1, -0.1, 0.0]
    viewer.drop.move(9, start[:2], 1, False)  # the pointer gives no height
    turn_until(lambda: any("dB" in text for text in labels(viewer)))
    viewer.drop.move(9, start[:2], 1, True)
    turn_until(lambda: session.view.count == 2)
    path = viewer.drop.worker.latest.result.path
    np.testing.assert_allclose(path.points[0], start, atol=1e-9)
    np.testing.assert_allclose(session.view.state.positions[9], path.points[-1])
    assert np.all(np.diff(path.costs) < 0) and path.points[-1][2] != start[2]
