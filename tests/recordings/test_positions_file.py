"""Files of positions that somebody gives: Acoular's XML and tables."""

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest
import sofar
from recorded import write_places
from running import exit_code

import fdcal
from fdcal.commands import report
from fdcal.recordings.formats import sound_files
from fdcal.recordings.formats.positions import read_positions, read_table
from fdcal.session.calibration_run import solve
from fdcal.session.sources import load_input

pytestmark = pytest.mark.usefixtures("remembered_runs")

ACOULAR = """<?xml version="1.0" encoding="utf-8"?>
<MicArray name="two">
    <pos Name="Point 1" x=" 0.152" y="0.1" z="0" />
    <pos Name="Point 2" x="-1e-1" y="-0.2" z="0.05" />
</MicArray>
"""


def written(tmp_path, text: str, name: str = "g.xml"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_a_geometry_of_acoular_is_read(tmp_path):
    read = read_positions(written(tmp_path, ACOULAR))
    assert read.names == ("Point 1", "Point 2")
    np.testing.assert_array_equal(read.positions, [[0.152, 0.1, 0.0], [-0.1, -0.2, 0.05]])
    with pytest.raises(fdcal.InputError, match="suffix"):
        read_positions(written(tmp_path, ACOULAR, "g.txt"))


@pytest.mark.parametrize("names", [("", ""), ("Point 1", "Point 1")])
def test_microphones_without_names_of_their_own_are_numbered(tmp_path, names):
    text = ACOULAR.replace("Point 1", names[0]).replace("Point 2", names[1])
    assert read_positions(written(tmp_path, text)).names == ("0", "1")


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("-1e-1", "left", 'x = "left" of microphone 1'),
        ("-1e-1", "nan", 'x = "nan" of microphone 1'),
        ("-1e-1", "1_0", 'x = "1_0" of microphone 1'),
        ("-1e-1", "[" * 3000, 'x = "[['),
        ('encoding="utf-8"', 'encoding="utf' + "f" * 3000 + '"', "not valid XML"),
        ('y="-0.2"', "", 'y = "" of microphone 1'),
        ("<pos", "<mic", "no <pos>"),
        ("</MicArray>", "", "not valid XML"),
        ('encoding="utf-8"', 'encoding="nosuch"', "not valid XML"),
    ],
)
def test_a_broken_geometry_is_refused(tmp_path, old, new, problem):
    with pytest.raises(fdcal.InputError) as caught:
        read_positions(written(tmp_path, ACOULAR.replace(old, new)))
    assert problem in str(caught.value) and len(str(caught.value)) < 1000 + len(str(tmp_path))


@pytest.mark.parametrize("cell", ["1_0", "1_0.5", "٣", "nan", "inf", "1e400", "0x10", ""])
def test_what_only_python_takes_for_a_number_is_none(cell, tmp_path):
    with pytest.raises(fdcal.InputError, match="line 3"):
        read_table(written(tmp_path, f"name,x,y\na,1,2\nb,{cell},3\n", "k.csv"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "must begin with the line name,x,y"),
        ("x,y\n1,2\n", "must begin with the line name,x,y"),
        ("name,x,y\na,1\n", "line 2"),
        ("name,x,y\na,1,2\na,3,4\n", "twice"),
        ("name,x,y,elevation\na,0,0,1.5\nb,1,0,1.5\n", 'column "elevation" of numbers is not understood; call a third'),
    ],
)
def test_a_table_that_is_none_is_refused(text, words, tmp_path):
    with pytest.raises(fdcal.InputError, match=words):
        read_table(written(tmp_path, text, "k.csv"))


def test_tables_are_read_as_spreadsheets_write_them(tmp_path):
    text = "name,x,y,z\n1,0.25,+.5,1\n2, 75e-2,0.5,-1.5\n"
    names, places = read_table(written(tmp_path, text, "english.csv"))
    np.testing.assert_array_equal(places, [[0.25, 0.5, 1], [0.75, 0.5, -1.5]])
    semicolons = "name;x;y;z\n1;0,25;0,5;1\n2;0,75;0,5;-1,5\n"
    for other in (semicolons, semicolons.replace(";", "\t")):
        same, also = read_table(written(tmp_path, other, "other.csv"))
        assert names == same and np.array_equal(places, also)


