"""Import recordings of a room: pressures are exact without noise, and the noise estimate is right."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import soundfile
from recorded import FS, SPEED, exact, mismatch_db, noisy, places, responses, stationary_source, write_places
from running import exit_code, refuses, run
from scipy.signal import chirp, fftconvolve

from fdcal.acoustics.dictionary import f_max
from fdcal.commands import report
from fdcal.commands.options import OPTIONS
from fdcal.model.measurement import load_measurement
from fdcal.model.validation import InputError
from fdcal.recordings import frequencies, impulse_response
from fdcal.recordings.channels import exclude_channels, known_microphones, select_subset
from fdcal.recordings.cross_spectra import DecimationSettings, decimate, stationary_pressures
from fdcal.recordings.importer import import_recording, import_summary
from fdcal.recordings.impulse_response import deconvolve, estimate_decay, impulse_response_pressures
from fdcal.recordings.recording import ImportOptions, Recording, read_samples, recording_of
from fdcal.session import doctor  # an import during a test would keep the replaced `solve`
from fdcal.session.calibration_run import solve
from fdcal.session.sources import compared_with_file, load_input

pytestmark = pytest.mark.usefixtures("remembered_runs")

BAND = 20.0, 400.0


def pressures_of(samples, **options):
    """The pressures of an impulse response in the usual band."""
    return impulse_response_pressures(recorded(samples), BAND, SPEED, **options)


def recorded(samples, kind="impulse", **others) -> Recording:
    return recording_of("file", kind, FS, samples, **others)


def test_a_response_gives_its_transform():
    taken = pressures_of(responses())
    assert np.all(mismatch_db(taken.pressures, exact(taken.frequencies, SPEED * -taken.wavenumbers[0].imag)) < -100)
    assert np.all(np.diff(taken.frequencies) > 0)


def test_a_recording_cut_while_the_room_rings_is_weighted_and_has_no_noise_estimate():
    taken = pressures_of(responses()[:, :400])
    s = SPEED * -taken.wavenumbers[0].imag
    assert s > 10
    assert np.all(mismatch_db(taken.pressures, exact(taken.frequencies, s)) < -60)
    assert taken.noise_power is None


def test_the_decay_is_estimated_in_noise():
    ringing = np.random.default_rng(0).standard_normal((8, FS)) * np.exp(-20 * np.arange(FS) / FS)
    clean = estimate_decay(recorded(ringing), BAND).rate
    noise = 0.01 * np.random.default_rng(1).standard_normal(ringing.shape)
    decay = estimate_decay(recorded(ringing + noise), BAND)
    assert clean == pytest.approx(20, rel=0.1) and decay.rate == pytest.approx(20, rel=0.15) and 0.2 < decay.tail < 0.5


def test_the_decay_is_estimated_after_the_end_of_a_sweep():
    t = np.arange(4 * FS) / FS
    played = np.where(t < 2, np.sin(2 * np.pi * 60 * 2 * (5 ** (t / 2) - 1) / np.log(5)), 0.0)  # 60 to 300 Hz in 2 s
    loud = np.exp(-0.5 * t)  # the room answers high frequencies less
    recorded_samples = np.array([fftconvolve(played * loud, h)[: len(t)] for h in responses(8)])
    taken = pressures_of(noisy(recorded_samples, 40))
    decay = estimate_decay(recorded(noisy(recorded_samples, 40)), BAND)
    assert decay.rate > 3 and 2 < decay.tail < 3.2, decay
    assert taken.how.startswith("no window") and taken.noise_power is not None
    assert np.median(mismatch_db(taken.pressures, exact(taken.frequencies, count=24)[:, :8])) < -20


def test_a_stationary_source_gives_the_pressures_of_its_impulse_responses():
    recorded_samples, _ = stationary_source(30, 60)
    taken = stationary_pressures(recorded(recorded_samples, "stationary"), BAND, SPEED)
    assert len(taken.frequencies) > 40
    assert np.median(mismatch_db(taken.pressures, exact(taken.frequencies))) < -58
    assert np.max(mismatch_db(taken.pressures, exact(taken.frequencies))) < -38, "dips of the level, too"


def test_the_noise_estimated_beside_a_stationary_source_is_right():
    recorded_samples, _ = stationary_source(30, 20)
    taken = stationary_pressures(recorded(recorded_samples, "stationary"), BAND, SPEED)
    truth = exact(taken.frequencies)
    factor = np.sum(truth.conj() * taken.pressures, axis=1) / np.sum(np.abs(truth) ** 2, axis=1)
    error = np.mean(np.abs(taken.pressures - factor[:, None] * truth) ** 2, axis=1)
    assert 0.45 < np.mean(error / taken.noise_power) < 2
    assert np.median(mismatch_db(taken.pressures, truth)) < -25, "averaging helps"


def test_a_lower_rate_changes_nothing_in_the_band():
    fs, t = 48_000, np.arange(48_000) / 48_000
    tones = np.array([np.cos(2 * np.pi * f * t + 0.3) for f in (25.0, 300.0, 499.0, 1700.0, 5000.0)])
    slow = decimate(recording_of("file", "stationary", fs, tones), 500.0)
    assert slow.sample_rate == 2000
    kept = read_samples(slow, 0, slow.samples)
    at = np.arange(slow.samples) / slow.sample_rate
    for row, f in zip(kept[:3], (25.0, 300.0, 499.0), strict=True):
        assert np.allclose(row[100:-100], np.cos(2 * np.pi * f * at + 0.3)[100:-100], atol=1e-5)
    assert np.abs(kept[3:, 100:-100]).max() < 1e-4, "1700 and 5000 Hz would fold to 300 and 1000 Hz"
    assert np.array_equal(read_samples(slow, 700, 900, [1]), kept[[1], 700:900])
    pieces = decimate(recording_of("file", "stationary", fs, tones), 500.0, DecimationSettings(block_samples=1000))
    chosen = (3, slow.samples - 5, np.array([1, 0]))
    assert np.array_equal(pieces.block(*chosen), slow.block(*chosen)), "whole or in pieces"


def test_a_narrow_resonance_keeps_its_own_frequency():
    t, f, rng = np.arange(30 * FS) / FS, 101.23, np.random.default_rng(0)
    ring = fftconvolve(rng.standard_normal(len(t)), np.exp((2j * np.pi * f - 0.5) * t[: 8 * FS]))[: len(t)].real
    recorded_samples = np.outer(rng.standard_normal(6), ring) + 0.01 * rng.standard_normal((6, len(t)))
    taken = stationary_pressures(recorded(recorded_samples, "stationary"), (80.0, 120.0), SPEED)
    assert np.min(np.abs(taken.frequencies - f)) < 0.05
    assert np.allclose(taken.wavenumbers, 2 * np.pi * taken.frequencies / SPEED)


def error_over_noise(taken) -> np.ndarray:
    """Error of every pressure over the estimated noise, mean of each third of the frequencies : (3,)."""
    truth = exact(taken.frequencies, SPEED * -taken.wavenumbers[0].imag)
    factor = np.sum(truth.conj() * taken.pressures, axis=1) / np.sum(np.abs(truth) ** 2, axis=1)
    error = np.mean(np.abs(taken.pressures - factor[:, None] * truth) ** 2, axis=1)
    return np.array([part.mean() for part in np.array_split(error / taken.noise_power, 3)])


@pytest.mark.parametrize("seconds", [5, 20])
def test_the_noise_estimated_in_a_sweep_is_right_with_its_reference_and_without(seconds):
    """The sweep is logarithmic, from 20 to 500 Hz, and a second of silence follows it."""
    t = np.arange(int(seconds * FS)) / FS
    sound = chirp(t, 20, seconds, 500, method="logarithmic") * np.minimum(1, 20 * np.minimum(t, seconds - t))
    played = np.concatenate([sound, np.zeros(FS)])
    recorded_samples = noisy(np.array([fftconvolve(played, h)[: len(played)] for h in responses()]), 30)
    plain = pressures_of(recorded_samples)
    made, noise = deconvolve(recorded(recorded_samples, None), recorded(played[None], None), BAND)
    known = impulse_response_pressures(made, BAND, SPEED, noise=noise)
    for taken in (plain, known):
        assert np.all(np.abs(np.log(error_over_noise(taken))) < np.log(1.6))
    assert len(plain.frequencies) > 57, "a long sweep ends only just before the recording does"
    assert plain.spacing.step > 0.5, "the spacing is that of the room, not of the sweep"
    assert len(known.frequencies) >= 38, "their distance is the width of a resonance"
    error = [np.median(mismatch_db(taken.pressures, exact(taken.frequencies))) for taken in (plain, known)]
    assert error[1] < error[0] - 6, "the reference compresses the sweep, and what follows is left out"


def test_what_follows_the_sound_is_left_out():
    quiet = noisy(np.pad(responses(), ((0, 0), (0, 3 * FS))), 20)
    taken = pressures_of(quiet)
    assert "the recording is cut off at" in taken.how
    assert np.all(np.abs(np.log(error_over_noise(taken))) < np.log(1.6))
    whole = np.exp(-2j * np.pi / FS * np.outer(taken.frequencies, np.arange(quiet.shape[1]))) @ quiet.T
    truth = exact(taken.frequencies)
    assert np.median(mismatch_db(taken.pressures, truth)) < np.median(mismatch_db(whole, truth)) - 4


def ringing(seconds: float, snr_db: float, slow: float = 5.0) -> tuple[np.ndarray, Callable]:
    """Sixty modes that decay at 20/s and one at 50 Hz that decays at `slow`, (24, T); their transform at (M,) Hz."""
    rng = np.random.default_rng(0)
    w = 2j * np.pi * np.concatenate([[50.0], rng.uniform(25, 390, 60)]) - np.concatenate([[slow], np.full(60, 20.0)])
    shapes = rng.standard_normal((24, 61)) * np.concatenate([[0.3], np.ones(60)])
    clean = (shapes @ np.exp(np.outer(w, np.arange(int(seconds * FS)) / FS))).imag
    level = np.sqrt(np.mean(clean[:, : FS // 10] ** 2)) * 10 ** (-snr_db / 20)

    def truth(frequencies: np.ndarray) -> np.ndarray:
        z = 2j * np.pi * frequencies[:, None]
        return (1 / (1 - np.exp((w - z) / FS)) - 1 / (1 - np.exp((w.conj() - z) / FS))) / 2j @ shapes.T

    return clean + level * rng.standard_normal(clean.shape), truth


@pytest.mark.parametrize(("seconds", "snr_db"), [(4, 20), (8, 45)])
def test_a_mode_that_rings_on_is_not_cut_off(seconds, snr_db):
    recorded_samples, truth = ringing(seconds, snr_db)
    taken = pressures_of(recorded_samples)
    assert taken.how.startswith("no window") and "cut off" in taken.how
    error = np.mean(np.abs(taken.pressures - truth(taken.frequencies)) ** 2, axis=1)
    assert 0.7 < np.mean(error / taken.noise_power) < 1.4
    assert np.all(error < 3 * taken.noise_power), "the same holds at the frequency of the mode"
    t = np.arange(recorded_samples.shape[1]) / FS
    whole = np.exp(-2j * np.pi * np.outer(taken.frequencies, t)) @ recorded_samples.T
    rest = np.mean(np.abs(whole - truth(taken.frequencies)) ** 2, axis=1)
    assert np.median(error / rest) < 0.7, "noise after the decay of most modes is still left out"


def test_frequencies_are_even_whatever_their_level():
    """At a peak the pressure gradient is small, so that a choice of peaks would make small arrays smaller."""
    f, flat = np.arange(20, 400, 0.25), np.full(1520, 1e-3)
    power = 1 + 50 * np.exp(-(((f - 100.3) / 0.6) ** 2)) + 50 * np.exp(-(((f - 103.1) / 0.6) ** 2))
    chosen = frequencies.choose_frequencies(f, power, flat, 2.5, 400)
    assert np.array_equal(chosen, frequencies.choose_frequencies(f, np.ones(len(f)), flat, 2.5, 400))
    assert np.all(np.diff(f[chosen]) >= 2.5) and len(chosen) > 0.8 * np.ptp(f) / 2.5
    few = f[frequencies.choose_frequencies(f, power, flat, 2.5, 12)]
    assert len(few) == 12
    assert np.ptp(few) > 300, "spread over the band"
    narrow = np.where(power > 10, power, 1e-6)  # two resonances are above the noise
    heard = f[frequencies.choose_frequencies(f, narrow, np.full(len(f), 1e-1), 2.5, 400)]
    assert np.all(np.abs(heard - 101.7) < 2.5) and len(heard) == 2
    refuses("10 dB above the noise", frequencies.choose_frequencies, f, power, 100 * power, 2.5)


MESH = np.stack([a.ravel() for a in np.meshgrid([0.0, 1, 2], [0.0, 1], [-1.0, 0, 1], indexing="ij")], axis=1)


def mesh_recording() -> Recording:
    return recorded(np.random.default_rng(0).standard_normal((18, 100)), positions=MESH)


def test_subsets_are_taken_also_one_in_a_plane(tmp_path):
    np.savez(tmp_path / "a.npz", recordings=responses()[:18], sample_rate=FS, kind="impulse", positions=MESH)
    measurement, _ = import_recording(tmp_path / "a.npz", ImportOptions(subset="1,4,7,10,13,16", known="1,4,13,16"))
    assert (measurement.dimension, measurement.array_dimension, measurement.count) == (3, 2, 6)
    assert len(measurement.known) == 4
    plate = ImportOptions(subset="1,4,7,10,13,16", dimension=2)
    assert import_recording(tmp_path / "a.npz", plate)[0].positions.shape == (6, 2), "a plate has no heights"
    refuses("^dimension = 2 needs microphones", import_recording, tmp_path / "a.npz", replace(plate, subset=None))
    plane = select_subset(mesh_recording(), "1,4,7,10,13,16")
    numbers, places = known_microphones(plane, f"{plane.names[3]}, {plane.names[0]}")
    assert numbers.tolist() == [3, 0] and np.array_equal(plane.positions[numbers], places)
    assert select_subset(mesh_recording(), "::6").names == ("0", "6", "12")
    listed = select_subset(mesh_recording(), "5,0:3")
    assert listed.names == ("5", "0", "1", "2")
    assert np.array_equal(read_samples(listed, 3, 9), read_samples(mesh_recording(), 3, 9)[[5, 0, 1, 2]])
    assert exclude_channels(listed, ["1"], [0]).names == ("0", "2")


@pytest.mark.parametrize(("call", "words"), [
    (lambda r: select_subset(r, "1,18"), "0 to 17"), (lambda r: select_subset(r, "a"), "for example, subset 0,3,8:12"),
    (lambda r: exclude_channels(r, ["18"]), 'no channel "18"'),
    (lambda r: known_microphones(r, "0,x"), 'no channel "x"'),
    (lambda r: known_microphones(recorded(np.ones((3, 50))), "0,1"), "contains no positions"),
])  # fmt: skip
def test_an_impossible_choice_is_refused(call, words):
    refuses(words, lambda: call(mesh_recording()))


# The command line imports and calibrates recordings.


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A WAV of responses, and a table of five known microphones."""
    path, quiet = tmp_path_factory.mktemp("mine"), noisy(responses(), 40)
    soundfile.write(path / "responses.wav", quiet.T / np.abs(quiet).max() * 0.9, FS, subtype="PCM_24")
    write_places(path / "known.csv", places()[:5])
    return path


