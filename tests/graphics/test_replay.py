"""The replay: numbers and maps are those of Python, one file that loads nothing else, played in a browser."""

import dataclasses
import io
import json
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
from browsing import until
from fields import waves
from PIL import Image
from replays import Reader, contents, descent_on_tiny, offline_page, wait_for
from running import exit_code, refuses

import fdcal
from fdcal.cost.eq7 import ReferenceCost, reference_cost_of
from fdcal.cost.maps import eq7_maps, minima_of, refined
from fdcal.graphics.heatmap import colour_limits, normalise, to_rgb
from fdcal.graphics.marks import LOWEST
from fdcal.graphics.replay import MAX_BYTES, replay_html
from fdcal.model.gauge import position_errors
from fdcal.model.measurement import Measurement, save_measurement
from fdcal.model.problem import ChannelCorrection
from fdcal.model.settings import Search

EVIL = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"


@pytest.fixture(scope="module")
def run():
    """Scene, measurement and the first states of descent on `tiny`."""
    scene, measurement, _, states = descent_on_tiny(60)
    return scene, measurement, states


def test_the_numbers_are_those_of_the_run(run):
    scene, measurement, states = run
    reference_cost = ReferenceCost(measurement.problem())
    text = replay_html(scene, measurement, states, "Tiny", reference_cost)
    data, arrays, positions = contents(text)
    expected = np.array([state.positions for state in states])
    assert np.abs(positions - expected).max() < 1e-8
    np.testing.assert_allclose(arrays["truth"] + data["origin"], measurement.positions, atol=1e-12)
    free = measurement.problem().free
    errors = np.array([position_errors(places, measurement.positions)[free] for places in expected])
    np.testing.assert_allclose(arrays["mean"], errors.mean(axis=1), rtol=1e-12)
    assert np.array_equal(arrays["largest"], errors.max(axis=1)) and data["averaged"] == free.tolist()
    assert np.array_equal(arrays["cost"], [reference_cost(state.positions) for state in states])
    for name in ("step", "sweep", "stage", "restart", "moved", "first", "last"):
        assert np.array_equal(arrays[name], [getattr(state, name) for state in states])
    np.testing.assert_allclose(data["given"], measurement.known_positions, atol=1e-6)
    assert data["known"] == measurement.known.tolist() and data["names"] == list(measurement.names)
    assert np.array_equal(data["outline"], scene.room.vertices) and Reader(text).texts["title"] == "Tiny"


def test_names_and_title_stay_texts(run):
    scene, measurement, states = run
    named = dataclasses.replace(measurement, names=(EVIL, *measurement.names[1:]))
    text = replay_html(scene, named, states, EVIL)
    page = Reader(text)
    assert page.tags.count("script") == 2 and "img" not in page.tags
    assert page.texts["title"] == EVIL and contents(text)[0]["names"][0] == EVIL
    assert EVIL not in text


def test_a_replay_needs_neither_true_positions_nor_a_room(run):
    _, measurement, states = run
    data, arrays, _ = contents(replay_html(None, dataclasses.replace(measurement, positions=None), states, "Blind"))
    assert not {"truth", "mean", "largest"} & set(arrays) and data["outline"] is data["maps"] is None


def test_no_replay_is_larger_than_an_email_attachment_may_be():
    """With many microphones, some states are left out, but never the first or the last."""
    count, rng = 600, np.random.default_rng(0)
    truth = rng.uniform(0, 3, (count, 3))
    pressures = rng.normal(size=(2, count)) + 1j * rng.normal(size=(2, count))
    measurement = Measurement([100.0, 150.0], pressures, 343.0, 3, positions=truth, known=[0, 1, 2, 3])
    fields = ("positions", "cost", "step", "sweep", "stage", "restart", "moved", "first", "last")
    State = dataclasses.make_dataclass("State", fields)
    states = [State(truth + rng.normal(size=truth.shape), 1.0, i, i, 0, 0, -1, 1, 2) for i in range(3000)]
    text = replay_html(None, measurement, states, "Large")
    data, arrays, _ = contents(text)
    steps = arrays["step"]
    assert 0.8 * MAX_BYTES < len(text) < 5e6 and data["taken"] == 3000
    assert (steps[0], steps[-1]) == (0, 2999) and data["count"] == len(steps) > 400 and (np.diff(steps) > 0).all()


