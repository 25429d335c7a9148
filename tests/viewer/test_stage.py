"""Scene nodes and cameras: only what has changed is sent, and cameras stand where the picture fits."""

import contextlib
import dataclasses
import re
from types import SimpleNamespace

import numpy as np
import pytest

from fdcal.graphics.camera import Camera, project
from fdcal.graphics.heatmap import cost_floor
from fdcal.graphics.picture import compose, static_picture, with_estimate
from fdcal.graphics.primitives import DARK, LECTURE_DARK, LECTURE_LIGHT, LIGHT, Label
from fdcal.model.arrays import positions_of
from fdcal.model.scene import load_scene
from fdcal.viewer import scene3d as cameras
from fdcal.viewer.scene3d import SceneNodes, labels_html
from fdcal.viewer.server import hardening


@pytest.fixture
def placed(server, scene, measurement) -> cameras.Cameras:
    """The cameras of all browsers, before a picture of `tiny`."""
    made = cameras.Cameras(server)
    made.picture = compose(scene, measurement)
    return made


def browser(width, height=900):
    """A browser whose canvas has a size, pixels, and its camera."""
    camera = SimpleNamespace(image_width=width, image_height=height)
    return SimpleNamespace(client_id=1, camera=camera, atomic=contextlib.nullcontext), camera


def test_a_camera_with_the_right_position_but_the_wrong_direction_is_set_again(placed):
    """A page may report its camera between two of our commands, and viser then believes the report."""
    client, camera = browser(900)
    placed.place(client, "top")
    old_opening, aim = camera.fov, camera.look_at
    camera.look_at = (aim[0] + 3e-5 * camera.position[2], *aim[1:])  # the view turns by 17 degrees about the vertical
    placed.follow(client)
    assert camera.look_at == aim
    placed.place(client, "3d")
    ordered = SimpleNamespace(**vars(camera))
    for name, other in (
        ("look_at", (*ordered.position[:2], 0.0)),  # the plan view has this direction
        ("fov", old_opening),
        ("near", 7 * camera.near),  # the renderer would not draw nearer objects
    ):
        setattr(camera, name, other)
        placed.follow(client)
        assert getattr(camera, name) == getattr(ordered, name)
    camera.look_at, camera.position = (1.0, 1.0, 0.0), (2.0, 2.0, 5.0)
    placed.follow(client)
    assert camera.look_at == (1.0, 1.0, 0.0), "the user has shifted it"
    placed.place(client, Camera((1.0, 2.0, 9.0), (1.0, 2.0, 0.5), (0.0, 1.0, 0.0), 0.6, 1.0))  # that of a link
    camera.position = ordered.position  # an old report
    placed.follow(client)
    assert camera.position == (1.0, 2.0, 9.0)


def test_the_camera_follows_the_canvas_until_the_user_moves_it(scene, measurement):
    fresh = hardening.open_server("127.0.0.1", 0)  # viser chooses the initial camera
    try:
        start, placed = tuple(fresh.initial_camera.position), cameras.Cameras(fresh)
        placed.picture = compose(scene, measurement)
        placed.set_initial(placed.picture)
        client, camera = browser(900)
        placed.place(client, "top")
        near, camera.image_width = camera.position, 450
        placed.follow(client)
        assert camera.position[2] > 1.5 * near[2], "half the width needs twice the distance"
        moved = (camera.position[0] + 1.0, *camera.position[1:])
        camera.position, camera.image_width = moved, 900
        placed.follow(client)
        assert camera.position == moved
        # On a slow machine our command arrives before the report of the page.
        for reported in (near, fresh.initial_camera.position, start):
            camera.position = reported
            placed.follow(client)
            assert camera.position == pytest.approx(near), "right for this size, and nobody has moved it"
    finally:
        fresh.stop()


class SentScene:
    """viser's scene; records in `sent` and `nodes` each node that is added, and each value that changes.

    viser does not send an equal value again. Points and vertices are the first value of a new node.
    """

    def __init__(self):
        self.sent, self.nodes = [], {}

    def add(self, name, *first, **values):
        scene, name = self, name.removeprefix("/")

        class Node(SimpleNamespace):
            def __setattr__(self, key, value):
                before = self.__dict__.get(key, *first[:1])
                if before is None or not np.array_equal(before, value):
                    scene.sent.append(name)
                super().__setattr__(key, value)

            def remove(self):
                del scene.nodes[name]

        self.sent.append(name)
        self.nodes[name] = node = Node(**values)
        return node

    add_line_segments = add_image = add_mesh_simple = add_mesh_trimesh = add

    def __getattr__(self, name):
        return lambda *_, **__: None  # the lights of the scene are ignored


def test_only_what_has_changed_is_sent_and_what_the_next_picture_lacks_is_removed(sent_scene, scene, measurement):
    made, nodes = sent_scene
    static = compose(scene, measurement)
    assert nodes.cameras.picture is None
    nodes.show(with_estimate(static, measurement, measurement.positions, 4))
    assert "room/walls" in made.sent and "microphones/estimate" in made.sent
    made.sent.clear()
    nodes.show(with_estimate(static, measurement, measurement.positions.copy(), 4))
    assert made.sent == []
    nodes.show(with_estimate(static, measurement, measurement.positions + 0.01))
    moved = {"microphones/estimate", "microphones/error"}  # the squares of the known microphones stay
    assert {name.removesuffix("_halo") for name in made.sent} == moved
    nodes.show(static)
    assert made.nodes.keys() == nodes.parts.keys() and not any("selected" in name for name in made.nodes)


