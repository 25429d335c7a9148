"""Plans: layouts, fields of rooms, bounds, and what they say."""

import json
import multiprocessing
from dataclasses import replace

import numpy as np
import pytest

from fdcal.acoustics.dictionary import dictionary
from fdcal.assessment.uncertainty import position_bound
from fdcal.graphics.reports import draw_plan, plan_html
from fdcal.model.validation import InputError, StorageError
from fdcal.recordings.frequencies import default_max_rows
from fdcal.session.planning.advice import sizes_of
from fdcal.session.planning.bounds import field_of, forecast, places_in_room, request_information, wavenumbers_of
from fdcal.session.planning.plan import make_plan, plan_dict, plan_lines, trial_lines
from fdcal.session.planning.request import Layout, PlanRequest, read_layout
from fdcal.session.planning.trials import Trials, draw_measurement, run_trials
from fdcal_bench.cases import FAMILIES, SNR_DB, TAKES
from fdcal_bench.scores import read_reference


def request_of(text="circle 12 0.3", **others):
    return PlanRequest(read_layout(text), **others)


@pytest.mark.parametrize(
    ("text", "count", "axes"),
    [
        ("circle 12 0.3", 12, 2),
        ("rectangle 4x3 0.6x0.4", 12, 2),
        ("ball 9 0.3", 9, 3),
        ("box 9 1x1x0.5", 9, 3),
        ("tiny", 16, 2),
    ],
)
def test_layouts_in_words_and_scenes(text, count, axes):
    assert read_layout(text).positions.shape == (count, axes)


def test_layouts_from_files(tmp_path):
    table, geometry = tmp_path / "a.csv", tmp_path / "a.xml"
    table.write_text("name,x,y,z\na,0,0,1\nb,1,0,1\nc,0,1,1\n")
    geometry.write_text('<MicArray><pos Name="p" x="0" y="0" z="0"/><pos Name="q" x="1" y="0" z="0.5"/></MicArray>')
    assert read_layout(str(table)).names == ("a", "b", "c")
    assert read_layout(str(table)).positions.shape == (3, 2)  # one height: a plane
    assert read_layout(str(geometry)).positions.shape == (2, 3)


@pytest.mark.parametrize("text", ["nothing", "circle", "circle 12", "circle x 0.3", "circle 12 -0.3", "cone 12 0.3"])
def test_no_layout_is_one_line(text):
    with pytest.raises(InputError) as caught:
        read_layout(text)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises((StorageError, InputError)):
        read_layout(str(tmp_path / "none.csv"))


@pytest.mark.parametrize(
    ("wrong", "key"),
    [
        ({"snr_db": 0.0}, "snr"),
        ({"snr_db": np.nan}, "snr"),
        ({"snr_db": "30"}, "snr"),
        ({"reverberation_time": -1.0}, "reverberation_time"),
        ({"reverberation_time": 1e9}, "frequencies"),
        ({"band": (300.0, 200.0)}, "frequencies"),
        ({"band": (20.0, 21.0)}, "frequencies"),
        ({"band": (5000.0, 6000.0)}, "frequencies"),
        ({"band": (np.nan, 200.0)}, "frequencies"),
        ({"known": (-1,)}, "known"),
        ({"known": (0, 0)}, "known"),
        ({"known": (99,)}, "known"),
        ({"known": (0.5,)}, "known"),
        ({"known": tuple(range(12))}, "known"),
        ({"known": (0, 4, 8), "known_sigma": -1.0}, "known_sigma"),
        ({"known": (0, 4, 8), "known_sigma": np.nan}, "known_sigma"),
        ({"known_sigma": 0.005}, "known_sigma"),
        ({"gain_sigma_db": -3.0}, "gain_sigma_db"),
        ({"gain_sigma_db": np.inf}, "gain_sigma_db"),
        ({"modes": -1}, "modes"),
        ({"modes": 0}, "modes"),
        ({"modes": 4.5}, "modes"),
        ({"room": (5.0,)}, "room"),
        ({"room": (5.0, -4.0)}, "room"),
        ({"text": "ball 12 0.3", "room": (5.0, 4.0)}, "room"),
        ({"seed": -1}, "seed"),
        ({"solver": "x"}, "solver"),
        ({"kind": "speech"}, "kind"),
        ({"kind": "impulse"}, "room"),
    ],
)
def test_requests_out_of_range(wrong, key):
    with pytest.raises(InputError) as caught:
        request_of(**wrong)
    assert caught.value.key == key and "\n" not in str(caught.value)


