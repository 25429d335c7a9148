"""Studies: their file, one calibration, the table, and runs on own processes of Dask."""

import contextlib
import http.client
import itertools
import json
import re
import socket
from contextlib import nullcontext
from dataclasses import asdict, replace
from importlib.metadata import version as fdcal_version
from types import SimpleNamespace

import numpy as np
import pandas
import psutil
import pytest
from distributed import Client
from distributed.security import Security
from pyarrow import parquet

import fdcal
from fdcal.acoustics.box_field import point_source_pressures
from fdcal.acoustics.measure import sound_field
from fdcal.commands.cli import main
from fdcal.model.scene import Room, load_scene
from fdcal.model.validation import InputError, StorageError
from fdcal_bench import command, draw, run, tasks
from fdcal_bench.code import CodeVersion, source_hash
from fdcal_bench.report import MAX_PANELS, study_panels, write_page, write_report
from fdcal_bench.run import PARTS, Results, connected, read_results, run_study
from fdcal_bench.statistics import classified, clustered, column_value, rows_of, selected, share_grid
from fdcal_bench.study import Study, load_study, scene_at
from fdcal_bench.tasks import own_code, run_task


def exit_code(*arguments) -> int:
    """The exit code of `fdcal study` in this process."""
    with pytest.raises(SystemExit) as ended:
        main(["study", *map(str, arguments)])
    return ended.value.code or 0


def refusal(capsys, *arguments) -> str:
    assert exit_code(*arguments) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    return line


TEXT = """
scene = "tiny"
draws = {draws}
[axes]
snr_db = [20, 40]
"solver.modes" = [12, 20]
[fixed]
"solver.name" = "joint"
[drawn]
source = true
least_distance = 0.2
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(TEXT.format(draws=3))
    return path


ROWS = {}


def row_of(study, number):
    """The row of a calibration, computed once."""
    key = study.digest(), number
    if key not in ROWS:
        ROWS[key] = run_task(study, number)
    return dict(ROWS[key])


def test_points_are_the_product_of_the_axes(file):
    study = load_study(file)
    assert (study.points, study.count) == (4, 12)
    assert [tuple(study.point(number).values()) for number in range(4)] == [(20, 12), (20, 20), (40, 12), (40, 20)]
    scene = scene_at(study, study.point(3), 7)
    assert (scene.measurement.snr_db, scene.solver.modes, scene.seed) == (40, 20, 7)
    file.write_text(TEXT.format(draws=10_000_000))
    tasks = load_study(file).tasks({0, 2})  # which are not listed
    assert [next(tasks) for _ in range(3)] == [1, 3, 4]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("snr_db =", "loudness ="),
        ('"solver.modes"', '"solver.mode"'),
        ('"solver.modes"', '"nothing.modes"'),
        ("[20, 40]", "20"),
        ("[20, 40]", "[]"),
        ("[12, 20]", "[12, -1]"),
        ('"tiny"', '"none"'),
        ("draws = 3", "draws = 0"),
        ("draws = 3", "drafts = 3"),
        ("[20, 40]", '["loud"]'),
        ("[20, 40]", "[[20]]"),
        ("[20, 40]", '[20, "forty"]'),  # of one axis all values are of one kind
        ("snr_db = [20, 40]", "microphones = [10000000000000000000000]"),
        ("snr_db = [20, 40]", 'microphones = ["many"]'),
        ("snr_db = [20, 40]", "microphones = [nan]"),
        ("snr_db = [20, 40]", "absorption = [0.1, 0.5]"),  # of rigid walls
        ("[20, 40]", "[20, 40, 20.0]"),
        ('"solver.modes"', '"room.walls.x"'),
        ('scene = "tiny"\n', ""),
        ("[axes]", '[axes]\nscene = ["tiny"]'),  # either a scene or an axis of scenes
        ("draws = 3", "= 3"),
    ],
)
def test_a_wrong_study_is_refused_in_one_line(file, capsys, old, new):
    file.write_text(file.read_text().replace(old, new))
    line = refusal(capsys, file, "--dry-run")
    assert line.count(str(file)) == 1


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[4.0, 3.0]", "[4.0, 3.0, 2.0]", "3 lengths"),
        ('"living room"', '"flat"', "two scenarios have the name"),
        ("draws = 2", 'draws = 2\nscene = "tiny"', "no scene"),
        ("inverted = 1", "inverted = 12", "too few microphones"),
    ],
)
def test_wrong_scenarios_are_refused_in_one_line(tmp_path, capsys, old, new, words):
    (tmp_path / "wrong.toml").write_text(SCENARIOS.replace(old, new))
    assert words in refusal(capsys, tmp_path / "wrong.toml", "--dry-run")


def test_a_missing_folder_and_a_missing_scheduler_are_refused(file, tmp_path, monkeypatch, capsys):
    assert "nothing is not a folder" in refusal(capsys, "--report", tmp_path / "nothing")
    monkeypatch.setattr(run, "BATCHING", run.Batching(connect_seconds=0.2))
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))  # without listening
        address = f"tcp://127.0.0.1:{bound.getsockname()[1]}"
        assert "no scheduler answers" in refusal(capsys, file, "-o", tmp_path / "out", "--scheduler", address)


def test_an_axis_of_scenes(file, tmp_path):
    """Names of shipped scenes, and paths beside the study's file; two scenes make two points."""
    from fdcal.model.scene import folder_of

    (tmp_path / "own.toml").write_text(
        (folder_of("scenes") / "tiny.toml").read_text().replace("snr_db = inf", "snr_db = 12.0")
    )
    text = TEXT.format(draws=3).replace('scene = "tiny"\n', "")
    file.write_text(text.replace("snr_db = [20, 40]", 'scene = ["tiny", "own.toml"]'))
    study = load_study(file)
    levels = [scene_at(study, study.point(number), 0).measurement.snr_db for number in range(4)]
    assert levels == [np.inf, np.inf, 12, 12]


