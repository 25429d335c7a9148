"""Lessons set the controls of the page, tolerate any file and any client, and restore all that they have set."""

import html
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import viser
from browsing import WAIT
from doubles import CallRecorder, set_by_client

from fdcal.acoustics.measure import cached_measurement
from fdcal.model.scene import load_scene
from fdcal.model.validation import InputError
from fdcal.session.lesson import Lesson, LessonProgress, LessonSetting, LessonStep, load_lesson
from fdcal.session.scene_edits import edited
from fdcal.session.session import Session
from fdcal.session.sources import OpenRequest
from fdcal.viewer.panels import Panels
from fdcal.viewer.state import Choices
from fdcal.viewer.tabs.lessons import LessonsTab, apply_setting, show_frame

EVIL = "<script>alert(1)</script>"


def state(first=1, last=3, automatic=True, **more):
    return SimpleNamespace(first=first, last=last, automatic=automatic, **{"finished": False, "sweep": 0} | more)


@pytest.fixture
def controls():
    """Controls that record what is done to them, and the records."""
    calls = []
    view = SimpleNamespace(state=state(4, 9, False), history=[state()], running=False, error="")
    session = CallRecorder(calls, view=view)
    work = SimpleNamespace(scene=load_scene("tiny"), opening=None)
    binding = CallRecorder(calls, session=session, modes=20, call=lambda act: act(), work=work)
    return SimpleNamespace(
        binding=binding, map=CallRecorder(calls, "map"), view=CallRecorder(calls, "view"), run_bar=CallRecorder([]),
        microphones=SimpleNamespace(panel=lambda name: ""),
    ), calls  # fmt: skip


def test_a_setting_is_applied_in_its_documented_order(controls):
    made, calls = controls
    setting = LessonSetting(
        modes="1-9", automatic=False, run="2 sweeps", microphone=3, follow=False, map="relief", map_modes="2, 4",
        scale="linear", trails=True, ellipses=False, view="3d",
    )  # fmt: skip
    apply_setting(setting, made, lambda view: calls.append(("view", view)), restarted=False)
    assert calls == [
        ("use_modes", 1, 9, False), ("step", 2, "sweep"), ("map.pick", 3), ("map.follow_solver", False),
        ("map.show_as", "relief"), ("map.choose_modes", (2, 4)), ("choose", ("log", False)),
        ("choose", ("trails", True)), ("choose", ("ellipses", False)), ("view", "3d"),
    ]  # fmt: skip


def test_values_left_out_stay(controls):
    made, calls = controls
    for setting, restarted, expected in (
        (LessonSetting(automatic=True), False, ("use_modes", 4, 9, True)),
        (LessonSetting(automatic=False), True, ("use_modes", 1, 3, False)),
        (LessonSetting(modes="2-5"), False, ("use_modes", 2, 5, False)),
        (LessonSetting(modes="2-5"), True, ("use_modes", 2, 5, True)),
        (LessonSetting(run="end"), False, ("play",)),
        (LessonSetting(run="3 steps"), False, ("step", 3, "step")),
        (LessonSetting(run="1 stage"), False, ("step", 1, "stage")),
        (LessonSetting(map_modes="solver"), False, ("map.choose_modes", None)),
    ):
        apply_setting(setting, made, lambda view: calls.append(("view", view)), restarted)
        assert calls == [expected]
        calls.clear()


@pytest.fixture
def page(server, controls):
    """A page without a session; `opened` has the requests, and `ready` shows the last of them."""
    made, calls = controls
    opened, then = [], []
    place = SimpleNamespace(cameras=SimpleNamespace(request_all=lambda view: calls.append(("view", view))))
    page = SimpleNamespace(panels=Panels(server.gui), viewer=None, nodes=place, opened=opened)
    page.open = lambda request, act: (opened.append(request), then.append(act))
    page.switcher = SimpleNamespace(idle=False)

    def ready():
        made.binding.run = SimpleNamespace(scene=opened[-1].scene, opening=opened[-1])
        page.viewer = SimpleNamespace(binding=made.binding, tabs=made)
        then[-1](page.viewer)

    page.ready, page.calls = ready, calls
    yield page
    server.gui.reset()


def answers_of(lessons):
    """The words on the buttons of the answers that can be given."""
    buttons = re.findall(r"data-do='answer=\d+' class=''>(.*?)</button>", lessons.caption)
    return [html.unescape(text) for text in buttons]


