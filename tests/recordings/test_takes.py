"""Several files, sources or parts of a recording: takes of one array, or the channels of one take."""

import dataclasses
import threading
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import recorded
import soundfile
from recorded import FS, SPEED, mismatch_db, noisy, places, write_places
from running import exit_code, refuses, run
from scipy.signal import butter, fftconvolve, resample_poly, sosfilt

import fdcal
from fdcal.model.measurement import save_measurement
from fdcal.model.validation import InputError
from fdcal.recordings import channels
from fdcal.recordings.cross_spectra import room_spacing, stationary_pressures
from fdcal.recordings.frequencies import default_max_rows
from fdcal.recordings.importer import import_recording, import_summary, measurement_of_takes, split
from fdcal.recordings.impulse_response import require_quiet_end, segment_levels
from fdcal.recordings.recording import ImportOptions, recording_of

COUNT = 16
SOURCES = ((4.3, 3.4, 0.8), (0.6, 3.2, 2.3), (4.4, 0.5, 2.5))  # m
GIVEN = {"sound_speed": SPEED, "array_radius": 0.5}


def responses(source: int) -> np.ndarray:
    """Impulse responses (COUNT, 2400) of one place of the source."""
    return recorded.responses(COUNT, SOURCES[source])


def playing(source: int, seconds: float, seed: int) -> np.ndarray:
    """What the array records of noise (COUNT, T) of unit power."""
    signal = np.random.default_rng(seed).standard_normal(int(seconds * FS) + 2399)
    heard = np.array([fftconvolve(signal, h, mode="valid") for h in responses(source)])
    return heard / np.sqrt(np.mean(heard**2))