def test_a_calibration_is_determined_by_its_number(file):
    study = load_study(file)
    one, same, other = row_of(study, 5), run_task(study, 5), row_of(study, 1)
    one.pop("seconds"), same.pop("seconds")
    assert one == same
    assert (one["source"], one["version"]) == (own_code().source, fdcal_version("fdcal"))
    assert len(one["source"]) == 16 and set(one) >= set(asdict(own_code())), "it names the code that computed it"
    assert (one["draw"], other["draw"]) == (1, 0)
    assert one["rms_error_m"] != other["rms_error_m"]
    assert 0 < one["bound_m"] < one["rms_error_m"] * 5


def test_a_row_has_the_errors_of_calibrate_whatever_is_known():
    """Without known positions the array is aligned first; with the minimal gauge every microphone counts."""
    axes = {"solver.known": ["all", "minimal", "none"]}
    fixed = {"snr_db": 30.0, "solver.name": "joint", "solver.modes": 12}
    study = Study(title="known", draws=1, axes=axes, scene="tiny", fixed=fixed)
    for number in range(study.count):
        row, scene = run_task(study, number), scene_at(study, study.point(number), study.seed)
        found = fdcal.calibrate(fdcal.simulate(scene), seed=study.seed, settings=scene.solver)
        assert row["rms_error_m"] == pytest.approx(found.rms_error, rel=1e-9)
        assert row["max_error_m"] == pytest.approx(found.max_error, rel=1e-9)
        assert row["max_error_m"] < 0.05, row["solver.known"]
        assert row["bound_m"] < 2 * row["rms_error_m"]


def test_the_source_of_a_draw_is_the_same_at_all_points(file):
    """Points therefore differ in their axes only: with less noise the same array has a smaller error."""
    study = load_study(file)
    errors = np.array([[row_of(study, 4 * draw + point)["rms_error_m"] for point in (1, 3)] for draw in range(2)])
    assert np.all(errors[:, 1] < errors[:, 0])


