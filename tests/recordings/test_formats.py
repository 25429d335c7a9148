"""Every format: files of its own library are read, files written here are read by that library, damage is reported.

Writers and readers on the other side are soundfile, sofar, h5py, NumPy, the csv, json and xml modules.
"""

import csv
import json
import os
import signal
import warnings
import xml.dom.minidom
from pathlib import Path

import h5py
import numpy as np
import pytest
import sofar
import soundfile
from recorded import too_large
from running import exit_code, refuses
from scipy.io import savemat
from sofar.io import _write_sofa

from fdcal.model import libraries
from fdcal.model.measurement import MicrophonePositions
from fdcal.model.validation import InputError
from fdcal.recordings import formats
from fdcal.recordings.channels import inspect_channels, require_usable_channels
from fdcal.recordings.formats.positions import read_places
from fdcal.recordings.importer import read_takes
from fdcal.recordings.recording import ImportOptions, read_samples

RATE, N, T = 8000.0, 5, 400
SAMPLES = np.random.default_rng(0).uniform(-0.5, 0.5, (N, T))
PLACES, FOUND = (np.random.default_rng(seed).uniform(-1, 1, (N, 3)) for seed in (1, 2))


def write_wav(path: Path, samples=SAMPLES, subtype="PCM_24") -> Path:
    soundfile.write(path, samples.T, int(RATE), subtype=subtype)
    return path


def write_hdf5(path: Path, samples=SAMPLES) -> Path:
    with h5py.File(path, "w") as file:
        file.create_dataset("time_data", data=samples.T.astype(np.float32)).attrs["sample_freq"] = RATE
    return path


def write_meshrir(path: Path, samples=SAMPLES, places=PLACES, sources: int = 2) -> Path:
    path.mkdir(exist_ok=True)
    np.save(path / "pos_mic.npy", places)
    np.save(path / "pos_src.npy", np.arange(3.0 * sources).reshape(sources, 3))
    for n, row in enumerate(samples):
        np.save(path / f"ir_{n}.npy", np.stack([row * (s + 1) for s in range(sources)]).astype(np.float32))
    return path


def write_npz(path: Path, samples=SAMPLES) -> Path:
    np.savez(path, recordings=samples, sample_rate=RATE, positions=PLACES, kind="impulse")
    return path


CONVENTIONS = {
    **dict.fromkeys(("SingleRoomSRIR", "SingleRoomMIMOSRIR", "SimpleFreeFieldHRIR", "FreeFieldHRIR"), "1.0"),
    **{"GeneralFIR": "1.0", "GeneralFIR-E": "2.0", "SingleRoomDRIR": "0.3", "MultiSpeakerBRIR": "0.3"},
}
EMITTERS = ("SingleRoomMIMOSRIR", "MultiSpeakerBRIR", "GeneralFIR-E")  # emitters have an axis of their own here


def room_sofa(convention: str = "SingleRoomSRIR") -> sofar.Sofa:
    """Return a file without the optional descriptions, because sofar cannot write them with netCDF4 1.7.5."""
    sofa = sofar.Sofa(convention, version=CONVENTIONS[convention])
    for name in [name for name in vars(sofa) if name.endswith("Descriptions")]:
        sofa.delete(name)
    return sofa


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


