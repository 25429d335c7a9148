"""What a pointer does in the scene becomes a bounded place on the floor, or nothing."""

from types import SimpleNamespace

import numpy as np
import pytest
from doubles import finish

from fdcal.model.settings import Search
from fdcal.model.validation import InputError, modes_text, parse_modes
from fdcal.viewer.gui.binding import PlanChoices
from fdcal.viewer.scene3d.picking import MicrophonePicker

SEARCH = Search(origin=(1.0, 2.0), size=(0.4, 0.4), step=0.1, radius=1.0)


@pytest.fixture
def picker():
    """A picker, the moves that it reported, and a function that passes it a drag of viser's."""
    placed, selected, direct, callbacks = [], [], [], {}
    binding = SimpleNamespace(
        measurement=SimpleNamespace(count=5, search=SEARCH),
        choices=SimpleNamespace(release=False, plan=PlanChoices()),
        run=SimpleNamespace(problem=SimpleNamespace(known=np.array([4]))),
    )  # fmt: skip
    disc = SimpleNamespace(
        on_click=lambda call: callbacks.update(click=call),
        on_drag=lambda _, modifier="drag": lambda call: callbacks.update({modifier: call}),
    )
    server = SimpleNamespace(scene=SimpleNamespace(add_batched_meshes_simple=lambda *_, **__: disc))
    picture = SimpleNamespace(marker_radius=0.01, z_range=(0.0, 0.0), focus=(0.95, 1.95, 1.45, 2.45))
    made = MicrophonePicker(
        server,
        binding,
        picture,
        selected.append,
        lambda *moved: placed.append(moved),
        lambda *moved: direct.append(moved),
    )
    return SimpleNamespace(
        made=made, binding=binding, placed=placed, selected=selected, direct=direct, **{
            name: lambda event, call=call: finish(call(event)) for name, call in callbacks.items()
        }
    )  # fmt: skip


def event(phase, index, point, eye=(1.2, 2.2, 5.0), page=3):
    camera = SimpleNamespace(position=np.array(eye))
    return SimpleNamespace(
        phase=phase, instance_index=index, end_position=point, client_id=page, client=SimpleNamespace(camera=camera)
    )


def test_the_position_is_where_the_line_of_sight_meets_the_floor(picker):
    picker.drag(event("start", 2, (1.25, 2.1, 2.5), eye=(1.2, 2.0, 5.0)))
    microphone, place, gesture, released = picker.placed[0]
    assert microphone == 2 and gesture is not None and not released
    np.testing.assert_allclose(place, [1.3, 2.2])


def test_with_shift_the_microphone_goes_where_the_pointer_is(picker):
    for phase in ("start", "end"):
        picker.shift(event(phase, 2, (1.25, 2.1, 2.5), eye=(1.2, 2.0, 5.0)))
    assert len(picker.direct) == 2 and not picker.placed
    for index, place, *_ in picker.direct:
        assert index == 2 and place == pytest.approx([1.3, 2.2])


def test_a_drag_is_one_gesture_and_the_next_is_another(picker):
    for phase in ("start", "update", "end", "start", "end"):
        picker.drag(event(phase, 1, (1.2, 2.2, 0.0)))
    gestures = [gesture for _, _, gesture, _ in picker.placed]
    assert [released for *_, released in picker.placed] == [False, False, True, False, True]
    assert gestures[0] == gestures[1] == gestures[2] != gestures[3] == gestures[4]


def test_two_pages_drag_side_by_side(picker):
    picker.drag(event("start", 1, (1.2, 2.2, 0.0), page=1))
    picker.drag(event("start", 2, (1.2, 2.2, 0.0), page=2))
    picker.drag(event("update", 1, (1.2, 2.2, 0.0), page=1))
    assert picker.placed[0][2] == picker.placed[2][2] != picker.placed[1][2]


