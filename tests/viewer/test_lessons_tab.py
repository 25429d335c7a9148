"""The tab Lessons: it sets the page's own controls, and tolerates any file and any client."""

import re
from types import SimpleNamespace

import pytest
from browsing import WAIT

from fdcal.acoustics.measure import cached_measurement
from fdcal.model.scene_file import load_scene
from fdcal.session.lesson import MAPS, Frame, Lesson, Setting, Step, load_lesson
from fdcal.session.scene_edits import edited
from fdcal.session.session import Session
from fdcal.viewer.gui.binding import MAP_KINDS
from fdcal.viewer.lesson_settings import apply_setting, show_frame
from fdcal.viewer.panels import Panels
from fdcal.viewer.server.hardening import open_server
from fdcal.viewer.tabs.lessons import NEXT, RESTORE, Caption, LessonsTab

EVIL = "<script>alert(1)</script>"


class CallRecorder:
    """An object that records all calls of its methods."""

    def __init__(self, calls, name=""):
        self.__dict__.update(_calls=calls, _name=name)

    def __getattr__(self, name):
        return CallRecorder(self._calls, f"{self._name}.{name}".lstrip("."))

    def __call__(self, *arguments, **named):
        self._calls.append((self._name, *arguments, *named.items()))


def state(first=1, last=3, automatic=True):
    return SimpleNamespace(first=first, last=last, automatic=automatic)


@pytest.fixture
def controls():
    """Controls that record what is done to them, and the records."""
    calls = []
    session = SimpleNamespace(
        view=SimpleNamespace(state=state(4, 9, False), history=[state()]),
        **{name: CallRecorder(calls, name) for name in ("reset", "use_modes", "play", "step", "sweep", "stage")},
    )
    binding = SimpleNamespace(session=session, modes=20, work=SimpleNamespace(scene=load_scene("tiny"), opening=None))
    return SimpleNamespace(
        binding=binding, map=CallRecorder(calls, "map"), view=CallRecorder(calls, "view"), run_bar=CallRecorder([])
    ), calls


@pytest.mark.parametrize("name", MAPS)
def test_every_map_of_a_lesson_is_one_of_the_page(controls, name):
    made, calls = controls
    apply_setting(Setting(map=name), made, lambda view: None, restarted=False)
    called, kind = calls[0]
    assert called == "map.show_as" and kind in MAP_KINDS


def test_a_setting_is_applied_in_its_documented_order(controls):
    made, calls = controls
    setting = Setting(
        modes="1-9", automatic=False, run="2 sweeps", microphone=3, follow=False, map="relief", map_modes="2, 4",
        scale="linear", trails=True, ellipses=False, view="3d",
    )  # fmt: skip
    apply_setting(setting, made, lambda view: calls.append(("view", view)), restarted=False)
    assert calls == [
        ("use_modes", 1, 9, False),
        ("sweep", 2),
        ("map.pick", 3),
        ("map.follow_solver", False),
        ("map.show_as", "Relief"),
        ("map.choose_modes", (2, 4)),
        ("map.scale_as", "Linear"),
        ("view.draw", ("trails", True)),
        ("view.draw", ("ellipses", False)),
        ("view", "3d"),
    ]


@pytest.mark.parametrize(
    ("setting", "restarted", "calls_expected"),
    [
        (Setting(automatic=True), False, ("use_modes", 4, 9, True)),
        (Setting(automatic=False), True, ("use_modes", 1, 3, False)),
        (Setting(modes="2-5"), False, ("use_modes", 2, 5, False)),
        (Setting(modes="2-5"), True, ("use_modes", 2, 5, True)),
        (Setting(run="end"), False, ("play",)),
        (Setting(run="3 steps"), False, ("step", 3)),
        (Setting(run="1 stage"), False, ("stage", 1)),
        (Setting(map_modes="in use"), False, ("map.choose_modes", None)),
    ],
)
def test_values_left_out_stay(controls, setting, restarted, calls_expected):
    made, calls = controls
    apply_setting(setting, made, lambda view: calls.append(("view", view)), restarted)
    assert calls == [calls_expected]


@pytest.fixture(scope="module")
def server():
    opened = open_server("127.0.0.1", 0)
    yield opened
    opened.stop()


