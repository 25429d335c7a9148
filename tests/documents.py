"""The documentation, README.md included, as tests read it: its pages, their blocks of code, and how these are run."""

import contextlib
import io
import re
import shlex
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from fdcal.commands.cli import main

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
README = ROOT / "README.md"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "generated" not in path.parts)
ALL = [README, *PAGES]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A block of code: its language, its text, and the text of the block `text` that follows it directly, or None."""

    language: str
    code: str
    output: str | None


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def blocks(text: str) -> list[Block]:
    """All blocks of code of a page, in their order."""
    found = list(BLOCK.finditer(text))
    after = [text[one.end() : two.start()] for one, two in pairwise(found)] + [""]
    following = [*found[1:], None]
    return [
        Block(
            one.group(1),
            one.group(2),
            two.group(2) if two is not None and two.group(1) == "text" and not gap.strip() else None,
        )
        for one, two, gap in zip(found, following, after, strict=True)
    ]


def run_python(code: str, where: str, namespace: dict) -> str:
    """Run Python code of a page, and return what it prints."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, where, "exec"), namespace)
    return printed.getvalue()


def run_fdcal(code: str) -> str:
    """Run the lines `fdcal ...` of a block, and return what they print; any of them may end with 0, 4 or 5."""
    printed = io.StringIO()
    for line in code.replace("\\\n", " ").splitlines():
        program, *arguments = shlex.split(line, comments=True)
        assert program == "fdcal", line
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(io.StringIO()):
            try:
                main(arguments)
            except SystemExit as end:
                assert end.code in (0, 4, 5), line
    return printed.getvalue()


def without_numbers(text: str) -> list[str]:
    """The lines of a text with # in place of each number that has a decimal point: these depend on the machine."""
    return [re.sub(r"-?\d+\.\d+(e[+-]?\d+)?", "#", line).strip() for line in text.strip().splitlines()]


def shows(documented: str, printed: str) -> bool:
    """Whether each line that is documented is printed, in that order; "..." stands for the rest of a line."""
    lines = iter(without_numbers(printed))
    for wanted in without_numbers(documented):
        start, dots, _ = wanted.partition("...")
        if not any(line.startswith(start) if dots else line == wanted for line in lines):
            return False
    return True