def test_from_a_recording_to_a_table_of_positions(folder, tmp_path, monkeypatch, capsys, quick_import):
    monkeypatch.chdir(tmp_path)
    name = "responses.wav"
    before = (folder / name).read_bytes()
    run("import", folder / name, "-o", "m.npz", "--known", folder / "known.csv", "--sound-speed", SPEED)
    printed = capsys.readouterr().out
    assert all(text in printed for text in ("impulse response", "channels     24", "known        5 of 24"))
    run("import", folder / name, "-o", "m.npz", code=2)
    assert "--force" in capsys.readouterr().err
    measurement = load_measurement("m.npz")
    snr = np.mean(np.abs(measurement.pressures) ** 2, axis=1) / measurement.noise_power - 1
    assert re.search(rf"^SNR .*at {measurement.frequencies[np.argmin(snr)]:.1f} Hz", printed, re.MULTILINE)
    assert exit_code("calibrate", "m.npz", "--solver", "joint", "--modes", 60, "-o", "r.json") in (0, 4)
    run("export", "r.json", "-o", "positions.csv")
    rows = np.genfromtxt("positions.csv", delimiter=",", names=True)
    found = np.stack([rows["x"], rows["y"], rows["z"]], axis=1)
    assert np.sqrt(np.mean(np.sum((found - places()) ** 2, axis=1))) < 0.03
    assert np.allclose(found[:5], places()[:5]) and (folder / name).read_bytes() == before


