"""The page's static title, which a browser shows until the page has loaded and the server has named it.

viser answers the request for its page from a file; `websockets.asyncio.server.serve` is given the function that does
so, as `process_request`. It is wrapped here, and nothing of viser is replaced.
"""

from __future__ import annotations

import functools
import gzip
from collections.abc import Callable

from websockets.http11 import Response

TITLE = "fdcal"
OF_VISER = b"<title>Viser</title>"

Respond = Callable[..., Response | None]  # of a connection and a request


def titled(respond: Respond) -> Respond:
    """Wrap the function that answers requests for files: the page that it returns has the title TITLE."""

    def answer(connection, request) -> Response | None:
        response = respond(connection, request)
        if response is not None and response.headers.get("Content-Type", "").startswith("text/html"):
            response.body = with_title(bytes(response.body), response.headers.get("Content-Encoding") == "gzip")
            del response.headers["Content-Length"]
            response.headers["Content-Length"] = str(len(response.body))
        return response

    return answer


@functools.lru_cache(maxsize=2)
def with_title(body: bytes, zipped: bool) -> bytes:
    """Return a page with the title TITLE in place of viser's; as it is where viser's page has another one.

    `body`: of the page; `zipped`: whether gzip has compressed it.
    """
    plain = gzip.decompress(body) if zipped else body
    renamed = plain.replace(OF_VISER, f"<title>{TITLE}</title>".encode(), 1)
    if renamed == plain:
        return body
    return gzip.compress(renamed, 1) if zipped else renamed
