"""Plans: layouts, fields of rooms, bounds, and their texts."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import write_places
from running import refuses

from fdcal.session import plan as planning
from fdcal.solvers.robust.arrivals import Arrivals, TakeSources

CENTIMETRES = planning.Layout("cm", tuple("0123456789"), np.random.default_rng(0).uniform(0, 60, (10, 3)))


def request_of(text="circle 12 0.3", **others):
    return planning.PlanRequest(planning.read_layout(text), **others)


@pytest.mark.parametrize(("text", "count", "axes"), [
    ("circle 12 0.3", 12, 2), ("rectangle 4x3 0.6x0.4", 12, 2), ("ball 9 0.3", 9, 3), ("box 9 1x1x0.5", 9, 3),
    ("tiny", 16, 2),
])  # fmt: skip
def test_layouts_in_words_and_scenes(text, count, axes):
    assert planning.read_layout(text).positions.shape == (count, axes)


def test_layouts_from_files(tmp_path):
    table, geometry = tmp_path / "a.csv", tmp_path / "a.xml"
    table.write_text("name,x,y,z\na,0,0,1\nb,1,0,1\nc,0,1,1\n")
    geometry.write_text('<MicArray><pos Name="p" x="0" y="0" z="0"/><pos Name="q" x="1" y="0" z="0.5"/></MicArray>')
    assert planning.read_layout(str(table)).names == ("a", "b", "c")
    # All microphones have one height: the array is plane.
    assert planning.read_layout(str(table)).positions.shape == (3, 2)
    assert planning.read_layout(str(geometry)).positions.shape == (2, 3)


WRONG = {
    "snr": [{"snr_db": 0.0}],
    "known": [{"known": (0, 0)}, {"known": (99,)}, {"known": tuple(range(12))}],
    "known_sigma": [{"known": (0, 4, 8), "known_sigma": -1.0}, {"known_sigma": 0.005}],
    "kind": [{"kind": "speech"}],
    "takes": [{"takes": 101}],
    "frequencies": [{"reverberation_time": 1e9}, {"band": (20.0, 21.0)}],
    "room": [
        {"kind": "impulse"}, {"text": "ball 12 0.3", "room": (5.0, 4.0)},
        # These are larger than the room: a plane array, a ball that has no band either, a circle in a plane room.
        {"text": "rectangle 4x4 3x3", "room": (2.0, 4.0, 2.5)}, {"text": "ball 16 4", "room": (5.0, 4.0, 2.6)},
        {"text": "circle 16 0.3", "room": (5.0, 0.7)},
    ],
}  # fmt: skip


@pytest.mark.parametrize(("wrong", "key"), [(one, key) for key, several in WRONG.items() for one in several])
def test_requests_out_of_range(wrong, key):
    assert refuses("", request_of, **wrong).key == key


def moved(count: int, places) -> planning.Layout:
    """A circle with the places of some microphones changed."""
    layout = planning.read_layout(f"circle {count} 0.2")
    positions = np.array(layout.positions)
    positions[list(places)] = list(places.values())
    return replace(layout, positions=positions)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        *((lambda text=text: planning.read_layout(text), "") for text in (
            "nothing", "circle", "circle 12", "circle x 0.3", "circle 12 -0.3", "cone 12 0.3", "gone.csv", "",
            "circle 16x4 0.2", "ball 16 0.3x0.4", "box 4x4 1x1x1", "ball 16 0.3 0.4")),
        (lambda: planning.PlanRequest(moved(8, {5: (-0.2, 0.0), 4: (-0.2, 0.0)})), "4 and 5 coincide"),
        (lambda: request_of("circle 16 0.3", room=(5.0, 0.7, 0.6)),
         r"the array, 0\.6 x 0\.6 m, does not fit .* 5 x 0\.7 x 0\.6 m.*smaller array or a larger"),
        (lambda: request_of(room=(5.0,)), r"room = \[5\.0\] has 1 lengths"),
        (lambda: request_of(band=(300.0, 200.0)), "300 to 200 Hz is not a band"),
        (lambda: request_of(band=(5000.0, 6000.0)), "interpolates up to .* Hz, but the band begins at 5000 Hz"),
        (lambda: request_of("circle 12 0.02", band=(2000.0, 2004.0)),
         r"^2000\.0 to 2004\.0 Hz with a reverberation time of 0\.5 s hold"),
        (lambda: planning.PlanRequest(CENTIMETRES), "in metres, not in centimetres"),
        (lambda: planning.PlanRequest(CENTIMETRES, band=(50.0, 400.0)), "in metres, not in centimetres"),
    ],
)  # fmt: skip
def test_a_refused_request_names_microphones_sizes_and_frequencies_with_their_digits(make, words):
    refuses(words, make)


LARGE = ("ball 40 0.4",)  # its short windows are not used


def test_a_plan_says_what_is_undetermined_and_its_bound_falls_with_the_root_of_the_number_of_takes():
    blind, given, several = (planning.make_plan(request_of(*LARGE, **others)) for others in (
        {"band": (20.0, 108.0)}, {"known": (0, 4, 8, 30)}, {"band": (20.0, 108.0), "takes": 4},
    ))  # fmt: skip
    assert any("mirror" in line for line in blind.degeneracies)
    assert not any("mirror" in line for line in given.degeneracies)
    assert several.bound.rms == pytest.approx(blind.bound.rms / 2)
    np.testing.assert_allclose(blind.expected[:, 0], blind.forecast.rms / np.sqrt(blind.takes))
    np.testing.assert_allclose(several.expected, blind.expected)


def test_an_array_outside_the_room_is_reported_as_moved(tmp_path):
    places = np.random.default_rng(0).uniform([1.7, 0.5, 0.5], [2.2, 1.0, 1.0], (10, 3))
    layout = planning.read_layout(str(write_places(tmp_path / "a.csv", places)))
    for size, moved in (((2.0, 2.0, 2.7), True), ((3.0, 2.0, 2.7), False)):
        request = planning.PlanRequest(layout, room=size)
        text = "\n".join(planning.plan_lines(planning.make_plan(request)))
        assert ("the array is moved as a whole" in text) == moved
        assert np.allclose(planning.positions_in_room(request), layout.positions) == (not moved)


@pytest.mark.parametrize("tilt", [0.0, 0.6, np.pi / 2])
def test_a_plane_array_is_planned_in_its_plane_however_it_is_turned(tmp_path, tilt):
    level = planning.read_layout("rectangle 4x3 0.6x0.4").positions
    places = np.column_stack([level[:, 0], np.cos(tilt) * level[:, 1], np.sin(tilt) * level[:, 1]]) + [2.0, 1.5, 1.2]
    layout = planning.read_layout(str(write_places(tmp_path / "a.csv", places)))
    plans = [planning.make_plan(one) for one in (planning.PlanRequest(layout), request_of("rectangle 4x3 0.6x0.4"))]
    assert plans[0].bound.rms == pytest.approx(plans[1].bound.rms, rel=1e-6)
    assert ("coordinates in its plane" in planning.plan_lines(plans[0])[0]) == (tilt > 0)
    planning.PlanRequest(layout, room=(4.0, 0.7, 2.5))


@pytest.mark.parametrize(("text", "others", "counted"), [
    ("circle 8 0.1", {"room": (5.0, 4.0, 2.6)}, True), ("ball 32 0.3", {}, True), ("ball 16 1.3", {}, False),
    ("ball 33 0.3", {}, False), ("circle 8 0.1", {"room": (5.0, 4.0)}, False), ("lshape", {}, False),
])  # fmt: skip
def test_short_windows_lower_the_error_of_small_arrays_in_space(text, others, counted):
    plan = planning.make_plan(request_of(text, **others))
    assert any("it includes short windows" in line for line in planning.plan_lines(plan)) == counted
    if counted:
        radius = np.sqrt(np.mean(np.sum(plan.request.layout.positions**2, axis=1)))
        assert 0.01 * radius < plan.forecast.rms < 0.05 * radius


def test_frequencies_that_are_far_apart_are_independent_and_close_ones_are_not():
    """With a short reverberation time near frequencies are equal over many hertz; the bound assumes independence."""
    few, many = (planning.make_plan(request_of(*LARGE, band=(100.0, high))) for high in (135.0, 300.0))
    assert all(plan.forecast.rms > plan.bound.rms for plan in (few, many))
    plans = [planning.make_plan(request_of(*LARGE, reverberation_time=time)) for time in (0.2, 0.5, 30.0)]
    closer = [plan.forecast.rms / plan.bound.rms for plan in plans]
    assert closer[0] == pytest.approx(closer[1], rel=0.1), "equally many independent frequencies"
    assert closer[2] < 1.2, "an import takes a part of them, which are far apart"


def test_what_the_array_cannot_interpolate_is_left_out_of_a_band():
    """The bound is that of the band up to this frequency, in every line, and the plan says so."""
    wide, whole = request_of("circle 8 0.2", band=(1.0, 1e5)), request_of("circle 8 0.2")
    cut = replace(wide, band=(1.0, whole.f_max))
    assert wide.limits == (1.0, whole.f_max) and np.array_equal(wide.frequencies, cut.frequencies)
    plans = [planning.make_plan(request) for request in (wide, cut)]
    assert plans[0].bound.rms == plans[1].bound.rms and np.array_equal(plans[0].expected, plans[1].expected)
    assert "of 1 to 100000 Hz the higher ones are left out" in planning.plan_lines(plans[0])[1]
    assert "left out" not in planning.plan_lines(plans[1])[1]


LIVING = {"room": (5.0, 4.0, 2.6), "reverberation_time": 0.4}
CASES = [
    ("ball 12 0.3", {"known": (0, 1, 2, 3), "known_sigma": 0.005, "gain_sigma_db": 1.0, "takes": 3}),
    ("circle 16 0.3", {"room": (5.0, 4.0), "kind": "impulse"}),
]


@pytest.mark.parametrize(("text", "others"), CASES)
def test_more_signal_and_more_takes_never_make_the_forecast_worse(text, others):
    plans = [planning.make_plan(request_of(text, snr_db=snr_db, **others)) for snr_db in (15.0, 30.0)]
    for plan in plans:
        assert np.all(np.diff(plan.expected, axis=1) <= 0), "less noise"
        assert np.all(np.diff(plan.expected, axis=0) <= 0), "another place of the source"
        assert plan.expected[plan.takes.index(plan.request.takes), 0] == plan.forecast.rms, "one quantity, one value"
        own, best = plan.request.snr_db, planning.FORECAST.max_snr_db
        assert plan.snr_db[0] == own and plan.snr_db[-1] <= max(best, own)
    for name in ("rms", "low", "high"):
        assert np.all(np.diff([getattr(plan.forecast, name) for plan in plans]) <= 0)
    other = planning.make_plan(replace(plans[1].request, takes=8, snr_db=36.0)).forecast.rms
    assert plans[1].expected[plans[1].takes.index(8), plans[1].snr_db.index(36.0)] == pytest.approx(other, rel=1e-12)
    assert np.all(np.diff([plan.bound.rms for plan in plans]) <= 0)


def test_arrival_times_lower_the_error_and_the_more_the_more_takes_there_are():
    """They add little to one take, and never make the error worse."""
    noise, impulse = (planning.make_plan(request_of(*LARGE, kind=kind, **LIVING)) for kind in ("stationary", "impulse"))
    ratios = impulse.expected[:, 0] / noise.expected[:, 0]
    assert 1 >= ratios[0] >= ratios[1] > ratios[2] > ratios[3] and ratios[2] < 0.7
    four = planning.make_plan(replace(impulse.request, takes=4))
    for plan, words in (
        (impulse, "arrival times hardly reduce it"),
        (four, "it includes arrival times\nleast error without arrival times ("),
    ):
        assert words in "\n".join(planning.plan_lines(plan))


def test_arrival_times_have_the_same_information_in_the_plan_and_in_the_solver():
    """With a very weak signal the forecast follows from arrival times only, by the solver's Gauss-Newton matrix."""
    request = request_of("ball 16 0.4", room=(9.0, 8.0, 5.0), kind="impulse", takes=1)
    places, x = planning.positions_in_room(request), request.layout.positions
    source = np.array([1.0, 1.0, 1.0])
    away, sigma = source - places.mean(axis=0), np.array([planning.FORECAST.arrival_sigma_m])
    distance, path = np.linalg.norm(away), np.linalg.norm(places - source, axis=1)
    start = TakeSources(away[None] / distance, np.array([1 / distance]), np.zeros(1))
    term = Arrivals((path - np.median(path))[None], np.ones((1, 16), bool), sigma, sigma, 3, start).terms(x)
    found = planning.arrival_matrix(places, source)
    np.testing.assert_allclose(found, term.matrix, atol=1e-6 * np.abs(term.matrix).max())


