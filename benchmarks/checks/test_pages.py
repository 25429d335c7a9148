"""The commands of pages, which take long, run from beginning to end, and print what the pages show."""

import re
import shutil

import numpy as np
import pytest
import soundfile

import fdcal
from benchmarks.documents import DOCS, PAGES, ROOT, blocks, name_of, prose, run_python, text_of
from benchmarks.printed import renewed, run_fdcal, shows
from fdcal.commands.report import summary
from fdcal.model.gauge import align
from fdcal.model.measurement import load_measurement
from fdcal.session.sources import load_input

TUTORIAL, CHANNELS = DOCS / "tutorials" / "first-recording.md", DOCS / "how-to" / "check-channels.md"
MEASURED = DOCS / "tutorials" / "measured-array.md"
EIGHT = DOCS / "tutorials" / "eight-microphones.md"


def figure(pattern: str, text: str) -> float:
    """The one number of a pattern in a text."""
    (found,) = re.findall(pattern, text)
    return float(found)


def test_the_first_run_finds_the_array_as_exactly_as_the_installation_says():
    said = figure(r"finds them to ([\d.]+) mm", prose(DOCS / "how-to" / "install.md"))
    assert said == pytest.approx(figure(r"error +mean ([\d.]+) mm", run_fdcal("fdcal calibrate tiny")), abs=0.15)


def run_page(page, namespace: dict, skip: str = "") -> None:
    """Run the Python code and the commands of a page in their order, and compare what they print."""
    for block in blocks(text_of(page)):
        if block.language == "python":
            printed = run_python(block.code, name_of(page), namespace)
        elif block.language == "sh" and not (skip and skip in block.code):
            printed = run_fdcal(block.code)
        else:
            continue
        if block.output is not None:
            assert shows(block.output, printed), f"{name_of(page)} shows\n{block.output}\nand it prints\n{printed}"


