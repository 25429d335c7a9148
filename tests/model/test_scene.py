"""Scenes: those that come with fdcal are consistent; a bad one is refused with key, value and remedy."""

import dataclasses
import shutil
import tomllib

import numpy as np
import pytest
from running import refuses

from fdcal.acoustics.measure import cached_measurement, load_cached_measurement, measure
from fdcal.model.arrays import positions_of
from fdcal.model.scene import MeasuredScene, folder_of, load_scene, response_path
from fdcal.model.validation import InputError, StorageError


def assert_refused(words, read, *arguments):
    """Check that a scene is refused in one line that contains all of `words`."""
    with pytest.raises(InputError) as caught:
        read(*arguments)
    message = str(caught.value)
    assert "\n" not in message and [word for word in words if word not in message] == [], message


def test_name_and_path_give_the_same_scene(edited):
    assert dataclasses.replace(load_scene(edited({})), name="tiny") == load_scene("tiny")


FLAT = "position = [4.3, 3.5]\nlow = 20.0\nhigh = 300.0\nsample_rate = 700.0"
CORNER = "[[0, 0], [1.68, 0], [1.68, 1.2], [0.6, 1.2], [0.6, 0.6], [0, 0.6]]"

RANGES = [  # each case changes one key
    ("array.random", "100000", "array.count = 100009"), ("source.high", "9000.0", "half of source.sample_rate = 13000"),
    ("search.origin", "[1e300, 0.4]", "too far away"), ("measurement.snr_db", "-inf", "decibels"),
    ("gauge.known", "[0, 5, 5]", "twice"), ("faults.phase_deg", "nan", "must be a number"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        *(({key: value}, [word]) for key, value, word in RANGES),
        ({"room.sise": "[1, 1]"}, ["room.sise is not a key", 'did you mean "room.size"']),
        ({"source.position": None}, ["source.position is missing", "add it"]),
        ({"room.cell": '"4 cm"'}, ["room.cell = '4 cm'", "a number"]),
        ({"room.size": "[-1.68, 1.2]"}, ["room.size = -1.68 m", "above zero"]),
        ({"room.size": "[1.68]"}, ["room.size", "1 numbers", "give two, along x and y or three"]),
        ({"room.size": "[1.68, 1.2, 3.0]"}, ["room.cell = 0.04 m has no meaning", "three lengths", "remove it"]),
        ({"room.outline": "[[0, 0], [1, 0], [1, 1]]"}, ["room.size or room.outline", "exactly one"]),
        ({"room.size": None, "room.outline": "[[0, 0], [1, 1], [2, 2]]"}, ["room.outline encloses no area"]),
        ({"room.cell": "1e-6"}, ["room.cell = 1e-06", "use a larger one"]),
        ({"room.walls": '"soft"'}, ['room.walls = "soft"', "rigid, pressure-release, absorbing"]),
        ({"room.walls": '"absorbing"'}, ["room.admittance = 0", "above zero"]),
        ({"room.admittance": "0.1"}, ["room.admittance = 0.1", "remove it"]),
        ({"array.geometry": '"spiral"'}, ['array.geometry = "spiral"', "use one of"]),
        ({"array.geometry": '"circle"'}, ["array.count is missing"]),
        ({"array.count": "5"}, ["array.count has no meaning", "remove it"]),
        ({"search.step": "1.0"}, ["search.step = 1 m", "lower it"]),
        ({"search.step": "0.0005"}, ["9.24e+05 candidates", "use a larger one", "500000"]),
        ({"search.size": "[0.48, 0.47]"}, ["search.size = 0.47 m", "search.step = 0.02 m", "use 0.46 or 0.48 m"]),
        ({"measurement.snr_db": "-5000.0"}, ["measurement.snr_db = -5000", "-300 to 300", "inf"]),
        ({"search.origin": "[0.4]"}, ["search.origin", "differ in dimension"]),
        ({"gauge.free": "[3]"}, ["gauge.known or gauge.free", "exactly one"]),
        ({"measurement.lowest": "950.0"}, ["measurement.lowest = 950 Hz", "below measurement.highest = 850 Hz"]),
        ({"measurement.highest": "1600.0"}, ["measurement.highest = 1600 Hz", "source.high = 1500 Hz"]),
        ({"solver.modes": "2"}, ["solver.first_modes = 3", "solver.modes = 2", "lower it"]),
        ({"solver": "3"}, ["not valid TOML"]),
        ({"solver.noise": "20"}, ["solver.noise = 20 must be a text"]),
        ({"faults.dead": "[16]"}, ["faults.dead"]),
        ({"faults.inverted": "[3]", "faults.dead": "[3]"}, ["faults.inverted and faults.dead name 3"]),
        ({"faults.gain_db": "-1.0"}, ["faults.gain_db"]),
        ({"source.positions": "[[1.58, 1.1], [0.1, 1.1]]"}, ["source.position or source.positions", "exactly one"]),
        ({"array.size": "[0.04, 0.4]"}, ["microphones 0 and 1 at the same position", "larger array"]),
        ({"array.random": "200"}, ["array.random = 200", "use at most"]),
        ({"array.center": "[0.1, 0.54]"}, ["microphone 0", "outside the room", "change array.center"]),
        ({"room.size": None, "room.outline": CORNER}, ["microphone 6 at (0.5, 0.74) m", "in a wall"]),
        ({"source.position": "[2.0, 1.1]"}, ["source.position = [2.0, 1.1] m", "outside the room", "move it"]),
        ({"source.position": "[0.75, 0.6]"}, ["source.position", "inside the array", "convex hull"]),
        ({"gauge.known": "[0, 5]"}, ["gauge.known = [0, 5]", "three known microphones"]),
        ({"gauge.known": "[0, 1, 2]"}, ["gauge.known = [0, 1, 2]", "not on one line"]),
        ({"gauge.known": "[0, 5, 16]"}, ["gauge.known names microphone 16", "0 to 15"]),
        ({"gauge.known": None, "gauge.free": "[]"}, ["no microphone to be found"]),
        ({"search.origin": "[0.7, 0.3]"}, ["microphone 3", "search domain", "search.origin or search.size"]),
        # The source has several places.
        *(
            ({"source.position": None, "source.positions": places}, words)
            for places, words in (
                ("[[1.58, 1.1], [0.1]]", ["source.positions[2] = [0.1] has 1 numbers", "give two"]),
                ("[[1.58, 1.1], [1.58, 1.1]]", ["source.positions[2]", "given twice", "move it"]),
                ("[[1.58, 1.1], [0.7, 0.6]]", ["source.positions[2]", "inside the array"]),
                ("[[1.58, 1.1], [2.7, 0.6]]", ["source.positions[2]", "outside the room"]),
                (str([[0.1, 0.001 * n] for n in range(101)]), ["source.positions", "101", "at most 100"]),
            )
        ),
    ],
)
def test_bad_scene_names_key_value_and_remedy(edited, changes, words):
    assert_refused(words, lambda: positions_of(load_scene(edited(changes))))