def test_frequencies_of_a_wide_array_of_few_microphones_end_where_it_can_resolve_them(folder, tmp_path):
    np.savez(tmp_path / "bare.npz", recordings=responses(), sample_rate=FS, kind="impulse")
    np.savez(tmp_path / "placed.npz", recordings=responses(), sample_rate=FS, kind="impulse", positions=places())
    radius = np.linalg.norm(places() - places().mean(axis=0), axis=1).max()
    limit = f_max(24, radius, SPEED, 3)
    for name, options, words in (
        ("placed.npz", {}, "positions in the file"),
        ("bare.npz", {"array_radius": radius}, "0.51 m, as given"),
        ("bare.npz", {"known": str(folder / "known.csv")}, "known microphones"),
    ):
        measurement, report = import_recording(tmp_path / name, ImportOptions(sound_speed=SPEED, **options))
        assert words in import_summary(measurement, report)
        assert measurement.frequencies[-1] <= report.highest_frequency < 500
        assert report.highest_frequency == pytest.approx(limit) or name == "bare.npz"
    # The closest pair says nothing about the other distances.
    close = np.argsort(np.linalg.norm(places() - places()[0], axis=1))[:2]
    known = write_places(tmp_path / "known.csv", places()[close], close)
    _, report = import_recording(tmp_path / "bare.npz", ImportOptions(sound_speed=SPEED, known=str(known)))
    assert limit / 2 < report.highest_frequency < 2 * limit
    measurement, report = import_recording(tmp_path / "bare.npz", ImportOptions(sound_speed=SPEED))
    assert limit / 2 < report.highest_frequency < 1.5 * limit, "the coherence shows the radius roughly"
    assert measurement.frequencies[-1] <= report.highest_frequency
    assert "the band; --array-radius R sets it" in import_summary(measurement, report, OPTIONS)