DRAWN = """window.drawn = [];
for (const name of ["fillText", "stroke"]) {
  const draw = CanvasRenderingContext2D.prototype[name];
  CanvasRenderingContext2D.prototype[name] = function (...given) {
    if (this.canvas.id == "error") window.drawn.push([given[0] ?? this.strokeStyle, given[2]]);
    draw.apply(this, given);
  };
}"""


@pytest.mark.parametrize("ends_true", [True, False])
def test_a_curve_shows_zero_errors_and_marks_restarts_of_the_solver(ends_true, run, browser, tmp_path):
    scene, measurement, states = run
    path, counted = tmp_path / "restarts.html", {"sweep": 0, "stage": 0, "moved": -1, "first": 1, "last": 3}
    places = [states[0].positions] * 3 + [measurement.positions if ends_true else states[-1].positions]
    restarts = [0, 0, 1, 1] if ends_true else [0] * 4
    shown = [
        SimpleNamespace(step=10 + i, restart=number, positions=place, channels=None, **counted)
        for i, (number, place) in enumerate(zip(restarts, places, strict=True))
    ]
    path.write_text(replay_html(scene, measurement, shown, "Restarts"), encoding="utf-8")
    with offline_page(browser, path, ready="true", script=DRAWN) as page:
        page.get_by_text("step 10, sweep 0; frequencies no. 1 to ").wait_for()
        assert not page.get_by_label("Same as solver").is_visible(), "there is no map"
        scale = {text: height for text, height in page.evaluate("window.drawn") if height is not None}
        colours = {text for text, height in page.evaluate("window.drawn") if height is None}
        assert ("#8c5ab4" in colours) == page.get_by_text("Violet ticks").is_visible() == ends_true
        above = [height for text, height in scale.items() if text != "0" and height < scale.get("0", np.inf)]
        assert len(above) >= 2 and (not ends_true or max(above) + 10 < scale["0"]), "below all decades"


def test_a_calibration_shows_its_run_inside_a_notebook(run, browser):
    """It is in a frame without its own address, which cannot affect the page around it."""
    _, measurement, _ = run
    found = fdcal.calibrate(measurement, solver="joint", modes=12)
    replay = found.show()
    _, arrays, positions = contents(replay.html)
    np.testing.assert_allclose(positions[-1], found.positions, atol=1e-6)
    assert arrays["mean"][-1] == pytest.approx(found.mean_error, rel=1e-3)
    with offline_page(browser) as page:
        page.set_content(f"<h1>Notebook</h1>{replay._repr_html_()}")
        frame = page.frame_locator("iframe")
        frame.get_by_text("step 0, sweep 0").wait_for()
        frame.get_by_role("button", name="Descent step").click()
        frame.get_by_text("your positions").wait_for()
        page.wait_for_timeout(400)  # a live page writes its address within this time
        assert frame.get_by_text("your positions").is_visible() and page.get_by_text("Notebook").is_visible()
    refuses("read from a file", lambda: fdcal.Calibration.from_json(found.to_json()).show())


def test_the_command_writes_a_run(tmp_path, capsys):
    path = tmp_path / "run.html"
    assert exit_code("replay", "tiny", "--solver", "joint", "--microphone", "9", "-o", path) == 0
    data, arrays, _ = contents(path.read_text(encoding="utf-8"))
    said = capsys.readouterr().out
    assert f"{data['count']} states of joint" in said and data["count"] > 5 and data["microphone"] == 9
    assert f"{path.stat().st_size / 1e6:.2g} MB" in said and path.stat().st_size < 120_000
    assert arrays["mean"][-1] < 2e-3