@pytest.fixture
def boxed(tmp_path):
    """Function that writes a scene in space with lines exchanged: boxed({"radius = 0.45": ""}) -> path.

    It is `ball3d`, or `listening_lab` where only that has these lines.
    """

    def write(changes: dict[str, str]):
        files = [folder_of("scenes") / f"{name}.toml" for name in ("ball3d", "listening_lab")]
        texts = [file.read_text(encoding="utf-8") for file in files]
        text = next(one for one in texts if all(one.count(old) == 1 for old in changes))
        for old, new in changes.items():
            text = text.replace(old, new)
        path = tmp_path / "boxed.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.mark.parametrize(("changes", "words"), [
    ({"[room]": "[room]\ncell = 0.02"}, ["room.cell = 0.02 m has no meaning", "remove it"]),
    ({"[source]": "[source]\nlow = 20.0"}, ["source.low = 20 Hz has no meaning", "remove it"]),
    ({"1.6, 1.3]": "1.6, 2.3]"}, ["microphone", "outside the room", "array.center"]),
    ({"position = [4.37, 3.55, 2.45]": FLAT}, ["source.position = [4.3, 3.5]", "room of 3 dimensions"]),
    ({"[4.6, 3.8, 2.7]": "[4.6, 3.8]\ncell = 0.02"}, ["source.position", "room of 2 dimensions"]),
    ({"center = [1.9, 1.6, 1.3]": "center = [1.9, 1.6]"}, ["array.center", "2 numbers", "give three"]),
    ({'"ball"': '"circle"', "center = [1.9, 1.6, 1.3]": ""}, ['array.geometry = "circle"', '"ball", "box"']),
    ({'"continuous"': '"discrete"'}, ['measurement.wavenumber = "discrete"', "no meaning", '"continuous"']),
    ({"known = [3, 29, 52, 57]": "known = [3, 29, 52]"}, ["gauge.known", "four known microphones", "not in one plane"]),
    ({"resolution = 8.1": "resolution = 2.0"}, ["measurement.resolution = 2 Hz", "0.125 s", "use at least 8.1 Hz"]),
    ({"highest = 785.0": "highest = 9000.0"}, ["measurement.highest = 9000 Hz", "use at most 8000 Hz"]),
])  # fmt: skip
def test_bad_scene_in_space_names_key_value_and_remedy(boxed, changes, words):
    assert_refused(words, lambda: measure(load_scene(boxed(changes))))