def write(path: Path, samples: np.ndarray, rate: int = FS) -> Path:
    soundfile.write(path, 0.9 * np.atleast_2d(samples).T / np.abs(samples).max(), rate, subtype="FLOAT")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Responses to three sources, the channels of the first one on their own, and a stationary source."""
    path = tmp_path_factory.mktemp("takes")
    for s in range(3):
        write(path / f"take{s}.wav", noisy(responses(s), 50, seed=s))
    (path / "single").mkdir()
    for n, row in enumerate(soundfile.read(path / "take0.wav")[0].T):
        soundfile.write(path / "single" / f"mic{n:02d}.wav", row, FS, subtype="FLOAT")
    write(path / "still.wav", noisy(playing(0, 24, 5), 40))
    return path


def same(one: fdcal.Measurement, other: fdcal.Measurement) -> None:
    for key in ("frequencies", "pressures", "wavenumbers", "noise_power", "takes"):
        assert np.array_equal(getattr(one, key), getattr(other, key)), key


def test_files_of_the_same_channels_are_takes(folder, tmp_path, monkeypatch, capsys):
    files = [folder / f"take{s}.wav" for s in range(3)]
    single = [fdcal.load(file, **GIVEN, max_rows=40) for file in files]
    together = fdcal.load(files, **GIVEN, max_rows=120)
    assert together.take_count == 3
    same(together, fdcal.Measurement.from_takes(single))
    monkeypatch.chdir(tmp_path)
    run("import", *files, "-o", "m.npz", "--sound-speed", SPEED, "--array-radius", "0.5", "--max-rows", 120)
    printed = capsys.readouterr().out
    assert f"takes        3, each of {COUNT} channels" in printed and f"{len(together.frequencies)} in all" in printed
    assert "take 2" in printed and "take2.wav: 0.6 s" in printed
    same(fdcal.load("m.npz"), together)


def test_files_of_one_channel_are_the_channels_of_one_take(folder):
    files = sorted((folder / "single").iterdir())
    for file in files[:2]:  # macOS adds such a file to each file on a foreign disk
        (folder / "single" / f"._{file.name}").write_bytes(b"\0\5\x16\7")
    same(fdcal.load(folder / "single", **GIVEN), fdcal.load(files, **GIVEN))
    joined, whole = fdcal.load(files, **GIVEN), fdcal.load(folder / "take0.wav", **GIVEN)
    assert joined.names == tuple(f"mic{n:02d}" for n in range(COUNT)) and joined.take_count == 1
    same(joined, whole)


def test_files_of_several_channels_can_be_channels_of_one_take(folder, tmp_path):
    samples = soundfile.read(folder / "take0.wav")[0].T
    for name, rows in (("left", samples[:6]), ("right", samples[6:, :-20])):
        soundfile.write(tmp_path / f"{name}.wav", rows.T, FS, subtype="FLOAT")
    files = [tmp_path / "left.wav", tmp_path / "right.wav"]
    refuses(r"have 6 and 10 channels.*channels for one take", fdcal.load, files)
    joined = fdcal.load(files, files="channels", **GIVEN)
    assert joined.names[5:7] == ("left.5", "right.0") and joined.count == COUNT
    soundfile.write(tmp_path / "left.w64", samples[6:].T, FS, subtype="FLOAT")
    twins = fdcal.load([files[0], tmp_path / "left.w64"], files="channels", **GIVEN).names
    assert twins[5:7] == (f"{files[0]}.5", f"{tmp_path / 'left.w64'}.0"), "files of the same name"


def test_measurements_of_several_files_are_takes(folder, tmp_path):
    single = [fdcal.load(folder / f"take{s}.wav", max_rows=40, **GIVEN) for s in range(2)]
    for s, one in enumerate(single):
        save_measurement(one, tmp_path / f"{s}.npz")
    same(fdcal.load([tmp_path / "0.npz", tmp_path / "1.npz"]), fdcal.Measurement.from_takes(single))
    refuses("holds no recordings", fdcal.load, [tmp_path / "0.npz", folder / "take1.wav"])
    refuses("leave out sources", fdcal.load, tmp_path / "0.npz", sources=1)
    refuses("tiny is not a file of a take", lambda: fdcal.load(["tiny", str(tmp_path / "0.npz")]))


def test_takes_have_threads_of_their_own_so_that_no_solver_waits_for_them():
    names, seen = set(), []
    takes = [recording_of("file", "impulse", FS, noisy(responses(s), 50, seed=s)) for s in range(3)]
    read = lambda *part, one: names.add(threading.current_thread().name.partition("_")[0]) or one.block(*part)  # noqa: E731
    watched = [dataclasses.replace(one, block=partial(read, one=one)) for one in takes]
    measurement_of_takes(watched, ImportOptions(**GIVEN), lambda done, note: seen.append(done))
    assert names == {"fdcal-takes"} and seen == [0, 1 / 3, 2 / 3, 1]


def test_a_short_remainder_is_joined_and_a_pause_is_left_out(tmp_path):
    rng = np.random.default_rng(3)
    recording = recording_of("long.wav", None, FS, rng.standard_normal((2, 10 * FS)))
    lengths = [[part.samples / FS for part in split(recording, s, 2.0)] for s in (4.0, 3.0, 3.9)]
    assert lengths == [[4, 4, 2], [3, 3, 4], [3.9, 3.9, 2.2]] and len(split(recording, 5.94, 4.0)) == 2
    for text, *s in ("use 5.94 s or less", 7, 4), ("use 2.14 s or more", 2.13, 32 / 15), ("leave out split", 7, 4.9748):
        refuses(text, split, recording, *s)
    samples = np.hstack([playing(0, 8, 1), 1e-3 * rng.standard_normal((COUNT, 8 * FS)), playing(1, 8, 2)])
    path = write(tmp_path / "pause.wav", samples + 1e-3 * rng.standard_normal(samples.shape))
    measurement, report = import_recording(path, ImportOptions(**GIVEN, split=8.0))
    assert measurement.take_count == 2 and "8 to 16 s" in report.skipped[0]
    assert import_recording(path, ImportOptions(**GIVEN, split=2.0))[0].take_count == 8, "the least that is suggested"
    assert all(text in import_summary(measurement, report) for text in ("skipped", "16 to 24 s"))


@pytest.mark.parametrize(("options", "words"), [
    (["still.wav", "--split", "200ms"], "split = 0.2 s is too short"),
    (["still.wav", "--split", "20s"], "is too long for"), (["still.wav", "--split", "8"], "a time with its unit"),
    (["still.wav", "--split", "8s", "--kind", "impulse"], "leave out --split"),
    (["take0.wav", "take0.wav"], "given twice"),
    (["take0.wav", "single/mic00.wav", "--takes"], "give takes of one array, or --channels"),
    (["single/mic00.wav"], "give the files of all channels"), (["take0.wav", "slow.wav"], "convert one of them"),
    (["single/mic00.wav", "short.wav"], "give channels of one take"),
    (["still.wav", "--frequencies", "100.1:100.2"], "too short for 100.1 to 100.2 Hz; widen --frequencies"),
    (["left.wav", "right.wav"], "give --channels if several recorders recorded one take"),
])  # fmt: skip
def test_files_that_do_not_fit_are_refused_in_one_line(options, words, folder, tmp_path, refused):
    write(tmp_path / "slow.wav", noisy(responses(1), 50), FS // 2)
    write(tmp_path / "short.wav", noisy(responses(1), 50)[0, :1800])
    for name, row in (("left.wav", 0), ("right.wav", 2)):
        write(tmp_path / name, noisy(responses(1), 50)[row : row + 2])
    paths = [str(folder / one) if (folder / one).exists() else one for one in options]
    assert words in refused("import", *paths, "-o", "m.npz")


def test_a_calibration_takes_several_files(folder, tmp_path, monkeypatch, capsys, quick_import):
    monkeypatch.chdir(tmp_path)
    write_places(Path("places.csv"), places(COUNT))
    files = [folder / f"take{s}.wav" for s in range(3)]
    options = ["--positions", "places.csv", "--temperature", "30", "--solver", "joint", "--modes", "12", "-o", "r.json"]
    ended = exit_code("calibrate", *files, *options)
    printed = capsys.readouterr()
    assert ended in (0, 4), printed.err
    assert printed.out.startswith("take0 and 2 other files: 16 of 16 microphones")
    assert fdcal.Calibration.load("r.json").sound_speed == pytest.approx(349.0, abs=0.2)
    run("calibrate", "tiny", "--split", "5s", code=2)
    assert "tiny holds no recordings; leave out --split" in capsys.readouterr().err


def test_a_reference_serves_every_take(tmp_path):
    signal = np.random.default_rng(8).standard_normal(4 * FS)
    write(tmp_path / "played.wav", signal)
    for s in range(2):
        heard = np.array([fftconvolve(np.pad(signal, (0, FS)), h)[: 5 * FS] for h in responses(s)])
        write(tmp_path / f"{s}.wav", noisy(heard, 40, seed=s))
    files, reference = [tmp_path / "0.wav", tmp_path / "1.wav"], str(tmp_path / "played.wav")
    single = [fdcal.load(one, reference=reference, max_rows=60, **GIVEN) for one in files]
    same(fdcal.load(files, reference=reference, max_rows=120, **GIVEN), fdcal.Measurement.from_takes(single))


def test_a_channel_that_is_faulty_in_one_take_is_left_out_of_all(folder, tmp_path):
    samples = soundfile.read(folder / "take1.wav")[0].T
    samples[3] = 0
    soundfile.write(tmp_path / "faulty.wav", samples.T, FS, subtype="FLOAT")
    files = [folder / "take0.wav", tmp_path / "faulty.wav"]
    refuses("channel 3 is silent", lambda: import_recording(files, ImportOptions(**GIVEN)))
    measurement, report = import_recording(files, ImportOptions(leave_out="bad", **GIVEN))
    assert measurement.count == COUNT - 1 and "3" not in measurement.names and report.left_out == {"3": "silent"}


def test_a_copy_of_a_take_is_no_take(tmp_path):
    samples = noisy(playing(0, 12, 1), 40)
    one = write(tmp_path / "one.wav", samples)
    moved = write(tmp_path / "moved.wav", noisy(playing(1, 12, 1), 40))  # the same sound from another place
    for copied in (
        -0.3 * samples,
        samples[:, 3011:],
        resample_poly(resample_poly(samples, 147, 160, axis=1), 160, 147, axis=1),
    ):
        other = write(tmp_path / "copy.wav", copied)
        with pytest.raises(InputError, match=r"copy\.wav is a copy of .*one\.wav.*give each take once"):
            import_recording([one, moved, other], ImportOptions(files="takes", **GIVEN))
    assert import_recording([one, moved], ImportOptions(files="takes", max_rows=40, **GIVEN))[0].take_count == 2


@pytest.mark.parametrize("key", ["names", "sound_speed"])
def test_takes_of_other_microphones_or_of_other_options_are_refused(key):
    """Exchanged names would assign the pressures of one microphone to another."""
    one, other = (fdcal.Measurement.from_arrays([100, 150, 210], np.eye(3, 4) + a) for a in (1j, 2j))
    changed = {"names": other.names[::-1], "sound_speed": 350.0}[key]
    refuses(f"measurement 2 and the first one differ in {key}", fdcal.Measurement.from_takes,
            [one, dataclasses.replace(other, **{key: changed})])  # fmt: skip


def test_copies_of_measurements_are_no_takes(tmp_path):
    one = fdcal.load("tiny")
    copy = dataclasses.replace(one, pressures=one.pressures * np.exp(1j * np.arange(len(one.frequencies)))[:, None])
    refuses("takes 1 and 2 are copies", fdcal.Measurement.from_takes, [one, copy])
    again = dataclasses.replace(
        one, **{key: np.repeat(getattr(one, key), 2, axis=0) for key in ("frequencies", "pressures")},
        noise_power=None, wavenumbers=None, takes=np.tile([0, 1], len(one.frequencies)), spectrum=None,
    )  # fmt: skip
    save_measurement(again, tmp_path / "again.npz")
    refuses(r"again\.npz: takes 1 and 2 are copies", fdcal.load, tmp_path / "again.npz")


@pytest.mark.parametrize("silent", [False, True])
def test_a_take_whose_channels_are_rotated_is_named(tmp_path, silent):
    first, second = (noisy(playing(s, 12, s), 40, seed=s) for s in range(2))
    if silent:
        first[COUNT - 2 :], second[COUNT - 2 :] = 0, 0
    one, other = write(tmp_path / "one.wav", first), write(tmp_path / "other.wav", np.roll(second, 2, axis=0))
    with pytest.raises(
        InputError, match=r"other\.wav has the channels of .*one\.wav rotated by 2: its channel 2 is channel 0"
    ):
        import_recording([one, other], ImportOptions(files="takes", leave_out="bad", **GIVEN))


def test_a_circle_recorded_from_another_side_is_not_taken_for_rotated_channels():
    angle, rng, samples = 2 * np.pi * np.arange(8) / 8, np.random.default_rng(0), 4 * FS
    circle = 0.3 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    f = np.fft.rfftfreq(samples, 1 / FS)

    def take(side: int) -> np.ndarray:
        """A loud wave from one side, and reflections from all sides."""
        waves = [(2.0, (np.cos(angle[side]), np.sin(angle[side]), 0.0))]
        waves += [(0.5, u / np.linalg.norm(u)) for u in rng.standard_normal((30, 3))]
        heard = np.zeros((8, len(f)), complex)
        for loud, u in waves:
            source = rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f))
            heard += loud * source * np.exp(2j * np.pi * f * (circle @ u)[:, None] / SPEED)
        return np.fft.irfft(heard, samples)

    takes = [recording_of(f"take {side}", "stationary", FS, take(side)) for side in (0, 2)]
    channels.require_different_takes(takes, [channels.inspect_channels(one) for one in takes])


def test_every_source_of_a_folder_is_a_take(tmp_path):
    path = tmp_path / "mesh"
    path.mkdir()
    np.save(path / "pos_mic.npy", places(COUNT))
    np.save(path / "pos_src.npy", np.array(SOURCES[:2]))
    # The format has a fixed rate of 48 kHz.
    every = np.array([resample_poly(noisy(responses(s), 50, seed=s), 12, 1, axis=1) for s in range(2)])
    for n in range(COUNT):
        np.save(path / f"ir_{n}.npy", every[:, n])
    options = {"sound_speed": SPEED, "frequencies": "50:350"}
    single = [fdcal.load(path, sources=s, max_rows=30, **options) for s in range(2)]
    together = fdcal.load(path, sources="all", max_rows=60, **options)
    same(together, fdcal.Measurement.from_takes(single))
    assert np.allclose(together.positions, places(COUNT))


@pytest.mark.parametrize("sources", [1, 2])
def test_each_independent_source_gives_a_row(sources):
    samples = sum(level * playing(s, 30, 20 + s) for s, level in zip(range(sources), (1.0, 0.5), strict=False))
    taken = stationary_pressures(recording_of("room.wav", "stationary", FS, noisy(samples, 40)), (40.0, 380.0), SPEED)
    f, rows = np.unique(taken.frequencies, return_counts=True)
    assert rows.max() <= sources and np.mean(rows == sources) > 0.9
    h = np.exp(-2j * np.pi * f[:, None] * np.arange(2400) / FS)
    fields = np.stack([h @ responses(s).T for s in range(sources)], axis=1)  # (M, S, N)
    errors = []
    for frequency, p in zip(taken.frequencies, taken.pressures, strict=True):
        span = fields[np.searchsorted(f, frequency)].T
        errors.append(mismatch_db(p[None], (span @ np.linalg.lstsq(span, p, rcond=None)[0])[None])[0])
    assert np.median(errors) < -30, "every row is a field of the sources"


@pytest.mark.parametrize("seconds", [0.2, 0.5, 1.0])
def test_the_bandwidth_of_a_room_is_found_whatever_its_source_emits(seconds):
    """Powers of an even decay: noise of the right envelope in every channel, times a spectrum with narrow peaks."""
    rng, rate, step = np.random.default_rng(0), 6.9 / seconds, 0.3
    t = np.arange(0, 4 * seconds, 1e-3)
    h = rng.standard_normal((24, len(t))) * np.exp(-rate * t)
    f = np.arange(20, 480, step)
    powers = np.abs(h @ np.exp(-2j * np.pi * np.outer(t, f))) ** 2
    powers *= np.exp(3 * rng.standard_normal(len(f)))
    assert room_spacing(powers, 2 * step).decorrelation == pytest.approx(rate, rel=0.35)


def test_takes_share_the_computing_time():
    assert default_max_rows(32) == 400 and default_max_rows(32, 4) == 100
    assert default_max_rows(200) < default_max_rows(48) < default_max_rows(8)


def test_the_rumble_of_a_building_is_not_taken_for_a_response_that_wraps_round():
    samples = np.pad(responses(0), ((0, 0), (0, 2400)))
    level, band = np.abs(samples).max(), (20.0, 320.0)
    samples = samples + 1e-4 * level * np.random.default_rng(4).standard_normal(samples.shape)
    low, rises = butter(4, (20, 40), "bandpass", fs=FS, output="sos"), []
    for seed in range(6):
        rumble = sosfilt(low, np.random.default_rng(seed).standard_normal(3 * FS))[-samples.shape[1] :]
        heard = recording_of("a", "impulse", FS, samples + 5e-4 * level * rumble / np.std(rumble))
        power = segment_levels(heard, band)
        rises.append(power[-2:].mean() > 10 * power.min())
        require_quiet_end(heard, band)
        wrapped = heard.block(0, heard.samples, np.arange(COUNT)).copy()
        wrapped[:, -120:] += 0.1 * samples[:, :120]
        refuses("wraps round", require_quiet_end, recording_of("a", "impulse", FS, wrapped), band)
    assert any(rises), "the level of so few Hz varies by more than 10 dB"


def test_a_noise_floor_far_below_the_sound_may_rise():
    """A rise by 10 dB at -110 dB is accepted; the same rise 60 dB higher is a response that wraps round."""
    rng, t = np.random.default_rng(0), np.arange(2 * FS) / FS
    heard, noise = rng.standard_normal((2, 8, len(t)))
    heard *= np.exp(-t / 0.05)
    noise *= 10**-5.5 * np.where(t > 1.7, 10**0.5, 1.0)
    require_quiet_end(recording_of("a", "impulse", FS, heard + noise), (20.0, 320.0))
    with pytest.raises(InputError, match="wraps round"):
        require_quiet_end(recording_of("a", "impulse", FS, heard + 1000 * noise), (20.0, 320.0))
