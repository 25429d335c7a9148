"""Errors below the command line name arguments, and the command line words each of them as its own option."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import click

from fdcal.commands.cli import commands
from fdcal.commands.options import OPTIONS

PACKAGE = Path(__file__).parents[2] / "fdcal"
BELOW = [path for path in sorted(PACKAGE.rglob("*.py")) if "commands" not in path.relative_to(PACKAGE).parts]
OPTION = re.compile(r"(?<![\w-])--[a-z][\w-]*")
ALLOWED = {  # the page says how to list the commands; a variable of the style sheet; options of git
    "session/study/definition.py": {"--format", "--porcelain"},
    "recordings/import_options.py": {"--subset"},  # a help text, declared beside the option
    "viewer/tabs/help.py": {"--help"},
    "viewer/gui/legend_html.py": {"--mantine-color-body"},
}


def texts(tree: ast.AST) -> Iterator[ast.Constant]:
    """Every string of a module but its docstrings."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docstrings = {id(node.body[0].value) for node in ast.walk(tree) if isinstance(node, documented)
                  and node.body and isinstance(node.body[0], ast.Expr)}  # fmt: skip
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            yield node


def remedies(tree: ast.AST) -> Iterator[str]:
    """Every piece of text in the remedy of an InputError."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "InputError":
            given = [*node.args[1:2], *(k.value for k in node.keywords if k.arg == "remedy")]
            yield from (text.value for part in given for text in texts(part))


def test_no_text_below_the_command_line_holds_one_of_its_options():
    for path in BELOW:
        name = path.relative_to(PACKAGE).as_posix()
        for text in texts(ast.parse(path.read_text(encoding="utf-8"))):
            found = set(OPTION.findall(text.value)) - ALLOWED.get(name, set())
            assert not found, f"{name}:{text.lineno}: {found}; name the argument in angle brackets"


def test_every_argument_that_a_remedy_names_has_an_option():
    named = {
        name
        for path in sorted(PACKAGE.rglob("*.py"))
        for remedy in remedies(ast.parse(path.read_text(encoding="utf-8")))
        for name in re.findall(r"<([a-z_]+)>", remedy)
    }
    assert named
    assert named <= set(OPTIONS)


def test_every_wording_is_an_option_of_a_command():
    known = {
        option
        for command in commands.commands.values()
        for parameter in command.params
        if isinstance(parameter, click.Option)
        for option in parameter.opts
    }
    assert {wording.split()[0] for wording in OPTIONS.values()} <= known
