"""The documentation, README.md included, as tests read it: its pages, their blocks of code, and how these are run."""

import contextlib
import io
import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
README = ROOT / "README.md"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "generated" not in path.parts)
ALL = [README, *PAGES]
MARK = re.compile(r"<!-- /?figure[^>]*-->")  # around what `python -m benchmarks documents` writes
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A block of code: its language, its text, and the text of the block `text` that follows it directly, or None."""

    language: str
    code: str
    output: str | None


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def prose(path: Path) -> str:
    """Return the words of a page in one line, as its reader sees them."""
    return " ".join(MARK.sub("", text_of(path)).split())


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def blocks(text: str) -> list[Block]:
    """Return all blocks of code of a page, in their order."""
    found = list(BLOCK.finditer(text))
    after = [text[one.end() : two.start()] for one, two in pairwise(found)] + [""]
    following = [*found[1:], None]
    return [
        Block(
            one.group(1),
            one.group(2),
            two.group(2) if two is not None and two.group(1) == "text" and not MARK.sub("", gap).strip() else None,
        )
        for one, two, gap in zip(found, following, after, strict=True)
    ]


def run_python(code: str, where: str, namespace: dict) -> str:
    """Run Python code of a page, and return what it prints."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, where, "exec"), namespace)
    return printed.getvalue()