@pytest.fixture
def page(server, controls):
    """A page without a session; `opened` holds what it was asked to open, `ready` puts the last of it on the page."""
    made, calls = controls
    opened = []
    place = SimpleNamespace(cameras=SimpleNamespace(request_all=lambda view: calls.append(("view", view))))
    page = SimpleNamespace(panels=Panels(server.gui), viewer=None, open=opened.append, nodes=place, opened=opened)
    page.switcher = SimpleNamespace(idle=False)

    def ready():
        made.binding.run = SimpleNamespace(scene=opened[-1].scene, opening=opened[-1])
        page.viewer = SimpleNamespace(binding=made.binding, tabs=made)

    page.ready, page.calls = ready, calls
    yield page
    server.gui.reset()


def text_of(lessons):
    return "" if lessons.caption is None else lessons.caption.html


def answers_of(lessons):
    """The words on the buttons of the answers that can be given."""
    return [] if lessons.caption is None else list(lessons.caption.answers)


def steps_of(lessons):
    """The commands of the buttons below a step."""
    return re.findall(r"data-do='(back|restore|next)'", text_of(lessons))


def test_a_lesson_runs_from_its_start_to_the_answer(page):
    lesson = load_lesson("3_too_many_too_soon")
    lessons = LessonsTab(page, [lesson])
    assert lessons.caption is None
    lessons.start("3. Too many too soon")
    assert "step 1 of 3" in text_of(lessons) and "being prepared" in text_of(lessons)
    assert not answers_of(lessons), "no question is asked before its picture is shown"
    lessons.show()
    assert page.calls == [], "nothing is set while another scene is still on the page"
    assert page.opened[-1].scene.solver.name == "descent"
    page.ready()
    lessons.show()
    assert ("use_modes", 1, 20, False) in page.calls and ("view", "top") in page.calls
    assert answers_of(lessons) == list(lesson.steps[0].choices), "the words of the answers are the buttons"
    assert "being prepared" not in text_of(lessons)
    page.calls.clear()
    lessons.answer(0)
    answer = "The answer is: Trapped far from the true positions."
    assert answer in text_of(lessons) and "After 7 sweeps" in text_of(lessons) and not answers_of(lessons)
    assert ("play",) in page.calls and len(page.opened) == 1, "the scene is there"
    lessons.answer(1)
    assert answer in text_of(lessons), "the first answer counts"
    page.calls.clear()
    lessons.go(NEXT)
    assert page.calls[0] == ("reset", 0) and page.calls[1] == ("use_modes", 1, 20, False)
    assert steps_of(lessons) == ["back", "restore", "next"] and "step 2 of 3" in text_of(lessons)
    lessons.go(NEXT)
    assert steps_of(lessons) == ["back", "restore"]
    lessons.end()
    assert lessons.caption is None and f"{lesson.title}, step 3 of 3<" in lessons.list_html(), "where it was left"
    page.viewer = None
    lessons.resume(lesson.name)
    assert "step 3 of 3" in text_of(lessons) and page.opened[-1].scene.solver.name == "descent"


def test_a_lesson_ends_with_the_next_one(page):
    first, second = load_lesson("4_frozen_grid"), load_lesson("5_corner_or_centre")
    lessons = LessonsTab(page, [first, second])
    following = lambda: lessons.caption.following  # noqa: E731
    lessons.start(first.title)
    page.ready()
    lessons.show()
    for _ in first.steps[1:]:
        assert not following()
        lessons.answer(0)
        assert following() == "Next step"
        lessons.follow()
    page.ready()
    lessons.show()
    assert not following(), "the last question has no answer yet"
    lessons.answer(2)
    assert following() == f"Next lesson: {second.title}"
    lessons.follow()
    assert lessons.progress.lesson is second and not following()
    lessons.progress = type(lessons.progress)(second, len(second.steps) - 1)
    page.ready()
    lessons.show()
    lessons.answer(2)
    assert not following(), "there is none after the last"


def test_the_lesson_does_not_wait_for_a_refused_scene(page):
    lessons = LessonsTab(page, [load_lesson("3_too_many_too_soon")])
    lessons.start("3. Too many too soon")
    page.switcher.idle = True
    lessons.show()
    assert answers_of(lessons) and "being prepared" not in text_of(lessons)
    page.ready()
    lessons.show()
    assert page.calls == []