@pytest.fixture
def exchanged(tmp_path):
    """Acoular's XML of the scene tiny, in which the rows of microphones 3 and 10 are exchanged."""
    places = fdcal.load("tiny").positions.tolist()
    places[3], places[10] = places[10], places[3]
    rows = [f'<pos Name="Point {n}" x="{x}" y="{y}" z="0.4"/>' for n, (x, y) in enumerate(places)]
    return written(tmp_path, f"<MicArray>{''.join(rows)}</MicArray>")


def test_exchanged_channels_are_found_with_the_positions_of_a_file_also_of_a_part_of_them(exchanged, capsys):
    for part in ((), ("--exclude", "1,2")):
        exit_code("calibrate", "tiny", *part, "--check", "--positions", exchanged)
        assert "3 (Point 3) and 10 (Point 10) are swapped" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("step", "factor", "said"), [(-1, 1, "is in reverse"), (1, 100, "in centimetres?"), (1, 1, "")]
)
def test_a_wrong_list_is_named_in_the_text_the_exit_code_and_the_result(tmp_path, capsys, step, factor, said):
    positions = write_places(tmp_path / "list.csv", factor * fdcal.load("tiny").positions[::step])
    result = tmp_path / "r.json"
    ended = exit_code("calibrate", "tiny", "--known", "none", "--check", "--positions", positions, "-o", result)
    text, check = capsys.readouterr().out, json.loads(result.read_text())["check"]
    assert said in text and ended == (5 if said else 0)
    assert ("no channels are swapped" in text) == (step == 1)
    assert check["fits"] and check["scale"] == pytest.approx(factor, rel=0.02)
    assert check["order"] == [str(n) for n in range(16)][::step]
    assert fdcal.Calibration.load(result).verdict == "good"


@pytest.mark.parametrize(
    ("known", "change", "said"),
    [
        ("none", lambda x: 1.05 * x, r"the list is 5.0 % too large, or the air is (29|30|31) K warmer than assumed"),
        ("all", lambda x: 0.95 * x, r"the list is 5.0 % too small, or the air is (28|29) K colder than assumed"),
        (
            "none",
            lambda x: x + 0.25 * (np.arange(len(x)) == 8)[:, None] * [0.6, 0.8],
            r"8 \(M09\) is 250 mm from its place",
        ),
        (
            "all",
            lambda x: x[[0, 1, 2, 12, *range(4, 12), 3, *range(13, 16)]],
            r"channels 3 \(M04\) and 12 \(M13\) are swapped",
        ),
    ],
)
def test_a_list_that_is_off_in_size_or_in_one_row_is_named_with_the_names_of_its_own(
    tmp_path, capsys, known, change, said
):
    places = change(np.asarray(fdcal.load("tiny").positions))
    positions = write_places(tmp_path / "list.csv", places, [f"M{n:02d}" for n in range(1, 17)])
    assert exit_code("calibrate", "tiny", "--known", known, "--check", "--positions", positions) == 5
    lines = capsys.readouterr().out.splitlines()
    assert any(re.fullmatch(said, line) for line in lines)
    assert sum(word in line for line in lines for word in ("too large", "its place")) <= 1


def test_the_size_of_an_array_that_is_not_to_be_trusted_accuses_no_list():
    """One of 16 microphones in a living room was found 29 % too large."""
    inputs = load_input("tiny")
    inputs = replace(inputs, settings=replace(inputs.settings, known="none"))
    found = solve(inputs)
    for verdict, scale, said in (("good", 1 / 1.29, "times as large"), ("model_mismatch", 1.0, "that of the list")):
        larger = replace(found, positions=1.29 * found.positions, verdict=verdict)
        check = report.comparison(inputs, larger)
        assert check.scale == pytest.approx(scale, rel=0.02)
        assert said in report.comparison_text(inputs, larger, check, None)


def test_exchanged_channels_are_found_in_python_and_the_positions_of_a_file_are_never_given_to_the_solver(exchanged):
    measurement = fdcal.load("tiny", positions=exchanged)
    found, plain = fdcal.calibrate(measurement), fdcal.calibrate(fdcal.load("tiny"))
    assert fdcal.compare_positions(found.positions, measurement.positions, measurement.known).swapped == ((3, 10),)
    np.testing.assert_array_equal(found.positions, plain.positions)
    assert found.max_error > plain.max_error


