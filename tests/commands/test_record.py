"""`fdcal record`: takes replayed from files, the faults named during a take, and the result of all takes."""

import builtins
import json
import signal

import numpy as np
import pytest
import soundfile
from recorded import FS, places, stationary_source, write_places
from running import exit_code

from fdcal.commands.options import progress_bar
from fdcal.recordings import take

COUNT, OTHER_SIDE = 14, (0.6, 0.5, 1.9)
INVERTED, SWAPPED = 12, (3, 9)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder with two takes of 20 s, a copy of one with faulty channels, and a list of the positions."""
    path = tmp_path_factory.mktemp("takes")
    places_of_source = (2, {}), (3, {"source": OTHER_SIDE})
    one, two = (stationary_source(20.0, 30.0, COUNT, seed=seed, **place)[0] for seed, place in places_of_source)
    one, two = (0.1 * sound / np.std(sound) for sound in (one, two))
    faulty = one.copy()
    faulty[INVERTED] *= -1
    faulty[list(SWAPPED)] = one[list(SWAPPED[::-1])]
    for name, sound in (("one", one), ("two", two), ("faulty", faulty)):
        soundfile.write(path / f"{name}.wav", sound.T, FS, subtype="PCM_24")
    (path / "list.json").touch()
    write_places(path / "list.csv", places(COUNT))
    return path


def test_inverted_and_swapped_channels_are_named_after_a_take_of_20_s(folder, capsys, quick_import):
    arguments = ["record", "-o", folder / "f1.wav", "--replay", folder / "faulty.wav", "--seconds", 20]
    assert exit_code(*arguments, "--positions", folder / "list.csv") == 5
    lines = capsys.readouterr().out.splitlines()
    (faults,) = (one for one in lines if one.startswith("faults "))
    assert f"microphone {INVERTED}: inverted; channels {SWAPPED[0]} and {SWAPPED[1]} are swapped" in faults
    assert "next    correct the channels, and record this take again" in lines


def test_the_report_after_each_take_uses_all_takes_so_far(folder, capsys, quick_import):
    (folder / ".fdcal-0.wav").write_bytes(b"RIFF")  # a program that was killed leaves such a file
    arguments = ["record", "-o", folder / "t1.wav", "--result", folder / "r.json", "--positions", folder / "list.csv"]
    code = exit_code(*arguments, "--replay", folder / "one.wav", "--replay", folder / "two.wav", "--seconds", 10)
    out = capsys.readouterr().out
    assert (folder / "t2.wav").exists() and code in (0, 4)
    assert f"mv {folder / '.fdcal-0.wav'} NAME.wav keeps it" in out
    found = json.loads((folder / "r.json").read_text())
    assert len(found["positions"]) == COUNT and found["verdict"] in out
    assert 1e3 * found["mean_error_m"] < 20 and f"mean {1e3 * found['mean_error_m']:.3g} mm" in out
    sigmas = [float(line.rpartition("one sigma ")[2].split()[0]) for line in out.splitlines() if "result " in line]
    assert len(sigmas) == 2 and sigmas[1] < sigmas[0]
    expected = [line for line in out.splitlines() if line.startswith("next ")]
    sigma = 1e3 * np.sqrt(np.mean(np.square(found["uncertainty_m"])))  # the result is that of two takes
    assert "other side" in expected[0] and f"about {sigma * np.sqrt(2 / 3):.2g} mm" in expected[1]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_take_keeps_it_and_says_so(folder, tmp_path, monkeypatch, capsys, number):
    blocks, replayed = iter(range(1000)), take.replayed

    def pressed(_):
        if next(blocks) in (30, 31):  # an impatient user interrupts twice
            signal.raise_signal(number)

    before = signal.getsignal(number)
    monkeypatch.setattr(take, "replayed", lambda path, channels: replayed(path, channels, pressed))
    assert exit_code("record", "-o", tmp_path / "take1.wav", "--replay", folder / "one.wav") == 130
    assert soundfile.info(tmp_path / "take1.wav").duration == pytest.approx(3.1)
    assert "3.1 s at 4000 Hz" in (said := capsys.readouterr().out) and "stopped early, and kept" in said
    assert signal.getsignal(number) is before


def test_a_signal_that_is_ignored_does_not_end_a_take(folder, tmp_path, monkeypatch):
    replayed, before = take.replayed, signal.signal(signal.SIGHUP, signal.SIG_IGN)  # nohup starts a program like this
    monkeypatch.setattr(take, "replayed", lambda *given: replayed(*given, lambda _: signal.raise_signal(signal.SIGHUP)))
    try:
        exit_code("record", "-o", tmp_path / "take1.wav", "--replay", folder / "one.wav", "--seconds", 1)
    finally:
        signal.signal(signal.SIGHUP, before)
    assert soundfile.info(tmp_path / "take1.wav").duration == 1


def test_silent_clipped_and_duplicated_channels_are_named_while_the_take_lasts(folder, tmp_path, capsys):
    sound = soundfile.read(folder / "one.wav", frames=3 * FS)[0][:, :6]
    sound[:, 1], sound[:, 4] = 0.0, sound[:, 2]
    sound[2 * FS :, 3] = np.clip(sound[2 * FS :, 3], -0.08, 0.08)
    sound[: 2 * FS, 3] *= 0.1
    soundfile.write(tmp_path / "bad.wav", sound, FS, subtype="PCM_24")
    assert exit_code("record", "-o", tmp_path / "take1.wav", "--replay", tmp_path / "bad.wav") == 4
    lines = capsys.readouterr().out.splitlines()
    early, late = ("1 is silent", "4 is a copy of 2"), ("3 is clipped",)
    named = [f"after {at} s: channel {fault}" for at, faults in ((1.0, early), (2.1, late)) for fault in faults]
    assert lines[:3] == named
    assert "channel 1: silent; channel 3: clipped; channel 4: a copy of 2" in lines[3]
    assert lines[4].startswith("result  none: ") and "3 microphones" in lines[4]


def test_between_takes_the_user_chooses_another_one_or_the_same_again(folder, tmp_path, monkeypatch, capsys):
    answers, asked, replayed = iter(["r", "nonsense", "", "q"]), [], take.replayed(folder / "one.wav", 4)
    monkeypatch.setattr(take, "sound_card", lambda *_: replayed)
    monkeypatch.setattr(builtins, "input", lambda question: asked.append(question) or next(answers))
    assert exit_code("record", "-o", tmp_path / "take1.wav", "--seconds", 2) == 4
    assert sorted(path.name for path in tmp_path.iterdir()) == ["take1.wav", "take2.wav"]
    heads = [line.split()[1] for line in capsys.readouterr().out.splitlines() if line.startswith("take ")]
    assert heads == ["1", "1", "2"] and len(asked) == 4
    assert "take2.wav" in asked[0] and "take1.wav again" in asked[0]


def test_no_take_is_lost_or_overwritten_where_the_next_name_is_taken(folder, tmp_path):
    for name in ("take2.wav", "take3.w64"):
        (tmp_path / name).write_text("mine")
    replayed = ["--replay", folder / "one.wav", "--seconds", 1, "--channels", 4]
    for options in ([], ["--force"]):
        assert exit_code("record", "-o", tmp_path / "take1.wav", *replayed, *replayed[:2], *options) == 4
    assert {path.name for path in tmp_path.iterdir()} == {"take3.w64", *(f"take{n}.wav" for n in (1, 2, 4, 5))}
    assert (tmp_path / "take2.wav").read_text() == (tmp_path / "take3.w64").read_text() == "mine"


def test_a_bar_shows_on_a_terminal_how_much_is_recorded(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    exit_code("record", "-o", tmp_path / "a.wav", "--replay", folder / "one.wav", "--seconds", 1, "--channels", 3)
    assert "recording 100 % |" in capsys.readouterr().err
    with progress_bar("working") as progress:
        progress(0.25)
        progress(0.5)
    assert capsys.readouterr().err.rpartition("working")[2].startswith("  50 % |")
    monkeypatch.setenv("TERM", "dumb")
    exit_code("record", "-o", tmp_path / "b.wav", "--replay", folder / "one.wav", "--seconds", 1, "--channels", 3)
    assert "\r" not in capsys.readouterr().err, "a line cannot be replaced"


@pytest.mark.parametrize(("options", "words"), [
    (["--replay", "one.wav", "--device", "2"], "leave out --device"),
    (["--replay", "nowhere.wav"], "cannot read nowhere.wav"),
    (["--replay", "one.wav", "--channels", "99"], "give fewer --channels"),
    (["--replay", "one.wav", "--positions", "nowhere.csv"], "nowhere.csv"),
    (["--replay", "one.wav", "--known", "nowhere.csv"], "nowhere.csv"),
    (["--replay", "one.wav", "--known", "0,1,2"], "give a file .cfg, .csv"),
    (["--replay", "one.wav", "--replay", "one.wav", "nowhere.wav"], "cannot read nowhere.wav"),
    (["--replay", "one.wav", "--seconds", "nan"], "seconds = nan must be a number"),
    (["--replay", "one.wav", "--result", "list.json"], "--result list.json exists"),
])  # fmt: skip
def test_what_cannot_be_recorded_is_one_line_and_no_file(folder, monkeypatch, capsys, options, words):
    monkeypatch.chdir(folder)
    assert exit_code("record", "-o", "no.wav", *options) in (2, 3)
    out, error = capsys.readouterr()
    assert out == "" and error.count("\n") == 1 and words in error and not (folder / "no.wav").exists()
