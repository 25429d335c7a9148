"""Bad input and files of another kind: exit code 2, one line that names value and remedy."""

import ast
import functools
import json
import re
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np
import pytest
from running import exit_code

import fdcal
from fdcal.assessment.result_file import REQUIRED
from fdcal.commands.cli import commands
from fdcal.commands.options import OPTIONS


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nothing"], ["nothing"]),
        (["view", "--port", "65536"], ["--port 65536", "out of range"]),
        (["view", "--port", "-1"], ["--port -1", "out of range"]),
        (["view", "--port", "eighty"], ["--port", "eighty"]),
        (["view", "--host", "no such host"], ["--host", "127.0.0.1"]),
        (["view", "--host", ""], ["--host", "127.0.0.1"]),
        (["view", "--host", "203.0.113.1"], ["--host", "203.0.113.1", "127.0.0.1"]),
        (["view", "nowhere"], ['"nowhere" is unknown', "tiny"]),
        (["simulate", "tiny"], ["-o"]),
        (["simulate", "tiny", "-o", "tiny.mat"], ["tiny.mat", ".npz"]),
        (["simulate", "old.npz", "-o", "new.npz"], ["old.npz", "give a scene"]),
        (["calibrate", "tiny", "--modes", "0"], ["modes = 0", "use 1"]),
        (["calibrate", "tiny", "--modes", "10000"], ["solver.modes = 10000", "use at most"]),
        (["calibrate", "tiny", "--seed", "-4"], ["seed = -4", "0 or more"]),
        (
            ["calibrate", "tiny", "--solver", "magic"],
            ["'--solver'", "'magic'", "'descent', 'joint', 'robust', 'room'"],
        ),
        (
            ["calibrate", "tiny", "--solver", "joint+descent"],
            ["'--solver'", "'joint+descent' is not one of", "'descent', 'joint'"],
        ),
        (["calibrate", "tiny", "--modes", "3"], ["3 modes are too few", "26 unknown coordinates", "use at least 6"]),
        (["calibrate", "tiny", "--start", "zero"], ["'--start'", "'zero'", "'affine', 'random'"]),
        (["calibrate", "tiny", "--known", "some"], ["'--known'", "'some'", "'all', 'minimal', 'none'"]),
        (
            ["calibrate", "tiny", "--noise", "much"],
            ["'--noise'", '"much" is unknown', '"auto", "reported"', "decibels"],
        ),
        (["calibrate", "tiny", "--noise", "nan"], ["'--noise'", '"nan" is unknown', "decibels"]),
        (["calibrate", "tiny", "--noise", "301"], ["'--noise'", '"301" is unknown', "decibels"]),
        (["calibrate", "tiny", "--solver", "descent", "--known", "none"], ['solver.known = "none"', "--known all"]),
        (["calibrate", "tiny", "--solver", "descent", "--known", "minimal"], ['"minimal"', "--solver joint"]),
        (["calibrate", "tiny", "--search", "0,0,1,1"], ["--search 0,0,1,1", "4 numbers", "give 5", "step"]),
        (["calibrate", "tiny", "--search", "0,0,1,1,fine"], ["--search", "no list of numbers"]),
        (["calibrate", "tiny", "--search", "0,0,1,-1,0.1"], ["search.size = -1 m", "above zero"]),
        (["calibrate", "tiny", "--search", "0,0,nan,1,0.1"], ["search.size = nan"]),
        (["calibrate", "tiny", "--radius", "-1"], ["search.radius = -1 m", "above zero"]),
        (
            ["calibrate", "tiny", "--solver", "descent", "--radius", "4"],
            ["2L + 1 =", "16 microphones; use a search.radius below 4 m"],
        ),
        (
            ["calibrate", "tiny", "--solver", "descent", "--radius", "0.5"],
            ["search.radius = 0.5 m", "(solver.modes; 20 asked for)", "below 2"],
        ),
        (["landscape", "tiny", "--microphone", "16", "-o", "f.png"], ["--microphone 16", "0 to 15"]),
        (["landscape", "tiny", "--microphone", "-1", "-o", "f.png"], ["--microphone -1", "0 to 15"]),
        (["landscape", "tiny", "--microphone", "0", "--mode-numbers", "0", "-o", "f.png"], ["mode 0", "1 to"]),
        (["landscape", "tiny", "--microphone", "0", "--mode-numbers", "1;2", "-o", "f.png"], ["whole numbers"]),
        (["landscape", "tiny", "--microphone", "0", "--radius", "4", "-o", "f.png"], ["2L + 1 ="]),
        (["snapshot", "tiny", "--size", "big", "-o", "f.png"], ["'--size'", '"big"', "1280x800"]),
        (["snapshot", "tiny", "--size", "1x1", "-o", "f.png"], ["'--size'", '"1x1"', "64 to 8192"]),
        (["snapshot", "ball3d", "--slice", "w=1", "-o", "f.png"], ["--slice", "w=1", "x=1.5"]),
        (["snapshot", "tiny", "--view", "side", "-o", "f.png"], ["side", "top"]),
        (["snapshot", "tiny", "-o", "."], [".png"]),
    ],
)
def test_bad_arguments_exit_2(arguments, words, refused):
    line = refused(*arguments)
    for word in words:
        assert word in line


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"room.sise": "[1, 1]"}, ["room.sise", 'did you mean "room.size"']),
        ({"solver.name": '"descent"', "solver.order_offset": "30"}, ["2L + 1 =", "16 microphones"]),
    ],
)
def test_bad_scene_exits_2(edited, changes, words, tmp_path, refused):
    line = refused("calibrate", edited(changes), "-o", "result.json")
    for word in words:
        assert word in line


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: {"pressures": t["pressures"].real}, ["real", "complex"]),
        (lambda t: {"pressures": t["pressures"][:, :-1]}, ["names must be 15"]),
        (lambda t: {"pressures": t["pressures"] * np.nan}, ["pressures", "finite"]),
        (lambda t: {"pressures": t["pressures"] * (np.arange(16) > 0)}, ['"0"', "zero"]),
        (lambda t: {"radius": None}, ["search_origin", "radius"]),
        (lambda t: {"dimension": 3, "array_dimension": 2}, ["two-dimensional", "dimension = 3"]),
        (lambda t: {"dimension": 4}, ["dimension", "2, 3"]),
        (lambda t: {"known": t["known"] + 100}, ["known", "0 to 15"]),
        (lambda t: {"known": t["known"][:2], "known_positions": t["known_positions"][:2]}, ["known = [0, 5]", "three"]),
        (lambda t: {"known": None, "known_positions": None}, ["known = []", "three"]),
    ],
)
def test_bad_measurement_exits_2(altered, made, change, words, refused):
    with np.load(made / "tiny.npz") as archive:
        path = altered(**change(dict(archive)))
    descent = ["calibrate", path, "--solver", "descent", "-o", "new.json"]
    for command in (descent, ["landscape", path, "--microphone", 9, "-o", "new.png"]):
        if command[0] == "calibrate" or "three" not in words:  # a landscape needs no gauge
            line = refused(*command)
            for word in words:
                assert word in line


