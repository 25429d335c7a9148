"""What a newcomer reads on the canvas, and what a finger does on a phone."""

import re

import pytest
from browsing import WAIT, serving_here

from fdcal.viewer.explore import summed_text
from fdcal.viewer.opening import MICROPHONE

PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
REACH = 24  # pixels, within which a finger takes a microphone
# Where the disc of a microphone stands on the screen, pixels.
DISC = """number => {
    const mutable = window.__viserMutable, canvas = document.querySelector("canvas[data-engine]");
    const {left, top, width, height} = canvas.getBoundingClientRect();
    for (const [name, node] of Object.entries(mutable.nodeRefFromName)) {
        let discs = null;
        if (/^\\/picking\\/\\d+$/.test(name)) node?.traverse(part => { if (part.isInstancedMesh2) discs = part; });
        if (!discs) continue;
        const at = mutable.camera.position.clone().copy(discs.getPositionAt(number)).applyMatrix4(discs.matrixWorld);
        const {x, y} = at.project(mutable.camera);
        return [left + (1 + x) / 2 * width, top + (1 - y) / 2 * height];
    }
}"""
# Whether a text of the scene that shows lies below the legend.
COVERED = """() => {
    const legend = document.querySelector("#fdcal [data-region=legend]").getBoundingClientRect();
    const texts = [...document.querySelectorAll("#fdcal-labels span")].filter(text => !text.style.visibility);
    return texts.filter(text => text.getBoundingClientRect().bottom > legend.top).map(text => text.innerText);
}"""
EMPTY_BOXES = """() => [...document.querySelectorAll(".mantine-Paper-root > .mantine-Paper-root")]
    .filter(name => /none/.test(name.nextElementSibling.style.display))
    .filter(name => getComputedStyle(name.parentElement).borderLeftColor != "rgba(0, 0, 0, 0)")
    .map(name => name.innerText)"""


@pytest.mark.parametrize(
    ("modes", "text"),
    [((92,), "92 alone"), (tuple(range(1, 93)), "1 to 92"), ((3, 4), "3 to 4"), ((1, 2, 3, 7), "1-3, 7")],
)
def test_one_mode_alone_is_told_from_a_sum(modes, text):
    assert summed_text(modes) == text


def test_a_phone_says_how_to_read_the_map_and_a_finger_beside_a_microphone_drags_it(browser, kernels):
    with serving_here() as url:
        context = browser.new_context(**PHONE)
        page = context.new_page()
        page.set_default_timeout(WAIT * 1e3)
        page.goto(f"{url}/?fixedDpr=1#face=explore")
        legend = page.locator("#fdcal [data-region=legend]")
        legend.get_by_text("low and dark").wait_for()
        assert "this microphone" in legend.inner_text()
        assert page.locator("[data-do=modes] + output").inner_text() == "92 alone"
        page.wait_for_function("() => window.__viserMutable.nodeRefFromName['/relief']?.children.length > 0")
        page.wait_for_timeout(1500)
        x, y = (at + 0.5 * REACH for at in page.evaluate(DISC, MICROPHONE))
        finger = context.new_cdp_session(page)
        page.wait_for_timeout(500)
        other = {"x": 330, "y": 320, "id": 1}
        for number in range(8):
            kind = "touchMove" if number else "touchStart"
            at = {"x": x + 4 * number, "y": y + 9 * number, "id": 0}
            if number == 5:
                finger.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [at, other]})
            fingers = [at] if number < 5 else [at, other]
            finger.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers})
            page.wait_for_timeout(150)
        below = f"([x, y]) => {{ const at = ({DISC})({MICROPHONE}); return Math.hypot(at[0] - x, at[1] - y) < 8; }}"
        page.wait_for_function(below, arg=[at["x"] - 0.5 * REACH, at["y"] - 0.5 * REACH])  # as far from it as at first
        page.locator("[data-region=words]").get_by_text(re.compile(r"^-[\d.]+ dB$")).wait_for()
        finger.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        page.get_by_text(re.compile(r"^[01] of 1 home$")).wait_for()
        page.get_by_role("button", name="Expert", exact=True).click()
        page.get_by_text("In use", exact=True).wait_for()
        page.wait_for_function(f"() => ({COVERED})().length == 0")
        assert page.evaluate(EMPTY_BOXES) == [], "a folded section is a line with its name"
        context.close()
