"""What `examine` says of sound data and of data with a fault, and the page that the command writes."""

import dataclasses

import numpy as np
import pytest
import soundfile

import fdcal
from fdcal.commands.cli import main
from fdcal.model.measurement_file import save_measurement
from fdcal.session import doctor

RATE = 4000


@pytest.fixture(scope="module")
def tiny() -> fdcal.Measurement:
    return fdcal.load("tiny")


@pytest.fixture(scope="module")
def solved() -> dict:
    return {}


@pytest.fixture
def solve_once(monkeypatch, solved):
    """The list takes no part in a blind calibration, which is computed once for all lists."""
    solve = doctor.solve

    def cached(inputs, *arguments, **others):
        if len(inputs.measurement.known):
            return solve(inputs, *arguments, **others)
        return solved.get("tiny") or solved.setdefault("tiny", solve(inputs, *arguments, **others))

    monkeypatch.setattr(doctor, "solve", cached)


def table(path, positions) -> str:
    rows = [",".join([str(n), *map(repr, x)]) for n, x in enumerate(np.asarray(positions).tolist())]
    path.write_text("\n".join(["name,x,y", *rows]) + "\n")
    return str(path)


def answers(*arguments) -> dict[str, tuple[str, str]]:
    return {one.question: (one.state, one.text) for one in doctor.examine(*arguments)}


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (lambda x: x, 0, "list         fine"),
        (lambda x: x[[0, 1, 2, 12, *range(4, 12), 3, *range(13, 16)]], 5, "channels 3 and 12 are swapped"),
        (lambda x: 1.05 * x, 5, "+5.0 % too large"),
        (lambda x: x + 0.25 * (np.arange(len(x)) == 6)[:, None] * [0.6, 0.8], 5, "6 is 250 mm from its place"),
    ],
)
def test_a_list_that_does_not_fit_is_described(tiny, tmp_path, capsys, solve_once, change, code, words):
    with pytest.raises(SystemExit) as ended:
        main(["doctor", "tiny", "--positions", table(tmp_path / "list.csv", change(np.asarray(tiny.positions)))])
    out = capsys.readouterr().out
    assert ended.value.code == code and words in out.splitlines()[-1]
    assert out.count("fault") == (code > 0)


def test_an_inverted_channel_and_nothing_else_is_named(tiny, tmp_path):
    pressures = np.array(tiny.pressures)
    pressures[:, 5] *= -1
    save_measurement(dataclasses.replace(tiny, pressures=pressures), tmp_path / "inverted.npz")
    found = answers(str(tmp_path / "inverted.npz"))
    assert found.pop("channels") == ("fault", "microphone 5: inverted")
    assert "fault" not in {state for state, _ in found.values()}


def test_pressures_without_a_common_field_are_none(tmp_path):
    rng, shape = np.random.default_rng(2), (16, 8)
    noise = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    save_measurement(fdcal.Measurement(np.linspace(100, 400, 16), noise, 343.0), tmp_path / "noise.npz")
    assert answers(str(tmp_path / "noise.npz"))["field"][0] == "fault"


def test_responses_that_wrap_round_end_the_examination_and_the_page_shows_it(tmp_path, capsys):
    rng, t = np.random.default_rng(4), np.arange(RATE) / RATE
    samples = np.exp(-t / 0.05) * rng.standard_normal((6, RATE)) + 1e-4 * rng.standard_normal((6, RATE))
    samples[4] = 0.0
    soundfile.write(tmp_path / "wrapped.wav", 0.1 * np.roll(samples, -20, axis=1).T, RATE, subtype="FLOAT")
    page = tmp_path / "page.html"
    with pytest.raises(SystemExit) as ended:
        main(["doctor", str(tmp_path / "wrapped.wav"), "--kind", "impulse", "-o", str(page)])
    lines = capsys.readouterr().out.splitlines()
    assert ended.value.code == 4
    assert any(line.startswith("samples") and "4: silent" in line for line in lines)
    assert lines[-1].startswith("wrapped      fault")
    assert page.read_text().count("<img") == 2 and "wraps round" in page.read_text()
