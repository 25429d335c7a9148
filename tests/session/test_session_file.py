"""A session file restores the session to the last bit; any other file is refused in one line."""

import copy
import dataclasses
import functools
import io
import itertools
import json
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
from running import refuses
from solving import same

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.model.measurement import load_measurement
from fdcal.model.scene import load_scene, placeholder_scene
from fdcal.session import session_file
from fdcal.session.scene_edits import edited
from fdcal.session.sources import OpenRequest

CHOICES = {"microphone": 9, "modes": (2, 5), "follow": False, "dark": True}


def left(name: str, steps: int | None = None, index: int = 2) -> OpenRequest:
    """A session on `tiny`, saved while solver `name` was running, or at its end."""
    scene = edited(load_scene("tiny"), {"solver.name": name, "solver.modes": 12, "measurement.snr_db": 40.0})
    measurement = cached_measurement(scene)
    states = itertools.islice(solvers.run(measurement.problem(scene.solver.weights), scene.solver, 5), steps)
    return OpenRequest(scene, 5, measurement, tuple(states), index, CHOICES)


@pytest.fixture
def reopened(tmp_path):
    """Function that writes a session and reads it again."""

    def reopen(given: OpenRequest) -> OpenRequest:
        path = tmp_path / "left.zip"
        path.write_bytes(session_file.write(given))
        return session_file.read(path)

    return reopen


@pytest.fixture(scope="module")
def joint_session():
    return left("joint", 5, 3)


@pytest.fixture
def folder(tmp_path, joint_session):
    """Function that writes the session with some of its content changed."""

    def write(change=None, arrays=None):
        with zipfile.ZipFile(io.BytesIO(session_file.write(joint_session))) as archive:
            table, packed = json.loads(archive.read("session.json")), archive.read("session.npz")
        if change is not None:
            change(table)
        if arrays is not None:
            with np.load(io.BytesIO(packed)) as archive:
                held = dict(archive)
            arrays(held)
            file = io.BytesIO()
            np.savez(file, **held)
            packed = file.getvalue()
        with zipfile.ZipFile(tmp_path / "session.zip", "w") as archive:
            archive.writestr("session.json", json.dumps(table))
            archive.writestr("session.npz", packed)
        return tmp_path / "session.zip"

    return write


@pytest.mark.parametrize("name", solvers.names())
def test_a_reopened_session_equals_the_saved_one_and_its_run_goes_on_as_if_it_had_not_stopped(name, reopened):
    given = left(name)
    before, found = copy.deepcopy(given.states), reopened(given)
    assert found.scene == given.scene and (found.start_seed, found.index) == (5, 2)
    assert found.choices == {**CHOICES, "modes": [2, 5]}
    assert same(found.measurement, given.measurement)
    assert same(found.states, before) and same(reopened(found).states, before)
    assert not any(state.positions.flags.writeable for state in found.states)
    problem, middle = found.measurement.problem(found.scene.solver.weights), len(before) // 2
    state = found.states[middle]
    for expected in before[middle + 1 :]:
        state = solvers.load(name).step(problem, state)
        assert same(state, expected)
    assert state.finished


def test_a_session_is_a_zip_of_two_files_of_which_one_is_a_measurement(folder, joint_session, tmp_path):
    with zipfile.ZipFile(folder()) as archive:
        archive.extract("session.npz", tmp_path)
    assert same(load_measurement(tmp_path / "session.npz"), joint_session.measurement)
    with zipfile.ZipFile(tmp_path / "half.zip", "w") as archive:
        archive.write(tmp_path / "session.npz", "session.npz")
    refuses(r"session\.json and session\.npz", session_file.read, tmp_path / "half.zip")
    refuses("nowhere", session_file.read, tmp_path / "nowhere.zip")


@pytest.mark.parametrize("content", [b"PK\x03\x04junk", pickle.dumps({"a": 1}), b"[" * 100_000, b"\xff"])
def test_a_file_that_is_not_a_session_is_refused_in_one_line(tmp_path, content):
    (tmp_path / "broken.zip").write_bytes(content)
    with zipfile.ZipFile(tmp_path / "inside.zip", "w") as archive:
        archive.writestr("session.json", content)
        archive.writestr("session.npz", content)
    for name in ("broken.zip", "inside.zip"):
        refuses("", session_file.read, tmp_path / name)


def test_a_long_run_is_written_with_fewer_states_all_of_them_finite(joint_session, monkeypatch):
    states = [dataclasses.replace(joint_session.states[-1], step=i) for i in range(100)]
    assert session_file.kept_states(states, 17) == list(range(100))
    monkeypatch.setattr(session_file, "WRITTEN_BYTES", 6 * len(pickle.dumps(joint_session.states[0])))
    kept = session_file.kept_states(states, 17)
    assert 4 <= len(kept) <= 6 and {0, 17, 99} <= set(kept)
    bad = dataclasses.replace(joint_session.states[-1], cost=float("nan"))
    refuses("rewind", lambda: session_file.write(dataclasses.replace(joint_session, states=(bad,), index=0)))


