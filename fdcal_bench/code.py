"""The code that computed a row: version, commit of a checkout, and hash of the modules that affect a result."""

import hashlib
import subprocess
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path

import fdcal

PACKAGE = Path(fdcal.__file__).parent
PARTS = ("acoustics", "assessment", "cost", "model", "session", "solvers")  # packages that affect a result
GIT_SECONDS = 10.0


@dataclass(frozen=True)
class CodeVersion:
    """The code of a process."""

    version: str  # of fdcal
    source: str  # hash of the modules that affect a result
    # the last commit that changed the package, with "+" if files were changed since; None outside a repository
    commit: str | None

    def __str__(self) -> str:
        return f"fdcal {self.version}, sources {self.source}" + (f", commit {self.commit}" if self.commit else "")


@cache
def code_version(*more: Path) -> CodeVersion:
    """Return the version of the code at the first call; its hash includes the modules in the folders `more`."""
    commit = _git("log", "-1", "--format=%h")
    changed = "+" if commit and _git("status", "--porcelain") else ""
    return CodeVersion(version("fdcal"), source_hash(PACKAGE, *more), commit and commit + changed)


def source_hash(package: Path, *more: Path) -> str:
    """Return a hash of the modules in the PARTS of a package and in other folders: names and contents."""
    found = hashlib.blake2b(digest_size=8)
    inside = sorted(path for part in PARTS for path in (package / part).rglob("*.py"))
    beside = [path for folder in more for path in sorted(folder.glob("*.py"))]
    for path, root in [(path, package) for path in inside] + [(path, path.parent) for path in beside]:
        found.update(path.relative_to(root).as_posix().encode())
        found.update(path.read_bytes().replace(b"\r\n", b"\n"))  # line endings do not matter
    return found.hexdigest()


def _git(*words: str) -> str | None:
    """Return the output of git on the package; None without output, or without git."""
    command = ["git", "-C", str(PACKAGE), *words, "--", "."]
    try:
        found = subprocess.run(command, capture_output=True, text=True, timeout=GIT_SECONDS, check=False)
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip() or None