def test_the_remedy_for_a_ratio_of_nothing_excludes_it():
    with pytest.raises(InputError, match="more than 0 and at most 120"):
        request_of(snr_db=0.0)


def test_two_microphones_at_one_place_are_named():
    layout = read_layout("circle 8 0.2")
    positions = layout.positions.copy()
    positions[5] = positions[2]
    with pytest.raises(InputError, match="microphones 2 and 5 are at one place"):
        PlanRequest(replace(layout, positions=positions))


def test_what_the_array_cannot_interpolate_is_left_out_of_a_band():
    """The bound is that of the band up to this frequency, in every line, and the plan says so."""
    wide, whole = request_of("circle 8 0.2", band=(1.0, 1e5)), request_of("circle 8 0.2")
    cut = replace(wide, band=(1.0, whole.f_max))
    assert wide.limits == (1.0, whole.f_max) and np.array_equal(wide.frequencies, cut.frequencies)
    plan = make_plan(wide)
    sizes = dict(plan.advice.accuracy.sizes.tolist())
    assert plan.bound.rms == make_plan(cut, with_advice=False).bound.rms
    assert sizes[1.0] == pytest.approx(plan.bound.rms, rel=0.1)
    assert "of 1 to 100000 Hz the higher ones are left out" in plan_lines(plan)[2]
    assert "left out" not in plan_lines(make_plan(cut, with_advice=False))[2]


def test_sizes_whose_band_holds_nothing_are_left_out():
    """A larger array interpolates too little of the band; the plan of the present one stays."""
    request = request_of("circle 8 0.2", band=(500.0, 690.0))
    factors = make_plan(request).advice.accuracy.sizes[:, 0]
    assert 1.0 in factors and factors.max() < 2 and factors.min() == pytest.approx(0.35)


def test_trials_that_are_all_refused_give_no_advice_on_noise_and_size(recwarn):
    request = request_of("circle 8 0.2")
    none = np.full((4, 8), np.nan)
    trials = Trials(none, ("refused",) * 4, np.ones(8, bool), 0.01, request.accuracy, 1.0)
    plan = make_plan(request, trials=trials)
    text = "\n".join(plan_lines(plan))
    assert " inf " not in text and "no advice on noise and size" in text
    assert json.loads(json.dumps(plan_dict(plan), allow_nan=False))["advice"]["margin"] is None
    assert not recwarn.list


@pytest.mark.parametrize("known", [(), (0, 3, 12)])
def test_the_tape_improves_the_shape_which_is_compared_in_one_frame(known):
    """The error in the frame of the tape may be larger than that after alignment, which has no frame to err in."""
    plan = make_plan(request_of("rectangle 4x4 0.5x0.5", known=known))
    tape = plan.advice.tape
    blind = make_plan(request_of("rectangle 4x4 0.5x0.5"), with_advice=False).bound.rms
    assert tape.shape_rms < tape.shape_before == pytest.approx(blind, rel=1e-6)
    assert tape.shape_rms < tape.rms
    line = next(line for line in plan_lines(plan) if "by tape," in line)
    assert "in the frame of the tape" in line and "after alignment" in line


@pytest.mark.parametrize(
    ("text", "room", "words"),
    [
        ("rectangle 4x4 3x3", (2.0, 4.0, 2.5), "the array, 3 x 3 x 0 m, does not fit into the room, 2 x 4 x 2.5 m"),
        ("ball 16 4", (5.0, 4.0, 2.6), r"does not fit into the room, 5 x 4 x 2\.6 m"),  # nor has it a band
        ("circle 16 0.3 vertical", (5.0, 4.0, 0.6), r"the array, 0\.6 x 0 x 0\.6 m, does not fit"),
        ("circle 16 0.3", (5.0, 0.7), r"the array, 0\.6 x 0\.6 m, does not fit into the room, 5 x 0\.7 m"),
    ],
)
def test_an_array_larger_than_the_room(text, room, words):
    with pytest.raises(InputError, match=words) as refused:
        request_of(text, room=room)
    assert refused.value.key == "room" and "smaller array or a larger" in refused.value.remedy


