"""Isosurfaces and slice of `ball3d`, and the relief of `tiny`, in a real browser."""

import re

import pytest
from browsing import choose, opened_page, serving_here, slider, tab

from fdcal.model.scene_file import load_scene

DRAWN = "name => window.__viserMutable?.nodeRefFromName?.[name] != null"
GONE = "name => window.__viserMutable?.nodeRefFromName?.[name] == null"
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
def page(browser, kernels):
    """The page of `ball3d`, in the tab Map."""
    with serving_here(load_scene("ball3d")) as address:
        page = opened_page(browser, address)
        tab(page, "Map")
        yield page
        page.close()


def box(page, name):
    return page.evaluate(BOX, name)


def lies(page, axis, place=None):
    """Wait until the slice lies across an axis, at a place if one is given."""
    flat = f"name => {{ const [low, high] = ({BOX})(name), thick = high[{axis}] - low[{axis}];"
    there = "true" if place is None else f"Math.abs(low[{axis}] - {place}) < 1e-3"
    page.wait_for_function(f"{flat} return thick >= 0 && thick < 1e-3 && {there}; }}", arg="/slice")


def test_isosurfaces_and_a_slice_stand_in_the_scene_and_follow_the_controls(page):
    choose(page, "Show", "Isosurfaces (3-D)")
    page.wait_for_function(DRAWN, arg="/isosurfaces")
    page.wait_for_function(GONE, arg="/floor")
    page.get_by_text(re.compile(r"isosurfaces at -[\d.]+(, -[\d.]+)* and -[\d.]+ dB")).first.wait_for()
    low, high = box(page, "/isosurfaces")
    assert all(a > b - 0.02 for a, b in zip(low, (1.4, 1.1, 0.8), strict=True))
    assert all(a < b + 0.02 for a, b in zip(high, (2.4, 2.1, 1.8), strict=True))
    choose(page, "Slice across", "x")
    lies(page, 0)  # the slider has the ends of this axis now
    handle = slider(page, "Slice at (m)")
    handle.focus()
    handle.press("Home")
    lies(page, 0, 1.4)
    handle.press("End")
    lies(page, 0, 2.4)
    choose(page, "Slice across", "y")
    lies(page, 1)
    handle = slider(page, "Slice at (m)")
    handle.focus()
    handle.press("Home")
    lies(page, 1, 1.1)
    sizes = [round(b - a, 2) for a, b in zip(*box(page, "/slice"), strict=True)]
    assert sizes == [1.02, 0.0, 1.02]
    choose(page, "Slice across", "None")
    page.wait_for_function(GONE, arg="/slice")
    before = page.evaluate(BOX, "/lowest")
    microphone = slider(page, "Microphone")
    microphone.focus()
    microphone.press("End")
    page.get_by_text("microphone 63, sum of").first.wait_for()
    page.wait_for_function(f"before => JSON.stringify(({BOX})('/lowest')) != before", arg=str(before).replace(" ", ""))
    choose(page, "Show", "Flat map")
    page.wait_for_function(DRAWN, arg="/floor")
    page.wait_for_function(GONE, arg="/isosurfaces")


def test_a_relief_lies_on_its_axes_from_the_top_and_its_slider_sets_its_height(page):
    choose(page, "Show", "Relief")
    page.wait_for_function(DRAWN, arg="/relief")
    seen = f"() => {{ const box = ({BOX})('/relief'), top = box[1][2]; return 0 < top && top < 2 && box }}"
    low, high = page.wait_for_function(seen).json_value()  # in one look: while a surface is replaced there is none
    assert [round(x, 3) for x in low] == [1.39, 1.09, 0.8] and [round(x, 3) for x in high[:2]] == [2.41, 2.11]
    handle = slider(page, "Relief height (%)")
    handle.focus()
    handle.press("End")
    page.wait_for_function(f"() => ({BOX})('/relief')[1][2] > 1.8")
