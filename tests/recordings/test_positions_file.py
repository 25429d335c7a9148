"""Files of given positions: Acoular's XML and tables."""

import json
import re
import zipfile

import numpy as np
import pytest
import soundfile
from recorded import write_places
from running import exit_code, refuses

import fdcal
from fdcal.model.measurement import list_labels
from fdcal.recordings.formats.positions import read_places, read_positions

pytestmark = pytest.mark.usefixtures("remembered_runs")

FORMATS_WRITTEN = ("csv", "json", "npy", "xml", "sofa")
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
    refuses("suffix", lambda: read_positions(written(tmp_path, ACOULAR, "g.doc")))


@pytest.mark.parametrize("names", [("", ""), ("Point 1", "Point 1")])
def test_microphones_without_names_of_their_own_are_numbered(tmp_path, names):
    text = ACOULAR.replace("Point 1", names[0]).replace("Point 2", names[1])
    assert read_positions(written(tmp_path, text)).names == ("0", "1")


PLACES = [[0.25, 0.5, 1.0], [0.75, -0.125, -1.5]]
TABLES = {
    "numbers in another form": "name,x,y,z\n1,0.25,+.5,1\n2, 75e-2,-0.125,-1.5\n",
    "decimal comma": "name;x;y;z\n1;0,25;0,5;1\n2;0,75;-0,125;-1,5\n",
    "tabs": "name\tx\ty\tz\n1\t0,25\t0,5\t1\n2\t0,75\t-0,125\t-1,5\n",
    "spaces": "1  0.25 0.5  1\n2  0.75 -0.125  -1.5\n",
    "quoted decimal comma": 'name,x,y,z\n1,"0,25","0,5",1\n2,"0,75","-0,125","-1,5"\n',
    "first line of Excel": "sep=;\nname;x;y;z\n1;0,25;0,5;1\n2;0,75;-0,125;-1,5\n",
    "comment and blank line": "# array A, 12 May\n\nname,x,y,z\n1,0.25,0.5,1\n2,0.75,-0.125,-1.5\n",
    "title": "Array A;;;\nMic;x;y;z\n1;0,25;0,5;1\n2;0,75;-0,125;-1,5\n",
    "index of pandas": ",name,x,y,z\n0,1,0.25,0.5,1\n1,2,0.75,-0.125,-1.5\n",
    "index of R": '"x" "y" "z"\n"1" 0.25 0.5 1\n"2" 0.75 -0.125 -1.5\n',
    "header in a comment": "#,x,y,z\n1,0.25,0.5,1\n2,0.75,-0.125,-1.5\n",
    "other words": "Mikrofon;X-Achse;Koordinate Y;posZ;Ort\n1;0.25;0.5;1;links\n2;0.75;-0.125;-1.5;rechts\n",
    "no header": "1,0.25,0.5,1\n2,0.75,-0.125,-1.5\n",
    "height": "id,x,y,comment,height (m)\n1,0.25,0.5,left,1\n2,0.75,-0.125,,-1.5\n",
    "millimetres": "# spacing in cm\nlabel,X (mm),Y (mm),Z (mm)\n1,250,500,1000\n2,750,-125,-1500\n",
    "centimetres": "channel,x_cm,y_cm,z_cm\n1,25,50,100\n2,75,-12.5,-150\n",
    "micrometres": "mic,x (\u00b5m),y [\u03bcm],z_um\n1,250000,500000,1e6\n2,750000,-125000,-1.5e6\n",
    "line of units": "name,x,y,z\n-,[mm],[mm],[mm]\n1,250,500,1000\n2,750,-125,-1500\n",
    "column of units": "name,x,y,z,unit\n1,250,500,1000,mm\n2,750,-125,-1500,mm\n",
    "unit in a comment": "% (units in mm)\n1 250 500 1000\n2 750 -125 -1500\n",
    "unit by size": "name,x,y,z\n1,250,500,1000\n2,750,-125,-1500\n",
    "LOCATA": "second\tx\tmic1_x\tmic1_y\tmic1_z\tmic2_x\tmic2_y\tmic2_z\n0\t9\t0.25\t0.5\t1\t0.75\t-0.125\t-1.5\n",
    "list.json": "[[0.25, 0.5, 1], [0.75, -0.125, -1.5], [0, 0, 0], [0, 0, 0]]",
    "object.json": '{"1": [0.25, 0.5, 1], "2": {"x": 0.75, "y": -0.125, "z": -1.5}}',
    "columns.json": '{"x": {"0": 0.25, "1": 0.75}, "y": {"0": 0.5, "1": -0.125}, "z": {"0": 1, "1": -1.5}}',
    "inside.json": '{"unit": "mm", "mics": [{"id": 1, "position": [250, 500, 1000]},'
    ' {"id": 2, "position": [750, -125, -1500]}], "sources": [[0, 0, 0]]}',
    "namespace.xml": '<MicArray xmlns="http://a.org"><a><pos Name="1" x="0.25" y="0.5" z="1"/>'
    '<pos Name="2" x="0.75" y="-0.125" z="-1.5"/></a></MicArray>',
    "hark.xml": '<h><positions type="microphone"><position id="1" x="0.25" y="0.5" z="1"/>'
    '<position id="2" x="0.75" y="-0.125" z="-1.5"/></positions>'
    '<positions type="tsp"><position x="1" y="1" z="1"/></positions></h>',
    "tascar.xml": '<receiver><mic name="1" position="0.25 0.5 1"/>'
    '<mic name="2" position="0.75 -0.125 -1.5"/></receiver>',
    "odas.cfg": "mics = ( # mu = ( 9, 9, 9 )\n{ mu = ( +0.25, 0.5, 1 ); sigma2 = ( 0.0, 0.0, 0.0 ); },\n"
    "{ mu = ( 0.75, -0.125, -1.5 ); } );\n",
}