def test_no_size_is_compared_that_does_not_fit_into_the_room():
    request = request_of("ball 16 0.8", room=(5.0, 4.0, 2.6))
    extent = np.ptp(request.layout.positions, axis=0)
    factors = sizes_of(request, None)[:, 0]
    assert 2.0 in factors and 2.83 not in factors and 2.83 * extent[2] > 2.4


@pytest.mark.parametrize("room", [(6.0, 5.0), (6.0, 5.0, 2.7)])
def test_the_field_of_a_room_solves_the_wave_equation(room):
    """Its pressures lie in the span of the Fourier-Bessel functions, as those of no other field do."""
    request = request_of("ball 60 0.3" if len(room) == 3 else "rectangle 6x6 0.6x0.6", room=room)
    f = request.spaced(60)[:3]
    p, k = field_of(request, f, np.random.default_rng(0)), wavenumbers_of(request, f)
    x = request.layout.positions
    for m in range(len(f)):
        W = dictionary(x, k[m], 5, x.mean(axis=0), len(room))
        rest = p[m] - W @ np.linalg.lstsq(W, p[m], rcond=None)[0]
        assert np.linalg.norm(rest) < 2e-3 * np.linalg.norm(p[m])


def test_the_measurement_of_a_trial_has_the_noise_and_errors_that_were_asked_for():
    request = request_of("circle 12 0.3", snr_db=20.0, known=(0, 4, 8), known_sigma=0.005)
    found = [draw_measurement(request, trial) for trial in range(30)]
    errors = np.concatenate([one.known_positions - request.layout.positions[[0, 4, 8]] for one in found])
    assert np.std(errors) == pytest.approx(0.005, rel=0.2)
    assert found[0].noise_power is not None
    assert np.allclose(found[0].noise_power, 0.01)
    assert not np.array_equal(found[0].pressures, found[1].pressures)
    assert np.array_equal(found[0].pressures, draw_measurement(request, 0).pressures)


def test_a_plan_says_what_is_undetermined():
    blind = make_plan(request_of(), with_advice=False)
    given = make_plan(request_of(known=(0, 4, 8)), with_advice=False)
    assert any("mirror" in line for line in blind.degeneracies)
    assert not any("mirror" in line for line in given.degeneracies)
    few = make_plan(request_of("rectangle 4x4 0.4x0.4", band=(20.0, 150.0)), with_advice=False)
    assert any("determined to" in line for line in few.degeneracies)


def test_noise_and_time_of_recording_exchange_against_each_other():
    """The ratio that a plan asks for gives the accuracy that is wanted, by the bound."""
    known = {"text": "rectangle 4x4 0.5x0.5", "known": (0, 3, 12)}
    present = make_plan(request_of(**known, snr_db=10.0), with_advice=False).bound.rms
    advice = make_plan(request_of(**known, snr_db=10.0, accuracy=present)).advice.accuracy
    assert advice.snr_db > 10
    assert advice.recording_factor == pytest.approx(10 ** ((advice.snr_db - 10) / 10))
    louder = make_plan(request_of(**known, snr_db=advice.snr_db), with_advice=False)
    assert louder.bound.rms == pytest.approx(present / advice.margin, rel=0.1)


def test_json_figure_and_page_hold_the_plan():
    request = request_of("rectangle 4x4 0.5x0.5", room=(6.0, 5.0, 2.7), known=(0, 3, 12))
    plan = make_plan(request)
    table = json.loads(json.dumps(plan_dict(plan)))
    assert table["bound_rms_m"] == plan.bound.rms
    assert table["text"] == plan_lines(plan)
    assert len(draw_plan(plan).axes) >= 4
    page = plan_html(plan)
    assert page.startswith("<!doctype html>")
    assert "http" not in page.replace("http-equiv", "")
    assert page.count("<tr>") == 17


def test_the_figure_says_that_the_accuracy_is_of_every_microphone_and_counts_trials():
    """Its bars are errors of whole arrays: all may lie below the accuracy that few trials reach at every microphone."""
    request = request_of("circle 8 0.2")
    errors = np.full((4, 8), 0.005)
    errors[:3, 0] = 0.02
    trials = Trials(errors, ("good",) * 4, np.ones(8, bool), 0.01, 0.01, 1.0)
    panels = draw_plan(make_plan(request, with_advice=False, trials=trials)).axes
    drawn = next(panel for panel in panels if panel.get_ylabel() == "trials")
    assert drawn.get_title() == "Every microphone within 10 mm: 25% of 4 trials"
    assert np.array_equal(drawn.get_yticks(), np.rint(drawn.get_yticks()))