def test_an_interrupted_table_is_continued_and_has_one_writer(file, tmp_path, monkeypatch):
    study, folder = load_study(file), tmp_path / "out"
    first, at = Results(folder, study, False), {"draw": 0, "seed": 0, "snr_db": 20, "solver.modes": 12}
    first.append([{"task": 0, "verdict": "refused", "reason": "why", **at}])
    first.append([{"task": 3, "verdict": "good", "rms_error_m": 0.01, **at}])
    with pytest.raises(InputError, match="--resume"):
        Results(folder, study, False)
    again = Results(folder, study, True)
    assert again.done() == {0, 3}
    assert list(study.tasks(again.done()))[:3] == [1, 2, 4]
    rows = pandas.read_parquet(folder / "rows").sort_values("task")
    assert rows["verdict"].tolist() == ["refused", "good"] and rows["rms_error_m"].tolist()[1] == 0.01
    assert rows["snr_db"].tolist() == [20, 20]
    with first.held(), pytest.raises(InputError, match="another run"), again.held():
        pytest.fail("both run")
    with again.held():
        pass

    def full(*arguments):
        raise OSError(28, "No space left on device")

    parts = list(folder.glob(PARTS))
    monkeypatch.setattr(parquet, "write_table", full)
    with pytest.raises(StorageError, match="No space left"):
        again.append([{"task": 0}])
    assert list(folder.glob(PARTS)) == parts, "a full disk leaves no part"


def test_a_folder_of_another_study_and_one_that_is_not_empty(file, tmp_path):
    study, folder = load_study(file), tmp_path / "out"
    Results(folder, study, False)
    file.write_text(TEXT.format(draws=4))
    with pytest.raises(InputError, match="another study"):
        Results(folder, load_study(file), True)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter.txt").write_text("mine")
    with pytest.raises(InputError, match="not empty"):
        Results(tmp_path / "full", study, False)
    with pytest.raises(InputError, match="no results"):
        read_results(tmp_path / "full")


def rows_by(code, tasks):
    """Return rows at the first point of the study, computed by some code."""
    at = {"snr_db": 20, "solver.modes": 12, "draw": 0, "seed": 0, "verdict": "good", "seconds": 1.0}
    error = {"rms_error_m": 0.002, "claimed_sigma_m": 0.002, "bound_m": 0.001, "max_error_m": 0.004}
    return [{"task": number, **at, **error, **code} for number in tasks]


def test_a_study_does_not_go_on_with_other_code(file, tmp_path, monkeypatch):
    """Otherwise its rows would come from two solvers; a folder without rows can be used by other code."""
    study, folder = load_study(file), tmp_path / "out"
    first, other = CodeVersion("0.1.0", "aaaa", "1234567"), CodeVersion("0.1.0", "bbbb", None)
    for code in (other, first):
        monkeypatch.setattr(run, "own_code", lambda code=code: code)
        table = Results(folder, study, False)
    table.append(rows_by(asdict(first), [0, 1]))
    assert Results(folder, study, True).done() == {0, 1}
    monkeypatch.setattr(run, "own_code", lambda: other)
    with pytest.raises(InputError, match=r"other code .*sources aaaa, commit 1234567; this is .*sources bbbb"):
        Results(folder, study, True)


@pytest.mark.parametrize("content", ["null", "{", '{"digest": 3}'])
@pytest.mark.parametrize("whole", [True, False])
def test_a_damaged_head_is_one_line_that_names_the_file(file, tmp_path, capsys, content, whole):
    folder = tmp_path / "out"
    Results(folder, load_study(file), False).append(rows_by({}, [0]))
    head = json.loads((folder / "study.json").read_text())
    if not whole and content.startswith("{") and content.endswith("}"):  # one wrong key among right ones
        content = json.dumps(head | (json.loads(content) or {"axes": None}))
    (folder / "study.json").write_text(content)
    for arguments in (("--report", folder), ("--report", folder, "--page", "page.md"), (file, "-o", folder)):
        assert exit_code(*arguments) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert f"{folder / 'study.json'} is damaged" in line


