"""What the server sends before a browser has run any of it."""

import gzip
import re
import urllib.request
from types import SimpleNamespace

import pytest

from fdcal.viewer.server.hardening import titled


def fetched(server, **headers):
    request = urllib.request.Request(f"http://127.0.0.1:{server.get_port()}/", headers=headers)
    with urllib.request.urlopen(request, timeout=30) as answer:
        body = answer.read()
        assert int(answer.headers["Content-Length"]) == len(body)
        return gzip.decompress(body) if answer.headers["Content-Encoding"] == "gzip" else body


@pytest.mark.parametrize("encoding", ["gzip", "identity"])
def test_the_page_has_the_programs_name_before_it_has_loaded(server, encoding):
    for _ in range(2):  # the second time it is kept
        page = fetched(server, **{"Accept-Encoding": encoding})
        assert re.findall(rb"<title>(.*?)</title>", page) == [b"fdcal"]
        assert page.count(b"<script") >= 1 and page.rstrip().endswith(b"</html>")


@pytest.mark.parametrize(
    "response",
    [
        None,
        SimpleNamespace(headers={"Content-Type": "image/png"}, body=b"<title>Viser</title>"),
        SimpleNamespace(headers={"Content-Type": "text/html", "Content-Length": "20"}, body=b"<title>Other</title>"),
    ],
)
def test_any_other_answer_is_passed_on(response):
    before = None if response is None else (dict(response.headers), response.body)
    assert titled(lambda *_: response)(None, None) is response
    assert response is None or (response.headers, response.body) == before