def test_a_measurement_without_search_domain_has_maps_too(run, tmp_path):
    """The domain surrounds the estimate; that of a blind array is moved with it onto the true positions."""
    save_measurement(dataclasses.replace(run[1], search=None, known=(), known_positions=None), tmp_path / "hall.npz")
    assert exit_code("replay", tmp_path / "hall.npz", "-o", tmp_path / "hall.html") == 0
    data, arrays, positions = contents((tmp_path / "hall.html").read_text(encoding="utf-8"))
    assert data["maps"]["modes"] and np.isfinite(arrays["cost"]).all()
    assert data["aligned"] and data["known"] == [] and arrays["mean"][-1] < 2e-3, "after alignment, as calibrate has it"
    low = np.array(data["maps"]["origin"])
    high = low + data["maps"]["step"] * np.array(data["maps"]["shape"])
    assert ((low < positions[-1]) & (positions[-1] < high)).all()


# The maps of a replay equal those of Python for any array, and its address selects a step.


SEARCH = Search((0.0, -0.2), (1.0, 0.8), 0.05, 0.5)
POINTS, FINE_POINTS = 120, 480  # points along the longer edge of a map; the finer map has few modes

MAP = """([t, n, indices]) => {
    const positions = [];
    for (let m = 0; m < replay.data.names.length; m++) positions.push(...replay.placeOf(t, m));
    const maps = indices.map(i => replay.landscapes.map(i, n, positions, t));
    return JSON.stringify(maps.map(({cost, power}) => [...cost, power]));
}"""


def measured(dimension, array_dimension, count=44, modes=9):
    """Plane waves with a decay at random positions: names, frequencies and wavenumbers as of a measured room."""
    low, size = np.array([*SEARCH.origin, 0.5]), np.array([*SEARCH.size, 0.6])
    rng, f, search = np.random.default_rng(dimension + array_dimension), np.linspace(60, 280, modes), SEARCH
    places, k = (low + size * rng.uniform(size=(count, 3)))[:, :array_dimension], 2 * np.pi * f / 343 - 0.04j
    if array_dimension == 3:
        search = dataclasses.replace(SEARCH, origin=tuple(low), size=tuple(size))
    return Measurement(
        f, waves(places, k, 5, rng), 343.0, dimension, array_dimension, wavenumbers=k, positions=places,
        known=[0, 5, 9], search=search,
    )  # fmt: skip


def states_of(measurement, count=4, channels=None):
    """States on their way to the truth; each moves one microphone."""
    away = 0.03 * np.random.default_rng(1).normal(size=measurement.positions.shape)
    numbers = dict(sweep=0, stage=0, restart=0, first=1, channels=channels)
    places = [measurement.positions + away * (count - 1 - t) for t in range(count)]
    return [SimpleNamespace(positions=x, step=10 * t, moved=3 + t, last=4 + t, **numbers) for t, x in enumerate(places)]


def replay_of(measurement, **changes):
    """A replay of the waves of `measured`, its problem and its states."""
    problem, states = measurement.problem(), states_of(measurement, **changes)
    text = replay_html(None, measurement, states, "Waves", reference_cost_of(problem), problem=problem)
    return text, problem, states


@contextmanager
def opened(browser, path, text, address=""):
    path.write_text(text, encoding="utf-8")
    with offline_page(browser, path, address) as page:
        yield page