def test_the_band_of_a_recording_that_shows_no_radius_ends_at_500_hz(tmp_path):
    independent = np.random.default_rng(0).normal(size=(8, FS)) * np.exp(-12 * np.arange(FS) / FS)
    np.savez(tmp_path / "noise.npz", recordings=independent, sample_rate=FS, kind="impulse")
    measurement, report = import_recording(tmp_path / "noise.npz", ImportOptions(sound_speed=SPEED))
    assert report.highest_frequency is None and 400 < measurement.frequencies[-1] <= 500
    assert "unknown; radius of the array: unknown; array_radius sets it" in import_summary(measurement, report)


def test_bad_channels_are_left_out_when_asked(tmp_path, monkeypatch):
    samples = noisy(responses(), 40)
    samples[3] = 0
    samples[8] = samples[2]
    np.savez(tmp_path / "a.npz", recordings=samples, sample_rate=FS, kind="impulse")
    refuses(r"channel 3 is silent, channel 8 is a copy of 2; .*leave_out bad", import_recording, tmp_path / "a.npz")
    measurement, report = import_recording(tmp_path / "a.npz", ImportOptions(leave_out="bad"))
    assert report.left_out == {"3": "silent", "8": "a copy of 2"}
    assert measurement.names == tuple(str(n) for n in range(24) if n not in (3, 8))
    assert "left out     3 (silent), 8 (a copy of 2); none of the others" in import_summary(measurement, report)
    # A list of all channels, with names of its own, belongs to the channels that are left.
    path, table = str(tmp_path / "a.npz"), write_places(tmp_path / "list.csv", places(), [f"M{n}" for n in range(24)])
    seen = [compared_with_file(load_input(path, options=ImportOptions(leave_out="bad")), str(table))]
    monkeypatch.setattr(doctor, "_of_field", lambda inputs, *_: seen.append(inputs) or ())
    assert [one.question for one in doctor.examine(path, str(table))] == ["samples", "synchronous", "wrapped"]
    assert all(np.array_equal(one.measurement.positions, np.delete(places(), (3, 8), axis=0)) for one in seen)
    np.savez(tmp_path / "all.npz", recordings=0 * samples, sample_rate=FS, kind="impulse")
    refuses(r"channel 5 is silent, and 18 more; record again$", import_recording, tmp_path / "all.npz")


