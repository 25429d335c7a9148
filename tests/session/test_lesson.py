"""Lessons are read from TOML files: the built-in ones are valid, and an error is reported in one line."""

from dataclasses import replace

import pytest
from running import refuses

from fdcal.session import lesson as lessons
from fdcal.session.lesson import LessonSetting, load_lesson

GOOD = """
title = "Mine"
[[steps]]
text = "Look."
question = "How many?"
choices = ["one", "two"]
answer = 2
reveal = "Two."
[steps.page]
scene = "tiny"
changes = { "solver.name" = "descent" }
modes = "1-5"
microphone = 3
[steps.then]
run = "2 sweeps"
[[steps]]
text = "Again."
"""


@pytest.fixture
def written(tmp_path):
    """Function that writes a lesson in which one piece of text is replaced, and returns its path."""

    def write(old="", new=""):
        assert old in GOOD
        path = tmp_path / "mine.toml"
        path.write_text(GOOD.replace(old, new, 1) if old else GOOD, encoding="utf-8")
        return path

    return write


def test_a_lesson_is_read_as_written(written):
    lesson = load_lesson(written())
    first, second = lesson.steps
    assert (lesson.title, lesson.name) == ("Mine", "mine")
    assert (first.choices, first.answer, first.reveal) == (("one", "two"), 2, "Two.")
    assert first.page.modes == "1-5" and first.then == LessonSetting(run="2 sweeps")
    targets = [lessons.run_target(run) for run in ("end", "1 step", "3 sweeps", "12 stages")]
    assert targets == [("end", 0), ("step", 1), ("sweep", 3), ("stage", 12)]
    assert second == lessons.LessonStep("Again.")


def test_a_step_changes_the_last_scene_named(written, edited):
    lesson = load_lesson(written('text = "Again."', 'text = "Again."\n[steps.page]\nchanges = { "seed" = 4 }'))
    scene, seed = lesson.start(0)
    assert (scene.name, scene.solver.name, seed) == ("tiny", "descent", 0)
    scene, seed = lesson.start(1)
    assert (scene.solver.name, seed) == ("robust", 4), "the changes apply to the scene as it is in its file"
    edited({"title": '"Other"'}, "beside")
    beside = load_lesson(written('scene = "tiny"', 'scene = "beside.toml"'))
    assert beside.start(0)[0].title == "Other", "a scene beside the lesson is found"
    measured = load_lesson(written('"tiny"\nchanges = { "solver.name" = "descent" }', '"frl_array"'))
    assert measured.start(0)[0].name == "frl_array", "a scene that is a measurement needs no room"
    unchanged = load_lesson(written())
    assert unchanged.start(0) == unchanged.start(0, revealed=True) == unchanged.start(1)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('title = "Mine"', "", "title is missing; add it to the lesson"),
        ('title = "Mine"', 'title = "Mine"\nname = "x"', "name is not a key of a lesson"),
        ('text = "Look."', 'txt = "Look."', 'steps[1].txt is not a key of a lesson; did you mean "steps[1].text"'),
        ('text = "Again."', 'text = "Again."\nreveal = "x"', "steps[2].reveal has no question before it"),
        ('text = "Again."', 'text = " "', "steps[2].text is empty"),
        ("answer = 2", "answer = 3", "steps[1].answer = 3 is none of the 2 choices"),
        ('choices = ["one", "two"]', 'choices = ["one"]', "steps[1].choices has 1 entries"),
        ('reveal = "Two."', "", "steps[1].reveal"),
        ('scene = "tiny"', "", "steps[1].page.scene is missing; name the scene"),
        ('scene = "tiny"', 'scene = ""', "steps[1].page.scene is missing; name the scene"),
        ('scene = "tiny"', 'scene = "huge"', '"huge" is unknown'),
        ('scene = "tiny"', 'scene = "none.toml"', "cannot read scene"),
        ('"solver.name" = "descent"', '"solver.nme" = "descent"', "solver.nme is not a key of a scene"),
        ('modes = "1-5"', 'modes = "5-1"', 'steps[1].page.modes = "5-1"'),
        ('modes = "1-5"', 'map_modes = "x"', 'steps[1].page.map_modes = "x"'),
        ('modes = "1-5"', 'map = "hilly"', 'steps[1].page.map = "hilly" is unknown; use one of flat, relief'),
        ('modes = "1-5"', 'map = "volume"', 'steps[1].page.map = "volume" needs an array in space; name a scene'),
        ('modes = "1-5"', 'view = "up"', 'steps[1].page.view = "up" is unknown'),
        ("microphone = 3", "microphone = 16", "page.microphone = 16 does not exist; tiny has microphones 0 to 15"),
        ("microphone = 3", "marks = [3, 16]", "steps[1].page.marks = 16 does not exist; tiny has microphones 0 to 15"),
        ('modes = "1-5"', 'frame = "step=1&stage=2"', 'steps[1].page.frame: the address has "stage=2"'),
        ('run = "2 sweeps"', 'run = "end"\nframe = "step=3"', "steps[1].then.frame and run are both given"),
        ('run = "2 sweeps"', 'run = "2 rounds"', 'steps[1].then.run = "2 rounds" is unknown'),
        ("[[steps]]", "[steps]", "is not valid TOML"),
    ],
)
def test_an_error_in_a_lesson_is_reported_in_one_line(written, old, new, words):
    path = written(old, new)
    said = str(refuses("", load_lesson, path))
    assert words in said and str(path) in said


@pytest.mark.parametrize(
    ("text", "setting"),
    [
        ("stage=2", LessonSetting()),
        ("sweep=0&map=none&trails=on", LessonSetting(map="none", trails=True)),
        ("microphone=7&modes=2-5&view=close", LessonSetting(microphone=7, follow=False, map_modes="2-5", view="close")),
        ("microphone=none&modes=solver&view=-30,40.5&theme=dark", LessonSetting(map_modes="solver", view="3d")),
        ("view=1,2,30,1,2,0,0,1,0,0.02", LessonSetting()),
    ],
)
def test_a_step_sets_what_an_address_names(text, setting):
    for frame in (text, f"#{text}"):
        assert replace(LessonSetting(frame=frame).unfolded(), frame=None) == setting
    own = LessonSetting(frame=text, microphone=3).unfolded()
    assert own.microphone == 3, "a key of the table overrides the frame"


def test_a_lesson_given_on_the_command_line_is_checked_before_a_page_opens(written, refused):
    for name, code, words in (
        (written("answer = 2", "answer = 3"), 2, "steps[1].answer = 3"),
        ("many_minima", 2, 'did you mean "1_many_minima"'),
        ("none.toml", 3, "cannot read lesson"),
    ):
        assert words in refused("view", "--lesson", name, "--no-browser", code=code)