@pytest.fixture(scope="module")
def easy():
    """A request that is easy to fulfil, and three trials of it."""
    asked = request_of("rectangle 4x4 0.6x0.6", room=(6.0, 5.0), snr_db=40.0, known=(0, 3, 12), band=(20.0, 400.0))
    return asked, run_trials(asked, request_information(asked), 3)


def test_trials_find_an_easy_array_and_never_an_impossible_accuracy(easy):
    found = easy[1]
    assert found.accurate == 1.0
    assert found.found == 1.0
    assert replace(found, accuracy=1e-9).accurate == 0.0


def test_processes_that_share_trials_change_no_result_and_one_that_dies_is_reported():
    easy = request_of("rectangle 4x4 0.6x0.6", room=(6.0, 5.0), snr_db=40.0, known=(0, 3, 12), band=(20.0, 250.0))
    information = request_information(easy)
    alone, shared = run_trials(easy, information, 2), run_trials(easy, information, 2, workers=2)
    np.testing.assert_array_equal(alone.errors, shared.errors)
    assert alone.verdicts == shared.verdicts

    def kill(done, note):
        for worker in multiprocessing.active_children():
            worker.kill()

    with pytest.raises(InputError, match="a worker process has ended"):
        run_trials(easy, information, 40, kill, workers=2)
    assert not multiprocessing.active_children()


def test_a_plan_with_trials_answers_first(easy):
    """Whoever asks whether an array will do reads yes or no before any figure of the bound."""
    asked, simulated = easy
    hard = replace(simulated, errors=np.full_like(simulated.errors, 0.3))
    lines = [plan_lines(make_plan(asked, with_advice=False, trials=trials)) for trials in (simulated, hard, None)]
    assert lines[0][1].startswith("yes: ")
    assert lines[1][1].startswith("no: ")
    assert lines[2][0].startswith("no calibration was simulated: ")


def test_a_plan_says_once_that_no_calibration_was_simulated_and_without_a_placeholder():
    plan = make_plan(request_of(known=(0, 4, 8)), with_advice=False)
    for text in ("\n".join(plan_lines(plan)), plan_html(plan)):
        assert text.count("simulated") == 1 and "trials&gt;" not in text and "<trials>" not in text


def test_a_plan_of_impulses_says_that_its_trials_leave_out_arrival_times():
    request = request_of("ball 12 0.3", room=(5.0, 4.0, 2.6))
    trials = Trials(np.full((2, 12), 0.002), ("good",) * 2, np.ones(12, bool), 0.002, 0.01, 1.0)
    for kind, said in (("impulse", True), ("stationary", False)):
        for simulated in (trials, None):
            plan = make_plan(replace(request, kind=kind), with_advice=False, trials=simulated)
            lines = [line for line in plan_lines(plan) if "calibrations leave out arrival times" in line]
            assert len(lines) == (said and simulated is not None)


def test_a_ratio_that_reaches_the_accuracy_is_not_denied_where_noise_hardly_matters():
    """Given positions that are uncertain limit the error: less noise reaches the accuracy, though hardly."""
    given = request_of("rectangle 4x4 0.6x0.6", known=(0, 3, 12), known_sigma=0.005)
    present, quiet = (expected(replace(given, snr_db=snr))[0].rms for snr in (25.0, 40.0))
    for accuracy, words in (
        (np.sqrt(present * quiet), "less noise hardly lowers"),
        (0.8 * quiet, "no signal-to-noise"),
    ):
        plan = make_plan(replace(given, snr_db=25.0, accuracy=accuracy))
        (line,) = [line for line in plan_lines(plan) if line.startswith(("less noise", "no signal-to-noise"))]
        assert line.startswith(words) and f"{1e3 * quiet:.1f} mm" in line and "given positions better" in line


def test_what_is_reached_already_is_not_said_to_be_out_of_reach():
    plan = make_plan(request_of("circle 16 0.2"))
    assert plan.advice.accuracy.snr_db is None and plan.forecast.rms < plan.request.accuracy
    text = "\n".join(plan_lines(plan))
    assert "10 mm rms is within reach at 30 dB" in text and "no signal-to-noise ratio reaches" not in text
    assert f"as it is {1e3 * plan.bound.rms:.3g} mm" in text