def test_a_microphone_stays_inside_the_search_domain(picker):
    picker.drag(event("start", 0, (50.0, -50.0, 0.0)))
    np.testing.assert_allclose(picker.placed[0][1], [1.4, 2.0])


def test_a_microphone_in_space_is_dragged_in_the_plane_of_an_upright_slice(picker):
    picker.made.show(np.array([[1.2, 2.2, 0.3]] * 5), None, across=1)
    picker.made._high[2] = 1.0
    picker.drag(event("start", 1, (1.3, 2.1, 0.45), eye=(1.3, 0.2, 0.5)))
    (_, place, *_), *_ = picker.placed
    np.testing.assert_allclose(place, [1.3, 2.2, 0.5 - 0.05 * 2.0 / 1.9], atol=1e-9)
    picker.drag(event("start", 1, (1.3, 2.2, 0.0), eye=(1.3, 2.2, 5.0)))
    assert len(picker.placed) == 1, "seen from above, the pointer is nowhere in particular on it"


@pytest.mark.parametrize("index", [None, -1, 5, 10**9, 1.5, "1"])
def test_a_microphone_that_is_not_there_is_not_moved(picker, index):
    picker.drag(event("start", index, (1.2, 2.2, 0.0)))
    picker.drag(event("update", index, (1.2, 2.2, 0.0)))
    assert picker.placed == []


@pytest.mark.parametrize("point", [(np.nan, 0, 0), (np.inf, 0, 0), (1.2, 2.2, 5.0), (1.2, 2.2, 9.0), (1.0, 2.0)])
def test_a_pointer_that_meets_no_floor_moves_nothing(picker, point):
    picker.drag(event("start", 1, point))
    assert picker.placed == []


@pytest.mark.parametrize("index", [None, -1, 5, 2, 4])
def test_a_click_selects_a_microphone_that_exists(picker, index):
    picker.click(SimpleNamespace(instance_index=index))
    assert picker.selected == ([index] if index in (2, 4) else [])


def test_an_update_without_a_start_or_after_the_page_closed_moves_nothing(picker):
    picker.drag(event("update", 1, (1.2, 2.2, 0.0)))
    picker.drag(event("start", 1, (1.2, 2.2, 0.0)))
    picker.made.forget(3)
    picker.drag(event("update", 1, (1.2, 2.2, 0.0)))
    assert [released for *_, released in picker.placed] == [False, True], "a page that closes lets go"


def test_a_microphone_is_let_go_at_its_last_place_where_the_pointer_has_left_the_floor(picker):
    picker.drag(event("start", 1, (1.2, 2.2, 0.0)))
    picker.drag(event("end", 1, (1.2, 2.2, 9.0)))
    (_, before, _, _), (_, place, _, released) = picker.placed
    assert released and place == pytest.approx(before)


@pytest.mark.parametrize(
    ("text", "modes"), [("1", (1,)), ("1-3, 5", (1, 2, 3, 5)), (" 5 ,1 - 2,", (1, 2, 5)), ("3,3,2-3", (2, 3))]
)
def test_modes_are_read_as_written(text, modes):
    assert parse_modes(text, 9) == modes
    assert parse_modes(modes_text(modes), 9) == modes


@pytest.mark.parametrize("text", ["", ",", "0", "10", "3-2", "1-99", "x", "1;2", "-1", "1--2", "1" * 300, "<b>"])
def test_modes_that_are_not_there_are_refused(text):
    with pytest.raises(InputError, match="1 to 9"):
        parse_modes(text, 9)


def test_a_known_microphone_stays_unless_it_is_released(picker):
    picker.drag(event("start", 4, (1.2, 2.2, 0.0)))
    picker.drag(event("update", 4, (1.2, 2.2, 0.0)))
    assert not picker.placed
    picker.binding.choices.release = True
    picker.drag(event("update", 4, (1.2, 2.2, 0.0)))
    assert [number for number, *_ in picker.placed] == [4]
