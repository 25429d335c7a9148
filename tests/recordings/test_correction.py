"""Corrected recordings: the differences of the channels are taken out, whatever the recording says."""

import dataclasses
import xml.etree.ElementTree as tree

import numpy as np
import pytest
import soundfile
from running import exit_code

import fdcal
from fdcal.assessment.calibration import ChannelFault, Channels
from fdcal.recordings import export as corrections
from fdcal.recordings.recording import recording_of

N, RATE, T = 6, 8000, 24_000
NAMES = tuple(f"M{n}" for n in range(N))
DELAY, CORNER = 3.1e-4, 40.0  # s, Hz


@pytest.fixture(scope="module")
def sound() -> np.ndarray:
    """What all channels would record alike (N, T): noise between 100 and 3500 Hz that begins and ends in silence."""
    rng, f = np.random.default_rng(3), np.fft.rfftfreq(T, 1 / RATE)
    band = np.clip((f - 100) / 50, 0, 1) * np.clip((3500 - f) / 50, 0, 1)
    return np.fft.irfft(band * np.fft.rfft(rng.normal(size=(N, T)) * np.hanning(T)), T)


def channels() -> Channels:
    gain_db, phase = np.array([0, 2.0, -3.0, 0, 0.5, 0]), np.array([0, 20.0, 180.0, 0, -35.0, 0])
    faults = (
        ChannelFault("M2", "inverted"), ChannelFault("M3", "delayed", DELAY, "s"),
        ChannelFault("M4", "high_pass", CORNER, "Hz"), ChannelFault("M0", "exchanged", partner="M5"),
        ChannelFault("M5", "exchanged", partner="M0"),
    )  # fmt: skip
    return Channels(gain_db, np.full(N, 0.1), phase, np.full(N, 0.1), np.zeros(N), faults)


@pytest.fixture(scope="module")
def result() -> fdcal.Calibration:
    """A calibration of six channels with each fault that can be corrected."""
    line = np.column_stack([np.arange(N, dtype=float), np.zeros(N)])
    f = np.array([100.0])
    return fdcal.Calibration(line, NAMES, "robust", 0, f, 0.0, 1, 0.0, True, verdict="good", channels=channels())


def recorded(sound: np.ndarray) -> np.ndarray:
    """What channels with these faults record of the sound (N, T), by the transfer function that the head gives."""
    f = np.fft.rfftfreq(2 * T, 1 / RATE)
    found = channels()
    H = (10 ** (found.gain_db / 20) * np.exp(1j * np.radians(found.phase_deg)))[:, None] * np.ones(len(f))
    H[3] *= np.exp(-2j * np.pi * f * DELAY)
    H[4, 1:] /= 1 - 1j * CORNER / f[1:]
    heard = np.fft.irfft(H * np.fft.rfft(sound, 2 * T), 2 * T)[:, :T]
    return heard[[5, 1, 2, 3, 4, 0]]


def error_db(found: np.ndarray, sound: np.ndarray) -> float:
    return 20 * np.log10(np.linalg.norm(found - sound) / np.linalg.norm(sound))


def test_what_the_channels_do_is_undone_whatever_the_length_of_a_block(sound, result, monkeypatch):
    recording = recording_of("sound", None, RATE, recorded(sound), names=NAMES)
    correction = corrections.correction_of(result, recording)
    whole = np.hstack(list(corrections.corrected_blocks(recording, correction)))
    assert whole.shape == sound.shape
    assert error_db(recorded(sound), sound) > -3 and error_db(whole, sound) < -40
    monkeypatch.setattr(corrections, "GROUP_SAMPLES", 8 * N * 2500)
    parts = list(corrections.corrected_blocks(recording, correction))
    assert len(parts) > 5
    assert np.hstack(parts) == pytest.approx(whole, abs=1e-12 * np.abs(whole).max())


