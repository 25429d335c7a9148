"""Keys do what buttons do, and none of them is the camera's."""

import itertools
import typing
from types import SimpleNamespace

import pytest
from viser import _messages

from fdcal.viewer.gui.binding import MAP_KINDS
from fdcal.viewer.tabs import help
from fdcal.viewer.tabs.help import KEYS, add_keys
from fdcal.viewer.tabs.map import LINEAR, LOG

CAMERA_KEYS = (*"WASDQE", "arrowup", "arrowdown", "arrowleft", "arrowright")  # used by viser


def finish(coroutine):
    with pytest.raises(StopIteration):
        coroutine.send(None)


class CallRecorder:
    """An object that records all calls of its methods."""

    def __init__(self, calls, name="", **held):
        self.__dict__.update(_calls=calls, _name=name, **held)

    def __getattr__(self, name):
        return CallRecorder(self._calls, f"{self._name}.{name}".lstrip("."))

    def __call__(self, *arguments, **named):
        self._calls.append((self._name, *arguments, *named.items()))


@pytest.fixture
def page():
    """A page that records what is done to it, and the records."""
    calls = []
    style = SimpleNamespace(log=True, dark=False)
    view = SimpleNamespace(index=4, state=SimpleNamespace(first=1, last=3))
    binding = SimpleNamespace(
        choices=SimpleNamespace(modes=None, style=style, trails=True), modes=20,
        measurement=SimpleNamespace(count=16), session=CallRecorder(calls, "session", view=view),
    )  # fmt: skip
    handles = {
        "microphone": SimpleNamespace(value=15),
        "kind": SimpleNamespace(value=MAP_KINDS[-1]),
        "kinds": MAP_KINDS,
    }
    tabs = CallRecorder(calls, binding=binding, map=CallRecorder(calls, "map", **handles))
    viewer = SimpleNamespace(tabs=tabs)
    return CallRecorder(calls, viewer=viewer), calls


@pytest.fixture
def keyboard(page):
    """Function that presses a key by its face."""
    made = {}

    def add_command(label, hotkey, modifier):
        handle = SimpleNamespace(on_trigger=lambda act: made.__setitem__((hotkey, modifier), act))
        return handle

    add_keys(SimpleNamespace(add_command=add_command), page[0])
    return lambda key, modifier=None, client="me": finish(made[key, modifier](SimpleNamespace(client=client)))


def test_no_key_moves_the_camera_or_is_used_twice():
    faces = [key.name for key in KEYS]
    assert len(set(faces)) == len(faces)
    assert not {key.key for key in KEYS} & set(CAMERA_KEYS), "viser moves the camera with these"
    assert {key.key for key in KEYS} <= set(typing.get_args(_messages.HotkeyKey))


@pytest.mark.parametrize(
    ("key", "modifier", "done"),
    [
        ("R", None, ("run_bar.toggle",)),
        ("N", None, ("run_bar.press", "Step")),
        ("G", None, ("run_bar.press", "Sweep")),
        ("T", None, ("run_bar.press", "Stage")),
        ("X", None, ("run_bar.press", "Reset")),
        ("B", None, ("session.seek", 3)),
        ("F", None, ("session.seek", 5)),
        ("M", None, ("map.pick", 0)),
        ("M", "shift", ("map.pick", 14)),
        ("O", None, ("map.choose_modes", range(1, 5))),
        ("I", None, ("map.choose_modes", range(1, 3))),
        ("P", None, ("sweep.toggle",)),
        ("U", None, ("map.choose_modes", None)),
        ("V", None, ("map.show_as", MAP_KINDS[0])),
        ("L", None, ("map.scale_as", LINEAR)),
        ("Y", None, ("view.draw", ("trails", False))),
        ("K", None, ("view.darken", True)),
        ("1", None, ("look", "me", "top")),
        ("2", None, ("nodes.cameras.request", "me", "3d")),
        ("3", None, ("look", "me", "close")),
        ("J", None, ("lessons.go", "Next")),
        ("J", "shift", ("lessons.go", "Back")),
    ],
)
def test_a_key_does_what_its_button_does(page, keyboard, key, modifier, done):
    keyboard(key, modifier)
    assert page[1] == [done]


def test_keys_keep_the_modes_of_the_map_in_range(page, keyboard):
    choices = page[0].viewer.tabs.binding.choices
    choices.modes = (20,)
    keyboard("O")
    choices.modes = (1,)
    keyboard("I")
    assert page[1] == [("map.choose_modes", range(1, 21)), ("map.choose_modes", range(1, 2))]
    choices.style.log = False
    keyboard("L")
    assert page[1][-1] == ("map.scale_as", LOG)


def test_keys_before_there_is_a_session_do_nothing(page, keyboard):
    page[0].__dict__["viewer"] = None
    for key in KEYS:
        if key.key not in "2J":
            keyboard(key.key, key.modifier)
    assert page[1] == []


def test_help_lists_every_key_and_mark():
    html = help.text()
    for key in KEYS:
        assert f"<b>{key.name}</b>" in html and key.label in html
    for word in ("true", "estimate", "known", "lowest cost", "other minimum", "(mm)", "(Hz)", "fdcal"):
        assert word in html
    for one, other in itertools.pairwise(["Keys", "Mouse", "Marks", "Numbers", "More"]):
        assert html.index(f">{one}<") < html.index(f">{other}<")