def test_channels_of_different_recordings_are_named_as_such_and_no_band_is_blamed(tmp_path):
    # A common signal with independent noise in each channel has the coherence of a very large array.
    rng = np.random.default_rng(5)
    own, common = rng.standard_normal((8, 10 * FS)), rng.standard_normal(10 * FS)
    np.savez(tmp_path / "a.npz", recordings=own + 0.4 * common, sample_rate=FS, kind="stationary")
    assert refuses("coherent up to", lambda: import_recording(tmp_path / "a.npz", ImportOptions())).key == "frequencies"


@pytest.mark.parametrize(("options", "words", "code"), [
    (["--frequencies", "low"], "write auto or LO:HI", 2), (["--temperature", "300"], "degrees Celsius", 2),
    (["--temperature", "20", "--sound-speed", "343"], "are both given", 2), (["--max-rows", "0"], "1 to 2000", 2),
    (["--subset", "1"], "two microphones", 2), (["--array-radius", "-1"], "above zero", 2),
    (["--reference", "nothing.wav"], "No such file", 3), (["--known", "0,1"], "contains no positions", 2),
    (["--source", "1"], "one source only", 2), (["--leave-out", ",".join(map(str, range(24)))], "name fewer", 2),
    (["--reference", "s.wav", "--kind", "stationary"], "leave out --reference or --kind", 2),
    (["--array-radius", "50"], "give --array-radius", 2), (["--array-radius", "1e-5"], "or give --frequencies", 2),
])  # fmt: skip
def test_an_option_out_of_range_is_refused(options, words, code, folder, refused):
    assert words in refused("import", folder / "responses.wav", "-o", "m.npz", *options, code=code)


