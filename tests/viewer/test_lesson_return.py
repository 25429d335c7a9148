"""A lesson puts back all that it has set: the session with its states, every control, the race."""

from dataclasses import replace

import numpy as np
import pytest
from doubles import set_by_client

from fdcal.model.scene_file import load_scene
from fdcal.session.lesson import Lesson, Setting, Step, lesson_names, load_lesson
from fdcal.session.scene_edits import edited
from fdcal.session.sources import OpenRequest
from fdcal.viewer.gui.binding import Choices
from fdcal.viewer.lesson_settings import control_values
from fdcal.viewer.tabs.comparison import ComparisonSetup
from fdcal.viewer.tabs.lessons import LessonsTab

SMALL = "tiny"


def controls_of(viewer):
    """What every control of the page says."""
    tabs = {**vars(viewer.tabs), "slice": viewer.tabs.map.slice}
    return {name: values for name, tab in tabs.items() if (values := control_values_of(tab))}


def control_values_of(tab):
    return control_values(tab) if hasattr(tab, "__dict__") else {}


def set_oddly(viewer):
    """Set the page as no lesson does, as a user would: by its controls."""
    main = viewer.tabs
    main.solver.use_modes(2, 7, False)
    main.solver.seed.value = 5
    viewer.binding.choose(seed=5)
    main.run_bar.speed.value = 12
    main.run_bar.limit_rate(12)
    main.map.pick(4)
    main.map.show_as("Relief")
    main.map.choose_modes((2, 3, 6))
    main.map.show_quantity("Solver's objective")
    main.map.set_order(3)
    main.map.scale_as("Linear")
    main.map.mark_minima(False)
    set_by_client(main.map.relief, 60)
    main.view.draw(trails=True, ellipses=True)
    main.view.darken(True)
    set_by_client(main.view.release, True)
    main.export.choose("Map (VTI for ParaView)")
    main.export.kind.value = "Map (VTI for ParaView)"
    main.scene.radius.value = 0.31
    main.scene.walls.value = "absorbing"
    main.scene.noise.value = True
    main.scene.refresh()
    set_by_client(main.maps.shared, True)
    main.comparison.seed.value = 9
    main.comparison.marks.value = False


@pytest.fixture
def opened(page_of):
    """A page that shows `tiny` solved by descent, stopped at step 5 of 9 and set oddly."""
    page, turn_until = page_of
    scene = edited(load_scene(SMALL), {"solver.name": "descent"})
    page.open(OpenRequest(scene, start_seed=3))
    turn_until(lambda: page.viewer is not None)
    session = page.viewer.binding.session
    set_oddly(page.viewer)
    assert session.wait_for(lambda view: view.state.last == 7, timeout=60)
    session.pace(0)  # at once; the control stays
    session.step(9)
    assert session.wait_for(lambda view: view.state.step == 9 and not view.running, timeout=60)
    session.seek(session.view.index - 4)
    assert session.wait_for(lambda view: view.state.step == 5, timeout=60)
    turn_until(lambda: page.viewer.tabs.run_bar.time.value == page.viewer.binding.session.view.index)
    turn_until(lambda: "mode 6" in page.viewer.tabs.spectrum.text.content)  # follows the map
    return page, turn_until


def prepared(page):
    """Whether the caption asks about what is shown."""
    return "being prepared" not in page.panels.overlay._regions["caption"].content


def in_small(lesson):
    """A lesson with all that it sets, in a scene that is there at once."""

    def small(setting):
        changes = {"scene": SMALL, "changes": {"solver.name": "descent"}} if setting.begins else {}
        modes = {} if setting.modes is None else {"modes": "1-20"}
        microphone = {} if setting.microphone is None else {"microphone": setting.microphone % 16}
        mapped = {"map_modes": "2-4"} if setting.map_modes not in (None, "in use") else {}
        run = {"run": "3 steps"} if setting.run else {}
        return Setting(**(vars(setting) | changes | modes | microphone | mapped | run))

    steps = tuple(Step(one.text, one.question, one.choices, one.answer, one.reveal, small(one.page), small(one.then))
                  for one in lesson.steps)  # fmt: skip
    return Lesson(lesson.title, steps)


