"""Bad input and files of another kind: exit code 2, one line that names value and remedy."""

import io
import json
import re
import tokenize
from pathlib import Path

import numpy as np
import pytest

from fdcal.commands.cli import commands
from fdcal.commands.options import OPTIONS

LAYOUT = "rectangle 4x4 0.5x0.5"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nothing"], ["nothing"]),
        (["view", "--port", "65536"], ["port = 65536", "out of range", "--port 0"]),
        (["view", "--host", "no such host"], ["host = no such host", "127.0.0.1"]),
        (["view", "nowhere"], ['"nowhere" is unknown', "tiny"]),
        (["calibrate", "array1"], ["did you mean array1_circle?"]),
        (["simulate", "tiny"], ["-o"]),
        (["simulate", "tiny", "-o", "tiny.mat"], ["tiny.mat", ".npz"]),
        (["simulate", "old.npz", "-o", "new.npz"], ["old.npz", "give a scene"]),
        (["calibrate", "tiny", "--modes", "10000"], ["solver.modes = 10000", "use at most"]),
        (["calibrate", "tiny", "--solver", "joint+descent"], ["'--solver'", "'descent', 'joint', 'robust'"]),
        (["calibrate", "tiny", "--known", "some"], ["; use --known all, minimal, none", "import INPUT"]),
        (["calibrate", "tiny", "--noise", "nan"], ['solver.noise = "nan" is unknown', '"auto"', "decibels"]),
        (["calibrate", "tiny", "--solver", "descent", "--known", "none"], ['solver.known = "none"', "--known all"]),
        (["landscape", "tiny", "--microphone", "16", "-o", "f.png"], ['"16" is not', "--microphone", "0 to 15"]),
        (["snapshot", "tiny", "--size", "big", "-o", "f.png"], ["'--size'", '"big"', "1280x800"]),
        (["snapshot", "tiny", "--size", "100x1000000", "-o", "f.png"], ["'--size'", "100x1000000", "64 to 8192"]),
        (["snapshot", "tiny", "-o", "."], [".png"]),
        (["calibrate", "tiny", "--solver", "joint", "--gains", "fixed"], ["--solver robust"]),
        (["calibrate", "tiny", "--start", "affine"], ["leave out --start"]),
        (["calibrate", "tiny", "--gains", "fixed", "--gain-sigma", "1dB,5deg"], ["--gains auto"]),
        (["calibrate", "tiny", "--gain-sigma", "1..2dB,5deg"], ["example 1dB,5deg"]),
        (["calibrate", "tiny", "--known-sigma", "5"], ["example 5mm"]),
        (["calibrate", "tiny", "--sound-speed-sigma", "0.3"], ["0.3%"]),
        (["calibrate", "tiny", "--distance", "0,4,1"], ["--distance", "without known"]),
        (["calibrate", "tiny", "--solver", "descent", "--noise", "30"], ["--noise", "--solver joint"]),
        (["calibrate", "tiny", "--temperature", "21"], ["tiny holds no recordings; leave out --temperature"]),
        (["plan", "nothing"], ['"nothing" names no array', '"circle 16 0.2"']),
        (["plan", "ball 32 0.3x0.4"], ['"ball 32 0.3x0.4" is not a geometry; write it as']),
        (["plan", LAYOUT, "--frequencies", "all"], ["is not a band; write LO:HI"]),
        (["plan", LAYOUT, "--room", "lshape"], ["'--room'", "example 6x5 or 6x5x2.7"]),
    ],
)
def test_bad_arguments_exit_2(arguments, words, refused):
    line = refused(*arguments)
    for word in words:
        assert word in line


def test_bad_measurements_exit_2(altered, made, refused):
    """Each key that may be wrong is tested where a measurement is read."""
    with np.load(made / "tiny.npz") as archive:
        path = altered(pressures=archive["pressures"] * (np.arange(16) > 0))
        for command in (["calibrate", path, "-o", "new.json"], ["landscape", path, "--microphone", 9, "-o", "new.png"]):
            assert '"0"' in (line := refused(*command)) and "zero" in line


