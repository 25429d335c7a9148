"""Files of another kind than a command takes: one line says what the file is and where it belongs."""

import re

import pytest

import fdcal
from fdcal.commands.cli import main


@pytest.fixture
def error(capsys):
    """Function that runs a command and returns its only line on standard error; it must fail as bad input."""

    def run(*arguments: object) -> str:
        with pytest.raises(SystemExit) as ended:
            main([str(argument) for argument in arguments])
        assert ended.value.code == 2
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


def test_the_version(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert not ended.value.code
    assert re.fullmatch(r"fdcal \d+\.\d+\.\d+\n", capsys.readouterr().out)


def test_what_belongs_to_the_import_is_said(error):
    assert "fdcal import INPUT -o FILE.npz --known FILE.csv" in error("calibrate", "tiny", "--known", "known.csv")
    assert "it is an option of fdcal import" in error("calibrate", "tiny", "--temperature", "21")
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
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    line = capsys.readouterr().err
    assert ended.value.code == 3
    assert re.search(r"cannot read (scene )?gone\.\w+: No such file or directory", line)