def test_every_control_is_as_it_was_after_the_steps_of_all_lessons(opened):
    page, turn_until = opened
    before, view = controls_of(page.viewer), page.viewer.binding.session.view
    steps = tuple(step for name in lesson_names() for step in in_small(load_lesson(name)).steps)
    choices, lessons = page.viewer.binding.choices, LessonsTab(page, [Lesson("All", steps)])
    page.lessons = lessons
    lessons.start("All")
    for number in range(len(steps)):
        turn_until(lambda: page.switcher.idle and prepared(page))
        lessons.answer(0)
        turn_until(lambda: page.switcher.idle and prepared(page))
        if number < len(steps) - 1:
            lessons.go("Next")
    assert controls_of(page.viewer) != before, "the lessons have set something"
    shown = page.viewer
    lessons.end()
    turn_until(lambda: page.viewer is not shown and page.switcher.idle)
    turn_until(lambda: page.viewer.binding.choices == choices)
    turn_until(lambda: controls_of(page.viewer) == before)
    after = page.viewer.binding.session.view
    assert [state.step for state in after.history] == [state.step for state in view.history]
    assert after.index == view.index and np.array_equal(after.state.positions, view.state.positions)


def test_a_lesson_depends_on_nothing_before_it(opened):
    """Its first step finds the controls with which a page begins."""
    page, turn_until = opened
    lessons = page.lessons = LessonsTab(page, [Lesson("Mine", (Step("Look.", page=Setting(scene=SMALL)),))])
    lessons.start("Mine")
    turn_until(lambda: prepared(page))
    odd, plain = page.viewer.binding.choices, Choices(microphone=page.viewer.binding.choices.microphone)
    kept = {name: getattr(odd, name) for name in ("seed", "export_kind", "plan", "themed")}
    assert odd == replace(plain, style=replace(plain.style, dark=True), **kept)
    turn_until(lambda: page.viewer.tabs.run_bar.speed.value < 60)  # so that it can be watched
    page.viewer.tabs.map.mark_minima(False)
    lessons.start("Mine")
    turn_until(lambda: page.viewer.binding.choices.style.minima)


def test_a_race_waits_for_the_end_of_a_lesson(opened):
    page, turn_until = opened
    lessons = page.lessons = LessonsTab(page, [Lesson("Mine", (Step("Look.", page=Setting(scene=SMALL)),))])
    race = page.viewer.tabs.comparison.worker
    race.toggle(ComparisonSetup(("descent", "joint"), "random", 0))
    turn_until(lambda: any(summary.step for summary in race.summaries))
    lessons.start("Mine")
    turn_until(lambda: race.released is not None)
    assert "its race wait" in page.panels.overlay._regions["caption"].content
    waiting = race.released.comparison
    turn_until(lambda: page.viewer.tabs.comparison.worker is not race)
    assert not waiting.running and page.viewer.tabs.comparison.worker.summaries == ()
    page.tick(0.0)
    lessons.end()
    turn_until(lambda: page.viewer.tabs.comparison.worker.summaries)
    again = page.viewer.tabs.comparison.worker
    assert [one.name for one in again.summaries] == ["descent", "joint"] and again.button_label == "Resume"
    again.toggle(ComparisonSetup(("descent", "joint"), "random", 0))
    turn_until(lambda: waiting.running or waiting.over)


def test_what_the_user_opens_during_a_lesson_stays(opened):
    page, turn_until = opened
    lessons = page.lessons = LessonsTab(page, [Lesson("Mine", (Step("Look.", page=Setting(scene=SMALL)),))])
    first = page.viewer
    lessons.start("Mine")
    turn_until(lambda: page.viewer is not first and page.switcher.idle)
    of_the_lesson, mine = page.viewer, OpenRequest(edited(load_scene(SMALL), {"title": "Mine"}))
    page.open(mine)
    turn_until(lambda: page.viewer is not of_the_lesson and page.switcher.idle)
    lessons.end()
    for _ in range(5):
        page.tick(0.0)
    assert page.switcher.idle and page.viewer.binding.run.opening is mine