@pytest.mark.parametrize("kind", TABLES)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_positions_are_read_as_people_have_them(tmp_path, caplog, kind, encoding):
    path = tmp_path / (kind if "." in kind else "table.txt")
    path.write_text(TABLES[kind], encoding=encoding)
    names, places = read_places(path)
    np.testing.assert_array_equal(places[:2], PLACES)
    assert [re.sub(r"\D", "", name) for name in names[:2]] in (["1", "2"], ["0", "1"])
    assert ("0" in names) == (kind in ("list.json", "columns.json", "odas.cfg"))
    assert bool(caplog.records) == (kind in ("unit in a comment", "unit by size"))


def test_a_table_of_an_old_spreadsheet_has_letters_of_windows(tmp_path):
    (tmp_path / "t.csv").write_bytes("Gerät;x;y\nä;0,25;0,5\nö;1;2\n".encode("cp1252"))
    assert read_places(tmp_path / "t.csv")[0] == ["ä", "ö"]


@pytest.mark.parametrize(
    ("head", "scale"),
    [("azimuth,elevation,r", 1), ("az (rad),colatitude (rad),radius (m)", 1), ("az (deg),el (rad),r (cm)", 100)],
)
def test_spherical_coordinates_are_read(tmp_path, head, scale):
    angles = np.array([[90.0, 30.0], [180.0, -45.0]])
    if "rad)" in head:
        angles = np.radians([0, 90] - angles * [-1, 1]) if "colat" in head else angles * [1, np.pi / 180]
    rows = [f"m{n},{a},{e},{scale * (n + 1)}\n" for n, (a, e) in enumerate(angles.tolist())]
    _, places = read_places(written(tmp_path, f"mic,{head}\n{''.join(rows)}", "s.csv"))
    np.testing.assert_allclose(places, [[0, 0.75**0.5, 0.5], [-(2**0.5), 0, -(2**0.5)]], atol=1e-12)