def test_an_array_that_does_not_lie_in_the_room_is_said_to_be_moved(tmp_path):
    places = np.random.default_rng(0).uniform([1.7, 0.5, 0.5], [2.2, 1.0, 1.0], (10, 3))
    table = tmp_path / "a.csv"
    table.write_text("\n".join(["name,x,y,z", *(f"{n},{x},{y},{z}" for n, (x, y, z) in enumerate(places))]))
    layout = read_layout(str(table))
    for size, moved in (((2.0, 2.0, 2.7), True), ((3.0, 2.0, 2.7), False)):
        request = PlanRequest(layout, room=size)
        text = "\n".join(plan_lines(make_plan(request, with_advice=False)))
        assert ("the array is moved as a whole" in text) == moved
        assert np.allclose(places_in_room(request), layout.positions) == (not moved)


@pytest.mark.parametrize("tilt", [0.0, 0.6, np.pi / 2])
def test_a_plane_array_is_planned_in_its_plane_however_it_is_turned(tmp_path, tilt):
    level = read_layout("rectangle 4x3 0.6x0.4").positions
    places = np.column_stack([level[:, 0], np.cos(tilt) * level[:, 1], np.sin(tilt) * level[:, 1]]) + [2.0, 1.5, 1.2]
    table = tmp_path / "a.csv"
    table.write_text("\n".join(["name,x,y,z", *(f"{n},{x},{y},{z}" for n, (x, y, z) in enumerate(places.tolist()))]))
    request, other = PlanRequest(read_layout(str(table)), room=(4.0, 3.0, 2.5)), request_of("rectangle 4x3 0.6x0.4")
    np.testing.assert_allclose(places_in_room(request)[:, :2], places[:, :2], atol=1e-9)
    assert np.ptp(places_in_room(request)[:, 2]) == pytest.approx(np.ptp(places[:, 2]), abs=1e-9)
    bounds = [make_plan(one, with_advice=False).bound.rms for one in (replace(request, room=None), other)]
    assert bounds[0] == pytest.approx(bounds[1], rel=1e-6)
    assert any("not level" in line for line in plan_lines(make_plan(request, with_advice=False))) == (tilt > 0)


def test_an_upright_array_in_words_stands_along_x_and_z():
    places = places_in_room(request_of("rectangle 4x3 0.6x0.4 vertical", room=(4.0, 3.0, 2.5)))
    np.testing.assert_allclose(np.ptp(places, axis=0), [0.6, 0, 0.4], atol=1e-12)
    with pytest.raises(InputError, match="three lengths"):
        request_of("circle 12 0.2 vertical", room=(4.0, 3.0))
    with pytest.raises(InputError, match="no geometry"):
        request_of("ball 12 0.2 vertical")


def test_a_band_that_is_too_narrow_is_named_with_all_its_digits():
    with pytest.raises(InputError, match=r"^2000\.0 to 2004\.0 Hz with a reverberation time of 0\.5 s hold"):
        request_of("circle 12 0.02", band=(2000.0, 2004.0))


def test_positions_in_centimetres_are_suspected(tmp_path):
    places = np.random.default_rng(0).uniform(0, 60, (10, 3))
    table = tmp_path / "cm.csv"
    table.write_text("\n".join(["name,x,y,z", *(f"{n},{x},{y},{z}" for n, (x, y, z) in enumerate(places))]))
    for band in (None, (50.0, 400.0)):
        with pytest.raises(InputError, match="in metres, not in centimetres"):
            PlanRequest(read_layout(str(table)), band=band)


def test_takes_are_independent_so_that_the_bound_falls_with_the_root_of_their_number():
    one, four = (make_plan(request_of("ball 12 0.3", takes=takes), with_advice=False) for takes in (1, 4))
    assert four.bound.rms == pytest.approx(one.bound.rms / 2)
    assert four.takes == one.takes and [case.takes for case in one.takes] == [1, 2, 4, 8]
    first, *several = one.takes
    assert first.rms == first.shared == first.longer
    for case in several:
        assert case.rms == pytest.approx(first.rms / np.sqrt(case.takes))
        assert case.rms < case.shared < first.rms, "divided time costs noise, and still another field is worth more"
        assert case.rms < case.longer < first.rms, "the same time at one place"


