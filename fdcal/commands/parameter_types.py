"""What the command line is given: texts to values, files that may be written, addresses that can be served.

Each function raises InputError, with the option, its value and the remedy.
"""

from __future__ import annotations

import errno
import ipaddress
import os
import re
import socket
import sys
from dataclasses import replace
from pathlib import Path

from ..model.settings import KNOWN_ROOM_SOLVERS, Search
from ..model.validation import InputError, StorageError, require_positive


def search_domain(own: Search | None, dimension: int, search: str | None, radius: float | None) -> Search | None:
    """The search domain of --search and --radius, what is not given taken from a measurement's `own`."""
    if search is None and radius is None:
        return own
    if own is None and (search is None or radius is None):
        raise InputError("the measurement has no search domain; give both --search ORIGIN,SIZE,STEP and --radius R")
    radius = own.radius if radius is None else radius
    if search is None:
        return replace(own, radius=radius)
    values = numbers(search, "--search", float)
    if len(values) != 2 * dimension + 1:
        layout = ",".join([*"xyz"[:dimension], *("width", "height", "depth")[:dimension], "step"])
        raise InputError(f"--search {search} has {len(values)} numbers; give {2 * dimension + 1} metres: {layout}")
    return Search(tuple(values[:dimension]), tuple(values[dimension:-1]), values[-1], radius)


def numbers(text: str, option: str, kind: type) -> list:
    """The numbers of a list such as "1,5,9", each of `kind`."""
    try:
        return [kind(part) for part in text.split(",")]
    except ValueError:
        word = "whole numbers" if kind is int else "numbers"
        raise InputError(f'{option} "{text}" is no list of {word}; write them with commas between, as 1,5,9') from None


def names(text: str | None) -> tuple[str, ...]:
    """The names of a list such as "3,17"; none unless given."""
    if text is None:
        return ()
    parts = tuple(part.strip() for part in text.split(","))
    if not all(parts):
        raise InputError(f'--exclude "{text}" is no list of microphones; write them with commas between, as 3,17')
    return parts


def distance(text: str | None) -> tuple[str, str, float] | None:
    """Two microphones, by name or number, and metres, from "0,5,1.25"."""
    if text is None:
        return None
    first, second, metres = (text.split(",") + [""] * 3)[:3]
    try:
        if text.count(",") != 2 or not (first.strip() and second.strip()):
            raise ValueError
        return first.strip(), second.strip(), float(metres)
    except ValueError:
        raise InputError(f'--distance "{text}" must be two microphones and metres, as 0,5,1.25') from None


def known_room(text: str | None, solver: str | None) -> tuple[str | None, tuple[float, ...] | None]:
    """Solver and size of the room, metres, from --solver and --room, as "6x5" or "6x5x2.7"."""
    if text is None:
        return solver, None
    if solver not in (None, *KNOWN_ROOM_SOLVERS):
        raise InputError(f"--room is for --solver room, which knows the room; leave out --solver {solver}")
    try:
        size = tuple(float(part) for part in text.lower().split("x"))
    except ValueError:
        size = ()
    if len(size) not in (2, 3):
        raise InputError(f'--room "{text}" is no size of a room; write LENGTHxWIDTH or LENGTHxWIDTHxHEIGHT, as 6x5x2.7')
    for length in size:
        require_positive("--room", length, "m")
    return KNOWN_ROOM_SOLVERS[0], size


def mode_numbers(text: str | None, measured: int) -> list[int]:
    """Modes counted from 1, each once, ascending; 1, 5 and 9 unless given."""
    if text is None:
        return [m for m in (1, 5, 9) if m <= measured]
    modes = numbers(text, "--mode-numbers", int)
    for mode in modes:
        if not 1 <= mode <= measured:
            raise InputError(f"--mode-numbers {text} names mode {mode}; the measurement has 1 to {measured}")
    return sorted(set(modes))


def microphone_number(number: int, count: int) -> int:
    """A microphone counted from 0."""
    if not 0 <= number < count:
        raise InputError(f"--microphone {number} is not there; the array has microphones 0 to {count - 1}")
    return number


def pixels(text: str) -> tuple[int, int]:
    """Width and height from "1280x800"."""
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    width, height = map(int, match.groups()) if match else (0, 0)
    if not (64 <= width <= 8192 and 64 <= height <= 8192):
        raise InputError(f'--size "{text}" is no picture size; write WIDTHxHEIGHT, as 1280x800, 64 to 8192 each')
    return width, height


def output_path(text: str, suffix: str | list[str], force: bool, *inputs: str | None) -> Path:
    """Where a result may be written, none of the `inputs`; asked before the work, not to spend an hour for nothing."""
    path = Path(text)
    allowed = [suffix] if isinstance(suffix, str) else suffix
    if path.suffix.lower() not in allowed:
        raise InputError(f'-o "{text}" must end in {" or ".join(allowed)}; write {path.stem or "result"}{allowed[0]}')
    if path.is_dir():
        raise InputError(f"-o {text} is a folder; name a file")
    if not path.parent.is_dir():
        raise StorageError(f"-o {text} lies in a folder that does not exist; make it first: mkdir -p {path.parent}")
    for given in inputs:
        if given is not None and (Path(given).resolve() == path.resolve() or _same_file(Path(given), path)):
            raise InputError(f"-o {text} is the input itself, which stays untouched; choose another name")
    if path.exists() and not force:
        raise InputError(f"-o {text} exists; add --force to overwrite it, or choose another name")
    return path


def _same_file(one: Path, other: Path) -> bool:
    """Whether two names are of one file, as those of a hard link are."""
    return one.exists() and other.exists() and one.samefile(other)


def address(host: str, port: int) -> bool:
    """Whether `host` is this machine alone (a loopback address), after trying that it can be served.

    A viewer given a host or port that cannot be served would wait for ever, so it is bound here first.
    """
    if not 0 <= port <= 65535:
        raise InputError(f"--port {port} is out of range; use 1024 to 65535, or 0 for a free one")
    try:
        if not host or re.search(r"\s", host):
            raise ValueError
        family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, ValueError):
        raise InputError(f'--host "{host}" is no known address; use 127.0.0.1 for this machine alone') from None
    try:
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(place)
            probe.listen(1)
    except PermissionError:
        raise InputError(f"--port {port} may only be used by the administrator; use 1024 to 65535, or 0") from None
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise InputError(f"--port {port} is in use; use another one, or --port 0 for a free one") from None
        raise InputError(f'--host "{host}" cannot be served here ({error.strerror}); use 127.0.0.1') from None
    return ipaddress.ip_address(place[0].split("%")[0]).is_loopback


def warning(host: str, port: int) -> str:
    """What it means to serve at an address that others can reach, and a safer way."""
    port = port or 8080
    return (
        f"The page at {host} can be opened and worked by anyone who reaches this machine: there is no password.\n"
        f"Safer: leave out --host, and on the other machine run  ssh -L {port}:127.0.0.1:{port} USER@THIS-MACHINE"
    )


def open_page(url: str) -> None:
    """Open `url` in the user's browser; nothing on a machine without a screen, where a text browser would start."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return
    import webbrowser

    webbrowser.open(url)
