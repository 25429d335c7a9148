"""docs/: its commands run, all that it names exists, and it names everything that a reader may look for."""

import dataclasses
import inspect
import json
import re
import tomllib
from typing import get_args

import click
import pytest
from PIL import Image

import fdcal
from benchmarks.documents import ALL, DOCS, ROOT, name_of, text_of
from fdcal.assessment.calibration import ChannelFault
from fdcal.assessment.findings import FINDINGS
from fdcal.assessment.result_file import GivenRow, ResultTable
from fdcal.commands.cli import commands
from fdcal.model.address import Map, View
from fdcal.model.measurement import OPTIONAL, REQUIRED, SEARCH
from fdcal.model.scene import scene_names
from fdcal.recordings import formats
from fdcal.session.lesson import Lesson, LessonSetting, LessonStep, Quantity, Scale, load_lesson
from fdcal.solvers import names as solver_names
from fdcal_bench.command import study

RECORDING = text_of(DOCS / "how-to" / "bring-your-recording.md")
LESSONS = text_of(DOCS / "how-to" / "write-a-lesson.md")
COMMANDS = text_of(DOCS / "reference" / "command-line.md")
FILES = text_of(DOCS / "reference" / "files.md")
VERDICTS = text_of(DOCS / "reference" / "verdicts.md")
DEPENDENCIES = text_of(DOCS / "reference" / "dependencies.md")
PICTURES = sorted((DOCS / "pictures").iterdir())


EVERY_COMMAND = {**commands.commands, "study": study}


def options(name: str) -> set[str]:
    return {text for option in EVERY_COMMAND[name].params for text in option.opts if text.startswith("-")}


@pytest.mark.parametrize("page", ALL, ids=name_of)
def test_every_command_and_option_of_a_page_is_there(page):
    for line in re.findall(r"(?:^|`|&& |\.venv/bin/)fdcal ((?!COMMAND)[a-z]+[^`\n]*)", text_of(page), re.MULTILINE):
        name = line.split()[0]
        assert name in EVERY_COMMAND, line
        given = set(re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*", line.partition(" && ")[0]))
        assert given <= options(name) | {"--debug", "--help"}, line


@pytest.mark.parametrize("page", ALL, ids=name_of)
def test_links_lead_somewhere_and_every_picture_has_a_text_for_those_who_cannot_see_it(page):
    text = text_of(page)
    for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text):
        assert (page.parent / target).exists(), target
    assert text.count("```{image}") == len(re.findall(r"```\{image\} [^\n]*\n:alt: \S", text)) and "![](" not in text


@pytest.mark.parametrize("picture", PICTURES, ids=lambda path: path.name)
def test_a_picture_is_small_is_shown_and_can_be_made_again(picture):
    film = picture.suffix == ".webp"
    assert picture.stat().st_size < (2_000_000 if film else 200_000)
    assert sum(each.stat().st_size for each in PICTURES) < 3_000_000
    assert any(f"pictures/{picture.name}" in text_of(page) for page in ALL)
    assert f'"{picture.name if film else picture.stem}"' in text_of(DOCS / ("film.py" if film else "pictures.py"))
    with Image.open(picture) as image:
        assert image.format == ("WEBP" if film else "PNG")


def lesson_keys() -> set[str]:
    """Keys of a lesson, of its steps, and of what a step shows."""
    own = {field.name for kind in (Lesson, LessonStep) for field in dataclasses.fields(kind)} - set(Lesson.OPTIONAL)
    return own - {"page", "then", "steps"} | {field.name for field in dataclasses.fields(LessonSetting)}


# Page, form of an entry, and what must have one.
NAMED = {
    "scenes": (text_of(DOCS / "reference" / "scenes.md"), "| `{}` |", scene_names()),
    "solvers": (text_of(DOCS / "reference" / "solvers.md"), "| `{}` |", solver_names()),
    "keys of a measurement": (FILES, "`{}`", REQUIRED + OPTIONAL + SEARCH),
    "keys of a result": (
        FILES, "`{}`",
        {*ResultTable.__struct_encode_fields__, *GivenRow.__struct_fields__, *ChannelFault.__match_args__},
    ),
    "options of import": (RECORDING, "`{}", options("import") - {"-o", "--output", "--force", "--seed"}),
    "tables of positions": (RECORDING, "| `{}` |", formats.suffixes("write")),
    "keys of a lesson": (LESSONS, "`{}`", lesson_keys()),
    "values in a lesson": (LESSONS, '`"{}"`', (*get_args(Map), *get_args(Quantity), *get_args(Scale), *get_args(View))),
    "command for a lesson": (LESSONS, "{}", ["--lesson"]),
    "functions and classes": (text_of(DOCS / "reference" / "api.rst"), "\n   {}\n", fdcal.__all__),
}  # fmt: skip


@pytest.mark.parametrize(("text", "entry", "names"), NAMED.values(), ids=NAMED)
def test_a_page_has_an_entry_for_every_name(text, entry, names):
    assert names and [name for name in names if entry.format(name) not in text] == []


@pytest.mark.parametrize("name", sorted(EVERY_COMMAND))
def test_every_command_is_documented_with_its_options(name):
    assert ".. click:: fdcal.commands.cli:commands" in COMMANDS, "the reference is generated from the code"
    (usage,) = re.findall(rf"^\| `fdcal {name}\b(.*?)` \| ", COMMANDS, re.MULTILINE)  # or several usages
    documented = set(re.findall(r"(?<![\w-])--?[a-z][a-z0-9-]*", usage))
    assert documented <= options(name)
    required = [p for p in EVERY_COMMAND[name].params if isinstance(p, click.Option) and p.required]
    for option in required:
        assert documented & set(option.opts)


def test_every_verdict_is_documented_with_a_remedy():
    codes = {one.code for one in FINDINGS}
    assert {"good", "scale_undetermined"} <= codes
    for code in codes:
        (remedy,) = re.findall(rf"^\| `{code}` \| .+ \| (.*) ?\|$", VERDICTS, re.M)
        assert remedy.strip() or code == "good", code


def test_every_dependency_has_its_reason():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    for requirement in sum(extras.values(), project["dependencies"]):
        if requirement.startswith("fdcal["):
            continue
        name = re.match(r"[\w-]+", requirement).group()
        assert re.search(rf"^\|[^|]*\b{name}\b[^|]*\|", DEPENDENCIES, re.MULTILINE), f"{name} is not explained"


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


def test_the_figures_in_the_documents_are_those_that_runs_wrote():
    from benchmarks import bench_documents as documents

    found = {key: value for page in ALL for key, value in documents.figures_in(text_of(page)).items()}
    assert found == json.loads(text_of(documents.STORE)), "python -m benchmarks documents writes them"
    assert set(found) == set(documents.FIGURES) and all(found.values())
    for key in documents.QUICK:
        assert documents.FIGURES[key]() == found[key], f"FDCAL_BENCH_KEYS={key} python -m benchmarks documents"


# What a user calls of the public classes; the rest of their methods serves other packages.
METHODS = [
    *(f"Calibration.{name}" for name in ("load", "save", "export", "to_dataframe", "plot")),
    "Measurement.from_arrays",
]


@pytest.mark.parametrize("name", [*fdcal.__all__, *METHODS])
def test_a_public_function_class_or_method_has_an_example(name):
    target = fdcal
    for part in name.split("."):
        target = getattr(target, part)
    assert ">>> " in (inspect.getdoc(target) or "")
