"""The tab Record: takes replayed in the folder of the page, what they say together, and files that it opens."""

import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
import soundfile
from browsing import WAIT
from doubles import set_by_client
from recorded import FS, places, stationary_source

from fdcal.model.validation import InputError
from fdcal.recordings import take
from fdcal.session import takes
from fdcal.viewer.background.prepare import Threads
from fdcal.viewer.server.hardening import is_loopback
from fdcal.viewer.tabs import record as module
from fdcal.viewer.tabs.record import CARD, NONE, Given, Recorder, RecordTab

COUNT = 16


@pytest.fixture
def tab(server, tmp_path, monkeypatch):
    """The tab of a folder with a recording, a list and a text, how to bring it up to date, and what it opens."""
    sound, _ = stationary_source(10.0, 30.0, COUNT)
    soundfile.write(tmp_path / "one.wav", 0.1 * sound.T / np.std(sound), FS, subtype="PCM_24")
    rows = [f"{n},{','.join(f'{x:.4f}' for x in place)}" for n, place in enumerate(places(COUNT))]
    (tmp_path / "list.csv").write_text("\n".join(["name,x,y,z", *rows]))
    (tmp_path / "notes.txt").write_text("<b>mine</b>")
    np.savez(tmp_path / "a_measurement.npz", pressures=np.zeros(COUNT))

    def no_card(*_):
        raise InputError("there is no sound card with inputs", "connect it, or replay a recording: <replay>")

    monkeypatch.setattr(take, "sound_card", no_card)
    threads, opened = Threads(), []
    recorder = Recorder(threads, tmp_path, opened.append, pace=lambda seconds: None)
    made = RecordTab(server.gui, recorder, str(tmp_path))

    def until(happened):
        for turn in range(round(WAIT / 0.02)):
            made.show(turn * module.LISTED)
            if happened():
                return
            time.sleep(0.02)
        pytest.fail("it does not happen")

    until(lambda: made.source.value != NONE)
    yield SimpleNamespace(tab=made, until=until, opened=opened, recorder=recorder, folder=tmp_path)
    threads.close(WAIT)
    server.gui.reset()


def test_it_offers_the_files_of_its_folder_alone_and_says_why_there_is_no_card(tab):
    made = tab.tab
    assert made.source.options == ("one.wav",) and made.positions.options == (NONE, "list.csv")
    choose, reason = made.card.content.split("</div>")[:2]
    assert f"Choose a file of the folder {tab.folder} in the list" in choose
    assert ">There is no sound card with inputs; connect it, then press" in reason
    for other in ("/etc/passwd", "../one.wav", "notes.txt", CARD):
        set_by_client(made.source, other)
        assert made.source.value == "one.wav"
    soundfile.write(tab.folder / "two.wav", np.zeros((FS, 2)), FS)
    tab.until(lambda: made.source.options == ("one.wav", "two.wav"))
    assert made.source.value == "one.wav"


def test_a_take_is_recorded_stopped_calibrated_and_opened_as_a_session(tab, monkeypatch):
    made, seen = tab.tab, threading.Event()
    monkeypatch.setattr(tab.recorder, "_pace", lambda seconds: tab.recorder.progress.moment and seen.wait(WAIT))
    set_by_client(made.positions, "list.csv")
    made.press()
    tab.until(lambda: made.levels.content.count(" dB</td>") == COUNT and made.record.label == "Stop")
    seen.set()
    tab.until(lambda: "one sigma" in made.takes.content and made.record.label == "Record" and not made.levels.content)
    assert (tab.folder / "take1.wav").exists()
    assert "take 1: take1.wav: 10 s at 4000 Hz, 16 channels" in made.takes.content
    assert "mean " in made.takes.content and "another take brings one sigma" in made.takes.content
    tab.recorder.open_takes()
    (request,) = tab.opened
    assert request.measurement.count == COUNT and request.measurement.positions is not None

    monkeypatch.setattr(tab.recorder, "_pace", lambda seconds: tab.recorder.stop())
    made.press()
    tab.until(lambda: "take2.wav: 0.1 s" in made.takes.content and made.record.label == "Record")
    assert "stopped early, and kept" in made.takes.content
    assert soundfile.info(tab.folder / "take2.wav").duration == pytest.approx(0.1)
    tab.recorder.leave_out_last()
    tab.until(lambda: "take 2" not in made.takes.content and "one sigma" in made.takes.content)
    assert (tab.folder / "take2.wav").exists()