@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if "```python" in text_of(page) and page not in (TUTORIAL, CHANNELS, EIGHT)],
    ids=name_of,
)
def test_the_python_code_of_a_page_runs_and_prints_what_it_shows(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    namespace: dict = {}
    for block in blocks(text_of(page)):
        if block.language == "python":
            printed = run_python(block.code, name_of(page), namespace)
            assert block.output is None or shows(block.output, printed), printed


def test_the_tutorial_runs_from_beginning_to_end_and_then_the_check_of_its_channels(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_page(TUTORIAL, {})
    known = "".join(block.code for block in blocks(text_of(TUTORIAL)) if block.code.startswith("name,x,y"))
    assert (tmp_path / "known.csv").read_text() == known, "the table that it shows is the one that it writes"
    assert {"plate.wav", "plate.npz", "result.json", "positions.csv", "positions.xml"} <= set(
        path.name for path in tmp_path.iterdir()
    )
    words = prose(TUTORIAL)
    printed = run_fdcal("fdcal calibrate plate.npz --check --positions layout.csv --known none")
    for said, shown_in, near in (
        (r"not used: (-\d+) dB here", r"leave-one-out error (-[\d.]+) dB", 1.5),
        (r"largest distance is ([\d.]+) mm", r"no channels are swapped\n +\w+ +([\d.]+) mm", 0.3),
    ):
        assert figure(said, words) == pytest.approx(figure(shown_in, printed), abs=near)
    rows = (tmp_path / "layout.csv").read_text().splitlines()
    rows[4], rows[13] = rows[13].replace("12,", "3,", 1), rows[4].replace("3,", "12,", 1)
    (tmp_path / "layout.csv").write_text("\n".join(rows))
    (tmp_path / "result.json").unlink()
    (shown,) = [b.code for b in blocks(text_of(CHANNELS)) if b.code.startswith("channels 3 and 12")]
    (line,) = [b.code for b in blocks(text_of(CHANNELS)) if b.code.startswith("fdcal calibrate plate.npz")]
    printed = run_fdcal(line)
    assert shows("\n".join(shown.splitlines()[:3]), printed), printed
    for block in blocks(text_of(CHANNELS)):
        if block.language == "python":
            assert shows(block.output, run_python(block.code, name_of(CHANNELS), {}))


def test_the_page_of_eight_microphones_runs_from_beginning_to_end(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_page(EIGHT, {})


def test_the_page_of_the_measured_array_finds_it_as_exactly_as_it_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "examples" / "frl_array", tmp_path / "examples" / "frl_array")
    run_page(MEASURED, {})
    found = fdcal.Calibration.load("result.json")
    nominal = np.loadtxt("examples/frl_array/nominal.csv", delimiter=",", skiprows=1)[:, 1:]
    said = figure(r"on average ([\d.]+) mm", prose(MEASURED))
    errors = np.linalg.norm(align(np.asarray(found.positions), nominal) - nominal, axis=1)
    assert 1e3 * errors.mean() == pytest.approx(said, abs=1.5)
    assert f"The verdict is `{found.verdict}`" in prose(MEASURED)
    claimed = figure(r"one sigma of ([\d.]+) mm", prose(MEASURED))
    assert 1e3 * np.sqrt(np.mean(found.uncertainty[np.arange(6)] ** 2)) == pytest.approx(claimed, abs=1)
    inputs, imported = load_input("frl_array"), load_measurement("array.npz")  # the scene has the same rows
    assert inputs.scene is None, "nothing of it is simulated"
    for name in ("frequencies", "pressures", "wavenumbers", "noise_power"):
        np.testing.assert_allclose(getattr(inputs.measurement, name), getattr(imported, name), rtol=0, atol=1e-12)
    np.testing.assert_allclose(inputs.measurement.positions, nominal)
    (line,) = [line for line in summary(inputs, found).splitlines() if line.startswith("error")]
    assert f"mean {1e3 * found.mean_error:.3g} mm" in line and "moved as a whole onto the nominal positions" in line


def test_the_microphones_of_the_measured_array_are_as_far_apart_as_its_page_says():
    samples, rate = soundfile.read(ROOT / "examples" / "frl_array" / "source000.flac")
    front, back = np.fft.rfft(samples[:, :2].T[:, : np.argmax(np.abs(samples[:, 0])) + rate // 1000], 4096)
    f = np.fft.rfftfreq(4096, 1 / rate)
    band = (f > 300) & (f < 1500)
    phase, weight = np.unwrap(np.angle(front * back.conj())[band]), np.abs(front * back)[band]
    delay = np.sum(weight * phase * f[band]) / np.sum(weight * f[band] ** 2) / (2 * np.pi)
    said = figure(r"(\d+) mm apart by the direct sound", prose(MEASURED))
    assert 1e3 * 343.2 * delay == pytest.approx(said, abs=2)


def test_lines_that_a_document_shows_get_the_numbers_that_are_printed_now():
    documented = "result  1 take, one sigma 6.1 mm\n...\nverdict good: one sigma 2.4 mm, ...\nlist  +1.4 %"
    printed = "head\nresult  1 take, one sigma 6 mm\nverdict good: one sigma 12.25 mm, and more 3.5\nlist  -10.0 %\nend"
    new = "result  1 take, one sigma 6 mm\n...\nverdict good: one sigma 12.25 mm, ...\nlist -10.0 %"
    assert renewed(documented, printed).replace("list  ", "list ") == new
    assert renewed(new, printed) == renewed(documented, printed)
    for other in (printed.replace("take", "takes"), "\n".join(printed.splitlines()[::-1])):
        with pytest.raises(ValueError, match="is not printed"):
            renewed(documented, other)
        assert not shows(documented, other)
    assert shows("mean 2.5 mm over 16 microphones", "mean 7 mm over 16 microphones")
    assert not shows("mean 2.5 mm over 16 microphones", "mean 2.5 mm over 15 microphones")
