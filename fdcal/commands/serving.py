"""The address at which the page is served, and the browser that opens it."""

import errno
import ipaddress
import os
import re
import socket
import sys

from ..model.validation import InputError

PORTS = "use 1024 to 65535, or 0"  # that may be served without being the administrator


def check_address(host: str, port: int) -> bool:
    """Return whether an address can be reached from this machine only (a loopback address).

    The port is bound once, because a viewer with an address that cannot be served would wait indefinitely.
    """
    if not 0 <= port <= 65535:
        raise InputError(f"--port {port} is out of range", f"{PORTS} for a free one", key="port", value=port)
    try:
        if not host or re.search(r"\s", host):
            raise ValueError
        family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, ValueError):
        remedy = "use 127.0.0.1 for this machine alone"
        raise InputError(f'--host "{host}" is an unknown address', remedy, key="host", value=host) from None
    try:
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(place)
            probe.listen(1)
    except PermissionError:
        problem = f"--port {port} may only be used by the administrator"
        raise InputError(problem, PORTS, key="port", value=port) from None
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            remedy = "use another one, or --port 0 for a free one"
            raise InputError(f"--port {port} is in use", remedy, key="port", value=port) from None
        problem = f'--host "{host}" cannot be served here ({error.strerror})'
        raise InputError(problem, "use 127.0.0.1", key="host", value=host) from None
    return ipaddress.ip_address(str(place[0]).split("%")[0]).is_loopback


def warning(host: str, port: int) -> str:
    """Return a warning for an address that other machines can reach, with a safer way."""
    port = port or 8080
    return (
        f"The page at {host} can be opened and used by anyone who reaches this machine: there is no password.\n"
        f"Safer: leave out --host, and on the other machine run  ssh -L {port}:127.0.0.1:{port} USER@THIS-MACHINE"
    )


def open_page(url: str) -> None:
    """Open `url` in a browser; do nothing without a screen, where a text browser would start."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return
    import webbrowser

    webbrowser.open(url)