def test_only_the_result_of_what_is_chosen_now_is_shown_and_opened(tab, monkeypatch):
    gates = {"": threading.Event(), "list.csv": threading.Event()}

    def result(_, day):
        assert gates["list.csv" if day.positions else ""].wait(WAIT)
        return SimpleNamespace(of=day.positions, inputs=None)

    monkeypatch.setattr(takes, "takes_result", result)
    monkeypatch.setattr(module, "measurement_request", lambda inputs: "opened")
    recorder, without, with_list = tab.recorder, Given(), Given("list.csv")
    recorder.takes = (SimpleNamespace(path=tab.folder / "one.wav"),)
    assert recorder.result(without) == (None, None, True)
    gates[""].set()
    assert recorder._results.wait_for(lambda found: found is not None, WAIT)
    assert recorder.result(without)[0].of is None
    assert recorder.result(with_list) == (None, None, True), "the result is that of another list"
    recorder.open_takes()
    assert not tab.opened
    gates["list.csv"].set()
    assert recorder._results.wait_for(lambda found: found.request[1] == with_list, WAIT)
    assert recorder.result(with_list)[0].of == str(tab.folder / "list.csv")
    recorder.open_takes()
    assert tab.opened == ["opened"]
    recorder.takes = ()
    assert recorder.result(with_list) == (None, None, False)


def test_a_card_that_is_connected_later_is_offered_after_another_look(tab, monkeypatch):
    made = tab.tab
    assert "no sound card with inputs; connect it, then press" in made.card.content, "what to do"
    assert "press &quot;Look for a sound card&quot;" in made.card.content
    stream = SimpleNamespace(name="Octa", names=tuple("01234567"), sample_rate=48e3)
    monkeypatch.setattr(take, "sound_card", lambda *_: stream)
    tab.until(lambda: not made.look.disabled)
    assert made.source.options == ("one.wav",)
    tab.recorder.look_for_card()
    tab.until(lambda: made.source.options == (CARD, "one.wav"))
    assert "Octa, 8 inputs, 48000 Hz" in made.card.content and made.source.value == "one.wav"


def test_a_folder_is_listed_only_after_it_has_changed(tab, monkeypatch):
    listed, listdir = [], module.os.listdir
    monkeypatch.setattr(module.os, "listdir", lambda path: listed.append(path) or listdir(path))
    looks = [tab.recorder._list(turn) for turn in range(10)]
    assert len(listed) <= 2 and looks[0] == looks[-1] == module.Folder(("one.wav",), ("list.csv",))
    (tab.folder / "two.wav").touch()
    (tab.folder / "folder.wav").mkdir()
    assert tab.recorder._list(10).recordings == ("one.wav", "two.wav")


def test_a_take_that_a_wav_file_cannot_hold_is_written_as_w64_under_a_number_that_no_take_has(tab, monkeypatch):
    (tab.folder / "take1.w64").write_text("mine")
    for limit, name in ((take.WAV_BYTES, "take2.wav"), (1e3, "take3.w64")):
        monkeypatch.setattr(take, "WAV_BYTES", limit)
        tab.recorder.start(tab.tab._job())
        tab.until(lambda name=name: (tab.folder / name).exists())
        tab.until(lambda: not tab.recorder.running)
        assert soundfile.info(tab.folder / name).duration == pytest.approx(10, abs=0.01)
    assert (tab.folder / "take1.w64").read_text() == "mine"


def test_a_file_is_opened_with_the_report_of_its_import_and_a_fault_is_one_line(tab):
    made = tab.tab
    tab.recorder.opening.newest(made._job())
    tab.until(lambda: "channels     16, 10 s at 4000 Hz" in made.report.content)
    assert tab.opened[0].scene.name == "one"
    (tab.folder / "broken.wav").write_bytes(b"RIFF")
    tab.until(lambda: "broken.wav" in made.source.options)
    set_by_client(made.source, "broken.wav")
    tab.recorder.opening.newest(made._job())
    tab.until(lambda: "broken.wav is not a sound file" in made.report.content)
    made.press()
    tab.until(lambda: "broken.wav is not a sound file" in made.levels.content)
    assert not tab.recorder.takes and len(tab.opened) == 1


def test_a_page_that_other_machines_reach_neither_records_nor_opens(server):
    made = RecordTab(server.gui, None, "")
    made.press()
    made.show(0.0)
    assert not hasattr(made, "record")
    server.gui.reset()


@pytest.mark.parametrize(
    ("host", "alone"), [("127.0.0.1", True), ("localhost", True), ("::1", True), ("0.0.0.0", False), ("", False),
                        ("192.168.1.2", False), ("example.org", False)],
)  # fmt: skip
def test_which_addresses_only_this_machine_reaches(host, alone):
    assert is_loopback(host) is alone