def steps_of(lessons):
    """The commands of the buttons below a step."""
    return re.findall(r"data-do='(back|restore|next)'", lessons.caption)


def run_ends(page, lessons):
    end = SimpleNamespace(state=state(finished=True), history=[state()], running=False, error="")
    page.viewer.binding.session.view = end
    lessons.show()


def begun(page, *lessons):
    """The tab with some lessons, the first of which is begun, with its scene on the page."""
    made = LessonsTab(page, list(lessons))
    made.open(lessons[0].title)
    page.ready()
    made.show()
    return made


def test_a_lesson_runs_from_its_start_to_the_answer(page):
    lesson = load_lesson("3_too_many_too_soon")
    lessons = LessonsTab(page, [lesson])
    assert not lessons.caption
    lessons.open("3. Too many too soon")
    assert "step 1 of 3" in lessons.caption and "being prepared" in lessons.caption
    assert not answers_of(lessons), "no question is asked before its picture is shown"
    lessons.show()
    assert page.calls == [], "nothing is set while another scene is still on the page"
    page.ready()
    lessons.show()
    assert ("use_modes", 1, 20, False) in page.calls and ("view", "top") in page.calls
    assert answers_of(lessons) == list(lesson.steps[0].choices), "the words of the answers are the buttons"
    assert "being prepared" not in lessons.caption
    page.calls.clear()
    lessons.answer(0)
    assert ("play",) in page.calls and len(page.opened) == 1, "the scene is there"
    session = page.viewer.binding.session
    # The first state is that of a run that has not begun.
    for running, finished in ((False, False), (True, False), (True, True), (False, True)):
        session.view = SimpleNamespace(state=state(finished=finished), history=[state()], running=running, error="")
        lessons.show()
        explained = finished and not running
        assert ("After 7 sweeps" in lessons.caption, "has ended" in lessons.caption) == (explained, not explained)
        assert (("choose", ("marks", (1, 10))) in page.calls) == explained, "what the text names is pointed out with it"
    assert "Not quite." in lessons.caption and not answers_of(lessons)
    lessons.answer(1)
    assert "Not quite." in lessons.caption, "the first answer counts"
    page.calls.clear()
    lessons.go(1)
    assert page.calls[0] == ("reset", 0) and page.calls[1] == ("use_modes", 1, 20, False)
    assert steps_of(lessons) == ["back", "restore", "next"] and "step 2 of 3" in lessons.caption
    lessons.go(1)
    assert steps_of(lessons) == ["back", "restore"]
    lessons.end()
    assert not lessons.caption and f"{lesson.title}, step 3 of 3<" in lessons.list_html(), "where it was left"
    page.viewer = None
    lessons.open(lesson.name)
    assert "step 3 of 3" in lessons.caption and page.opened[-1].scene.solver.name == "descent"
    page.calls.clear()
    page.ready()
    lessons.show()
    assert ("play",) not in page.calls and answers_of(lessons), "it begins at the start, not after the runs before it"


def test_a_lesson_ends_with_the_next_one(page):
    first, second = load_lesson("4_frozen_grid"), load_lesson("5_corner_or_centre")
    lessons = begun(page, first, second)
    following = lambda: "".join(re.findall(r"data-do='follow' class='first'>(.*?)<", lessons.caption))  # noqa: E731
    for _ in first.steps[1:]:
        assert not following()
        lessons.answer(0)
        run_ends(page, lessons)
        assert following() == "Next step"
        lessons.follow()
    page.ready()
    lessons.show()
    assert not following(), "the last question has no answer yet"
    lessons.answer(2)
    run_ends(page, lessons)
    assert following() == f"Next lesson: {second.title}"
    lessons.follow()
    assert lessons.progress.lesson is second and not following()
    lessons.answer(1)
    page.calls.clear()
    page.ready()
    lessons.show()
    assert page.calls.count(("play",)) == 1, "an answer before the scene is ready is kept"


def test_the_next_step_restores_the_scene_of_the_lesson(page):
    lessons = begun(page, load_lesson("4_frozen_grid"))
    page.viewer.binding.run = SimpleNamespace(scene=load_scene("tiny"), opening=None)
    lessons.go(1)
    assert len(page.opened) == 2 and page.opened[1].scene == page.opened[0].scene


