"""`fdcal gallery`: a folder of pages that a browser opens from the disk, written completely or not at all."""

import math
import re
from dataclasses import replace

import pytest
from replays import Reader, contents, offline_page, wait_for
from running import exit_code

from fdcal import load, solvers
from fdcal.commands import gallery_pages
from fdcal.model.measurement import load_measurement
from fdcal.model.scene import folder_of, load_scene
from fdcal.model.storage import folder_in_progress
from fdcal.model.validation import InputError, StorageError, parse_modes
from fdcal.session.lesson import lesson_names, load_lesson
from fdcal.viewer import opening

PAGES = {
    "index.html", "fig1.html", "ball3d.html", "faults.html", "lesson-1.html", "lesson-2.html",
}  # fmt: skip

LESSON, SCENES = "3_too_many_too_soon", "5_corner_or_centre"  # one that keeps its scene, one that changes it

FAULTY = """
[faults]
inverted = [11]
gain_db = 1.0
phase_deg = 5.0
"""


SMALL_BALL = (
    ("count = 64", "count = 16"),
    ("[3, 29, 52, 57]", "[3, 6, 11, 14]"),
    ("highest = 300.0", "highest = 150.0"),
)


def small(show, folder):
    """A show of the gallery with scene `tiny`, whose simulation takes no time; in space with fewer microphones."""
    scene = {"ball3d": folder / "ball.toml", "faults": folder / "faulty.toml"}.get(show.name, folder / "few.toml")
    if show.scene == "ball3d":
        return replace(show, scene=str(scene))
    address = re.sub(r"microphone=\d+", "microphone=9", re.sub(r"modes=[\d-]+", "modes=9", show.address))
    return replace(show, scene=str(scene), microphone=9, address=address)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The gallery, as the command writes it, of small scenes."""
    folder, scenes = tmp_path_factory.mktemp("site") / "gallery", tmp_path_factory.mktemp("scenes")
    tiny, ball = ((folder_of("scenes") / f"{name}.toml").read_text(encoding="utf-8") for name in ("tiny", "ball3d"))
    (scenes / "few.toml").write_text(tiny.replace("modes = 20", "modes = 9"), encoding="utf-8")
    (scenes / "faulty.toml").write_text(tiny.replace("modes = 20", "modes = 14") + FAULTY, encoding="utf-8")
    for old, new in SMALL_BALL:
        ball = ball.replace(old, new)
    (scenes / "ball.toml").write_text(ball, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        shows = [show for show in gallery_pages.SHOWS if show.name not in ("array1", "array2")]
        patch.setattr(gallery_pages, "SHOWS", tuple(small(show, scenes) for show in shows))
        patch.setattr(gallery_pages, "LESSONS", {name: gallery_pages.LESSONS[name] for name in (LESSON, SCENES)})
        assert not exit_code("gallery", "-o", folder)
    return folder


@pytest.mark.parametrize("show", gallery_pages.SHOWS, ids=lambda show: show.name)
def test_what_a_show_names_is_in_its_scene(show):
    scene, address = load_scene(show.scene), dict(part.split("=") for part in show.address.split("&"))
    assert show.solver in solvers.names()
    assert int(address["microphone"]) == show.microphone < scene.array.number
    shipped = show.scene == opening.SCENE  # its measurement; of another scene the solver's modes, which it has at least
    count = len(load_measurement(opening.MEASUREMENT).frequencies) if shipped else scene.solver.modes
    assert not address.get("modes") or parse_modes(address["modes"], count)


def test_the_site_is_complete_small_and_needs_no_network(site):
    assert {path.name for path in site.iterdir()} == PAGES
    assert max(path.stat().st_size for path in site.iterdir()) < 2e6
    for path in site.iterdir():
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"https?:|fetch\(|XMLHttpRequest|import\(|url\(", text), path.name
        links = [value for key, value in Reader(text).given if key in ("href", "src") and not value.startswith("data:")]
        assert all(link.startswith("#") or link.partition("#")[0] in PAGES for link in links), path.name
        assert links or path.name != "index.html"
    data, arrays, _ = contents((site / "faults.html").read_text(encoding="utf-8"))
    assert arrays["mean"][-1] < 5e-3 and data["names"][9] == "9"
    assert "gains" in arrays and data["maps"], "the solver of the bad channel estimates gains"


def test_every_page_opens_from_the_disk(site, browser):
    with offline_page(browser, site / "index.html", ready="true") as page:
        links = [link.get_attribute("href") for link in page.get_by_role("link").all()]
        assert len(links) == 5 and links[0] == "lesson-1.html" and page.get_by_role("img").count() == 5
        for number, link in enumerate(links):
            page.get_by_role("link").nth(number).click()
            page.wait_for_url(f"**/{link}")
            wait_for(page, "Boolean(window.replay?.landscapes)")
            wait_for(page, "document.getElementById('note').innerText == ''")
            page.go_back()


def test_a_lesson_asks_shows_its_runs_and_is_resumed(site, browser):
    """The numbers are those of its text, which `benchmarks documents` compares with the solver."""
    lesson, one_mode = load_lesson(LESSON), "window.replay?.map?.n == 9 && replay.map.indices.length == 1"
    with offline_page(browser, site / "fig1.html", ready=one_mode) as page:  # as the index shows it, without an address
        page.goto((site / "lesson-1.html").as_uri())
        page.get_by_text(lesson.steps[0].question).wait_for()
        page.locator("#errors").get_by_text("mean 224 mm").wait_for()
        page.get_by_role("button", name=lesson.steps[0].choices[0]).click()
        page.get_by_text("Not quite.").wait_for()
        page.keyboard.press("End")
        page.get_by_text("step 91, sweep 7; modes 1 to 20").wait_for()
        page.locator("#errors").get_by_text("mean 190 mm").wait_for()
        page.get_by_role("button", name="Next step").click()
        page.get_by_text("step 0, sweep 0; modes 1 to 20").wait_for()
        wait_for(page, "replay.map?.minima.count > 1")
        lowest = page.evaluate("replay.map.minima.lowest[0]")
        truth = load("tiny").positions
        assert truth is not None
        assert math.dist(lowest, truth[8]) == pytest.approx(0.44, abs=0.01), "44 cm, as the step says"
        right = lesson.steps[1].answer
        page.get_by_role("button", name=lesson.steps[1].choices[right - 1]).click()
        page.get_by_text("Right.").wait_for()
        wait_for(page, "replay.map?.indices.length == 3 && replay.map.minima.count == 1")
        wait_for(page, f"location.hash.startsWith('#part=2,{right}&')")
        page.reload()
        page.get_by_text("Right.").wait_for()
        page.get_by_role("button", name="Again").click()
        page.get_by_role("button", name=lesson.steps[1].choices[0]).wait_for()


def test_each_step_of_a_lesson_shows_the_run_of_its_own_scene(site, browser):
    assert list(gallery_pages.LESSONS) == lesson_names()
    lesson, page_path = load_lesson(SCENES), site / "lesson-2.html"
    first, second = (",".join(map(str, lesson.start(number)[0].gauge.known)) for number in (0, 1))
    with offline_page(browser, page_path, ready=f"window.replay?.data.known.join() == '{first}'") as page:
        page.get_by_role("button", name=lesson.steps[0].choices[lesson.steps[0].answer - 1]).click()
        page.keyboard.press("End")
        page.get_by_text("farther half 21 mm", exact=True).wait_for()  # in the plot
        page.get_by_role("button", name="Next step").click()
        wait_for(page, f"window.replay?.data.known.join() == '{second}'")
        assert page.evaluate("location.hash").startswith("#part=2")
        page.get_by_role("button", name="Back").click()
        wait_for(page, f"window.replay?.data.known.join() == '{first}'")


@pytest.fixture
def quick(monkeypatch):
    """A gallery of two pages, made at once."""
    monkeypatch.setattr(gallery_pages, "gallery_pages", lambda progress: iter([("a.html", "A"), ("index.html", "I")]))


def test_a_folder_that_holds_something_is_kept(quick, tmp_path, refused):
    (tmp_path / "mine.txt").write_text("mine", encoding="utf-8")
    line = refused("gallery", "-o", tmp_path)
    assert "is not empty" in line and "--force" in line
    assert exit_code("gallery", "-o", tmp_path, "--force") == 0
    assert {path.name for path in tmp_path.iterdir()} == {"mine.txt", "a.html", "index.html"}


@pytest.mark.parametrize("place", ["file", "missing/gallery"])
def test_a_place_that_is_no_folder_is_refused(quick, place, tmp_path, refused):
    (tmp_path / "file").write_text("", encoding="utf-8")
    words, code = ("is a file", 2) if place == "file" else ("does not exist", 3)
    assert words in refused("gallery", "-o", tmp_path / place, code=code)


@pytest.mark.parametrize(
    "fault", [KeyboardInterrupt, InputError("a problem", "a remedy"), OSError(28, "No space left")]
)
def test_nothing_half_written_is_left(fault, tmp_path):
    with pytest.raises((KeyboardInterrupt, InputError, StorageError)):
        with folder_in_progress(tmp_path / "gallery") as folder:
            (folder / "a.html").write_text("A", encoding="utf-8")
            raise fault
    assert not list(tmp_path.iterdir())
