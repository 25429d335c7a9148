"""docs/: options and files that it names are there, and it names all options of import."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest

from fdcal.commands.cli import commands
from fdcal.recordings import formats
from fdcal.session.lesson import MAPS, SCALES, VIEWS, Lesson, Setting, Step
from fdcal.session.lesson_file import load_lesson

DOCS = Path(__file__).parent.parent / "docs"
TEXT = (DOCS / "bring-your-recording.md").read_text(encoding="utf-8")
LESSONS = (DOCS / "lessons.md").read_text(encoding="utf-8")


def options(name: str) -> set[str]:
    return {text for option in commands.commands[name].params for text in option.opts if text.startswith("-")}


def test_every_option_told_is_there():
    known = options("import") | options("calibrate") | options("export")
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", TEXT)) <= known


def test_every_option_of_import_is_documented():
    for option in options("import") - {"-o", "--output", "--force", "--seed"}:
        assert f"`{option}" in TEXT, option


def test_every_suffix_of_positions_is_told():
    for suffix in formats.suffixes("write"):
        assert f"| `{suffix}` |" in TEXT


def test_the_worked_example_can_be_loaded_and_its_error_is_the_documented_one(tmp_path):
    (example,) = re.findall(r"```toml\n(.*?)```", LESSONS, re.DOTALL)
    path = tmp_path / "mine.toml"
    path.write_text(example, encoding="utf-8")
    lesson = load_lesson(path)
    assert lesson.start(0, revealed=True)[0].room.walls == "pressure-release"
    (documented,) = re.findall(r"error: mine.toml: (.*)\n", LESSONS)
    path.write_text(example.replace("answer = 2", "answer = 4"), encoding="utf-8")
    with pytest.raises(ValueError, match=re.escape(documented)):
        load_lesson(path)


def test_every_key_of_a_lesson_is_documented():
    fields = {field.name for kind in (Lesson, Step) for field in dataclasses.fields(kind)} - set(Lesson.OPTIONAL)
    for key in fields - {"page", "then", "steps"} | set(Setting.OPTIONAL):
        assert f"`{key}`" in LESSONS, key
    for value in (*MAPS, *SCALES, *VIEWS):
        assert f'`"{value}"`' in LESSONS, value
    assert "`--lesson" in LESSONS or "--lesson mine.toml" in LESSONS