def test_invalid_values_change_nothing(page):
    lessons = LessonsTab(page, [load_lesson("3_too_many_too_soon")])
    lessons.open("3. Too many too soon")
    before = lessons.progress
    for junk in ("Z", "AB", "Next ", EVIL, "a" * 300):
        with pytest.raises(InputError, match="there is no lesson"):
            lessons.open(junk)
    lessons.go(-1)
    lessons.answer(3)
    lessons.answer(-1)
    assert lessons.progress == before


def test_a_setting_that_fails_is_shown_as_an_error(page):
    lessons = begun(page, Lesson("Mine", (LessonStep("Look.", page=LessonSetting(scene="tiny", modes="1-99")),)))
    assert "1 to 20" in lessons.caption


def test_a_frame_is_shown_or_run_to(kernels):
    scene = edited(load_scene("tiny"), {"solver.name": "descent"})
    session = Session(cached_measurement(scene).problem(), scene.solver, 0)
    session.step(6)
    assert session.wait_for(lambda view: view.state.step == 6, timeout=WAIT)
    show_frame(session, {"step": "4"}, list(session.view.history))
    assert session.wait_for(lambda view: view.state.step == 4 and not view.running, timeout=WAIT)
    assert session.view.count == 7, "the run so far stays"
    show_frame(session, {"sweep": "1"}, list(session.view.history))
    assert session.wait_for(lambda view: view.state.sweep == 1 and not view.running, timeout=WAIT)
    assert session.view.state.step == len(cached_measurement(scene).problem().free), "it went on from the last state"
    show_frame(session, {"stage": "1"}, list(session.view.history))
    assert session.wait_for(lambda view: view.index == 0, timeout=WAIT)
    session.close()


def test_a_caption_escapes_its_texts_and_shows_the_answer_given_and_the_right_one(page):
    """On a small screen there is no space for the button below all choices."""
    lesson = Lesson(EVIL, (LessonStep(EVIL, EVIL, ("one", f"{EVIL}two", "three"), 2, EVIL),))
    lessons = LessonsTab(page, [lesson, replace(lesson, title=f"{EVIL}, the next")])
    lessons._error = EVIL
    for choice, shown in ((1, {"two"}), (0, {"one", "two"}), (2, {"two", "three"})):
        lessons.progress = LessonProgress(lesson, 0, choice)
        text = lessons.caption
        assert "<script" not in text and "&lt;script" in text
        assert {word for word in ("one", "two", "three") if f"{word}<" in text} == shown
        assert ("&#10007;" in text) == (choice != 1) and text.count("&#10003;") == 1
        assert ("Right." in text, "Not quite." in text) == (choice == 1, choice != 1)


SMALL = "tiny"
MINE = Lesson("Mine", (LessonStep("Look.", page=LessonSetting(scene=SMALL)),))


def controls_of(viewer):
    """Return the values of all controls of the page."""
    handles = [(name, *one) for name, tab in vars(viewer.tabs).items() for one in getattr(tab, "__dict__", {}).items()]
    return {handle[:2]: handle[2].value for handle in handles if isinstance(handle[2], viser.GuiInputHandle)}


def set_unusual_values(viewer):
    """Set the controls of the page, as a user does, to values that no lesson sets."""
    main = viewer.tabs
    main.solver.use_modes(2, 7, False)
    set_by_client(main.solver.seed, 5)
    set_by_client(main.run_bar.speed, 12)
    main.map.pick(4)
    main.map.show_as("relief")
    main.map.choose_modes((2, 3, 6))
    viewer.binding.choose(objective=True, order_offset=3, log=False, minima=False, trails=True, ellipses=True)
    main.view.darken(True)
    set_by_client(main.export.kind, "Microphones (CSV)")
    for control, value in ((main.scene.noise, True), (main.scene.radius, 0.31), (main.scene.walls, "absorbing")):
        set_by_client(control, value)