def test_in_space_search_and_known_microphones_may_be_left_out(boxed):
    path = boxed({"known = [3, 29, 52, 57]": "known = []"})
    text = path.read_text(encoding="utf-8")
    path.write_text(text[: text.index("[search]")] + text[text.index("[gauge]") :], encoding="utf-8")
    scene = load_scene(path)
    assert scene.search is None and positions_of(scene).shape == (64, 3)


TINY = tomllib.loads((folder_of("scenes") / "tiny.toml").read_text(encoding="utf-8"))
LEAVES = [f"{name}.{key}" for name, table in TINY.items() if isinstance(table, dict) for key in table]
OPTIONAL = {"room.size", "array.shape", "array.size", "array.random", "array.center", "gauge.known", "solver.modes"}


@pytest.mark.parametrize("key", ["seed", *sorted(set(LEAVES) - OPTIONAL)])
def test_a_missing_key_is_named_and_no_default_is_used(edited, key):
    refuses(rf"{key} is missing; add it", lambda: load_scene(edited({key: None})))


@pytest.mark.parametrize(("name", "words"), [
    ("nowhere", r'"nowhere" is unknown.*array1_circle'), ("9" * 5000, r"is unknown|cannot read"),
    ("gone.toml", "cannot read scene"), ("mine.npz", "is a measurement; give a scene"), ("a\0b.toml", "NUL"),
    ("text.toml", "not valid TOML"), ("binary.toml", "not valid TOML"),
])  # fmt: skip
def test_a_file_that_is_not_a_scene_is_refused_in_one_line(tmp_path, monkeypatch, name, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.toml").write_bytes(b"room = [")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe")
    with pytest.raises((InputError, StorageError), match=words) as caught:
        load_scene(name)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, StorageError) or name != "gone.toml"


def test_a_measurement_becomes_a_scene_by_a_file_that_names_it(tmp_path):
    scene, path = load_scene("frl_array"), tmp_path / "mine.toml"
    assert isinstance(scene, MeasuredScene) and scene.title == "Measured: 7 microphones in a laboratory"
    assert "CC BY 4.0" in scene.remark and "nominal" in scene.remark
    path.write_text('measurement = "hall.npz"')
    refuses(r"hall\.npz", load_scene, path)
    shutil.copy(scene.file, tmp_path / "hall.npz")
    assert load_scene(path).file == str(tmp_path / "hall.npz") and load_scene(path).title == "mine"
    path.write_text('measurement = "hall.npz"\nseed = 1\n')
    refuses("seed has no meaning in a scene that is a measurement", load_scene, path)
    path.write_text('measurement = "hall.npz"\nremark = 1\n')
    refuses("remark = 1 must be a text", load_scene, path)


@pytest.mark.parametrize("room", ['room = "listening_lab"', '[room]\nresponse = "listening_lab"'])
def test_a_measured_room_has_neither_walls_nor_a_source(written_room, room):
    scene = load_scene(written_room(room))
    assert (scene.room.response, scene.room.walls, scene.room.size) == ("listening_lab", "unknown", None)
    assert (scene.source, scene.room.dimension, len(scene.room.vertices)) == (None, 3, 0)
    assert positions_of(scene).shape == (64, 3)


def test_the_file_of_a_measured_room_is_beside_the_scene(written_room, tmp_path):
    scene = load_scene(written_room('room = "hall.mat"'))
    assert scene.room.response == str(tmp_path / "hall.mat")
    refuses("hall", measure, scene)
    (tmp_path / "other").mkdir()
    shutil.copy(response_path("listening_lab"), tmp_path / "other" / "hall.mat")
    assert load_scene(written_room('room = "other/hall.mat"')).room.response == str(tmp_path / "other/hall.mat")