def test_several_takes_of_a_large_array_have_the_frequencies_that_an_import_takes():
    whole, lowest = (request_of("ball 64 0.4", takes=4, reverberation_time=0.4, modes=modes) for modes in (None, 100))
    count = default_max_rows(64, 4)
    assert len(whole.frequencies) == len(lowest.frequencies) == count < 100 < whole.max_modes
    band = whole.limits[1] - whole.limits[0]
    assert np.ptp(whole.frequencies) > 0.95 * band > np.ptp(lowest.frequencies), "the band, the lowest 100"
    assert whole.frequencies[0] == lowest.frequencies[0]
    for request, of in ((whole, whole.max_modes), (lowest, 100)):
        line = plan_lines(make_plan(request, with_advice=False))[2]
        assert f"{count} independent ones in each take, as many of {of} as an import" in line


def test_a_longer_recording_brings_ever_less_where_noise_is_low_and_another_place_as_much_as_before():
    gains = []
    for snr in (15, 30, 45):
        first, two, *_ = make_plan(request_of("ball 12 0.3", snr_db=snr), with_advice=False).takes
        gains.append((first.rms / two.longer, first.rms / two.rms))
    longer, places = np.array(gains).T
    assert np.all(np.diff(longer) < 0) and longer[-1] < 1.25
    np.testing.assert_allclose(places, np.sqrt(2))


def test_a_plan_says_what_more_places_of_the_source_bring():
    plan = make_plan(request_of("ball 12 0.3", takes=3), with_advice=False)
    lines = plan_lines(plan)
    assert lines[1].endswith("the source at 3 places, recorded equally long from each")
    (same,) = [line for line in lines if line.startswith("more places")]
    assert "each recorded as long as one" in same and f"3 places {1e3 * plan.takes[2].rms:.3g} mm" in same
    assert any(line.startswith("the same recording time in all") for line in lines)
    assert f"one place, recorded 3 times as long: {1e3 * plan.takes[2].longer:.3g} mm" in lines
    table = plan_dict(plan)
    assert table["takes"] == 3 and [row["takes"] for row in table["takes_expected_rms_m"]] == [1, 2, 3, 4, 8]


@pytest.mark.parametrize(
    ("text", "others", "said"),
    [
        ("ball 16 0.4", {}, True),
        ("ball 16 0.4", {"room": (5.0, 4.0, 2.6)}, True),
        ("ball 16 0.4", {"takes": 2}, False),
        ("ball 16 0.4", {"known": (0, 1, 2, 3)}, False),
        ("ball 17 0.4", {}, False),
        ("circle 16 0.4", {"room": (5.0, 4.0)}, False),
    ],
)
def test_few_microphones_from_one_place_with_nothing_given_are_said_to_be_often_not_found(text, others, said):
    plan = make_plan(request_of(text, **others), with_advice=False)
    trials = Trials(np.full((2, 16), 0.002), ("good",) * 2, np.ones(16, bool), 0.002, 0.01, 1.0)
    for one, expected in ((plan, said), (replace(plan, trials=trials), False)):
        assert any("more places of the source, or try" in line for line in plan_lines(one)) == expected


def test_trials_say_which_verdicts_there_were():
    verdicts = ("good", "ambiguous", "not_converged", "ambiguous")
    trials = Trials(np.full((4, 16), 1e-3), verdicts, np.ones(16, bool), 1e-3, 0.01, 1.0)
    (line, _) = trial_lines(trials)
    assert "verdict good in 25%" in line and line.endswith(", ambiguous in 50%, not_converged in 25%")


def test_more_places_are_worth_more_also_where_they_share_the_rows_that_an_import_takes():
    """Rows of a take that are farther apart are less alike; the bound takes all for independent."""
    layout = read_layout("ball 32 0.4")
    requests = [PlanRequest(layout, (9.0, 7.0, 4.0), 1.0, takes=takes) for takes in (1, 2, 4)]
    plans = [make_plan(request, with_advice=False) for request in requests]
    assert len(requests[1].frequencies) > len(requests[2].frequencies), "they share them"
    cases = [case.rms for case in plans[0].takes]
    assert cases[0] == pytest.approx(plans[0].forecast.rms, rel=1e-9), "one quantity has one value"
    assert cases[:3] == pytest.approx([plan.forecast.rms for plan in plans], rel=0.03)
    assert cases[2] < 0.95 * cases[1] < 0.9 * cases[0]