def test_positions_in_degrees_are_refused(tmp_path):
    angles = np.degrees(np.arctan2(places(), np.roll(places(), 1, axis=1)))
    np.savez(tmp_path / "a.npz", recordings=responses(), sample_rate=FS, kind="impulse", positions=angles)
    with pytest.raises(InputError, match=r"the band begins at 20 Hz; give positions in metres, not in centimetres"):
        import_recording(tmp_path / "a.npz")


def test_a_reference_of_another_rate_is_refused(folder, tmp_path):
    soundfile.write(tmp_path / "sweep.wav", np.random.default_rng(0).uniform(-1, 1, 8000), 8000)
    with pytest.raises(InputError, match=r"8000 Hz and .*4000 Hz; convert"):
        import_recording(folder / "responses.wav", ImportOptions(reference=str(tmp_path / "sweep.wav")))
    with pytest.raises(InputError, match="24 channels; give a reference signal of one"):
        import_recording(folder / "responses.wav", ImportOptions(reference=str(folder / "responses.wav")))


@pytest.mark.parametrize(("count", "warned"), [(3, True), (5, False)])
def test_too_few_microphones_are_reported_at_the_import(tmp_path, count, warned):
    np.savez(tmp_path / "few.npz", recordings=noisy(responses(), 40)[:count], sample_rate=FS, kind="impulse")
    measurement, report = import_recording(tmp_path / "few.npz", ImportOptions(sound_speed=SPEED, array_radius=0.5))
    last = import_summary(measurement, report).splitlines()[-1]
    assert last.startswith(f"warning: {count} microphones are too few") == warned
    if warned:
        refuses(f"{count} microphones are too few|too few", lambda: solve(load_input(str(tmp_path / "few.npz"))))