@pytest.mark.parametrize("damage", [b"", b"PAR1", b"[]", None])
def test_a_damaged_part_is_one_line_that_names_the_file(file, tmp_path, capsys, damage):
    folder = tmp_path / "out"
    Results(folder, load_study(file), False).append(rows_by({}, [0]))
    (part,) = folder.glob(PARTS)
    if damage is None:  # a table of something else
        pandas.DataFrame({"task": ["one"], "x": [3]}).to_parquet(part)
    else:
        part.write_bytes(damage)
    assert exit_code("--report", folder) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{part} is damaged" in line
    with pytest.raises(InputError, match=rf"{part.name} is damaged.*resume, which does its tasks again"):
        read_results(folder)
    assert Results(folder, load_study(file), True).done() == set()


def test_the_report_describes_its_rooms_and_lists_points_with_intervals_and_wrong_verdicts(file, tmp_path):
    study, folder = load_study(file), tmp_path / "out"
    table = Results(folder, study, False)
    rows = rows_by({}, range(8))
    for row in rows:
        row |= {"verdict": "good", "rms_error_m": 1e-3, "claimed_sigma_m": 2e-3, "seed": 700 + row["task"]}
    rows[3] |= {"rms_error_m": 0.123, "max_error_m": 0.4}
    other = CodeVersion("0.1.0", "aaaa", "1234567")
    for row in rows:
        row |= asdict(own_code() if row["task"] == 3 else other)
    table.append(rows)
    page = write_report(folder, *read_results(folder), None, {}).read_text()
    assert f"Computed by different code: 7 by {other}; 1 by {own_code()}." in page
    assert "<h2>Every point</h2><table>" in page
    assert "rigid walls, a decay by 60 dB in" in page and "microphones" in page
    assert re.search(r"<td>\d+ \(\d+ to 100\)</td>", page), "a share and its interval"
    assert "<td>703</td><td>123</td><td>400</td>" in page, "the one that is good and wrong"


def test_the_hash_of_sources_covers_what_a_row_depends_on(tmp_path):
    for part in ("cost", "viewer"):
        (tmp_path / part).mkdir()
        (tmp_path / part / "one.py").write_bytes(b"x = 1\n")
    before = source_hash(tmp_path)
    (tmp_path / "viewer" / "one.py").write_bytes(b"x = 2\n")
    (tmp_path / "cost" / "one.py").write_bytes(b"x = 1\r\n")
    assert source_hash(tmp_path) == before, "neither the page nor line endings change it"
    (tmp_path / "cost" / "one.py").write_bytes(b"x = 2\n")
    assert source_hash(tmp_path) != before


def listening(process) -> list[tuple[str, int]]:
    """The addresses at which a process and its children accept connections."""
    family = [process, *process.children(recursive=True)]
    found = (each for one in family for each in one.net_connections("inet") if each.status == psutil.CONN_LISTEN)
    return [tuple(each.laddr) for each in found]


def test_own_processes_listen_on_the_loopback_interface_and_to_each_other_alone():
    """A scheduler of Dask executes what a client sends: it must be a client of ours, and nothing shows the tasks."""
    before = set(listening(psutil.Process()))
    with connected(1) as client:
        own = set(listening(psutil.Process())) - before
        assert len(own) >= 4 and {host for host, _ in own} == {"127.0.0.1"}
        address = client.scheduler.address
        assert address.startswith("tls://127.0.0.1:")
        with pytest.raises((OSError, TimeoutError)):
            Client(address.replace("tls", "tcp"), timeout=1)
        with pytest.raises((OSError, TimeoutError)):
            Client(address, security=Security.temporary(), timeout=1)  # another certificate
        answers = 0
        for _, port in own:
            for page in ("status", "info/main/workers.html", "health", "metrics"):
                with contextlib.suppress(OSError, http.client.HTTPException):
                    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=1)
                    connection.request("GET", f"/{page}")
                    answers += connection.getresponse().status == 200
        assert not answers
        assert client.submit(sum, [1, 2]).result() == 3


