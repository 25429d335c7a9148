"""Files that the page opens from the folder in which it was started, and no others."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import soundfile
from browsing import WAIT
from doubles import set_by_client, wait_until
from recorded import FS, places, stationary_source

from fdcal import solvers
from fdcal.model.measurement import save_measurement
from fdcal.recordings.importer import import_recording
from fdcal.session import session_file
from fdcal.session.sources import measurement_input, measurement_request
from fdcal.viewer.tabs import open_file as module
from fdcal.viewer.tabs.open_file import NONE, OpenFile

COUNT = 16


@pytest.fixture
def tab(server, tmp_path):
    """The controls for a folder with a recording and a list, how to bring them up to date, and what they open."""
    sound, _ = stationary_source(10.0, 30.0, COUNT)
    soundfile.write(tmp_path / "one.wav", 0.1 * sound.T / np.std(sound), FS, subtype="PCM_24")
    rows = [f"{n},{','.join(f'{x:.4f}' for x in place)}" for n, place in enumerate(places(COUNT))]
    (tmp_path / "list.csv").write_text("\n".join(["name,x,y,z", *rows]))
    (tmp_path / "notes.txt").write_text("<b>mine</b>")
    (tmp_path / ".hidden.wav").touch()
    (tmp_path / "folder.wav").mkdir()
    opened = []
    made = OpenFile(server.gui, tmp_path, opened.append)

    def until(happened):
        wait_until(happened, made.list_folder)

    until(lambda: made.file.value != NONE)
    yield SimpleNamespace(tab=made, until=until, opened=opened, folder=tmp_path)
    made.worker.close(WAIT)
    server.gui.reset()


def test_a_recording_is_opened_with_the_report_of_its_import_and_a_fault_is_one_line(tab):
    made = tab.tab
    set_by_client(made.positions, "list.csv")
    made.press()
    tab.until(lambda: "channels     16, 10 s at 4000 Hz" in made.report.content)
    assert tab.opened[0].scene.name == "one" and tab.opened[0].measurement.positions is not None
    (tab.folder / "broken.wav").write_bytes(b"RIFF")
    tab.until(lambda: "broken.wav" in made.file.options)
    set_by_client(made.file, "broken.wav")
    made.press()
    tab.until(lambda: "broken.wav is not a sound file" in made.report.content)
    assert len(tab.opened) == 1


def test_a_measurement_and_a_session_are_opened_too(tab):
    made, (measurement, _) = tab.tab, import_recording(tab.folder / "one.wav")
    save_measurement(measurement, tab.folder / "hall.npz")
    mine, problem = measurement_request(measurement_input(measurement, "mine")), measurement.problem("unit")
    start = solvers.load("joint").init(problem, replace(mine.scene.solver, name="joint", modes=12, first_modes=12), 0)
    mine = replace(mine, scene=replace(mine.scene, solver=start.settings), states=(start,))
    (tab.folder / "run.zip").write_bytes(session_file.write(mine))
    tab.until(lambda: made.file.options == ("hall.npz", "one.wav", "run.zip"))
    for file, name in (("hall.npz", "hall"), ("run.zip", "mine")):
        set_by_client(made.file, file)
        made.press()
        tab.until(lambda name=name: any(request.scene.name == name for request in tab.opened))


def test_it_offers_the_files_of_its_folder_alone_and_lists_it_only_after_a_change(tab, monkeypatch):
    made, listed, listdir = tab.tab, [], module.os.listdir
    assert made.file.options == ("one.wav",) and made.positions.options == (NONE, "list.csv")
    for other in ("/etc/passwd", "../one.wav", "notes.txt"):
        set_by_client(made.file, other)
        assert made.file.value == "one.wav"
    monkeypatch.setattr(module.os, "listdir", lambda path: listed.append(path) or listdir(path))
    monkeypatch.setattr(module, "SETTLED", 0)
    for _ in range(10):
        made.list_folder()
    assert not listed
    (tab.folder / "two.wav").touch()
    made.list_folder()
    assert len(listed) == 1 and made.file.options == ("one.wav", "two.wav") and made.file.value == "one.wav"
