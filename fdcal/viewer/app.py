"""From an opening to a page that is served until Ctrl-C."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ..session.lesson import Lesson
from ..session.request import OpenRequest
from .server.error_log import error_log
from .server.hardening import open_server, without_output
from .server.signals import Interrupt


def serve(
    opening: OpenRequest,
    host: str = "127.0.0.1",
    port: int = 8080,
    on_ready: Callable[[str], None] | None = None,
    lessons: Sequence[Lesson] = (),
    begin: Lesson | None = None,
) -> None:
    """Show an opening at http://host:port (0 takes a free port) until Ctrl-C.

    `on_ready` is called with the address as soon as a page can be opened; the simulation may still run then.
    `lessons` are offered in their order; `begin`, one of them, opens its own scene in place of `opening`.
    Raises InputError (address, scene) and StorageError.
    """
    with Interrupt() as interrupt, error_log():
        server = open_server(host, port)
        page = None
        try:
            server.gui.configure_theme(show_share_button=False, show_logo=False)
            server.gui.set_panel_label(f"fdcal · {opening.scene.name}")
            if on_ready is not None:
                on_ready(address(host, server.get_port()))
            from .preview import look_at_once
            from .scene3d.nodes import SceneNodes

            nodes = SceneNodes(server)
            if begin is None:
                look_at_once(nodes, opening)
            from .page import Page  # seconds of libraries, in which a browser loads its own

            page = Page(server, nodes, lessons)
            page.open(opening) if begin is None else page.lessons.take(begin.title)
            page.run(interrupt)
        finally:
            if page is not None:
                page.close()
            without_output(server.stop)


def address(host: str, port: int) -> str:
    """The address to type into a browser on this machine."""
    name = "127.0.0.1" if host in ("", "0.0.0.0") else "[::1]" if host == "::" else f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}"