def test_an_interrupted_study_says_what_is_kept_goes_on_and_is_drawn(file, tmp_path, monkeypatch, capsys):
    """It runs in a thread of this process; `benchmarks documents` interrupts and kills processes of its own."""
    file.write_text(TEXT.format(draws=1).replace('"solver.modes" = [12, 20]\n', ""))
    folder = tmp_path / "out"

    def stopped(study, results, client, progress):
        def stop(done, note):
            raise KeyboardInterrupt

        return run_study(study, results, client, stop)

    @contextlib.contextmanager
    def local(*_):
        with Client(processes=False, n_workers=1, threads_per_worker=1, dashboard_address=None) as client:
            yield client

    monkeypatch.setattr(run, "connected", local)
    with monkeypatch.context() as patch:
        patch.setattr(run, "run_study", stopped)
        assert exit_code(file, "-o", folder) == 130
    said = f"interrupted; 1 of 2 calibrations are in {folder}: the same command with --resume continues"
    assert capsys.readouterr().err.splitlines()[-1] == f"error: {said}"
    assert exit_code(file, "-o", folder, "--resume") == 0
    head, rows = read_results(folder)
    assert sorted(rows["task"]) == sorted(pandas.read_parquet(folder / "rows")["task"]) == list(range(2)), "each once"
    page = write_report(folder, head, rows, None, {})
    assert page.read_text().startswith("<!doctype html>")
    assert {one.suffix for one in page.parent.iterdir()} == {".png", ".svg", ".html"}
    with pytest.raises(InputError, match="no axis"):
        write_report(folder, head, rows, ("snr_db", "nothing"), {})


def test_a_study_whose_calibrations_are_all_refused_says_so_and_does_not_end_like_a_success(
    file, tmp_path, monkeypatch, capsys
):
    study, rest = load_study(file), "refused"

    def run_all(study, results, client, progress):
        rows = [{"task": n, "verdict": rest if n else "refused", "reason": "no room"} for n in range(study.count)]
        results.append(rows)
        return len(rows)

    monkeypatch.setattr(run, "run_study", run_all)
    monkeypatch.setattr(run, "connected", lambda *_: nullcontext(SimpleNamespace(dashboard_link="")))
    assert command.run(study, str(tmp_path / "none"), 1, None, False) == 4
    assert f"refused {study.count} of {study.count}, most often: no room" in capsys.readouterr().out
    rest = "good"
    assert command.run(study, str(tmp_path / "some"), 1, None, False) == 0
    assert f"refused 1 of {study.count}" in capsys.readouterr().out


def test_computing_a_field_once_for_all_points_of_a_draw_changes_no_measurement(tmp_path, monkeypatch):
    """The noise differs between points; the radius changes the field itself."""
    path = tmp_path / "study.toml"
    path.write_text(
        'scene = "tiny"\ndraws = 2\n[axes]\nsnr_db = [20, 40]\nradius = [0.2, 0.25]\n'
        '[fixed]\n"solver.modes" = 12\n"solver.name" = "joint"\n[drawn]\nsource = true\nleast_distance = 0.2\n'
    )
    study, computed = load_study(path), []

    def counted(*arguments):
        computed.append(arguments)
        return sound_field(*arguments)

    def row(number):
        draw, index = divmod(number, study.points)
        return tasks.posed(study, study.point(index), draw)[0].measurement.pressures.tolist()

    numbers, alone = (0, 1, 2, 4), []  # of the first draw two radii and two levels of noise, and another draw
    for number in numbers:
        monkeypatch.setattr(tasks, "_fields", {})
        alone.append(row(number))
    monkeypatch.setattr(tasks, "_fields", {})
    monkeypatch.setattr(tasks, "sound_field", counted)
    assert [row(number) for number in numbers] == alone
    assert len(computed) == 3, "two radii of a draw, and one of another"