def test_arrays_and_sheets_are_read(tmp_path):
    places = [*PLACES, [0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]
    for array in (np.array(places), np.array(places).T):
        np.save(tmp_path / "a.npy", array)
        np.testing.assert_array_equal(read_places(tmp_path / "a.npy")[1], places)
    main = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
    cells = [["s0", "s1", "s2", "s3"], ["1", "250", "500", "1000"], ["2", "750", "-125", "-1500"]]
    rows = "".join(
        f"<row>{''.join(_cell(f'{letter}{n}', text) for letter, text in zip('BCDE', row, strict=True))}</row>"
        for n, row in enumerate(cells, 3)
    )
    with zipfile.ZipFile(tmp_path / "t.xlsx", "w") as file:
        shared = "".join(f"<si><t>{text}</t></si>" for text in ("Mic", "X (mm)", "Y (mm)", "Z (mm)"))
        file.writestr("xl/sharedStrings.xml", f"<sst {main}>{shared}</sst>")
        file.writestr("xl/worksheets/sheet1.xml", f"<worksheet {main}><sheetData>{rows}</sheetData></worksheet>")
        file.writestr("xl/worksheets/sheet2.xml", f"<worksheet {main}><sheetData/></worksheet>")
    names, found = read_places(tmp_path / "t.xlsx")
    assert names == ["1", "2"]
    np.testing.assert_array_equal(found, PLACES)
    with zipfile.ZipFile(tmp_path / "t.xlsx", "a") as file:
        file.writestr("xl/worksheets/sheet3.xml", f"<worksheet {main}><sheetData>{rows}</sheetData></worksheet>")
    refuses("2 sheets with cells; keep the one", read_places, tmp_path / "t.xlsx")


def _cell(where: str, text: str) -> str:
    return f'<c r="{where}"{" t=" + chr(34) + "s" + chr(34) if text[0] == "s" else ""}><v>{text.lstrip("s")}</v></c>'


geometry = ACOULAR.replace


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("t.xml", geometry("-1e-1", "left"), 'microphone 1: x = "left" is not a number'),
        ("t.xml", geometry('encoding="utf-8"', 'encoding="utf' + "f" * 3000 + '"'), "not valid XML"),
        ("t.xml", geometry(' x="', ' u="'), "no column of"),
        ("t.xml", geometry("</MicArray>", ""), "not valid XML"),
        # texts that only Python accepts as numbers
        *(("t.csv", f"name,x,y\na,1,2\nb,{cell},3\n", "line 3") for cell in "1_0 ٣ nan inf 1e400 0x1".split(" ")),
        ("t.csv", "name,x,y\na,1,2\nb,,3\n", "line 3"),
        ("t.csv", "", "must begin with the line name,x,y"),
        ("t.csv", "name,x,y\na,1\n", "line 2"),
        ("t.csv", "name,x,y\na,1,2\na,3,4\n", "twice"),
        ("t.csv", "name,x,y\na,0,5,0,34\n", "line 2: 'a,0,5,0,34' has more cells than the header; separate cells by"),
        ("t.csv", "0,1,2\n1,2,3\n", "first column may be the numbers of the microphones or x; begin with"),
        ("t.csv", "a,1,2,3,4\n", "has 5 columns and no line that names them"),
        ("t.csv", "name,x,y\n#1,0.1,0.2\n2,0.4,0.5\n", "line 2: '#1,0.1,0.2' may be a comment"),
        ("t.csv", "name,channel,x,y\na,1,0,0\nb,0,1,0\n", 'column "channel" of numbers is not understood'),
        ("t.csv", "name,x,y,nx\na,1,0,0.5\n", 'column "nx" of numbers is not understood'),
        ("t.csv", "name,x (mm),y (cm)\na,1,0\n", "the units in"),
        ("t.csv", "name,x (m),y [furlong]\na,1,0\n", '"furlong" of "y .furlong." is not known; write one of m, '),
        ("t.csv", "name,x,y,unit\na,1,0,mm\nb,1,0,cm\n", "column of units must hold a single known unit"),
        ("t.csv", "name;x;y\na;1,5;2\nb;1.5;2\n", "have both commas and points"),
        ("t.csv", "mic,azimuth,elevation,r\na,1,0,1\n", "may be degrees or radians; write"),
        ("t.csv", "mic,theta,phi,r\na,1,0,1\n", "name,azimuth"),
        ("t.txt", "t\tmic1_x\tmic1_y\tmic2_x\tmic2_y\n0\t1\t2\t3\t4\n1\t1\t2\t3\t5\n", "change from line to line"),
        ("t.csv", "mic,x left,x right,y\na,1,0,1\n", "several columns are called x"),
        ("t.json", "[[1, 2, 3], [1, 2, 3], [1, 2, 3]]", "which axis of shape"),
        ("t.json", "[[1, 2, 3], [1, 2, 3], [1, 2, 3], [1, 2]]", 'microphone 3: z = ""'),
        ("t.json", '{"a": [[1, 2, 3]], "b": [[1, 2, 3]]}', "2 lists that may be the positions: a, b"),
        ("t.json", '{"x": [1, 2], "y": [1]}', "no list of positions"),
        ("t.json", '{"unit": "furlong", "mics": [[1, 2, 3]]}', 'the unit "furlong" is not known'),
        ("t.json", "[" * 100_000, "no valid JSON|not valid JSON"),
        ("t.cfg", "raw = {}", "no microphone"),
        ("t.npy", "abc", "not a readable array"),
        ("t.xlsx", "abc", "not a readable Excel file"),
        ("t.xml", "<a><b><p x='1' y='2'/></b><c><p x='1' y='2'/></c></a>", "exactly one list of positions"),
    ],
)
def test_ambiguous_positions_are_asked_about_in_one_line(tmp_path, name, text, words):
    with pytest.raises(fdcal.InputError, match=words) as caught:
        read_places(written(tmp_path, text, name))
    said = str(caught.value).removeprefix(str(tmp_path))
    assert said.startswith("/t.") and "; " in said and "\n" not in said and len(said) < 1000


