"""The view in the page's address, and the commands of elements on the canvas."""

from types import SimpleNamespace

from fdcal.model.address import parse_address
from fdcal.model.scene import folder_of
from fdcal.session.lesson import load_lesson
from fdcal.viewer import page as module
from fdcal.viewer.cost_maps import MAP_KINDS
from fdcal.viewer.page import address_of, camera_of

CAMERA = "1,2,30,1,2,0,0,1,0,0.02"


class Client:
    """A browser that keeps its notifications."""

    client_id = 7

    def __init__(self):
        self.notified = []

    def add_notification(self, title, body, **_):
        self.notified.append(body)


def command(page, text, client=None):
    """Do what the page does when a browser has sent a command."""
    page.panels.overlay.receive(client or Client(), f"stamp {text}")


def address_bar(page):
    return page.panels.overlay._regions["address"].content.partition("-->")[2].replace("&amp;", "&")


def test_an_address_that_the_page_writes_leads_to_the_same_view(tiny_page, monkeypatch):
    page, _ = tiny_page
    tabs = page.viewer.tabs
    tabs.map.pick(5)
    tabs.map.choose_modes([2, 3, 4, 6])
    tabs.map.show_as(MAP_KINDS[1])
    written = address_of(page.viewer)
    tabs.map.pick(0)
    tabs.map.choose_modes(None)
    tabs.map.show_as(MAP_KINDS[0])
    command(page, f"open={written}&view={CAMERA}")
    choices = page.viewer.binding.choices
    assert (choices.microphone, choices.modes, choices.kind) == (5, (2, 3, 4, 6), "relief")
    (_, camera), *_ = [one for one in page.nodes.cameras.requests if one[1] is not None][-1:]
    assert camera.position == (1, 2, 30) and camera.look_at == (1, 2, 0) and camera.fov == 0.02
    before = page.viewer.binding.choices
    command(page, f"open={written}")
    assert page.viewer.binding.choices is before, "a page that is loaded again changes nothing"
    monkeypatch.setattr(module, "MAX_MODES_TEXT", 20)  # `tiny` has few modes
    for modes, kept in (((1, 3), True), (range(1, page.viewer.binding.modes + 1, 2), False)):
        tabs.map.choose_modes(modes)
        written = parse_address(address_of(page.viewer))
        assert "scene" in written and written.get("modes") == ("1,3" if kept else None), "without a long list"


def test_a_link_to_another_scene_opens_it_and_then_sets_method_step_and_map(tiny_page):
    page, turn_until = tiny_page
    command(page, "open=scene=plane3d&microphone=3&modes=1-4&map=none")
    turn_until(lambda: page.viewer.run.scene.name == "plane3d" and page.viewer.binding.choices.kind == "none")
    turn_until(lambda: address_bar(page) == "scene=plane3d&method=robust&microphone=3&modes=1-4&map=none")
    command(page, "open=scene=tiny&method=joint&step=2&modes=solver&map=flat")
    turn_until(lambda: address_bar(page) == "scene=tiny&method=joint&step=2&modes=solver&map=flat")


OF_TINY = {"fig1_square": "tiny", '"1-57"': '"1-20"', "= 16": "= 9", '"22, 38"': '"9, 18"', '"38"': '"18"'}


def test_a_link_to_the_step_of_a_lesson_shows_what_the_steps_before_it_have_set(server, tiny_page, tmp_path):
    page, turn_until = tiny_page
    text = (folder_of("lessons") / "1_many_minima.toml").read_text(encoding="utf-8")
    for old, new in OF_TINY.items():  # this scene takes hardly any time to simulate
        text = text.replace(old, new)
    (tmp_path / "1_many_minima.toml").write_text(text, encoding="utf-8")
    lesson = load_lesson(tmp_path / "1_many_minima.toml")
    page.lessons._lessons[lesson.title] = lesson
    command(page, "open=lesson=1_many_minima&part=2")
    turn_until(lambda: page.viewer.binding.choices.kind == "shape")
    assert page.viewer.binding.choices.microphone == 9, "the first step sets it"
    turn_until(lambda: address_bar(page) == "lesson=1_many_minima&part=2")
    client = Client()
    page.nodes.cameras.requests.clear()
    # The requests stay in the queue, where the test reads them.
    page.nodes.cameras.process_requests = lambda clients: None
    command(page, f"open=lesson=1_many_minima&part=3&view={CAMERA}", client)
    turn_until(lambda: page.switcher.idle and page.nodes.cameras.requests)
    assert page.nodes.cameras.requests[-1] == (client, camera_of(parse_address(f"view={CAMERA}"))), "it comes last"
    for name in ("1", "1_m"):  # its number, then the beginning of its name
        page.lessons.leave()
        command(page, f"open=lesson={name}", client)
        assert page.lessons.progress.lesson is lesson, client.notified
        turn_until(lambda: page.switcher.idle)
    command(page, "open=lesson=1_many_minima&part=99", client)
    assert "there is no step 99" in client.notified[0]


NOT_THERE = (
    "scene=../../etc/passwd", "scene=none_such", "method=x", "microphone=-1", "microphone=99", "modes=1-9999",
    "step=1&step=2", "step=1&sweep=2", "view=1,2,3", "view=0,0,1,0,0,1,0,1,0,0.5", "other=1", "lesson=x",
    "view=0,0,nan,0,0,1,0,1,0,0.5", "modes=x", "map=up", "scene=100%2525",
)  # fmt: skip


def test_an_impossible_address_is_refused_in_one_line_and_an_unknown_command_does_nothing(tiny_page):
    page, turn_until = tiny_page
    before = page.viewer.binding.choices
    for part in NOT_THERE:
        client = Client()
        command(page, f"open={part}", client)
        assert len(client.notified) == 1 and "\n" not in client.notified[0], part
    assert "100%25" in client.notified[0] and "100%2525" not in client.notified[0], "decoded once"
    for value in ("many", "", " ", "x", "1 =", "1 none=1"):
        page.panels.overlay.receive(SimpleNamespace(), value)  # this client cannot receive a notification
    assert page.viewer.binding.choices is before and page.switcher.idle
    command(page, "open=lesson=none_such")  # the film of the opening covers a notification
    turn_until(lambda: "there is no lesson &quot;none_such&quot;" in page.panels.overlay._regions["bar"].content)


def test_the_page_follows_a_browser_until_a_user_chooses(tiny_page):
    page, _ = tiny_page
    for asked, dark in (("dark=on", True), ("dark=off", False), (None, True), ("dark=off", True)):
        if asked is None:
            page.viewer.tabs.view.darken(True)
        else:
            command(page, asked)
        assert page.viewer.binding.choices.dark == dark
