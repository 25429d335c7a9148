"""SOFA: every convention for rooms that sofar writes, receivers side by side or one that is moved; there and back."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import sofar
from sofar.io import _write_sofa

from fdcal.assessment.calibration import Calibration
from fdcal.assessment.result_file import save_result
from fdcal.commands.cli import main
from fdcal.model.given_positions import MicrophonePositions
from fdcal.model.validation import InputError, StorageError
from fdcal.recordings import formats
from fdcal.recordings.import_options import ImportOptions
from fdcal.recordings.importer import read_takes
from fdcal.recordings.recording import read_samples

RATE, N, T = 8000.0, 5, 60
SAMPLES = np.random.default_rng(0).uniform(-0.5, 0.5, (N, T))
PLACES = np.random.default_rng(1).uniform(-1, 1, (N, 3))
FOUND = np.random.default_rng(2).uniform(-1, 1, (N, 3))
CONVENTIONS = {
    "SingleRoomSRIR": "1.0",
    "SingleRoomMIMOSRIR": "1.0",
    "SingleRoomDRIR": "0.3",
    "MultiSpeakerBRIR": "0.3",
    "GeneralFIR": "1.0",
    "GeneralFIR-E": "2.0",
    "SimpleFreeFieldHRIR": "1.0",
    "FreeFieldHRIR": "1.0",
}
EMITTERS = ("SingleRoomMIMOSRIR", "MultiSpeakerBRIR", "GeneralFIR-E")  # with an axis of their own


def spherical(places):
    x, y, z = places.T
    angles = np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))
    return np.stack([*angles, np.linalg.norm(places, axis=1)], axis=1)


def directed(sofa, name: str, count: int) -> None:
    for key, direction in (("View", [1.0, 0, 0]), ("Up", [0, 0, 1.0])):
        if hasattr(sofa, name + key):
            setattr(sofa, name + key, np.tile(direction, (count, 1)))


def place(sofa, name: str, places, in_degrees: bool) -> None:
    setattr(sofa, f"{name}Position", spherical(places) if in_degrees else places)
    setattr(sofa, f"{name}Position_Type", "spherical" if in_degrees else "cartesian")
    setattr(sofa, f"{name}Position_Units", "degree, degree, metre" if in_degrees else "metre")


def written(path: Path, convention: str, moved: bool = False, in_degrees: bool = False, emitters: int = 1, delay=None):
    """A file of one measurement with N receivers, or of N measurements with one."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sofa = sofar.Sofa(convention, version=CONVENTIONS[convention])
        for name in [name for name in vars(sofa) if name.endswith("Descriptions")]:
            sofa.delete(name)
        samples, receivers = (SAMPLES[:, None] if moved else SAMPLES[None]), 1 if moved else N
        sofa.Data_Delay = np.zeros((1, receivers)) if delay is None else delay[None]
        if convention in EMITTERS:
            samples = np.stack([samples * (e + 1) for e in range(emitters)], axis=-1)
            samples = np.moveaxis(samples, 3, 2) if convention == "MultiSpeakerBRIR" else samples
            sofa.Data_Delay = np.zeros((1, receivers, emitters))
            sofa.EmitterPosition = np.arange(3.0 * emitters).reshape(emitters, 3)
            directed(sofa, "Emitter", emitters)
        sofa.Data_IR, sofa.Data_SamplingRate = samples, RATE
        place(sofa, "Listener", PLACES if moved else np.zeros((1, 3)), in_degrees and moved)
        place(sofa, "Receiver", np.zeros((1, 3)) if moved else PLACES, in_degrees and not moved)
        directed(sofa, "Receiver", receivers)
        if moved:
            place(sofa, "Source", np.tile([2.0, 1, 0], (N, 1)), False)
            if convention.startswith("SingleRoom"):
                directed(sofa, "Source", N)
            if hasattr(sofa, "MeasurementDate"):
                sofa.MeasurementDate = np.zeros(N)
        if convention in ("SingleRoomDRIR", "MultiSpeakerBRIR"):  # which sofar reads and no longer writes
            with pytest.raises(ValueError, match="deprecated"):
                sofar.write_sofa(str(path), sofa)
            _write_sofa(str(path), sofa, verify=False)
        else:
            sofar.write_sofa(str(path), sofa)
    return path


@pytest.mark.parametrize("moved", [False, True], ids=["receivers", "moved"])
@pytest.mark.parametrize("convention", CONVENTIONS)
def test_every_convention_is_read_and_its_positions_are_filled_in(convention, moved, tmp_path, capfd):
    path = written(tmp_path / "a.sofa", convention, moved, in_degrees=True)
    recording = formats.read(path)
    assert np.allclose(recording.positions, PLACES)
    assert np.allclose(read_samples(recording, 0, T), SAMPLES)
    before = path.read_bytes()
    formats.write(tmp_path / "b.sofa", "b.sofa", MicrophonePositions(tuple("43210"), FOUND), str(path))
    back = formats.read(tmp_path / "b.sofa")
    assert np.allclose(back.positions, FOUND[::-1]), "by the names of the channels"
    assert np.allclose(read_samples(back, 0, T), SAMPLES)
    assert path.read_bytes() == before
    assert capfd.readouterr() == ("", ""), "the library has nothing to tell"