def test_a_field_is_that_of_its_source(monkeypatch):
    """Two draws may differ in the place of the source alone."""
    scene = load_scene("tiny")
    moved = replace(scene, source=replace(scene.source, position=(0.3, 0.9)))
    monkeypatch.setattr(tasks, "_fields", {})
    monkeypatch.setattr(tasks, "cached_recordings", lambda take: None)
    monkeypatch.setattr(tasks, "sound_field", lambda take, recordings: take.source.position)
    fields = [tasks._sound_fields(one) for one in (scene, moved, scene)]
    assert fields == [(scene.source.position,), ((0.3, 0.9),), (scene.source.position,)]


def test_statistics_of_a_table_and_its_rows_at_values_of_the_axes():

    table = pandas.DataFrame(
        {
            "task": range(4),
            "snr_db": [20, 20, 40, 40],
            "verdict": ["good", "ambiguous", "good", "refused"],
            "rms_error_m": [0.004, 0.05, 0.05, None],
            "claimed_sigma_m": [0.004, 0.02, 0.001, None],
            "bound_m": [0.001, 0.001, 0.001, None],
            "max_error_m": [0.01, 0.1, 0.1, None],
            "worst_sigmas": [0.0, 0.0, 0.0, None],
        }
    )
    rows, axes = classified(table), {"snr_db": [20, 40]}
    assert rows["found"].tolist() == [True, False, False, False]
    assert rows["wrong"].tolist() == [False, False, True, False]
    assert share_grid(rows, axes, ("snr_db", ""), "found")[:, 0].tolist() == [0.5, 0.0]
    assert len(selected(rows, axes, {"snr_db": "20"})) == 2
    with pytest.raises(InputError):
        selected(rows, axes, {"snr_db": "30"})

    # a value of an axis of whole and other numbers: its column holds 10.0 where the study's file says 10
    rows = pandas.DataFrame(
        {"snr_db": [10.0, 20.5, 10.0], "known": ["all", "none", "all"], "walls": [True, False, True]}
    )
    axes = {"snr_db": [10, 20.5], "known": ["all", "none"], "walls": [True, False]}
    for at, count in (({"snr_db": "10"}, 2), ({"snr_db": "20.5"}, 1), ({"known": "all", "walls": "True"}, 2)):
        assert len(selected(rows, axes, at)) == count


SCENARIOS = """
draws = 2
seed = 5
[[scenarios]]
name = "flat"
array = "disc"
microphones = 12
radius = 0.4
room = [4.0, 3.0]
modes = 16
snr_db = 40.0
inverted = 1
known_error = 0.002
[[scenarios]]
name = "living room"
array = "ball"
microphones = 12
radius = 0.25
room = [5.0, 4.0, 2.6]
modes = 20
takes = 2
known = 5
misplaced = 0.2
absorption = [[60, 0.1], [500, 0.3]]
cardioid = true
gain_db = 1.0
phase_deg = 5.0
sound_speed_error = 0.01
sound_speed_sigma = 0.02
"""


@pytest.fixture
def scenarios(tmp_path):
    path = tmp_path / "scenarios.toml"
    path.write_text(SCENARIOS)
    return load_study(path)


def test_scenarios_are_the_points_of_a_study(scenarios):
    assert (scenarios.points, scenarios.count) == (2, 4)
    assert [scenarios.point(n) for n in (0, 1)] == [{"scenario": "flat"}, {"scenario": "living room"}]
    stated = [tasks.posed(scenarios, scenarios.point(n), 5)[0].settings for n in (0, 1)]
    assert [one.sound_speed_sigma for one in stated] == [None, 0.02], "as stated to the solver"