def test_bad_results_exit_2(made, tmp_path, refused):
    """Each key that may be wrong is tested where a result is read."""
    drawing = ["landscape", "tiny", "--microphone", 0, "-o", "f.png", "--result"]
    result = json.loads((made / "result.json").read_text())
    (tmp_path / "few.json").write_text(json.dumps(result | {"positions": [[0.5, 0.5]], "uncertainty_m": [0.0]}))
    assert '"names" must be of shape (1,)' in refused(*drawing, "few.json")
    assert "gone.json" in refused(*drawing, "gone.json", code=3)
    assert "frl_array" not in refused("simulate", "old.npz", "-o", "new.npz"), "a measured scene cannot be simulated"


# A command refuses a file of another kind: one line says what the file is and which command reads it.


@pytest.mark.parametrize(("name", "content", "arguments", "words"), [
    ("g.csv", b"name,x,y\n0,1,2\n", ["calibrate", "g.csv"], "is a table of positions; give it as --positions"),
    ("result.json", b"{}", ["calibrate", "result.json"], "fdcal export"),
    ("samples.csv", b"1,2\n3,1\n" * 9, ["view", "samples.csv"], "give --rate in Hz (an option of fdcal calibrate)"),
    ("notes.md", b"", ["calibrate", "."], "is a folder in which no recordings were found"),
    ("room.npz", b"PK\x03\x04", ["export", "room.npz", "-o", "out.csv"], "is not a result; give the .json file"),
    ("empty.wav", b"", ["import", "empty.wav", "-o", "out.npz"], "that can be read: the file is empty"),
])  # fmt: skip
def test_a_file_of_another_kind_is_named_as_such(tmp_path, refused, name, content, arguments, words):
    (tmp_path / name).write_bytes(content)
    assert words in refused(*arguments)


@pytest.mark.parametrize(("arguments", "words"), [
    (["calibrate", "gone.json"], r"cannot read scene gone\.json: No such file or directory"),
    (["calibrate", "gone.wav"], r"gone\.wav: No such file or directory"),
    (["calibrate", "gone.npz"], r"cannot read gone\.npz: No such file or directory"),
    (["plan", "gone.csv"], r"cannot read gone\.csv: No such file or directory"),
    (["simulate", "gone.toml", "-o", "new.npz"], r"cannot read scene gone\.toml: No such file or directory"),
    (["simulate", "tiny", "-o", "gone/new.npz"], "mkdir"),
])  # fmt: skip
def test_files_and_folders_that_are_not_there_exit_3(refused, arguments, words):
    assert re.search(words, refused(*arguments, code=3))


# Errors below the command line name arguments; the command line names its own options instead.


PACKAGE = Path(__file__).parents[2] / "fdcal"
BELOW = [path for path in sorted(PACKAGE.rglob("*.py")) if "commands" not in path.relative_to(PACKAGE).parts]
OPTION = re.compile(r"(?<![\w-])--[a-z][\w-]*")
STYLE = re.compile(r"var\(--[\w-]+|--[\w-]+ *:|<!--\S+")  # matches variables of a style sheet and comments of a page
ALLOWED = {  # the page says how to list the commands; git has the other options
    "model/storage.py": {"--format", "--porcelain"},
    "viewer/tabs/help.py": {"--help"},
}


TEXTS = (tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", tokenize.STRING))


def test_no_text_below_the_command_line_holds_one_of_its_options():
    for path in BELOW:
        name = path.relative_to(PACKAGE).as_posix()
        for text in tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline):
            if text.type in TEXTS and not text.line.lstrip().startswith('"""'):
                found = set(OPTION.findall(STYLE.sub("", text.string))) - ALLOWED.get(name, set())
                assert not found, f"{name}:{text.start[0]}: {found}; name the argument in angle brackets"


def test_every_argument_that_a_remedy_names_has_an_option_and_every_option_is_there():
    texts = "".join(path.read_text(encoding="utf-8") for path in BELOW if not {"viewer", "graphics"} & {*path.parts})
    tags, of_python = {"i", "pos"}, {"wavenumbers", "search", "radius"}
    named = set(re.findall(r"<([a-z_]+)>", texts)) - tags - of_python
    known = {option for command in commands.commands.values() for one in command.params for option in one.opts}
    assert len(named) > 10 and named <= set(OPTIONS)
    assert {wording.split()[0] for wording in OPTIONS.values()} <= known
