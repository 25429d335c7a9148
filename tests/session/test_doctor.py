"""The answers of `examine` on healthy and faulty data, and the output of the command."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import soundfile
from recorded import write_places
from running import exit_code

import fdcal
from fdcal.assessment.position_check import compare_positions
from fdcal.commands import report
from fdcal.model.measurement import save_measurement
from fdcal.recordings.recording import ImportOptions
from fdcal.session import doctor
from fdcal.session.calibration_run import solve
from fdcal.session.sources import measurement_input

pytestmark = pytest.mark.usefixtures("remembered_runs")  # a blind calibration does not use the list

RATE = 4000


def answers(*arguments) -> dict[str, tuple[str, str]]:
    findings = list(doctor.examine(*arguments))
    assert all(bool(one.found) == (one.state in ("fault", "differs")) for one in findings)
    return {one.question: (one.state, one.text) for one in findings}


@pytest.mark.parametrize(("change", "code", "words"), [
    (lambda x: x, 0, "list         fine"),
    (lambda x: x[[0, 1, 2, 12, *range(4, 12), 3, *range(13, 16)]], 5, "channels 3 and 12 are swapped"),
])  # fmt: skip
def test_a_list_that_does_not_fit_is_described(tiny, tmp_path, capsys, change, code, words):
    ended = exit_code("doctor", "tiny", "--positions", write_places(tmp_path / "list.csv", change(tiny.positions)))
    out = capsys.readouterr().out
    assert ended == code and words in out.splitlines()[-1] and out.count("fault") == (code > 0)


@pytest.mark.parametrize(("found", "sized"), [
    ((1.05, 0.005), True), ((0.885, 0.007), False), ((1.029, 0.005), False), ((1.0, np.inf), False),
])  # fmt: skip
def test_a_size_counts_only_where_the_array_found_without_the_list_shows_it_too(tiny, monkeypatch, found, sized):
    """The list is 4 % too large; a search that begins with its shape may end elsewhere."""
    inputs = replace(measurement_input(tiny, "tiny"), measurement=replace(tiny, positions=1.04 * tiny.positions))
    result = solve(measurement_input(replace(tiny, known=[], known_positions=None), "tiny"))
    result = replace(result, verdict="ambiguous")
    check = compare_positions(result.positions, inputs.measurement.positions)
    monkeypatch.setattr(doctor, "_size", lambda *_: found)
    fit = doctor.list_fit(inputs, result, check)
    assert fit.sized == sized and not fit.misplaced
    small = replace(result, positions=0.8 * result.positions, verdict="scale_undetermined")
    undetermined = report.comparison(measurement_input(tiny, "tiny"), small)
    assert undetermined.agrees and undetermined.scale == 1, "a size that nothing determines is no finding"
    assert "cannot be trusted (scale_undetermined)" in report.comparison_text(inputs, small, undetermined, None)


def test_a_dead_channel_is_not_called_misplaced(tiny, tmp_path, monkeypatch):
    """It is found anywhere, here 3 m away, which does not contradict the list; an inverted channel is named as well."""
    solve = doctor.solve

    def displaced(*arguments, **others):
        found = solve(*arguments, **others)
        return replace(found, positions=found.positions + 3.0 * (np.arange(16) == 5)[:, None])

    monkeypatch.setattr(doctor, "solve", displaced)
    pressures, rng = np.array(tiny.pressures), np.random.default_rng(3)
    pressures[:, 7] *= -1
    pressures[:, 5] = np.abs(pressures[:, 5]).mean() * rng.standard_normal((len(pressures), 2)).view(complex)[:, 0]
    save_measurement(replace(tiny, pressures=pressures), tmp_path / "dead.npz")
    found = answers(str(tmp_path / "dead.npz"), str(write_places(tmp_path / "list.csv", tiny.positions)))
    assert found.pop("channels") == ("fault", "microphone 5: dead; microphone 7: inverted")
    assert found["list"][0] == "fine" and "fault" not in {state for state, _ in found.values()}


def test_pressures_without_a_common_field_are_a_fault(tmp_path):
    noise = np.random.default_rng(2).standard_normal((16, 16)).view(complex)
    save_measurement(fdcal.Measurement(np.linspace(100, 400, 16), noise, 343.0), tmp_path / "noise.npz")
    assert answers(str(tmp_path / "noise.npz"))["field"][0] == "fault"


def of_samples(tmp_path, *takes):
    """The findings about the samples and the clocks of noise (N, T)."""
    paths = [str(tmp_path / f"take{n}.wav") for n in range(len(takes))]
    for path, samples in zip(paths, takes, strict=True):
        soundfile.write(path, 0.1 * samples.T, RATE, subtype="FLOAT")
    return itertools.islice(doctor.examine(paths, options=ImportOptions(kind="stationary")), 2)


def test_one_channel_of_noise_is_named_and_the_clocks_are_not_fine(tmp_path):
    rng = np.random.default_rng(7)
    noise = rng.standard_normal(10 * RATE) + 0.1 * rng.standard_normal((5, 10 * RATE))
    noise[1] = rng.standard_normal(10 * RATE)
    _, clocks = of_samples(tmp_path, noise)
    assert clocks.state == "unknown" and clocks.text.startswith("not coherent with the others: 1")
    _, clocks = of_samples(tmp_path, rng.standard_normal((5, 10 * RATE)))
    assert (clocks.state, clocks.value) == ("unknown", None) and "no channels are coherent" in clocks.text


def test_the_value_is_that_of_the_take_with_the_fault(tmp_path):
    rng = np.random.default_rng(7)
    healthy = rng.standard_normal(10 * RATE) + 0.1 * rng.standard_normal((5, 10 * RATE))
    faulty = healthy.copy()
    faulty[2, 5 * RATE :], faulty[4] = np.roll(healthy[2], 8)[5 * RATE :], 0
    samples, clocks = of_samples(tmp_path, healthy, faulty, healthy)
    assert (samples.state, clocks.state) == ("fault", "fault")
    assert (samples.found, clocks.found) == ((("silent", "4"),), (("jump", "2"),))
    assert clocks.text.startswith("2: jumps by +2 ms") and clocks.value == pytest.approx(2000, rel=0.01)


def test_responses_that_wrap_round_end_the_examination(tmp_path, capsys):
    rng, t = np.random.default_rng(4), np.arange(RATE) / RATE
    samples = np.exp(-t / 0.05) * rng.standard_normal((6, RATE)) + 1e-4 * rng.standard_normal((6, RATE))
    samples[4] = 0.0
    soundfile.write(tmp_path / "wrapped.wav", 0.1 * np.roll(samples, -20, axis=1).T, RATE, subtype="FLOAT")
    assert exit_code("doctor", tmp_path / "wrapped.wav", "--kind", "impulse") == 4
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("samples") and "4: silent" in line for line in lines)
    assert lines[-1].startswith("wrapped      fault") and "wraps round" in lines[-1]


def test_a_refusal_names_the_option_of_the_command(tmp_path, capsys):
    soundfile.write(tmp_path / "short.wav", 0.1 * np.random.default_rng(4).standard_normal((RATE, 6)), RATE)
    assert exit_code("doctor", tmp_path / "short.wav", "--kind", "stationary") == 0
    assert "give --kind impulse" in capsys.readouterr().out