@pytest.mark.parametrize(("name", "few"), [("tiny", {}), ("listening_lab", {"array.count": 6})])
def test_a_scene_without_noise_and_one_in_a_measured_room_come_back_too(name, few, reopened):
    scene = edited(load_scene(name), {"solver.modes": 12, **few})
    measurement = cached_measurement(scene)
    state = solvers.load(scene.solver.name).init(measurement.problem(scene.solver.weights), scene.solver, 0)
    assert np.isinf(scene.measurement.snr_db) or name != "tiny"
    assert reopened(OpenRequest(scene, 0, measurement, (state,))).scene == scene
    bare = placeholder_scene(measurement, "mine", scene.solver)
    found = reopened(OpenRequest(bare, 0, measurement, (state,))).scene
    assert found == bare and type(found) is type(bare), "no walls are drawn of an unknown room"


class Trap:
    """An object that would write to a file if it were unpickled."""

    def __reduce__(self):
        return (open, ("/tmp/fdcal-trap", "w"))


def first_of(table, keys):
    """Return the record of the first state at some keys."""
    return functools.reduce(dict.__getitem__, keys, table["states"]["rows"][0])


def put(*path):
    """Function that sets the value at the keys of `path` to its last entry."""
    *keys, key, value = path
    return lambda table: first_of(table, keys).update({key: value})


def pop(*path):
    return lambda table: first_of(table, path[:-1]).pop(path[-1])


CHANGES = [
    (lambda table: table.pop("states"), "session"),
    (lambda table: table.update(fdcal_session=1), "fdcal_session = 1 is another version; fdcal reads 4"),
    (lambda table: table.update(index=999), "index"),
    (lambda table: table["scene"]["room"].update(sound_speed=-1), "room.sound_speed"),
    (lambda table: table["scene"]["solver"].update(name="descent"), "solver"),
    (lambda table: table["states"].update(solver="os"), "solver"),
    (lambda table: table["states"].update(rows=[]), "rows"), (lambda table: table["states"]["rows"].append(7), "rows"),
    (pop("cost"), "cost.*version"), (pop("model", "log_speed"), "log_speed.*version"),
    (pop("positions"), r": states: Object missing required field `positions`"),
    (put("model", "evil", 1), "evil.*version"), (put("progress", {}), "version"), (put("settings", 7), "settings"),
    (put("first", 0), "first"), (put("moved", 99), "moved"), (put("finished", 1), "finished"),
    (put("cost", "1e999"), "cost"), (put("cost", 10**400), "cost"), (put("cost", float("nan")), "cost"),
    (put("model", "damped", "__import__('os')"), r"states\.model\.damped: Expected"),
    (put("progress", "stage", 6), r"progress\.stage = 6 must be from 0 to"), (put("progress", "rounds", -1), "rounds"),
    (put("positions", [99, 0]), "positions"), (put("model", "noise", [0, 0]), "noise"),
    (put("model", "contradicted", True), "contradicted: it refers to"), (put("optima", [[1, 2]]), "optima"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "word"), CHANGES)
def test_a_changed_table_is_refused(folder, change, word):
    said = str(refuses(word, session_file.read, folder(change)))
    assert "session.zip" in said and len(said) < 1000 + len(str(Path.cwd()))


@pytest.mark.parametrize("arrays", [
    lambda held: held.update(states_0=np.array([Trap()], dtype=object)),
    lambda held: held.update(states_0=np.full_like(held["states_0"], np.nan)),
    lambda held: held.update(states_0=held["states_0"] * 1e12),
    lambda held: held.update(states_0=held["states_0"][..., :1]), lambda held: held.pop("states_0"),
    lambda held: held.pop("pressures"), lambda held: held.update(frequencies=held["frequencies"][::-1]),
    lambda held: held.update(dimension=3, array_dimension=2),
])  # fmt: skip
def test_changed_arrays_are_refused(folder, arrays):
    refuses("", session_file.read, folder(arrays=arrays))


def test_a_file_that_claims_or_unpacks_to_too_much_is_refused(tmp_path, folder, monkeypatch):
    with zipfile.ZipFile(folder()) as archive:
        table = archive.read("session.json")
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**15,)})
    arrays = io.BytesIO()
    with zipfile.ZipFile(arrays, "w") as archive:
        archive.writestr("states_0.npy", header.getvalue())
    path = tmp_path / "huge.zip"
    for limit, packed in ((session_file.UNPACKED_BYTES, arrays.getvalue()), (1000, bytes(5000))):
        monkeypatch.setattr(session_file, "UNPACKED_BYTES", limit)
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("session.json", table)
            archive.writestr("session.npz", packed)
        refuses("", session_file.read, path)