@pytest.fixture
def channels(tmp_path):
    """A folder with a file for each of twelve channels, and a table of four of them with heights that agree."""
    folder, samples = tmp_path / "hall", noisy(responses(12), 60.0)
    folder.mkdir()
    for n, row in enumerate(samples, 1):
        soundfile.write(folder / f"²{n}.wav", row / np.abs(samples).max(), FS, subtype="FLOAT")  # "²" is no number
    (folder / "notes.txt").write_text("on a table")
    known = np.column_stack([places(12)[:4, :2], np.full(4, 1.2)])
    return folder, str(write_places(tmp_path / "known.csv", known, [f"²{n}" for n in range(1, 5)]))


def test_a_folder_of_files_of_one_channel_is_one_take_in_natural_order(channels):
    folder, known = channels
    measurement, report = import_recording(folder, ImportOptions(known=known))
    assert measurement.names == tuple(f"²{n}" for n in range(1, 13)) and measurement.take_count == 1
    assert measurement.array_dimension == 3, "the heights of the others are not known"
    assert "in space; if all microphones stand at z = 1.2 m" in import_summary(measurement, report)
    measurement, report = import_recording(folder, ImportOptions(known=known, array_dimension=2))
    assert measurement.array_dimension == 2 and measurement.known_positions.shape == (4, 2)
    assert "in the plane z = 1.2 m, like all given positions" in import_summary(measurement, report)
    blind = import_recording(folder, ImportOptions(known="none", array_dimension=2))[0]
    assert blind.array_dimension == 2 and not len(blind.known)
    Path(known).write_text(Path(known).read_text().rstrip()[:-3] + "1.3")
    with pytest.raises(InputError, match=r"array_dimension = 2 needs microphones of one height.*differ by 0\.1 m"):
        import_recording(folder, ImportOptions(known=known, array_dimension=2))


def test_exchanged_channels_give_exit_code_5_whatever_the_verdict(monkeypatch):
    class Compared:
        agrees = fits = False

    monkeypatch.setattr("fdcal.session.calibration_run.solve", lambda *_: SimpleNamespace(verdict="not_converged"))
    monkeypatch.setattr(report, "comparison", lambda *_: Compared)
    for name in ("summary", "comparison_text"):
        monkeypatch.setattr(report, name, lambda *_: None)
    assert exit_code("calibrate", "tiny", "--check") == 5
    Compared.agrees = True
    assert exit_code("calibrate", "tiny", "--check") == 4


# Deconvolution estimates the noise of a response; a response that wraps round is recognised.