@pytest.mark.parametrize(("dimension", "array_dimension", "corrected"), [(2, 2, True), (3, 2, False), (3, 3, True)])
def test_the_maps_of_the_browser_are_those_of_python(browser, tmp_path, dimension, array_dimension, corrected):
    measurement, channels = measured(dimension, array_dimension), None
    if corrected:
        rng = np.random.default_rng(3)
        channels = ChannelCorrection(np.exp(rng.normal(size=44) * (0.3 + 1j)), rng.uniform(1, 9, 44))
    text, problem, _ = replay_of(measurement, channels=channels)
    with opened(browser, tmp_path / "maps.html", text) as page:
        data, _, positions = contents(text)
        modes, lattice = data["maps"]["modes"], refined(problem.search, POINTS)
        for t, n in ((0, 7), (3, 20))[: 1 + (dimension == 2)]:
            indices = [0, len(modes) // 2, len(modes) - 1]
            values = np.array(json.loads(page.evaluate(MAP, [t, n, indices])))
            found = values[:, :-1].reshape(3, *lattice.shape[1::-1]) / values[:, -1].sum()
            chosen = [modes[i] for i in indices]
            maps = eq7_maps(problem, positions[t], n, chosen, data["maps"]["order_offset"], lattice, channels)
            np.testing.assert_allclose(found, maps, atol=1e-4 * maps.max())


def test_what_an_address_names_is_shown_or_reported_as_missing_and_a_map_is_the_sum_of_its_modes(browser, tmp_path):
    text, problem, _ = replay_of(measured(2, 2))
    _, _, positions = contents(text)
    vain = "#step=1e9&microphone=99&modes=7-3&view=%3Cb%3E&zoom=0,0,0"
    with opened(browser, tmp_path / "sum.html", text, vain) as page:
        said = page.locator("#note").inner_text()
        assert said == "Not in this replay: step=1e9, microphone=99, modes=7-3, view=<b>, zoom=0,0,0"
        page.get_by_text("step 0, sweep 0").wait_for()
        # A step beyond the end selects the last one.
        page.evaluate("location.hash = 'step=999999&microphone=12&modes=2-6'")
        page.get_by_text("step 30, sweep 0").wait_for()
        wait_for(page, "document.getElementById('note').innerText == ''")
        wait_for(page, "replay.map?.n == 12 && replay.map.indices.length == 5")
        lattice = refined(problem.search, FINE_POINTS)  # a map of few modes is finer
        total = eq7_maps(problem, positions[3], 12, range(2, 7), 2, lattice).sum(axis=0)
        cost = np.array(json.loads(page.evaluate("JSON.stringify([...replay.map.cost])"))).reshape(total.shape)
        np.testing.assert_allclose(cost, total, atol=1e-4 * total.max())
        marked, there = page.evaluate("replay.map.minima"), minima_of(total, lattice)
        assert marked["count"] == there.count and len(marked["lowest"]) == len(there.lowest)
        for name, places in (("lowest", there.lowest), ("others", there.others)):
            np.testing.assert_allclose(np.reshape(marked[name], (-1, 2)), places, atol=1.01 * lattice.step)
        image = np.asarray(Image.open(io.BytesIO(page.locator("#view").screenshot())).convert("RGB")).astype(int)
        # The ball covers a part of the mark.
        row, column = np.argwhere(np.abs(image - LOWEST).max(axis=2) < 20).mean(axis=0)
        np.testing.assert_allclose([column, row], page.evaluate("replay.drawn(12)"), atol=10)
        weak, strong = (10 ** (np.linspace(-14 - range_db, -14, total.size) / 10) for range_db in (0.1, 1.1))
        for cost in (weak, strong):  # the scale follows the rule of all pictures
            low, high = colour_limits(cost, True)
            # A text is fast, an array takes seconds.
            ends, first, last = page.evaluate(SCALE_OF, json.dumps(cost.tolist()))
            np.testing.assert_allclose(ends, 10 * np.log10([low, high]), atol=1e-9)
            wanted = to_rgb(normalise(np.array([cost[0], cost[-1]]), low, high, True))
            np.testing.assert_allclose([first, last], wanted, atol=4)  # rounding may select the next colour


SCALE_OF = """text => {
    const lattice = replay.fineLandscapes, found = new Map([[0, {power: 1, cost: JSON.parse(text)}]]);
    const map = replay.finished({indices: [0]}, found, lattice);
    const [nx, ny] = lattice.shape, {data} = map.image.getContext("2d").getImageData(0, 0, nx, ny);
    const colour = pixel => [...data.slice(4 * pixel, 4 * pixel + 3)];
    return [[map.low, map.high], colour(nx * (ny - 1)), colour(nx - 1)];  // row 0 of an image is at high y
}"""


def test_an_address_leads_to_a_state_and_follows_the_viewer(browser, tmp_path):
    measurement, names = measured(2, 2), ["A & B", *(f"m{n}" for n in range(1, 44))]
    text, *_ = replay_of(dataclasses.replace(measurement, names=tuple(names)))
    address = "#step=20&microphone=0&modes=2-5&view=3d"
    with opened(browser, tmp_path / "moment.html", text, address) as page:
        page.get_by_text("step 20, sweep 0").wait_for()
        page.get_by_role("button", name="3-D", pressed=True).wait_for()
        page.get_by_text("frequencies no. 2 to 5").wait_for()
        assert page.locator("#microphone").input_value() == "0"
        page.get_by_label("State", exact=True).focus()
        page.keyboard.press("ArrowRight")
        page.locator("#microphone").select_option("m7")
        page.get_by_label("Last frequency").focus()
        page.keyboard.press("ArrowRight")
        page.keyboard.press("t")
        wait_for(page, "location.hash == '#step=30&microphone=7&modes=2-6&view=top'")
        page.get_by_label("Same as solver").check()
        wait_for(page, "location.hash == '#step=30&microphone=7&view=top'")
        wait_for(page, "replay.map?.indices.length == 7")
        address = "#step=10&microphone=none&modes=3&view=40,25&zoom=2,0.1,-0.05&map=flat&trails=on&theme=dark"
        page.evaluate(f"location.hash = '{address}'")
        page.get_by_text("step 10, sweep 0").wait_for()
        # The map is that of the microphone that the step moved.
        wait_for(page, "replay.map?.n == 4 && replay.map.indices.length == 1")
        wait_for(page, "document.documentElement.dataset.theme == 'dark'")
        page.keyboard.press("ArrowRight")
        page.keyboard.press("ArrowLeft")
        page.get_by_role("button", name="Reset view").wait_for()
        after = "#step=10&modes=3&view=40,25&zoom=2,0.1,-0.05&trails=on&theme=dark"
        wait_for(page, f"location.hash == '{after}'")
        page.get_by_label("Speed").select_option("50")
        page.get_by_role("button", name="Play").click()
        page.get_by_text("step 30, sweep 0").wait_for()
        page.get_by_role("button", name="Play").wait_for()
        page.evaluate(f"location.hash = '{after}'")
        page.get_by_text("step 10, sweep 0").wait_for()
        # The first click plays, the second one pauses.
        page.evaluate("for (const _ of [1, 2]) document.getElementById('play').click()")
        with opened(browser, tmp_path / "moment.html", text, after) as again:
            wait_for(again, "replay.map?.n == 4 && replay.map.indices.length == 1")

            def of_the_same_moment():
                assert page.locator("#view").screenshot() == again.locator("#view").screenshot()

            until(again, of_the_same_moment)
            again.get_by_role("button", name="Reset view").click()
            wait_for(again, "location.hash == '#step=10&modes=3&view=3d&trails=on&theme=dark'")
            again.get_by_role("button", name="Reset view").wait_for(state="hidden")


def test_a_large_measurement_keeps_the_lowest_modes_within_the_bound():
    text, *_ = replay_of(measured(2, 2, count=100, modes=2500))
    data, arrays, _ = contents(text)
    modes = data["maps"]["modes"]
    assert len(text) < MAX_BYTES and data["maps"]["left_out"] == 2500 - len(modes) > 0
    assert modes == list(range(1, len(modes) + 1)) and arrays["pressures"].shape == (len(modes), 100, 2)
