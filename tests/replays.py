"""Readers of the HTML of a replay, and how tests open one in a browser."""

import base64
import json
import zlib
from contextlib import contextmanager
from dataclasses import replace
from html.parser import HTMLParser
from itertools import islice

import numpy as np

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.model.scene import load_scene


class Reader(HTMLParser):
    """Title, tags, attributes and the text of the data element of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.given, self.texts, self._open = [], [], {}, ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.given += attributes
        self._open = dict(attributes).get("id", tag) if tag in ("script", "title", "style") else ""

    def handle_endtag(self, tag):
        self._open = ""

    def handle_data(self, text):
        if self._open:
            self.texts[self._open] = self.texts.get(self._open, "") + text


def descent_on_tiny(count):
    """Scene `tiny`, its measurement and problem, and the first states of descent."""
    scene = load_scene("tiny")
    measurement = cached_measurement(scene)
    problem = measurement.problem(scene.solver.weights)
    settings = replace(solvers.with_mode_count(problem, scene.solver), name="descent")
    return scene, measurement, problem, list(islice(solvers.run(problem, settings, 0), count))


def unpacked(data):
    """Return the arrays of `fdcal.graphics.replay.packed`."""
    content, at, arrays = zlib.decompress(base64.b64decode(data["bytes"])), 0, {}
    for name, (code, shape) in data["arrays"].items():
        kind = np.dtype("<" + code)
        size = int(np.prod(shape))
        planes = np.frombuffer(content, np.uint8, size * kind.itemsize, at).reshape(kind.itemsize, size)
        values = np.ascontiguousarray(planes.T).view(kind).reshape(shape)
        arrays[name] = np.cumsum(values, axis=0, dtype=kind) if code == "i4" else values
        at += size * kind.itemsize
    return arrays


def contents(text):
    """Return the data of a replay, its arrays, and its positions (T, N, D), metres."""
    data = json.loads(Reader(text).texts["data"])
    arrays = unpacked(data["packed"])
    return data, arrays, arrays["positions"] * data["unit"] + np.array(data["origin"])


def wait_for(page, condition):
    """Wait for a condition of JavaScript; a replay's content security policy forbids `wait_for_function`."""
    for _ in range(600):
        if page.evaluate(condition):
            return
        page.wait_for_timeout(100)
    raise AssertionError(f"still not true: {condition}")


@contextmanager
def offline_page(browser, path=None, address="", ready="Boolean(window.replay?.map)", script=""):
    """Yield a page without a network that shows a file and is `ready`; at the end, check that it reports no fault."""
    faults, page = [], browser.new_context(offline=True, viewport={"width": 1280, "height": 720}).new_page()
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("console", lambda message: faults.append(message.text))
    page.on("dialog", lambda dialog: (faults.append(dialog.message), dialog.dismiss()))
    page.add_init_script(script)
    if path is not None:
        page.goto(path.as_uri() + address)
        wait_for(page, ready)
    yield page
    page.context.close()
    assert not faults