@pytest.mark.parametrize(("text", "others"), CASES)
def test_the_advice_follows_from_the_table(text, others):
    plan = planning.make_plan(request_of(text, **others))
    own, values = plan.takes.index(plan.request.takes), np.unique(plan.expected)
    for accuracy in (*values * 0.999, *values * 1.001):
        one = replace(plan, request=replace(plan.request, accuracy=float(accuracy)))
        advice, reached = planning.plan_lines(one)[-1], plan.expected <= accuracy
        if reached[own, 0]:
            assert "the plan is expected to reach" in advice
        elif not reached.any():
            assert advice.startswith("nothing in this table reaches")
        else:
            assert "needs" in advice
            for words in advice.split(" needs ")[1].split(" or "):
                takes, ratio = plan.request.takes, plan.request.snr_db
                for part in words.split(" and "):
                    number = float(part.split()[0])
                    takes, ratio = (int(number), ratio) if "places" in part else (takes, number)
                row, column = plan.takes.index(takes), [f"{x:g}" for x in plan.snr_db].index(f"{ratio:g}")
                assert reached[row, column], "what is advised is in the table"


def test_the_words_have_the_numbers_of_the_plan():
    plan = planning.make_plan(request_of("ball 12 0.3", takes=3))
    lines, low, rms, high = planning.plan_lines(plan), plan.forecast.low, plan.forecast.rms, plan.forecast.high
    assert low < rms < high and plan.expected[2, 0] == rms
    in_mm = lambda values: [f"{1e3 * value:.3g} mm" for value in values]  # noqa: E731
    error = "expected error: {1} rms, {0} to {2} in 8 of 10 recordings; it incl".format(*in_mm((low, rms, high)))
    assert lines[2].startswith(error) and lines[0].endswith("the source at 3 places, each recorded for the same time")
    cells = zip((1, 2, 3, 4, 8), map(in_mm, plan.expected), strict=True)
    rows = [f"{takes} place{'s' * (takes > 1)} {' '.join(row)}" for takes, row in cells]
    assert [" ".join(line.split()) for line in lines[-7:-1]] == ["30 dB 33 dB 36 dB 40 dB", *rows]