def test_the_command_writes_floats_and_says_what_it_did(sound, result, tmp_path, capsys):
    faults = [
        dataclasses.replace(fault, name=fault.name[1:], partner=fault.partner and fault.partner[1:])
        for fault in result.channels.faults
    ]
    numbered = dataclasses.replace(result.channels, faults=tuple(faults))
    plain = dataclasses.replace(result, names=tuple(map(str, range(N))), channels=numbered)
    plain.save(tmp_path / "result.json")
    soundfile.write(tmp_path / "in.wav", recorded(sound).T / np.abs(sound).max(), RATE, subtype="FLOAT")
    assert exit_code("correct", tmp_path / "in.wav", tmp_path / "result.json", "-o", tmp_path / "out.wav") == 0
    printed = capsys.readouterr().out
    assert "phases up to 35.0 degrees" in printed, "without the change of sign"
    assert "turned  2" in printed and "0 from 5, 5 from 0" in printed and "3 by 0.31 ms" in printed
    found, rate = soundfile.read(tmp_path / "out.wav")
    assert rate == RATE and soundfile.info(tmp_path / "out.wav").subtype == "FLOAT"
    assert error_db(found.T * np.abs(sound).max(), sound) < -40


def test_a_channel_that_the_calibration_does_not_know_stays_as_it_is(sound, result):
    recording = recording_of("sound", None, RATE, recorded(sound), names=(*NAMES[:5], "reference"))
    correction = corrections.correction_of(result, recording)
    assert correction.unknown == ("reference",)
    found = np.hstack(list(corrections.corrected_blocks(recording, correction)))
    assert error_db(found[5], recorded(sound)[5]) < -60
    faults = (ChannelFault("M0", "exchanged", partner="M1"), ChannelFault("M1", "exchanged", partner="M2"))
    chain = dataclasses.replace(result, channels=dataclasses.replace(result.channels, faults=faults))
    source = corrections.correction_of(chain, recording_of("sound", None, RATE, sound, names=NAMES)).source
    assert source.tolist() == list(range(N)), "an exchange that is not mutual moves none"


def test_channels_that_a_list_shows_exchanged_change_places(sound, result, tmp_path):
    plain = dataclasses.replace(result, channels=dataclasses.replace(result.channels, faults=()))
    line = plain.positions + np.array([[0.0, y] for y in (0, 0.3, 0.9, 0.2, 0.7, 0.1)])
    plain = dataclasses.replace(plain, positions=line)
    # M1 and M2 are exchanged; M3, M4 and M5 stand in each other's places.
    check = fdcal.compare_positions(line, line[[0, 2, 1, 4, 5, 3]])
    assert check.fits and check.swapped == ((1, 2),) and len(check.permuted) == 1
    plain.save(tmp_path / "result.json", check=check)
    recording = recording_of("sound", None, RATE, sound, names=NAMES)
    source = corrections.correction_of(fdcal.Calibration.load(tmp_path / "result.json"), recording).source
    # The microphone of channel n stands where the list has row order[n], whose channel gets its samples.
    assert source[check.order].tolist() == list(range(N))
    assert corrections.correction_of(plain, recording).source.tolist() == list(range(N))


def test_other_channels_and_results_without_gains_are_refused(sound, result):
    recording = recording_of("sound", None, RATE, sound, names=tuple("abcdef"))
    with pytest.raises(fdcal.InputError) as refused:
        corrections.correction_of(result, recording)
    assert refused.value.key == "recording"
    with pytest.raises(fdcal.InputError) as refused:
        corrections.correction_of(dataclasses.replace(result, channels=None), recording)
    assert "robust" in refused.value.remedy


def test_the_factors_of_acoular_multiply_the_samples(result, tmp_path):
    dead = dataclasses.replace(result.channels, faults=(ChannelFault("M1", "dead"),))
    dataclasses.replace(result, channels=dead).export(tmp_path / "calib.xml", table="gains")
    rows = tree.parse(tmp_path / "calib.xml").getroot().findall("pos")  # as Acoular's Calib reads them
    factors = np.array([float(row.get("factor")) for row in rows])
    assert [row.get("Name") for row in rows] == list(NAMES)
    sign = np.array([1, 0, -1, 1, 1, 1])  # M1 is dead, M2 inverted
    assert factors == pytest.approx(sign * 10 ** (-result.channels.gain_db / 20))