@pytest.mark.parametrize(("room", "words"), [
    ('room = "cellar"', ['room.response = "cellar" is unknown', "listening_lab", ".mat"]),
    ('[room]\nresponse = "listening_lab"\nwalls = "rigid"', ["room.walls = 'rigid'", "unknown", "remove it"]),
    ('[room]\nresponse = "listening_lab"\nsize = [3.0, 4.0, 2.5]', ["room.size", "unknown", "remove it"]),
    ('[room]\nresponse = "listening_lab"\ncell = 0.02', ["room.cell = 0.02", "remove it"]),
    ('room = "listening_lab"\n[source]\nposition = [1.0, 1.0, 1.0]\nduration = 1.0', ["source", "remove it"]),
])  # fmt: skip
def test_walls_or_a_source_in_a_measured_room_are_refused(written_room, room, words):
    assert_refused(words, load_scene, written_room(room))


@pytest.fixture
def written_room(tmp_path):
    """Function that writes the listening lab with another room: written_room('room = "hall.mat"') -> path."""

    def write(room: str):
        head, _, tables = (folder_of("scenes") / "listening_lab.toml").read_text(encoding="utf-8").partition("[array]")
        lines = "".join(line for line in head.splitlines(keepends=True) if not line.startswith("room"))
        path = tmp_path / "own.toml"
        path.write_text(f"{lines}{room}\n[array]{tables}", encoding="utf-8")
        return path

    return write


TWO_PLACES = "[[1.58, 1.1], [0.1, 1.1]]"


def of_places(edited, places=TWO_PLACES, **others):
    return load_scene(edited({"source.position": None, "source.positions": places} | others))


def test_each_place_of_the_source_is_a_take(edited):
    scene = of_places(edited, **{"measurement.snr_db": "30.0"})
    takes = scene.takes()
    assert [take.source.place for take in takes] == list(scene.source.places) == [(1.58, 1.1), (0.1, 1.1)]
    measurement, alone = measure(scene), [measure(take) for take in takes]
    assert measurement.take_count == 2 and len(measurement.frequencies) == sum(len(one.frequencies) for one in alone)
    for number, one in enumerate(alone):
        take = measurement.of_take(number)
        np.testing.assert_array_equal(take.frequencies, one.frequencies)
        np.testing.assert_array_equal(take.noise_power, one.noise_power)
        np.testing.assert_array_equal(take.spectrum, one.spectrum)
    np.testing.assert_array_equal(measurement.of_take(0).pressures, alone[0].pressures)
    assert not np.array_equal(measurement.of_take(1).pressures, alone[1].pressures), "each take has its own noise"
    quiet = measure(of_places(edited))
    np.testing.assert_array_equal(quiet.of_take(1).pressures, measure(of_places(edited).takes()[1]).pressures)


def test_the_channels_are_those_of_all_takes(edited):
    faults = {"faults.gain_db": "2.0", "faults.dead": "[4]"}
    plain, faulty = measure(of_places(edited)), measure(of_places(edited, **faults))
    gains, healthy = faulty.pressures / plain.pressures, np.arange(16) != 4
    np.testing.assert_allclose(gains[:, healthy], np.broadcast_to(gains[0, healthy], gains[:, healthy].shape))
    dead = [faulty.of_take(take).pressures[:, 4] for take in (0, 1)]
    assert not np.array_equal(dead[0][:5], dead[1][:5])


def test_a_scene_with_one_place_is_the_same_with_either_key(edited):
    one = measure(of_places(edited, "[[1.58, 1.1]]", **{"measurement.snr_db": "20.0"}))
    np.testing.assert_array_equal(one.pressures, measure(load_scene(edited({"measurement.snr_db": "20.0"}))).pressures)
    assert one.take_count == 1


def test_the_cached_measurement_depends_on_every_place(edited, monkeypatch, tmp_path):
    monkeypatch.setenv("FDCAL_CACHE", str(tmp_path / "cache"))
    two, other = (of_places(edited, f"[[1.58, 1.1], {place}]") for place in ("[0.1, 1.1]", "[0.1, 0.3]"))
    measured = cached_measurement(two)
    np.testing.assert_array_equal(cached_measurement(two).pressures, measure(two).pressures)
    assert load_cached_measurement(other) is None and load_cached_measurement(two.takes()[0]) is None
    np.testing.assert_array_equal(measured.pressures, load_cached_measurement(two).pressures)
