"""Other scenes in place of the first, in a real browser: with uncertainties, and with an array in space."""

import pytest
from browsing import choose, press, slider, tab

DRAWN = "name => window.__viserMutable?.nodeRefFromName?.[name] != null"
GONE = "name => window.__viserMutable?.nodeRefFromName?.[name] == null"
# Number of meshes below a name that a picture shows; a frame of the name stays when they have gone.
SHOWN = """name => {
    let count = 0;
    window.__viserMutable.nodeRefFromName[name]?.traverseVisible(part => { count += Boolean(part.isMesh); });
    return count;
}"""
# Lowest and highest x, y, z of what is drawn under a name; the browser's own axes: y up
BOX = """name => {
    const low = [1e9, 1e9, 1e9], high = [-1e9, -1e9, -1e9];
    window.__viserMutable.nodeRefFromName[name]?.traverse(node => {
        const places = node.geometry?.attributes?.position;
        node.updateWorldMatrix(true, false);
        for (let i = 0; places && i < places.count; i++) {
            const at = node.localToWorld(node.position.clone().fromBufferAttribute(places, i));
            [-at.z, -at.x, at.y].forEach((x, a) => { low[a] = Math.min(low[a], x); high[a] = Math.max(high[a], x); });
        }
    });
    return [low, high];
}"""


@pytest.fixture(scope="module")
def ball(opened):
    """The page of `ball3d`, which is chosen in Explore, in the tab Map."""
    press(opened, "Explore")
    opened.get_by_role("button", name="Choose a scene").click()
    opened.locator("[data-do='scene=ball3d']").click()
    opened.get_by_role("button", name="Choose a scene").get_by_text("ball").wait_for()
    opened.wait_for_function("location.hash.includes('scene=ball3d')")
    press(opened, "Expert")
    opened.get_by_text("fdcal · ball3d").wait_for()
    tab(opened, "Map")
    return opened


def box(page, name):
    return page.evaluate(BOX, name)


def lies(page, axis, place=None):
    """Wait until the slice lies across an axis, at a place unless that is None."""
    flat = f"name => {{ const [low, high] = ({BOX})(name), thick = high[{axis}] - low[{axis}];"
    there = "true" if place is None else f"Math.abs(low[{axis}] - {place}) < 1e-3"
    page.wait_for_function(f"{flat} return thick >= 0 && thick < 1e-3 && {there}; }}", arg="/slice")


def test_isosurfaces_and_a_slice_stand_in_the_scene_and_follow_the_controls(ball):
    ticks = "window.__viserMutable?.nodeRefFromName?.['/frame_ticks']?.visible"
    ball.wait_for_function(f"{ticks} === false")  # of the heights, which coincide from the top
    choose(ball, "Show", "Isosurfaces (3-D)")
    ball.wait_for_function(f"name => ({SHOWN})(name) == 1", arg="/isosurfaces")
    ball.wait_for_function(GONE, arg="/floor")
    low, high = box(ball, "/isosurfaces")
    assert all(a > b - 0.02 for a, b in zip(low, (1.4, 1.1, 0.8), strict=True))
    assert all(a < b + 0.02 for a, b in zip(high, (2.4, 2.1, 1.8), strict=True))
    for axis, name, ends in ((0, "x", (1.4, 2.4)), (1, "y", (1.1, 2.1))):
        choose(ball, "Slice across", name)
        lies(ball, axis)  # only then has the slider the ends of this axis
        for key, place in zip(("Home", "End"), ends, strict=True):
            slider(ball, "Slice at (m)").press(key)
            lies(ball, axis, place)
    sizes = [round(b - a, 2) for a, b in zip(*box(ball, "/slice"), strict=True)]
    assert sizes == [1.02, 0.0, 1.02]
    choose(ball, "Slice across", "None")
    ball.wait_for_function(GONE, arg="/slice")
    tab(ball, "View")
    ball.get_by_role("button", name="3-D", exact=True).locator("visible=true").click()
    ball.wait_for_function(f"{ticks} === true")
    press(ball, "Explore")
    for pressed in ("true", "false"):  # one mode alone, and the sum up to it
        ball.locator("[data-do=alone]").click()
        ball.locator(f"[data-do=alone][aria-pressed={pressed}]").wait_for()
        ball.wait_for_function(f"name => ({SHOWN})(name) == 1", arg="/isosurfaces")
    press(ball, "Expert")
    tab(ball, "View")
    ball.get_by_role("button", name="Top", exact=True).locator("visible=true").click()
    ball.wait_for_function(f"{ticks} === false")
    tab(ball, "Map")
    choose(ball, "Show", "Flat map")
    ball.wait_for_function(DRAWN, arg="/floor")
    ball.wait_for_function(f"name => ({SHOWN})(name) == 0", arg="/isosurfaces")


def test_a_relief_lies_on_its_axes_from_the_top_and_its_slider_sets_its_height(ball):
    choose(ball, "Show", "Relief")
    ball.wait_for_function(DRAWN, arg="/relief")
    seen = f"() => {{ const box = ({BOX})('/relief'), top = box[1][2]; return 0 < top && top < 2 && box }}"
    low, high = ball.wait_for_function(seen).json_value()  # in one look: while a surface is replaced there is none
    assert [round(x, 3) for x in low] == [1.39, 1.09, 0.8] and [round(x, 3) for x in high[:2]] == [2.41, 2.11]
    slider(ball, "Relief height (%)").press("End")
    ball.wait_for_function(f"() => ({BOX})('/relief')[1][2] > 1.8")
