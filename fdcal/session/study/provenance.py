"""Which code computed a row of a study: the version of fdcal, a hash of its sources, the commit where there is one."""

from __future__ import annotations

import hashlib
import subprocess
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path

PACKAGE = Path(__file__).parents[2]
PARTS = ("acoustics", "assessment", "cost", "model", "session", "solvers")  # what a row depends on
GIT_SECONDS = 10.0


@dataclass(frozen=True)
class CodeVersion:
    """The code that computes rows."""

    version: str  # of fdcal
    source: str  # hash of the modules that a row depends on
    # that changed the package last, with "+" where files were changed since; None outside a repository
    commit: str | None


def version_text(version: str, source: str, commit: str | None) -> str:
    """Return the code of some rows in words."""
    return f"fdcal {version}, sources {source}" + (f", commit {commit}" if commit else "")


@cache
def code_version() -> CodeVersion:
    """Return the version of the code of this process, as its files are at the first call."""
    return CodeVersion(version("fdcal"), source_hash(PACKAGE), _commit(PACKAGE))


def source_hash(package: Path) -> str:
    """Return a hash of the modules in the PARTS of a folder: names and contents, line ends apart."""
    found = hashlib.blake2b(digest_size=8)
    for path in sorted(path for part in PARTS for path in (package / part).rglob("*.py")):
        found.update(path.relative_to(package).as_posix().encode())
        found.update(path.read_bytes().replace(b"\r\n", b"\n"))
    return found.hexdigest()


def _commit(folder: Path) -> str | None:
    commit = _git(folder, "log", "-1", "--format=%h")
    return commit and commit + ("+" if _git(folder, "status", "--porcelain") else "")


def _git(folder: Path, *words: str) -> str | None:
    """Return what git says of a folder; None where it says nothing, or there is none."""
    command = ["git", "-C", str(folder), *words, "--", "."]
    try:
        found = subprocess.run(command, capture_output=True, text=True, timeout=GIT_SECONDS, check=False)
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip() or None
