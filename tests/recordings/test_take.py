"""Takes from a simulated sound card and from replayed files: the content of the file, also if a take ends early."""

import sys
import types

import numpy as np
import pytest
import soundfile
from running import refuses

from fdcal.model import libraries
from fdcal.model.validation import InputError
from fdcal.recordings import take

RATE = 2000  # Hz


class Card(types.ModuleType):
    """A double of the library sounddevice with one sound card, which delivers `sound` (N, T) and then stops."""

    class PortAudioError(Exception):
        pass

    def __init__(self, sound, overflow_at=()):
        super().__init__("sounddevice")
        self.sound, self.overflow_at, self.opened = np.asarray(2.0**31 * sound, np.int32), overflow_at, 0
        self.connected = self.seen = True

    def _terminate(self):
        self.seen = None

    def _initialize(self):
        assert self.seen is None, "PortAudio looks for cards again only after it was terminated"
        self.seen = self.connected

    def query_devices(self, device, kind):
        if device == "nowhere" or not self.seen:
            raise ValueError(f"No input device matching {device!r}")
        return {"name": "simulated", "max_input_channels": len(self.sound), "default_samplerate": float(RATE)}

    def check_input_settings(self, **settings):
        if settings["samplerate"] > 192_000:
            raise self.PortAudioError("Invalid sample rate")

    def InputStream(self, *, channels, samplerate, blocksize, callback, dtype, **_):
        assert dtype == "int32"
        return Stream(self, channels, blocksize, callback)


class Stream:
    def __init__(self, card, channels, size, callback):
        self.card, self.channels, self.size, self.callback = card, channels, size, callback

    def __enter__(self):
        self.card.opened += 1
        for number, start in enumerate(range(0, self.card.sound.shape[1], self.size)):
            samples = self.card.sound[: self.channels, start : start + self.size].T
            status = types.SimpleNamespace(input_overflow=number in self.card.overflow_at)
            self.callback(samples, len(samples), None, status)

    def __exit__(self, *_):
        self.card.opened -= 1


@pytest.fixture
def card(monkeypatch):
    """Function that connects a sound card."""

    def connect(sound, **others):
        module = Card(sound, **others)
        monkeypatch.setitem(sys.modules, "sounddevice", module)
        monkeypatch.setattr(take, "PATIENCE", 0.01)
        return module

    return connect


def noise(channels=4, seconds=2.0, seed=0):
    return 0.1 * np.random.default_rng(seed).standard_normal((channels, round(seconds * RATE)))


def test_a_take_holds_what_the_card_delivered_to_24_bits_and_closes_the_card(card, tmp_path):
    sound = noise()
    module = card(sound, overflow_at=(3, 7))
    done = take.record_take(take.sound_card(3), tmp_path / "take.wav", 1.55)
    written, rate = soundfile.read(tmp_path / "take.wav")
    assert (rate, done.seconds, done.gaps, done.stopped, module.opened) == (RATE, 1.55, 2, False, 0)
    np.testing.assert_allclose(written.T, sound[:3, : round(1.55 * RATE)], atol=2**-23)
    assert soundfile.info(tmp_path / "take.wav").subtype == "PCM_24"
    assert "lost 2 times" in done.text and "none of them is silent" in done.text


def test_a_take_that_is_stopped_or_whose_card_fails_keeps_what_was_recorded(card, tmp_path):
    card(noise(seconds=1.0))
    stopped = take.record_take(take.sound_card(), tmp_path / "a.wav", 30, lambda seconds, _: seconds < 0.65)
    failed = take.record_take(take.sound_card(), tmp_path / "b.wav", 30)
    assert stopped.stopped and not stopped.fault and "stopped early, and kept" in stopped.text
    assert not failed.stopped and "has stopped delivering sound" in failed.text
    assert soundfile.info(tmp_path / "a.wav").frames == 0.7 * RATE
    assert soundfile.info(tmp_path / "b.wav").frames == RATE
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.wav", "b.wav"]


def test_a_card_that_is_connected_later_is_found(card):
    module = card(noise())
    module.connected = False
    refuses("no sound card with inputs can record this", take.sound_card)
    module.connected = True
    assert take.sound_card().name == "simulated"


def test_nothing_is_written_where_nothing_was_recorded(card, tmp_path):
    card(np.zeros((2, 0)))
    with pytest.raises(InputError, match=r"nothing was recorded: the sound card .* has stopped delivering sound"):
        take.record_take(take.sound_card(), tmp_path / "take.wav", 30)
    assert not list(tmp_path.iterdir())


def test_a_take_keeps_an_existing_file_and_what_a_wav_file_cannot_hold_is_refused_first(card, tmp_path):
    card(noise())
    (tmp_path / "take.wav").write_text("mine")
    refuses("exists", lambda: take.record_take(take.sound_card(), tmp_path / "take.wav", 1))
    assert (tmp_path / "take.wav").read_text() == "mine"
    refuses(r"write long.w64", lambda: take.record_take(take.sound_card(), tmp_path / "long.wav", 200_000))


@pytest.mark.parametrize(("arguments", "problem"), [
    ({"channels": 9}, "has 4 inputs, not 9; give fewer channels"),
    ({"device": "nowhere"}, 'no sound card "nowhere" can record this'),
    ({"rate": 1e6}, "can record this .Invalid sample rate.*give another rate"),
])  # fmt: skip
def test_what_a_card_cannot_do_is_one_line(card, arguments, problem):
    card(noise())
    refuses(problem, take.sound_card, **arguments)


def test_a_missing_library_and_a_missing_portaudio_say_how_to_go_on(monkeypatch):
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    with pytest.raises(InputError, match=r"extra \"record\".*fdcal\[record\].*replay a recording") as missing:
        take.sound_card()

    def no_portaudio(name):
        raise OSError("PortAudio library not found")

    monkeypatch.setattr(libraries.importlib, "import_module", no_portaudio)
    refuses(r"PortAudio library not found.*libportaudio2.*replay a recording", take.sound_card)
    assert missing.value.worded({"replay": "--replay FILE"}).endswith("or replay a recording: --replay FILE")


def test_an_interrupt_that_nobody_catches_keeps_what_was_recorded(tmp_path):
    soundfile.write(tmp_path / "from.wav", noise().T, RATE)
    count = iter(range(100))

    def wait(_):
        if next(count) == 5:
            raise KeyboardInterrupt

    done = take.record_take(take.replayed(tmp_path / "from.wav", wait=wait), tmp_path / "take.wav", 30)
    assert done.stopped and soundfile.info(tmp_path / "take.wav").frames == 0.5 * RATE