@pytest.mark.parametrize(
    ("label", "said"),
    [
        ("{}", ""),
        ("mic{:02d}", "the names differ: the list is taken in row order, mic00 = channel 0"),
        (
            "1+{}",
            "only 15 of 16 names of the list are names of channels: the list is taken in row order, 1 = channel 0",
        ),
    ],
)
def test_a_list_whose_names_are_not_those_of_the_channels_is_said_to_count_by_rows(tmp_path, capsys, label, said):
    names = [str(n + 1) if label == "1+{}" else label.format(n) for n in range(16)]
    positions = write_places(tmp_path / "list.csv", fdcal.load("tiny").positions, names)
    ended = exit_code("calibrate", "tiny", "--check", "--positions", positions)
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("list ")]
    assert lines == ([f"list    {said}"] if said else []) and ended == 0


def test_a_list_without_check_points_to_it(exchanged, capsys):
    exit_code("calibrate", "tiny", "--modes", "12", "--positions", exchanged)
    assert "add --check" in capsys.readouterr().out


@pytest.mark.parametrize("known", ["all", "none"])
def test_every_way_out_gives_the_same_positions_to_the_last_digit(tmp_path, known):
    """A reader who mixes two of them must not get an array that is moved or turned against itself."""
    found = fdcal.calibrate(fdcal.load("tiny"), modes=12, known=known)
    positions = found.positions
    for suffix in ("csv", "json", "npy", "xml", "sofa"):
        found.export(tmp_path / f"out.{suffix}")
    found.save(tmp_path / "result.json")
    with open(tmp_path / "out.csv", newline="") as file:
        table = [[float(row["x"]), float(row["y"])] for row in csv.DictReader(file)]
    rows = json.loads((tmp_path / "out.json").read_text())["microphones"]
    outputs = {
        "to_dataframe": found.to_dataframe()[["x", "y"]].to_numpy(),
        "to_json": json.loads(found.to_json())["positions"],
        "from_json": fdcal.Calibration.from_json(found.to_json()).positions,
        "save": fdcal.Calibration.load(tmp_path / "result.json").positions,
        "csv": table,
        "json": [[row["x"], row["y"]] for row in rows],
        "npy": np.load(tmp_path / "out.npy").T[:, :2],
        "xml": read_positions(tmp_path / "out.xml").positions[:, :2],
        "sofa": sofar.read_sofa(str(tmp_path / "out.sofa"), verbose=False).ReceiverPosition[:, :2, 0],
        "to_pyfar": found.to_pyfar().cartesian[:, :2],
    }
    for name, output in outputs.items():
        np.testing.assert_array_equal(np.reshape(output, positions.shape), positions, err_msg=name)
    assert found.frame == ("known" if known == "all" else "axes")
    spread = np.cov(positions.T)
    assert (abs(spread[0, 1]) < 1e-9 * spread.max() and spread[0, 0] >= spread[1, 1]) == (known == "none")
    traces = np.trace(found.covariance, axis1=1, axis2=2)
    np.testing.assert_allclose(np.sqrt(traces), found.uncertainty, rtol=1e-9)


@pytest.mark.parametrize("head", ["name,x,y,height", "name,x,y,z_m", "name,x,y,Z (m)", "name,x,y,comment,z"])
def test_a_height_column_is_read_whatever_it_is_called(tmp_path, head):
    between = "left of the door," if "comment" in head else ""
    rows = "".join(f"{n},{n}.5,1,{between}0.{n}\n" for n in range(3))
    names, positions = read_table(written(tmp_path, f"{head}\n{rows}", "places.csv"))
    np.testing.assert_array_equal(positions, [[n + 0.5, 1, n / 10] for n in range(3)])
    assert names == ["0", "1", "2"]


def test_a_track_without_a_number_stands_first_in_its_folder(tmp_path):
    for name in ("Audio Track-10.wav", "Audio Track-2.wav", "Audio Track.wav"):
        (tmp_path / name).touch()
    assert [one.name for one in sound_files(tmp_path)] == ["Audio Track.wav", "Audio Track-2.wav", "Audio Track-10.wav"]