@pytest.mark.parametrize("convention", EMITTERS)
def test_every_source_is_a_take_when_all_are_asked_for(convention, tmp_path):
    path = written(tmp_path / "a.sofa", convention, emitters=3)
    takes = read_takes([path], ImportOptions(source="all"))
    assert [one.path for one in takes] == [f"{path}, source {n}" for n in range(3)]
    for number, one in enumerate(takes):
        assert np.allclose(read_samples(one, 0, T), SAMPLES * (number + 1))
    single = written(tmp_path / "b.sofa", "GeneralFIR")
    assert len(read_takes([single], ImportOptions(source="all"))) == 1


@pytest.mark.parametrize("convention", EMITTERS)
def test_the_emitter_asked_for_is_read(convention, tmp_path):
    path = written(tmp_path / "a.sofa", convention, emitters=3)
    for source in range(3):
        recording = formats.read(path, source)
        assert (recording.count, recording.samples) == (N, T)
        assert np.allclose(read_samples(recording, 7, 50, [3, 1]), (source + 1) * SAMPLES[[3, 1], 7:50])
    with pytest.raises(InputError, match="sources 0 to 2"):
        formats.read(path, 3)


@pytest.mark.parametrize("order", [1, -1], ids=["same order", "reverse order"])
def test_positions_of_one_source_s_measurements_are_given_to_another_s_only_in_the_same_order(order, tmp_path):
    path = written(tmp_path / "a.sofa", "GeneralFIR", moved=True)
    sofa = sofar.read_sofa(str(path), verbose=False)
    sofa.Data_IR = np.concatenate([SAMPLES, SAMPLES[::order]])[:, None]
    sofa.ListenerPosition = np.concatenate([PLACES, PLACES[::order]])
    sofa.SourcePosition = np.repeat([[2.0, 1, 0], [5.0, 1, 0]], N, axis=0)
    sofar.write_sofa(str(path), sofa)
    placed = MicrophonePositions(tuple("01234"), FOUND)
    if order < 0:
        with pytest.raises(InputError, match="in different orders; leave out original"):
            formats.write(tmp_path / "b.sofa", "b.sofa", placed, str(path))
        return
    formats.write(tmp_path / "b.sofa", "b.sofa", placed, str(path))
    for source in (0, 1):
        assert np.allclose(formats.read(tmp_path / "b.sofa", source).positions, FOUND)


def test_a_delay_is_applied_and_one_that_is_no_sample_is_refused(tmp_path):
    delay = np.array([103.0, 100, 101, 107, 100])
    recording = formats.read(written(tmp_path / "a.sofa", "SingleRoomSRIR", delay=delay))
    assert recording.samples == T + 7
    samples_read = read_samples(recording, 0, T + 7)
    for row, samples, begin in zip(samples_read, SAMPLES, (3, 0, 1, 7, 0), strict=True):
        assert np.allclose(row, np.pad(samples, (begin, 7 - begin)))
    assert np.array_equal(read_samples(recording, 2, 64, [3, 0]), samples_read[[3, 0], 2:64])
    with pytest.raises(InputError, match=r'"Data.Delay" differs by 0.5 samples'):
        formats.read(written(tmp_path / "b.sofa", "SingleRoomSRIR", delay=delay * 0.5 % 1))


@pytest.mark.parametrize(
    ("suffix", "original", "words", "code"),
    [
        ("csv", "a.sofa", "--original a.sofa is for -o FILE.sofa", 2),
        ("sofa", "a.wav", "original = a.wav is no SOFA file", 2),
        ("sofa", "nothing.sofa", "cannot read nothing.sofa", 3),
        ("sofa", "junk.sofa", "original = junk.sofa cannot be read", 2),
        ("sofa", "a.sofa", "5 receiver positions, the result 4 microphones", 2),
    ],
)
def test_an_original_that_cannot_be_is_refused(suffix, original, words, code, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    written(Path("a.sofa"), "SingleRoomSRIR")
    Path("junk.sofa").write_text("junk")
    result = Calibration(FOUND[:4], tuple("0123"), "joint", 0, np.array([50.0]), 0.1, 3, 1.5, True, known=())
    save_result(result, "r.json")
    with pytest.raises(SystemExit) as ended:
        main(["export", "r.json", "-o", f"p.{suffix}", "--original", original])
    assert ended.value.code == code
    line = capsys.readouterr().err
    assert words in line and line.count("\n") == 1
    assert not list(tmp_path.glob("p.*"))


def test_a_file_that_cannot_be_read_is_no_fault_of_the_output(tmp_path):
    with pytest.raises(StorageError, match=r"^cannot read .*nothing\.sofa"):
        formats.write(
            tmp_path / "b.sofa", "b.sofa", MicrophonePositions(tuple("01234"), FOUND), str(tmp_path / "nothing.sofa")
        )