@pytest.fixture
def opened(page_of):
    """A page that shows `tiny` solved by descent, stopped at step 5 of 9, with unusual settings."""
    page, turn_until = page_of
    page.open(OpenRequest(edited(load_scene(SMALL), {"solver.name": "descent"}), start_seed=3))
    turn_until(lambda: page.viewer is not None)
    session = page.viewer.binding.session
    set_unusual_values(page.viewer)
    assert session.wait_for(lambda view: view.state.last == 7, timeout=60)
    session.pace(0)  # the session steps at once; the control keeps its value
    session.step(9)
    assert session.wait_for(lambda view: view.state.step == 9 and not view.running, timeout=60)
    session.seek(session.view.index - 4)
    assert session.wait_for(lambda view: view.state.step == 5, timeout=60)
    turn_until(lambda: page.viewer.tabs.run_bar.time.value == page.viewer.binding.session.view.index)
    turn_until(lambda: "frequency 6" in page.viewer.tabs.spectrum.text.content)  # the text follows the map
    return page, turn_until


def prepared(page):
    """Return whether the caption shows its question or explanation."""
    return "being prepared" not in page.panels.overlay._regions["caption"].content


def test_a_lesson_depends_on_nothing_before_it(opened):
    """Its first step begins with the initial values of all controls."""
    page, turn_until = opened
    lessons = page.lessons = LessonsTab(page, [MINE])
    lessons.open("Mine")
    turn_until(lambda: prepared(page))
    odd, plain = page.viewer.binding.choices, Choices(microphone=page.viewer.binding.choices.microphone)
    kept = {name: getattr(odd, name) for name in ("seed", "export_kind", "themed")}
    assert odd == replace(plain, dark=True, objective=False, **kept)
    turn_until(lambda: page.viewer.tabs.run_bar.speed.value < 60)  # the lesson runs slowly enough to be watched
    page.viewer.binding.choose(minima=False, rate=12)
    page.panels.overlay.acts["hurry"](None, "")
    assert page.viewer.binding.choices.rate is None, "fast, although the user has chosen a speed"
    lessons.open("Mine")
    turn_until(lambda: page.viewer.binding.choices.minima)


def test_what_the_user_opens_during_a_lesson_stays(opened):
    page, turn_until = opened
    page.lessons, first = (lessons := LessonsTab(page, [MINE])), page.viewer
    lessons.open("Mine")
    turn_until(lambda: page.viewer is not first and page.switcher.idle)
    of_the_lesson, mine = page.viewer, OpenRequest(edited(load_scene(SMALL), {"title": "Mine"}))
    page.open(mine)
    turn_until(lambda: page.viewer is not of_the_lesson and page.switcher.idle)
    lessons.end()
    for _ in range(5):
        page.tick(0.0)
    assert page.switcher.idle and page.viewer.binding.run.opening is mine


def test_a_lesson_sets_what_it_says_and_every_control_is_as_it_was_after_it(opened):
    page, turn_until = opened
    before, view = controls_of(page.viewer), page.viewer.binding.session.view
    begins = {"scene": SMALL, "changes": {"solver.name": "descent"}}
    look = {"map": "relief", "scale": "linear", "trails": True, "ellipses": True, "minima": True, "view": "3d"}
    use = {"modes": "1-20", "automatic": True, "microphone": 9, "follow": False, "map_modes": "2-4"}
    asked = "Look.", "Which?", ("one", "two"), 1, ""
    steps = (
        LessonStep(*asked, LessonSetting(**begins, **use), LessonSetting(run="3 steps")),
        LessonStep(*asked, LessonSetting(reset=True, **use, **look)),
        LessonStep("Look.", page=LessonSetting(**begins, map="none", quantity="eq7", order_offset=1)),
    )
    choices, lessons = page.viewer.binding.choices, LessonsTab(page, [Lesson("All", steps)])
    page.lessons = lessons
    lessons.open("All")
    for number in range(len(steps)):
        turn_until(lambda: page.switcher.idle and prepared(page))
        lessons.answer(0)
        turn_until(lambda: page.switcher.idle and prepared(page))
        if number < len(steps) - 1:
            lessons.go(1)
    assert controls_of(page.viewer) != before, "the lessons have set something"
    shown = page.viewer
    lessons.end()
    turn_until(lambda: page.viewer is not shown and page.switcher.idle)
    turn_until(lambda: page.viewer.binding.choices == choices)
    turn_until(lambda: controls_of(page.viewer) == before)
    after = page.viewer.binding.session.view
    assert [state.step for state in after.history] == [state.step for state in view.history]
    assert after.index == view.index and np.array_equal(after.state.positions, view.state.positions)