def test_bad_results_exit_2(made, tmp_path, refused):
    drawing = ["landscape", "tiny", "--microphone", 0, "-o", "f.png", "--result"]
    (tmp_path / "text.json").write_text("{")
    (tmp_path / "empty.json").write_text("{}")
    (tmp_path / "few.json").write_text(json.dumps({"positions": [[0, 0]]}))
    assert "not valid JSON" in refused(*drawing, "text.json")
    assert 'no "positions"' in refused(*drawing, "empty.json")
    assert 'no "solver"' in refused(*drawing, "few.json")
    result = json.loads((made / "result.json").read_text())
    few = {key: result[key] for key in REQUIRED} | {"positions": [[0.5, 0.5]], "uncertainty_m": [0.0]}
    (tmp_path / "few.json").write_text(json.dumps(few))
    assert "shape (1, 2)" in refused(*drawing, "few.json")
    assert "gone.json" in refused(*drawing, "gone.json", code=3)


# Files of another kind than a command takes: one line says what the file is and where it belongs.


@pytest.fixture
def error(capsys):
    """Function that runs a command and returns its only line on standard error; it must fail as bad input."""

    def run(*arguments: object) -> str:
        assert exit_code(*arguments) == 2
        lines = capsys.readouterr().err.strip().splitlines()
        assert len(lines) == 1
        return lines[0]

    return run