def test_trials_of_several_takes_have_a_source_for_each():
    one, three = (
        draw_measurement(request_of("ball 12 0.3", takes=takes, gain_sigma_db=1.0, known=(0, 1), known_sigma=0.01), 4)
        for takes in (1, 3)
    )
    assert three.take_count == 3 and three.count == one.count
    for name in ("frequencies", "pressures", "noise_power", "known_positions"):
        np.testing.assert_array_equal(getattr(three.of_take(0), name), getattr(one, name))
    fields = [three.of_take(take).pressures for take in range(3)]
    for a, b in ((0, 1), (0, 2), (1, 2)):
        likeness = abs(np.vdot(fields[a], fields[b])) / np.linalg.norm(fields[a]) / np.linalg.norm(fields[b])
        assert likeness < 0.3, "independent"


@pytest.mark.parametrize("takes", [0, -1, 101, 2.5])
def test_a_number_of_takes_that_is_impossible_is_refused(takes):
    with pytest.raises(InputError) as refused:
        request_of(takes=takes)
    assert refused.value.key == "takes"


def expected(request):
    """Return the forecast and the bound of a request."""
    information = request_information(request)
    bound = position_bound(information, request.prior)
    return forecast(request, information, bound), bound


@pytest.mark.parametrize("number", [0, 1], ids=["noise", "impulses"])
def test_of_ten_recordings_about_eight_err_as_much_as_is_forecast(number):
    """Reached are the reference results of today's solver, in a living room with noise and with impulses."""
    family = [one for one in FAMILIES if one.count == 16][number]
    reached = {one.draw: one.error_mm for one in read_reference() if (one.case, one.method) == (family.name, "fdcal")}
    inside, ratios, kind = 0, [], "impulse" if family.kind == "impulse" else "stationary"
    for draw, error in reached.items():
        places = family.places(draw)
        layout = Layout("drawn", tuple(map(str, range(len(places)))), places)
        found, _ = expected(PlanRequest(layout, family.room, family.reverberation, SNR_DB, takes=TAKES, kind=kind))
        inside += 1e3 * found.low <= error <= 1e3 * found.high
        ratios.append(error / (1e3 * found.rms))
    assert 6 <= inside <= 10 and 1 / 1.5 < np.sqrt(np.mean(np.square(ratios))) < 1.5


def test_frequencies_that_are_far_apart_are_independent_and_close_ones_are_not():
    """A short reverberation time makes neighbours alike over many hertz; the bound takes all for independent."""
    few, many = (expected(request_of("ball 12 0.3", band=(100.0, 300.0), modes=modes)) for modes in (None, 8))
    assert all(found.rms > bound.rms for found, bound in (few, many))
    closer = [expected(request_of("ball 12 0.3", reverberation_time=time))[0].margin for time in (0.2, 0.5, 30.0)]
    assert closer[0] == pytest.approx(closer[1], rel=0.1), "as many independent ones for each hertz of decorrelation"
    assert closer[2] < 1.2, "an import takes a part of them, which are far apart"


def test_arrival_times_lower_the_error_and_the_more_the_more_takes_there_are():
    """They add little to one take, and never make the error worse."""
    ratios = []
    for takes in (1, 2, 4, 8):
        request = request_of("ball 16 0.4", room=(5.0, 4.0, 2.6), reverberation_time=0.4, takes=takes)
        ratios.append(expected(replace(request, kind="impulse"))[0].rms / expected(request)[0].rms)
        words = "arrival times included" if ratios[-1] < 1 else "arrival times add too little"
        text = "\n".join(plan_lines(make_plan(replace(request, kind="impulse"), with_advice=False)))
        assert words in text and ("rms expected, arrival times left out)" in text) == (ratios[-1] < 1)
    assert 1 >= ratios[0] >= ratios[1] > ratios[2] > ratios[3] and ratios[2] < 0.7


def test_a_plan_says_between_which_bounds_the_error_will_be():
    plan = make_plan(request_of("ball 12 0.3"), with_advice=False)
    low, high, rms = (f"{1e3 * value:.3g} mm" for value in (plan.forecast.low, plan.forecast.high, plan.forecast.rms))
    assert plan_lines(plan)[3] == f"expected error: {rms} rms, {low} to {high} in 8 of 10 recordings"
    assert plan_dict(plan)["expected_range_m"] == [plan.forecast.low, plan.forecast.high]