def written(
    path: Path,
    convention: str,
    moved: bool = False,
    in_degrees: bool = False,
    emitters: int = 1,
    delay=None,
    kelvin: float = 293.15,
):
    """A file of one measurement with N receivers, or of N measurements with one."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sofa = room_sofa(convention)
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
        if convention == "SingleRoomSRIR" and not moved:
            sofa.ReceiverPosition = sofa.ReceiverPosition[:, :, None]  # one position for each measurement
        directed(sofa, "Receiver", receivers)
        if hasattr(sofa, "RoomTemperature"):
            sofa.RoomTemperature = kelvin
        if moved:
            place(sofa, "Source", np.tile([2.0, 1, 0], (N, 1)), False)
            if convention.startswith("SingleRoom"):
                directed(sofa, "Source", N)
            if hasattr(sofa, "MeasurementDate"):
                sofa.MeasurementDate = np.zeros(N)
        # Sofar reads these conventions but no longer writes them.
        if convention in ("SingleRoomDRIR", "MultiSpeakerBRIR"):
            with pytest.raises(ValueError, match="deprecated"):
                sofar.write_sofa(str(path), sofa)
            _write_sofa(str(path), sofa, verify=False)
        else:
            sofar.write_sofa(str(path), sofa)
    return path


def write_sofa(path: Path) -> Path:
    return written(path, "SingleRoomSRIR")


OTHER_SUFFIXES = {".bwf": "WAV", ".aifc": "AIFF", ".snd": "AU", ".sph": "NIST", ".WAV": "WAV"}


def write_container(path: Path, samples=SAMPLES) -> Path:
    kind = OTHER_SUFFIXES.get(path.suffix, path.suffix[1:].upper())
    soundfile.write(path, samples.T, int(RATE), subtype="PCM_16" if kind == "NIST" else "PCM_24", format=kind)
    return path


WRITERS = {
    "a.wav": write_wav,
    "a.flac": write_wav,
    **{f"a.{suffix}": write_container for suffix in ("w64", "rf64", "aiff", "au", "caf")},
    **{f"a{suffix}": write_container for suffix in OTHER_SUFFIXES},
    "a.h5": write_hdf5,
    "a.npz": write_npz,
    "a.sofa": write_sofa,
    "mesh": write_meshrir,
}


@pytest.mark.parametrize("name", WRITERS)
def test_files_of_each_library_are_read(name, tmp_path, request):
    if name in ("a.wav", "a.h5", "mesh"):
        request.getfixturevalue("apart")
    recording = formats.read(WRITERS[name](tmp_path / name))
    assert (recording.count, recording.samples) == SAMPLES.shape
    assert recording.sample_rate == (48_000.0 if name == "mesh" else RATE)
    digits = 1e-4 if name == "a.sph" else 1e-6
    assert np.allclose(read_samples(recording, 0, recording.samples), SAMPLES, atol=digits)
    assert np.allclose(read_samples(recording, 100, 150, [3, 0]), SAMPLES[[3, 0], 100:150], atol=digits)
    if name in ("a.npz", "a.sofa", "mesh"):
        assert np.allclose(recording.positions, PLACES)
        assert recording.kind == "impulse"


def test_the_temperature_of_a_sofa_file_sets_the_sound_speed(tmp_path):
    recording = formats.read(written(tmp_path / "a.sofa", "SingleRoomSRIR", kelvin=303.15))
    assert recording.sound_speed == pytest.approx(349.0, abs=0.1)
    assert formats.read(written(tmp_path / "b.sofa", "SingleRoomSRIR", kelvin=0.0)).sound_speed is None


def test_sofa_of_one_receiver_that_is_moved_and_of_two_sources(tmp_path):
    sofa = room_sofa()
    sofa.Data_IR, sofa.Data_SamplingRate = np.concatenate([SAMPLES, -SAMPLES])[:, None], RATE
    sofa.ListenerPosition = np.concatenate([PLACES, PLACES])
    sofa.ReceiverPosition, sofa.ReceiverPosition_Type = np.array([[0.1, 0, 0]]), "cartesian"
    sofa.ReceiverPosition_Units = "metre"
    sofa.ListenerView, sofa.ListenerUp = np.array([[0.0, 1, 0]]), np.array([[0.0, 0, 1]])
    sofa.MeasurementDate = np.zeros(10)
    sofa.SourcePosition = np.repeat([[2.0, 0, 0], [0, 2.0, 0]], 5, axis=0)
    sofar.write_sofa(str(tmp_path / "moved.sofa"), sofa)
    for source, sign in ((0, 1), (1, -1)):
        recording = formats.read(tmp_path / "moved.sofa", source)
        assert np.allclose(recording.positions, PLACES + [0, 0.1, 0]), "the receiver turns with the listener"
        assert np.allclose(read_samples(recording, 0, 400), sign * SAMPLES)


def in_sofa(change):
    """Function of a path that writes a valid file and then changes it."""

    def write(path: Path) -> None:
        import netCDF4

        write_sofa(path)
        with netCDF4.Dataset(path, "a") as file:
            change(file)

    return write


def refusal(path: Path) -> str:
    def usable():
        recording = formats.read(path)
        require_usable_channels(recording, inspect_channels(recording))

    return str(refuses("", usable))


def in_hdf5(change):
    """Function of a path that writes a valid file and then changes it."""

    def write(path: Path) -> None:
        with h5py.File(write_hdf5(path), "a") as file:
            change(file)

    return write


def in_mesh(name: str, change):
    """Function of a path that writes a valid folder and then changes one of its files."""
    return lambda path: change(write_meshrir(path) / name)


def of_channel(number: int, values):
    """Function of a path that writes a sound with other samples in a channel."""
    return lambda path: write_wav(path, np.where(np.arange(N)[:, None] == number, values, SAMPLES), "FLOAT")


@pytest.mark.parametrize(
    ("name", "write", "words"),
    [
        ("nothing.wav", lambda path: None, "No such file"),
        ("a.doc", lambda path: path.write_text("x"), "fdcal cannot read the format of"),
        ("a.txt", lambda path: path.write_text("x"), "not a table of samples; give one line for each time"),
        ("a.csv", lambda path: path.write_text("16000\n0.1,0.2\n0.3,0.4"), "lines of 1 and of 2 numbers; give"),
        ("a.csv", lambda path: path.write_text("name,x,y\n0,1,2\n"), "a table of positions; give it as positions"),
        ("a.npy", lambda path: np.save(path, SAMPLES),
         'no sampling rate beside "a" (5 channels, 400 samples); give rate'),
        ("a.npy", lambda path: np.save(path, SAMPLES * 1j), "does not hold an array of real numbers"),
        ("a.npz", lambda path: np.savez(path, left=SAMPLES, right=SAMPLES, fs=8e3),
         'several arrays that may be the samples: "left" (5, 400), "right" (5, 400); call the samples'),
        ("a.npz", lambda path: np.savez(path, x=SAMPLES[:, :9], y=SAMPLES[:0], fs=8e3), 'no array of real samples'),
        ("a.mat", lambda path: savemat(path, {"x": SAMPLES[:, :20].repeat(3, 0), "fs": 8e3}), "which axis of"),
        ("a.mat", lambda path: savemat(path, {"x": SAMPLES, "fs": 8e3, "rate": 9e3}), "several sampling rates: fs"),
        ("a.mat", lambda path: savemat(path, {"p": SAMPLES[0], "azi_rad": SAMPLES[0], "ele_rad": SAMPLES[0]}),
         "an impulse response with directions; use it as the room of a scene"),
        ("a.wav", lambda path: os.truncate(write_wav(path), path.stat().st_size // 2), "truncated"),
        ("a.npz", lambda path: np.savez(path, recordings=SAMPLES), "no sampling rate"),
        ("a.h5", in_hdf5(lambda file: file["time_data"].attrs.pop("sample_freq")), "no sampling rate"),
        ("a.h5", in_hdf5(lambda file: file.pop("time_data")), "no array of real samples"),
        ("a.h5", in_hdf5(lambda file: file["time_data"].attrs.update(sample_freq="1.2.3")), 'freq" is 1.2.3; give'),
        ("a.h5", in_hdf5(lambda file: file["time_data"].__setitem__((7, 1), np.nan)), 'sample 7 of channel "1" is not'),
        ("mesh", in_mesh("ir_3.npy", Path.unlink), "no ir_3.npy"),
        ("mesh", in_mesh("ir_3.npy", lambda path: np.save(path, np.zeros((2, 7)))), "ir_3.npy has shape (2, 7)"),
        ("mesh", in_mesh("ir_3.npy", lambda path: os.truncate(path, 900)), "ir_3.npy is damaged or truncated"),
        ("mesh", in_mesh("ir_3.npy", lambda path: np.save(path, np.full((2, T), 1e300))),
         'sample 0 of channel "3" is 1e+300, too large for a sound'),
        ("mesh", in_mesh("pos_mic.npy", lambda path: np.save(path, PLACES[:, :2])), "pos_mic.npy has shape (5, 2)"),
        ("a.sofa", in_sofa(lambda f: f["ReceiverPosition"].setncattr("Units", "degree, degree, metre")), "in degrees"),
        ("a.sofa", in_sofa(lambda f: f["ReceiverPosition"].__setitem__(slice(None), np.nan)), "empty or not finite"),
        ("a.sofa", in_sofa(lambda f: f.renameVariable("Data.IR", "Data.XX")), 'neither "Data.IR"'),
        ("a.sofa", in_sofa(lambda f: f.renameVariable("SourcePosition", "Elsewhere")), 'has no "SourcePosition"'),
        ("a.sofa", in_sofa(lambda f: f["ListenerView"].__setitem__(slice(None), [0, 0, 1.0])), "not two directions"),
        ("a.wav", of_channel(2, 0.0), "channel 2 is silent"),
        ("a.wav", of_channel(3, np.clip(5 * SAMPLES[3], -0.9, 0.9)), "channel 3 is clipped"),
        ("a.wav", of_channel(4, SAMPLES[1]), "channel 4 is a copy of 1"),
        ("a.wav", of_channel(1, np.where(np.arange(T) == 17, np.nan, SAMPLES[1])),
         'sample 17 of channel "1" is not a finite'),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("error", "ignore::ResourceWarning")  # another test may have left a file open
def test_the_fault_of_a_file_is_named(name, write, words, tmp_path):
    write(tmp_path / name)
    assert words in refusal(tmp_path / name)


def write_mat73(path: Path) -> None:
    """Write a file as MATLAB does: HDF5 after 512 bytes, every array transposed, texts as numbers."""
    with h5py.File(path, "w", userblock_size=512) as file:
        file["rec/data"], file["rec/fs"], file["sound_speed"] = SAMPLES, [[RATE]], [[340.0]]
        file.create_dataset("note", data=np.arange(40, dtype=np.uint16)[None]).attrs["MATLAB_class"] = np.bytes_("char")
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")


def in_groups(file: h5py.File) -> None:
    file["raw/pa"] = SAMPLES
    file["raw/pa"].attrs["sampleRateHz"] = RATE
    file["meta/microphonePositionsM"], file["meta/serials"] = PLACES.T, np.arange(N)
    file["names"], file["kind"], file["none"] = list("abcde"), np.bytes_("impulse"), h5py.Empty("f8")


def at_root(rate):
    return in_hdf5(lambda file: (file["time_data"].attrs.pop("sample_freq"), file.attrs.update(sample_freq=rate)))


def write_table(path: Path, header: str = "", delimiter: str = ",", times=None, decimal: str = ".") -> None:
    table = SAMPLES.T if times is None else np.column_stack([times, SAMPLES.T])
    text = "\n".join(delimiter.join(f"{x:.9g}".replace(".", decimal) for x in row) for row in table)
    path.write_text(f"{header}\n{text}\n" if header else text)


SECONDS, NUMBERS = np.arange(T) / RATE, np.arange(T)
ARRAYS = [  # name, writer, whether the file has no rate
    ("a.npy", lambda path: np.save(path, SAMPLES.T), True),
    ("a.npz", lambda path: np.savez(path, SAMPLES.T), True),
    ("a.npz", lambda path: np.savez(path, x=SAMPLES[None], fs=RATE, positions=PLACES), False),
    ("a.npz", lambda path: np.savez(path, p=SAMPLES, t=SECONDS), False),
    ("b.mat", lambda path: savemat(path, {"x": SAMPLES.T, "Fs": RATE, "names": np.array([*"abcde"], object)}), False),
    ("a.mat", lambda path: savemat(path, {"rec": {"audio": SAMPLES, "samplingRate_kHz": RATE / 1000}}), False),
    ("a.mat", write_mat73, False),
    ("a.h5", lambda path: write_hdf5(path, SAMPLES.T), False),
    ("a.hdf5", at_root(RATE), False),
    ("a.h5", at_root("8 kHz"), False),
    ("b.h5", in_hdf5(lambda file: (file.pop("time_data"), in_groups(file))), False),
    ("a.csv", write_table, True),
    ("b.csv", lambda path: write_table(path, "time,a,b,c,d,e", times=SECONDS), False),
    ("a.csv", lambda path: write_table(path, ",0,1,2,3,4", times=NUMBERS), True),
    ("b.csv", lambda path: write_table(path, "t_s,a,b,c,d,e", times=SECONDS.round(3)), True),
    ("a.txt", lambda path: write_table(path, "# of a logger", " "), True),
    ("b.tsv", lambda path: write_table(path, "t (ms)\ta\tb\tc\td\te", "\t", 1000 * SECONDS), False),
    ("b.csv", lambda path: write_table(path, "Zeit_ms;a;b;c;d;e", ";", 1000 * SECONDS, ","), False),
]


@pytest.mark.parametrize(("name", "write", "without_rate"), ARRAYS)
def test_arrays_as_people_write_them_are_read(name, write, without_rate, tmp_path):
    write(tmp_path / name)
    recording = formats.read(tmp_path / name, rate=RATE if without_rate else None)
    assert (recording.count, recording.samples, recording.sample_rate) == (N, T, RATE)
    assert recording.names == tuple("abcde" if name[0] == "b" else "01234")
    assert np.allclose(read_samples(recording, 0, T), SAMPLES, atol=1e-6)
    assert recording.positions is None or np.allclose(recording.positions, PLACES)
    if not without_rate:
        refuses(r"a sampling rate of 8000 Hz; leave out rate", formats.read, tmp_path / name, rate=9000.0)


def changed(name: str, *changes: tuple[bytes, int, bytes]):
    """Function of a path that writes a sound file with other bytes at places counted from those of markers."""

    def write(path: Path) -> None:
        data = bytearray(write_container(path.with_name(name)).read_bytes())
        for marker, place, content in changes:
            at = data.index(marker) + place
            data[at : at + len(content)] = content
        path.write_bytes(data)

    return write


def of_length(length: int):
    return changed("b.wav", (b"data", 4, length.to_bytes(4, "little")))


LENGTH = 3 * N * T  # number of bytes of the samples
ZEROS = (b"ds64", 8, bytes(24))
LENGTHS = {
    **{f"{length:#x}.wav": of_length(length) for length in (0x7FFFF000, 0x80000000, 0x7FFFFF00, 0xFFFFFFFF, 0)},
    "header.wav": of_length(LENGTH + 44),
    "zero.rf64": changed("b.rf64", ZEROS),
    "zero.bw64": changed("b.rf64", ZEROS, (b"RF64", 0, b"BW64")),
    "pipe.au": changed("b.au", (b".snd", 8, bytes(4))),
    "pipe.caf": changed("b.caf", (b"data", 4, b"\xff" * 8)),
    "pipe.aiff": changed("b.aiff", (b"SSND", 4, b"\x7f\xff\xf0\0")),
    "pipe.flac": changed("b.flac", (b"fLaC", 21, bytes([0x70, 0, 0, 0, 0]))),
}


@pytest.mark.parametrize("name", LENGTHS)
def test_a_wrong_length_in_the_header_is_replaced_by_that_of_the_file(name, tmp_path, caplog):
    LENGTHS[name](tmp_path / name)
    recording = formats.read(tmp_path / name)
    assert np.allclose(read_samples(recording, 0, T), SAMPLES, atol=1e-6) and recording.samples == T
    remark = "the length in its header is not that of the file, which is read to its end"
    assert [one.message for one in caplog.records] == [f"{tmp_path / name}: {remark}"]
    if name == "header.wav":  # this file really lacks samples
        os.truncate(tmp_path / name, 44 + LENGTH - 300)
        assert "is truncated" in refusal(tmp_path / name)


def test_transfer_functions_are_read_as_impulse_responses(tmp_path):
    sofa, spectrum = sofar.Sofa("GeneralTF"), np.fft.rfft(SAMPLES)
    sofa.ReceiverPosition, sofa.ReceiverPosition_Type, sofa.ReceiverPosition_Units = PLACES, "cartesian", "metre"
    for first in (0, 2):
        sofa.N = RATE / T * np.arange(first, spectrum.shape[1])
        sofa.Data_Real, sofa.Data_Imag = spectrum.real[None, :, first:], spectrum.imag[None, :, first:]
        sofar.write_sofa(str(tmp_path / "a.sofa"), sofa)
        found, known = formats.read(tmp_path / "a.sofa"), np.where(np.arange(T // 2 + 1) < first, 0, spectrum)
        assert (found.sample_rate, found.lowest, found.kind) == (RATE, first * RATE / T, "impulse")
        assert np.allclose(read_samples(found, 0, T), np.fft.irfft(known)) and np.allclose(found.positions, PLACES)
    sofa.N = sofa.N**2
    sofar.write_sofa(str(tmp_path / "a.sofa"), sofa)
    assert 'the frequencies "N" are not evenly spaced from 0' in refusal(tmp_path / "a.sofa")


def half_precision(file: h5py.File) -> None:
    kept = dict(file["SourcePosition"].attrs)
    del file["SourcePosition"]
    file.create_dataset("SourcePosition", (1, 3), "f2").attrs.update({key: kept[key] for key in ("Type", "Units")})


def linked(file: h5py.File) -> None:
    del file["Data.IR"]
    file["Data.IR"] = h5py.SoftLink("/aside/IR")
    file["aside"] = h5py.ExternalLink("/etc/passwd", "/")


def outside(file: h5py.File) -> None:
    file.create_dataset("aside", (5,), "u1", external=[("/etc/passwd", 0, 5)])


def through(file: h5py.File) -> None:
    layout = h5py.VirtualLayout((5,), "u1")
    layout[:] = h5py.VirtualSource("other.h5", "x", (5,))
    file.create_virtual_dataset("aside", layout)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (half_precision, "cannot be read"),  # netCDF 4.10 crashes on this type
        (linked, '"aside" is a link to /etc/passwd, and fdcal reads no other file'),
        (outside, '"aside" has its values in /etc/passwd'),
        (through, '"aside" is a virtual dataset'),
    ],
)
@pytest.mark.filterwarnings("error", "ignore::ResourceWarning")
def test_an_hdf5_file_of_another_structure_is_refused_in_one_line(change, words, tmp_path, request):
    if change is half_precision:
        request.getfixturevalue("apart")
    with h5py.File(write_sofa(tmp_path / "a.sofa"), "a") as file:
        change(file)
    said = refusal(tmp_path / "a.sofa")
    assert "a.sofa" in said and words in said


def test_a_header_that_announces_what_is_not_there_is_refused(tmp_path, apart):
    for shape in ((10**12, 32), (100, 10**9)):
        with h5py.File(tmp_path / "a.h5", "w") as file:
            data = file.create_dataset("time_data", shape=shape, dtype="f4", chunks=(64, 32))
            data.attrs["sample_freq"] = RATE
        assert "a.h5" in refusal(tmp_path / "a.h5")


def test_a_long_recording_is_read_in_blocks(tmp_path, monkeypatch):
    monkeypatch.setattr(formats, "MAX_HELD", 0)
    for path in (write_hdf5(tmp_path / "b.h5"), write_sofa(tmp_path / "a.sofa")):
        assert np.allclose(read_samples(formats.read(path), 3, 90, [2, 0]), SAMPLES[[2, 0], 3:90])


@pytest.mark.parametrize(("function", "words"), [
    (os.abort, "crashed, SIGABRT; copy it again"), (signal.pause, "it takes more than 1 s; copy it again"),
    (too_large, "it takes more than 4 GB of memory; copy it again"),
])  # fmt: skip
def test_a_reader_that_crashes_hangs_or_takes_all_memory_ends_in_one_line(function, words, monkeypatch, apart):
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]), prepend=os.pathsep)
    if function is signal.pause:
        monkeypatch.setattr(libraries, "SECONDS", 1.0)
    said = str(refuses("", libraries.isolated_call, "room.sofa", function))
    assert said.startswith("room.sofa") and words in said


def clipped(samples, subtype: str, path: Path) -> list[int]:
    write_wav(path, samples, subtype)
    return np.flatnonzero(inspect_channels(formats.read(path)).clipped).tolist()


def test_clipped_peaks_are_found_even_if_they_are_short(tmp_path):
    # White noise hardly ever exceeds the limit in two neighbouring samples.
    over = 0.1 * np.random.default_rng(0).standard_normal((4, 20_000))
    over[1] *= 3
    assert np.sum(np.abs(over[1]) > 1) > 10
    loud = np.clip(over, -1, 1)
    assert clipped(loud, "PCM_16", tmp_path / "a.wav") == clipped(loud, "FLOAT", tmp_path / "b.wav") == [1]
    assert clipped(0.37 * loud, "FLOAT", tmp_path / "c.wav") == [1], "before it was made quieter"


def test_sound_near_full_scale_is_not_called_clipped(tmp_path):
    noise = np.random.default_rng(0).standard_normal((16, 200_000))
    for size, subtype in ((0.9, "PCM_16"), (30 / 32768, "PCM_16"), (5 / 32768, "PCM_16"), (1.0, "PCM_24")):
        assert clipped(noise / np.abs(noise).max() * size, subtype, tmp_path / "a.wav") == []
    loop = np.tile(noise[:4, :5000], (1, 20))
    assert clipped(loop / np.abs(loop).max() * 0.9, "PCM_16", tmp_path / "b.wav") == []
    tone = 0.8 * np.sin(2 * np.pi * 440 * np.arange(48_000) / 48_000 + np.arange(4)[:, None])
    assert clipped(tone, "FLOAT", tmp_path / "c.wav") == []


# Positions are written to files.

PLACED = MicrophonePositions(
    ("a", "b & <c>", "ü", "d", "e"), PLACES, np.array([0.001, 0.002, 0.003, 0.004, 1 / 3]), "known"
)


@pytest.mark.parametrize(
    "placed", [PLACED, MicrophonePositions(PLACED.names, PLACES[:, :2])], ids=["space", "plane, no uncertainty"]
)
def test_names_positions_and_uncertainty_are_written(placed, tmp_path):
    """Readers of csv, json, `acoular.MicGeom` and `pyroomacoustics` read them; SOFA is tested below."""
    for suffix in ("csv", "json", "xml", "npy"):
        formats.write(tmp_path / f"p.{suffix}", placed)
    with open(tmp_path / "p.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    microphones = json.loads((tmp_path / "p.json").read_text(encoding="utf-8"))["microphones"]
    elements = xml.dom.minidom.parse(str(tmp_path / "p.xml")).getElementsByTagName("pos")
    names, positions = read_places(tmp_path / "p.csv")
    for found in ([row["name"] for row in rows], [one["name"] for one in microphones], names,
                  [element.getAttribute("Name") for element in elements]):  # fmt: skip
        assert found == list(placed.names)
    for found in (*([[row[a] for a in "xyz"] for row in table] for table in (rows, microphones)), positions,
                  [[e.getAttribute(a) for a in "xyz"] for e in elements], np.load(tmp_path / "p.npy").T):  # fmt: skip
        np.testing.assert_allclose(np.array(found, float), placed.positions, rtol=0, atol=5.1e-8)
    sigma = [None] * 5 if placed.uncertainty is None else placed.uncertainty.tolist()
    assert [one["uncertainty"] for one in microphones] == sigma
    assert [row["uncertainty"] for row in rows] == ["" if one is None else f"{one:.7f}" for one in sigma]


def test_sofa_is_written_by_the_numbers_of_the_channels(tmp_path):
    for placed, expected in ((PLACED, PLACES), (MicrophonePositions(tuple("43210"), FOUND), FOUND[::-1])):
        formats.write(tmp_path / "p.sofa", placed)
        back = sofar.read_sofa(str(tmp_path / "p.sofa"), verbose=False)
        assert np.allclose(np.reshape(back.ReceiverPosition, (N, 3)), expected)


COMMANDS = (
    ["export", "r.json", "-o", "r.json"],
    ["import", "m.npz", "-o", "m.npz"],
    ["import", "a.wav", "--reference", "m.npz", "-o", "m.npz"],
)


@pytest.mark.parametrize("command", COMMANDS)
def test_the_input_is_never_the_output(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path(command[-1]).write_text("mine")
    Path("link" + Path(command[-1]).suffix).hardlink_to(command[-1])
    for output in (command[-1], "link" + Path(command[-1]).suffix):
        assert exit_code(*command[:-1], output, "--force") == 2
        assert "is the input itself" in capsys.readouterr().err
    assert Path(command[-1]).read_text() == "mine"


# The library sofar writes every convention for rooms, with all receivers in one measurement or one receiver that moves.


@pytest.mark.parametrize("moved", [False, True], ids=["receivers side by side", "one that is moved"])
@pytest.mark.parametrize("convention", CONVENTIONS)
def test_every_convention_is_read(convention, moved, tmp_path, capfd):
    recording = formats.read(written(tmp_path / "a.sofa", convention, moved, in_degrees=True))
    assert np.allclose(recording.positions, PLACES)
    assert np.allclose(read_samples(recording, 0, T), SAMPLES)
    assert capfd.readouterr() == ("", ""), "the library prints nothing"


@pytest.mark.parametrize("convention", EMITTERS)
def test_the_emitter_asked_for_is_read_and_each_is_a_take_when_all_are(convention, tmp_path):
    path = written(tmp_path / "a.sofa", convention, emitters=3)
    takes = read_takes([path], ImportOptions(source="all"))
    assert [one.path for one in takes] == [f"{path}, source {n}" for n in range(3)]
    for source, take in enumerate(takes):
        recording = formats.read(path, source)
        assert (recording.count, recording.samples) == (N, T)
        assert np.allclose(read_samples(recording, 7, 50, [3, 1]), (source + 1) * SAMPLES[[3, 1], 7:50])
        assert np.allclose(read_samples(take, 0, T), SAMPLES * (source + 1))
    refuses("source = 3 does not exist; the file has sources 0 to 2", formats.read, path, 3)
    assert len(read_takes([written(tmp_path / "b.sofa", "GeneralFIR")], ImportOptions(source="all"))) == 1


def test_a_delay_is_applied_and_one_of_a_fraction_of_a_sample_is_refused(tmp_path):
    delay = np.array([103.0, 100, 101, 107, 100])
    recording = formats.read(written(tmp_path / "a.sofa", "SingleRoomSRIR", delay=delay))
    assert recording.samples == T + 7
    samples_read = read_samples(recording, 0, T + 7)
    for row, samples, begin in zip(samples_read, SAMPLES, (3, 0, 1, 7, 0), strict=True):
        assert np.allclose(row, np.pad(samples, (begin, 7 - begin)))
    assert np.array_equal(read_samples(recording, 2, 64, [3, 0]), samples_read[[3, 0], 2:64])
    with pytest.raises(InputError, match=r'"Data.Delay" differs by up to 0.5 samples'):
        formats.read(written(tmp_path / "b.sofa", "SingleRoomSRIR", delay=delay * 0.5 % 1))