def test_an_answer_before_the_scene_is_ready_is_kept(page):
    lessons = LessonsTab(page, [load_lesson("5_corner_or_centre")])
    lessons.start("5. Corner or centre")
    lessons.answer(1)
    page.ready()
    lessons.show()
    assert ("map.show_as", "No map") in page.calls and page.calls.index(("play",)) > 0
    assert page.calls.count(("play",)) == 1


def test_a_right_answer_is_confirmed(page):
    lessons = LessonsTab(page, [load_lesson("3_too_many_too_soon")])
    lessons.start("3. Too many too soon")
    page.ready()
    lessons.show()
    lessons.answer(1)
    assert "Right." in text_of(lessons)


def test_the_next_step_restores_the_scene_of_the_lesson(page):
    lessons = LessonsTab(page, [load_lesson("4_frozen_grid")])
    lessons.start("4. Why the grid freezes")
    page.ready()
    lessons.show()
    page.viewer.binding.run = SimpleNamespace(scene=load_scene("tiny"), opening=None)
    lessons.go(NEXT)
    assert len(page.opened) == 2 and page.opened[1].scene == page.opened[0].scene
    assert page.opened[1].scene.solver.name == "descent"


@pytest.mark.parametrize("junk", ["", "Z", "AB", "Next ", None, EVIL, "a" * 300])
def test_invalid_values_change_nothing(page, junk):
    lessons = LessonsTab(page, [load_lesson("3_too_many_too_soon")])
    lessons.go(junk)
    lessons.start("3. Too many too soon")
    before = lessons.progress
    lessons.go(junk), lessons.start(junk)
    lessons.answer(3), lessons.answer(-1)
    assert lessons.progress == before


def test_a_setting_that_fails_is_shown_as_an_error(page):
    steps = (Step("Look.", page=Setting(scene="tiny", modes="1-99")),)
    lessons = LessonsTab(page, [Lesson("Mine", steps)])
    lessons.start("Mine")
    page.ready()
    lessons.show()
    assert "1 to 20" in text_of(lessons)
    lessons.go(RESTORE)
    page.ready()
    lessons.show()
    assert "1 to 20" in text_of(lessons)


def test_a_frame_is_shown_or_run_to(kernels):
    scene = edited(load_scene("tiny"), {"solver.name": "descent"})
    session = Session(cached_measurement(scene).problem(), scene.solver, 0)
    session.step(6)
    assert session.wait_for(lambda view: view.state.step == 6, timeout=WAIT)
    show_frame(session, Frame("step", 4), list(session.view.history))
    assert session.wait_for(lambda view: view.state.step == 4 and not view.running, timeout=WAIT)
    assert session.view.count == 7, "the run so far stays"
    show_frame(session, Frame("sweep", 1), list(session.view.history))
    assert session.wait_for(lambda view: view.state.sweep == 1 and not view.running, timeout=WAIT)
    assert session.view.state.step == len(cached_measurement(scene).problem().free), "it went on from the last state"
    show_frame(session, Frame("stage", 1), list(session.view.history))
    assert session.wait_for(lambda view: view.index == 0, timeout=WAIT)
    session.close()


def test_texts_of_a_file_are_escaped():
    lesson = Lesson(EVIL, (Step(EVIL, EVIL, (EVIL, EVIL), 1, EVIL),))
    for choice in (-1, 0, 1):
        html = Caption(lesson, 0, choice, True, EVIL, EVIL, EVIL).html
        assert "<script" not in html and "&lt;script" in html


@pytest.mark.parametrize(("choice", "shown"), [(1, {"two"}), (0, {"one", "two"}), (2, {"two", "three"})])
def test_an_answered_step_shows_the_answer_given_and_the_right_one(choice, shown):
    """On a small screen the button below has no place beside all choices."""
    lesson = Lesson("A lesson", (Step("", "Which?", ("one", "two", "three"), 2, "Why."),))
    html = Caption(lesson, 0, choice, True, "", "", "").html
    assert {word for word in ("one", "two", "three") if f">{word}<" in html} == shown
    assert ("&#10007;" in html) == (choice != 1) and html.count("&#10003;") == 1
