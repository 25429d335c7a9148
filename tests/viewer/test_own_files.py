"""Files that a browser sends to the page: how they are kept, read and refused."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import soundfile
from doubles import wait_until
from recorded import FS, places, stationary_source, write_places
from viser import _messages

from benchmarks.protocol import ProtocolPage, send
from fdcal import solvers
from fdcal.model.measurement import save_measurement
from fdcal.recordings.importer import import_recording
from fdcal.session import session_file
from fdcal.session.sources import measurement_input, measurement_request
from fdcal.viewer import explore as module
from fdcal.viewer.explore import LIST, RECORDING, OwnFiles
from fdcal.viewer.html import Overlay

COUNT, PART = 16, 65_536


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with a recording, a list, a measurement, a session and a damaged recording."""
    folder = tmp_path_factory.mktemp("files")
    sound, _ = stationary_source(10.0, 30.0, COUNT)
    soundfile.write(folder / "one.wav", 0.1 * sound.T / np.std(sound), FS, subtype="PCM_24")
    write_places(folder / "list.csv", places(COUNT))
    (folder / "broken.wav").write_bytes(b"RIFF")
    measurement, _ = import_recording(folder / "one.wav")
    save_measurement(measurement, folder / "hall.npz")
    mine, problem = measurement_request(measurement_input(measurement, "mine")), measurement.problem("unit")
    start = solvers.load("joint").init(problem, replace(mine.scene.solver, name="joint", modes=12, first_modes=12), 0)
    mine = replace(mine, scene=replace(mine.scene, solver=start.settings), states=(start,))
    (folder / "run.zip").write_bytes(session_file.write(mine))
    return folder


@pytest.fixture
def own(server, files):
    """The receiver of files, a client, a function that sends files and opens them, and what was opened."""
    opened, overlay = [], Overlay(server.gui)
    made = OwnFiles(server, opened.append, lambda: None)
    overlay.acts["own"] = made.open
    with ProtocolPage(f"http://127.0.0.1:{server.get_port()}") as page:
        wait_until(lambda: server.get_clients() and "fdcal command" in page.controls)

        def begin(role, name, size):
            of = {"transfer_uuid": "", "mime_type": "", "part_count": 1, "size_bytes": size}
            send(page.connection, type="FileTransferStartUpload", source_component_uuid=role, filename=name, **of)

        def part(content):
            of = {"source_component_uuid": "", "transfer_uuid": "", "part_index": 0, "content": content}
            send(page.connection, type="FileTransferPart", **of)

        def give(*given, kind="auto 20"):
            for role, name in given:
                content = (files / name).read_bytes()
                begin(role, name, len(content))
                for at in range(0, len(content), PART):
                    part(content[at : at + PART])
            page.set("fdcal command", f"{len(opened)}.{np.random.default_rng().integers(1e9)} own={kind}")

        yield SimpleNamespace(made=made, give=give, opened=opened, begin=begin, part=part, channel=overlay.channel)
    made.close()
    server.gui.reset()
    for kind in (_messages.FileTransferStartUpload, _messages.FileTransferPart):
        server._websock_server.unregister_handler(kind)
    assert not Path(made._folder.name).exists()


def test_each_kind_of_file_is_opened_with_its_report_and_a_fault_is_one_line(own):
    own.give((RECORDING, "one.wav"), (LIST, "list.csv"), kind="stationary 20")
    wait_until(lambda: "channels     16, 10 s at 4000 Hz" in own.made.html())
    assert own.opened[0].scene.name == "one" and own.opened[0].measurement.positions is not None
    for name, title in (("hall.npz", "hall"), ("run.zip", "mine")):
        own.give((RECORDING, name))
        wait_until(lambda title=title: own.opened[-1].scene.name == title)
    own.give((RECORDING, "broken.wav"))
    wait_until(lambda: ">broken.wav is not a sound file" in own.made.html())
    own.give((RECORDING, "run.zip"), (LIST, "list.csv"))
    wait_until(lambda: "run.zip is a session" in own.made.html())
    own.give((RECORDING, "one.wav"), kind="auto hot")
    wait_until(lambda: "temperature" in own.made.html() and not own.made.worker.busy)
    assert len(own.opened) == 3


def test_names_stay_in_the_folder_and_neither_more_bytes_nor_other_roles_are_accepted(own, monkeypatch):
    folder = Path(own.made._folder.name)
    own.begin("elsewhere", "one.wav", 10)
    for name in ("../../evil.wav", "/etc/passwd", "..\\..\\x.wav", "\x1b]0;x\x07.wav", ".hidden", "", "a/x.wav"):
        own.begin(RECORDING, name, 10)
        own.part(b"0123456789")
    wait_until(lambda: own.made._bytes == 70)
    kept = sorted(path.name for path in folder.rglob("*") if path.is_file())
    assert kept == ["__0_x_.wav", "evil.wav", "file", "hidden", "passwd", "x.wav", "x.wav"]
    assert folder.stat().st_mode & 0o077 == 0, "nobody else reads it"
    monkeypatch.setattr(module, "MAX_BYTES", 100)
    own.part(b"0" * 50)  # the part exceeds the announced size and the limit of the page
    wait_until(lambda: "files: use fdcal view FILE" in own.made.html())
    own.begin(RECORDING, "small.wav", 10)  # the rest of an upload is refused, too, even if it would fit
    own.part(b"0" * 10)
    own.give(kind="auto 20")
    wait_until(lambda: own.channel.value.endswith("own=auto 20") and not own.made._delivered)
    assert own.made._bytes == 70 and not own.opened
    own.made.close()
    assert not folder.exists()
    own.begin(RECORDING, "late.wav", 10)
    own.give(kind="auto 20")
    wait_until(lambda: not own.made._delivered)
    assert not folder.exists()
