"""docs/: options and files that it names are there, and it names all options of import."""

from __future__ import annotations

import re
from pathlib import Path

from fdcal import formats
from fdcal.cli import commands

TEXT = (Path(__file__).parent.parent / "docs" / "bring-your-recording.md").read_text(encoding="utf-8")


def options(name: str) -> set[str]:
    return {text for option in commands.commands[name].params for text in option.opts if text.startswith("-")}


def test_every_option_told_is_there():
    known = options("import") | options("calibrate") | options("export")
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", TEXT)) <= known


def test_every_option_of_import_is_told():
    for option in options("import") - {"-o", "--output", "--force", "--seed"}:
        assert f"`{option}" in TEXT, option


def test_every_suffix_of_positions_is_told():
    for suffix in formats.suffixes("write"):
        assert f"| `{suffix}` |" in TEXT