RATE, SWEPT, COUNT = 1000, (30.0, 300.0), 24  # Hz, Hz, channels


@pytest.mark.parametrize(("recorded_s", "played_s", "response_s"), [(6, 5.5, 2.25), (8, 3, 4.5)])
def test_the_noise_is_that_in_the_response_whatever_the_lengths(recorded_s, played_s, response_s, monkeypatch):
    """White noise of known power added to the recording of a sweep, of a flat spectrum S in the band."""
    monkeypatch.setattr(impulse_response, "DECONVOLUTION", replace(impulse_response.DECONVOLUTION, length=response_s))
    rng, t = np.random.default_rng(0), np.arange(int(played_s * RATE)) / RATE
    played, power = chirp(t, 15, played_s, 450), 0.3
    room = rng.standard_normal((COUNT, 100)) * np.exp(-np.arange(100) / 10)
    clean = np.array([np.pad(fftconvolve(played, h), (0, recorded_s * RATE))[: recorded_s * RATE] for h in room])
    noise = np.sqrt(power) * rng.standard_normal(clean.shape)

    def deconvolved(samples):
        one, sweep = recording_of("recording", None, RATE, samples), recording_of("sweep", None, RATE, played[None])
        made, density = deconvolve(one, sweep, SWEPT)
        return read_samples(made, 0, made.samples), density

    (with_noise, density), (without, _) = deconvolved(clean + noise), deconvolved(clean)
    assert with_noise.shape == (COUNT, response_s * RATE)
    spectrum = np.abs(np.fft.rfft(with_noise - without)) ** 2 / with_noise.shape[1]
    f = np.fft.rfftfreq(with_noise.shape[1], 1 / RATE)
    inside = (f > 40) & (f < 280)
    assert np.mean(density(f[inside])) == pytest.approx(np.mean(spectrum[:, inside]), rel=0.07)
    f = np.linspace(40, 280, 1000)
    S = np.exp(-2j * np.pi * np.outer(f, t)) @ played
    assert np.mean(density(f) * np.abs(S) ** 2) == pytest.approx(power, rel=0.1)


def test_a_recording_hardly_longer_than_the_response_does_not_show_the_noise():
    rng = np.random.default_rng(0)
    samples, played = rng.standard_normal((3, int(2.8 * RATE))), rng.standard_normal((1, RATE))
    made, density = deconvolve(recording_of("a", None, RATE, samples), recording_of("b", None, RATE, played), SWEPT)
    assert density is None and made.count == 3


@pytest.fixture
def taken(tmp_path):
    """Function that imports samples (N, T) as impulse responses."""

    def take(samples: np.ndarray, kind: str = "impulse"):
        np.savez(tmp_path / "room.npz", recordings=samples, sample_rate=FS, kind=kind, sound_speed=343.0)
        return import_recording(tmp_path / "room.npz", ImportOptions(array_radius=0.5))

    return take


def test_a_response_that_begins_at_its_end_and_an_echo_of_the_sweep_before_the_end_are_refused(taken):
    samples = np.pad(responses(8), ((0, 0), (0, 2400)))
    for seconds in (0.02, 0.05):
        refuses(r"wraps round.*numpy\.roll", taken, noisy(np.roll(samples, -int(seconds * FS), axis=1), 60.0))
    samples[:, -200:] += 0.05 * samples[:, :200]
    refuses(r"rises again by \d+ dB", lambda: taken(noisy(samples, 60.0)))


def test_a_response_in_noise_or_one_that_begins_late_is_accepted(taken):
    for snr_db in (10.0, 30.0, 60.0, 90.0):
        for silence in ((0, 0), (0, 1000), (0, 4000), (800, 1600)):
            samples = noisy(np.pad(responses(8), ((0, 0), silence)), snr_db)
            impulse_response.require_quiet_end(recording_of("room", "impulse", FS, samples), (20.0, 400.0))
    assert taken(samples)[0].count == 8