def test_a_draw_has_the_noise_the_faults_and_the_errors_of_its_scenario(scenarios):
    for scenario in scenarios.scenarios:
        drawn = draw.draw(scenario, 5)
        again = draw.draw(scenario, 5).measurement
        one = drawn.measurement
        np.testing.assert_array_equal(one.pressures, again.pressures)
        assert not np.allclose(one.positions, draw.draw(scenario, 6).measurement.positions)
        other = draw.draw(replace(scenario, name="other"), 5).measurement
        assert not np.allclose(one.positions, other.positions), "scenarios are independent"
        assert one.count == scenario.microphones and len(one.frequencies) == scenario.modes * scenario.takes
        assert one.sound_speed == pytest.approx((1 + scenario.sound_speed_error) * draw.SOUND_SPEED)
        off = np.linalg.norm(one.known_positions - one.positions[one.known], axis=1)
        wrong = [str(n) in drawn.misplaced for n in one.known]
        assert len(drawn.faulty) == scenario.inverted and sum(wrong) == bool(scenario.misplaced)
        np.testing.assert_allclose(off[wrong], scenario.misplaced)
        assert np.all(off[np.logical_not(wrong)] <= 5 * scenario.known_error)


def test_the_field_of_a_rectangle_solves_helmholtz_equation_and_is_rigid_at_the_walls():
    """That of a box is tested in tests/acoustics."""
    room, source, h = Room(size=(4.0, 3.0)), np.array([3.4, 2.6]), 1e-3
    k, at = np.array([2.0 - 0.01j, 7.3 - 0.01j]), np.array([1.3, 1.1])
    points = np.concatenate([[at], *([at + h * e, at - h * e] for e in np.eye(2))])
    p = point_source_pressures(room, source, points, k)
    laplacian = (p[:, 1:].sum(axis=1) - 4 * p[:, 0]) / h**2
    np.testing.assert_allclose(laplacian, -(k**2) * p[:, 0], rtol=2e-4)
    wall = np.array([[0.0, *at[1:]], [h, *at[1:]], [2 * h, *at[1:]]])
    q = point_source_pressures(room, source, wall, k)
    assert np.all(np.abs(-3 * q[:, 0] + 4 * q[:, 1] - q[:, 2]) / (2 * h) < 1e-4 * np.abs(k * q[:, 0]))


def test_a_row_counts_microphones_inside_ellipses_and_healthy_channels_called_faulty(scenarios):
    row = row_of(scenarios, 0)
    inside, ranks = json.loads(row["inside"]), json.loads(row["ranks"])
    assert inside == sorted(inside) and inside[-1] <= row["judged"] <= 12 - 4 - 1
    assert sum(ranks) == 2 * row["judged"] and row["sound"] == 11 and row["right_given"] == 4
    assert row["error_m2"] == pytest.approx(row["rms_error_m"] ** 2, rel=1e-6) or row["accused"]
    assert row["faults"] == 1 and row["named"] <= 1


def test_the_standard_error_of_a_fraction_treats_draws_as_clusters():
    """If all microphones of a draw err together, the fraction scatters with the number of draws, not of microphones."""
    rng = np.random.default_rng(0)
    found = []
    for _ in range(300):
        sizes = rng.integers(5, 30, 40).astype(float)
        counts = np.where(rng.random(40) < 0.8, sizes, 0.0)
        found.append([float(one[0]) for one in clustered(counts[:, None], sizes)])
    share, error = np.transpose(found)
    assert np.mean(share) == pytest.approx(0.8, abs=0.02)
    assert np.mean(error) == pytest.approx(np.std(share), rel=0.15)
    assert np.std(share) > 3 * np.sqrt(0.8 * 0.2 / 700)


