"""`fdcal gallery`: a folder of pages that a browser opens from the disk, written completely or not at all."""

import math
import re

import pytest
from replays import Reader, offline_page, wait_for
from running import exit_code

from fdcal import load
from fdcal.commands import gallery_pages
from fdcal.model.measurement import load_measurement
from fdcal.model.scene import folder_of, load_scene
from fdcal.model.storage import folder_in_progress
from fdcal.model.validation import InputError, StorageError
from fdcal.session.lesson import lesson_names, load_lesson
from fdcal.viewer import opening

PAGES = {"index.html", "fig1.html", "lesson-1.html", "lesson-2.html"}

# The first lesson keeps its scene, the second one changes it.
LESSON, SCENES = "3_too_many_too_soon", "5_corner_or_centre"


def few_modes(site):
    """The file of the lesson `SCENES` with few modes and sweeps."""
    return site.parent / "few.toml"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The gallery, as the command writes it, of a small scene and two lessons, one of them with few modes."""
    folder, scene = tmp_path_factory.mktemp("site") / "gallery", tmp_path_factory.mktemp("scenes") / "few.toml"
    tiny = (folder_of("scenes") / "tiny.toml").read_text(encoding="utf-8")
    scene.write_text(tiny.replace("modes = 20", "modes = 9"), encoding="utf-8")
    text = (folder_of("lessons") / f"{SCENES}.toml").read_text(encoding="utf-8")
    few = text.replace('"descent", "gauge', '"descent", "solver.modes" = 4, "solver.max_sweeps" = 3, "gauge')
    few_modes(folder).write_text(few, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (("SCENE", str(scene)), ("MICROPHONE", 9), ("MODE", 9)):
            patch.setattr(gallery_pages, name, value)
        patch.setattr(gallery_pages, "LESSONS", {LESSON: "one scene", str(few_modes(folder)): "two"})
        assert not exit_code("gallery", "-o", folder)
    return folder


def test_the_run_that_plays_first_has_its_microphone_and_mode():
    scene = load_scene(gallery_pages.SCENE)
    assert gallery_pages.MICROPHONE < scene.array.number and opening.SCENE == gallery_pages.SCENE
    assert gallery_pages.MODE <= len(load_measurement(opening.MEASUREMENT).frequencies)


def test_the_site_is_complete_small_and_needs_no_network(site):
    assert {path.name for path in site.iterdir()} == PAGES
    assert max(path.stat().st_size for path in site.iterdir()) < 2e6
    for path in site.iterdir():
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"https?:|fetch\(|XMLHttpRequest|import\(|url\(", text), path.name
        assert path.name == "index.html" or "default-src 'none'" in dict(Reader(text).given)["content"]
        links = [value for key, value in Reader(text).given if key in ("href", "src") and not value.startswith("data:")]
        assert all(link.startswith("#") or link.partition("#")[0] in PAGES for link in links), path.name
        assert links or path.name != "index.html"


def test_every_page_opens_from_the_disk(site, browser):
    with offline_page(browser, site / "index.html", ready="true") as page:
        links = [link.get_attribute("href") for link in page.get_by_role("link").all()]
        assert len(links) == 3 and links[0] == "lesson-1.html" and page.get_by_role("img").count() == 3
        for number, link in enumerate(links):
            page.get_by_role("link").nth(number).click()
            page.wait_for_url(f"**/{link}")
            wait_for(page, "Boolean(window.replay?.landscapes)")
            wait_for(page, "document.getElementById('note').innerText == ''")
            page.go_back()


def test_a_lesson_asks_shows_its_runs_and_is_resumed(site, browser):
    """The numbers are those in the text of the lesson, which `benchmarks documents` compares with the solver."""
    lesson, one_mode = load_lesson(LESSON), "window.replay?.map?.n == 9 && replay.map.indices.length == 1"
    # The index links to the page without a fragment.
    with offline_page(browser, site / "fig1.html", ready=one_mode) as page:
        page.goto((site / "lesson-1.html").as_uri())
        page.get_by_text(lesson.steps[0].question).wait_for()
        page.locator("#errors").get_by_text("mean 224 mm").wait_for()
        page.get_by_role("button", name=lesson.steps[0].choices[0]).click()
        page.get_by_text("Not quite.").wait_for()
        page.keyboard.press("End")
        page.get_by_text("step 91, sweep 7; frequencies no. 1 to 20").wait_for()
        page.locator("#errors").get_by_text("mean 190 mm").wait_for()
        page.get_by_role("button", name="Next step").click()
        page.get_by_text("step 0, sweep 0; frequencies no. 1 to 20").wait_for()
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
    lesson, page_path = load_lesson(few_modes(site)), site / "lesson-2.html"
    first, second = (",".join(map(str, lesson.start(number)[0].gauge.known)) for number in (0, 1))
    with offline_page(browser, page_path, ready=f"window.replay?.data.known.join() == '{first}'") as page:
        page.get_by_role("button", name=lesson.steps[0].choices[lesson.steps[0].answer - 1]).click()
        page.keyboard.press("End")
        page.get_by_text(re.compile(r"^farther half \d+ mm$")).wait_for()  # the plot shows this text
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
def test_a_path_that_is_not_a_folder_is_refused(quick, place, tmp_path, refused):
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
