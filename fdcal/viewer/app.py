"""Serve the page until Ctrl-C."""

import contextlib
import io
from collections.abc import Callable, Sequence

from ..session.lesson import Lesson
from ..session.process import interrupts
from ..session.sources import OpenRequest
from ..session.worker import Flag
from .opening import film_html, opening_request
from .server.hardening import is_loopback, open_server
from .server.process import error_log, share_one_heap

BROWSER_TIME = 1.0  # s, longest time that the session waits for a browser to request the page with the film
FIRST_PICTURE = 1.0  # s, longest time from the request until the film begins and viser's program connects


def serve(
    request: OpenRequest | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    on_ready: Callable[[str], None] | None = None,
    lessons: Sequence[Lesson] = (),
    begin: Lesson | None = None,
    on_progress: Callable[[str], None] = lambda text: None,
) -> None:
    """Serve the page until Ctrl-C.

    `request`: what the page shows first, by default the opening (`fdcal.viewer.opening`); `host`: address to listen at;
    `port`: 0 selects a free port; `on_ready`: called with the page's address as soon as it can be opened, perhaps
    before the simulation has finished; `lessons`: offered in this order; `begin`: the lesson to start with, whose scene
    is opened instead of `request`; `on_progress`: called with the progress of the first session in words, and with ""
    when it is ready or refused. InputError if the address or the scene cannot be used; StorageError if a file of the
    scene cannot be read.
    """
    share_one_heap()
    with interrupts() as interrupt, error_log():
        page, opens = None, request is None and begin is None
        sent, connected = Flag(), Flag()
        server = open_server(host, port, film_html() if opens else "", sent.set)
        try:
            server.gui.configure_theme(show_share_button=False, show_logo=False)
            server.gui.set_panel_label("fdcal")
            if on_ready is not None:
                on_ready(address(host, server.get_port()))
            if opens and sent.wait(BROWSER_TIME):
                # The film plays smoothly if the imports below wait for its first picture.
                server.on_client_connect(lambda client: connected.set())
                connected.wait(FIRST_PICTURE)
            from .scene3d import SceneNodes

            nodes = SceneNodes(server)
            if request is not None and begin is None:
                nodes.show_room(request)
            from .page import Page

            named = "" if request is None or begin is not None else request.scene.name
            page = Page(server, nodes, lessons, on_progress, is_loopback(host), named)
            if begin is not None:
                page.lessons.open(begin.title, 1)
            else:
                page.open(request or opening_request())
            page.run(interrupt)
        finally:
            if page is not None:
                page.close()
            with contextlib.redirect_stdout(io.StringIO()):  # viser prints that it has stopped
                server.stop()


def address(host: str, port: int) -> str:
    """Return the address to type into a browser on this machine."""
    name = "127.0.0.1" if host in ("", "0.0.0.0") else "[::1]" if host == "::" else f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}"