def test_a_relief_that_was_replaced_stays_until_pages_have_drawn_the_new_one(sent_scene, scene, measurement):
    made, nodes = sent_scene
    for cost in np.random.default_rng(1).uniform(1, 2, (2, 20, 20)):
        nodes.show(compose(scene, measurement, floor=cost_floor(cost, scene.search, relief=True)))
    left = [nodes.remove_old(now) or sum("relief/" in name for name in made.nodes) for now in (0.0, 1.0, 3.5)]
    assert left == [2, 2, 1]


def test_a_text_tells_the_page_for_which_scene_it_waits(sent_scene, scene, measurement):
    """A page draws a change after it arrives; x of "/labelled" says which texts belong to the drawn scene."""
    made, nodes = sent_scene
    static = compose(scene, measurement)
    for offset, count in ((0.0, 1), (0.0, 1), (0.3, 2)):
        nodes.show(with_estimate(static, measurement, measurement.positions + offset, 4))
        assert made.labelled.position[0] == count and f"data-count='{count}'" in made.texts.content


@pytest.fixture
def sent_scene():
    scene = SentScene()
    scene.texts, scene.labelled = SimpleNamespace(content=""), SimpleNamespace(position=(0.0, 0.0, 0.0))
    scene.add_frame = lambda *_, **__: scene.labelled
    gui = SimpleNamespace(add_html=lambda *_, **__: scene.texts)
    server = SimpleNamespace(scene=scene, gui=gui, atomic=contextlib.nullcontext, initial_camera=None)
    return scene, SceneNodes(server)


def test_texts_are_sent_as_html_names_first(sent_scene, scene, measurement):
    made, nodes = sent_scene
    picture = compose(scene, measurement, measurement.positions, 4)
    label = Label("cut_ends/A", "<b>", (1.0, 2.0, 0.0))
    nodes.show(dataclasses.replace(picture, labels=(*picture.labels, label)))
    texts = re.findall(r">([^<>]+)</span>", made.texts.content)
    assert texts[0] == "microphone 4" and "&lt;b&gt;" in texts[1:3], "names come first, and none is taken for HTML"
    assert texts.index("x (m)") < min(texts.index(number) for number in texts if number[0].isdigit())


@pytest.mark.parametrize("theme", [LIGHT, DARK, LECTURE_LIGHT, LECTURE_DARK], ids=["light", "dark", "lecture", "both"])
def test_texts_have_the_colours_of_the_theme(scene, measurement, theme):
    dark, lecture = theme.background != (255, 255, 255), theme.marks > 1
    still = static_picture(scene, measurement, dark, None, lecture)
    drawn = with_estimate(still, measurement, measurement.positions, 3)
    assert f"color:rgb{theme.foreground}".replace(" ", "") in labels_html(drawn.labels, drawn.theme)


@pytest.mark.parametrize("size", [(1280, 720), (618, 720), (390, 844), (400, 640)])
@pytest.mark.parametrize("name", ["fig1_square", "ball3d"])
@pytest.mark.parametrize("view", ["top", "close"])
def test_each_view_of_the_array_fills_the_window(server, name, size, view):
    scene = load_scene(name)
    measurement = SimpleNamespace(
        search=scene.search, positions=positions_of(scene), array_dimension=len(scene.search.origin), known=[],
        nominal=False,
    )  # fmt: skip
    placed = cameras.Cameras(server)
    placed.picture = picture = compose(scene, measurement)
    client, camera = browser(*size)
    placed.place(client, view)
    there = Camera(camera.position, camera.look_at, camera.up_direction, camera.fov, 1.0)
    x0, y0, x1, y1 = picture.focus
    corners = [(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in picture.z_range]
    pixels, free = project(there, size, corners), min(size[0], 0.55 * size[1] if size[1] > size[0] else size[1])
    assert np.ptp(pixels, axis=0).max() > 0.6 * free
    assert (pixels > 0).all() and (pixels < size).all()
    if size[0] <= cameras.PHONE_WIDTH and view == "top":
        assert pixels[:, 1].max() < 0.5 * size[1], "the panel of a phone covers nothing"


def test_a_view_from_the_side_makes_room_for_a_relief_that_comes_later(placed, scene, measurement):
    client, camera = browser(900, 700)
    floor = cost_floor(np.random.default_rng(1).uniform(1, 2, (20, 20)), scene.search, relief=True)
    for view, follows in (("top", False), ("close", True)):
        placed.picture = compose(scene, measurement)
        placed.place(client, view)
        before = camera.position
        placed.picture = compose(scene, measurement, floor=floor)
        placed.follow(client)
        assert (camera.position != before) == follows
        camera.position = after = tuple(1.5 * x for x in camera.position)  # the user moves the camera
        placed.picture = compose(scene, measurement)
        placed.follow(client)
        assert camera.position == after
    placed.picture = None
    placed.show_layout(client, "expert")
    placed.place(client, "close")
    assert placed.pages[client.client_id].expert, "a page may ask for a view before there is a picture"
