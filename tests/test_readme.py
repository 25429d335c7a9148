"""The README does what it says: its example runs, and it names what is there."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import click
import pytest

from fdcal.commands.cli import commands
from fdcal.model.measurement_file import OPTIONAL, REQUIRED, SEARCH
from fdcal.model.scene_file import scene_names

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")


def test_python_example_runs_and_finds_the_array(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    exec(compile(example, "README.md", "exec"), {})
    printed = capsys.readouterr().out
    sweeps, modes, error = re.fullmatch(r"(\d+) sweeps, (\d+) modes, mean error ([\d.]+) mm\n", printed).groups()
    assert int(sweeps) > 0
    assert int(modes) == 36, "all that the scene has"
    assert float(error) < 40, "within two steps of the search lattice"


@pytest.mark.parametrize("name", scene_names())
def test_every_scene_is_told(name):
    assert f"| `{name}` |" in TEXT


@pytest.mark.parametrize("name", sorted(commands.commands))
def test_every_command_is_documented_with_its_options(name):
    (usage,) = re.findall(rf"^\| `fdcal {name}([^`]*)` \|", TEXT, re.MULTILINE)
    known = {text for option in commands.commands[name].params for text in option.opts if text.startswith("-")}
    documented = set(re.findall(r"(?<![\w-])--?[a-z-]+", usage))
    assert documented <= known
    required = [p for p in commands.commands[name].params if isinstance(p, click.Option) and p.required]
    for option in required:
        assert documented & set(option.opts)


@pytest.mark.parametrize("key", REQUIRED + OPTIONAL + SEARCH)
def test_every_key_of_the_measurement_file_is_documented(key):
    assert f"`{key}`" in TEXT


def test_every_dependency_has_its_reason():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    table = TEXT[TEXT.index("## Dependencies") :]
    for requirement in project["dependencies"] + project["optional-dependencies"]["test"]:
        name = re.match(r"[\w-]+", requirement).group()
        assert re.search(rf"^\|[^|]*\b{name}\b[^|]*\|", table, re.MULTILINE), f"{name} is not explained"


def test_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#:]+)\)", TEXT):
        assert (ROOT / target).exists(), target
