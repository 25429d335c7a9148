"""Helpers of tests that look for things on the page in a real browser."""

import contextlib
import functools
import threading
from concurrent.futures import ThreadPoolExecutor
from queue import Queue

import pytest

from fdcal.acoustics.measure import cached_measurement
from fdcal.graphics.camera import camera_for, project
from fdcal.graphics.picture import compose
from fdcal.session.sources import OpenRequest
from fdcal.viewer import app
from fdcal.viewer import scene3d as cameras

WAIT = 60.0  # s, the bound of every wait
COARSE = "?fixedDpr=0.25#layout=expert"  # a sixteenth of the pixels is enough

ARGUMENTS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-gpu-compositing",  # software composes the page either way, and without GL it takes half the time
    "--webgl-antialiasing-mode=none",  # no test looks at the pixels of an edge
    "--disable-quic",
    "--no-first-run",
]
ARGUMENTS += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]


# Software draws every frame: a page takes a third less time with three frames per second than with eight.
FEWER_FRAMES = """{
    const [draw, drop] = [requestAnimationFrame, cancelAnimationFrame];
    window.requestAnimationFrame = act => setTimeout(() => draw(act), 300);
    window.cancelAnimationFrame = number => { clearTimeout(number); drop(number); };
}"""


@contextlib.contextmanager
def serving_here(scene=None, port=0, lessons=(), play=False):
    """Serve a scene's page from a thread of this process, which saves imports; yield its address.

    The page has its own session, controls and panels. Without a scene the opening plays.
    """
    stop, address = threading.Event(), Queue()
    request = None if scene is None else OpenRequest(scene, play=play)
    with pytest.MonkeyPatch.context() as patch, ThreadPoolExecutor(1) as pool:
        patch.setattr(app, "interrupts", lambda: contextlib.nullcontext(stop))
        served = pool.submit(app.serve, request, port=port, on_ready=address.put, lessons=lessons)
        try:
            yield address.get(timeout=WAIT)
        finally:
            stop.set()
            served.result(WAIT)


def slowed_down(page):
    """Make a page draw, and check conditions, less often than 60 times per second."""
    page.add_init_script(FEWER_FRAMES)
    page.wait_for_function = functools.partial(page.wait_for_function, polling=100)
    page.set_default_timeout(WAIT * 1e3)


def is_fault(message):
    """Return whether a console message is an error; one about a control that was removed meanwhile is not."""
    return message.type == "error" and not message.text.startswith("Tried to update non-existent component")


def opened_page(context, address, query=COARSE):
    """A page whose picture is drawn; `page.faults` are the errors that it has reported to the browser's console."""
    page = context.new_page()  # the second page of a context loads viser in half the time
    slowed_down(page)
    page.faults = []
    page.on("console", lambda message: page.faults.append(message.text) if is_fault(message) else None)
    page.goto(f"{address}/{query}")
    drawn = "name => window.__viserMutable?.nodeRefFromName?.[name] != null"
    page.wait_for_function(drawn, arg="/microphones/true", timeout=WAIT * 1e3)
    return page


def until(page, holds):
    """Wait until a function of the tests that checks the page no longer fails; after WAIT, raise its last error.

    The effects of a press (answer of the server, layout, sizes measured by the page's script) come later.
    """
    for _ in range(int(WAIT / 0.1)):
        try:
            return holds()
        except AssertionError:
            page.wait_for_timeout(100)
    return holds()


def restart_solver(page):
    """Take the solver back to its start."""
    press(page, "Restart")
    page.get_by_text("step 0, sweep 0").first.wait_for()


def press(page, name):
    """Press a button as soon as exactly one has that name; while one session replaces another there are two."""
    from playwright.sync_api import Error, expect

    button = page.get_by_role("button", name=name, exact=True)
    while True:
        expect(button).to_have_count(1, timeout=WAIT * 1e3)
        try:
            return button.click()
        except Error as error:  # another session has replaced this one since the line before
            if "strict mode violation" not in str(error):
                raise


def trigger(button):
    """Press a button without waiting until it stops moving: on a busy machine a page may get no frame for a minute."""
    button.wait_for()
    button.evaluate("element => element.click()")


def slider(page, label):
    return page.locator(f"[id='{page.get_by_text(label, exact=True).get_attribute('for')}']").get_by_role("slider")


def choose(page, label, option):
    number = page.locator(f"//label[.='{label}']").get_attribute("for")
    page.locator(f"[id='{number}']").click()
    page.get_by_role("option", name=option, exact=True).click()


def tab(page, name):
    page.get_by_role("tab", name=name, exact=True).click()


STANDS = """([x, y, z]) => {
    const at = window.__viserMutable.camera.position;  // the browser's own axes: y up
    return Math.hypot(at.z + x, at.x + y, at.y - z) < 1e-3 * z;
}"""


def on_screen(page, scene, points):
    """Return the pixels at which points (P, 3), metres, appear in the view from the top, once the camera has it."""
    picture = compose(scene, cached_measurement(scene))
    for _ in range(int(WAIT / 0.1)):
        box = page.locator("canvas").first.bounding_box()
        size = (round(box["width"]), round(box["height"]))
        camera = camera_for(picture, size, "top", cameras.EXPERT_MARGINS, fov=cameras.TOP_FOV)
        if page.evaluate(STANDS, [float(x) for x in camera.position]):
            return project(camera, size, points) + [box["x"], box["y"]]
        page.wait_for_timeout(100)
    there = page.evaluate("window.__viserMutable.camera.position.toArray()")
    pytest.fail(f"the camera stands at {there}, and not at {camera.position} as a canvas of {size} needs it")


def hover(page, pixel):
    """Move the pointer over a microphone, until the page changes the shape of the pointer."""
    over = "[...document.querySelectorAll('canvas')].some(e => e.style.cursor == 'pointer')"
    fixed = pixel
    # The camera may still move: a function returns the current pixel.
    where = pixel if callable(pixel) else lambda: fixed
    for _ in range(int(WAIT)):
        pixel = where()
        page.mouse.move(pixel[0] + 40, pixel[1] + 40)  # viser ignores a pointer that has not moved
        page.mouse.move(*pixel, steps=4)
        for _ in range(10):
            if page.evaluate(over):
                return
            page.wait_for_timeout(100)
    pytest.fail(f"no microphone is found at {pixel}")
