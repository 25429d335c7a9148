"""The public Python API: each name is there, is loaded when it is first used, and is documented."""

from dataclasses import replace

import numpy as np
import pytest
from running import exit_code, refuses

import fdcal

pytestmark = pytest.mark.usefixtures("remembered_runs")


def test_the_table_and_all_list_the_same_names():
    assert sorted(fdcal.__all__) == sorted(fdcal.PUBLIC)
    assert {name for name in dir(fdcal) if not name.startswith("_")} == set(fdcal.PUBLIC)
    with pytest.raises(AttributeError, match="has no attribute 'nosuch'"):
        fdcal.nosuch  # noqa: B018


@pytest.fixture(scope="module")
def found(tiny) -> fdcal.Calibration:
    return fdcal.calibrate(tiny, modes=12)


def test_a_scene_by_name_by_path_and_itself_is_one_measurement(tiny, edited):
    for other in (fdcal.simulate("tiny"), fdcal.simulate(fdcal.load_scene("tiny")), fdcal.load(edited({}))):
        np.testing.assert_array_equal(other.pressures, tiny.pressures)


def test_python_and_the_command_line_find_the_same_positions(tiny, tmp_path):
    path = tmp_path / "r.json"
    assert exit_code("calibrate", "tiny", "--modes", "12", "--noise", "40", "-o", path) == 0
    printed = fdcal.Calibration.load(path)
    same = fdcal.calibrate(tiny, modes=12, noise=40, settings=fdcal.load_scene("tiny").solver)
    np.testing.assert_allclose(same.positions, printed.positions, atol=1e-9)
    assert (same.verdict, same.known) == (printed.verdict, printed.known)


def test_known_microphones_by_name_by_number_and_by_position_are_the_same(tiny, found):
    places, usual = {name: tiny.positions[int(name)] for name in found.known}, fdcal.load_scene("tiny").solver
    for known in (["0", "5", "7"], [7, 0, 5], places, {int(name): list(place) for name, place in places.items()}):
        again = fdcal.calibrate(tiny, known=known, modes=12, settings=replace(usual, known="none"))
        np.testing.assert_array_equal(again.positions, found.positions)
        assert again.known == found.known


@pytest.mark.parametrize(("solver", "corrected"), [("joint", 0.0), ("robust", 1e-3)])
def test_a_position_that_is_given_is_kept(tiny, solver, corrected):
    """Solver joint keeps it exactly; solver robust corrects it, here by less than a millimetre."""
    moved = {n: tiny.positions[n] + 0.5 for n in (1, 3, 10)}  # the given positions move the whole array
    again = fdcal.calibrate(tiny, known=moved, solver=solver, modes=12)
    for n, place in moved.items():
        np.testing.assert_allclose(again.positions[n], place, rtol=0, atol=corrected)
    np.testing.assert_allclose(again.positions, tiny.positions + 0.5, atol=0.02)


@pytest.mark.parametrize(("function", "arguments", "key"), [
    ("calibrate", {"known": [3, "3"]}, "known"), ("calibrate", {"solver": "nosuch"}, "solver.name"),
    ("calibrate", {"exclude": [99]}, "exclude"), ("calibrate", {"modes": 0}, "modes"),
    ("calibrate", {"seed": -1}, "seed"), ("calibrate", {"distance": 0.2}, "distance"),
    ("calibrate", {"seed": 1.5, "solver": "joint", "start": "random"}, "seed"),
    ("calibrate", {"time_limit": 0}, "time_limit"), ("calibrate", {"settings": 3}, "settings"),
    ("calibrate", {"gain_sigma_db": "1"}, "solver.gain_sigma_db"), ("calibrate", {"progress": 3}, "progress"),
    ("load", {"source": 3}, "source"), ("load", {"source": "tiny", "positions": 3}, "positions"),
    ("load", {"source": "nowhere.wav", "temperature": "warm"}, "temperature"),
    ("load", {"source": "nowhere.wav", "known": 3}, "known"), ("landscape", {"modes": 3}, "modes"),
    ("landscape", {"calibration": 3}, "calibration"), ("landscape", {"microphone": "nosuch"}, "microphone"),
    ("landscape", {"measurement": "tiny"}, "measurement"), ("landscape", {"modes": []}, "modes"),
])  # fmt: skip
def test_an_impossible_argument_is_named_in_the_error(tiny, function, arguments, key):
    needed = {"calibrate": {"measurement": tiny}, "landscape": {"measurement": tiny, "microphone": 3}}
    with pytest.raises((fdcal.InputError, fdcal.StorageError)) as caught:
        getattr(fdcal, function)(**needed.get(function, {}) | arguments)
    assert caught.value.key == key
    assert "--" not in str(caught.value)


def test_one_excluded_microphone_is_written_as_a_list(tiny):
    """A text is not split into letters, which would exclude other microphones."""
    for read in (lambda: fdcal.calibrate(tiny, exclude="12"), lambda: fdcal.load("tiny", exclude="12")):
        refuses(r"put names or numbers into a list: exclude = \['12'\]", read)
    assert fdcal.load("tiny", exclude=["12"]).names == tuple(str(n) for n in range(16) if n != 12)


def test_any_setting_of_the_solver_is_an_argument(tiny):
    random = fdcal.calibrate(tiny, solver="joint", start="random", seed=3, modes=20)
    assert (random.solver, random.seed) == ("joint", 3)
    assert fdcal.calibrate(tiny, settings=replace(fdcal.load_scene("tiny").solver, modes=9)).frequencies.size == 9


def test_progress_is_reported_and_may_end_the_run(tiny):
    seen = []
    fdcal.calibrate(tiny, modes=11, progress=lambda done, note: seen.append(done))
    assert seen == sorted(seen)
    assert seen[-1] == 1

    def stop(done, note):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fdcal.calibrate(tiny, modes=10, progress=stop)


def test_the_landscape_is_lowest_at_the_true_position(tiny):
    panels = fdcal.landscape(tiny, 3, range(1, 16))
    assert np.linalg.norm(panels.minima[-1] - tiny.positions[3]) <= 2 * tiny.search.step
    np.testing.assert_allclose(panels.maps[-1], panels.maps[:-1].sum(axis=0))
    assert len(panels.plot(tiny.positions[3]).axes) > 2


def test_the_landscape_round_a_result_needs_no_true_positions(tiny, found):
    without = replace(tiny, positions=None, known=tiny.known, known_positions=tiny.known_positions)
    refuses("true positions", fdcal.landscape, without, 3)
    assert np.isfinite(fdcal.landscape(without, "3", [4], calibration=found).maps).all()
    assert refuses("99", fdcal.landscape, tiny, 3, [99]).key == "modes"


def test_a_result_and_a_measurement_have_a_one_line_representation(tiny, found):
    assert len(repr(found).splitlines()) == 1 and len(repr(found)) < 200
    assert "16 microphones, 3 known, 12 frequencies, verdict good, mean error" in repr(found)
    assert repr(tiny) == "<Measurement: 16 microphones, 3 known, 36 frequencies from 102.1 to 831.0 Hz>"


def test_an_argument_that_does_not_exist_is_a_type_error_with_a_suggestion(tiny):
    for arguments, meant in (({"know": "none"}, "known"), ({"mode": 3}, "modes"), ({"gain_sigma": 1}, "gain_sigma_db")):
        with pytest.raises(TypeError, match=f"calibrate.. got an unexpected .*did you mean '{meant}'"):
            fdcal.calibrate(tiny, **arguments)