@pytest.fixture
def exchanged(tmp_path):
    """Acoular's XML of the scene tiny, in which the rows of microphones 3 and 10 are exchanged."""
    places = fdcal.load("tiny").positions.tolist()
    places[3], places[10] = places[10], places[3]
    rows = [f'<pos Name="Point {n}" x="{x}" y="{y}" z="0.4"/>' for n, (x, y) in enumerate(places)]
    return written(tmp_path, f"<MicArray>{''.join(rows)}</MicArray>")


def test_exchanged_channels_are_found_by_a_list_although_some_channels_are_left_out(exchanged, capsys):
    exit_code("calibrate", "tiny", "--exclude", "1,2", "--check", "--positions", exchanged)
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


@pytest.mark.parametrize(("change", "said"), [
    (lambda x: 1.05 * x, r"the list is 5.0 % too large, or the air is (29|30|31) K warmer than assumed"),
    (lambda x: x + 0.25 * (np.eye(16)[8][:, None] * [0.6, 0.8]), r"8 \(M09\) is 250 mm from its listed position"),
    (lambda x: x[sorted(range(16), key=lambda n: str(n + 1))], r".*: its rows are sorted as text .*"),
])  # fmt: skip
def test_a_list_with_its_own_names_that_is_wrong_in_size_a_row_or_order_is_described(tmp_path, capsys, change, said):
    places = change(np.asarray(fdcal.load("tiny").positions))
    positions = write_places(tmp_path / "list.csv", places, [f"M{n:02d}" for n in range(1, 17)])
    assert exit_code("calibrate", "tiny", "--known", "none", "--check", "--positions", positions) == 5
    lines = capsys.readouterr().out.splitlines()
    assert any(re.fullmatch(said, line) for line in lines)
    assert sum(word in line for line in lines for word in ("too large", "its listed position")) <= 1


def test_exchanged_channels_are_found_in_python_and_the_positions_of_a_file_are_never_given_to_the_solver(exchanged):
    measurement = fdcal.load("tiny", positions=exchanged)
    found, plain = fdcal.calibrate(measurement), fdcal.calibrate(fdcal.load("tiny"))
    assert fdcal.compare_positions(found.positions, measurement.positions, measurement.known).swapped == ((3, 10),)
    np.testing.assert_array_equal(found.positions, plain.positions)
    assert found.max_error > plain.max_error