def test_a_table_or_a_result_is_no_scene(error, tmp_path):
    (tmp_path / "geometry.csv").write_text("name,x,y\n0,1,2\n")
    (tmp_path / "result.json").write_text("{}")
    assert "is a table" in error("calibrate", tmp_path / "geometry.csv")
    assert "fdcal export" in error("calibrate", tmp_path / "result.json")
    assert "is a folder in which no recordings were found" in error("calibrate", tmp_path)


def test_a_measurement_is_no_result(error, tmp_path):
    (tmp_path / "room.npz").write_bytes(b"PK\x03\x04")
    message = error("export", tmp_path / "room.npz", "-o", tmp_path / "out.csv")
    assert re.search(r"is not a result; give the .json file that `fdcal calibrate -o` writes", message)


def test_an_empty_sound_file(error, tmp_path):
    (tmp_path / "empty.wav").touch()
    message = error("import", tmp_path / "empty.wav", "-o", tmp_path / "out.npz")
    assert message.endswith("the file is empty")
    assert "b'" not in message


def test_python_is_told_what_to_load():
    with pytest.raises(fdcal.InputError, match="load it first"):
        fdcal.calibrate("tiny")
    with pytest.raises(fdcal.InputError, match="not int"):
        fdcal.load(3)


def test_what_belongs_to_the_import_is_said(error):
    assert "fdcal import INPUT -o FILE.npz --known FILE.csv" in error("calibrate", "tiny", "--known", "known.csv")
    assert "tiny holds no recordings; leave out --temperature" in error("calibrate", "tiny", "--temperature", "21")
    assert "it is an option of fdcal import" in error("calibrate", "tiny", "--window", "none")
    assert "it is an option of" not in error("calibrate", "tiny", "--magic", "21")


@pytest.mark.parametrize(
    "arguments",
    [
        ["calibrate", "gone.json"],
        ["calibrate", "gone.npz"],
        ["import", "gone.wav", "-o", "a.npz"],
        ["plan", "gone.csv"],
    ],
)
def test_a_file_that_is_not_there_is_named_alike_everywhere(capsys, arguments):
    ended = exit_code(*arguments)
    line = capsys.readouterr().err
    assert ended == 3
    assert re.search(r"cannot read (scene )?gone\.\w+: No such file or directory", line)


def test_every_option_of_one_number_refuses_nan_and_infinity():
    seen = 0
    for command in commands.commands.values():
        for option in (one for one in command.params if isinstance(one.type, click.types.FloatParamType)):
            seen += 1
            for value in ("nan", "inf", "-inf"):
                with pytest.raises(click.BadParameter, match=r"is no finite number|is not in the range"):
                    option.type.convert(value, option, None)
    assert seen > 10


# Errors below the command line name arguments, and the command line words each of them as its own option.


PACKAGE = Path(__file__).parents[2] / "fdcal"
BELOW = [path for path in sorted(PACKAGE.rglob("*.py")) if "commands" not in path.relative_to(PACKAGE).parts]
OPTION = re.compile(r"(?<![\w-])--[a-z][\w-]*")
STYLE = re.compile(r"var\(--[\w-]+|--[\w-]+ *:|<!--\S+")  # variables of a style sheet, and comments of a page
ALLOWED = {  # the page says how to list the commands; options of git
    "model/code_version.py": {"--format", "--porcelain"},
    "recordings/import_options.py": {"--subset"},  # a help text, declared beside the option
    "viewer/tabs/help.py": {"--help"},
}


@functools.cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


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
        for text in texts(parsed(path)):
            found = set(OPTION.findall(STYLE.sub("", text.value))) - ALLOWED.get(name, set())
            assert not found, f"{name}:{text.lineno}: {found}; name the argument in angle brackets"


def test_every_argument_that_a_remedy_names_has_an_option():
    named = {
        name
        for path in sorted(PACKAGE.rglob("*.py"))
        for remedy in remedies(parsed(path))
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
