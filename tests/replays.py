"""What a replay holds, read from its HTML, and how tests open one in a browser."""

import json
from html.parser import HTMLParser

import numpy as np

from fdcal.graphics.replay import unpacked


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


def contents(text):
    """Return the data of a replay, its arrays, and its positions (T, N, D), metres."""
    data = json.loads(Reader(text).texts["data"])
    arrays = unpacked(data["packed"])
    return data, arrays, arrays["positions"] * data["unit"] + np.array(data["origin"])


def wait_for(page, condition):
    """Wait for a condition of JavaScript; a replay's content security policy keeps `wait_for_function` out."""
    for _ in range(600):
        if page.evaluate(condition):
            return
        page.wait_for_timeout(100)
    raise AssertionError(f"still not true: {condition}")