def test_the_page_of_a_study_says_what_its_rows_hold(scenarios, tmp_path):
    results = Results(tmp_path / "out", scenarios, False)
    rows = [row_of(scenarios, number) for number in range(2)]
    good = rows[0] | {"verdict": "good", "worst_sigmas": 7.0, "task": 2, "draw": 1, "seed": 6}
    few = {key: rows[0][key] for key in ("scenario", "seed", "source", "version", "commit")}
    results.append([*rows, good, few | {"task": 3, "draw": 1, "verdict": "refused", "reason": "no room for a source"}])
    page = tmp_path / "study-scenarios.md"
    case = 'text = "All others are right."\n[[cases]]\nscenario = "flat"\nseed = 6\nwhy = "another basin"\n'
    page.with_suffix(".cases.toml").write_text(case)
    page.write_text("of an earlier study")
    write_page(page, *read_results(tmp_path / "out"), "out", command.PAGE_COMMANDS)
    text = page.read_text()
    assert f"fdcal study STUDY.toml -o out\nfdcal study --report out --page {page}\n" in text and "`scenarios`" in text
    (picture,) = re.findall(r"\{image\} (\S+)", text)
    assert (page.parent / picture).stat().st_size > 5000
    assert "4 draws, 1 to 3 of each scenario, of 4 that are planned; seeds 5 to 6" in " ".join(text.split())
    assert "Good and wrong: 1 of 4 draws" in text and "| flat | 6 |" in text
    assert "| 7.0 | another basin |" in text and text.endswith("\n\nAll others are right.\n")
    assert "Refused: 1 of 4 draws" in text and "- flat, seed 5: no room for a source" in text
    assert "| flat | 3 | 1 |" in text and "| all | 4 | 1 |" in text
    assert own_code().source in text
    assert len(page.with_suffix(".csv").read_text().splitlines()) == 5
    inside, n = json.loads(rows[0]["inside"])[2], rows[0]["judged"]
    assert f"| {100 * inside / n:.1f} ± " in text


def test_a_page_of_a_study_of_axes_is_refused_before_anything_is_written(tmp_path, monkeypatch, capsys):
    """Its statistics hold for independent draws only."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text('scene = "tiny"\ndraws = 1\n[axes]\nsnr_db = [20, 40]\n')
    Results("found", load_study("mine.toml"), False).append(rows_by({}, range(2)))
    line = refusal(capsys, "--report", "found", "--page", "page.md")
    assert line.endswith("only a study of scenarios has a page; use --report without --page")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["found", "mine.toml"]


# Every calibration of a study is in one panel of its figures, and no figure has more panels than can be read.


STUDIES = {
    "one": {"snr_db": [20, 40]},
    "names": {"solver.name": ["joint", "robust"], "scene": ["tiny", "array1_circle"]},
    "four": {"solver.name": ["a", "b", "c", "d"], "solver.modes": [8, 16], "snr_db": [20, 40], "scene": ["x", "y"]},
    "many": {"known": [0, 3, 4, 6], "radius": [0.1, 0.2], "snr_db": [20, 40], "size": [[1, 2], [3, 4], [5, 6]]},
    "fixed": {"snr_db": [30], "radius": [0.1, 0.2, 0.3]},
}


@pytest.mark.parametrize("name", STUDIES)
def test_each_calibration_is_in_one_panel(name):
    axes = STUDIES[name]
    points = [dict(zip(axes, map(column_value, values), strict=True)) for values in itertools.product(*axes.values())]
    rows, shown = pandas.DataFrame(points), study_panels(axes)
    parts = [rows_of(rows, values) for values in shown.panels]
    assert sorted(itertools.chain.from_iterable(part.index for part in parts)) == list(rows.index)
    assert len(shown.panels) <= MAX_PANELS and shown.columns <= len(shown.panels)
    assert len(axes[shown.x]) > 1 and (shown.y == "" or len(axes[shown.y]) > 1)
    named = {shown.x, shown.y, *shown.averaged, *shown.panels[0]}
    assert {key for key, values in axes.items() if len(values) > 1} <= named
    if name == "four":  # noise is along x, solvers side by side; axes that are chosen stay
        assert (shown.y, shown.x) == ("solver.modes", "snr_db")
        assert shown.panels[0] == {"solver.name": "a", "scene": "x"} and len(shown.panels) == 8
        chosen = study_panels(axes, ("snr_db", "solver.name"))
        assert (chosen.y, chosen.x) == ("snr_db", "solver.name")
        assert {"solver.modes", "scene"} == set(chosen.panels[0])