def test_rows_that_are_matched_by_channel_number_are_named_as_they_are_taken():
    assert list_labels(("1", "2"), ("a", "b", "c"), "0")[1].endswith("b = channel 1")
    assert list_labels(("1", "2"), ("1", "2", "3"), "0")[1] == f"the names differ: {ROWS}, 2 = channel 1"


ROWS = "the list is taken in row order"


@pytest.mark.parametrize(("label", "said"), [
    ("{}", ""), ("mic{:02d}", f"the names differ: {ROWS}, mic00 = channel 0"),
    ("1+{}", f"15 of 16 names are names of channels: {ROWS}, 1 = channel 0"),
])  # fmt: skip
def test_a_list_whose_names_are_not_those_of_the_channels_is_matched_by_rows_with_a_note(tmp_path, capsys, label, said):
    names = [str(n + 1) if label == "1+{}" else label.format(n) for n in range(16)]
    positions = write_places(tmp_path / "list.csv", fdcal.load("tiny").positions, names)
    ended = exit_code("calibrate", "tiny", "--check", "--positions", positions)
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("list ")]
    assert lines == ([f"list    {said}"] if said else []) and ended == 0


def test_a_list_of_some_microphones_must_be_given_as_known(tmp_path, capsys):
    some = write_places(tmp_path / "some.csv", fdcal.load("tiny").positions[:4], ["0", "1", "2", "3"])
    assert exit_code("calibrate", "tiny", "--check", "--positions", some) == 2
    error = capsys.readouterr().err
    assert "4 positions are given for 16 microphones, none for 4, 5, 6, 7, 8, 9 ...;" in error
    assert "give the list as --known" in error


def test_a_list_of_positions_in_an_unknown_format_is_refused(tmp_path, capsys):
    (tmp_path / "places.psv").write_text("name|x|y\n0|1|2\n")
    soundfile.write(tmp_path / "one.wav", np.random.default_rng(0).normal(size=(8000, 4)) / 10, 8000)
    assert exit_code("calibrate", tmp_path / "one.wav", "--known", tmp_path / "places.psv") == 2
    assert "is not a list of positions; give a file .cfg, .csv" in capsys.readouterr().err


def test_a_list_without_the_option_check_gives_a_hint_to_that_option(exchanged, capsys):
    exit_code("calibrate", "tiny", "--modes", "12", "--positions", exchanged)
    assert "add --check" in capsys.readouterr().out


@pytest.mark.parametrize("known", ["all", "none"])
def test_every_output_gives_the_same_positions_and_tables_round_them_to_a_tenth_of_a_micrometre(tmp_path, known):
    """A reader who combines two of them must not get parts in different frames."""
    found = fdcal.calibrate(fdcal.load("tiny"), modes=12, known=known)
    positions = found.positions
    for suffix in FORMATS_WRITTEN:
        found.export(tmp_path / f"out.{suffix}")
    found.save(tmp_path / "result.json")
    outputs = {
        "to_dataframe": found.to_dataframe()[["x", "y"]].to_numpy(),
        "to_json": json.loads(found.to_json())["positions"],
        "from_json": fdcal.Calibration.from_json(found.to_json()).positions,
        "save": fdcal.Calibration.load(tmp_path / "result.json").positions,
    }
    outputs |= {f"read {one}": read_places(tmp_path / f"out.{one}")[1][:, :2] for one in FORMATS_WRITTEN}
    for name, output in outputs.items():
        wanted = positions.round(7) if name in ("read csv", "read xml") else positions
        np.testing.assert_array_equal(np.reshape(output, positions.shape), wanted, err_msg=name)
    assert found.frame == ("known" if known == "all" else "axes")
    spread = np.cov(positions.T)
    assert (abs(spread[0, 1]) < 1e-9 * spread.max() and spread[0, 0] >= spread[1, 1]) == (known == "none")
    np.testing.assert_allclose(np.sqrt(np.trace(found.covariance, axis1=1, axis2=2)), found.uncertainty, rtol=1e-9)
